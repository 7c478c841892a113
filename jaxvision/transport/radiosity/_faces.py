"""The map from the unit square to each part of a shape (such as the side of a box), and its
inverse; lengths in m.

The coordinates (u, v) of the square are positions along the edges for a quad or the side of a box,
radius and angle for a disc, and polar angle and azimuth for a sphere. For a triangle, one side of
the square is mapped to the first vertex.
"""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from ...core._numerics import arctan2, divide, dot, normalize, reciprocal, safe_sqrt
from ...core._types import Scalar, Scalars
from ...core._vector import Vec, Vec3, as_array, as_vec
from ...geometry.hemisphere import cross, local_frame
from ...scene import Box, Disc, Quad, Shape, Sphere, TriangleMesh

# (first, second) axis of each side of a box, so that their cross product points outside: -x, +x,
# -y, +y, -z, +z
_AXES = ((2, 1), (1, 2), (0, 2), (2, 0), (1, 0), (0, 1))


def lengths(shape: Shape) -> list[tuple[float, float]]:
    """Return the extent of each part of a shape along its two axes, m."""
    match shape:
        case Quad():
            u, v = (float(np.linalg.norm(edge)) for edge in (shape.edge_u, shape.edge_v))
            return [(u, v)]
        case Box():
            side = 2 * np.asarray(shape.half_extents, float)
            return [(side[i], side[j]) for i, j in _AXES]
        case Disc():
            return [(float(shape.radius), 2 * np.pi * float(shape.radius))]
        case Sphere():
            return [(np.pi * float(shape.radius), 2 * np.pi * float(shape.radius))]
        case TriangleMesh():
            a, b, c = np.asarray(shape.vertices, float)[np.asarray(shape.faces)].swapaxes(0, 1)
            away = np.linalg.norm((b + c) / 2 - a, axis=-1)
            return list(zip(away.tolist(), np.linalg.norm(c - b, axis=-1).tolist(), strict=True))
    raise TypeError(f"{type(shape).__name__} has no faces.")


def face_point(shape: Shape, part: int, u: Scalars, v: Scalars) -> Vec:
    """Return the point, m, on a part of a shape at (u, v) in the unit square. `u` and `v`
    broadcast."""
    u, v = jnp.broadcast_arrays(u, v)
    match shape:
        case Quad() | Box():
            corner, edge_u, edge_v = side(shape, part)
            return corner + u * as_vec(edge_u) + v * as_vec(edge_v)
        case Disc():
            frame = local_frame(normalize(shape.normal))
            r, turn = shape.radius * u, 2 * jnp.pi * v
            across = (r * jnp.cos(turn)) * frame.tangent + (r * jnp.sin(turn)) * frame.bitangent
            return shape.centre + across
        case Sphere():
            theta, phi = jnp.pi * u, 2 * jnp.pi * v
            r = shape.radius * jnp.sin(theta)
            up = shape.radius * jnp.cos(theta)
            return shape.centre + Vec(r * jnp.cos(phi), r * jnp.sin(phi), up)
        case TriangleMesh():
            a, b, c = (as_vec(shape.vertices[shape.faces[part, k]]) for k in range(3))
            return a + (u * (1 - v)) * (b - a) + (u * v) * (c - a)
    raise TypeError(f"{type(shape).__name__} has no faces.")


def side(shape: Quad | Box, part: int) -> tuple[Array, Array, Array]:
    """Return one side of a shape as a parallelogram: its corner and two edges, (3,) m each."""
    if isinstance(shape, Quad):
        return shape.corner, shape.edge_u, shape.edge_v
    axes = [as_array(axis) for axis in _half_sides(shape)]
    i, j = _AXES[part]
    outward = axes[part // 2] if part % 2 else -axes[part // 2]
    return shape.centre + outward - axes[i] - axes[j], 2 * axes[i], 2 * axes[j]


def _half_sides(box: Box) -> list[Vec]:
    """Return the vectors, m, from the centre of a box to the middles of its three sides."""
    axes = jnp.eye(3, dtype=box.centre.dtype) if box.rotation is None else box.rotation
    return [as_vec(axes[k] * box.half_extents[k]) for k in range(3)]


def face_place(
    shape: Shape, point: Vec, primitive: Int[Array, ""] | None
) -> tuple[Int[Array, ""], Scalar, Scalar]:
    """Return (part, u, v) for a point of a shape, m, the inverse of `face_point`. For a mesh,
    `primitive` is the index of the triangle that contains the point; None stands for the first
    triangle. A point that is not exactly on the surface because of rounding is projected onto
    it."""
    none = jnp.zeros((), jnp.int32)
    match shape:
        case Quad():
            return none, *_edge_coordinates(point - shape.corner, shape.edge_u, shape.edge_v)
        case Box():
            axes = _half_sides(shape)
            local = [dot(point - shape.centre, axis) / dot(axis, axis) for axis in axes]
            reach = [jnp.abs(x) for x in local]
            axis = jnp.where(reach[0] >= jnp.maximum(reach[1], reach[2]), 0, 1)
            axis = jnp.where(reach[2] > jnp.maximum(reach[0], reach[1]), 2, axis)
            part = 2 * axis + (_pick(axis, local) > 0).astype(axis.dtype)
            i, j = jnp.asarray(_AXES)[part]
            u, v = ((_pick(k, local) + 1) / 2 for k in (i, j))
            return part.astype(jnp.int32), jnp.clip(u, 0, 1), jnp.clip(v, 0, 1)
        case Disc():
            frame = local_frame(normalize(shape.normal))
            x, y = (dot(point - shape.centre, axis) for axis in (frame.tangent, frame.bitangent))
            u = jnp.minimum(safe_sqrt(x * x + y * y) / shape.radius, 1)
            return none, u, _turn(x, y)
        case Sphere():
            d = point - shape.centre
            theta = arctan2(safe_sqrt(d.x * d.x + d.y * d.y), d.z)
            return none, theta / jnp.pi, _turn(d.x, d.y)
        case TriangleMesh():
            triangle = none if primitive is None else jnp.maximum(primitive, 0)
            a, b, c = (as_vec(shape.vertices[shape.faces[triangle, k]]) for k in range(3))
            s, t = _edge_coordinates(point - a, b - a, c - a)
            u = jnp.minimum(s + t, 1)
            return triangle, u, divide(t, s + t, u > 0)
    raise TypeError(f"{type(shape).__name__} has no faces.")


def _pick(index: Int[Array, ""], values: Sequence[Scalar]) -> Scalar:
    first, second, third = values
    return jnp.where(index == 0, first, jnp.where(index == 1, second, third))


def _turn(x: Scalar, y: Scalar) -> Scalar:
    """Return the angle of (x, y) as a fraction of a full turn, in [0, 1)."""
    half = arctan2(jnp.abs(y), x) / (2 * jnp.pi)
    return jnp.where(y < 0, 1 - half, half)


def _edge_coordinates(inside: Vec, u: Vec3, v: Vec3) -> tuple[Scalar, Scalar]:
    """Return the coordinates in [0, 1] of a point in a parallelogram along its edges u and v."""
    area = cross(u, v)
    square = dot(area, area)
    inverse = reciprocal(square)
    along, across = dot(cross(inside, v), area), dot(cross(u, inside), area)
    return jnp.clip(along * inverse, 0, 1), jnp.clip(across * inverse, 0, 1)
