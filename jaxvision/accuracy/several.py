"""Several settings at once: the cheapest combination within a tolerance, or the most accurate one
within a time.

Times multiply: a change of one setting changes the time by the same factor as alone. Errors of
random settings add in quadrature, and biases add linearly: (sum of biases)^2 + sum of squares.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from ..errors import InputError
from .choice import candidates
from .records import Curve


@dataclass(frozen=True)
class Combination:
    """Settings of several knobs, and their expected error and time.

    Attributes:
        settings: by name of the knob.
        error: relative, upper limit for any seed.
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
    """Choose the best combination of settings from their Pareto fronts. A deterministic setting
    with unknown error keeps its value.

    Args:
        curves: of one problem, one for each knob; each was measured with the others at `base`.
        base: settings of the other knobs during each measurement.
        tolerance: relative, upper limit of the error for any seed.
        seconds: time of a warm call, s.

    Returns:
        The combination.

    Raises:
        InputError: unless exactly one of the two is given, where no combination meets it, and where
            no error is known at all or none of a random knob.
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
    best: tuple[float, Combination] | None = None
    nearest = np.inf
    for chosen in product(*sets):
        random = sum(
            error**2 for (_, error, _), c in zip(chosen, curves, strict=True) if c.knob.random
        )
        bias = sum(
            error for (_, error, _), c in zip(chosen, curves, strict=True) if not c.knob.random
        )
        error = float(np.sqrt(bias**2 + random))
        taken = once * float(np.prod([factor for *_, factor in chosen]))
        price, limited = (error, taken) if tolerance is None else (taken, error)
        nearest = min(nearest, limited)
        if limited <= limit and (best is None or price < best[0]):
            names = [curve.knob.name for curve in curves]
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
    """Return the time, s, at the base value of a setting."""
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
    """Return the settings without an error. Raises `InputError` if one of them is random, or if all
    lack an error."""
    found = [c.knob for c, front in zip(curves, fronts, strict=True) if not front]
    lost = next((k for k in found if k.random or len(found) == len(curves)), None)
    if lost is not None:
        raise InputError(f"no error of knob {lost.name!r} is known; allow more time to measure.")
    return tuple(knob.name for knob in found)


def _pareto(curve: Curve, once: float) -> Front:
    """(setting, bound of the error, factor of time), without dominated ones."""
    found: Front = []
    for trial in sorted(candidates(curve), key=lambda trial: (trial.seconds, trial.error_high)):
        error = trial.error_high
        if np.isfinite(error) and (not found or error < found[-1][1]):
            found.append((trial.setting, error, trial.seconds / max(once, 1e-12)))
    return found
