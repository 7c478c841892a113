"""Fit the order of convergence of an approximation: the slope of a straight line through the
logarithms of its errors."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from .records import Knob, Law, Order, Trial

LEAST_SPREAD = 0.01  # relative: the smallest uncertainty that is assumed for an error
SHALLOWEST = 0.7  # share of the declared order that a fit must reach to confirm it


def variable(setting: float, law: Law) -> float:
    """Return x in which log(error) is linear: log(setting), or the setting itself."""
    return float(setting) if law == "geometric" else float(np.log(setting))


def fit_order(knob: Knob, trials: Sequence[Trial]) -> Order | None:
    """Fit the law by which errors depend on the setting. Errors with a smaller scatter over seeds
    have larger weights. If the knob declares a geometric law but a power law fits better, return
    the power law. Return None if fewer than two settings have usable errors, or if settings are not
    numbers."""
    solid = [one for one in trials if not one.hollow and one.error > 0 and is_number(one.setting)]
    if len({one.setting for one in solid}) < 2:
        return None
    order, left = _line(knob, solid, knob.law)
    if knob.law == "geometric" and len(solid) > 2:
        power, left_by_power = _line(knob, solid, "power")
        order = power if left_by_power < left else order
    return order


def _line(knob: Knob, solid: Sequence[Trial], law: Law) -> tuple[Order, float]:
    """Fit log(error) by a line in the law's variable; return order and weighted squares."""
    from scipy.special import stdtrit

    x = np.array([variable(one.setting, law) for one in solid])
    y = np.log([one.error for one in solid])
    known = np.array([_interval_of_order(knob, one) for one in solid])
    weights = 1 / known**2
    centre = np.average(x, weights=weights)
    spread = float(np.sum(weights * (x - centre) ** 2))
    slope = float(np.sum(weights * (x - centre) * y) / spread)
    left = y - np.average(y, weights=weights) - slope * (x - centre)
    free = len(solid) - 2
    squares = float(np.sum(weights * left**2))
    if free == 0:
        return Order(slope, -np.inf, np.inf, law, len(solid)), squares
    # no more precise than the scatter over seeds, even if a few points fit a line well
    scatter = max(squares / free, 1.0)
    half = float(stdtrit(free, 0.975)) * float(np.sqrt(scatter / spread))
    return Order(slope, slope - half, slope + half, law, len(solid)), squares


def _interval_of_order(knob: Knob, trial: Trial) -> float:
    """Return the standard error of the logarithm of a trial's error."""
    if not np.isfinite(trial.error_high) or trial.error_high <= trial.error:
        return LEAST_SPREAD
    wide = float(np.log(trial.error_high / trial.error)) / 1.96
    return max(wide / float(np.sqrt(trial.seeds)) if knob.random else wide, LEAST_SPREAD)


def is_number(setting: Any) -> bool:
    """Return whether a setting is a positive number."""
    return isinstance(setting, int | float) and not isinstance(setting, bool) and setting > 0


def order_holds(knob: Knob, order: Order | None) -> bool:
    """Return whether the measured errors confirm the order that the knob declares. The interval of
    the fitted order must include the declared order or steeper orders, and the fitted order must be
    at least 0.7 times the declared order."""
    if order is None or knob.order is None or order.points < 3:
        return False
    return order.low <= knob.order and order.exponent <= SHALLOWEST * knob.order
