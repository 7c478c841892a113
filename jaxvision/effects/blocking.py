"""Which surfaces may come between a light and a surface: `False` is certain.

A one-sided convex surface does not shade itself. Nothing is blocked where lamp, receiver and
occluder are parted by the plane of one of them: both of the others on one closed side of a flat
occluder, the lamp or the occluder behind a flat receiver, the receiver or the occluder behind the
lamp. Elsewhere the hull of lamp and receiver and the occluder must be apart (`bodies.gap`). Lengths
in m.
"""

from collections.abc import Sequence

import numpy as np

from ..scene import Box, Sphere, Surface, TriangleMesh
from .bodies import DIRECTIONS, Bodies, body_of, gap, heights, hulls, stacked, taken
from .cells import plane_between
from .illumination import Source
from .stages import Ends

TOUCHING = 1e-6  # of the scene's reach: nearer to a plane than that is in it
_AT_ONCE = 1 << 15


def reach_of(surfaces: Sequence[Ends[Surface]], sources: Sequence[Source]) -> float:
    """m, the largest distance of anything bounded from the origin."""
    bodies = [body_of(surface.of("shape")) for surface in surfaces]
    bodies += [source.body for source in sources]
    far = [
        np.linalg.norm(p, axis=1).max() + r.max() for b in bodies if b is not None for p, r in [b]
    ]
    return float(max([*far, 1e-9]))


def _parts(
    surfaces: Sequence[Ends[Surface]], reach: float
) -> tuple[Bodies, np.ndarray, dict[int, tuple[np.ndarray, np.ndarray]]]:
    """The bodies of all surfaces, which of them are bounded, and the planes of the flat ones."""
    found = [body_of(surface.of("shape")) for surface in surfaces]
    bounded = np.array([body is not None for body in found])
    endless = np.zeros((1, 3)), np.full(1, 1e3 * reach)
    bodies = stacked([endless if body is None else body for body in found])
    planes = {i: plane_between(surface.of("shape")) for i, surface in enumerate(surfaces)}
    return bodies, bounded, {i: plane for i, plane in planes.items() if plane is not None}


def _extent(
    bodies: Bodies, bounded: np.ndarray, own: dict[int, tuple], plane: tuple
) -> tuple[np.ndarray, np.ndarray]:
    """The least and the largest height of each body over a plane, m; an endless plane parallel to
    it has one height."""
    point, normal = plane
    moved = Bodies(bodies.points - point, bodies.radii)
    high, low = heights(moved, normal[None])[:, 0], -heights(moved, -normal[None])[:, 0]
    for i in map(int, np.flatnonzero(~bounded)):
        parallel = i in own and np.linalg.norm(np.cross(own[i][1], normal)) < 1e-12
        low[i], high[i] = -np.inf, np.inf
        if parallel:
            low[i] = high[i] = (own[i][0] - point) @ normal
    return low, high


def _of_light(source: Source, plane: tuple, reach: float) -> tuple[float, float]:
    """The least and the largest height of a light over a plane, m."""
    point, normal = plane
    if source.body is not None:
        points, radii = source.body
        over = (points - point) @ normal
        return float((over - radii).min()), float((over + radii).max())
    if source.kind == "direction":
        along, slack = (
            float(source.places[0] @ normal),
            float(np.sin(min(source.size[0], np.pi / 2))),
        )
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
    """Whether a surface can come between a light and a lit point of a surface.

    Args:
        sources: the lights.
        surfaces: of the scene.
        occluders: numbers of the surfaces that block at all; None: all.
        wanted: (lights, receivers), the pairs that matter; None: all.

    Returns:
        (lights, receivers, occluders); False is certain, to a millionth of the scene's reach, m.
    """
    n = len(surfaces)
    may = np.zeros((len(sources), n, n), bool)
    may[:, :, list(range(n)) if occluders is None else list(occluders)] = True
    if wanted is not None:
        may &= wanted[:, :, None]
    for i, surface in enumerate(surfaces):
        kind, two_sided = type(surface.low.shape), surface.low.two_sided
        may[:, i, i] &= kind is TriangleMesh or (two_sided and kind in (Sphere, Box))
    reach = reach_of(surfaces, sources)
    bodies, bounded, planes = _parts(surfaces, reach)
    tolerance = TOUCHING * reach
    for i, plane in planes.items():
        low, high = _extent(bodies, bounded, planes, plane)
        for k, source in enumerate(sources):
            light_low, light_high = _of_light(source, plane, reach)
            above, below = light_low >= -tolerance, light_high <= tolerance
            # as an occluder: lamp and receiver on one closed side
            may[k, above & (low >= -tolerance), i] = False
            may[k, below & (high <= tolerance), i] = False
            # as a receiver: lamp and occluder on different closed sides
            may[k, i, below & (low >= -tolerance)] = False
            may[k, i, above & (high <= tolerance)] = False
            if not surfaces[i].low.two_sided:
                may[k, i, high <= tolerance] = False
                may[k, i, :] &= not below
    for k, source in enumerate(sources):
        if source.normal is not None and source.body is not None:
            plane = source.body[0][0], source.normal
            slack = source.size[0] if source.kind == "place" else 0.0
            _, high = _extent(bodies, bounded, planes, plane)
            behind = high <= tolerance - slack
            may[k, behind, :] = False
            may[k, :, behind] = False
    _apart(may, sources, bodies, bounded, reach, tolerance)
    return may


def _apart(
    may: np.ndarray,
    sources: Sequence[Source],
    bodies: Bodies,
    bounded: np.ndarray,
    reach: float,
    tolerance: float,
) -> None:
    """Clears the triples whose occluder is apart from the hull of lamp and receiver."""
    n = len(bounded)
    for k, source in enumerate(sources):
        if source.kind == "sky":
            continue
        receiver, occluder = np.nonzero(
            may[k] & bounded[:, None] & bounded & ~np.eye(n, dtype=bool)
        )
        if not receiver.size:
            continue
        lit = swept(source, bodies, reach)
        # first along fixed directions, then by search for what is left
        high, low = heights(lit, DIRECTIONS), -heights(bodies, -DIRECTIONS)
        clear = np.zeros(len(receiver), bool)
        for start in range(0, len(receiver), _AT_ONCE):
            part = slice(start, start + _AT_ONCE)
            clear[part] = (low[occluder[part]] - high[receiver[part]]).max(1) > tolerance
        rest = np.flatnonzero(~clear)
        found = gap(taken(lit, receiver[rest]), taken(bodies, occluder[rest]), enough=tolerance)
        clear[rest] = found > tolerance
        may[k, receiver[clear], occluder[clear]] = False


def swept(source: Source, bodies: Bodies, reach: float) -> Bodies:
    """The hull of each body and a light; toward a light that is infinitely far away, the body moved
    beyond all others."""
    if source.body is not None:
        points, radii = source.body
        each = len(bodies.points)
        lamp = Bodies(np.tile(points, (each, 1, 1)), np.tile(radii, (each, 1)))
        return hulls(bodies, lamp)
    far = 4 * reach
    wide = far * np.tan(min(float(source.size[0]), 1.5))
    return hulls(bodies, Bodies(bodies.points + far * source.places[0], bodies.radii + wide))
