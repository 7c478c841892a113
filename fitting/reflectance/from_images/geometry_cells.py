"""Many pixels as few cells: averages of samples of one light with similar geometry.

The work of a fit is then independent of the number of pixels. A cell is a sample at the mean
geometry with the mean digital number. The curvature of the model inside the cell changes its mean.
This correction is computed at given parameters, where cells and pixels then agree exactly.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxvision import Vec

from .model import Samples, predicted_dn
from .signal import Geometry

COSINE_STEP = 0.05  # of a cell in n.l
FEWEST_SATURATED = 64  # samples of a program of saturated ones
UNCERTAIN = 1e12  # DN, deviation of a sample that says nothing
FINE_ANGLE, ANGLE_RATIO = 0.1, 1.1  # cells are 0.01 rad wide at the mirror direction, 0.11 at 1 rad


@dataclass(frozen=True)
class Grouping:
    """Which samples share a cell."""

    cell: Int[np.ndarray, " samples"]  # its index for each
    count: int  # of cells


def group(
    light: Int[np.ndarray, " samples"],
    cosine: Float[np.ndarray, " samples"],
    mirror_angle: Float[np.ndarray, " samples"],
    *,
    width: float = 1.0,
) -> Grouping:
    """Group samples by light, n.l and mirror angle (rad), most finely near the mirror direction;
    `width` scales the cells."""
    row = np.floor(cosine / (width * COSINE_STEP)).astype(np.int64)
    angle = np.log1p(mirror_angle / FINE_ANGLE) / (width * np.log(ANGLE_RATIO))
    column = np.floor(angle).astype(np.int64)
    row, column = row - row.min(), column - column.min()
    key = (light * (row.max() + 1) + row) * (column.max() + 1) + column
    _, cell = np.unique(key, return_inverse=True)
    return Grouping(cell, int(cell.max()) + 1)


def average(
    samples: Samples, grouping: Grouping, *, exact_at: Float[Array, " parameters"] | None = None
) -> Samples:
    """Average the unsaturated samples of each cell, weighted by their inverse variances.

    With `exact_at`, the cells predict the mean of their pixels exactly at that vector. An empty
    cell gets an enormous deviation, so that all channels have the same number of cells.
    """
    weight = 1 / np.asarray(samples.deviation, np.float64) ** 2
    if samples.saturated is not None:
        weight = np.where(samples.saturated, 0, weight)
    total = np.bincount(grouping.cell, weight, grouping.count)
    filled = total > 0

    def mean(values: Array) -> Array:
        sums = np.bincount(grouping.cell, weight * np.asarray(values), grouping.count)
        return jnp.asarray(sums / np.where(filled, total, 1), samples.dn.dtype)

    deviation = np.where(filled, 1 / np.sqrt(np.where(filled, total, 1)), UNCERTAIN)
    cells = replace(
        samples,
        geometry=_mean_geometry(samples.geometry, mean),
        dn=mean(samples.dn),
        deviation=jnp.asarray(deviation, samples.dn.dtype),
        saturated=None,
    )
    if exact_at is None:
        return cells
    offset = mean(predicted_dn(exact_at, samples)) - predicted_dn(exact_at, cells)
    return replace(cells, offset=offset)


def _mean_geometry(seen: Geometry, mean: Callable[[Array], Array]) -> Geometry:
    """Return directions with the mean cosines between light, normal and viewer, in a frame with the
    viewer in the xz plane and the light at positive y."""
    cos_i, cos_o = mean(seen.wi.z), mean(seen.wo.z)
    between = mean(seen.wi.x * seen.wo.x + seen.wi.y * seen.wo.y + seen.wi.z * seen.wo.z)
    sin_i, sin_o = (jnp.sqrt(jnp.maximum((1 - c) * (1 + c), 0)) for c in (cos_i, cos_o))
    tilted = sin_i * sin_o > 0
    cos_phi = (between - cos_i * cos_o) / jnp.where(tilted, sin_i * sin_o, 1)
    cos_phi = jnp.clip(jnp.where(tilted, cos_phi, 1), -1, 1)
    sin_phi = jnp.sqrt((1 - cos_phi) * (1 + cos_phi))
    toward_light = Vec(sin_i * cos_phi, sin_i * sin_phi, cos_i)
    toward_view = Vec(sin_o, jnp.zeros_like(sin_o), cos_o)
    return Geometry(toward_light, toward_view, mean(seen.irradiance))


def saturated_only(samples: Samples) -> Samples | None:
    """The saturated samples by themselves; None if there are none.

    Their number is padded to a power of two, so that channels share a compiled program. The padding
    counts as measured, with an enormous deviation.
    """
    if samples.saturated is None or not bool(np.any(samples.saturated)):
        return None
    chosen = np.flatnonzero(samples.saturated)
    count = max(FEWEST_SATURATED, 1 << (len(chosen) - 1).bit_length())
    real = jnp.arange(count) < len(chosen)
    at = jnp.asarray(np.resize(chosen, count))
    return replace(
        samples,
        geometry=jax.tree.map(lambda x: x[at], samples.geometry),
        dn=samples.dn[at],
        deviation=jnp.where(real, samples.deviation[at], UNCERTAIN),
        saturated=real,
    )
