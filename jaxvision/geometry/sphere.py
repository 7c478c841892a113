"""Intersection of a ray with a sphere. Functions take one ray; lengths are in metres."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ..core._loops.fusion import materialise
from ..core._numerics import (
    divide,
    dot,
    norm,
    or_one,
    replace_gradient,
    safe_sqrt,
)
from ..core._types import Scalar
from ..core._vector import Vec, as_vec, where
from ..scene import Sphere
from ._size import size_of
from ._unknown import unknown_hit
from .rays import Hit, Ray


def sphere_distance(ray: Ray, sphere: Sphere) -> Scalar:
    """Return the distance to the nearest hit, m, inf for a miss, by the textbook formula. The error
    is a few eps of the distance to the centre, which is small enough to find the first of several
    surfaces.
    """
    b, discriminant = _closest(ray, sphere)
    half_chord = jnp.sqrt(jnp.maximum(discriminant, 0))
    near, far = b - half_chord, b + half_chord
    distance = jnp.where(near > 0, near, far)
    return jnp.where((discriminant > 0) & (distance > 0), distance, jnp.inf)


def sphere_blocks(ray: Ray, sphere: Sphere, distance: Scalar) -> Bool[Array, ""]:
    """Return whether the ray hits the sphere before `distance`, m, without computing a square
    root.
    """
    b, discriminant = _closest(ray, sphere)
    rest = distance - b  # from the closest approach to the end of the ray
    less, more = jnp.minimum(b, rest), jnp.maximum(b, rest)
    reaches = discriminant > jnp.maximum(-less * jnp.abs(less), 0)
    return reaches & (discriminant <= more * more)  # otherwise both ends lie inside the sphere


def _closest(ray: Ray, sphere: Sphere) -> tuple[Scalar, Scalar]:
    """Return the distance along the ray to its closest approach, and the square of half the
    chord."""
    b, closest = _closest_approach(ray, sphere)
    return b, sphere.radius * sphere.radius - dot(closest, closest)


def _closest_approach(ray: Ray, sphere: Sphere) -> tuple[Scalar, Vec]:
    """Return the closest approach of the ray to the centre: the distance along the ray, and the
    position relative to the centre, m."""
    f = ray.origin - sphere.centre
    b = -dot(f, ray.direction)
    return b, f + b * ray.direction


def intersect_sphere(ray: Ray, sphere: Sphere) -> Hit:
    """Return the nearest hit of a sphere ahead of the ray's origin, which may lie inside.

    A tangent ray misses.

    Args:
        ray: its origin in m.
        sphere: the sphere, lengths in m.

    Returns:
        The hit; a miss has distance inf.

    Example:
        >>> ray, ball = jv.Ray([0, 0, 0], [0, 0, 1]), jv.Sphere([0, 0, 5], 1.0)
        >>> hit = jv.geometry.intersect_sphere(ray, ball)
        >>> print(hit.distance, jv.as_array(hit.normal))
        4.0 [ 0.  0. -1.]
    """
    found = materialise(_first_crossing, *jax.lax.stop_gradient((ray, sphere)))
    hit = found < jnp.inf
    b, closest = _closest_approach(ray, sphere)
    half_chord = safe_sqrt(sphere.radius * sphere.radius - dot(closest, closest))
    first = found < b
    near, far, _ = _crossings(ray, sphere)
    distance = replace_gradient(found, jnp.where(hit, jnp.where(first, near, far), 0))
    along = jnp.where(first, -half_chord, half_chord)
    outward = closest + along * ray.direction
    square = or_one(dot(outward, outward), hit)
    normal = outward * jnp.where(hit, 1 / jnp.sqrt(square), 0)
    on_sphere = as_vec(sphere.centre) + sphere.radius * normal
    met = Hit(distance, normal, where(hit, on_sphere, ray.origin), size_of(sphere))
    return unknown_hit(met, ray, *jax.tree.leaves(sphere))


def _first_crossing(ray: Ray, sphere: Sphere) -> Scalar:
    """Return the distance to the first crossing ahead, m, inf for a miss. The result must be
    materialised, so that every use has the same rounding: for a ray that starts on the sphere,
    rounding decides which of the two crossings is returned.
    """
    near, far, meets = _crossings(ray, sphere)
    return jnp.where(meets & (far > 0), jnp.where(near > 0, near, far), jnp.inf)


def _crossings(ray: Ray, sphere: Sphere) -> tuple[Scalar, Scalar, Bool[Array, ""]]:
    """Return (near, far, whether the line meets the sphere), distances in m. The crossings are
    computed from the closest approach and the product of both roots, without cancellation for
    distant or small spheres (Haines et al., Ray Tracing Gems (2019), ch. 7).
    """
    r = sphere.radius
    b, closest = _closest_approach(ray, sphere)
    discriminant = r * r - dot(closest, closest)
    half_chord = safe_sqrt(discriminant)
    larger = b + jnp.where(b < 0, -half_chord, half_chord)  # the larger root: nothing cancels
    meets = discriminant > 0
    away = norm(ray.origin - sphere.centre)
    smaller = divide((away - r) * (away + r), larger, where=meets)
    ahead = b >= 0
    return jnp.where(ahead, smaller, larger), jnp.where(ahead, larger, smaller), meets
