"""Angles and cosines between cells, lights and the eye, each bounded over the whole of a cell.

Bounds for each of c cells and s light positions, valid for every point of the cell and every normal
of its cone. Angles in rad, lengths in m.
"""

import numpy as np

from ..core._bounds import Angles, angle, unit
from .cells import Cells, Eye


def half_width(radius: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Half-angle, rad, of the cone that a ball subtends; pi from inside it."""
    inside = radius >= distance
    ratio = np.where(inside, 1, radius / np.where(distance > 0, distance, 1))
    return np.where(inside, np.pi, np.arcsin(np.minimum(ratio, 1)))


def cosine(angles: np.ndarray) -> np.ndarray:
    """cos+ of angles from 0 to beyond a right angle, no unit."""
    return np.where(angles < np.pi / 2, np.cos(np.clip(angles, 0, np.pi / 2)), 0)


def toward_eye(cells: Cells, eye: Eye) -> tuple[np.ndarray, np.ndarray]:
    """The unit direction to the viewer, (c, 3), and its variation over each cell, (c,) rad."""
    if eye.everywhere:
        return cells.axis, np.full(len(cells.radius), np.pi)
    if eye.parallel:
        along = np.broadcast_to(-eye.rotation[2], cells.centre.shape)
        return along, np.zeros(len(cells.radius))
    apart = eye.place - cells.centre
    return unit(apart), half_width(cells.radius + eye.size, np.linalg.norm(apart, axis=1))


def cos_seen(cells: Cells, eye: Eye) -> tuple[np.ndarray, np.ndarray]:
    """The smallest and the largest cosine between a cell's normal and the direction to the eye,
    (c,); 0 from behind.
    """
    wo, width = toward_eye(cells, eye)
    middle, slack = angle(cells.axis, wo), width + cells.spread
    return cosine(middle + slack), cosine(np.maximum(middle - slack, 0))


def lobe_angles(
    cells: Cells, eye: Eye, wi: np.ndarray, width: np.ndarray, cos_i: np.ndarray
) -> Angles:
    """The angles between the lobes of c cells and the eye, for light from `wi`, (c, s, 3) unit
    vectors toward the middle of each light position. `width`, (c, s) rad, is the variation of that
    direction, and `cos_i`, (c, s), the largest cosine of incidence."""
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
