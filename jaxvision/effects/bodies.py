"""Convex bodies, lower bounds on the distance between two of them, and their convex hulls.

A body is the convex hull of balls. A box is given by eight points, a sphere by one ball, and a disc
by the polygon around it. For every unit vector u, the distance of two bodies is at least the
smallest u.x of a point x of one body minus the largest u.x of a point x of the other body.
Gilbert's algorithm searches for the u with the largest such bound. A search that stops early gives
a smaller bound, which is still valid. Source: Gilbert, "An Iterative Procedure for Computing the
Minimum of a Quadratic Form on a Convex Set", SIAM J. Control 4(1) (1966). Lengths are in m, and
NumPy computes in float64.
"""

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from ..core._bounds import SIGNS, Ends, box_corners, cached, numbers, unit
from ..scene import Box, Disc, Plane, Quad, Sphere, Surface, TriangleMesh
from ..scene.shapes import Shape
from .boxes import same

_SIDES = 16  # sides of the polygon around a disc, which is 2 % wider
_AXES = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
DIRECTIONS = _AXES / np.linalg.norm(_AXES, axis=1, keepdims=True)  # (26, 3)

_STEPS = 48  # steps of Gilbert's algorithm
_BATCH = 1 << 14  # pairs


class Bodies(NamedTuple):
    """A batch of n bodies, each the convex hull of p balls."""

    points: np.ndarray  # (n, p, 3) m; a body with fewer balls repeats its last
    radii: np.ndarray  # (n, p) m


