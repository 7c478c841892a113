"""Measure error against time for the values of one knob on one problem, within a time budget."""

import time
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ..core._warnings import warn
from ..core.interrupts import is_handled, raised_interrupts
from ..errors import InputError
from .deadlines import OutOfTime
from .fitted import fit_order
from .knobs import knob_named
from .norms import check_norms, level_of, next_error, norms_of, relative_rms, rms, spreads_over
from .records import Curve, Knob, Problem, Reference, Trial
from .reference import (
    ERROR_FACTOR,
    PAIR_SEEDS,
    ROUNDING_UNITS,
    mean_of,
    paired_reference,
    random_reference,
    unlike,
)
from .session import GRACE, Clock, Point, Session, whole_seconds

FIRST_LOOK = 0.45  # share of the remaining time, for two calls of one more setting
LAST_LOOK = 0.9  # the same for a setting that is also the finest reference
HOLLOW = 3.0  # errors below this multiple of the reference's error are uncertain
CERTAIN = 0.99865  # confidence that a reference and the finest other setting differ: 3 sigma
LEAST = 2e-3  # s, the shortest remaining time in which a run is started
WORTH = 1.5  # factor on its share of the time, for a knob to be measured again
KEPT = 0.5  # the same for a problem that keeps its compiled programs
REPEATS = 5  # timed calls of a setting that is not random


def curve(
    problem: Problem,
    knob: Knob | str,
    *,
    settings: Sequence[Any] | None = None,
    reference: Any = None,
    seconds: float = 60.0,
    seeds: int = 8,
    metrics: Sequence[str] = ("rms", "p99", "max"),
    clock: Clock | None = None,
) -> Curve:
    """Measure the error and the time of a problem at each value of one setting.

    First the problem is run twice at each value, the cheapest value first. Then the reference is
    computed. Finally, runs with further seeds alternate between the values, so that a drift of the
    machine's speed favours no value. An interrupt ends the measurement and keeps its results. A
    call is abandoned if it exceeds both its predicted time and the remaining time. If XLA is
    compiling when a call is abandoned, the compilation continues in the background. Later calls
    wait until that compilation ends, for at most a quarter of the remaining time. Trials that were
    timed while abandoned work was running are marked (`Trial.beside`).

    Args:
        problem: the computation and its settings.
        knob: the knob, or its name, which is one of `KNOBS`.
        settings: values to measure, cheapest first; None for the values that the knob lists.
        reference: exact result, in the problem's unit; None computes one.
        seconds: time budget, s; values that would exceed the budget are not run, and a call that
            exceeds the budget is abandoned.
        seeds: largest number of seeds for each value of a random knob.
        metrics: norms to record: "rms", "p99", "max" and for pictures "delta_e". The first norm
            decides which value is chosen.
        clock: function that returns seconds; None for the machine's clock.

    Returns:
        The curve.

    Raises:
        InputError: for an unknown knob or norm, no values, fewer than two seeds, a budget of at
            most 0, a problem that refuses every value, and results whose shape differs from the
            shape of the reference.

    Example:
        The midpoint rule on x^2 over [0, 1] has an error of 1 / (12 n^2).

        >>> from jaxvision.accuracy import Knob, Problem, curve
        >>> def midpoint(settings):
        ...     x = (np.arange(settings["n"]) + 0.5) / settings["n"]
        ...     return lambda seed: np.array([np.mean(x**2)])
        >>> n = Knob("n", "intervals", "midpoint rule", (4, 16, 64), (128, 256), order=-2.0)
        >>> found = curve(Problem("x^2", midpoint, exact=[1 / 3]), n)
        >>> print(f"{found.order.exponent:.2f}", found.reference.how)
        -2.00 closed form
    """
    turned = knob_named(knob) if isinstance(knob, str) else knob
    if settings is not None:
        turned = replace(turned, settings=tuple(settings))
    names = tuple(metrics)
    check_norms(names)
    if not turned.settings:
        raise InputError(f"knob {turned.name!r} has no settings; give at least one.")
    if not all(isinstance(setting, Hashable) for setting in turned.settings):
        raise InputError(f"knob {turned.name!r}: a setting is a number, a word or a tuple of such.")
    if int(seeds) != seeds or seeds < 2 or not seconds > 0:
        raise InputError(f"give at least 2 seeds and a time above 0 s, got {seeds}, {seconds}.")
    session = Session(problem, turned, seconds, clock)
    given = problem.exact if reference is None else reference
    how = "closed form" if reference is None else "given"
    found: tuple[Reference, Any] | None = None
    if given is not None:
        found = Reference(None, 0.0, how), session.compared(np.asarray(given, np.float64))
        if not np.isfinite(found[1]).all():
            raise InputError(f"{problem.name}: the reference holds numbers that are not finite.")
    stopped = ""
    try:
        with raised_interrupts(), np.errstate(invalid="ignore", over="ignore"):
            session.wait_for_the_rest()
            _look(session, names)
            if found is None:
                found = random_reference(session) if turned.random else paired_reference(session)
            _take_turns(session, int(seeds))
    except KeyboardInterrupt:
        is_handled()
        stopped = "interrupted"
    except OutOfTime:
        pass
    run = [s for s in turned.settings if s in session.points and session.points[s].results]
    if not run and stopped:
        raise KeyboardInterrupt("interrupted before anything was measured.")
    not_run = tuple(s for s in turned.settings if s not in run)
    late = session.given_up or any(setting not in session.refused for setting in not_run)
    why = (f"out of time{session.given_up}" if late else "", session.refusal)
    stopped = stopped or ", ".join(filter(None, why))
    if not run:
        nothing = Reference(None, np.inf, "none")
        last = stopped, session.elapsed, problem.error_axis
        return Curve(problem.name, turned, (), nothing, None, (), not_run, *last)
    if found is None and not turned.random and len(session.points[run[0]].results) > 1:
        found = paired_reference(session, finer=False)
    if found is None:
        last = session.points[run[-1]].results
        nearest = session.compared(next(iter(last.values())))
        found = Reference(run[-1], np.inf, "finest setting"), nearest
    points = [session.points[setting] for setting in run]
    outcome = partial(_curve_of, session, points, *found, names, not_run)
    with np.errstate(invalid="ignore", over="ignore"):
        try:
            with raised_interrupts():
                return outcome(stopped)
        except KeyboardInterrupt:  # all is measured, but not yet compared
            is_handled()
            return outcome("interrupted")


