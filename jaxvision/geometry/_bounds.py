"""Enclosing spheres of shapes. Lengths in m."""

from collections.abc import Sequence
from functools import reduce

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..core._numerics import norm
from ..core._shown import Shown
from ..core._types import Scalar
from ..scene import Box, Disc, Plane, Quad, Shape, Sphere, TriangleMesh


class Ball(Shown):
    """A bounding sphere.

    Attributes:
        centre: (3,) m.
        radius: () m.
    """

    centre: Float[Array, "3"]
    radius: Scalar


def ball_around(shapes: Sequence[Shape]) -> Ball | None:
    """Return a sphere that encloses all shapes.

    Args:
        shapes: at least one.

    Returns:
        Centre and radius, m, without a gradient; None if a shape is an unbounded plane.

    Example:
        >>> ball = jv.geometry.ball_around([jv.Sphere([0, 0, 0], 1.0), jv.Sphere([4, 0, 0], 1.0)])
        >>> print(ball.radius >= 3)
        True
    """
    shapes = jax.lax.stop_gradient(list(shapes))
    balls = [_ball(shape) for shape in shapes if not isinstance(shape, Plane)]
    if len(balls) < len(shapes):
        return None
    low = reduce(jnp.minimum, (ball.centre - ball.radius for ball in balls))
    high = reduce(jnp.maximum, (ball.centre + ball.radius for ball in balls))
    centre = (low + high) / 2
    radius = reduce(jnp.maximum, (norm(ball.centre - centre) + ball.radius for ball in balls))
    return Ball(centre, radius)


def _ball(shape: Shape) -> Ball:
    match shape:
        case Sphere() | Disc():
            return Ball(shape.centre, shape.radius)
        case Box():
            return Ball(shape.centre, norm(shape.half_extents))
        case Quad():
            u, v = shape.edge_u, shape.edge_v
            half = jnp.maximum(norm(u + v), norm(u - v)) / 2
            return Ball(shape.corner + (u + v) / 2, half)
        case TriangleMesh():
            low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
            centre = (low + high) / 2
            return Ball(centre, norm(shape.vertices - centre[None]).max())
        case Plane():
            return Ball(shape.point, jnp.full_like(shape.point[0], jnp.inf))
