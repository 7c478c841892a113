"""Texture coordinates of shapes, and their gradients along the surface. All functions are for one
point. Lengths are in metres; coordinates have no unit."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int

from ..core._numerics import arctan2, divide, dot, safe_sqrt
from ..core._types import Scalar
from ..core._vector import Vec, as_vec
from ..geometry.hemisphere import cross
from ..scene import Quad, Shape, Sphere, TriangleMesh


class Coordinates(eqx.Module):
    """The texture coordinates of a point on a surface, and their gradients along the surface,
    m^-1."""

    u: Scalar
    v: Scalar
    along_u: Vec
    along_v: Vec


def coordinates(shape: Shape, point: Vec, primitive: Int[Array, ""] | None) -> Coordinates:
    """Return the texture coordinates of a point, m, on a `Quad`, a `Sphere`, or the triangle
    `primitive` of a mesh. Other shapes have the coordinates 0."""
    match shape:
        case Quad():
            corner, one, other = (as_vec(x) for x in (shape.corner, shape.edge_u, shape.edge_v))
            return _flat(point, corner, one, other, ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
        case Sphere():
            away = point - as_vec(shape.centre)
            across = away.x * away.x + away.y * away.y
            radius, whole = safe_sqrt(across), across + away.z * away.z
            half = arctan2(jnp.abs(away.y), away.x) / (2 * jnp.pi)
            u = jnp.where(away.y < 0, 1 - half, half)
            v = arctan2(radius, away.z) / jnp.pi
            east = divide(1, 2 * jnp.pi * across, where=across > 0)
            south = divide(1, jnp.pi * whole * radius, where=radius > 0)
            zero = jnp.zeros_like(u)
            return Coordinates(
                u,
                v,
                Vec(-away.y * east, away.x * east, zero),
                Vec(away.x * away.z * south, away.y * away.z * south, -across * south),
            )
        case TriangleMesh(uv=uv) if uv is not None and primitive is not None:
            face = shape.faces.at[primitive].get(mode="clip")
            a, b, c = (as_vec(v) for v in shape.vertices.at[face].get(mode="clip"))
            known = uv.at[face].get(mode="clip")
            return _flat(point, a, b - a, c - a, (known[:, 0], known[:, 1]))
    zero = jnp.zeros_like(point.x)
    return Coordinates(zero, zero, Vec(zero, zero, zero), Vec(zero, zero, zero))


def _flat(point: Vec, a: Vec, edge_b: Vec, edge_c: Vec, corners) -> Coordinates:
    """Return texture coordinates that are affine in the plane of a triangle. `corners` contains,
    for u and for v, the values at a, a + edge_b and a + edge_c."""
    area = cross(edge_b, edge_c)
    inverse = divide(1, dot(area, area), where=dot(area, area) > 0)
    to_b, to_c = inverse * cross(edge_c, area), inverse * cross(area, edge_b)
    found = []
    for at_a, at_b, at_c in corners:
        along = (at_b - at_a) * to_b + (at_c - at_a) * to_c
        found.append((at_a + dot(along, point - a), along))
    (u, along_u), (v, along_v) = found
    return Coordinates(u, v, along_u, along_v)