def _look(session: Session, names: tuple[str, ...]) -> None:
    """Run each setting twice if the time suffices. Run at least one setting, even if only one call
    fits into the time. Settings that raise an error are recorded as refused."""
    settings, finest = session.knob.settings, session.knob.reference[-1:]
    if session.remaining <= LEAST:
        raise OutOfTime
    for setting in settings:
        share = LAST_LOOK if setting in finest else FIRST_LOOK
        if session.expected(setting, calls=2) <= share * session.remaining:
            _run_twice(session, setting)
        if setting == settings[0]:
            for point in session.points.values():  # compiles norms, for which no interrupt waits
                some = next(iter(point.results.values()))
                norms_of(some, some, 1.0, names=names, developed=session.problem.developed)
        if session.given_up:
            break
    if not session.points and not session.refused and not session.given_up:
        first = next(filter(session.is_compiled, settings), settings[0])
        if session.expected(first, calls=1) <= session.remaining:
            _run_twice(session, first)
    if not session.points:
        raise next(iter(session.refused.values()), OutOfTime())


def _run_twice(session: Session, setting: Any) -> None:
    """Run a setting twice. Settings after the first are run only if time for a reference
    remains."""
    share = LAST_LOOK if session.points else 1 + GRACE
    until = session.elapsed + share * session.remaining
    try:
        for seed in PAIR_SEEDS:
            session.call(setting, seed, within=until - session.elapsed)
    except OutOfTime:  # one call does not distinguish a bias from chance
        session.points.pop(setting, None)
    except Exception as refusal:  # the problem may raise any error
        session.refuse(setting, refusal)


def _take_turns(session: Session, seeds: int) -> None:
    """Call all settings alternately, with further seeds, while the next call fits the time."""
    session.wait_for_the_rest()
    rounds = seeds if session.knob.random else min(seeds, REPEATS)
    for number in range(len(PAIR_SEEDS), rounds):
        for setting in session.knob.settings:
            known = setting in session.points
            if known and session.expected(setting, calls=1) <= session.remaining:
                try:
                    session.call(setting, number if session.knob.random else PAIR_SEEDS[0])
                except OutOfTime:  # slower than earlier calls, but already measured
                    session.given_up = ""
                    return
                except Exception:  # such as a part of the pixels that cannot be fitted
                    continue


