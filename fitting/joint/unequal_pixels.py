"""A test of whether the scatter of pixels exceeds photon and read noise because of unequal pixels
or a texture.

The mean variance s^2 of n pixels about their cell's mean has the variance 2 v^2 / (n - 1) about the
model's v. Unequal gains of relative size p add p^2 R^2, where R is the response of a pixel to a
relative change of the light. Their score, after removal of the part that gain and read noise
explain, is a regression of s^2 - v on R^2 (Rao, Proc. Cambridge Phil. Soc. 44, 1948).

Unequal pixels below significance may still bias gain and read noise, by p^2 C J. C is the
posterior's covariance and J = dv^T W R^2 with the weights n / (2 v^2) of variances.
"""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.special import ndtri

from .fit import JointFit
from .model import JointData, predicted, values_at

NOISE = ("system_gain", "read_noise")  # what unequal pixels look like
TYPICAL = 0.01  # relative gains of a camera's pixels, rms, which few exceed
TOLERATED = 0.5  # standard errors by which gain or read noise may be off
BEYOND_CHANCE = 5.0  # standard errors of the pixels' gains from none
ONE_SIDED = float(ndtri(0.95))
ALONE = 1e-9  # of the column R^2: the part that gain and read noise leave is rounding below it


@dataclass(frozen=True)
class UnequalPixels:
    """Pixel gains as estimated from the scatter of pixels."""

    size: float  # relative, rms; 0 where the scatter rises less than photons make it
    deviations: float  # of its square from 0, in standard errors
    # relative, rms, that could have gone unseen: the upper 95 % limit, at most `TYPICAL`
    most: float
    moved: float  # standard errors by which `most` would move the gain or the read noise

    @property
    def found(self) -> bool:
        """Whether unequal pixels are significant, so that gain and read noise include them."""
        return self.deviations > BEYOND_CHANCE

    def hide_noise(self, stated: bool) -> bool:
        """Whether unequal pixels make gain and read noise unidentifiable. `stated`: whether the rig
        gives their size."""
        return self.found or (not stated and self.moved > TOLERATED)


def unequal_pixels(fit: JointFit) -> UnequalPixels:
    """Estimate the pixel gains of a fit that has none, by their score."""
    cells = fit.data.cells
    count = np.asarray(cells.count, np.float64)
    freedom = count - 1
    used = freedom > 0
    variance, relative, slopes = (
        np.asarray(x, np.float64) for x in _of_pixels(jnp.asarray(fit.vector), fit.data)
    )
    weight = np.sqrt(freedom[used] / 2) / variance[used]
    beyond = (np.asarray(cells.scatter, np.float64)[used] / freedom[used] - variance[used]) * weight
    column = relative[used] ** 2 * weight
    known = slopes[:, used].T * weight[:, None]
    left = column - known @ np.linalg.lstsq(known, column)[0]
    moved = _moved(fit, np.where(count > 0, count / (2 * variance**2), 0) * relative**2, slopes)
    if left @ left <= ALONE * (column @ column):  # too few cells of several pixels
        return UnequalPixels(0.0, 0.0, TYPICAL, TYPICAL**2 * moved)
    square, error = float(left @ beyond / (left @ left)), 1 / float(np.linalg.norm(left))
    most = min((max(square, 0.0) + ONE_SIDED * error) ** 0.5, TYPICAL)
    return UnequalPixels(max(square, 0.0) ** 0.5, square / error, most, most**2 * moved)


def _moved(fit: JointFit, weighted: np.ndarray, slopes: np.ndarray) -> float:
    """The larger shift of gain or read noise for p^2 = 1, in standard errors."""
    covariance = np.linalg.pinv(fit.information)
    shift = covariance @ np.sum(slopes * weighted, axis=(1, 2))
    places = [i for i, parameter in enumerate(fit.space) if parameter.name in NOISE]
    errors = np.sqrt(np.diagonal(covariance)[places])
    return float(np.max(np.abs(shift[places]) / errors, initial=0.0))


@eqx.filter_jit
def _of_pixels(vector: Array, data: JointData) -> tuple[Array, Array, Array]:
    """Variance of a pixel, R, and the derivatives of the variance, (parameters, images, cells)."""

    def variance(v: Array) -> Array:
        return predicted(values_at(v, data), data, data.cells).variance

    model = predicted(values_at(vector, data), data, data.cells)
    slopes = jax.vmap(lambda e: jax.jvp(variance, (vector,), (e,))[1])(jnp.eye(vector.size))
    return model.variance, model.relative, slopes
