"""Rays and shapes where naive formulas fail: grazing, tangent and parallel rays, origins on the
surface and far away, small and large scenes, thin triangles; both precisions against 50 digits.
"""

from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from oracles import exact
from oracles.exact import dot, length
from precisions import both_precisions, eps

from jaxvision import Ray
from jaxvision.core._numerics import normalize
from jaxvision.core._vector import as_array, as_vec
from jaxvision.geometry import intersect, occluded, offset_origin
from jaxvision.geometry.hemisphere import local_frame, to_world
from jaxvision.scene import Box, Disc, Plane, Quad, Sphere, TriangleMesh

# ------------------------------------------------ shapes, and rays that are aimed at them


def triangle(vertices):
    return TriangleMesh(vertices, np.array([[0, 1, 2]]))


def box(centre, half_extents, rotation):
    return Box(centre, half_extents, rotation=rotation)


MAKE = {
    "sphere": Sphere,
    "plane": Plane,
    "disc": Disc,
    "quad": Quad,
    "box": box,
    "triangle": triangle,
}

UPRIGHT = np.eye(3)
TILTED = np.array([[2, -2, 1], [1, 2, 2], [-2, -1, 2]]) / 3
EDGES = np.array([[2, 0, 0], [0.5, 1, 0]])
SLIVER = np.array([[2, 0, 0], [1.2, 1e-3, 0]])
SCALES = [1e-3, 1.0, 1e4]
WORLDS = [(scale, np.zeros(3)) for scale in SCALES] + [(1.0, np.array([1000.0, -500, 250]))]


def numbers(kind, turn, scale, place, edges):
    """Return the float fields of a shape about `place` of a size near `scale`."""
    centre = scale * place
    match kind:
        case "sphere":
            return centre, np.array(scale)
        case "plane":
            return centre, turn[2]
        case "disc":
            return centre, 3 * turn[2], np.array(scale)
        case "quad":
            return centre, *(scale * edges @ turn)
        case "box":
            return centre, scale * np.array([1, 0.5, 0.25]), turn
        case "triangle":
            return (centre + scale * np.array([np.zeros(3), *edges]) @ turn,)


def target(kind, u, v, edges):
    """Return a point of the surface in the shape's own axes: u = 0 is the rim, less is outside."""
    match kind:
        case "sphere":
            return np.array([u, v, np.sqrt(max(0, 1 - u * u - v * v))])
        case "plane":
            return np.array([u, v, 0])
        case "disc":
            return (1 - u) * np.array([np.cos(6 * v), np.sin(6 * v), 0])
        case "box":
            return np.array([2 * u - 1, v - 0.5, 0.25])
        case _:
            return u * edges[0] + v * edges[1]


# (u, v) of the target, the direction in the shape's own axes, the distance of the start in sizes
RAYS = {
    "straight down": ((0.25, 0.25), (0, 0, -1), 1),
    "slanted": ((0.3, 0.6), (0.6, 0, -0.8), 1),
    "from below": ((0.3, 0.4), (0, 0.6, 0.8), 1),
    "from afar": ((0.25, 0.5), (0, 0.6, -0.8), 1e4),
    "from very near": ((0.25, 0.5), (0.6, 0, -0.8), 1e-3),
    "leaving": ((0.25, 0.5), (0.6, 0, -0.8), -1),
    "starting on it": ((0.25, 0.5), (0, 0.6, -0.8), 0),
    "leaving from it": ((0.25, 0.5), (0, 0.6, 0.8), 0),
    "running along it": ((0.25, 0.5), (1, 0, 0), 0),
    "in its plane": ((0, 0), (1, 0, 0), 3),
    "inside the rim": ((0.001, 0.5), (0.6, 0, -0.8), 1),
    "on the rim": ((0, 0.5), (0, 0.6, -0.8), 1),
    "outside the rim": ((-0.001, 0.5), (0.6, 0, -0.8), 1),
    "at a corner": ((0, 0), (0, 0, -1), 1),
    "grazing": ((0, 0.01), (0.8, 0.6, -0.01), 1),
    "grazing from afar": ((0.25, 0.25), (0.6, 0.8, -0.01), 100),
    "hardly touching": ((0.25, 0.25), (0.6, 0.8, -1e-4), 1),
    "a hair off parallel": ((0.25, 0.25), (1, 0, -1e-9), 1),
    "at a great height": ((0.5, 0.25), (1e-3, 0, -1), 1e3),
}


