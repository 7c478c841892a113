"""Compare cameras: unusual ones, the scatter between them, and drifts with date or temperature.

Sources:
    DerSimonian and Laird, "Meta-analysis in clinical trials", Controlled Clinical Trials 7 (1986):
        the scatter among cameras beyond their own errors.
    Rousseeuw and Croux, "Alternatives to the median absolute deviation", JASA 88 (1993).
"""

import datetime
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float
from scipy.stats import chi2, linregress, norm

FEWEST = 5  # cameras, for a median and a scatter
CHANCE = 0.05  # probability that any camera is called an outlier although none is
MAD = 1.4826  # standard deviation over median absolute deviation of a Gaussian
DRIFT = 0.01  # probability of reporting a drift in any quantity although there is none
YEAR = 365.25  # days


@dataclass(frozen=True)
class Compared:
    """The comparison of one quantity of one channel between all cameras that have it.

    Attributes:
        quantity: name of the quantity.
        channel: "" for none.
        unit: unit of the values.
        median: median over the cameras.
        scatter: standard deviation between the cameras beyond their errors, without the outliers;
            NaN if undetermined.
        differ: whether chance alone would give so large a scatter in fewer than one of 1000 such
            studies.
        outliers: names of the cameras that differ from the others, the furthest first.
        values: values of the outliers, in the unit.
    """

    quantity: str
    channel: str
    unit: str
    median: float
    scatter: float
    differ: bool
    outliers: tuple[str, ...]
    values: tuple[float, ...] = ()


@dataclass(frozen=True)
class Drift:
    """The significant change of a quantity with date or temperature, as a line through the values
    of all cameras.

    Attributes:
        quantity: name of the quantity.
        channel: "" for none.
        unit: of the slope, such as "DN a year".
        slope: slope of the line, in that unit.
        standard_error: standard error of the slope.
    """

    quantity: str
    channel: str
    unit: str
    slope: float
    standard_error: float


def compared(found: xr.Dataset) -> tuple[Compared, ...]:
    """Compare every quantity of each camera with those of the other cameras."""
    result = []
    for quantity, channel, unit, cameras, x, errors in _quantities(found):
        median = float(np.median(x))
        unlike = _unlike(x, errors)
        known = np.isfinite(errors) & (errors > 0) & ~unlike
        scatter, differ = np.nan, False
        if np.count_nonzero(known) > 1:
            scatter, differ = _scatter(x[known], errors[known])
        furthest = sorted(np.flatnonzero(unlike), key=lambda i: -abs(x[i] - median))
        outliers = tuple(str(cameras[i]) for i in furthest)
        values = tuple(float(x[i]) for i in furthest)
        result.append(Compared(quantity, channel, unit, median, scatter, differ, outliers, values))
    return tuple(result)


def drifts(found: xr.Dataset) -> tuple[Drift, ...]:
    """Return the quantities that change significantly with date or temperature."""
    dates = [str(date) for date in found["date"].values]
    days = [datetime.date.fromisoformat(d).toordinal() / YEAR if d else np.nan for d in dates]
    axes = {"year": np.array(days), "K": found["temperature"].values}
    result = []
    every = list(_quantities(found))
    for word, place in axes.items():
        for quantity, channel, unit, cameras, x, _ in every:
            at = place[np.isin(found["camera"].values, cameras)]
            line = _line(at, x, DRIFT / len(every))
            if line is not None:
                result.append(Drift(quantity, channel, f"{unit} / {word}", *line))
    return tuple(result)


Column = tuple[str, str, str, np.ndarray, np.ndarray, np.ndarray]


def _quantities(found: xr.Dataset) -> Iterator[Column]:
    """Yield name, channel, unit, cameras, values and standard errors of each quantity that at least
    two cameras have.
    """
    cameras = found["camera"].values
    for i, quantity in enumerate(found["quantity"].values):
        for j, channel in enumerate(found["channel"].values):
            x, errors = (found[n].values[:, j, i] for n in ("value", "standard_error"))
            there = np.isfinite(x)
            if np.count_nonzero(there) > 1:
                unit = str(found["unit"].values[i])
                yield str(quantity), str(channel), unit, cameras[there], x[there], errors[there]


def _scatter(
    x: Float[np.ndarray, " cameras"], errors: Float[np.ndarray, " cameras"]
) -> tuple[float, bool]:
    """Return the standard deviation between cameras beyond their errors, and whether it is
    significant.
    """
    weights = errors**-2
    mean = np.sum(weights * x) / np.sum(weights)
    excess, freedom = float(np.sum(weights * (x - mean) ** 2)), len(x) - 1
    scale = np.sum(weights) - np.sum(weights**2) / np.sum(weights)
    variance = max((excess - freedom) / scale, 0.0)
    return float(np.sqrt(variance)), bool(chi2.sf(excess, freedom) < 1e-3)


def _unlike(x: Float[np.ndarray, " cameras"], errors: Float[np.ndarray, " cameras"]) -> np.ndarray:
    """Return which cameras differ from the median by more than their own error and the scatter of
    most cameras explain.
    """
    if len(x) < FEWEST:
        return np.zeros(len(x), bool)
    away = x - np.median(x)
    own = np.where(np.isfinite(errors), errors, 0.0)
    spread = np.hypot(own, MAD * np.median(np.abs(away)))
    return np.abs(away) > norm.isf(CHANCE / (2 * len(x))) * spread


def _line(at: np.ndarray, x: np.ndarray, chance: float) -> tuple[float, float] | None:
    """Return the slope of a line and its standard error from the scatter about the line; None if
    the slope is not significant.
    """
    there = np.isfinite(at)
    at, x = at[there], x[there]
    if len(x) < FEWEST or np.ptp(at) == 0:
        return None
    line: Any = linregress(at, x)
    return (float(line.slope), float(line.stderr)) if line.pvalue < chance else None
