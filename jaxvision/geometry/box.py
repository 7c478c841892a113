"""A ray and a box, by slabs: Kay & Kajiya, "Ray Tracing Complex Scenes", SIGGRAPH 1986. For ONE
ray; lengths in metres."""

import jax.numpy as jnp
from jaxtyping import Array, Bool

from .._numerics import dot, smallest_divisor
from .._types import Scalar
from .._vector import Vec, as_vec, where
from ..scene import Box
from ._size import size_of
from .rays import Hit, Ray


def _local(box: Box, v: Vec) -> Vec:
    """A world vector along the box's sides."""
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
    """Where the ray enters and leaves each pair of faces, and whether it is between the faces that
    it runs along."""
    enter, leave, between = [], [], jnp.asarray(True)
    for o, d, h in zip(
        (origin.x, origin.y, origin.z),
        (direction.x, direction.y, direction.z),
        (half.x, half.y, half.z),
        strict=True,
    ):
        crosses = jnp.abs(d) > smallest_divisor(d.dtype)
        inverse = 1 / jnp.where(crosses, d, 1)
        middle, half_chord = -o * inverse, h * jnp.abs(inverse)
        enter.append(jnp.where(crosses, middle - half_chord, -jnp.inf))
        leave.append(jnp.where(crosses, middle + half_chord, jnp.inf))
        between = between & (crosses | (jnp.abs(o) <= h))
    return enter, leave, between


def _meet(ray: Ray, box: Box) -> tuple[Vec, Vec, Scalar, list[Scalar], Bool[Array, ""]]:
    origin, direction = _local(box, ray.origin - box.centre), _local(box, ray.direction)
    enter, leave, between = _slabs(origin, direction, as_vec(box.half_extents))
    near = jnp.maximum(jnp.maximum(enter[0], enter[1]), enter[2])
    far = jnp.minimum(jnp.minimum(leave[0], leave[1]), leave[2])
    outside = near > 0
    hit = between & (near <= far) & (far > 0)
    candidates = [jnp.where(outside, e, v) for e, v in zip(enter, leave, strict=True)]
    return origin, direction, jnp.where(outside, near, far), candidates, hit


def intersect_box(ray: Ray, box: Box) -> Hit:
    """The nearest point of a box in front of the ray's origin, which may lie inside.

    On an edge the first of the box's own axes gives the normal.

    Args:
        ray: its origin in m.
        box: the box, lengths in m.

    Returns:
        The hit; a miss has distance inf.
    """
    origin, direction, distance, candidates, hit = _meet(ray, box)
    on_x = hit & (candidates[0] == distance)
    on_y = hit & ~on_x & (candidates[1] == distance)
    on_z = hit & ~on_x & ~on_y
    # the distance of that one face, so that gradients reach no other
    chosen = jnp.where(on_x, candidates[0], jnp.where(on_y, candidates[1], candidates[2]))
    away = jnp.where(hit, chosen, 0)
    local, half = origin + away * direction, as_vec(box.half_extents)

    def face(on: Bool[Array, ""], place: Scalar, h: Scalar) -> tuple[Scalar, Scalar]:
        """(the normal's component, the place put back onto the face)"""
        side = jnp.where(place < 0, -jnp.ones_like(place), 1)
        return jnp.where(on, side, 0), jnp.where(on, side * h, place)

    (nx, x), (ny, y), (nz, z) = (
        face(on_x, local.x, half.x),
        face(on_y, local.y, half.y),
        face(on_z, local.z, half.z),
    )
    on_box = as_vec(box.centre) + _world(box, Vec(x, y, z))
    point = where(hit, on_box, ray.origin)
    normal = _world(box, Vec(nx, ny, nz))
    return Hit(jnp.where(hit, chosen, jnp.inf), normal, point, size_of(box))