def cases(kind):
    """Return (names, the shapes' fields stacked, origins, directions) of every ray at every
    shape."""
    rows = []
    for form, turn, edges in (
        ("upright", UPRIGHT, EDGES),
        ("tilted", TILTED, EDGES),
        ("sliver", TILTED, SLIVER),
    ):
        if form == "sliver" and kind not in ("quad", "triangle"):
            continue
        for scale, place in WORLDS:
            for name, ((u, v), way, away) in RAYS.items():
                way = np.array(way) / np.linalg.norm(way)
                start = place + (target(kind, u, v, edges) - away * way) @ turn
                fields = numbers(kind, turn, scale, place, edges)
                label = f"{name}, {form}, {scale:g} m, at {place}"
                rows.append((label, fields, scale * start, way @ turn))
    names, fields, origins, directions = zip(*rows, strict=True)
    return (
        names,
        jax.tree.map(lambda *x: np.stack(x), *fields),
        np.stack(origins),
        np.stack(directions),
    )


# ------------------------------------------------ the same in 50 digits


class Crossing(NamedTuple):
    """A place where a line meets a surface.

    Attributes:
        distance: along the line.
        bound: how far rounding may move the distance, in eps.
        sure: that rounding cannot decide about the hit.
        normal: of the surface there.
        wobble: error of the normal, in eps.
    """

    distance: mp.mpf
    bound: mp.mpf
    sure: bool
    normal: list
    wobble: mp.mpf


def minus(u, v):
    return [a - b for a, b in zip(u, v, strict=True)]


def along(u, v, t):
    return [a + t * b for a, b in zip(u, v, strict=True)]


def cross(u, v):
    return [u[i - 2] * v[i - 1] - u[i - 1] * v[i - 2] for i in range(3)]


def unit(v):
    size = length(v)
    return [c / size for c in v]


def sphere_crossings(o, d, e, centre, radius):
    """Return the crossings with a sphere; the conditioning is that of half the chord, sqrt(r^2 -
    p^2), where p is the closest approach."""
    f = minus(o, centre)
    square = dot(d, d)
    b = -dot(f, d) / square
    chord2 = (radius**2 - dot(along(f, d, b), along(f, d, b))) / square
    reach = length(f) + radius
    unsure = e * radius * reach
    if chord2 <= unsure:
        slack = mp.sqrt(max(0, chord2) + unsure) / e + reach
        return [Crossing(b, slack, False, None, mp.inf)] if chord2 > -unsure else []
    h = mp.sqrt(chord2)
    found = []
    for t in (b - h, b + h):
        bound = reach * (1 + radius / h)
        normal = unit(along(f, d, t))
        found.append(Crossing(t, bound, abs(t) > e * bound, normal, bound / radius))
    return found


def flat_crossings(o, d, e, point, normal, condition, margin):
    """Return the crossings with a plane. `condition`: ratio of the errors of normal and edges.
    `margin(x)`: how far inside x lies."""
    n, way = unit(normal), minus(point, o)
    slope, reach = dot(n, d), length(way) * condition
    if abs(slope) <= e * condition:  # rounding alone may turn it any way
        return [Crossing(mp.mpf(0), mp.inf, False, n, mp.inf)]
    t = dot(n, way) / slope
    bound = (reach + condition * abs(t)) / abs(slope)
    inside = margin(along(o, d, t))
    if inside < -e * bound:
        return []
    return [Crossing(t, bound, inside > e * bound and abs(t) > e * bound, n, condition)]


def weights(x, corner, u, v):
    """Return (s, t, length of s = 1, length of t = 1 across the other edge) of x = corner + s u + t
    v."""
    n = cross(u, v)
    size = dot(n, n)
    f = minus(x, corner)
    s, t = dot(cross(f, v), n) / size, dot(cross(u, f), n) / size
    return s, t, mp.sqrt(size) / length(v), mp.sqrt(size) / length(u)


