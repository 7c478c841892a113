"""Compute the reference result from which errors are measured, independently of the measured
results, and estimate its error. For a random knob, the error estimate comes from other seeds. For a
deterministic knob, the error estimate comes from coarser settings."""

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from ..errors import InputError
from .deadlines import OutOfTime
from .fitted import is_number, variable
from .norms import rms
from .records import Compared, Knob, Law, Reference
from .session import Session

DRAWS = 4  # smallest number of independent results in the mean of a random reference
MOST_DRAWS = 16
TIME_SHARE = 0.6  # share of the remaining time
ABANDON_SHARE = 0.9  # share of the remaining time, after which a reference is abandoned
FIRST_SEED = 1_000_000  # first seed of references; trials have smaller seeds
PAIR_SEEDS = (0, 1)  # seeds with which settings of a bias are compared with each other
ROUNDING_UNITS = 4  # ULP: the smallest error that is assumed for a sum
MAX_DISAGREEMENT = 4.0  # factor on the error expected from the steps between settings, as the limit
ERROR_FACTOR = 1.5  # factor on the estimated error of a reference, as its upper limit
RUNGS = 4  # settings of a sequence: three determine the rate of its decrease, a fourth the law
MOST_TAIL = 6.0  # largest error after the last step, in units of this step
STEEPEST = 300.0  # fall of an error between two settings, as a logarithm


def mean_of(draws: Sequence[np.ndarray], compared: Compared | None) -> tuple[np.ndarray, float]:
    """Return the mean of at least two independent results and its standard error by the jackknife
    (Efron, SIAM (1982), ch. 3). `compared`, if given, is applied to the mean."""
    count, total = len(draws), np.sum(draws, axis=0)
    if compared is None:
        return total / count, rms(np.std(draws, axis=0, ddof=1)) / count**0.5
    without = np.stack([compared((total - draw) / (count - 1)) for draw in draws])
    return compared(total / count), rms(np.std(without, axis=0)) * (count - 1) ** 0.5


def random_reference(session: Session) -> tuple[Reference, np.ndarray]:
    """Return the mean of independent runs of the finest setting that the time allows. The error of
    this reference is the standard error of the mean, in the unit of the result."""
    run = tuple(session.points)
    setting = _finest(session, calls=DRAWS)
    try:
        draws = _draw_results(session, setting)
    except Exception as failure:
        late = isinstance(failure, OutOfTime)
        if setting not in run:
            if late:
                session.points.pop(setting, None)
            else:
                session.refuse(setting, failure)
        coarser = run[: run.index(setting)] if setting in run else run
        if not coarser:
            raise
        setting = coarser[-1]
        draws = _draw_results(session, setting)
    mean, error = mean_of(draws, session.problem.compared)
    return Reference(setting, error, "other seeds"), mean


def _draw_results(session: Session, setting: Any) -> list[np.ndarray]:
    """Return independent results of a setting, as many as can be computed in a share of the
    remaining time. A seed that fails is skipped if other seeds have succeeded."""
    draws: list[np.ndarray] = []
    until = session.elapsed + TIME_SHARE * max(session.remaining, 0.0)
    latest = session.elapsed + ABANDON_SHARE * session.remaining
    for seed in range(FIRST_SEED, FIRST_SEED + MOST_DRAWS):
        if len(draws) >= DRAWS and session.elapsed + session.expected(setting, calls=1) > until:
            break
        try:
            point = session.call(setting, seed, within=latest - session.elapsed)
        except OutOfTime:
            if len(draws) < DRAWS:
                raise
            break
        except Exception:
            if not draws:
                raise
            continue
        draws.append(point.results.pop(seed))
    if len(draws) < 2:
        raise InputError(
            f"{session.problem.name}: {session.knob.name} {setting} fails with most seeds."
        )
    return draws


def paired_reference(
    session: Session, *, finer: bool = True
) -> tuple[Reference, dict[int, np.ndarray]]:
    """Compute the reference for a deterministic knob: the results of the finest setting that the
    time allows, for the same seeds as the trials. Without `finer`, the reference is the finest
    setting that was already run. The error of the reference is estimated from the differences
    between the results of the finest settings."""
    knob = session.knob
    exact = bool(knob.reference) and not isinstance(knob.reference[-1], int | float)
    steps: list[Any] = [s for s, p in session.points.items() if p.results.keys() >= set(PAIR_SEEDS)]
    chosen = steps[-1]
    for setting in knob.reference if finer else ():
        if session.expected(setting, calls=len(PAIR_SEEDS)) > TIME_SHARE * session.remaining:
            break
        try:
            for seed in PAIR_SEEDS:
                session.call(setting, seed)
        except OutOfTime:
            session.points.pop(setting, None)
            break
        except Exception as failure:
            session.refuse(setting, failure)
            break
        steps = [step for step in steps if step != setting] + [setting]
        chosen = setting
    rungs = (*steps[-RUNGS:-1], chosen)
    ladder = _ladder(session, rungs)
    found = ladder[-1]
    rounding = ROUNDING_UNITS * session.points[chosen].rounding * rms(found[PAIR_SEEDS[0]])
    if exact and chosen == knob.reference[-1]:
        return Reference(chosen, rounding, "exact setting"), found
    how = "twice as fine" if chosen in knob.reference else "finest setting"
    return Reference(chosen, max(_tail(knob, rungs, ladder), rounding), how), found


