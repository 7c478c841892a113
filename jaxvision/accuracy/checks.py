"""The best combination of settings, checked by runs with fresh seeds against finer settings of all
knobs, and tightened where they find it beyond the tolerance."""

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ..errors import InputError
from .deadlines import OutOfTime, in_time
from .norms import level_of
from .records import Curve, Problem
from .reference import DRAWS, FIRST_SEED, mean_of
from .session import Clock, part_seconds
from .several import Combination, combined
from .spread import next_error

FRESH = 3  # seeds of the check
FINER = (4, 2)  # times a random setting, for each of the draws of a reference; in a hurry fewer
ROUNDS = 3  # of tightening after a check that failed
MARGIN = 0.9


def settled(
    problem: Problem,
    curves: Sequence[Curve],
    wanted: float | None,
    allowed: float | None,
    *,
    seconds: float,
    clock: Clock | None = None,
) -> tuple[Combination, bool]:
    """The best combination, checked by fresh runs; one that they find beyond the tolerance is
    tightened.

    Args:
        problem: whose knobs they are.
        curves: of the knobs.
        wanted: relative error; None: a time is given.
        allowed: s; None: an error is given.
        seconds: s, for the runs.
        clock: seconds as a function; None: the machine's.

    Returns:
        The combination with the error of those runs, and whether there was time for them.

    Raises:
        InputError: where no combination is within the tolerance or the time.
    """
    now = clock or time.perf_counter
    until = now() + seconds
    aim, off, error = wanted, 1.0, None
    for number in range(ROUNDS):
        try:
            best = combined(curves, problem.settings, tolerance=aim, seconds=allowed)
        except InputError:
            if number == 0:
                raise
            break
        error = checked_error(problem, curves, best, seconds=until - now(), clock=clock)
        if error is None:
            return replace(best, error=best.error * off), False
        if wanted is None or error <= wanted:
            return replace(best, error=error), True
        off = error / max(best.error, 1e-12)
        aim = MARGIN * wanted / off
    raise InputError(
        f"{problem.name}: no settings were found within {wanted:.3g}: fresh runs of the last ones "
        f"are off by {error:.3g}; allow more, or more time to measure."
    )


def checked_error(
    problem: Problem,
    curves: Sequence[Curve],
    best: Combination,
    *,
    seconds: float,
    clock: Clock | None = None,
) -> float | None:
    """The error of a combination, by runs with fresh seeds against finer settings of all knobs.

    Args:
        problem: whose knobs they are.
        curves: of the knobs.
        best: the combination.
        seconds: s, the time that is left.
        clock: seconds as a function; None: the machine's.

    Returns:
        Relative, what no run is expected to exceed; None where time is too short for a reference
        of a third of that error.
    """
    now = clock or time.perf_counter
    until = now() + seconds
    turned = {**problem.settings, **best.settings}
    random = any(one.knob.random for one in curves)
    for finer in FINER if random else (1,):
        finest, each = _finer(problem, curves, best, finer)
        compiling = sum(
            problem.compiling
            for one in (finest, turned)
            if problem.compiled is None or not problem.compiled(one)
        )
        call = part_seconds(problem, best.seconds)
        if compiling + DRAWS * each + FRESH * call <= seconds:
            with suppress(OutOfTime):
                work = partial(_fresh_error, problem, finest, turned, random)
                return in_time(work, lambda: until - now())
            return None
    return None


def _finer(
    problem: Problem, curves: Sequence[Curve], best: Combination, finer: int
) -> tuple[dict[str, Any], float]:
    """Settings for a reference, and s of a call: of each knob those of its own reference, of random
    ones so many times the chosen number."""
    measured = [one for one in curves if one.knob.name not in best.unknown]
    fine = {c.knob.name: c.reference.setting for c in measured if c.reference.setting is not None}
    each = part_seconds(problem, best.seconds)
    for one in measured:
        name = one.knob.name
        setting = fine.get(name)
        if not isinstance(setting, int | float):
            continue
        if one.knob.random:
            fine[name] = finer * best.settings[name]
            each *= finer
        else:
            known = {trial.setting: trial.seconds for trial in one.trials}
            ends = known.get(best.settings[name], one.trials[0].seconds)
            each *= max(max(known.values()) / ends, 1.0) if ends > 0 else 1.0
    return {**problem.settings, **best.settings, **fine}, each


def _fresh_error(
    problem: Problem, finest: Mapping[str, Any], turned: Mapping[str, Any], random: bool
) -> float | None:
    """The error of settings by fresh seeds against the finest; None where that is no better."""
    compute = problem.prepare(finest)
    draws = [np.asarray(compute(FIRST_SEED + n), np.float64) for n in range(DRAWS if random else 1)]
    compared = problem.compared or np.asarray
    reference, own = mean_of(draws, compared) if random else (compared(draws[0]), 0.0)
    chosen = problem.prepare(turned)
    results = [compared(np.asarray(chosen(FIRST_SEED // 2 + n))) for n in range(FRESH)]
    errors = [np.sqrt(np.mean((one - reference) ** 2)) for one in results]
    level = level_of(reference, problem.level)
    found = next_error(np.array(errors) / level)[2]
    return None if own / level > found / 2 else found