def edges_crossings(o, d, e, corner, u, v, *, half):
    def margin(x):
        s, t, across_s, across_t = weights(x, corner, u, v)
        if not half:
            return min(min(s, 1 - s) * across_s, min(t, 1 - t) * across_t)
        across = length(cross(u, v)) / length(minus(u, v))
        return min(s * across_s, t * across_t, (1 - s - t) * across)

    n = cross(u, v)
    condition = length(u) * length(v) / length(n)
    return flat_crossings(o, d, e, corner, n, condition, margin)


def box_crossings(o, d, e, centre, half_extents, axes):
    f, found = minus(o, centre), []
    reach = length(f) + length(half_extents)
    for i, axis in enumerate(axes):
        slope = dot(axis, d)
        for side in (-1, 1):
            to_face = side * half_extents[i] - dot(axis, f)
            normal = [side * a for a in axis]
            if abs(slope) <= e:
                if abs(to_face) <= e * reach:
                    found.append(Crossing(mp.mpf(0), mp.inf, False, normal, mp.mpf(1)))
                continue
            t = to_face / slope
            x = along(f, d, t)
            inside = min(half_extents[j] - abs(dot(axes[j], x)) for j in range(3) if j != i)
            bound = (reach + abs(t)) / abs(slope)
            if inside >= -e * bound:
                sure = inside > e * bound and abs(t) > e * bound
                found.append(Crossing(t, bound, sure, normal, mp.mpf(1)))
    return found


def crossings(kind, fields, o, d, e):
    """Return all crossings, the nearest first. `e`: the rounding allowed for, some eps."""
    match kind:
        case "sphere":
            found = sphere_crossings(o, d, e, *fields)
        case "plane":
            found = flat_crossings(o, d, e, *fields, mp.mpf(1), lambda x: mp.inf)
        case "disc":
            centre, normal, radius = fields
            inside = lambda x: radius - length(minus(x, centre))  # noqa: E731
            found = flat_crossings(o, d, e, centre, normal, mp.mpf(1), inside)
        case "quad":
            found = edges_crossings(o, d, e, *fields, half=False)
        case "box":
            found = box_crossings(o, d, e, *fields)
        case "triangle":
            a, b, c = fields[0]
            found = edges_crossings(o, d, e, a, minus(b, a), minus(c, a), half=True)
    ahead = [crossing for crossing in found if crossing.distance > -e * crossing.bound]
    return sorted(ahead, key=lambda crossing: crossing.distance)


def exactly(x):
    """Return the 50-digit value of an array of any rank."""
    return exact.number(x) if np.ndim(x) == 0 else [exactly(row) for row in x]


def which(distance, found, e, name):
    """Return the crossing at a distance, or None for a correct miss."""
    for crossing in found:
        slack = e * crossing.bound
        if distance < mp.inf and abs(distance - crossing.distance) <= slack:
            return crossing
        assert not crossing.sure, f"{name}: {distance}, should be {crossing.distance}"
    assert distance == mp.inf, f"{name}: a hit of nothing at {distance}"
    return None


def height(kind, fields, normal, point):
    """Return the height of a point above the surface that it is known to be near."""
    match kind:
        case "sphere":
            return length(minus(point, fields[0])) - fields[1]
        case "box":
            heights = (dot(normal, minus(point, fields[0])) - h for h in fields[1])
            return min(heights, key=abs)
        case "triangle":
            return dot(normal, minus(point, fields[0][0]))
        case _:
            return dot(normal, minus(point, fields[0]))


# ------------------------------------------------ distances, normals, points, gradients


@cache
def met(kind):
    """Return ((distance, size), (normal, point), the gradient of the distance, that of all the
    rest)."""

    def values(origin, direction, fields):
        hit = intersect(Ray(origin, direction), MAKE[kind](*fields))
        seen = hit.distance < jnp.inf
        return jnp.where(seen, hit.distance, 0), (hit.normal, hit.point), (hit.distance, hit.size)

    def one(origin, direction, fields):
        (distance, rest), pull, kept = jax.vjp(
            lambda *x: (values(*x)[:2], values(*x)[2]), origin, direction, fields, has_aux=True
        )
        nothing, ones = jax.tree.map(jnp.zeros_like, rest), jax.tree.map(jnp.ones_like, rest)
        slopes = pull((jnp.ones_like(distance), nothing))
        others = pull((jnp.zeros_like(distance), ones))
        return kept, rest, slopes, others

    return jax.jit(jax.vmap(one))


