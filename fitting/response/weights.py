"""Weights of the observations (a pixel's code in one exposure), and their residuals under a curve.

Weights come from a noise model, var(ln X) = relative + shot / X + read / X^2 + (width of the
interval)^2 / 12, at the PREDICTED exposure X = E_i t_j. Observations are also selected by the
predicted exposure, because weights or selections that depend on the noisy code would bias the
curve. Each class of steepness (`places.py`) has its own noise model.

Codes are DN; log exposures are relative.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from .code_bins import CodeBins, interval_variance

LOOSEST = 0.15  # log standard deviation of usable codes: second-order terms are a percent or two
WIDEST = 0.2  # log standard deviation of codes that are read; wider than that of usable codes
COARSEST = 0.015  # log standard deviation of rounding that no noise dithers and all pixels share
# Step of ln t from which coarse codes are the only ones paired with fine codes
LARGEST_LOG_STEP = 1.4
HAT_DEVIATION = 0.1  # log standard deviation at mid-scale before a noise model is known
HAT_BRIM = 0.08  # height of the hat below which codes are not used, because their noise is unknown
OUTLIER = 5.0  # standard deviations of a residual from which its pixel is left out
HARMONICS = 16  # terms of the series for rounding
MARGIN = 3.0  # standard deviations between a predicted exposure and unobserved codes


@dataclass(frozen=True)
class NoiseModel:
    """The variance of ln X at the relative exposure X: relative + shot / X + read / X^2."""

    # variance by errors in proportion to the light, such as unequal gains of the pixels
    relative: float
    shot: float  # variance by shot noise at mid-scale (X = 1)
    read: float  # variance by read noise at mid-scale (X = 1)


def noise_variance(
    noise: NoiseModel, log_exposure: Float[np.ndarray, " points"]
) -> Float[np.ndarray, " points"]:
    """Return the variance of a pixel's log exposure due to noise."""
    inverse = np.exp(-log_exposure)
    return noise.relative + noise.shot * inverse + noise.read * inverse**2


@dataclass(frozen=True)
class WeightRule:
    """Tables of weights over a uniform grid of log exposure. Each table has one row for each class
    of steepness, and an empty cell at either end."""

    by_bin: Float[np.ndarray, "classes bins"]  # initial weight by observed code
    start: float = 0.0  # log exposure of the first cell
    step: float = 1.0  # log exposure between cells
    # 1 / variance; None where `by_bin` is the only weight
    precision: Float[np.ndarray, "classes cells"] | None = None
    # fraction of the precision that is used as weight
    weight: Float[np.ndarray, "classes cells"] | None = None
    # share of the variance that is independent between exposures: noise, and rounding where noise
    # dithers it
    share: Float[np.ndarray, "classes cells"] | None = None
    # expected weight times residual at the true curve
    bias: Float[np.ndarray, "classes cells"] | None = None


@dataclass(frozen=True)
class Observations:
    """The weights and residuals of the linked pixels, which are those with at least two positive
    weights."""

    binned: Int[np.ndarray, "exposures pixels"]  # indices of bins
    classes: Int[np.ndarray, " pixels"]  # class of each pixel
    weights: Float[np.ndarray, "exposures pixels"]  # weights of the observations
    cells: Int[np.ndarray, "exposures pixels"]  # flattened indices of cells of the rule's tables
    residuals: Float[np.ndarray, "exposures pixels"]  # residuals in ln X
    total: Float[np.ndarray, " pixels"]  # sum of weights
    log_irradiance: Float[np.ndarray, " pixels"]  # estimated log irradiance of each pixel


def hat_rule(bins: CodeBins, *, classes: int = 1) -> WeightRule:
    """Make weights by the observed code: the squared hat function of Debevec & Malik."""
    height = np.minimum(bins.centres - bins.black, bins.edges[-1] - bins.centres)
    hat = height / height.max()
    by_bin = np.where(hat > HAT_BRIM, (hat / HAT_DEVIATION) ** 2, 0)
    return WeightRule(np.tile(by_bin, (classes, 1)))


def noise_rule(
    noises: Sequence[NoiseModel | None],
    means: Float[np.ndarray, " bins"],
    *,
    coarsest: float = np.inf,
) -> WeightRule:
    """Make weights by predicted exposure, from a curve and each class's noise model."""
    grid = np.linspace(means[0], means[-1], 4 * len(means))
    absent = np.zeros(len(means)), *(np.zeros(len(grid) + 2) for _ in range(4))
    rows = [absent if n is None else _class_tables(n, means, grid, coarsest) for n in noises]
    by_bin, *tables = (np.stack(column) for column in zip(*rows, strict=True))
    return WeightRule(by_bin, grid[0], grid[1] - grid[0], *tables)


def coarsest(log_t: Float[np.ndarray, " exposures"]) -> float:
    """Return the largest rms rounding error, in ln X, of used codes that no noise dithers."""
    # The rounding error of a code is the same in all pixels. It adds a ripple to the curve, with
    # the period of the exposures, which the exposures do not contradict. Linear 8-bit cameras with
    # little noise had half of their codes outside the band. Exposures far apart need all codes.
    return COARSEST if np.diff(np.sort(log_t)).max() < LARGEST_LOG_STEP else np.inf


