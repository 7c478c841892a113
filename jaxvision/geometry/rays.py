"""Rays, what they meet, and where they go on from. For ONE ray; the caller vmaps.

Lengths are metres, directions unit vectors.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from .._numerics import dot
from .._types import Scalar
from .._vector import Vec, Vec3, Vector, as_vec, scaled
from ._size import largest_component, offset_length


class Ray(eqx.Module):
    """`origin`: m. `direction`: unit vector, the way the ray travels. (3,) arrays are taken apart
    into components."""

    origin: Vec = eqx.field(converter=as_vec)
    direction: Vec = eqx.field(converter=as_vec)


class Encounter(eqx.Module):
    """What a ray meets first, in whole numbers. `shape`: () index, -1 for nothing. `primitive`: ()
    the triangle where that shape is a mesh; None where no shape is one."""

    shape: Int[Array, ""]
    primitive: Int[Array, ""] | None = None


class Hit(eqx.Module):
    """`distance`: () m along the ray, inf for a miss. `normal`: unit, on the front: outward of
    closed shapes; 0 for a miss. `point`: m, on the surface itself; the ray's origin for a miss.
    `size`: () m, the largest length that the point was computed from, which its rounding is
    relative to. `shading_normal`: unit, as `normal` or interpolated, or None where no shape has
    normals of its own. `uv`: () and (), no unit, 0 for what has none, or None where no shape has
    any.
    """

    distance: Scalar
    normal: Vec = eqx.field(converter=as_vec)
    point: Vec = eqx.field(converter=as_vec)
    size: Scalar
    shading_normal: Vec | None = None
    uv: tuple[Scalar, Scalar] | None = None


def mirror_direction(normal: Vec3, w: Vec3) -> Vec3:
    """s = (2 n n^T - I) w: `w` mirrored about `normal`, all (..., 3), unit and pointing away from
    the surface. Source: Szeliski, Computer Vision, section 2.2.2."""
    return scaled(normal, 2 * dot(normal, w)) - w


def offset_origin(
    point: Vector, normal: Vector, direction: Vector, *, size: Scalar | None = None
) -> Vec:
    """Where a ray that leaves a surface at `point` starts: moved along the normal, to the side the
    ray goes to, as far as rounding may have put the point on the other one.

    `point`: m. `normal`, `direction`: unit; the ray may leave on either side. `size`: () m, as
    `Hit.size`; without it the largest component of the point, too little where the surface
    itself reaches much farther from the world's origin than the point. A constant to gradients
    but for the point. One normal is known here: a ray from an edge or a corner of a mesh that goes
    outward of the one face and inward of its neighbour starts on the wrong side of the neighbour
    and may meet it. After Waechter & Binder, "A Fast and Robust Method for Avoiding
    Self-Intersection", Ray Tracing Gems (2019), ch. 6, with the shape's size in the bound.
    """
    reach = largest_component(point) if size is None else size
    away = jax.lax.stop_gradient(
        jnp.where(dot(normal, direction) < 0, -1, 1) * offset_length(reach) * as_vec(normal)
    )
    return as_vec(point) + away
