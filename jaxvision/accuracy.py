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
    """One setting of a knob. `error`: as the metric measures it. `seconds`: median of a warm call.
    `first_seconds`: the first call, tracing and compilation included."""

    setting: Any
    error: float
    seconds: float
    first_seconds: float


def relative_rms(result: Any, reference: Any) -> float:
    """Root mean square of result - reference over that of the reference, in float64; no unit."""
    computed, exact = np.asarray(result, np.float64), np.asarray(reference, np.float64)
    return float(np.sqrt(np.mean((computed - exact) ** 2) / np.mean(exact**2)))


def error_against_time(
    calls: Mapping[Any, Callable[[], Any]],
    reference: Any,
    *,
    metric: Callable[[Any, Any], float] = relative_rms,
    repeats: int = 5,
) -> list[Trial]:
    """Runs each setting's call and measures it: the trials in the order of `calls`.

    The warm calls are interleaved, so that a machine whose speed drifts favours none. `reference`
    is the result to be reached, from a finer setting or in closed form.
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
    """The fastest trial whose error is at most `tolerance`; `InputError` naming the best error
    reached when there is none."""
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
