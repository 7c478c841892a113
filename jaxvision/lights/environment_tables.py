"""What an environment's sampling needs, computed once from its picture, before any rendering."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from .._types import as_float, check_shape
from .environment import EnvironmentMap


def environment_map(radiance: ArrayLike, *, rotation: ArrayLike | None = None) -> EnvironmentMap:
    """The light of a latitude-longitude picture of radiance, (h, w, bands) in W m^-2 sr^-1, >= 0.

    A place is sampled in proportion to the mean over the bands of the bilinear picture over its
    pixel, times solid angle (all of the sphere alike if the picture is black). Gradients do not
    enter the probabilities. `rotation`: (3, 3), rows the map's axes in the world; by default the
    world's own. `ValueError` for another shape.
    """
    picture = as_float(radiance)
    check_shape("environment_map's radiance", picture, ("h", "w", "bands"))
    h, w, _ = picture.shape
    brightness = _pixel_means(jax.lax.stop_gradient(picture).mean(axis=-1))
    brightness = jnp.where(brightness.max() > 0, brightness, 1)
    cell = jnp.asarray(_row_solid_angles(h), picture.dtype)[:, None] * (2 * jnp.pi / w)
    mass = brightness * cell
    row_mass = mass.sum(axis=1, keepdims=True)
    within = jnp.where(row_mass > 0, mass / jnp.where(row_mass > 0, row_mass, 1), 1 / w)
    return EnvironmentMap(
        picture,
        jnp.eye(3, dtype=picture.dtype) if rotation is None else rotation,
        _cumulative(row_mass[:, 0] / row_mass.sum()),
        _cumulative(within),
        brightness / row_mass.sum(),
    )


def _pixel_means(picture: Float[Array, "h w"]) -> Float[Array, "h w"]:
    """Means of the bilinear picture over its pixels: [1 6 1] / 8 along both axes. Positive
    wherever the picture is, so that every bright place can be drawn."""
    w = picture.shape[1]
    near, far = picture[:1], picture[-1:]
    poles = [
        (jnp.roll(line, w // 2, 1) + jnp.roll(line, (w + 1) // 2, 1)) / 2 for line in (near, far)
    ]
    tall = jnp.concatenate([poles[0], picture, poles[1]])
    rows = (tall[:-2] + 6 * tall[1:-1] + tall[2:]) / 8
    return (jnp.roll(rows, 1, 1) + 6 * rows + jnp.roll(rows, -1, 1)) / 8


def _row_solid_angles(h: int) -> Float[np.ndarray, " h"]:
    """Differences of cos(theta) over each row: 2 sin(middle) sin(half a row)."""
    return 2 * np.sin(np.pi * (np.arange(h) + 0.5) / h) * np.sin(np.pi / (2 * h))


def _cumulative(probability: Float[Array, "... n"]) -> Float[Array, "... n_1"]:
    """Running sums from 0, ending in exactly 1."""
    total = jnp.cumsum(probability, axis=-1)
    total = total / total[..., -1:]
    return jnp.concatenate([jnp.zeros_like(total[..., :1]), total], axis=-1)
