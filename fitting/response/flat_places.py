"""Correct a response curve to the curve of flat parts of the picture.

A camera that sharpens adds to each code a fraction of its difference from the surrounding codes.
Where the picture has detail, pixels with equal light then have different codes. Unless the response
is a pure gamma, these differences bias the curve in proportion to the activity a, the local
variance of the log code. To estimate the bias, the pixels are divided into classes by activity. Let
g_(k) be the curve fitted without class k, and a_(k) the mean activity of the pixels used for that
fit. A regression of g_(k) on a_(k) gives the slope of the curve over the activity. The deviation d
of the curve of all pixels, whose mean activity is a_all, from the curve of flat parts is

    d = a_all  sum_k (a_(k) - m) g_(k) / sum_k (a_(k) - m)^2,    m the mean of the a_(k).

The covariance V of d comes from the scatter of the score over tiles of the picture. Let q be the
mean of d^2 / V over the codes. If an F test of q is significant, d is multiplied by lambda = 1 - 1
/ q and subtracted (James & Stein 1961). Because d is a bias only with probability lambda, the
covariance grows by lambda^2 V + lambda (1 - lambda) d d^T. Nothing is subtracted if the activity is
equal everywhere, or if the activity is a function of the code, as on a ramp. Misregistered images
are not corrected either, because errors from misregistration are not proportional to the activity.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.special import fdtri

from .code_bins import CodeBins
from .code_pairs import PairStatistics
from .solve import Solution, equations_of, inverse
from .weights import NoiseModel, noise_variance

FEWEST_CLASSES = 3
F_TEST_LEVEL = 0.975  # of the F test
# Ratio to the noise of the quietest places, up to which images are registered
LARGEST_NOISE_RATIO = 2.0
LEAST_RELATIVE_SPREAD = 0.5  # least spread of the activity at a code, relative to its mean


def is_registered(noises: Sequence[NoiseModel | None], rounding: float) -> bool:
    """Return whether noise of steep places is less than twice that of flat ones."""
    if any(noise is None for noise in noises):
        return False
    at = np.zeros(1)  # mid-scale
    variances = [float(noise_variance(n, at)[0]) + rounding for n in noises if n is not None]
    return max(variances) <= LARGEST_NOISE_RATIO**2 * min(variances)


def correct_to_flat_places(
    found: Solution,
    cells: Sequence[Sequence[PairStatistics]],
    activity: Float[np.ndarray, " classes"],
    log_t: Float[np.ndarray, " exposures"],
    bins: CodeBins,
) -> Solution:
    """Return the solution corrected to flat places, if that is significant."""
    size, phi = len(found.means), found.used.design_effect
    each = [[equations_of(cell, log_t, found.basis) for cell in tile] for tile in cells]
    matrices = [np.sum([cell.matrix for cell in kind], axis=0) for kind in zip(*each, strict=True)]
    rights = [np.sum([cell.right for cell in kind], axis=0) for kind in zip(*each, strict=True)]
    matrix, right = np.sum(matrices, axis=0), np.sum(rights, axis=0)
    share = np.array([np.trace(kind[:size, :size]) for kind in matrices])
    used = np.flatnonzero(share > 0)
    if len(used) < FEWEST_CLASSES or len(cells) < 2:
        return found
    weights = np.array([np.diagonal(matrices[k])[:size] for k in used])
    share, activity = share[used] / share.sum(), activity[used]
    average = share @ activity
    if not _separation(weights, activity) >= LEAST_RELATIVE_SPREAD * average > 0:
        return found
    without = (average - share * activity) / (1 - share)
    slope = without - without.mean()
    slope *= average / (slope @ slope)

    at = np.concatenate([found.means, found.free])
    pulls = np.array([[cell.right - cell.matrix @ at for cell in tile] for tile in each])
    departure, by_tile = np.zeros(size), np.zeros((len(cells), size))
    for k, factor in zip(used, slope, strict=True):
        rest = inverse((matrix - matrices[k]) / phi + found.prior, bins)[:size] / phi
        departure += factor * rest @ (right - rights[k])
        by_tile += factor * (pulls.sum(axis=1) - pulls[:, k]) @ rest.T
    by_tile = (by_tile - by_tile.mean(axis=0)) * np.sqrt(len(cells) / (len(cells) - 1))
    seen = (np.diagonal(matrix)[:size] > 0) & (np.arange(size) != bins.middle)
    return _subtract_departure(found, departure, by_tile, seen)


def _separation(weights: np.ndarray, activity: np.ndarray) -> float:
    """Return the standard deviation of activity among observations of a code, median over codes."""
    seen = weights[:, weights.sum(axis=0) > 0]
    mean = activity @ seen / seen.sum(axis=0)
    variance = activity**2 @ seen / seen.sum(axis=0) - mean**2
    return float(np.sqrt(np.median(np.maximum(variance, 0))))


def _subtract_departure(
    found: Solution, departure: np.ndarray, by_tile: np.ndarray, seen: np.ndarray
) -> Solution:
    """Subtract a significant departure, shrunk by its scatter over tiles."""
    deviation = np.sqrt(np.sum(by_tile**2, axis=0))
    if not (deviation[seen] > 0).all():
        return found
    beyond = np.mean((departure[seen] / deviation[seen]) ** 2)
    alike = by_tile[:, seen] / deviation[seen]
    freedom = np.count_nonzero(seen) ** 2 / np.sum((alike @ alike.T) ** 2)
    if not beyond >= fdtri(freedom, len(by_tile) - 1, F_TEST_LEVEL):
        return found
    weight = 1 - 1 / beyond
    covariance = found.covariance.copy()
    doubt = weight * (1 - weight) * np.outer(departure, departure)
    covariance[: len(departure), : len(departure)] += weight**2 * by_tile.T @ by_tile + doubt
    return replace(found, means=found.means - weight * departure, covariance=covariance)
