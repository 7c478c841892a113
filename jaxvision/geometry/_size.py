"""The largest coordinates of shapes, which determine the rounding errors of points on them."""

from collections.abc import Sequence
from functools import reduce

import jax
import jax.numpy as jnp

from ..core._arguments import takes_numbers
from ..core._types import Scalar
from ..core._vector import Vec3, as_vec
from ..scene import Box, Disc, Plane, Quad, Shape, Sphere, TriangleMesh

# A point is moved off its surface by this many rounding errors of its largest length. The errors of
# the point and of the intersection tests add up to about a dozen.
_OFFSET = 32.0


def largest_component(v: Vec3) -> Scalar:
    """Return the largest of |x|, |y| and |z|, in the unit of `v`."""
    a = as_vec(v)
    return jnp.maximum(jnp.maximum(jnp.abs(a.x), jnp.abs(a.y)), jnp.abs(a.z))


def largest_coordinate(points: Sequence[Vec3]) -> Scalar:
    """Return the largest absolute value of any component of any point.

    Args:
        points: (3,) each, in any one unit.

    Returns:
        () in the unit of the points, or 1 if all components are 0. The gradient is 0.
    """
    largest = reduce(jnp.maximum, (largest_component(point) for point in points))
    return jax.lax.stop_gradient(jnp.where(largest > 0, largest, 1))


def size_of(shape: Shape) -> Scalar:
    """Return an upper bound on the absolute coordinates of a shape, m; for a plane, of its
    `point`."""
    match shape:
        case Sphere() | Disc():
            return largest_component(shape.centre) + jnp.abs(shape.radius)
        case Plane():
            return largest_component(shape.point)
        case Quad():
            edges = largest_component(shape.edge_u) + largest_component(shape.edge_v)
            return largest_component(shape.corner) + edges
        case Box():
            return largest_component(shape.centre) + jnp.abs(shape.half_extents).sum()
        case TriangleMesh():
            known = jnp.isfinite(shape.vertices)  # triangles at other vertices are never met
            return jnp.where(known, jnp.abs(shape.vertices), 0).max()


def largest_size(shapes: Sequence[Shape]) -> Scalar:
    """Return the largest coordinate of any of the shapes.

    Args:
        shapes: at least one.

    Returns:
        () m.
    """
    return reduce(jnp.maximum, (size_of(shape) for shape in shapes))


@takes_numbers
def offset_length(size: Scalar) -> Scalar:
    """Return the distance by which to move a point off its surface, so that no ray from it hits the
    same surface again.

    Args:
        size: () m, the largest length in the computation of the point.

    Returns:
        () m: 4e-6 of `size` in float32, 7e-15 in float64.
    """
    return _OFFSET * float(jnp.finfo(size.dtype).eps) * size
