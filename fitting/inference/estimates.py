"""Estimates: named numbers with units, standard errors and intervals."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

QUANTILES = (0.025, 0.16, 0.5, 0.84, 0.975)  # ends of the 95 and 68 % intervals and the middle


@dataclass(frozen=True)
class Estimate:
    """One number with its uncertainty; `value` is None where the input cannot determine it and
    `reason` then says why. `group` separates equal names (a colour channel, say), `method` the
    ways of estimating one quantity."""

    name: str
    symbol: str
    unit: str
    value: float | None
    standard_error: float | None = None
    interval_68: tuple[float, float] | None = None
    interval_95: tuple[float, float] | None = None
    method: str = ""
    group: str = ""
    reason: str = ""


def gaussian_estimate(
    name: str,
    symbol: str,
    unit: str,
    value: float,
    standard_error: float,
    *,
    method: str = "",
    group: str = "",
    log_scale: bool = False,
) -> Estimate:
    """Estimate with symmetric Gaussian intervals; with `log_scale` they are symmetric in the log
    (for positive quantities), `standard_error` staying that of the value itself."""
    low95, low68, high68, high95 = (
        _shifted(value, float(norm.ppf(q)) * standard_error, log_scale)
        for q in QUANTILES
        if q != 0.5
    )
    return Estimate(
        name,
        symbol,
        unit,
        float(value),
        float(standard_error),
        (low68, high68),
        (low95, high95),
        method,
        group,
    )


def _shifted(value: float, step: float, log_scale: bool) -> float:
    return float(value * np.exp(step / value)) if log_scale and value > 0 else float(value + step)


def sampled_estimate(
    name: str,
    symbol: str,
    unit: str,
    samples: np.ndarray,
    *,
    method: str = "",
    group: str = "",
) -> Estimate:
    """Median, standard deviation and equal-tailed quantile intervals of draws (n,)."""
    low95, low68, middle, high68, high95 = (float(q) for q in np.quantile(samples, QUANTILES))
    return Estimate(
        name,
        symbol,
        unit,
        middle,
        float(np.std(samples)),
        (low68, high68),
        (low95, high95),
        method,
        group,
    )


def not_determined(
    name: str, symbol: str, unit: str, reason: str, *, method: str = "", group: str = ""
) -> Estimate:
    """The estimate of something this input cannot give."""
    return Estimate(name, symbol, unit, None, method=method, group=group, reason=reason)


def find(
    estimates: Sequence[Estimate], name: str, *, method: str = "", group: str = ""
) -> Estimate:
    """The first estimate of that name (and method and group, where given); `KeyError` if none."""
    for estimate in estimates:
        if (
            estimate.name == name
            and (not method or estimate.method == method)
            and (not group or estimate.group == group)
        ):
            return estimate
    raise KeyError(f"no estimate {name!r} with method {method!r} and group {group!r}")
