"""Choose a combination of settings for several knobs: the cheapest within a tolerance, or the most
accurate within a time.

The time of a combination is modelled as a product: each knob changes the time by the factor that
was measured with the other knobs fixed. In the model of the error, random errors add in quadrature
and biases add linearly: error^2 = (sum of biases)^2 + sum of squares of random errors.

The best combination is compared with finer settings in runs with fresh seeds. If its error exceeds
the tolerance, a more accurate combination is tried.
"""

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from ..core.interrupts import is_handled, raised_interrupts
from ..errors import InputError
from .choice import candidates
from .curves import pareto_of
from .deadlines import OutOfTime, run_within
from .norms import level_of, next_error, rms
from .records import Curve, Problem
from .reference import DRAWS, ERROR_FACTOR, FIRST_SEED, mean_of
from .session import Clock, part_seconds, whole_seconds

CHECK_SEEDS = 3  # seeds of the check
# factors on a random setting for each draw of a reference; the second if time is short
FACTORS = (4, 2)
ROUNDS = 3  # rounds of tightening after a failed check
MARGIN = 0.9
TOLERANCES = (0.1, 0.01, 0.001)


@dataclass(frozen=True)
class Combination:
    """A setting for each of several knobs, with the expected error and time of the combination.

    Attributes:
        settings: values of the settings, by name.
        error: upper limit of the relative error for any seed.
        seconds: time of a warm call, s.
        unknown: knobs that keep their setting because the time was too short to estimate their
            errors; `error` does not include these errors.
    """

    settings: Mapping[str, Any]
    error: float
    seconds: float
    unknown: tuple[str, ...] = ()


def combined(
    curves: Sequence[Curve],
    base: Mapping[str, Any],
    *,
    tolerance: float | None = None,
    seconds: float | None = None,
) -> Combination:
    """Choose the best combination of settings of several knobs, from the Pareto fronts of the
    knobs. A deterministic knob whose error is unknown keeps its value in `base`.

    Args:
        curves: measured curves of one problem, one for each knob; the other knobs had their values
            in `base`.
        base: value of each knob while the other knobs were measured.
        tolerance: upper limit of the relative error for any seed.
        seconds: upper limit of the time of a warm call, s.

    Returns:
        The combination.

    Raises:
        InputError: unless exactly one of tolerance and time is given; if no combination meets the
            given limit; if no error is known; and if the error of a random knob is unknown.
    """
    if (tolerance is None) == (seconds is None) or not curves:
        raise InputError("combined needs curves, and either a tolerance or a time.")
    limit = tolerance if tolerance is not None else seconds
    assert limit is not None
    missing = [one.knob.name for one in curves if one.knob.name not in base]
    if missing or not limit >= 0:
        wrong = f"base has no setting of {missing[0]!r}" if missing else f"got {limit:g}"
        raise InputError(f"combined: {wrong}; give one of each knob, and a limit of at least 0.")
    run = [curve for curve in curves if curve.trials]
    once = float(np.median([_seconds_at(curve, base) for curve in run] or [0.0]))
    fronts = [_pareto(c, _seconds_at(c, base)) if c.trials else [] for c in curves]
    unknown = _unknown(curves, fronts)
    sets = [
        front or [(base[curve.knob.name], 0.0, 1.0)]
        for curve, front in zip(curves, fronts, strict=True)
    ]
    names = [curve.knob.name for curve in curves]
    random = np.array([curve.knob.random for curve in curves])
    best: tuple[float, Combination] | None = None
    nearest = np.inf
    for chosen in product(*sets):
        errors = np.array([error for _, error, _ in chosen])
        error = float(np.hypot(errors[~random].sum(), np.linalg.norm(errors[random])))
        taken = once * float(np.prod([factor for *_, factor in chosen]))
        price, limited = (error, taken) if tolerance is None else (taken, error)
        nearest = min(nearest, limited)
        if limited <= limit and (best is None or price < best[0]):
            settings = {n: s for n, (s, *_) in zip(names, chosen, strict=True)}
            best = price, Combination(settings, error, taken, unknown)
    if best is None:
        unit = "" if tolerance is not None else " s"
        raise InputError(
            f"No settings reach {limit:g}{unit}: the nearest are known to be within "
            f"{nearest:.3g}{unit}; allow more, or more time to measure."
        )
    return best[1]


def _seconds_at(curve: Curve, base: Mapping[str, Any]) -> float:
    """Return the time, s, at a curve's `base` value, interpolated."""
    setting = base[curve.knob.name]
    known = {trial.setting: trial.seconds for trial in curve.trials}
    if setting in known:
        return known[setting]
    if isinstance(setting, str):
        return curve.trials[0].seconds
    settings = sorted(known)
    return float(np.interp(setting, settings, [known[s] for s in settings]))


Front = list[tuple[Any, float, float]]


def _unknown(curves: Sequence[Curve], fronts: Sequence[Front]) -> tuple[str, ...]:
    """Return the names of the knobs for which no error is known. `InputError` is raised if such a
    knob is random, or if no knob has a known error."""
    found = [c.knob for c, front in zip(curves, fronts, strict=True) if not front]
    lost = next((k for k in found if k.random or len(found) == len(curves)), None)
    if lost is not None:
        raise InputError(f"no error of knob {lost.name!r} is known; allow more time to measure.")
    return tuple(knob.name for knob in found)


