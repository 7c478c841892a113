"""What accuracy costs: error against time for any knob, and the cheapest setting that suffices.

A knob is anything that trades the two: a dtype, a number of samples, a noise sampler, a solver's
tolerance. Timing is eager and stays outside pure functions: measure, choose, then call.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from .errors import InputError


@dataclass(frozen=True)
class Trial:
    """The measurement of one setting of a knob.

    Attributes:
        setting: the setting.
        error: of its result, in the metric's unit.
        seconds: median time of a warm call, in s.
        first_seconds: time of the first call, with tracing and compilation, in s.
    """

    setting: Any
    error: float
    seconds: float
    first_seconds: float


def relative_rms(result: Any, reference: Any) -> float:
    """The root mean square error relative to that of the reference, computed in float64.

    Args:
        result: any shape and unit.
        reference: the same shape and unit.

    Returns:
        sqrt(mean (result - reference)^2 / mean reference^2), no unit.

    Example:
        >>> print(f"{jv.accuracy.relative_rms([1.0, 1.1], [1.0, 1.0]):.4f}")
        0.0707
    """
    computed, exact = np.asarray(result, np.float64), np.asarray(reference, np.float64)
    return float(np.sqrt(np.mean((computed - exact) ** 2) / np.mean(exact**2)))


def error_against_time(
    calls: Mapping[Any, Callable[[], Any]],
    reference: Any,
    *,
    metric: Callable[[Any, Any], float] = relative_rms,
    repeats: int = 5,
) -> list[Trial]:
    """Runs the call of each setting and measures its error and time.

    The warm calls of all settings take turns, so that a machine of drifting speed favours none.

    Args:
        calls: a call without arguments for each setting.
        reference: the result to be reached, from a finer setting or in closed form, in any unit.
        metric: error of a result against the reference.
        repeats: warm calls of each setting, at least 1.

    Returns:
        One trial for each setting, in the order of `calls`.

    Raises:
        InputError: for no calls or no repeats.
    """
    if not calls or repeats < 1:
        raise InputError("error_against_time needs at least one call and one repeat; give both.")
    first = {setting: _timed(call) for setting, call in calls.items()}
    warm: dict[Any, list[float]] = {setting: [] for setting in calls}
    for _ in range(repeats):
        for setting, call in calls.items():
            warm[setting].append(_timed(call)[0])
    return [
        Trial(setting, metric(result, reference), float(np.median(warm[setting])), seconds)
        for setting, (seconds, result) in first.items()
    ]


def cheapest(trials: list[Trial], *, tolerance: float) -> Trial:
    """The fastest trial whose error is at most the tolerance.

    Args:
        trials: from `error_against_time`.
        tolerance: largest error, in the unit of the metric.

    Returns:
        The trial.

    Raises:
        InputError: if there is none; the message names the smallest error reached.
    """
    enough = [trial for trial in trials if trial.error <= tolerance]
    if not enough:
        best = min(trials, key=lambda trial: trial.error)
        raise InputError(
            f"No setting reaches {tolerance:g}; the most accurate, {best.setting}, has an error of "
            f"{best.error:.3g}: refine the knob or allow more."
        )
    return min(enough, key=lambda trial: trial.seconds)


def _timed(call: Callable[[], Any]) -> tuple[float, Any]:
    start = time.perf_counter()
    result = jax.block_until_ready(call())
    return time.perf_counter() - start, result