def unlike(session: Session, settings: Sequence[Any], reference: Any) -> float:
    """Return the distance, in the result's unit, between the reference and the finest of at least
    three other settings, if this distance is larger than the differences between those settings
    explain. Otherwise return 0."""
    run = [one for one in settings if session.points[one].results.keys() >= set(PAIR_SEEDS)]
    run = run[-RUNGS:]
    rungs = [one for one in run if isinstance(one, int | float)]
    if len(rungs) < 3:
        return 0.0
    ladder = _ladder(session, rungs)
    apart = [
        ladder[-1][seed] - (reference[seed] if isinstance(reference, dict) else reference)
        for seed in PAIR_SEEDS
    ]
    gap = rms(np.mean(apart, axis=0))
    return gap if gap > MAX_DISAGREEMENT * _tail(session.knob, rungs, ladder) else 0.0


def _ladder(session: Session, settings: Sequence[Any]) -> list[dict[int, np.ndarray]]:
    """Return the prepared results of each setting, for the seeds that all settings have in
    common."""
    results = (session.points[setting].results for setting in settings)
    return [{seed: session.compared(own[seed]) for seed in PAIR_SEEDS} for own in results]


def _finest(session: Session, *, calls: int) -> Any:
    """Return the finest setting whose calls fit into the time, else the cheapest."""
    chosen = next(iter(session.points))
    for setting in (*session.points, *session.knob.reference):
        if session.expected(setting, calls=calls) <= TIME_SHARE * session.remaining:
            chosen = setting
    return chosen


def _tail(knob: Knob, settings: Sequence[Any], ladder: Sequence[Mapping[int, np.ndarray]]) -> float:
    """Estimate the error of the last of at least two results. The error is assumed to be E exp(-k
    x), where x is a function of the setting (`fitted.variable`). The sizes of successive
    differences of results give the rate k. The correlation of successive differences shows whether
    they add up in one direction or at random."""
    if len(ladder) < 2:
        return float("inf")
    steps = [
        np.mean([after[seed] - before[seed] for seed in PAIR_SEEDS], axis=0)
        for before, after in pairwise(ladder)
    ]
    last = rms(steps[-1])
    laws = _laws(knob.law, settings, [rms(step) for step in steps])
    apart = [_distance(laws[0], *pair) for pair in pairwise(settings)]
    if len(steps) < 2:
        known = knob.order is not None and knob.law == "power"
        return last * max(1.0, 1 / np.expm1(abs(knob.order or 1.0) * apart[0])) if known else last
    first = rms(steps[-2])
    if first == 0 or last == 0:
        return last
    alike = float(np.clip(np.mean(steps[-2] * steps[-1]) / (first * last), 0, 1))
    tails = []
    for law in laws:
        apart = [_distance(law, *pair) for pair in pairwise(settings)][-2:]
        bias = _bias_of_last(first / last, *apart)
        chance = _chance_of_last(first / last, *apart)
        tails.append(last * float(np.sqrt(alike * bias**2 + (1 - alike) * chance**2)))
    return max(tails)


def _laws(law: Law, settings: Sequence[Any], steps: Sequence[float]) -> tuple[Law, ...]:
    """Return the laws by which errors are extrapolated. If the knob declares a power law, only this
    law is returned. If the knob declares a geometric law, return the law, geometric or power, for
    which the differences of results give the most constant rate. With fewer than three differences,
    return both laws."""
    if law == "power":
        return (law,)
    if len(steps) < 3 or min(steps) == 0:
        return law, "power"

    def unsteady(law: Law) -> float:
        apart = [_distance(law, *pair) for pair in pairwise(settings)]
        ratios = [before / after for before, after in pairwise(steps)]
        rates = [_bias_rate(*given) for given in zip(ratios, apart, apart[1:], strict=False)]
        return abs(np.log(rates[1] / rates[0])) if min(rates) > 0 else np.inf

    return (min((law, "power"), key=unsteady),)


def _distance(law: Law, coarse: Any, fine: Any) -> float:
    """Return the distance of two settings in the variable of a law; 1 unless both are numbers."""
    if not (is_number(coarse) and is_number(fine)):
        return 1.0
    return abs(variable(fine, law) - variable(coarse, law)) or 1.0


def _bias_of_last(ratio: float, before: float, after: float) -> float:
    """Return the estimated bias at the finest of three settings, relative to the last step, at most
    `MOST_TAIL`. A step is the change of the result from one setting to the next; both steps have
    the same sign. `ratio` is the first step divided by the last step."""
    rate = _bias_rate(ratio, before, after)
    return float(min(1 / np.expm1(rate * after), MOST_TAIL)) if rate > 0 else MOST_TAIL


def _bias_rate(ratio: float, before: float, after: float) -> float:
    """Return the rate k of a bias exp(-k x) over the variable x of a law, from the `ratio` of two
    successive changes of the result, which have the same sign; 0 if the bias does not decrease."""
    if ratio <= before / after:
        return 0.0
    return _rate(lambda k: np.expm1(k * before) / -np.expm1(-k * after), ratio, before, after)


def _chance_of_last(ratio: float, before: float, after: float) -> float:
    """Return the estimated random error at the finest of three settings, relative to the last step,
    whose sign is random. A step is the change of the result from one setting to the next. `ratio`
    is the first step divided by the last step."""
    if ratio <= 1:
        return 1.0
    law = lambda k: (np.exp(2 * k * before) + 1) / (1 + np.exp(-2 * k * after))  # noqa: E731
    rate = _rate(law, ratio**2, before, after)
    return float(1 / np.sqrt(np.exp(2 * rate * after) + 1))


def _rate(law: Callable[[float], float], ratio: float, before: float, after: float) -> float:
    """Solve law(k) = ratio for the rate k, where the law increases with k."""
    from scipy.optimize import brentq

    most = STEEPEST / max(before, after)
    if law(most) <= ratio:
        return most
    return brentq(lambda k: np.log(law(k) / ratio), 1e-12, most)  # pyright: ignore[reportReturnType]
