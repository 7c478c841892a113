"""Rays and the surfaces they meet. For one ray; the caller vmaps.

Lengths are metres, directions unit vectors. A ray meets what lies at a distance > 0; a miss has
distance inf, a zero normal, and gradients of zero.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from ._numerics import dot, norm, normalize, safe_sqrt, smallest_divisor
from ._types import Scalar, group_by_structure, take
from ._vector import Vec, Vec3, as_vec, masked, scaled
from .scene import Plane, Shape, Sphere


class Ray(eqx.Module):
    """`origin`: m. `direction`: unit vector, the way the ray travels. (3,) arrays are taken apart
    into components."""

    origin: Vec = eqx.field(converter=as_vec)
    direction: Vec = eqx.field(converter=as_vec)


class Hit(eqx.Module):
    """`distance`: () m along the ray, inf for a miss. `normal`: unit, outward."""

    distance: Scalar
    normal: Vec = eqx.field(converter=as_vec)


def mirror_direction(normal: Vec3, w: Vec3) -> Vec3:
    """s = (2 n n^T - I) w: `w` mirrored about `normal`, all (..., 3), unit and pointing away from
    the surface. Source: Szeliski, Computer Vision, section 2.2.2."""
    return scaled(normal, 2 * dot(normal, w)) - w


def intersect_sphere(ray: Ray, sphere: Sphere) -> Hit:
    """The nearest point of the sphere in front of the ray's origin, which may lie inside.

    Source: Haines, Guenther, Akenine-Moeller, "Precision Improvements for Ray/Sphere
    Intersection", Ray Tracing Gems (2019), ch. 7: the discriminant from the ray's closest approach
    to the centre, and the smaller root from the product of both, so that neither a distant nor a
    small sphere cancels. A tangent ray misses.
    """
    f, d, r = ray.origin - sphere.centre, ray.direction, sphere.radius
    b = -dot(f, d)
    closest = f + b * d  # from the centre to the ray's closest approach
    discriminant = r * r - dot(closest, closest)
    half_chord = safe_sqrt(discriminant)
    larger = b + jnp.where(b < 0, -half_chord, half_chord)  # in magnitude: nothing cancels
    meets = (discriminant > 0) & (jnp.abs(larger) > smallest_divisor(larger.dtype))
    distance = norm(f)
    smaller = (distance - r) * (distance + r) / jnp.where(meets, larger, 1)
    ahead = b >= 0
    near, far = jnp.where(ahead, smaller, larger), jnp.where(ahead, larger, smaller)
    outside = near > 0
    hit = meets & (far > 0)
    from_centre = closest + jnp.where(outside, -half_chord, half_chord) * d
    normal = from_centre * (1 / jnp.where(hit, r, 1))
    return Hit(jnp.where(hit, jnp.where(outside, near, far), jnp.inf), masked(hit, normal))


def intersect_plane(ray: Ray, plane: Plane) -> Hit:
    """t = n.(p - o) / n.d; a ray (nearly) in the plane misses it."""
    normal = normalize(plane.normal)
    height = dot(normal, plane.point - ray.origin)
    slope = dot(normal, ray.direction)
    crossing = jnp.abs(slope) > smallest_divisor(slope.dtype)
    distance = height / jnp.where(crossing, slope, 1)
    hit = crossing & (distance > 0)
    return Hit(jnp.where(hit, distance, jnp.inf), masked(hit, normal))


def intersect(ray: Ray, shape: Shape) -> Hit:
    """The hit of any shape."""
    match shape:
        case Sphere():
            return intersect_sphere(ray, shape)
        case Plane():
            return intersect_plane(ray, shape)


def nearest_shape(ray: Ray, shapes: Sequence[Shape]) -> Int[Array, ""]:
    """Index of the shape met first, of equally near ones the first; -1 where none is met."""
    index = jnp.full((), -1)
    nearest = jnp.full_like(ray.origin.x, jnp.inf)
    for i, shape in enumerate(shapes):
        distance = jax.lax.stop_gradient(intersect(ray, shape).distance)
        index = jnp.where(distance < nearest, i, index)
        nearest = jnp.minimum(distance, nearest)
    return index


def hit_shape(ray: Ray, shapes: Sequence[Shape], index: Int[Array, ""]) -> Hit:
    """The hit of the shape of that index, the only one that gradients reach; a miss for -1."""
    zero = jnp.zeros_like(ray.origin.x)
    chosen = Hit(zero + jnp.inf, Vec(zero, zero, zero))
    for members, group in group_by_structure(shapes):
        shape, among = take(members, group, index)
        hit = intersect(ray, shape)
        chosen = jax.tree.map(lambda new, old, here=among: jnp.where(here, new, old), hit, chosen)
    return chosen
