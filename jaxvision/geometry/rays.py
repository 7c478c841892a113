"""Records of rays and hits, and the origins of rays that continue from a hit. Functions take one
ray; use `jax.vmap` for many.

Lengths are metres, directions unit vectors.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from ..core._arguments import check_unit, takes_numbers
from ..core._numerics import angle_between as angle_between
from ..core._numerics import dot
from ..core._numerics import log_cos_between as log_cos_between
from ..core._shown import Shown
from ..core._types import Scalar, is_known
from ..core._vector import Direction, Directions, Vec, Vec3, Vector, as_vec, scaled, vector_field
from ._size import largest_component, offset_length


class Ray(Shown):
    """A ray: its origin and unit direction. Arrays (3,) are split into components.

    Attributes:
        origin: (3,) m.
        direction: (3,) unit vector in which the ray travels.

    Example:
        >>> ray = jv.Ray([0, 0, 1], [0.6, 0, 0.8])
        >>> jv.as_array(ray.origin + 5.0 * ray.direction).round(4).tolist()
        [3.0, 0.0, 5.0]
    """

    origin: Vec = eqx.field(converter=vector_field)
    direction: Vec = eqx.field(converter=vector_field)

    def __check_init__(self) -> None:
        if all(map(is_known, jax.tree.leaves(self.direction))):
            check_unit("Ray.direction", np.stack(np.broadcast_arrays(*self.direction), axis=-1))


class Encounter(Shown):
    """The first intersection of a ray, as the indices of the shape and of its triangle.

    Attributes:
        shape: () index, -1 if nothing is hit.
        primitive: () index of the triangle if that shape is a mesh; None if no shape is a mesh.

    Example:
        >>> floors = [jv.Disc([0, 0, z], [0, 0, 1], 1) for z in (0, 1)]
        >>> int(jv.nearest_shape(jv.Ray([0, 0, 5], [0, 0, -1]), floors).shape)  # the upper one
        1
    """

    shape: Int[Array, ""]
    primitive: Int[Array, ""] | None = None


class Hit(Shown):
    """The nearest intersection of a ray with a shape: distance, normal and point.

    Attributes:
        distance: () m along the ray, inf for a miss.
        normal: unit, on the front: outward for closed shapes; 0 for a miss.
        point: m, on the surface; the ray's origin for a miss.
        size: () m, the largest length in the computation of the point; the rounding error of the
            point is proportional to it.
        shading_normal: unit, interpolated or as `normal`; None if no shape has vertex normals.
        uv: () and (), no unit, 0 for a shape without texture coordinates; None if no shape has
            any.

    Example:
        >>> hit = jv.intersect(jv.Ray([3, 0, 0], [-1, 0, 0]), jv.Sphere([0, 0, 0], 1))
        >>> print(hit.distance, jv.as_array(hit.point), jv.as_array(hit.normal))
        2.0 [1. 0. 0.] [1. 0. 0.]
    """

    distance: Scalar
    normal: Vec = eqx.field(converter=vector_field)
    point: Vec = eqx.field(converter=vector_field)
    size: Scalar
    shading_normal: Vec | None = None
    uv: tuple[Scalar, Scalar] | None = None


@takes_numbers
def mirror_direction(normal: Directions, w: Directions) -> Vec3:
    """Return the mirror direction s = (2 n n^T - I) w of a direction w about the normal n.

    Args:
        normal: (..., 3) unit.
        w: (..., 3) unit, away from the surface.

    Returns:
        `w` mirrored about the normal, (..., 3), unit, away from the surface.

    Source: Szeliski, Computer Vision, section 2.2.2.

    Example:
        >>> print(jv.mirror_direction(jnp.array([0.0, 0.0, 1.0]), jnp.array([0.6, 0.0, 0.8])))
        [-0.6  0.   0.8]
    """
    return scaled(normal, 2 * dot(normal, w)) - w


@takes_numbers
def offset_origin(
    point: Vector, normal: Direction, direction: Direction, *, size: Scalar | None = None
) -> Vec:
    """Displace the origin of a ray that leaves a surface, so that it does not hit the surface
    again.

    The point moves along the normal to the side of the ray, by the largest distance by which
    rounding may have moved it to the wrong side. This function knows the normal of one face only.
    At an edge or a corner of a mesh, a ray may leave one face outward and its neighbour inward. The
    ray then starts on the wrong side of the neighbour and may hit it.

    Args:
        point: (3,) m.
        normal: (3,) unit.
        direction: (3,) unit; the ray may leave on either side.
        size: () m, as `Hit.size`; None for the largest component of the point, which is too small
            if the surface reaches much farther from the world's origin than the point.

    Returns:
        The origin, m; it has gradients with respect to the point only.

    Source: after Waechter & Binder, "A Fast and Robust Method for Avoiding Self-Intersection", Ray
    Tracing Gems (2019), ch. 6, with the size of the shape in the bound.

    Example:
        >>> up = jnp.array([0.0, 0.0, 1.0])
        >>> start = jv.offset_origin(jnp.array([1.0, 0.0, 0.0]), up, up)
        >>> bool(0 < start.z < 1e-5)  # to the side to which the ray goes
        True
    """
    reach = largest_component(point) if size is None else size
    away = jax.lax.stop_gradient(
        jnp.where(dot(normal, direction) < 0, -1, 1) * offset_length(reach) * as_vec(normal)
    )
    return as_vec(point) + away
