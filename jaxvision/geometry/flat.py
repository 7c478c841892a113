"""A ray and what is flat: planes, discs, parallelograms. For ONE ray; lengths in metres.

    t = n.(p - o) / n.d

A ray (nearly) in the plane misses it.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool

from .._numerics import divide, dot, normalize, smallest_divisor
from .._types import Scalar
from .._vector import Vec, Vector, as_vec, masked
from ..hemisphere import cross
from ..scene import Disc, Plane, Quad
from ._size import largest_component, size_of
from .rays import Hit, Ray


def _crossing(ray: Ray, point: Vector, normal: Vec) -> tuple[Scalar, Bool[Array, ""]]:
    """Distance to the plane through `point`, m, and whether it is met ahead."""
    height = dot(normal, point - ray.origin)
    slope = dot(normal, ray.direction)
    crosses = jnp.abs(slope) > smallest_divisor(slope.dtype)
    distance = divide(height, slope, where=crosses)
    return distance, distance > 0


def _hit(
    ray: Ray,
    point: Vector,
    normal: Vec,
    distance: Scalar,
    hit: Bool[Array, ""],
    size: Scalar,
) -> Hit:
    """The hit of a plane through `point` at a known distance, put back into the plane."""
    away = jnp.where(hit, distance, 0)
    met = ray.origin + away * ray.direction
    met = met + jnp.where(hit, dot(normal, point - met), 0) * normal
    reach = jnp.maximum(size, largest_component(met))
    return Hit(jnp.where(hit, distance, jnp.inf), as_vec(masked(hit, normal)), met, reach)


def intersect_plane(ray: Ray, plane: Plane) -> Hit:
    """Where a ray meets a plane, from either side.

    Args:
        ray: its origin in m.
        plane: the plane, lengths in m.

    Returns:
        The hit; a miss has distance inf.
    """
    normal = as_vec(normalize(plane.normal))
    distance, hit = _crossing(ray, plane.point, normal)
    return _hit(ray, plane.point, normal, distance, hit, size_of(plane))


def _meet_disc(ray: Ray, disc: Disc) -> tuple[Scalar, Bool[Array, ""], Vec]:
    normal = as_vec(normalize(disc.normal))
    distance, hit = _crossing(ray, disc.centre, normal)
    aside = ray.origin + jnp.where(hit, distance, 0) * ray.direction - disc.centre
    return distance, hit & (dot(aside, aside) <= disc.radius * disc.radius), normal


def intersect_disc(ray: Ray, disc: Disc) -> Hit:
    """Where a ray meets a disc, rim included, from either side.

    Args:
        ray: its origin in m.
        disc: the disc, lengths in m.

    Returns:
        The hit; a miss has distance inf.
    """
    distance, hit, normal = _meet_disc(ray, disc)
    return _hit(ray, disc.centre, normal, distance, hit, size_of(disc))


class FlatQuad(eqx.Module):
    """A quad with all that no ray changes. `corner`: m. `normal`: unit, 0 for one without area.
    `across_u`, `across_v`: m^-1, the reciprocal edges: their inner products with u edge_u +
    v edge_v are u and v. `size`: () m, as `Hit.size`."""

    corner: Vec
    normal: Vec
    across_u: Vec
    across_v: Vec
    size: Scalar


def flat_quad(quad: Quad) -> FlatQuad:
    """The quad, m, made ready for many rays."""
    area = cross(quad.edge_u, quad.edge_v)
    normal = as_vec(normalize(area))
    length = dot(area, normal)
    inverse = divide(1, length)
    across_u, across_v = cross(quad.edge_v, normal), cross(normal, quad.edge_u)
    return FlatQuad(
        as_vec(quad.corner), normal, across_u * inverse, across_v * inverse, size_of(quad)
    )


def line_crossing(ray: Ray, quad: FlatQuad) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """(height, slope, u slope, v slope) of where the ray's line crosses the parallelogram's plane:
    at the distance height / slope, m, of either sign, and at u edge_u + v edge_v from the corner.
    slope >= 0; all is left times the slope, so that a test need not divide."""
    toward = quad.corner - ray.origin
    height, slope = dot(quad.normal, toward), dot(quad.normal, ray.direction)
    height, slope = jnp.where(slope < 0, -height, height), jnp.abs(slope)
    u = height * dot(quad.across_u, ray.direction) - slope * dot(quad.across_u, toward)
    v = height * dot(quad.across_v, ray.direction) - slope * dot(quad.across_v, toward)
    return height, slope, u, v


def _meet_quad(ray: Ray, quad: FlatQuad) -> tuple[Scalar, Scalar, Bool[Array, ""]]:
    """(height, slope, whether it is met): the distance is height / slope."""
    height, slope, u, v = line_crossing(ray, quad)
    inside = (jnp.minimum(u, v) >= 0) & (jnp.maximum(u, v) <= slope)
    return height, slope, inside & (height > 0) & (slope > smallest_divisor(slope.dtype))


def quad_distance(ray: Ray, quad: FlatQuad) -> Scalar:
    """Distance to the parallelogram, m, inf for a miss."""
    height, slope, meets = _meet_quad(ray, quad)
    return jnp.where(meets, height / slope, jnp.inf)


def quad_blocks(ray: Ray, quad: FlatQuad, distance: Scalar) -> Bool[Array, ""]:
    """Whether the ray meets the parallelogram before `distance`, m."""
    height, slope, meets = _meet_quad(ray, quad)
    return meets & (height < distance * slope)


def intersect_quad(ray: Ray, quad: Quad | FlatQuad) -> Hit:
    """Where a ray meets a parallelogram, rim included, from either side.

    Args:
        ray: its origin in m.
        quad: the parallelogram, which is never met if it has no area, lengths in m.

    Returns:
        The hit; a miss has distance inf.
    """
    flat = flat_quad(quad) if isinstance(quad, Quad) else quad
    _, _, meets = _meet_quad(ray, flat)
    return quad_hit(ray, flat, meets)


def quad_hit(ray: Ray, quad: FlatQuad, meets: Bool[Array, ""]) -> Hit:
    """The hit, m, of a parallelogram by a ray of which it is known whether it meets it."""
    distance, ahead = _crossing(ray, quad.corner, quad.normal)
    return _hit(ray, quad.corner, quad.normal, distance, meets & ahead, quad.size)
