"""Many pixels as few cells: averages of samples of one light with similar geometry.

The work of a fit is then independent of the number of pixels. A cell is a sample at the mean
geometry with the mean digital number. The curvature of the model inside the cell changes its mean.
This correction is computed at given parameters, where cells and pixels then agree exactly.
"""

from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int

from .derivatives import Prediction, predict
from .model import Samples
from .signal import in_plane

COSINE_STEP = 0.05  # of a cell in n.l
FEWEST_SATURATED = 64  # samples of a program of saturated ones
UNCERTAIN = 1e12  # DN, standard deviation of a sample without information
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


def average(samples: Samples, grouping: Grouping, *, exact_at: Prediction | None = None) -> Samples:
    """Average the unsaturated samples of each cell, weighted by their inverse variances.

    With `exact_at`, the samples as predicted at a vector, the cells predict the mean of their
    pixels exactly there. An empty cell gets an enormous deviation, so that all channels have the
    same number of cells.
    """
    weight = np.asarray(samples.deviation, np.float64) ** -2
    if samples.saturated is not None:
        weight = np.where(samples.saturated, 0, weight)
    total = np.bincount(grouping.cell, weight, grouping.count)
    filled = total > 0

    def mean(values: Any) -> Float[np.ndarray, " cells"]:
        sums = np.bincount(grouping.cell, weight * values, grouping.count)
        return sums / np.where(filled, total, 1)

    seen = samples.geometry
    wi, wo = seen.wi, seen.wo
    between = wi.x * wo.x + wi.y * wo.y + wi.z * wo.z
    cells = replace(
        samples,
        geometry=in_plane(*map(mean, (wi.z, wo.z, between, seen.irradiance))),
        dn=mean(samples.dn),
        deviation=np.where(filled, 1 / np.sqrt(np.where(filled, total, 1)), UNCERTAIN),
        saturated=None,
    )
    if exact_at is None:
        return cells
    return replace(cells, offset=mean(exact_at.dn) - predict(exact_at.vector, cells).dn)


def saturated_only(samples: Samples) -> Samples | None:
    """The saturated samples by themselves; None if there are none.

    Their number is padded to a power of two, so that channels share a compiled program. The padding
    counts as measured, with an enormous deviation.
    """
    if samples.saturated is None or not bool(np.any(samples.saturated)):
        return None
    chosen = np.flatnonzero(samples.saturated)
    count = max(FEWEST_SATURATED, 1 << (len(chosen) - 1).bit_length())
    real = np.arange(count) < len(chosen)
    at = np.resize(chosen, count)
    return replace(
        samples,
        geometry=jax.tree.map(lambda x: x[at], samples.geometry),
        dn=samples.dn[at],
        deviation=np.where(real, samples.deviation[at], UNCERTAIN),
        saturated=real,
    )
