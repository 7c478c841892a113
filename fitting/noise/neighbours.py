"""Covariances of neighbouring pixels, which determine the brighter-fatter effect and linear mixing.

For L frames at one level of light, let d_p be the deviation of pixel p from its mean over the
frames. The covariance of pixels that are i rows and j columns apart is

    C_ij = sum over the frames of d_p d_(p + (i, j)) / (L - 1), averaged over p and over (i, j) and
    (i, -j),

minus the variance of the frames' means. For independent pixels of variance s^2, the expectation of
C_ij is 0, and its standard error is s^2 / sqrt((L - 1) pairs), where `pairs` is the number of
averaged pairs of pixels. At a signal of x DN, the brighter-fatter effect (Antilogus 2014, Astier
2019) contributes a_ij x^2 to C_ij to first order, with the area change a_ij per electron. Linear
mixing after charge collection contributes a term proportional to x. Covariances that darks have
too, such as those from row noise, are subtracted. In frames of h rows and w columns, row noise of
variance r^2 adds r^2 (r^2 + 2 s^2 / w) / (h (L - 1)) to the sampling variance of C_ij, and twice as
much for pixels of the same row (i = 0).
"""

from math import factorial

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .levels import Levels, PhotonTransfer, shot_of, signal_of
from .live_pixels import LARGEST_LAG
from .shared import temporal_lines

PERIOD = 32  # period, in pixels, of the sensor for which the series is computed
TERMS = 20  # the next term is below 1e-10 up to a_00 mu = -1

# Standard errors of a significant covariance: 1 in 1,000 cameras without one
SIGNIFICANCE_SIGMAS = 3.6

Lags = Float[np.ndarray, "lags lags"]


class NeighbourData(eqx.Module):
    """The covariances of neighbouring pixels, in the form in which they enter the likelihood."""

    variance_terms: Float[Array, " terms"]  # C_00 / mu in powers of a_00 mu, the highest first
    # sum of all covariances with other pixels less that of the darks, DN^2; 0 for the darks; None
    # where unknown
    total: Float[Array, " levels"] | None = None
    # sampling variance of `total`, over the square of the sum of variance and `total`
    spread: Float[Array, " levels"] | None = None


def are_known(around: NeighbourData | None) -> bool:
    """Return whether covariances of neighbouring pixels are among the data of a fit."""
    return around is not None and around.total is not None


# The number of offsets of either sign for each size; 0 at the pixel itself.
COPIES: Lags = np.outer(*2 * [np.where(np.arange(LARGEST_LAG + 1) == 0, 1.0, 2.0)])
COPIES[0, 0] = 0


def above_dark(measurement: PhotonTransfer) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return three arrays: the covariances of bright levels minus those of the darks, the sampling
    variances of these differences, and the sampling variances of their sums over all neighbours.
    Return None if there are no frames of adjacent pixels. Also return None if the light flickers,
    because flicker causes larger covariances of neighbouring pixels than the repulsion of
    charges."""
    bright, dark = measurement.bright, measurement.dark
    if bright.covariances is None or dark.covariances is None or bright.flicker is not None:
        return None
    assert bright.shared is not None
    shape = np.asarray(bright.shared.shape)
    reach = np.arange(LARGEST_LAG + 1)
    # The number of pairs in each averaged covariance.
    along = [size - reach for size in shape]
    both = np.where(np.outer(reach, reach), 2, 1)
    size = np.outer(*along) * both * (float(bright.pixels) / np.prod(shape)) ** 2
    lines = [temporal_lines(dark, axis) for axis in (0, 1)]

    def chance(levels: Levels) -> tuple[np.ndarray, np.ndarray]:
        freedom = np.asarray(levels.frames) - 1
        covariances, own = np.asarray(levels.covariances), np.asarray(levels.variance)
        widest = np.maximum(own, own + np.sum(covariances * COPIES, axis=(1, 2)))
        each = (widest**2 / freedom)[:, None, None] / size
        total = np.sum(each * COPIES**2, axis=(1, 2))
        for axis, line in enumerate(lines):
            if not line.is_significant:
                continue
            # Offsets by the same number of rows share the products of row noise; at 0 rows these
            # are squares.
            product = line.variance * (line.variance + 2 * own / shape[1 - axis])
            product = product / shape[axis] / freedom
            twice = np.expand_dims(np.where(reach, 1.0, 2.0), 1 - axis)
            each = each + product[:, None, None] * twice
            total = total + product * (
                2 * (2 * LARGEST_LAG) ** 2 + LARGEST_LAG * (4 * LARGEST_LAG + 2) ** 2
            )
        return each, total

    varying = np.asarray(dark.variance) > 0  # identical frames contain no information
    unlit, unlit_total = (1 / one[varying] for one in chance(dark))
    common = np.sum(unlit * np.asarray(dark.covariances)[varying], axis=0) / unlit.sum(axis=0)
    each, total = chance(bright)
    above = np.asarray(bright.covariances) - common
    return above, each + 1 / unlit.sum(axis=0), total + 1 / unlit_total.sum()


def are_significant(measurement: PhotonTransfer, usable: np.ndarray) -> bool:
    """Return whether nearest neighbours covary significantly along rows, along columns or along
    both, in proportion to the shot variance (mixing) or to its square (repulsion). This test is
    more sensitive than a test of the sum of covariances over all neighbours, which is the datum of
    a fit.
    """
    above = above_dark(measurement)
    if above is None:
        return False
    found, variances, _ = above
    shot = shot_of(measurement)[usable]
    shapes = np.array([shot, shot**2])[:, None]
    along, errors = (np.array([x[usable, 0, 1], x[usable, 1, 0]]) for x in (found, variances))
    sums = np.sum(shapes * along / errors, axis=-1)
    information = np.sum(shapes**2 / errors, axis=-1)
    both = np.sum(sums, axis=1) / np.sqrt(np.sum(information, axis=1))
    return bool(
        max(np.abs(sums / np.sqrt(information)).max(), np.abs(both).max()) > SIGNIFICANCE_SIGMAS
    )


def neighbour_data(measurement: PhotonTransfer, usable: np.ndarray) -> NeighbourData:
    """Return the covariances of a measurement as inputs of the likelihood."""
    terms = jnp.asarray(variance_terms(area_shape(measurement, usable)))
    above = above_dark(measurement)
    if above is None:
        return NeighbourData(terms)
    found, _, variances = above
    total = np.sum(found * COPIES, axis=(1, 2))[usable]
    own = np.asarray(measurement.bright.variance)[usable]
    spread = variances[usable] / (own + np.maximum(total, 0)) ** 2
    darks = np.zeros(measurement.dark.mean.size)
    return NeighbourData(
        terms,
        jnp.asarray(np.concatenate([total, darks])),
        jnp.asarray(np.concatenate([spread, darks + 1])),
    )


def own_variance(
    values: dict[str, Array], around: NeighbourData | None, electrons: Array, top: Array
) -> Array:
    """Return V(mu), the variance of a pixel's charge after repulsion and mixing, e-^2."""
    own = electrons
    if "brighter_fatter" in values and around is not None:
        change = -values["brighter_fatter"] * values["system_gain"] * electrons / top
        own = electrons * jnp.polyval(around.variance_terms, jnp.clip(change, -1, 1))
    return own * (1 - values["pixel_mixing"]) if "pixel_mixing" in values else own


