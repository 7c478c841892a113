"""The variance of pixels about a fit: the sensor's noise and the misfit of the model.

A linear signal X (DN) has the variance

    floor + shot X + (relative X)^2

floor and shot are those of the sensor. `relative` is the misfit of the model: the pixels' own gains
(PRNU), or a surface that differs from the model.

A misfit is not noise. Weights that decrease with it would reduce the weight of the highlights that
the model misses, although they dominate the errors of its pictures. A fit therefore treats a misfit
as a constant,

    floor + shot X + misfit^2,

which is plain least squares if the misfit dominates, and efficient if there is none.
"""

from dataclasses import dataclass

import numpy as np
import scipy.optimize
from jaxtyping import Float

from jaxvision.sensor import QUANTISATION_VARIANCE

BINS = 64
EXCESS = 3.0  # standard deviations by which chi-square must exceed its expectation


@dataclass(frozen=True)
class Spread:
    """Variance of the linear signal X: floor + shot X + (relative X)^2."""

    floor: float  # DN^2
    shot: float  # DN; the system gain, DN per electron
    relative: float | None  # fraction of the signal; None where it is not significant


def variance(
    spread: Spread,
    signal: Float[np.ndarray, " samples"],
    *,
    slope: Float[np.ndarray, " samples"] | float = 1.0,
) -> Float[np.ndarray, " samples"]:
    """Variance of the stored number in DN^2, including rounding, at a signal X in DN and a slope d
    DN / d X."""
    linear = spread.floor + spread.shot * np.maximum(signal, 0)
    if spread.relative is not None:
        linear = linear + (spread.relative * signal) ** 2
    return slope**2 * linear + QUANTISATION_VARIANCE


def sensor_spread(gain: float, read_noise: float) -> Spread:
    """Spread of a sensor with a gain in DN/e- and a read noise in e-."""
    return Spread((gain * read_noise) ** 2, gain, None)


def chi_square_per_dof(
    residual: np.ndarray, signal: np.ndarray, slope: np.ndarray | float, spread: Spread, dof: int
) -> float:
    """Sum of squared residuals (DN) in units of their variance, per degree of freedom."""
    return float(np.sum(residual**2 / variance(spread, signal, slope=slope)) / dof)


def fit_spread(
    residual: Float[np.ndarray, " samples"],
    signal: Float[np.ndarray, " samples"],
    slope: Float[np.ndarray, " samples"],
    *,
    sensor: Spread | None,
) -> Spread:
    """Return the most likely spread of residuals (DN), from their mean squares in bins of signal
    (DN).

    With a known sensor, only the relative term is fitted, and only if chi-square exceeds its
    expectation by three standard deviations. Without one, a constant and a relative term are
    fitted.
    """
    counts, squares, x, d = _binned(residual, signal, slope)
    total = counts.sum()
    if sensor is not None:
        excess = np.sum(counts * squares / variance(sensor, x, slope=d)) / total - 1
        if excess < EXCESS * np.sqrt(2 / total):
            return sensor

    def spread_of(logs: np.ndarray) -> Spread:
        if sensor is not None:
            return Spread(sensor.floor, sensor.shot, float(np.exp(logs[0])))
        return Spread(float(np.exp(2 * logs[1])), 0.0, float(np.exp(logs[0])))

    def deviance(logs: np.ndarray) -> float:
        v = variance(spread_of(logs), x, slope=d)
        return float(np.sum(counts * (np.log(v) + squares / v)) / total)

    typical = np.log(np.sqrt(np.average(squares / d**2, weights=counts)))
    brightest = np.log(np.maximum(x.max(), 1.0))
    start = [typical - brightest, typical - 1]
    bounds = [(typical - brightest - 12, 2.0), (typical - 12, typical + 2)]
    count = 2 if sensor is None else 1
    found = scipy.optimize.minimize(deviance, start[:count], bounds=bounds[:count])
    return spread_of(found.x)


def flat_spread(
    residual: Float[np.ndarray, " samples"],
    signal: Float[np.ndarray, " samples"],
    slope: Float[np.ndarray, " samples"],
    *,
    sensor: Spread | None,
) -> Spread:
    """Return the spread that weights a fit: the sensor's plus the constant that makes residuals
    most likely."""
    counts, squares, x, d = _binned(residual, signal, slope)
    own = Spread(0.0, 0.0, None) if sensor is None else sensor
    typical = 2 * np.log(np.sqrt(np.average(squares / d**2, weights=counts)))

    def with_misfit(log_square: float) -> Spread:
        return Spread(own.floor + float(np.exp(log_square)), own.shot, None)

    def deviance(log_square: float) -> float:
        v = variance(with_misfit(log_square), x, slope=d)
        return float(np.sum(counts * (np.log(v) + squares / v)))

    bounds = (typical - 24, typical + 4)
    return with_misfit(scipy.optimize.minimize_scalar(deviance, bounds=bounds).x)


def _binned(
    residual: np.ndarray, signal: np.ndarray, slope: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Counts, mean squares, mean signals and rms slopes in bins of equally many samples."""
    order = np.argsort(signal)
    edges = np.unique(np.linspace(0, len(order), min(BINS, len(order)) + 1).astype(int))
    counts = np.diff(edges)

    def means(values: np.ndarray) -> np.ndarray:
        return np.add.reduceat(values[order], edges[:-1]) / counts

    return counts, means(residual**2), means(signal), np.sqrt(means(slope**2))
