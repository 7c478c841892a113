"""What a fit leaves over: how large its residuals are, and how far they move together.

Size. A linear signal X (DN) scatters with the variance

    floor + shot X + (relative X)^2

in which floor and shot are the sensor's, and `relative` is what the model misses: the pixels' own
gains (PRNU), or a surface that is not the model's.

Company. Errors of a model are shared: by the pixels of one image (a light whose intensity is off),
by one pixel under all lights (its gain, a stain). Then N pixels do not count as N. The gradient of
the log likelihood, summed within such clusters, has a covariance J that exceeds the information I;
I^-1 J I^-1 is the sandwich covariance (Liang & Zeger, Biometrika 73, 1986; two ways of clustering
at once: Cameron, Gelbach & Miller, J. Bus. Econ. Stat. 29, 2011), and trace(I^-1 J) / P the design
effect, the factor by which fewer observations would say as much.
"""

from dataclasses import dataclass

import numpy as np
import scipy.optimize
from jaxtyping import Float, Int
from scipy.linalg import solve_triangular
from scipy.stats import chi2

QUANTISATION = 1 / 12  # DN^2: rounding to integers
BINS = 64
EXCESS = 3.0  # standard deviations by which chi-square must exceed its expectation
CHANCE = 0.01  # probability of calling independent residuals clustered
FEWEST_FREE = 3  # clusters beyond the parameters: Student's t has a variance from there


@dataclass(frozen=True)
class Spread:
    """Variance of the linear signal. floor: DN^2; shot: DN (the system gain, DN per electron);
    relative: fraction of the signal, None where the data do not ask for it."""

    floor: float
    shot: float
    relative: float | None


def variance(
    spread: Spread,
    signal: Float[np.ndarray, " samples"],
    *,
    slope: Float[np.ndarray, " samples"] | float = 1.0,
) -> Float[np.ndarray, " samples"]:
    """Variance of the stored digital number (DN^2), rounding included; `slope`: d DN / d X."""
    linear = spread.floor + spread.shot * np.maximum(signal, 0)
    if spread.relative is not None:
        linear = linear + (spread.relative * signal) ** 2
    return slope**2 * linear + QUANTISATION


def sensor_spread(gain: float, read_noise: float) -> Spread:
    """The spread of a known sensor: gain in DN per electron, read noise in electrons."""
    return Spread((gain * read_noise) ** 2, gain, None)


def chi_square_per_dof(
    residual: np.ndarray, signal: np.ndarray, slope: np.ndarray | float, spread: Spread, dof: int
) -> float:
    """Mean squared residual (DN) in units of its variance, `dof` being what is counted."""
    return float(np.sum(residual**2 / variance(spread, signal, slope=slope)) / dof)


def fit_spread(
    residual: Float[np.ndarray, " samples"],
    signal: Float[np.ndarray, " samples"],
    slope: Float[np.ndarray, " samples"],
    *,
    sensor: Spread | None,
) -> Spread:
    """The spread that makes residuals (DN) likeliest, from their mean squares in bins of signal.

    With a known `sensor` only the relative term is fitted, and only where chi-square exceeds what
    the sensor explains by three standard deviations; without one, a constant and a relative term
    are.
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


@dataclass(frozen=True)
class Robustness:
    """covariance: sandwich where clustering shows, else the inverse information. by_light,
    by_pixel: design effects as measured, NaN with fewer than three clusters more than parameters.
    design_effect: of the covariance, 1 where both are within chance."""

    covariance: Float[np.ndarray, "parameters parameters"]
    by_light: float
    by_pixel: float
    design_effect: float


def cluster_robust(
    scores: Float[np.ndarray, "parameters samples"],
    information: Float[np.ndarray, "parameters parameters"],
    light: Int[np.ndarray, " samples"],
    pixel: Int[np.ndarray, " samples"],
) -> Robustness:
    """Covariance that allows for residuals shared within lights and within pixels.

    A kind of clustering enters only where its design effect exceeds what independent residuals
    give in 99 of 100 cases, and never narrows an error. P fitted parameters take their part of what
    the clusters show, so J counts clusters - P of them; with few, J is itself uncertain, and the
    covariance is widened to the variance of Student's t.
    """
    count = len(information)
    root = np.linalg.cholesky(information)
    whitened = solve_triangular(root, scores, lower=True)
    extra = np.zeros((count, count))
    effects = []
    for cluster in (light, pixel):
        sums = _cluster_sums(whitened, cluster)
        clusters = sums.shape[1]
        freedom = clusters - count
        if freedom < FEWEST_FREE:
            effects.append(np.nan)
            continue
        covariance = sums @ sums.T * clusters / freedom
        effect = np.trace(covariance) / count
        effects.append(float(effect))
        if effect > chi2.ppf(1 - CHANCE, count * freedom) / (count * freedom):
            extra += covariance * freedom / (freedom - 2) - np.eye(count)
    eigenvalues, directions = np.linalg.eigh(np.eye(count) + extra)
    eigenvalues = np.maximum(eigenvalues, 1.0)
    half = solve_triangular(root.T, directions, lower=False) * np.sqrt(eigenvalues)
    return Robustness(half @ half.T, effects[0], effects[1], float(np.mean(eigenvalues)))


def _cluster_sums(scores: np.ndarray, cluster: np.ndarray) -> np.ndarray:
    """Scores summed within each cluster that occurs: (parameters, clusters)."""
    sums = np.stack([np.bincount(cluster, row) for row in scores])
    return sums[:, np.bincount(cluster) > 0]