# allowed error in eps, in units of each case's conditioning
ALLOWED = 2


@pytest.mark.slow
@both_precisions
@pytest.mark.parametrize("kind", MAKE)
def test_hits_and_their_gradients_against_fifty_digits(dtype, kind):
    """Distance, normal, hit point and d distance / d origin, which is -n / (n.d) for any surface,
    agree with 50 digits; all other gradients are finite, and all gradients of a miss are zero."""
    names, *arrays = cases(kind)
    fields, origins, directions = jax.tree.map(lambda x: jnp.asarray(x, dtype), arrays)
    kept, rest, slopes, others = met(kind)(origins, directions, fields)
    for leaf in jax.tree.leaves((kept, rest, slopes, others)):
        assert leaf.dtype == dtype
    for leaf in jax.tree.leaves((rest, slopes, others)):
        assert jnp.isfinite(leaf).all()

    everything = origins, directions, fields, kept, tuple(map(as_array, rest))
    everything = jax.tree.map(np.asarray, everything)
    slope_of_origin = np.asarray(slopes[0])
    rounding, sure = ALLOWED * eps(dtype), 0
    for i, name in enumerate(names):
        o, d, shape, (distance, size), (normal, point) = jax.tree.map(
            lambda x, i=i: exactly(x[i]), everything
        )
        assert distance > 0, name
        found = crossings(kind, shape, o, d, rounding)
        crossing = which(distance, found, rounding, name)
        if not found:
            assert not any(np.asarray(g[i]).any() for g in jax.tree.leaves(slopes)), name
            assert not any(normal), name
        if crossing is None or not crossing.sure:
            continue
        sure += 1
        n, slope = crossing.normal, dot(crossing.normal, d)
        assert length(minus(normal, n)) <= rounding * crossing.wobble, name
        assert abs(height(kind, shape, n, point)) <= rounding * size, name
        bend = along(exactly(slope_of_origin[i]), n, 1 / slope)
        assert length(bend) * slope**2 <= rounding * crossing.wobble, name
    assert sure > 0.3 * len(names)


PARALLEL = {
    "plane": (np.zeros(3), UPRIGHT[2]),
    "disc": (np.zeros(3), UPRIGHT[2], np.array(1.0)),
    "quad": (np.zeros(3), *EDGES),
    "triangle": (np.array([np.zeros(3), *EDGES]),),
}
NOTHING = {
    "sphere": [(np.zeros(3), np.array(0.0))],
    "plane": [(np.zeros(3), np.zeros(3))],
    "disc": [(np.zeros(3), np.zeros(3), np.array(1.0))],
    "quad": [
        (np.zeros(3), *np.zeros((2, 3))),
        (np.zeros(3), EDGES[0], np.zeros(3)),
        (np.zeros(3), EDGES[0], 2 * EDGES[0]),
        (np.zeros(3), EDGES[0], -EDGES[0]),
    ],
    "triangle": [
        (np.zeros((3, 3)),),
        (np.array([np.zeros(3), EDGES[0], EDGES[0]]),),
        (np.array([np.zeros(3), EDGES[0], 2 * EDGES[0]]),),
    ],
}


def rays_that_meet_nothing(kind):
    """Yield (origin, direction, fields) of rays in the plane of a flat shape, above and below
    it."""
    for scale in SCALES if kind in PARALLEL else []:
        fields = [scale * x if kind == "triangle" else x for x in PARALLEL[kind]]
        for above, way in [(h, 0) for h in (0, 1e-6, -1e-6, 1)] + [(0, 1e-80)]:
            yield scale * np.array([-3, 0.5, above]), np.array([1, 0, way]), tuple(fields)
    for fields in NOTHING.get(kind, []):
        for at in ([0, 0, 0], [0.5, 0, 0], [0.5, 0.25, 0]):
            for way in np.array([[0, 0, -1], [0.6, 0, -0.8], [0, 0.6, 0.8], [1, 0, 0]]):
                yield at - way, way, fields