def _curve_of(
    session: Session,
    points: list[Point],
    reference: Reference,
    exact: Any,
    names: tuple[str, ...],
    not_run: tuple[Any, ...],
    stopped: str,
) -> Curve:
    problem = session.problem
    some = np.asarray(next(iter(exact.values())) if isinstance(exact, dict) else exact)
    shape = session.compared(next(iter(points[0].results.values()))).shape
    if not spreads_over(some.shape, shape):
        raise InputError(
            f"{problem.name}: a result has shape {shape}, and the reference {some.shape}; give one "
            "of the same shape."
        )
    level = level_of(some, problem.level)
    if problem.level is None and not some.any():
        warn(
            f"{problem.name}: the reference is 0 everywhere, so that no error is relative to it; "
            "add light, or turn the camera."
        )
    own = reference.error
    apart = [point for point in points if point.setting != reference.setting]
    if session.knob.random and reference.how == "other seeds":
        own = max(own, _gap(session, apart, some, reference))
    if not session.knob.random and reference.setting is not None:
        own = max(own, unlike(session, [point.setting for point in apart], exact))
    if len(turned := session.knob.settings) > 1 and session.points.keys() == {reference.setting}:
        # an error shared by all is not visible in differences
        own = np.inf if reference.setting == turned[0] else own
    relative = replace(reference, error=own / level)
    trials = [_trial(session, p, exact, level, relative.error, names) for p in points]
    return Curve(
        problem.name,
        session.knob,
        tuple(trials),
        relative,
        fit_order(session.knob, trials),
        pareto_of(trials),
        not_run,
        stopped,
        session.elapsed,
        problem.error_axis,
    )


def _gap(
    session: Session, others: Sequence[Point], exact: np.ndarray, reference: Reference
) -> float:
    """Return the distance between the reference and the finest other setting if the random scatter
    of the two does not explain this distance, so that the reference or the setting must be biased.
    Otherwise return 0. If the reference has no error beyond rounding, return the distance of the
    nearest setting."""
    from scipy.special import stdtrit

    error, known = reference.error, [one for one in others if len(one.results) > 1]
    means = [mean_of(list(one.results.values()), session.problem.compared) for one in known]
    gaps = [rms(mean - exact) for mean, _ in means]
    own = session.points.get(reference.setting)
    units = 0.0 if own is None else ROUNDING_UNITS * own.rounding
    if error <= units * rms(exact):
        pairs = zip(gaps, means, strict=True)
        return min((max(gap, scatter) for gap, (_, scatter) in pairs), default=np.inf)
    if not known:
        return 0.0
    mean, scatter = means[-1]
    limit = float(stdtrit((len(known[-1].results) - 1) * mean.size, CERTAIN))
    return gaps[-1] if gaps[-1] > limit * np.hypot(scatter, error) else 0.0


def _trial(
    session: Session,
    point: Point,
    exact: Any,
    level: float,
    floor: float,
    names: tuple[str, ...],
) -> Trial:
    problem, knob = session.problem, session.knob
    same: dict[int, Any] = dict.fromkeys(point.results, exact)
    truth: Mapping[int, Any] = exact if isinstance(exact, dict) else same
    seeds = [seed for seed in point.results if seed in truth]
    found = {seed: session.compared(point.results[seed]) for seed in seeds}
    norms_named = (*names, "rms")
    each = [
        norms_of(found[s], truth[s], level, names=norms_named, developed=problem.developed)
        for s in seeds
    ]
    norms = {n: rms(np.array([one[n] for one in each])) for n in each[0]}
    main = np.array([one[names[0]] for one in each])
    if knob.random:
        error, low, high = next_error(main)
    else:
        apart = np.stack([found[s] - truth[s] for s in seeds]) / level
        error, low, high = _bias(main, apart)
    hollow = bool(norms["rms"] < HOLLOW * floor)
    # The error of the reference in the first norm; for a random knob the measured error includes
    # it.
    own = floor * (norms[names[0]] / norms["rms"] if norms["rms"] > 0 else 1.0)
    if not knob.random and own > 0:
        low, high = max(low - ERROR_FACTOR * own, 0.0), high + ERROR_FACTOR * own
    high += own if hollow and own > 0 else 0.0
    times = whole_seconds(problem, np.array(point.warm or [point.first]), point.once)
    middle, low_time, high_time = np.quantile(times, [0.5, 0.25, 0.75]).tolist()
    kept = {name: norms[name] for name in names if name in norms}
    seconds = middle, low_time, high_time, point.first
    return Trial(point.setting, error, low, high, *seconds, len(seeds), kept, hollow, point.beside)


