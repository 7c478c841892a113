"""Tables for sampling an environment, computed once from its picture before rendering.

A uniform random float32 is a multiple of the resolution 2^-23. The cumulative probabilities in the
tables are multiples of the resolution too, and the density is computed from their differences. The
density is therefore exactly that of the drawn samples, without rounding errors. Every pixel of the
sky can be drawn, even if the sun is 1e9 times brighter.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..core._arguments import warn_caller
from ..core._numerics import divide, running_sum
from ..core._types import as_float, check_range, check_shape
from .environment import EnvironmentMap

# Smallest probability of a pixel with light, in units of the resolution. It exceeds the errors of
# the running sums, which are below 8 units. For 512 rows of 1024 columns in float32, this minimum
# takes 3e-3 of the samples.
_LEAST = 16
_LEAST_ROWS = 16  # pictures with fewer rows are not checked for their shape


def environment_map(radiance: ArrayLike, *, rotation: ArrayLike | None = None) -> EnvironmentMap:
    """Make an environment light from a latitude-longitude picture of radiance.

    The probability of a pixel is proportional to the mean of the bilinear picture over the pixel
    and the bands, times the solid angle. If the picture is black, sampling is uniform over the
    sphere. For a pixel with light, the probability of the row, and the probability of the pixel
    within the row, are at least 16 times the resolution of uniform random numbers. Probabilities
    have no gradients.

    Args:
        radiance: (h, w, bands) W m^-2 sr^-1, >= 0.
        rotation: (3, 3), whose rows are the map's axes in the world; by default the world's axes.

    Returns:
        The light.

    Raises:
        ValueError: for another shape, a picture without pixels, codes of a display picture, and
            values that are negative or not finite.

    Example:
        Rows near the poles get fewer samples, in proportion to their solid angle.

        >>> sky = jv.environment_map(np.ones((4, 8, 1)))
        >>> print(np.asarray(sky.rows).round(3))  # (1 - cos(theta)) / 2 at 0, 45, ... degrees
        [0.    0.146 0.5   0.854 1.   ]
    """
    dtype = getattr(radiance, "dtype", None)
    if dtype in (np.uint8, np.uint16):
        raise ValueError(
            f"environment_map's radiance is in W m^-2 sr^-1, got {dtype} codes, which are "
            "no radiance; decode them, as by jaxvision.srgb_decode(codes / 255), and scale them."
        )
    picture = as_float(radiance)
    check_shape("environment_map's radiance", picture, ("h", "w", "bands"))
    if picture.size == 0:
        raise ValueError(
            f"environment_map's radiance must have pixels and bands, got {picture.shape}."
        )
    height, width = picture.shape[:2]
    if height >= _LEAST_ROWS and width in (height, height * 3 // 4, height * 4 // 3):
        warn_caller(
            f"environment_map's radiance has {height} rows of {width}, as a light probe or a cross "
            "of a cube has; a latitude-longitude picture is twice as wide as high."
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
    """Return the cumulative probabilities of the rows, and of the columns within each row."""
    h, w, _ = picture.shape
    # Values are divided by the brightest pixel, so that sums stay within the range of a float. XLA
    # divides by multiplying with the inverse. The inverse of a number above 8.5e37 is not a normal
    # float32 and counts as 0, so both numbers are first made smaller. The factor depends on the
    # picture, because XLA would cancel a constant one.
    smaller = jnp.where(picture.max() > 1, 2.0**-32, 1).astype(picture.dtype)
    relative = divide(picture * smaller, picture.max() * smaller, otherwise=1)
    brightness = _pixel_means(relative.mean(axis=-1))
    mass = brightness * jnp.asarray(_solid_angles(h, w), picture.dtype)
    row_mass = mass.sum(axis=1, keepdims=True)
    within = divide(mass, row_mass, otherwise=1 / w)
    return _cumulative(row_mass[:, 0] / row_mass.sum()), _cumulative(within)


@jax.jit  # compiled separately, so that the density follows from the rounded tables
def _density(rows: Float[Array, " h_1"], columns: Float[Array, "h w_1"]) -> Float[Array, "h w"]:
    """Return the probability of each pixel divided by its solid angle."""
    solid_angles = jnp.asarray(_solid_angles(len(rows) - 1, columns.shape[1] - 1), rows.dtype)
    return jnp.diff(rows)[:, None] * jnp.diff(columns) / solid_angles


def _pixel_means(picture: Float[Array, "h w"]) -> Float[Array, "h w"]:
    """Return the mean of the bilinear picture over each pixel, by the filter [1 6 1] / 8 along both
    axes. The mean is positive wherever the bilinear picture is, so that no light is missed."""
    w = picture.shape[1]
    near, far = picture[:1], picture[-1:]
    poles = [
        (jnp.roll(line, w // 2, 1) + jnp.roll(line, (w + 1) // 2, 1)) / 2 for line in (near, far)
    ]
    tall = jnp.concatenate([poles[0], picture, poles[1]])
    rows = (tall[:-2] + 6 * tall[1:-1] + tall[2:]) / 8
    return (jnp.roll(rows, 1, 1) + 6 * rows + jnp.roll(rows, -1, 1)) / 8


def _solid_angles(h: int, w: int) -> Float[np.ndarray, "h 1"]:
    """Return the solid angle of a pixel in each row, in sr. The solid angle is the product of the
    difference of cos(theta), written as 2 sin(middle) sin(half a row), and the difference of
    phi."""
    differences = 2 * np.sin(np.pi * (np.arange(h) + 0.5) / h) * np.sin(np.pi / (2 * h))
    return differences[:, None] * (2 * np.pi / w)


def _cumulative(probability: Float[Array, "... n"]) -> Float[Array, "... n_1"]:
    """Return running sums from 0 to exactly 1, in multiples of the resolution of uniform floats."""
    step = jnp.finfo(probability.dtype).eps
    least = jnp.where(probability > 0, _LEAST * step, 0)
    total = running_sum(least + probability * (1 - least.sum(axis=-1, keepdims=True)))
    total = jnp.round(total / total[..., -1:] / step) * step
    return jnp.concatenate([jnp.zeros_like(total[..., :1]), total], axis=-1)
