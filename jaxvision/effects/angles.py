"""Bound the angles and cosines between surface cells, lights and the eye.

The bounds, for c cells and s light positions, are valid for every point of a cell and every normal
in the cell's cone of normals. Angles are in rad, lengths in m.
"""

import numpy as np

from ..core._bounds import Angles, angle, unit
from .cells import Cells, Eye


def half_width(radius: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Return the half-angle, rad, that a ball subtends at a distance; pi inside the ball."""
    inside = radius >= distance
    ratio = np.where(inside, 1, radius / np.where(distance > 0, distance, 1))
    return np.where(inside, np.pi, np.arcsin(np.minimum(ratio, 1)))


def cosine(angles: np.ndarray) -> np.ndarray:
    """Return max(cos, 0) of angles that may exceed a right angle, no unit."""
    return np.where(angles < np.pi / 2, np.cos(np.clip(angles, 0, np.pi / 2)), 0)


def toward_eye(cells: Cells, eye: Eye) -> tuple[np.ndarray, np.ndarray]:
    """Return the unit direction from each cell to the eye, (c, 3), and its variation, (c,) rad."""
    if eye.everywhere:
        return cells.axis, np.full(len(cells.radius), np.pi)
    if eye.parallel:
        along = np.broadcast_to(-eye.rotation[2], cells.centre.shape)
        return along, np.zeros(len(cells.radius))
    apart = eye.place - cells.centre
    return unit(apart), half_width(cells.radius + eye.size, np.linalg.norm(apart, axis=1))


def cos_seen(cells: Cells, eye: Eye) -> tuple[np.ndarray, np.ndarray]:
    """Return the smallest and largest cosine, (c,), of normals and eye; 0 for a hidden back."""
    wo, width = toward_eye(cells, eye)
    middle, slack = angle(cells.axis, wo), width + cells.spread
    return cosine(middle + slack), cosine(np.maximum(middle - slack, 0))


def lobe_angles(
    cells: Cells, eye: Eye, wi: np.ndarray, width: np.ndarray, cos_i: np.ndarray
) -> Angles:
    """Bound the angles on which the shading of a specular lobe depends, for c cells and s light
    positions. `wi`, (c, s, 3), are unit vectors from the cells toward the middle of each light
    position. `width`, (c, s) rad, is the largest angle between `wi` and the same direction from any
    other point of the cell. `cos_i`, (c, s), is the largest cosine of incidence."""
    wo, seen = toward_eye(cells, eye)
    axis, wo, spread, seen = cells.axis[:, None], wo[:, None], cells.spread[:, None], seen[:, None]
    mirrored = 2 * (wi * axis).sum(-1, keepdims=True) * axis - wi
    off = np.maximum(angle(mirrored, wo) - 2 * spread - width - seen, 0)
    between = np.minimum(angle(wi, np.broadcast_to(wo, wi.shape)) + width + seen, np.pi) / 2
    least = np.where(between < np.pi / 2, np.cos(between), 0)
    cos_o, most = (x[:, None] for x in cos_seen(cells, eye))
    # n.h = (n.wi + n.wo) / |wi + wo|, |wi + wo| = 2 d
    cos_half = np.where(least > 0, (cos_i + most) / np.where(least > 0, 2 * least, 1), 1)
    return Angles(off, np.minimum(cos_half, 1), least, cos_i, cos_o, most)
