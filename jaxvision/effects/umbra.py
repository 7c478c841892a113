"""Find the cells that may be in a lamp's shadow, and the cells that are certainly in its full
shadow.

A cell cannot be shaded if the convex hull of the cell and the lamp is disjoint from every occluder
that `blocking.may_block` allows. A cell is in the full shadow of a flat occluder under two
conditions. First, the occluder's plane separates the cell from the lamp. Second, for each corner of
the lamp, the cell is inside all planes through that corner and a side of the occluder. Then every
segment from the cell to a corner of the lamp meets the occluder. Segments from the cell to other
points of the lamp also meet the occluder, because they cross its plane within the convex hull of
the points where the segments to the corners cross. The eye is treated like a lamp: cells in the
full shadow of the eye are not seen. Lengths in m.
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
    body_of,
    bounding_balls,
    disc_polygon,
    faces_of,
    gap,
    heights,
    nearest_on_segment,
    numbers,
    plane_of,
    select_bodies,
    stacked,
    surface_bodies,
    unit,
)
from .cells import Cells, Eye, bodies_of, has_face_cells, part_of
from .illumination import Source
from .stages import Ends

_PAIRS = 60_000  # pairs of cells and occluders; in larger scenes whole surfaces are tested
# relative to its coordinates: a cell at most this far beyond an occluder is in its plane
_MARGIN = 1e-4
_SEARCHED_PAIRS = 2000  # pairs for which the best separating direction is searched


def shaded(
    sources: Sequence[Source],
    surfaces: Sequence[Ends[Surface]],
    cells: Cells,
    *,
    may: np.ndarray,
    wanted: np.ndarray,
) -> np.ndarray:
    """Return flags, (l, c): whether anything may lie between a light and a cell, for the pairs
    flagged in `wanted`, (l, c). For a flagged pair, False means that nothing lies between light and
    cell. All other pairs are False. `may`, (l, n, n), is the result of `blocking.may_block`."""
    found = wanted & np.any(may, axis=2)[:, cells.surface]
    count = int((found * may.sum(axis=2)[:, cells.surface]).sum())
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
    """Return whether the convex hull of the light and each cell may intersect an occluder, for
    pairs of cells and occluders. Four tests follow each other: the horizon of a flat cell, the ball
    around the occluder, separating planes with fixed normals, and, for few remaining pairs, the
    best separating plane."""
    cell, occluder = pairs
    tolerance = certain(reach)
    about, size = bounding_balls(occluders)
    hulls = swept(source, bodies_of(cells), reach)
    middle, wide = bounding_balls(Bodies(hulls.points[:, 1:], hulls.radii[:, 1:]))
    apart = np.linalg.norm(
        nearest_on_segment(cells.centre[cell] - about[occluder], middle[cell] - about[occluder]),
        axis=1,
    )
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
    if len(left) <= _SEARCHED_PAIRS:
        i, j = cell[left], occluder[left]
        meets[left] = (
            gap(select_bodies(hulls, i), select_bodies(occluders, j), enough=tolerance) <= tolerance
        )
    return meets


def outward(surfaces: Sequence[Ends[Surface]], cells: Cells) -> np.ndarray:
    """Return the side of a convex body that each cell belongs to, (c,): 1 for the outer side, -1
    for the inner. The result is 0 for other shapes, for shapes with free parameters, and for cells
    that join several triangles of a mesh."""
    side = np.zeros(len(cells.radius))
    for i, surface in enumerate(surfaces):
        shape = surface.low.shape
        if shape is surface.high.shape and is_convex(surface.field("shape")):
            part = part_of(cells, i)
            away = np.sign(((cells.centre[part] - _middle(shape)) * cells.axis[part]).sum(1))
            clear = not isinstance(shape, TriangleMesh) or has_face_cells(shape)
            side[part] = away if clear else 0
    return side


def _middle(shape: Shape) -> np.ndarray:
    """Return a point inside a convex body, (3,) m."""
    if isinstance(shape, TriangleMesh):
        return numbers(shape.vertices)[np.unique(faces_of(shape))].mean(0)
    assert isinstance(shape, Sphere | Box)
    return numbers(shape.centre)


def hidden(surfaces: Sequence[Ends[Surface]], cells: Cells, eye: Eye) -> np.ndarray:
    """Return flags, (c,): whether a cell is certainly invisible to the eye. Such a cell is on the
    inner side of a convex body with the eye outside, or entirely behind one flat surface."""
    inner = outward(surfaces, cells) < 0
    if eye.everywhere:
        return inner & False
    for i in np.unique(cells.surface[inner]):
        body = body_of(surfaces[i].field("shape"))
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
    return inner if source is None else inner | umbra_flags([source], surfaces, cells)[0]


class _Shadow(NamedTuple):
    """The full shadow of one flat occluder, as an intersection of half-spaces."""

    normals: np.ndarray  # (h, 3) unit, inward; the first is that of the occluder's own plane
    offsets: np.ndarray  # (h,) m
    size: float  # m, the largest coordinate of its rim

    def least(self, bodies: Bodies) -> np.ndarray:
        """Return the smallest signed distance of a point of each body from the border of each
        half-space, positive inside, (n, h) m."""
        return -heights(bodies, -self.normals) - self.offsets


def umbra_flags(
    sources: Sequence[Source],
    surfaces: Sequence[Ends[Surface]],
    cells: Cells,
    *,
    occluders: Sequence[int] | None = None,
) -> np.ndarray:
    """Return flags, (l, c): whether a whole cell is in the full shadow that one flat occluder
    casts; lengths in m. A cell whose flag is True is certainly in full shadow, up to the rounding
    of coordinates. `occluders` are the indices of the surfaces that may block light, all if
    None."""
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
            shadow = _shadow_of(surfaces[j].field("shape"), source)
            if shadow is None:
                continue
            deep = _MARGIN * (shadow.size + of_body)
            farthest = heights(whole, shadow.normals[:1])[:, 0] - shadow.offsets[0]
            some = (farthest > deep)[cells.surface] & bounded & (cells.surface != j) & ~dark[k]
            if not some.any():
                continue
            there = Cells(*(x[some] for x in cells))
            least = np.maximum(shadow.least(whole)[there.surface], shadow.least(bodies_of(there)))
            size = shadow.size + of_cell[some]
            inside = (least >= -relative * size[:, None]).all(1)
            beyond = _is_past_occluder(
                there, balls[there.surface], shadow, least[:, 0], _MARGIN * size
            )
            dark[k, some] = inside & beyond
    return dark


def covered(
    body: tuple[np.ndarray, np.ndarray], eye: Eye, surfaces: Sequence[Ends[Surface]]
) -> bool:
    """Return whether one flat surface hides a whole body from an eye that is a point. The body is
    given by points (p, 3) m and radii (p,) m."""
    source = _eye_as_source(eye)
    if source is None:
        return False
    bodies = stacked([body])
    size = np.abs(bodies.points).max() + bodies.radii.max()
    found = (_shadow_of(surface.field("shape"), source) for surface in surfaces)
    return any(
        bool((shadow.least(bodies) > _MARGIN * (shadow.size + size)).all())
        for shadow in found
        if shadow is not None
    )


def _eye_as_source(eye: Eye) -> Source | None:
    """Return a light at the position of the eye, or None if the eye is not a single point. No pixel
    sees a point in the full shadow of this light."""
    if eye.everywhere or eye.parallel or eye.size > 0:
        return None
    one, body = np.ones(1), (eye.place[None], np.zeros(1))
    return Source(one, body[0], body[1], one, None, body, "place")


def _shadow_of(shape: Ends[Shape], source: Source) -> _Shadow | None:
    """Return the full shadow of an occluder, or None if no point is in full shadow. The result is
    None if the occluder is not flat or has free parameters, if the light is a sky, or if the light
    is not entirely on one side of the occluder."""
    plane = plane_of(shape)
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
        not np.all(side * above > _MARGIN * (size if ends is None else np.abs(ends).max() + size))
        or (np.linalg.norm(along, axis=1) <= _MARGIN * size).any()
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
    """Return the corners, (m, 3) m in order, of a polygon inside a flat shape; an unbounded plane
    has no corners."""
    match shape:
        case Quad():
            corner, u, v = (numbers(x) for x in (shape.corner, shape.edge_u, shape.edge_v))
            return corner + np.stack([0 * u, u, u + v, v])
        case Disc():
            return disc_polygon(shape, within=True)
    return np.zeros((0, 3))


def _is_past_occluder(
    cells: Cells, of_ball: np.ndarray, shadow: _Shadow, least: np.ndarray, deep: np.ndarray
) -> np.ndarray:
    """Return flags, (c,): whether the occluder's plane certainly separates a cell from the light.
    The flag is False for cells in the plane of the occluder, because rounding decides on
    which side they are. A cell of a ball, and a flat cell, may touch the occluder."""
    normal, offset = shadow.normals[0], shadow.offsets[0]
    lean = np.sqrt(np.maximum(1 - (cells.axis @ normal) ** 2, 0))
    share = np.where(of_ball, 1.0, np.where(cells.spread == 0, lean, 0.0))
    reach = share * np.where(np.isinf(cells.radius), 0, cells.radius)
    return np.maximum(least, cells.centre @ normal - offset + reach) > deep