def area_shape(measurement: PhotonTransfer, usable: np.ndarray) -> Lags:
    """Return the ratios a_ij / a_00 from the covariances; over all pixels they sum to 0."""
    shape = -shares(measurement, usable, power=2)
    shape[0, 0] = 1
    return shape


def shares(measurement: PhotonTransfer, usable: np.ndarray, *, power: int) -> Lags:
    """Return the share of each neighbour in the sum of the covariances that grow with the signal
    (`power` 1) or with its square (`power` 2). The shares sum to 1, and the share at offset (0, 0)
    is 0.

    Each covariance is multiplied by the fraction of its square that chance does not explain. If the
    sum of covariances is not significant, or if the covariances are unknown, the four nearest
    neighbours have equal shares. For repulsion, the shares affect variances only at second order in
    a_00.
    """
    even = np.zeros((LARGEST_LAG + 1, LARGEST_LAG + 1))
    even[0, 1] = even[1, 0] = 0.25
    above = above_dark(measurement)
    if above is None:
        return even
    found, variances, _ = above
    both = _powers_of(signal_of(measurement)[usable], found[usable], variances[usable])
    slopes, errors = both[power - 1]
    square = np.maximum(slopes**2, np.finfo(float).tiny)
    kept = slopes * np.maximum(1 - errors**2 / square, 0) * (COPIES > 0)
    total = np.sum(kept * COPIES)
    return kept / total if total > 3 * np.sqrt(np.sum(errors**2 * COPIES**2)) else even


def _powers_of(
    signal: np.ndarray, found: np.ndarray, variances: np.ndarray
) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Fit C = r x + b x^2 at each offset; return (r, its error) and (b, its error)."""
    x, weight = signal[:, None, None], 1 / variances
    moments = [np.sum(weight * x**power, axis=0) for power in (2, 3, 4)]
    first, second = (np.sum(weight * x**power * found, axis=0) for power in (1, 2))
    determinant = moments[0] * moments[2] - moments[1] ** 2
    lines = (moments[2] * first - moments[1] * second) / determinant
    squares = (moments[0] * second - moments[1] * first) / determinant
    return (
        (lines, np.sqrt(moments[2] / determinant)),
        (squares, np.sqrt(moments[0] / determinant)),
    )


def variance_terms(shape: Lags) -> Float[np.ndarray, " terms"]:
    """Return the coefficients of C_00 / mu in powers m of a_00 mu, the highest first. The
    coefficient of power m is 2^m / (m + 1)! times (a * ... * a)_00 / a_00^m, where a * ... * a is
    the convolution of m copies of the area changes a_ij (Astier et al. 2019).
    """
    lags = np.arange(-LARGEST_LAG, LARGEST_LAG + 1)
    around = np.zeros((PERIOD, PERIOD))
    around[np.ix_(lags % PERIOD, lags % PERIOD)] = shape[np.ix_(abs(lags), abs(lags))]
    spectrum = np.fft.fft2(around).real
    terms = [2**m / factorial(m + 1) * np.mean(spectrum**m) for m in range(TERMS)]
    return np.array(terms[::-1])
