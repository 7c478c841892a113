"""Bound the light that reaches each cell from each light.

A light is represented by a few balls, each with an intensity. A point light is one ball. A
rectangular light is divided into pieces, with one ball each. The irradiance E of a surface that
faces the light is at most the sum of I cos(theta) / d^2 over the balls, where I is the intensity, d
a lower bound of the distance, and the cosine of emission has its largest value. The integral of a
light's radiance L over directions is at most pi L if weighted by the receiver's cosine, and at most
2 pi L without the cosine. E is given per unit of the light's `spectrum`. Lengths are in m.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..core._bounds import Angles, Ends, Lobe, angle, numbers, unit
from ..core._bounds import Source as Source
from ..lights import kinds
from ..scene import Light
from .angles import cosine, half_width, lobe_angles
from .cells import Cells, Eye


def has_size(light: Light) -> bool:
    """Return whether a light may reach a point from many directions; True if not registered."""
    own = kinds().get(type(light))
    return own is None or hasattr(own, "seen")


def source_of(light: Ends[Any]) -> Source:
    """Return bounds on a light over the range of its parameters; inf for an unknown type."""
    own = kinds().get(type(light.low))
    if own is not None and own.bound is not None:
        return own.bound(light)
    kind, bands = (
        type(light.low).__name__,
        [numbers(getattr(light.low, name)).shape[-1] for name in light.low.spectra],
    )
    none = np.zeros((0, 3)), np.zeros(0), np.zeros(0)
    spectrum = np.full(max(bands, default=1), np.inf)
    return Source(spectrum, *none, None, None, "sky", why=f"no bound of {kind} is known")


class Arrived(NamedTuple):
    """Bounds on the light that reaches c cells from the s positions of a light."""

    # (c, s, 3) unit, toward the middle of each light position; None for a sky
    wi: np.ndarray | None
    width: np.ndarray  # (c, s) rad, the variation of that direction over the cell
    cos_i: np.ndarray  # (c, s), the largest cosine of incidence
    # (c, s), the largest irradiance of a facing surface per unit of the source's spectrum
    e: np.ndarray
    body: np.ndarray  # (c,) the largest sum of e cos
    facing: np.ndarray  # (c,) the largest sum of e


def light_on(source: Source, cells: Cells, least: np.ndarray) -> Arrived:
    """Bound the light of a source on the cells, at least `least`, (c,) m, away from it."""
    count = len(cells.radius)
    if source.kind == "sky" and not len(source.places):
        e = np.full((count, 1), 2 * np.pi * source.share)
        one = np.ones((count, 1))
        return Arrived(None, one * np.pi, one, e, np.minimum(e[:, 0], np.pi), e[:, 0])
    if source.kind in ("direction", "sky"):
        wi = np.broadcast_to(source.places, (count, 1, 3))
        width = np.broadcast_to(source.size, (count, 1))
        off = angle(cells.axis[:, None], wi) - cells.spread[:, None] - width
        cos_i = cosine(np.maximum(off, 0))
        e = (cos_i > 0) * (2 * np.pi * source.share if source.kind == "sky" else 1.0)
    else:
        wi, width, cos_i, e = _toward_places(source, cells, least)
    body, facing = times(e, cos_i).sum(1), e.sum(1)
    if source.extended:
        body, facing = np.minimum(body, np.pi), np.minimum(facing, 2 * np.pi)
    return Arrived(wi, width, cos_i, e, body, facing)


def lobe_products(
    arrived: Arrived, source: Source, lobes: Sequence[Lobe | None], cells: Cells, eye: Eye
) -> np.ndarray:
    """Return the largest product E f_r cos / k_s, (c,), of the irradiance E and the lobe's shading
    f_r cos toward the eye, divided by the lobe's reflectance k_s, per unit of the light's spectrum.
    The product is 0 for a surface without a lobe (None in `lobes`). Lengths in m."""
    found, e = np.zeros(len(cells.radius)), arrived.e
    has = np.array([own is not None for own in lobes], bool)[cells.surface]
    angles = None
    if arrived.wi is not None and has.any():
        there = Cells(*(x[has] for x in cells))
        e, seen = e[has], (x[has] for x in (arrived.wi, arrived.width, arrived.cos_i))
        angles = lobe_angles(there, eye, *seen)
    sent, start = np.zeros(has.sum()), 0
    for own, count in zip(lobes, np.bincount(cells.surface, minlength=len(lobes)), strict=True):
        if own is None:
            continue
        part, start = slice(start, start + count), start + count
        sent[part] = own.size if source.extended else np.inf
        if angles is not None:
            most = own.most(Angles(*(x[part] for x in angles)))
            by_place = times(e[part], np.broadcast_to(most, e[part].shape))
            sent[part] = np.minimum(by_place.sum(1), sent[part])
    found[has] = sent
    return found


def times(a: np.ndarray, b: np.ndarray | float) -> np.ndarray:
    """Multiply two arrays with 0 times inf = 0, because without light or reflectance there is no
    radiance."""
    nothing = (a == 0) | (b == 0)
    return np.where(nothing, 0, np.where(nothing, 1, a) * np.where(nothing, 1, b))


def _toward_places(
    source: Source, cells: Cells, least: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the unit direction from each cell to each light position, (c, s, 3). Also return, (c,
    s) each, the largest angle between this direction and the direction from another point of the
    cell, in rad; the largest cosine of incidence; and the largest irradiance E."""
    apart = source.places - cells.centre[:, None]
    distance = np.linalg.norm(apart, axis=-1)
    wi, size = unit(apart), cells.radius[:, None] + source.size
    width = half_width(size, distance)
    flat = (cells.spread == 0)[:, None]
    # above a flat cell: d^2 = height^2 + along^2, with both at their minimum
    height = (apart * cells.axis[:, None]).sum(-1)
    along = np.sqrt(np.maximum(distance**2 - height**2, 0))
    lateral = np.maximum(along - np.where(np.isinf(size), along, size), 0)
    above = np.hypot(np.maximum(np.abs(height) - source.size, 0), lateral)
    ball = np.maximum(distance - size, 0)
    d = np.maximum(np.where(flat, above, ball), least[:, None])
    some = np.where(d > 0, d, 1)
    off = np.maximum(angle(cells.axis[:, None], wi) - cells.spread[:, None] - width, 0)
    level = np.clip((height + source.size) / some, 0, 1)
    cos_i = np.where(flat, np.where(d > 0, level, height + source.size > 0), cosine(off))
    e = np.where(d > 0, source.weight / some**2, np.inf) * (cos_i > 0)
    if source.normal is not None:  # the receiver's height over the lamp's plane
        over = -(apart * source.normal).sum(-1)
        leaning = np.sqrt(np.maximum(1 - (cells.axis @ source.normal) ** 2, 0))[:, None]
        reach = np.where(flat, leaning, 1) * np.where(np.isinf(size), 1e300, cells.radius[:, None])
        reach = np.where(flat & (leaning == 0), 0, reach)
        over = over + reach + (source.size if source.kind == "place" else 0)
        e = times(e, np.where(d > 0, np.clip(over / some, 0, 1), over > 0))
    return wi, width, cos_i, e
