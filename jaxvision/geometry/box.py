"""Intersection of a ray with a box, by slabs: Kay & Kajiya, "Ray Tracing Complex Scenes", SIGGRAPH
1986. Functions take one ray; lengths are in metres."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from ..core._loops.fusion import materialise
from ..core._numerics import divide, dot, replace_gradient, smallest_divisor
from ..core._types import Scalar
from ..core._vector import Vec, as_vec, where
from ..scene import Box
from ._size import size_of
from ._unknown import unknown_hit
from .rays import Hit, Ray


def _local(box: Box, v: Vec) -> Vec:
    """Return the components of a world vector along the box's axes."""
    if box.rotation is None:
        return v
    return Vec(*(dot(axis, v) for axis in box.rotation))


def _world(box: Box, v: Vec) -> Vec:
    if box.rotation is None:
        return v
    x, y, z = (as_vec(axis) for axis in box.rotation)
    return v.x * x + v.y * y + v.z * z


def _slabs(
    origin: Vec, direction: Vec, half: Vec
) -> tuple[list[Scalar], list[Scalar], Bool[Array, ""]]:
    """Return the distances at which the ray enters and leaves each pair of faces, and whether it
    lies between all pairs of faces that are parallel to it."""
    enter, leave, between = [], [], jnp.asarray(True)
    for o, d, h in zip(
        (origin.x, origin.y, origin.z),
        (direction.x, direction.y, direction.z),
        (half.x, half.y, half.z),
        strict=True,
    ):
        least = smallest_divisor(d.dtype)
        crosses = jnp.abs(d) > least
        inverse = 1 / jnp.where(crosses, d, least)
        middle, half_chord = -o * inverse, h * jnp.abs(inverse)
        enter.append(jnp.where(crosses, middle - half_chord, -jnp.inf))
        leave.append(jnp.where(crosses, middle + half_chord, jnp.inf))
        between = between & (crosses | (jnp.abs(o) <= h))
    return enter, leave, between


def _faces(ray: Ray, box: Box) -> tuple[Scalar, Int[Array, ""]]:
    """Return (distance in m, number of the face): inf and -1 for a miss. The number of a face is
    twice the number of its axis, plus one on the positive side. For a hit on an edge, the face of
    the first axis is returned.
    """
    origin, direction = _local(box, ray.origin - box.centre), _local(box, ray.direction)
    enter, leave, between = _slabs(origin, direction, as_vec(box.half_extents))
    near = jnp.maximum(jnp.maximum(enter[0], enter[1]), enter[2])
    far = jnp.minimum(jnp.minimum(leave[0], leave[1]), leave[2])
    outside, hit = near > 0, between & (near <= far) & (far > 0)
    x, y, z = (jnp.where(outside, -e, v) for e, v in zip(enter, leave, strict=True))
    axis = jnp.where((x <= y) & (x <= z), 0, jnp.where(y <= z, 1, 2)).astype(jnp.int32)
    positive = (_component(direction, axis) > 0) != outside
    face = jnp.where(hit, 2 * axis + positive.astype(jnp.int32), -1)
    return jnp.where(hit, jnp.where(outside, near, far), jnp.inf), face


def _component(v: Vec, axis: Int[Array, ""]) -> Scalar:
    return jnp.where(axis == 0, v.x, jnp.where(axis == 1, v.y, v.z))


def box_distance(ray: Ray, box: Box) -> Scalar:
    """Return the distance to the nearest hit, m, inf for a miss."""
    return _faces(ray, box)[0]


def _first_face(ray: Ray, box: Box) -> Int[Array, ""]:
    return _faces(ray, box)[1]


def _place(ray: Ray, box: Box, face: Int[Array, ""]) -> tuple[Scalar, Vec]:
    """Return the distance to the face with this number, and the hit in the box's axes, projected
    onto the face, m.
    """
    origin, direction = _local(box, ray.origin - box.centre), _local(box, ray.direction)
    axis, half = face // 2, as_vec(box.half_extents)
    to_face = _side(face, half.x) * _component(half, axis) - _component(origin, axis)
    slope = _component(direction, axis)
    crosses = (face >= 0) & (jnp.abs(slope) > smallest_divisor(slope.dtype))
    distance = divide(to_face, slope, where=crosses)
    met = origin + distance * direction
    on = _side(face, half.x) * half
    return distance, Vec(
        jnp.where(axis == 0, on.x, met.x),
        jnp.where(axis == 1, on.y, met.y),
        jnp.where(axis == 2, on.z, met.z),
    )


def _side(face: Int[Array, ""], like: Scalar) -> Scalar:
    """Return the side of its axis on which a face lies, 1 or -1."""
    return jnp.where(face % 2 == 1, jnp.ones_like(like), -1)


def intersect_box(ray: Ray, box: Box) -> Hit:
    """Return the nearest hit of a box ahead of the ray's origin, which may lie inside.

    On an edge, the normal is along the first of the box's axes.

    Args:
        ray: its origin in m.
        box: the box, lengths in m.

    Returns:
        The hit; a miss has distance inf.
    """
    hit = box_hit(ray, box, materialise)
    return unknown_hit(hit, ray, *jax.tree.leaves(box))


def box_hit(ray: Ray, box: Box, compute: Callable[..., Any]) -> Hit:
    """Return the hit of a box, m. `compute` is `materialise`, or `inline` if the caller computes
    the whole hit in one loop, because face and position must agree in rounding."""
    face = compute(_first_face, *jax.lax.stop_gradient((ray, box)))
    distance, place = compute(_place, ray, box, face)
    hit, axis, side = face >= 0, face // 2, _side(face, distance)
    ahead = jnp.maximum(distance, jnp.finfo(distance.dtype).tiny)  # the given face lies ahead
    distance = jnp.where(hit, replace_gradient(ahead, distance), jnp.inf)
    normal = Vec(*(jnp.where(hit & (axis == i), side, 0) for i in range(3)))
    point = where(hit, as_vec(box.centre) + _world(box, place), ray.origin)
    return Hit(distance, _world(box, normal), point, size_of(box))
