"""The extent of a lamp's shadows: the cells that may be in one, and the cells in full shadow.

A cell is out of reach if the hull of it and the lamp is disjoint from every occluder that
`blocking.may_block` allows. It is in full shadow of a flat occluder if it is beyond the occluder's
plane and, for each corner of the lamp, inside all planes through that corner and a side of the
occluder. Every segment from the cell to such a corner then meets the occluder, and so do those to
the whole lamp, because the section of the hull of two bodies by a plane between them is the hull of
these points. Cells in the full shadow of the eye are not seen. Lengths in m.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..scene import Box, Disc, Quad, Sphere, Surface, TriangleMesh
from ..scene.shapes import Shape
from .blocking import certain, is_convex, reach_of, swept, touching
from .bodies import (
    DIRECTIONS,
    Bodies,
    balls_about,
    body_of,
    disc_polygon,
    faces_of,
    gap,
    heights,
    numbers,
    stacked,
    surface_bodies,
    taken,
    unit,
)
from .cells import Cells, Eye, bodies_of, has_faces_apart, part_of, plane_between
from .illumination import Source
from .stages import Ends

_PAIRS = 60_000  # pairs of cells and occluders; in larger scenes whole surfaces are tested
# relative to its coordinates: a cell at most this far beyond an occluder is in its plane
_DEEP = 1e-4
_SEARCHED = 2000  # pairs for which the best separating direction is searched


def shaded(
    sources: Sequence[Source],
    surfaces: Sequence[Ends[Surface]],
    cells: Cells,
    *,
    may: np.ndarray,
    wanted: np.ndarray,
) -> np.ndarray:
    """Return whether anything can be between a light and a cell, (l, c), for the wanted pairs, (l,
    c). False is certain for these, and all other pairs are False. `may`, (l, n, n), comes from
    `may_block`."""
    found = wanted & np.any(may, axis=2)[:, cells.surface]
    count = sum(int((found[k][:, None] & may[k][cells.surface]).sum()) for k in range(len(found)))
    if not 0 < count <= _PAIRS:
        return found
    reach = reach_of(surfaces, sources)
    occluders, bounded = surface_bodies(surfaces)
    own, relative = outward(surfaces, cells) > 0, touching(surfaces)
    for k, source in enumerate(sources):
        cell, occluder = np.nonzero(found[k][:, None] & may[k][cells.surface])
        itself = own[cell] & (occluder == cells.surface[cell])
        cell, occluder = cell[~itself], occluder[~itself]
        if source.kind == "sky":
            continue
        found[k] = False
        never = ~bounded[occluder] | np.isinf(cells.radius[cell])
        found[k, cell[never]] = True
        cell, occluder = cell[~never], occluder[~never]
        meets = _meets(source, cells, occluders, (cell, occluder), reach, relative)
        found[k, cell[meets]] = True
    return found


def _meets(
    source: Source,
    cells: Cells,
    occluders: Bodies,
    pairs: tuple[np.ndarray, np.ndarray],
    reach: float,
    relative: float,
) -> np.ndarray:
    """Return whether the hull of a light and each cell may intersect an occluder. The tests are, in
    order: the horizon of a flat cell, the ball around the occluder, fixed directions, and the best
    direction for the few remaining triples."""
    cell, occluder = pairs
    tolerance = certain(reach)
    about, size = balls_about(occluders)
    hulls = swept(source, bodies_of(cells), reach)
    middle, wide = balls_about(Bodies(hulls.points[:, 1:], hulls.radii[:, 1:]))
    apart = _distance_to_segment(about[occluder], cells.centre[cell], middle[cell])
    meets = apart <= size[occluder] + np.maximum(cells.radius, wide)[cell] + tolerance
    left = np.flatnonzero(meets & (cells.spread[cell] == 0))
    i, j = cell[left], occluder[left]
    over = np.einsum("npk,nk->np", occluders.points[j] - cells.centre[i][:, None], cells.axis[i])
    own = np.abs(cells.axis[i])
    size = np.einsum("npk,nk->np", np.abs(occluders.points[j]), own) + occluders.radii[j]
    off = relative * (size.max(1, initial=0) + (np.abs(cells.centre[i]) * own).sum(1))
    meets[left] = (over + occluders.radii[j]).max(1, initial=-np.inf) > off
    low, high = -heights(occluders, -DIRECTIONS), heights(hulls, DIRECTIONS)
    left = np.flatnonzero(meets)
    meets[left] = (low[occluder[left]] - high[cell[left]]).max(1) <= tolerance
    left = np.flatnonzero(meets)
    if len(left) <= _SEARCHED:
        i, j = cell[left], occluder[left]
        meets[left] = gap(taken(hulls, i), taken(occluders, j), enough=tolerance) <= tolerance
    return meets


def _distance_to_segment(place: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """(n,) m, from each place, (n, 3), to the segment between two others."""
    along = end - start
    square = (along**2).sum(1)
    t = np.clip(((place - start) * along).sum(1) / np.where(square > 0, square, 1), 0, 1)
    return np.linalg.norm(start + t[:, None] * along - place, axis=1)


def outward(surfaces: Sequence[Ends[Surface]], cells: Cells) -> np.ndarray:
    """Return (c,), the side of a convex body that a cell belongs to: 1 outer, -1 inner. It is 0 for
    other shapes, for shapes that may move, and for cells of many triangles of a mesh."""
    side = np.zeros(len(cells.radius))
    for i, surface in enumerate(surfaces):
        shape = surface.low.shape
        if shape is surface.high.shape and is_convex(surface.of("shape")):
            part = part_of(cells, i)
            away = np.sign(((cells.centre[part] - _middle(shape)) * cells.axis[part]).sum(1))
            clear = not isinstance(shape, TriangleMesh) or has_faces_apart(shape)
            side[part] = away if clear else 0
    return side


def _middle(shape: Shape) -> np.ndarray:
    """(3,) m, a point inside a convex body."""
    if isinstance(shape, TriangleMesh):
        return numbers(shape.vertices)[np.unique(faces_of(shape))].mean(0)
    assert isinstance(shape, Sphere | Box)
    return numbers(shape.centre)


def hidden(surfaces: Sequence[Ends[Surface]], cells: Cells, eye: Eye) -> np.ndarray:
    """(c,) whether a cell is on the inner side of a convex body with the eye outside, or entirely
    behind one flat surface."""
    inner = outward(surfaces, cells) < 0
    if eye.everywhere:
        return inner & False
    for i in np.unique(cells.surface[inner]):
        body = body_of(surfaces[i].of("shape"))
        assert body is not None
        bodies = stacked([body])
        lens = Bodies(eye.place[None, None], np.full((1, 1), eye.size))
        if eye.parallel:
            ahead = -heights(bodies._replace(points=bodies.points - eye.place), -eye.rotation[2:])
            outside = ahead[0, 0] > eye.moves
        else:
            outside = gap(lens, bodies)[0] > 0
        inner &= outside | (cells.surface != i)
    source = _eye_as_source(eye)
    return inner if source is None else inner | in_umbra([source], surfaces, cells)[0]


class _Shadow(NamedTuple):
    """The full shadow of one flat occluder: the intersection of these half-spaces."""

    normals: np.ndarray  # (h, 3) unit, inward; the first is that of the occluder's own plane
    offsets: np.ndarray  # (h,) m
    size: float  # m, the largest coordinate of its rim

    def least(self, bodies: Bodies) -> np.ndarray:
        """(n, h) m, the distance of each body's worst point inside each half-space."""
        return -heights(bodies, -self.normals) - self.offsets