def tangents(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two unit vectors that are perpendicular to a unit normal, (3,), and to each other."""
    first = unit(np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))]))
    return first, np.cross(normal, first)


def disc_polygon(shape: Disc, *, within: bool = False) -> np.ndarray:
    """Return the corners, (n, 3) m, of a regular polygon around a disc, or inside it if
    `within`."""
    first, second = tangents(unit(numbers(shape.normal)))
    turn = 2 * np.pi * np.arange(_SIDES) / _SIDES
    around = np.outer(np.cos(turn), first) + np.outer(np.sin(turn), second)
    wider = 1.0 if within else 1 / np.cos(np.pi / _SIDES)
    return numbers(shape.centre) + numbers(shape.radius) * wider * around


def corners(shape: Shape) -> np.ndarray | None:
    """Return points, (n, 3) m, whose convex hull contains a shape, or None for an unbounded plane.
    For balls and large meshes they are the corners of the bounding box."""
    match shape:
        case Sphere():
            return numbers(shape.centre) + SIGNS * numbers(shape.radius)
        case Quad():
            corner, u, v = (numbers(x) for x in (shape.corner, shape.edge_u, shape.edge_v))
            return corner + np.stack([0 * u, u, v, u + v])
        case Disc():
            return disc_polygon(shape)
        case Box():
            axes = np.eye(3) if shape.rotation is None else numbers(shape.rotation)
            return numbers(shape.centre) + (SIGNS * numbers(shape.half_extents)) @ axes
        case TriangleMesh():
            vertices = numbers(shape.vertices)
            if len(vertices) <= len(SIGNS):
                return vertices
            low, high = vertices.min(0), vertices.max(0)
            return (low + high) / 2 + SIGNS * (high - low) / 2
    return None


@cached
def body_of(shape: Ends[Shape]) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the centres, (p, 3) m, and radii, (p,) m, of balls whose convex hull contains a shape
    for all values of its free parameters. The result is None for an unbounded plane, and for a
    shape whose rotation is a free parameter."""
    low, high = shape
    if isinstance(low, Sphere) and isinstance(high, Sphere):
        points = box_corners(numbers(low.centre), numbers(high.centre))
        return points, np.full(len(points), float(high.radius))
    if isinstance(low, Plane):
        return None
    if not all(same(*(getattr(end, n, None) for end in shape)) for n in ("rotation", "normal")):
        return None
    if isinstance(low, Box | Disc) and isinstance(high, Box | Disc):  # the largest, at each centre
        middles = box_corners(numbers(low.centre), numbers(high.centre))
        about = numbers(corners(high)) - numbers(high.centre)
        points = (middles[:, None] + about).reshape(-1, 3)
    else:  # corners are sums of fields, so their extremes are at those of all fields
        points = box_corners(*(numbers(corners(end)) for end in shape))
    return points, np.zeros(len(points))


def faces_of(mesh: TriangleMesh) -> np.ndarray:
    """Return the vertex indices of the faces of a mesh, (faces, 3), clipped to valid indices."""
    return np.clip(np.asarray(mesh.faces), 0, len(mesh.vertices) - 1)


@cached
def is_closed(shape: Ends[Shape]) -> bool:
    """Return whether a shape bounds a solid body with outward normals. The result is True for balls
    and boxes, and for a fixed mesh in which each edge is used once in each direction and each
    connected part has positive volume. A mesh is assumed not to intersect itself."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    low, high = shape
    if isinstance(low, Sphere | Box):
        return True
    if not isinstance(low, TriangleMesh) or low is not high:
        return False
    places, same = np.unique(numbers(low.vertices), axis=0, return_inverse=True)
    faces = same.reshape(-1)[faces_of(low)]
    faces = faces[[len(set(face)) == 3 for face in faces.tolist()]]
    sides = np.concatenate([np.roll(faces, -k, axis=1)[:, :2] for k in range(3)])
    count = len(places)
    there, back = (np.unique(sides @ np.array(way)) for way in ([count, 1], [1, count]))
    if len(there) < len(sides) or not np.array_equal(there, back):
        return False
    graph = coo_array((np.ones(len(sides)), sides.T), shape=(count, count))
    part = connected_components(graph, directed=False)[1][faces[:, 0]]
    a, b, c = ((places - places.mean(0))[corner] for corner in faces.T)
    volumes = np.bincount(part, np.einsum("fk,fk->f", a, np.cross(b, c)))
    return bool((volumes[np.unique(part)] > 0).all())


@cached
def plane_of(shape: Ends[Shape]) -> tuple[np.ndarray, np.ndarray] | None:
    """Return a point, m, and the unit normal of a flat shape without free parameters, or None."""
    if shape.low is not shape.high:
        return None
    match shape.low:
        case Quad(corner=corner, edge_u=u, edge_v=v):
            return numbers(corner), unit(np.cross(numbers(u), numbers(v)))
        case Disc(centre=centre, normal=normal) | Plane(point=centre, normal=normal):
            return numbers(centre), unit(numbers(normal))
    return None


def stacked(bodies: Sequence[tuple[np.ndarray, np.ndarray]]) -> Bodies:
    """Combine bodies into one batch, in which smaller bodies repeat their last ball."""
    most = max((len(points) for points, _ in bodies), default=1)
    points, radii = np.zeros((len(bodies), most, 3)), np.zeros((len(bodies), most))
    for i, (own, size) in enumerate(bodies):
        points[i, : len(own)], points[i, len(own) :] = own, own[-1]
        radii[i, : len(own)], radii[i, len(own) :] = size, size[-1]
    return Bodies(points, radii)


def surface_bodies(surfaces: Sequence[Ends[Surface]]) -> tuple[Bodies, np.ndarray]:
    """Return the bodies of all surfaces, and (n,) whether each surface is bounded. The body of an
    unbounded surface is arbitrary."""
    found = [body_of(surface.field("shape")) for surface in surfaces]
    ball = np.zeros((1, 3)), np.ones(1)
    bodies = stacked([ball if body is None else body for body in found])
    return bodies, np.array([body is not None for body in found])


def bounding_balls(bodies: Bodies) -> tuple[np.ndarray, np.ndarray]:
    """Return the centres, (n, 3) m, and radii, (n,) m, of balls that contain the bodies."""
    middle = (bodies.points.min(1) + bodies.points.max(1)) / 2
    away = np.linalg.norm(bodies.points - middle[:, None], axis=2)
    return middle, (away + bodies.radii).max(1)


def select_bodies(bodies: Bodies, index: np.ndarray) -> Bodies:
    """Select bodies of a batch by index."""
    return Bodies(bodies.points[index], bodies.radii[index])


def hulls(a: Bodies, b: Bodies) -> Bodies:
    """Return the convex hull of each pair of bodies."""
    return Bodies(np.concatenate([a.points, b.points], 1), np.concatenate([a.radii, b.radii], 1))


def heights(bodies: Bodies, directions: np.ndarray) -> np.ndarray:
    """Return the largest u.x over each body, (n, d) m, for d unit vectors u, (d, 3)."""
    return (bodies.points @ directions.T + bodies.radii[..., None]).max(1)


def _farthest(bodies: Bodies, direction: np.ndarray) -> np.ndarray:
    """Return the point of each body that is farthest along the body's unit direction, (n, 3) m."""
    height = np.einsum("npk,nk->np", bodies.points, direction) + bodies.radii
    best, row = height.argmax(1), np.arange(len(height))
    return bodies.points[row, best] + bodies.radii[row, best, None] * direction


def gap(a: Bodies, b: Bodies, *, enough: float = np.inf) -> np.ndarray:
    """Return a lower bound on the distance between the two bodies of each pair, (n,) m; 0 if no
    positive bound was found.

    The search for a larger bound stops at a bound above `enough`, in m.
    """
    found = np.zeros(len(a.points))
    for start in range(0, len(found), _BATCH):
        part = np.arange(start, min(start + _BATCH, len(found)))
        found[part] = _gap(select_bodies(a, part), select_bodies(b, part), enough)
    return found


def _gap(a: Bodies, b: Bodies, enough: float) -> np.ndarray:
    apart = -heights(a, -DIRECTIONS) - heights(b, DIRECTIONS)
    best = np.maximum(apart.max(1), 0)
    first = DIRECTIONS[apart.argmax(1)]
    v = _farthest(a, -first) - _farthest(b, first)
    older = v.copy()
    active = np.flatnonzero(best <= enough)
    for _ in range(_STEPS):
        if not active.size:
            break
        own_a, own_b, own = select_bodies(a, active), select_bodies(b, active), v[active]
        length = np.linalg.norm(own, axis=1)
        u = own / np.where(length > 0, length, 1)[:, None]
        w = _farthest(own_a, -u) - _farthest(own_b, u)
        bound = np.einsum("nk,nk->n", u, w)
        best[active] = np.maximum(best[active], np.where(length > 0, bound, 0))
        v[active] = _nearest_of_triangle(own, w, older[active])
        older[active] = w
        open_ = (best[active] < length * (1 - 1e-4)) & (best[active] <= enough)
        active = active[open_ & (length > 0)]
    return best


def _nearest_of_triangle(v: np.ndarray, w: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the point nearest to the origin in each triangle v, w, x, (n, 3) each. With x, a point
    of an earlier step, Gilbert's algorithm does not alternate between two points."""
    p, q = w - v, x - v
    pp, pq, qq = (np.einsum("nk,nk->n", s, t) for s, t in ((p, p), (p, q), (q, q)))
    vp, vq = np.einsum("nk,nk->n", v, p), np.einsum("nk,nk->n", v, q)
    det = pp * qq - pq * pq
    whole = det > 1e-12 * pp * qq
    safe = np.where(whole, det, 1)
    s, t = (pq * vq - qq * vp) / safe, (pq * vp - pp * vq) / safe
    inside = whole & (s >= 0) & (t >= 0) & (s + t <= 1)
    options = np.stack(
        [nearest_on_segment(v, w), nearest_on_segment(v, x), nearest_on_segment(w, x)]
    )
    side = (options**2).sum(-1).argmin(0)
    on_side = options[side, np.arange(len(v))]
    return np.where(inside[:, None], v + s[:, None] * p + t[:, None] * q, on_side)


def nearest_on_segment(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the point nearest to the origin on each segment from a to b, (n, 3) each."""
    along = b - a
    square = np.einsum("nk,nk->n", along, along)
    t = -np.einsum("nk,nk->n", a, along) / np.where(square > 0, square, 1)
    return a + np.clip(t, 0, 1)[:, None] * along
