"""Tables for sampling an environment, computed once from its picture before rendering.

A uniform float32 is a multiple of 2^-23, its resolution. The entries of the tables are multiples of
it too, and the density is computed from their differences. It is therefore exactly the density of
the draws, regardless of rounding, and a sun of 1e9 times the sky leaves no pixel of the sky
unsampled.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..core._numerics import divide, running_sum
from ..core._types import as_float, check_range, check_shape
from .environment import EnvironmentMap

# Steps of the resolution that every pixel with light gets at least. Running sums err by less than
# 8; 512 rows of 1024 columns give away 3e-3 of the samples to it in float32.
_LEAST = 16


def environment_map(radiance: ArrayLike, *, rotation: ArrayLike | None = None) -> EnvironmentMap:
    """Make an environment light from a latitude-longitude picture of radiance.

    The probability of a pixel is proportional to the bilinear picture's mean over the pixel and the
    bands, times the solid angle. If the picture is black, sampling is uniform over the sphere. The
    probability of a pixel with light within its row, and of its row, is at least 16 times the
    resolution of the floats. Probabilities have no gradients.

    Args:
        radiance: (h, w, bands) W m^-2 sr^-1, >= 0.
        rotation: (3, 3), whose rows are the map's axes in the world; by default the world's axes.

    Returns:
        The light.

    Raises:
        ValueError: for another shape, a picture without pixels, and values that are negative or not
            finite.

    Example:
        Rows near the poles get fewer samples, in proportion to their solid angle.

        >>> sky = jv.environment_map(np.ones((4, 8, 1)))
        >>> print(np.asarray(sky.rows).round(3))  # (1 - cos(theta)) / 2 at 0, 45, ... degrees
        [0.    0.146 0.5   0.854 1.   ]
    """
    picture = as_float(radiance)
    check_shape("environment_map's radiance", picture, ("h", "w", "bands"))
    if picture.size == 0:
        raise ValueError(
            f"environment_map's radiance must have pixels and bands, got {picture.shape}."
        )
    check_range("environment_map's radiance", picture, 0)
    rows, columns = _tables(jax.lax.stop_gradient(picture))
    return EnvironmentMap(
        picture,
        jnp.eye(3, dtype=picture.dtype) if rotation is None else rotation,
        rows,
        columns,
        _density(rows, columns),
    )


@jax.jit
def _tables(
    picture: Float[Array, "h w bands"],
) -> tuple[Float[Array, " h_1"], Float[Array, "h w_1"]]:
    """Cumulative probabilities of the rows, and within each row of its columns."""
    h, w, _ = picture.shape
    # relative to the brightest, so that sums stay within the range of a float. XLA multiplies by an
    # inverse, which from 8.5e37 on is no normal float32 and counts as 0: both are made smaller
    # before, by a factor that depends on the picture, or XLA would take it away
    smaller = jnp.where(picture.max() > 1, 2.0**-32, 1).astype(picture.dtype)
    relative = divide(picture * smaller, picture.max() * smaller, otherwise=1)
    brightness = _pixel_means(relative.mean(axis=-1))
    mass = brightness * jnp.asarray(_solid_angles(h, w), picture.dtype)
    row_mass = mass.sum(axis=1, keepdims=True)
    within = divide(mass, row_mass, otherwise=1 / w)
    return _cumulative(row_mass[:, 0] / row_mass.sum()), _cumulative(within)


@jax.jit  # compiled apart, so that it uses the tables as they were rounded
def _density(rows: Float[Array, " h_1"], columns: Float[Array, "h w_1"]) -> Float[Array, "h w"]:
    """Probability of each pixel's draws by solid angle."""
    solid_angles = jnp.asarray(_solid_angles(len(rows) - 1, columns.shape[1] - 1), rows.dtype)
    return jnp.diff(rows)[:, None] * jnp.diff(columns) / solid_angles


def _pixel_means(picture: Float[Array, "h w"]) -> Float[Array, "h w"]:
    """Means of the bilinear picture over its pixels: [1 6 1] / 8 along both axes. They are positive
    wherever the picture is, so that every bright place can be drawn."""
    w = picture.shape[1]
    near, far = picture[:1], picture[-1:]
    poles = [
        (jnp.roll(line, w // 2, 1) + jnp.roll(line, (w + 1) // 2, 1)) / 2 for line in (near, far)
    ]
    tall = jnp.concatenate([poles[0], picture, poles[1]])
    rows = (tall[:-2] + 6 * tall[1:-1] + tall[2:]) / 8
    return (jnp.roll(rows, 1, 1) + 6 * rows + jnp.roll(rows, -1, 1)) / 8


def _solid_angles(h: int, w: int) -> Float[np.ndarray, "h 1"]:
    """Solid angle of a pixel in each row: the difference of cos(theta), 2 sin(middle) sin(half a
    row), times that of phi."""
    differences = 2 * np.sin(np.pi * (np.arange(h) + 0.5) / h) * np.sin(np.pi / (2 * h))
    return differences[:, None] * (2 * np.pi / w)


def _cumulative(probability: Float[Array, "... n"]) -> Float[Array, "... n_1"]:
    """Running sums from 0 to exactly 1, in multiples of the resolution of uniform floats."""
    step = jnp.finfo(probability.dtype).eps
    least = jnp.where(probability > 0, _LEAST * step, 0)
    total = running_sum(least + probability * (1 - least.sum(axis=-1, keepdims=True)))
    total = jnp.round(total / total[..., -1:] / step) * step
    return jnp.concatenate([jnp.zeros_like(total[..., :1]), total], axis=-1)