def _class_tables(
    noise: NoiseModel, means: np.ndarray, grid: np.ndarray, coarsest: float
) -> tuple[np.ndarray, ...]:
    interval = np.interp(grid, means, interval_variance(means))
    variance = np.minimum(noise_variance(noise, grid) + interval, 1e6)  # it grows as X^-2
    reach = MARGIN * np.sqrt(variance)
    independent = noise_variance(noise, grid)
    rounded = interval * undithered_share(independent / (12 * interval))
    fine = rounded < coarsest**2
    looked_at = variance < WIDEST**2
    sharp = (variance - noise.relative < LOOSEST**2) & looked_at
    sharp &= fine if fine.any() else True
    clear = grid + reach <= grid[-1]
    inside = sharp & clear & (grid - reach >= grid[np.argmax(looked_at)])
    if np.isfinite(coarsest) and inside.any():
        # A limit inside a code would admit only light from one side of that code.
        edges = (means[:-1] + means[1:]) / 2
        inside &= grid >= edges[np.searchsorted(edges[:-1], grid[np.argmax(inside)])]
    share = 1 - rounded / variance
    bias = interval * np.gradient(variance, grid) / variance**2 - independent / variance / 2
    precision = np.pad(np.where(clear & looked_at, 1 / variance, 0), 1)
    weight, share, bias = (
        np.pad(np.where(inside, column, 0), 1) for column in (1 / variance, share, bias)
    )
    of_bins = noise_variance(noise, means) + interval_variance(means)
    return np.where(of_bins < WIDEST**2, 1 / of_bins, 0), precision, weight, share, bias


def undithered_share(
    variance: Float[np.ndarray, " points"],
) -> Float[np.ndarray, " points"]:
    """Return the covariance of the rounding error with the light, as a share of this covariance
    without noise.

    Let u be the error of rounding x + n, with light x and noise n. If n is normal with the variance
    s^2, in squared rounding intervals,

        Cov(u, x) = -sum_k exp(-2 pi^2 k^2 s^2) / (2 pi^2 k^2),

    which is -1/12 for s = 0. If s is at least half an interval, this covariance vanishes and the
    rounding error is independent of the light (Widrow and Kollar, "Quantization Noise", 2008).
    """
    squares = np.arange(1, HARMONICS + 1)[:, None] ** 2
    decay = np.exp(-2 * np.pi**2 * squares * variance) / squares
    return decay.sum(axis=0) / np.sum(1 / squares)


def observe(
    binned: Int[np.ndarray, "exposures pixels"],
    classes: Int[np.ndarray, " pixels"],
    log_t: Float[np.ndarray, " exposures"],
    means: Float[np.ndarray, " bins"],
    rule: WeightRule,
    *,
    screened: bool = True,
) -> Observations:
    """Compute weights and residuals of pixels with two positive weights, without outliers."""
    by_each, weights = means[binned] - log_t[:, None], weights_by_code(rule, binned, classes)
    cells = np.zeros_like(binned)
    if rule.weight is not None:
        for table in (rule.precision, rule.weight):
            weights, cells = predicted_weights(rule, table, weights, by_each, log_t, classes)
    linked = np.count_nonzero(weights, axis=0) >= 2
    weights, by_each = weights[:, linked], by_each[:, linked]
    log_irradiance = weighted_mean(weights, by_each)
    residuals = by_each - log_irradiance
    known = rule.weight is not None  # residuals need a curve
    steady = (weights * residuals**2 < (OUTLIER**2 if known and screened else np.inf)).all(axis=0)
    return Observations(
        binned=np.maximum(binned[:, linked][:, steady], 0),
        classes=classes[linked][steady],
        weights=weights[:, steady],
        cells=cells[:, linked][:, steady],
        residuals=residuals[:, steady],
        total=weights[:, steady].sum(axis=0),
        log_irradiance=log_irradiance[steady],
    )


def weights_by_code(
    rule: WeightRule,
    binned: Int[np.ndarray, "exposures pixels"],
    classes: Int[np.ndarray, " pixels"],
) -> Float[np.ndarray, "exposures pixels"]:
    """Return the initial weights, by observed code."""
    rough = rule.by_bin.ravel()[np.maximum(binned, 0) + classes * rule.by_bin.shape[1]]
    return np.where(binned >= 0, rough, 0)


def predicted_weights(
    rule: WeightRule,
    table: Float[np.ndarray, "classes cells"] | None,
    weights: Float[np.ndarray, "exposures pixels"],
    by_each: Float[np.ndarray, "exposures pixels"],
    log_t: Float[np.ndarray, " exposures"],
    classes: Int[np.ndarray, " pixels"],
) -> tuple[Float[np.ndarray, "exposures pixels"], Int[np.ndarray, "exposures pixels"]]:
    """Return weights at the exposures that a pixel's mean predicts, and their cells."""
    assert table is not None
    cells = cells_of(rule, weighted_mean(weights, by_each) + log_t[:, None], classes)
    return np.where(weights > 0, table.ravel()[cells], 0), cells


def cells_of(
    rule: WeightRule,
    log_exposure: Float[np.ndarray, "*exposures pixels"],
    classes: Int[np.ndarray, " pixels"],
) -> Int[np.ndarray, "*exposures pixels"]:
    """Return the flat indices of a rule's cells that contain these log exposures."""
    assert rule.weight is not None
    count = rule.weight.shape[1]
    position = (log_exposure - rule.start) / rule.step + 1.5
    return np.clip(position, 0, count - 1).astype(np.int32) + classes * count


def weighted_mean(
    weights: Float[np.ndarray, "exposures pixels"], values: Float[np.ndarray, "exposures pixels"]
) -> Float[np.ndarray, " pixels"]:
    """Return the weighted mean over exposures for each pixel."""
    total = weights.sum(axis=0)
    return (weights * values).sum(axis=0) / np.where(total > 0, total, 1)
