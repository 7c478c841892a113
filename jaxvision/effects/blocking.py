"""Find which surfaces may lie between a light and a surface. If the answer is `False`, the surface
certainly does not block the light.

A one-sided convex surface does not shade itself. The outer side of a convex body does not shade
itself either. A ball or box that contains both lamp and receiver, such as a room, blocks nothing
between them, because it is convex. An occluder also blocks nothing if the plane of the lamp, the
receiver or the occluder separates the other two, in one of three ways. A flat occluder has lamp and
receiver on the same side, or in its plane. A flat receiver has the lamp or the occluder behind it.
A flat lamp has the receiver or the occluder behind it. In all other cases, an occluder blocks
nothing if it is disjoint from the convex hull of lamp and receiver (`bodies.gap`). A point within a
few rounding errors of a plane is treated as a point of the plane. Rays skip surfaces within the
much larger distance `geometry.offset_length`, so no ray meets the plane there either. Lengths in m.
"""

from collections.abc import Sequence

import jax
import numpy as np

from ..core._bounds import Ends, cached
from ..scene import Box, Sphere, Surface, TriangleMesh
from ..scene.shapes import Shape
from .bodies import (
    DIRECTIONS,
    Bodies,
    body_of,
    faces_of,
    gap,
    heights,
    hulls,
    is_closed,
    numbers,
    plane_of,
    select_bodies,
    stacked,
    surface_bodies,
    unit,
)
from .boxes import same
from .illumination import Source

_ROUNDINGS = 4.0  # relative rounding error of a coordinate, for shapes that touch a plane
_SEPARATION = 32.0  # float64 roundings by which disjoint bodies must be separated
_LIGHT_DISTANCE = 4  # distance, over the reach, at which a light at infinity is placed
_BATCH = 1 << 15
_FACES = 2000  # faces of a mesh, up to which its convexity is tested


def reach_of(surfaces: Sequence[Ends[Surface]], sources: Sequence[Source]) -> float:
    """Return the largest distance, m, of bounded surfaces and lights from the origin."""
    bodies = [body_of(surface.field("shape")) for surface in surfaces]
    bodies += [source.body for source in sources]
    far = [
        np.linalg.norm(p, axis=1).max() + r.max() for b in bodies if b is not None for p, r in [b]
    ]
    return float(max([*far, 1e-9]))


def touching(surfaces: Sequence[Ends[Surface]]) -> float:
    """Return the relative distance, a few ULP, within which shapes count as touching."""
    leaves = jax.tree.leaves([surface.low.shape for surface in surfaces])
    kinds = {leaf.dtype for leaf in leaves if np.issubdtype(leaf.dtype, np.floating)}
    return _ROUNDINGS * max(float(np.finfo(kind).eps) for kind in kinds)


@cached
def is_convex(shape: Ends[Shape]) -> bool:
    """Return whether a shape is a convex body without separate shading normals. The result is True
    for balls and boxes. For a closed mesh without shading normals, the result is True if all
    vertices lie below the plane of each face, within a few rounding errors."""
    mesh = shape.low
    if not isinstance(mesh, TriangleMesh):
        return isinstance(mesh, Sphere | Box)
    if mesh.normals is not None or len(mesh.faces) > _FACES or not is_closed(shape):
        return False
    places, faces = numbers(mesh.vertices), faces_of(mesh)
    first, second, third = np.moveaxis(places[faces], 1, 0)
    normal, places = unit(np.cross(second - first, third - first)), places[np.unique(faces)]
    over = places @ normal.T - (first * normal).sum(1)
    size = np.abs(places) @ np.abs(normal.T) + (np.abs(first) * np.abs(normal)).sum(1)
    return bool((over <= _ROUNDINGS * float(np.finfo(mesh.vertices.dtype).eps) * size).all())


def certain(reach: float) -> float:
    """Return the largest float64 rounding error, in m, of sums of coordinates up to `reach`."""
    return _SEPARATION * float(np.finfo(np.float64).eps) * reach


