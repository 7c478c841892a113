"""The best combination of settings, checked by runs with fresh seeds against finer values of all
settings, and tightened if its error exceeds the tolerance."""

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ..errors import InputError
from .deadlines import OutOfTime, in_time
from .norms import level_of
from .records import Curve, Problem
from .reference import DRAWS, FIRST_SEED, SURE, mean_of
from .session import Clock, part_seconds, whole_seconds
from .several import Combination, combined
from .spread import next_error

FRESH = 3  # seeds of the check
FINER = (4, 2)  # times a random setting, for each of the draws of a reference; in a hurry fewer
ROUNDS = 3  # of tightening after a check that failed
MARGIN = 0.9


class Check(NamedTuple):
    """The result of runs with fresh seeds."""

    # relative, what no run is expected to exceed, whatever the reference is itself off by
    error: float
    seconds: float  # s, of a warm call, the first of the runs left out


def settled(
    problem: Problem,
    curves: Sequence[Curve],
    wanted: float | None,
    allowed: float | None,
    *,
    seconds: float,
    clock: Clock | None = None,
) -> tuple[Combination, bool]:
    """The best combination with error and time from fresh runs, and whether there was time for
    them. A combination whose error (relative) or time (s) is too large is tightened. `InputError`
    if no combination meets the limit."""
    now = clock or time.perf_counter
    until = now() + seconds
    aim, within, off, slow = wanted, allowed, 1.0, 1.0
    best, check = None, None
    for number in range(ROUNDS):
        try:
            best = combined(curves, problem.settings, tolerance=aim, seconds=within)
        except InputError:
            if number == 0:
                raise
            break
        check = checked(problem, curves, best, seconds=until - now(), clock=clock)
        if check is None:
            return replace(best, error=best.error * off, seconds=best.seconds * slow), False
        found = replace(best, error=check.error, seconds=check.seconds)
        if wanted is not None and check.error <= wanted:
            return found, True
        if allowed is not None and (check.seconds <= allowed or number == ROUNDS - 1):
            return found, True
        off = check.error / max(best.error, 1e-12)
        slow = check.seconds / max(best.seconds, 1e-12)
        if wanted is not None:
            aim = MARGIN * wanted / off
        if allowed is not None:  # of what settings can save, the same share as of what they took
            least = combined(curves, problem.settings, tolerance=np.inf).seconds
            share = max(allowed - least, 0.0) / max(check.seconds - least, 1e-12)
            within = least + MARGIN * share * (best.seconds - least)
    assert best is not None
    assert check is not None
    if wanted is None:
        return replace(best, error=check.error, seconds=check.seconds), True
    raise InputError(
        f"{problem.name}: no settings were found within {wanted:.3g}: fresh runs of the last ones "
        f"are off by {check.error:.3g}; allow more, or more time to measure."
    )


def checked(
    problem: Problem,
    curves: Sequence[Curve],
    best: Combination,
    *,
    seconds: float,
    clock: Clock | None = None,
) -> Check | None:
    """Measure the error and time of a combination, by runs with fresh seeds against finer settings
    of all knobs, for at most `seconds`. The result is None if there is too little time for a
    reference with half of that error. The bias of the reference's own settings is added to the
    error."""
    now = clock or time.perf_counter
    until = now() + seconds
    own = sum(
        SURE * one.reference.error
        for one in curves
        if not one.knob.random and one.knob.name not in best.unknown
    )
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
                work = partial(_fresh_runs, problem, finest, turned, random, now)
                check = in_time(work, lambda: until - now())
                return check and check._replace(error=check.error + own)
            return None
    return None


def _finer(
    problem: Problem, curves: Sequence[Curve], best: Combination, finer: int
) -> tuple[dict[str, Any], float]:
    """Return settings for a reference, and the time of a call in s. Each knob has the setting of
    its own reference, and a random knob a multiple of the chosen number."""
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


def _fresh_runs(
    problem: Problem,
    finest: Mapping[str, Any],
    turned: Mapping[str, Any],
    random: bool,
    now: Clock,
) -> Check | None:
    """Error and time of settings with fresh seeds; None if the finest settings are not better."""
    compute = problem.prepare(finest)
    draws = [np.asarray(compute(FIRST_SEED + n), np.float64) for n in range(DRAWS if random else 1)]
    compared = problem.compared or np.asarray
    reference, own = mean_of(draws, compared) if random else (compared(draws[0]), 0.0)
    chosen = problem.prepare(turned)
    errors, times = [], []
    for seed in range(FIRST_SEED // 2, FIRST_SEED // 2 + FRESH):
        begun = now()
        result = np.asarray(chosen(seed))
        times.append(now() - begun)
        errors.append(np.sqrt(np.mean((compared(result) - reference) ** 2)))
    level = level_of(reference, problem.level)
    found = next_error(np.array(errors) / level)[2]
    seconds = whole_seconds(problem, np.median(times[1:]), problem.once())
    return None if own / level > found / 2 else Check(found, float(seconds))