def _pareto(curve: Curve, once: float) -> Front:
    """Return the Pareto-optimal settings of a curve, as (setting, error bound, time divided by the
    time of the setting in `base`)."""
    known = [trial for trial in candidates(curve) if np.isfinite(trial.error_high)]
    best = [known[i] for i in pareto_of(known, by="error_high")]
    return [(trial.setting, trial.error_high, trial.seconds / max(once, 1e-12)) for trial in best]


class Check(NamedTuple):
    """The error and time of a combination, from runs with fresh seeds."""

    # relative, upper limit for any run, including the error of the reference
    error: float
    seconds: float  # s, time of a warm call, without the first run


def combine_and_check(
    problem: Problem,
    curves: Sequence[Curve],
    wanted: float | None,
    allowed: float | None,
    *,
    seconds: float,
    clock: Clock | None = None,
) -> tuple[Combination, bool]:
    """Choose the best combination, check it by runs with fresh seeds, and choose again if the check
    fails. Return the combination with its error and time, and whether there was time to check it.
    Raise `InputError` if no combination meets the limit."""
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
        check = check_combination(problem, curves, best, seconds=until - now(), clock=clock)
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
        if allowed is not None:  # the same share of the possible saving as of the time used
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


def check_combination(
    problem: Problem,
    curves: Sequence[Curve],
    best: Combination,
    *,
    seconds: float,
    clock: Clock | None = None,
) -> Check | None:
    """Measure the error and the time, in s, of a combination by runs with fresh seeds, compared
    with finer settings. Return None if the time is too short for a reference with an error of at
    most half the measured error."""
    now = clock or time.perf_counter
    until = now() + seconds
    own = sum(
        ERROR_FACTOR * one.reference.error
        for one in curves
        if not one.knob.random and one.knob.name not in best.unknown
    )
    turned = {**problem.settings, **best.settings}
    random = any(one.knob.random for one in curves)
    for finer in FACTORS if random else (1,):
        finest, each = _finer(problem, curves, best, finer)
        compiling = sum(
            problem.compiling
            for one in (finest, turned)
            if problem.compiled is None or not problem.compiled(one)
        )
        call = part_seconds(problem, best.seconds)
        if compiling + DRAWS * each + CHECK_SEEDS * call <= seconds:
            with suppress(OutOfTime):
                work = partial(_fresh_runs, problem, finest, turned, random, now)
                check = run_within(work, lambda: until - now())
                return check and check._replace(error=check.error + own)
            return None
    return None


def _finer(
    problem: Problem, curves: Sequence[Curve], best: Combination, finer: int
) -> tuple[dict[str, Any], float]:
    """Return finer settings, with which the reference for a check is computed, and the time in s of
    one call with these settings. A deterministic knob has the setting with which the reference of
    its curve was computed. A random knob has `finer` times the setting that `best` chose."""
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
    """Run settings with fresh seeds for error and time; None if the reference is too coarse."""
    compute = problem.prepare(finest)
    draws = [np.asarray(compute(FIRST_SEED + n), np.float64) for n in range(DRAWS if random else 1)]
    compared = problem.compared or np.asarray
    reference, own = mean_of(draws, compared) if random else (compared(draws[0]), 0.0)
    chosen = problem.prepare(turned)
    errors, times = [], []
    for seed in range(FIRST_SEED // 2, FIRST_SEED // 2 + CHECK_SEEDS):
        begun = now()
        result = np.asarray(chosen(seed))
        times.append(now() - begun)
        errors.append(rms(compared(result) - reference))
    level = level_of(reference, problem.level)
    found = next_error(np.array(errors) / level)[2]
    seconds = whole_seconds(problem, np.median(times[1:]), problem.once())
    return None if own / level > found / 2 else Check(found, float(seconds))


@dataclass(frozen=True)
class Together:
    """The cheapest combination of settings of all knobs for one tolerance."""

    # the settings; None: no settings are known to be within the tolerance
    combination: Combination | None
    # whether error and time are those of runs with fresh seeds; else they follow from the curves of
    # single knobs
    checked: bool = False


def all_together(
    problem: Problem,
    curves: Sequence[Curve],
    *,
    seconds: float = 0.0,
    clock: Clock | None = None,
) -> tuple[Together, ...]:
    """For each of `TOLERANCES`, choose the cheapest combination of settings and check it, all
    within the given seconds. The result is empty if fewer than two knobs were measured. An
    interrupt ends the checks, and the other combinations are returned unchecked."""
    known = [curve for curve in curves if curve.knob.name in problem.settings]
    if len(known) < 2:
        return ()
    now = clock or time.perf_counter
    until, found = now() + seconds, list[Together]()
    try:
        with raised_interrupts():
            for tolerance in TOLERANCES:
                left = max(until - now(), 0.0)
                found.append(_choose_combination(problem, known, tolerance, found, left, clock))
    except KeyboardInterrupt:
        is_handled()
        for tolerance in TOLERANCES[len(found) :]:
            found.append(_choose_combination(problem, known, tolerance, found, 0.0, clock))
    return tuple(found)


def _choose_combination(
    problem: Problem,
    curves: Sequence[Curve],
    tolerance: float,
    before: Sequence[Together],
    seconds: float,
    clock: Clock | None,
) -> Together:
    try:
        best = combined(curves, problem.settings, tolerance=tolerance)
        for one in before:  # settings that were checked before need no second check
            known = one.combination if one.checked else None
            if known and known.settings == best.settings and known.error <= tolerance:
                return one
        if seconds <= 0:
            return Together(best)
        return Together(
            *combine_and_check(problem, curves, tolerance, None, seconds=seconds, clock=clock)
        )
    except InputError:
        return Together(None)
