"""The form factor from a surface element to a polygon, near or far, for one pair; lengths in m."""

from collections.abc import Iterable, Sequence
from typing import TypeVar

import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Bool

from ...core._loops.fusion import fuse
from ...core._numerics import divide, dot
from ...core._types import Scalar
from ...core._vector import Vec
from ...geometry import largest_coordinate
from ...geometry.hemisphere import cross
from ...lights import square_nodes
from ...lights.polygon import contour_integral

Polygon = tuple[Vec, Vec, Vec, Vec]
Value = TypeVar("Value", Vec, Scalar)
FAR = 5.0


def is_far(point: Vec, corners: Polygon, *, reach: float = FAR) -> Bool[Array, ""]:
    """Return whether a point is farther from a polygon (corners in m) than `reach` times the
    polygon's size."""
    a, b, c, d = (corner - point for corner in corners)
    four, one, other = a + b + c + d, c - a, d - b
    square = jnp.maximum(dot(one, one), dot(other, other)) / 2
    return dot(four, four) > (4 * reach) ** 2 * square


def contour_form_factor(point: Vec, normal: Vec, corners: Polygon) -> Scalar:
    """Return the form factor of `point_to_polygon` by the contour integral, accurate for near
    polygons; lengths in m."""
    around = [corner - point for corner in corners]
    scale = 1 / largest_coordinate(around)
    around = fuse([corner * scale for corner in around])
    # these corners run counterclockwise as seen from the front, and those of `contour_integral`
    # clockwise
    area = cross(around[2] - around[0], around[3] - around[1])
    facing = -dot(area, around[0] + around[2])
    seen = contour_integral(around, normal) / jnp.pi
    value = jnp.where(facing > 0, jnp.clip(seen, 0, 1), 0)
    return jnp.where(jnp.isnan(facing), jnp.nan, value)  # the integral of NaN may be 0


def far_factor(point: Vec, normal: Vec, corners: Polygon) -> Scalar:
    """Return the form factor of `point_to_polygon` by 2 x 2 Gauss-Legendre nodes on the bilinear
    patch between the corners, m, accurate for far polygons. The relative error is about .03 (s /
    d)^4 for a polygon of size s at distance d."""
    total = jnp.zeros_like(point.x)
    for s, t, weight in square_places(2, total.dtype):
        place, area = polygon_point(corners, s, t)
        toward = place - point
        square = dot(toward, toward)
        facing = jnp.maximum(dot(normal, toward), 0) * jnp.maximum(-dot(area, toward), 0)
        total = total + divide(weight * facing, square * square, square != 0)
    return total / jnp.pi


def polygon_point(corners: Polygon, s: Scalar, t: Scalar) -> tuple[Vec, Vec]:
    """Return the point, m, at (s, t) in the unit square of the bilinear patch between four corners,
    and the vector area of the patch there per unit area of the square, m^2."""
    a, b, c, d = corners
    twist = (c - d) - (b - a)
    along, across = (b - a) + t * twist, (d - a) + s * twist
    return bilinear(corners, s, t), cross(along, across)


def bilinear(corners: Sequence[Value], s: Scalar, t: Scalar) -> Value:
    """Interpolate the values at the four corners of the unit square bilinearly to (s, t), in their
    unit."""
    a, b, c, d = corners
    return a + s * (b - a) + t * ((d - a) + s * ((c - d) - (b - a)))


def square_places(order: int, dtype: DTypeLike) -> Iterable[tuple[Scalar, Scalar, Scalar]]:
    nodes, weights = square_nodes(order)
    for (s, t), weight in zip(nodes, weights, strict=True):
        yield jnp.asarray(s, dtype), jnp.asarray(t, dtype), jnp.asarray(weight, dtype)
