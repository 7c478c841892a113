"""Intersection of a ray with flat shapes: planes, discs, parallelograms. Functions take one ray;
lengths are in metres.

    t = n.(p - o) / n.d

is the distance from the origin o, along the direction d, to the plane through p with the normal n.
A ray that is (nearly) parallel to the plane misses it.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ..core._loops.fusion import materialise
from ..core._numerics import divide, dot, exact_cross, normalize, smallest_divisor
from ..core._shown import Shown
from ..core._types import Scalar
from ..core._vector import Vec, Vector, as_vec, masked
from ..scene import Disc, Plane, Quad
from ._size import largest_component, size_of
from ._unknown import unknown_hit
from .hemisphere import cross
from .rays import Hit, Ray


def _distance(ray: Ray, point: Vector, normal: Vec) -> Scalar:
    """Return the distance to the plane through `point`, m; 0 for a ray in the plane, negative for a
    plane behind."""
    slope = dot(normal, ray.direction)
    crosses = jnp.abs(slope) > smallest_divisor(slope.dtype)
    return divide(dot(normal, point - ray.origin), slope, where=crosses)


def _point_at(ray: Ray, distance: Scalar) -> Vec:
    return ray.origin + distance * ray.direction


def _hit(
    ray: Ray,
    point: Vector,
    normal: Vec,
    meets: Bool[Array, ""],
    size: Scalar,
    compute: Callable[..., Any],
) -> Hit:
    """Return the hit of a plane through `point`, projected onto the plane, if the plane lies ahead.
    For `compute`, see `box_hit`: if the distance were computed twice with different rounding, the
    hit would miss the plane.
    """
    distance = compute(_distance, ray, point, normal)
    hit = meets & (distance > 0)
    place = compute(_point_at, ray, jnp.where(hit, distance, 0))
    met = place + jnp.where(hit, dot(normal, point - place), 0) * normal
    reach = jnp.maximum(size, largest_component(place))
    return Hit(jnp.where(hit, distance, jnp.inf), as_vec(masked(hit, normal)), met, reach)


def intersect_plane(ray: Ray, plane: Plane) -> Hit:
    """Return the hit of a plane, from either side.

    Args:
        ray: its origin in m.
        plane: the plane, lengths in m.

    Returns:
        The hit; a miss has distance inf.

    Example:
        >>> floor = jv.Plane([0, 0, 0], [0, 0, 1])
        >>> print(jv.geometry.intersect_plane(jv.Ray([0, 0, 2], [0.6, 0, -0.8]), floor).distance)
        2.5
    """
    hit = plane_hit(ray, plane, materialise)
    return unknown_hit(hit, ray, *jax.tree.leaves(plane))


def plane_hit(ray: Ray, plane: Plane, compute: Callable[..., Any]) -> Hit:
    """Return where a ray hits a plane, in m. For `compute`, see `box_hit`."""
    normal = as_vec(normalize(plane.normal))
    return _hit(ray, plane.point, normal, jnp.asarray(True), size_of(plane), compute)


def intersect_disc(ray: Ray, disc: Disc) -> Hit:
    """Return the hit of a disc, including its rim, from either side.

    Args:
        ray: its origin in m.
        disc: the disc, lengths in m.

    Returns:
        The hit; a miss has distance inf.

    Example:
        >>> disc = jv.Disc([0, 0, 3], [0, 0, -1], 1.0)
        >>> print(jv.geometry.intersect_disc(jv.Ray([2, 0, 0], [0, 0, 1]), disc).distance)
        inf
    """
    hit = disc_hit(ray, disc, materialise)
    return unknown_hit(hit, ray, *jax.tree.leaves(disc))


def disc_hit(ray: Ray, disc: Disc, compute: Callable[..., Any]) -> Hit:
    """Return the hit of a disc, m. For `compute`, see `box_hit`."""
    normal = as_vec(normalize(disc.normal))
    aside = ray.origin + _distance(ray, disc.centre, normal) * ray.direction - disc.centre
    inside = dot(aside, aside) <= disc.radius * disc.radius
    return _hit(ray, disc.centre, normal, inside, size_of(disc), compute)


class FlatQuad(Shown):
    """A quad with precomputed values that do not depend on the ray. `corner`: m. `normal`: unit; 0
    for a quad without area. `across_u`, `across_v`: m^-1, the reciprocal edges, whose inner
    products with u edge_u + v edge_v are u and v. `size`: () m, as `Hit.size`.
    """

    corner: Vec
    normal: Vec
    across_u: Vec
    across_v: Vec
    size: Scalar


def flat_quad(quad: Quad) -> FlatQuad:
    """Prepare a quad, m, for many rays."""
    area = exact_cross(quad.edge_u, quad.edge_v)
    normal = as_vec(normalize(area))
    length = dot(area, normal)
    inverse = divide(1, length)
    across_u, across_v = cross(quad.edge_v, normal), cross(normal, quad.edge_u)
    return FlatQuad(
        as_vec(quad.corner), normal, across_u * inverse, across_v * inverse, size_of(quad)
    )


def line_crossing(ray: Ray, quad: FlatQuad) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """Intersect the ray's line with the plane of the parallelogram. Return (height, slope, u slope,
    v slope) with slope >= 0, so that a test needs no division. The distance is height / slope, m,
    of either sign. The crossing is at corner + u edge_u + v edge_v."""
    toward = quad.corner - ray.origin
    height, slope = dot(quad.normal, toward), dot(quad.normal, ray.direction)
    height, slope = jnp.where(slope < 0, -height, height), jnp.abs(slope)
    u = height * dot(quad.across_u, ray.direction) - slope * dot(quad.across_u, toward)
    v = height * dot(quad.across_v, ray.direction) - slope * dot(quad.across_v, toward)
    return height, slope, u, v


def _meet_quad(ray: Ray, quad: FlatQuad) -> tuple[Scalar, Scalar, Bool[Array, ""]]:
    """Return (height, slope, whether the ray hits the quad); the distance is height / slope."""
    height, slope, u, v = line_crossing(ray, quad)
    inside = (jnp.minimum(u, v) >= 0) & (jnp.maximum(u, v) <= slope)
    return height, slope, inside & (height > 0) & (slope > smallest_divisor(slope.dtype))


def quad_distance(ray: Ray, quad: FlatQuad) -> Scalar:
    """Return the distance to the parallelogram, m, inf for a miss."""
    height, slope, meets = _meet_quad(ray, quad)
    return jnp.where(meets, height / slope, jnp.inf)


def quad_blocks(ray: Ray, quad: FlatQuad, distance: Scalar) -> Bool[Array, ""]:
    """Return whether the ray hits the parallelogram before `distance`, m."""
    height, slope, meets = _meet_quad(ray, quad)
    return meets & (height < distance * slope)


def intersect_quad(ray: Ray, quad: Quad | FlatQuad) -> Hit:
    """Return the hit of a parallelogram, including its rim, from either side.

    Args:
        ray: its origin in m.
        quad: the parallelogram, lengths in m; one without area is never hit.

    Returns:
        The hit; a miss has distance inf.

    Example:
        >>> quad = jv.Quad([0, 0, 3], [0, 1, 0], [1, 0, 0])
        >>> print(jv.geometry.intersect_quad(jv.Ray([0.5, 0.5, 0], [0, 0, 1]), quad).distance)
        3.0
    """
    flat = flat_quad(quad) if isinstance(quad, Quad) else quad
    _, _, meets = _meet_quad(ray, flat)
    hit = quad_hit(ray, flat, meets, materialise)
    return unknown_hit(hit, ray, *jax.tree.leaves(quad))


def quad_hit(ray: Ray, quad: FlatQuad, meets: Bool[Array, ""], compute: Callable[..., Any]) -> Hit:
    """Return the hit of a parallelogram, m, given whether the ray hits it. For `compute`, see
    `box_hit`.
    """
    return _hit(ray, quad.corner, quad.normal, meets, quad.size, compute)