def in_umbra(
    sources: Sequence[Source],
    surfaces: Sequence[Ends[Surface]],
    cells: Cells,
    *,
    occluders: Sequence[int] | None = None,
) -> np.ndarray:
    """Return whether a whole cell is in the full shadow of one flat occluder, (l, c), lengths in m.
    True is certain, except for the rounding of coordinates. `occluders` are the numbers of the
    blocking surfaces; None: all."""
    dark = np.zeros((len(sources), len(cells.radius)), bool)
    relative = touching(surfaces)
    whole, bounded = surface_bodies(surfaces)
    bounded = bounded[cells.surface]
    if not bounded.any():
        return dark
    balls = np.array([isinstance(surface.low.shape, Sphere) for surface in surfaces])
    of_body = np.abs(whole.points).max((1, 2)) + whole.radii.max(1)
    of_cell = np.abs(cells.centre).max(1) + np.minimum(cells.radius, 1e300)
    for j in range(len(surfaces)) if occluders is None else occluders:
        for k, source in enumerate(sources):
            shadow = _shadow_of(surfaces[j].of("shape"), source)
            if shadow is None:
                continue
            deep = _DEEP * (shadow.size + of_body)
            farthest = heights(whole, shadow.normals[:1])[:, 0] - shadow.offsets[0]
            some = (farthest > deep)[cells.surface] & bounded & (cells.surface != j) & ~dark[k]
            there = Cells(*(x[some] for x in cells))
            least = np.maximum(shadow.least(whole)[there.surface], shadow.least(bodies_of(there)))
            size = shadow.size + of_cell[some]
            inside = (least >= -relative * size[:, None]).all(1)
            beyond = _beyond(there, balls[there.surface], shadow, least[:, 0], _DEEP * size)
            dark[k, some] = inside & beyond
    return dark


