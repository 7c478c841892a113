"""Points distributed uniformly over a shape, for sampling emissive surfaces.

Two uniform numbers become a point with the constant density 1 / area. Lengths are in m and areas in
m^2; normals have unit length. Functions draw one point; use `jax.vmap` for many.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._numerics import divide, norm, normalize, running_sum, safe_sqrt
from ..core._shown import Shown
from ..core._types import Scalar
from ..core._vector import Vec, as_vec, scaled
from ..scene import Box, Disc, Plane, Quad, Shape, Sphere, TriangleMesh
from ._triangle import corners
from .hemisphere import cross, direction_at, local_frame, to_world


class SurfacePoint(Shown):
    """A point on the surface of a shape, and its normal.

    Attributes:
        point: (3,) m.
        normal: (3,) unit, outward.
    """

    point: Vec
    normal: Vec


def has_area(shape: Shape) -> bool:
    """Return whether `point_on` can sample points of a shape.

    Args:
        shape: any shape.

    Returns:
        False for a plane, which is unbounded; a Python bool, no unit.

    Example:
        >>> print(jv.geometry.has_area(jv.Plane([0, 0, 0], [0, 0, 1])))
        False
    """
    return not isinstance(shape, Plane)


def surface_area(shape: Shape) -> Scalar:
    """Return the area of the whole surface of a shape.

    Args:
        shape: any shape.

    Returns:
        () m^2; inf for a plane.

    Example:
        >>> print(f"{jv.geometry.surface_area(jv.Sphere([0, 0, 0], 0.5)):.4f} m^2")
        3.1416 m^2
    """
    match shape:
        case Sphere():
            return 4 * jnp.pi * shape.radius**2
        case Disc():
            return jnp.pi * shape.radius**2
        case Quad():
            return norm(cross(shape.edge_u, shape.edge_v))
        case Box():
            return 2 * _face_areas(shape).sum()
        case TriangleMesh():
            return _triangle_areas(shape).sum()
        case Plane():
            return jnp.full_like(shape.point[0], jnp.inf)


@takes_numbers
def point_on(shape: Shape, u: Float[Array, "2"]) -> SurfacePoint:
    """Draw a point on a shape's surface, uniform by area.

    Args:
        shape: any shape but a plane.
        u: (2,) uniform in [0, 1), no unit.

    Returns:
        The point, m, and its unit normal.

    Raises:
        ValueError: for a plane, which is unbounded.

    Example:
        >>> place = jv.geometry.point_on(jv.Quad([0, 0, 3], [0, 2, 0], [2, 0, 0]), [0.5, 0.5])
        >>> print(jv.as_array(place.point), jv.as_array(place.normal))
        [1. 1. 3.] [ 0.  0. -1.]
    """
    match shape:
        case Sphere():
            normal = direction_at(2 * u[0], 2 * jnp.pi * u[1])
            return SurfacePoint(shape.centre + shape.radius * normal, normal)
        case Disc():
            normal = as_vec(normalize(shape.normal))
            radius, phi = shape.radius * safe_sqrt(u[0]), 2 * jnp.pi * u[1]
            aside = Vec(radius * jnp.cos(phi), radius * jnp.sin(phi), jnp.zeros_like(phi))
            return SurfacePoint(shape.centre + as_vec(to_world(local_frame(normal), aside)), normal)
        case Quad():
            point = as_vec(shape.corner) + u[0] * as_vec(shape.edge_u) + u[1] * as_vec(shape.edge_v)
            return SurfacePoint(point, as_vec(normalize(cross(shape.edge_u, shape.edge_v))))
        case Box():
            return _point_on_box(shape, u)
        case TriangleMesh():
            return _point_on_mesh(shape, u)
        case Plane():
            raise ValueError("point_on needs a bounded shape, got a Plane.")


def _face_areas(box: Box) -> Float[Array, "3"]:
    """Return, for each axis, the area of one of the two faces perpendicular to it, m^2."""
    x, y, z = box.half_extents
    return 4 * jnp.stack([y * z, z * x, x * y])


def _point_on_box(box: Box, u: Float[Array, "2"]) -> SurfacePoint:
    """Select a face with the number u_0, with a probability proportional to the face's area. The
    rescaled u_0 is uniform again.
    """
    face, rest = _pick(jnp.repeat(_face_areas(box), 2), u[0])
    axis, side = face // 2, face % 2
    place = jnp.stack([2 * rest - 1, 2 * u[1] - 1])
    sign = 1 - 2 * side.astype(rest.dtype)
    across = jnp.arange(3, dtype=axis.dtype) == axis
    beside = jnp.arange(3, dtype=axis.dtype) == (axis + 1) % 3
    normal = jnp.where(across, sign, 0)
    point = box.half_extents * jnp.where(across, sign, jnp.where(beside, place[0], place[1]))
    if box.rotation is not None:
        point, normal = point @ box.rotation, normal @ box.rotation
    return SurfacePoint(as_vec(box.centre + point), as_vec(normal))


def _pick(weights: Float[Array, " n"], u: Scalar) -> tuple[Array, Scalar]:
    """Draw an index with probability proportional to its weight; return it, and `u` rescaled to be
    uniform again.
    """
    ends = running_sum(weights)
    at = u * ends[-1]
    # The last index with a weight above 0, because `at` may round up
    last = jnp.searchsorted(ends, ends[-1])
    index = jnp.minimum(jnp.searchsorted(ends, at, side="right"), last)
    width = weights[index]
    rest = divide(at - (ends[index] - width), width, width != 0)
    return index, jnp.clip(rest, 0, 1)


def _vertices(mesh: TriangleMesh) -> tuple[Vec, Vec, Vec]:
    """Return the three vertices of each triangle, components (faces,)."""
    a, b, c = (as_vec(corners(mesh)[:, i]) for i in range(3))
    return a, b, c


def _triangle_areas(mesh: TriangleMesh) -> Float[Array, " faces"]:
    a, b, c = _vertices(mesh)
    return norm(cross(b - a, c - a)) / 2


def _point_on_mesh(mesh: TriangleMesh, u: Float[Array, "2"]) -> SurfacePoint:
    """Select a triangle with the number u_0, with a probability proportional to the triangle's
    area. The rescaled u_0 is uniform again.
    """
    index, rest = _pick(_triangle_areas(mesh), u[0])
    a, b, c = (Vec(corner.x[index], corner.y[index], corner.z[index]) for corner in _vertices(mesh))
    root = safe_sqrt(rest)
    point = a + scaled(b - a, 1 - root) + scaled(c - a, u[1] * root)
    return SurfacePoint(point, as_vec(normalize(cross(b - a, c - a))))
