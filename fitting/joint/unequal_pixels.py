"""Whether pixels scatter as photons and read-out do, or also as unequal pixels or a texture would.

The mean variance s^2 of n pixels about their cell's mean has the variance 2 v^2 / (n - 1) about the
model's v. Unequal gains of relative size p add p^2 R^2, R being what a relative change of the light
does to a pixel. Their score, what gain and read noise explain removed first, is a regression of
s^2 - v on R^2 (Rao, Proc. Cambridge Phil. Soc. 44, 1948).
"""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .fit import JointFit
from .model import JointData, predicted, values_at

BEYOND_CHANCE = 5.0  # standard errors of the pixels' gains from none
ALONE = 1e-9  # of the column R^2: the part that gain and read noise leave is rounding below it


@dataclass(frozen=True)
class UnequalPixels:
    """What the scatter of pixels says of their gains.

    Attributes:
        size: relative, rms; 0 where the scatter rises less than photons make it.
        deviations: of its square from 0, in standard errors.
    """

    size: float
    deviations: float

    @property
    def found(self) -> bool:
        """Whether they are beyond chance, so that gain and read noise stand for them too."""
        return self.deviations > BEYOND_CHANCE


def unequal_pixels(fit: JointFit) -> UnequalPixels:
    """The gains of pixels that the likelihood leaves out, by their score.

    Args:
        fit: of one channel, whose pixels are alike.

    Returns:
        Their size.
    """
    cells = fit.data.cells
    freedom = np.asarray(cells.count, np.float64) - 1
    used = freedom > 0
    variance, relative, slopes = (
        np.asarray(x, np.float64) for x in _of_pixels(jnp.asarray(fit.vector), fit.data)
    )
    weight = np.sqrt(freedom[used] / 2) / variance[used]
    beyond = (np.asarray(cells.scatter, np.float64)[used] / freedom[used] - variance[used]) * weight
    column = relative[used] ** 2 * weight
    known = slopes[:, used].T * weight[:, None]
    left = column - known @ np.linalg.lstsq(known, column)[0]
    if left @ left <= ALONE * (column @ column):  # too few cells of several pixels to tell
        return UnequalPixels(0.0, 0.0)
    square = float(left @ beyond / (left @ left))
    return UnequalPixels(max(square, 0.0) ** 0.5, square * float(np.linalg.norm(left)))


@eqx.filter_jit
def _of_pixels(vector: Array, data: JointData) -> tuple[Array, Array, Array]:
    """Variance of a pixel, R, and the variance's slopes, (parameters, images, cells)."""

    def variance(v: Array) -> Array:
        return predicted(values_at(v, data), data, data.cells).variance

    model = predicted(values_at(vector, data), data, data.cells)
    slopes = jax.vmap(lambda e: jax.jvp(variance, (vector,), (e,))[1])(jnp.eye(vector.size))
    return model.variance, model.relative, slopes