def slack_over(
    bodies: Bodies, point: np.ndarray, normal: np.ndarray, relative: float
) -> np.ndarray:
    """Return the largest rounding error, (n,) m, of each body's height above a plane."""
    size = (np.abs(bodies.points) @ np.abs(normal) + bodies.radii).max(1)
    return relative * (size + np.abs(point) @ np.abs(normal))


def _extent(
    bodies: Bodies, bounded: np.ndarray, own: dict[int, tuple], plane: tuple, relative: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the smallest and the largest height of each body above a plane, in m. Heights smaller
    than their rounding error become 0. For an unbounded plane that is parallel to the given plane,
    the two heights are equal."""
    point, normal = plane
    slack, over = slack_over(bodies, point, normal, relative), (bodies.points - point) @ normal
    high, low = (over + bodies.radii).max(1), (over - bodies.radii).min(1)
    high, low = (np.where(np.abs(x) <= slack, 0, x) for x in (high, low))
    for i in map(int, np.flatnonzero(~bounded)):
        parallel = i in own and np.linalg.norm(np.cross(own[i][1], normal)) < 1e-12
        low[i], high[i] = -np.inf, np.inf
        if parallel:
            height = (own[i][0] - point) @ normal
            off = relative * (np.abs(own[i][0]) + np.abs(point)) @ np.abs(normal)
            low[i] = high[i] = 0 if abs(height) <= off else height
    return low, high


def _height_range(source: Source, plane: tuple, relative: float) -> tuple[float, float]:
    """Return the smallest and largest height of a light above a plane, m, as `_extent` does."""
    if source.body is not None:
        (low,), (high,) = _extent(stacked([source.body]), np.ones(1, bool), {}, plane, relative)
        return low, high
    if source.kind == "direction":
        along = float(source.places[0] @ plane[1])
        slack = float(np.sin(min(source.size[0], np.pi / 2)))
        low = np.inf if along > slack else 0.0 if along >= slack else -np.inf
        high = -np.inf if along < -slack else 0.0 if along <= -slack else np.inf
        return low, high
    return -np.inf, np.inf


def may_block(
    sources: Sequence[Source],
    surfaces: Sequence[Ends[Surface]],
    *,
    occluders: Sequence[int] | None = None,
    wanted: np.ndarray | None = None,
) -> np.ndarray:
    """Return whether each surface can lie between a light and a lit point of another surface: flags
    (lights, receivers, occluders). A surface whose flag is False certainly does not block the
    light, up to the rounding of coordinates. `occluders` are the indices of the surfaces that may
    block light, all if None. `wanted`, (lights, receivers), flags the pairs that matter, all if
    None."""
    n = len(surfaces)
    may = np.zeros((len(sources), n, n), bool)
    may[:, :, list(range(n)) if occluders is None else list(occluders)] = True
    if wanted is not None:
        may &= wanted[:, :, None]
    for i, surface in enumerate(surfaces):
        kind, two_sided = type(surface.low.shape), surface.low.two_sided
        solid = kind in (Sphere, Box, TriangleMesh)
        may[:, i, i] &= solid and (two_sided or not is_convex(surface.field("shape")))
    reach = reach_of(surfaces, sources)
    bodies, bounded = surface_bodies(surfaces)
    flat = {i: plane_of(surface.field("shape")) for i, surface in enumerate(surfaces)}
    planes = {i: plane for i, plane in flat.items() if plane is not None}
    relative = touching(surfaces)
    for i, plane in planes.items():
        low, high = _extent(bodies, bounded, planes, plane, relative)
        for k, source in enumerate(sources):
            light_low, light_high = _height_range(source, plane, relative)
            above, below = light_low >= 0, light_high <= 0
            # as an occluder: lamp and receiver on one closed side
            may[k, above & (low >= 0), i] = False
            may[k, below & (high <= 0), i] = False
            # as a receiver: lamp and occluder on different closed sides
            may[k, i, below & (low >= 0)] = False
            may[k, i, above & (high <= 0)] = False
            if not surfaces[i].low.two_sided:
                may[k, i, high <= 0] = False
                may[k, i, :] &= not below
    for k, source in enumerate(sources):
        if source.normal is not None and source.body is not None:
            plane = source.body[0][0], source.normal
            _, high = _extent(bodies, bounded, planes, plane, relative)
            behind = high <= (-source.size[0] if source.kind == "place" else 0)
            may[k, behind, :] = False
            may[k, :, behind] = False
    lamps = [k for k, source in enumerate(sources) if source.body is not None]
    places = stacked([body for source in sources if (body := source.body) is not None])
    for i, surface in enumerate(surfaces):
        around = _are_inside(surface, places, relative, reach, strictly=True)
        if around.any():
            inside = _are_inside(surface, bodies, relative, reach) & bounded
            inside[i] = True
            may[np.ix_(np.array(lamps)[around], np.flatnonzero(inside), np.array([i]))] = False
    _exclude_disjoint(may, sources, bodies, bounded, reach)
    return may


def _are_inside(
    surface: Ends[Surface], bodies: Bodies, relative: float, reach: float, *, strictly: bool = False
) -> np.ndarray:
    """Return flags, (n,): whether each body lies inside a given ball or box. The flags are False if
    a parameter of the ball or box is free. Unless `strictly`, a body may touch the sides of a box
    from inside. `relative` is the tolerated relative rounding error of coordinates."""
    shape = surface.low.shape
    if not same(*surface.field("shape")) or not isinstance(shape, Sphere | Box):
        return np.zeros(len(bodies.points), bool)
    away, slack = bodies.points - numbers(shape.centre), certain(reach)
    if isinstance(shape, Sphere):
        far = (np.linalg.norm(away, axis=2) + bodies.radii).max(1)
        return far + slack < float(shape.radius)
    axes = np.eye(3) if shape.rotation is None else numbers(shape.rotation)
    far = (np.abs(away @ axes.T) + bodies.radii[..., None]).max(1)
    size = (np.abs(bodies.points).max(2) + bodies.radii).max(1) + np.abs(
        numbers(shape.centre)
    ).max()
    room = numbers(shape.half_extents)
    return (far + slack < room if strictly else far <= room + relative * size[:, None]).all(1)


def _exclude_disjoint(
    may: np.ndarray,
    sources: Sequence[Source],
    bodies: Bodies,
    bounded: np.ndarray,
    reach: float,
) -> None:
    """Clear the flags in `may` of occluders disjoint from the convex hull of light and receiver."""
    n, tolerance = len(bounded), certain(_LIGHT_DISTANCE * reach)
    for k, source in enumerate(sources):
        if source.kind == "sky":
            continue
        pairs = may[k] & bounded[:, None] & bounded & ~np.eye(n, dtype=bool)
        if not pairs.any():
            continue
        lit = swept(source, bodies, reach)
        # first along fixed directions, then by search for the remaining triples
        high, low = heights(lit, DIRECTIONS).T.copy(), -heights(bodies, -DIRECTIONS).T.copy()
        clear, rows = np.zeros((n, n), bool), -(-_BATCH // n)
        for start in range(0, n, rows):
            part = slice(start, start + rows)
            for top, bottom in zip(high, low, strict=True):
                clear[part] |= bottom - top[part, None] > tolerance
        receiver, occluder = np.nonzero(pairs & ~clear)
        found = gap(select_bodies(lit, receiver), select_bodies(bodies, occluder), enough=tolerance)
        clear[receiver, occluder] = found > tolerance
        may[k] &= ~(pairs & clear)


def swept(source: Source, bodies: Bodies, reach: float) -> Bodies:
    """Return the convex hull of each body and the light. A light at infinity is replaced by a copy
    of the body, far away in the light's direction."""
    if source.body is not None:
        points, radii = source.body
        each = len(bodies.points)
        lamp = Bodies(np.tile(points, (each, 1, 1)), np.tile(radii, (each, 1)))
        return hulls(bodies, lamp)
    far = _LIGHT_DISTANCE * reach
    wide = far * np.tan(min(float(source.size[0]), 1.5))
    return hulls(bodies, Bodies(bodies.points + far * source.places[0], bodies.radii + wide))