def _bias(norms: np.ndarray, apart: np.ndarray) -> tuple[float, float, float]:
    """Estimate the bias, which is the error that all seeds share, with lower and upper bounds. The
    squared bias is the mean, over pairs of seeds, of the product of their differences from the
    reference. If noise hides the bias, the estimate is its upper bound."""
    typical = rms(norms)
    noise = float(np.mean(np.var(apart, axis=0, ddof=1))) if len(apart) > 1 else 0.0
    whole = float(np.mean(apart**2))
    if noise == 0 or whole == 0:
        return typical, typical, typical
    shared, count = max(whole - noise, 0.0), apart[0].size
    # errors of the bands of a pixel are correlated
    count /= apart.shape[-1] if apart.ndim > 2 else 1
    half = 2 * float(np.sqrt((2 * shared * noise + noise**2) / count))
    shared = max(shared, half)
    bounds = np.sqrt(np.clip([shared, shared - half, shared + half], 0, None) / whole)
    return tuple(float(typical * b) for b in bounds)  # pyright: ignore[reportReturnType]


def pareto_of(trials: Sequence[Trial], *, by: str = "error") -> tuple[int, ...]:
    """Return the indices of trials that no other surpasses in time and error, fastest first."""
    found: list[int] = []
    errors = [getattr(trial, by) for trial in trials]
    for i in sorted(range(len(trials)), key=lambda i: (trials[i].seconds, errors[i])):
        if not found or errors[i] < errors[found[-1]]:
            found.append(i)
    return tuple(found)


def error_against_time(
    calls: Mapping[Any, Callable[[], Any]],
    reference: Any,
    *,
    metric: Callable[[Any, Any], float] = relative_rms,
    repeats: int = 5,
    clock: Clock | None = None,
) -> list[Trial]:
    """Measure the error and the time of several functions that compute the same result.

    Warm calls of the functions alternate, so that a drift of the machine's speed favours no
    function.

    Args:
        calls: functions without arguments, by name.
        reference: exact result, from a finer setting or in closed form, in any unit.
        metric: error of a result against the reference.
        repeats: number of warm calls of each function, at least 1.
        clock: function that returns seconds; None for the machine's clock.

    Returns:
        One trial for each function, in the order of `calls`, with the function's name as setting.
            The error is the error of the first call, without an interval.

    Raises:
        InputError: for no calls or no repeats.
    """
    if not calls or repeats < 1:
        raise InputError("error_against_time needs at least one call and one repeat; give both.")
    knob = Knob("call", "", "what rivals", tuple(calls), ())
    problem = Problem("rivals", lambda settings: lambda seed: calls[settings["call"]]())
    session = Session(problem, knob, np.inf, clock)
    for number in range(repeats + 1):
        for name in calls:
            session.call(name, min(number, 1))
    trials = []
    for name in calls:
        point = session.points[name]
        low, middle, high = (float(q) for q in np.quantile(point.warm, [0.25, 0.5, 0.75]))
        error = float(metric(point.results[0], reference))
        trials.append(Trial(name, error, error, error, middle, low, high, point.first))
    return trials


def asked_knobs(of: str, names: Sequence[str] | None, known: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the requested knobs, or all known names if no knob is requested. An
    unknown name raises `InputError`. The error message begins with `of`, the name of the scene or
    rig that is measured."""
    for name in names or ():
        if name not in known:
            words = ", ".join(repr(one) for one in known)
            raise InputError(f"{of}: knob {name!r} changes nothing here; use {words}.")
    return tuple(names or known)


def measure_in_turn(
    names: Sequence[str],
    measure: Callable[[str, float], Curve],
    *,
    seconds: float,
    worth: float = WORTH,
    clock: Clock | None = None,
) -> tuple[Curve, ...]:
    """Measure one curve for each named knob by `measure(name, share)`, where `share` is an equal
    part of the given seconds. If time is left over, measure the curves with the fewest points
    again, as long as at least `worth` times the share remains. An interrupt keeps the finished
    curves."""
    now = clock or time.perf_counter
    until = now() + seconds
    found: list[Curve] = []
    shares: list[float] = []

    def measure_knob(name: str, share: float) -> Curve | None:
        """Return the measured curve, or None if an interrupt stopped the measurement. An interrupt
        before the first curve is raised again."""
        try:
            with raised_interrupts():
                return measure(name, max(share, LEAST))
        except KeyboardInterrupt:
            if not found:
                raise
            is_handled()
            return None

    for number, name in enumerate(names):
        shares.append(max(until - now(), 0.0) / (len(names) - number))
        one = measure_knob(name, shares[-1])
        found.append(one or replace(found.pop(), stopped="interrupted"))
        if found[-1].stopped == "interrupted":
            return tuple(found)
    for number in sorted(range(len(found)), key=lambda n: len(found[n].trials)):
        left, before = until - now(), found[number]
        if before.stopped != "out of time" or left < worth * shares[number]:
            continue
        again = measure_knob(names[number], left)
        if again is None or len(again.trials) >= len(before.trials):
            found[number] = again or replace(before, stopped="interrupted")
        if again is None or again.stopped == "interrupted":
            break
    return tuple(found)