def covered(
    body: tuple[np.ndarray, np.ndarray], eye: Eye, surfaces: Sequence[Ends[Surface]]
) -> bool:
    """Whether one flat surface hides all of a body, points (p, 3) m and radii (p,) m, from an eye
    at one place."""
    source = _eye_as_source(eye)
    if source is None:
        return False
    bodies = stacked([body])
    size = np.abs(bodies.points).max() + bodies.radii.max()
    found = (_shadow_of(surface.of("shape"), source) for surface in surfaces)
    return any(
        bool((shadow.least(bodies) > _DEEP * (shadow.size + size)).all())
        for shadow in found
        if shadow is not None
    )


def _eye_as_source(eye: Eye) -> Source | None:
    """An eye at one place is treated as a light: no pixel sees the points in its full shadow."""
    if eye.everywhere or eye.parallel or eye.size > 0:
        return None
    one, body = np.ones(1), (eye.place[None], np.zeros(1))
    return Source(one, body[0], body[1], one, None, body, "place")


def _shadow_of(shape: Ends[Shape], source: Source) -> _Shadow | None:
    """None without a full shadow: for a shape that is not flat or may move, for a sky, and for a
    light that is not entirely on one side."""
    plane = plane_between(shape)
    if plane is None:
        return None
    origin, normal = plane
    if source.body is not None and not source.body[1].any():
        ends = source.body[0]
        above = (ends - origin) @ normal
    elif source.kind == "direction" and not source.size.any():
        ends, above = None, source.places @ normal
    else:
        return None
    side, rim = np.sign(above[0]), _rim(shape.low)
    size = float(np.abs(rim if len(rim) else origin).max())
    along = np.roll(rim, -1, axis=0) - rim
    if (
        not np.all(side * above > _DEEP * (size if ends is None else np.abs(ends).max() + size))
        or (np.linalg.norm(along, axis=1) <= _DEEP * size).any()
    ):
        return None
    toward = source.places[0] if ends is None else ends[:, None] - rim
    across = np.cross(along, toward)
    through = np.broadcast_to(rim, across.shape).reshape(-1, 3)
    across = unit(across).reshape(-1, 3)
    if len(rim):
        across = across * np.sign(((rim.mean(0) - through) * across).sum(1))[:, None]
    normals = np.concatenate([-side * normal[None], across])
    return _Shadow(normals, (normals * np.concatenate([origin[None], through])).sum(1), size)


def _rim(shape: Shape) -> np.ndarray:
    """(m, 3) m, the corners of a polygon inside a flat shape, in order; none for an endless
    plane."""
    match shape:
        case Quad():
            corner, u, v = (numbers(x) for x in (shape.corner, shape.edge_u, shape.edge_v))
            return corner + np.stack([0 * u, u, u + v, v])
        case Disc():
            return disc_polygon(shape, within=True)
    return np.zeros((0, 3))


def _beyond(
    cells: Cells, of_ball: np.ndarray, shadow: _Shadow, least: np.ndarray, deep: np.ndarray
) -> np.ndarray:
    """Return (c,), whether a cell is beyond the occluder. It is False in the plane of the occluder,
    where their order is unknown. A cell of a ball, or a flat one, may touch the occluder."""
    normal, offset = shadow.normals[0], shadow.offsets[0]
    lean = np.sqrt(np.maximum(1 - (cells.axis @ normal) ** 2, 0))
    share = np.where(of_ball, 1.0, np.where(cells.spread == 0, lean, 0.0))
    reach = share * np.where(np.isinf(cells.radius), 0, cells.radius)
    return np.maximum(least, cells.centre @ normal - offset + reach) > deep