@pytest.mark.sweep
@both_precisions
@pytest.mark.parametrize("kind", NOTHING)
def test_parallel_rays_and_shapes_without_extent_have_no_hits(dtype, kind):
    """All gradients are finite, and those by the ray are zero."""
    count = len(cases(kind)[0])  # one size of program for all
    rows = jax.tree.map(lambda *x: np.stack(x), *map(list, rays_that_meet_nothing(kind)))
    arrays = jax.tree.map(lambda x: jnp.asarray(np.resize(x, (count, *x.shape[1:])), dtype), rows)
    origins, directions, fields = arrays
    (distance, _), (normal, point), *gradients = met(kind)(origins, directions, tuple(fields))
    assert (distance == jnp.inf).all()
    assert not as_array(normal).any()
    assert (as_array(point) == origins).all()
    assert all(jnp.isfinite(g).all() for g in jax.tree.leaves(gradients))
    assert not any(g.any() for g in jax.tree.leaves(gradients[0][:2]))


# ------------------------------------------------ shadows near a surface


ARRIVING = [(0, 0, -1), (0.6, 0, -0.8), (0.48, 0.64, -0.6)]
LEAVING = [(0, 0, 1), (0.6, 0, 0.8), (0, -0.8, 0.6), (1, 0, 0.02), (-0.28, -0.96, 0.02)]


def shadows(kind):
    """Return a function of a ray that meets the shape, and of a direction about the normal of the
    side that it meets."""

    def one(origin, direction, fields, way, scale):
        shape = MAKE[kind](*fields)
        hit = intersect(Ray(origin, direction), shape)
        side = -jnp.sign(jnp.dot(as_array(hit.normal), direction))
        normal = as_array(hit.normal) * side
        toward = to_world(local_frame(normal), normalize(way))
        slope = jnp.dot(normal, toward)
        near, far = 1e-3 * scale / slope, jnp.full_like(scale, jnp.inf)
        above = Disc(as_array(hit.point) + near * toward, normal, 1e-3 * scale)

        def blocked(distance, *shapes):
            return occluded(hit.point, hit.normal, as_vec(toward), distance, shapes, size=hit.size)

        found = {
            "itself": blocked(far, shape),
            "itself, near": blocked(near, shape),
            "the disc": blocked(far, shape, above),
            "the disc before a near end": blocked(2 * near, shape, above),
            "the disc behind the end": blocked(near / 2, shape, above),
        }
        starts = [
            as_array(offset_origin(hit.point, hit.normal, as_vec(w), size=hit.size))
            for w in (toward, -toward)
        ]
        return as_array(hit.point), normal, starts, found

    return jax.jit(jax.vmap(one))


@pytest.mark.sweep
@pytest.mark.parametrize("kind", MAKE)
def test_a_point_does_not_shade_itself_but_near_occluders_do(kind):
    """In float32, a disc a thousandth of the size above the surface shades the point, and the moved
    starts are truly above and below the surface."""
    rows = [
        (
            scale * (target(kind, u, v, EDGES) - np.array(way)) @ turn,
            np.array(way) @ turn,
            numbers(kind, turn, scale, np.zeros(3), EDGES),
            np.array(on),
            np.array(scale),
        )
        for scale in SCALES
        for turn in (UPRIGHT, TILTED)
        for u, v in ((0.25, 0.25), (0.3, 0.6), (0.01, 0.02))
        for way in ARRIVING
        for on in LEAVING
    ]
    rows = jax.tree.map(lambda *x: np.stack(x).astype(np.float32), *rows)
    points, normals, starts, found = jax.tree.map(np.asarray, shadows(kind)(*rows))
    assert (np.linalg.norm(normals, axis=1) > 0.99).all()
    for name, shaded in found.items():
        expected = name in ("the disc", "the disc before a near end")
        assert (shaded == expected).all(), name
    for i in range(0, len(points), len(LEAVING)):
        fields, n = [exactly(x[i]) for x in rows[2]], exact.vector(normals[i])
        above, below = (height(kind, fields, n, exact.vector(start[i])) for start in starts)
        assert below < 0 < above
