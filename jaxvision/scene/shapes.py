"""The records of shapes, in metres. Each defines its front, the side to which its normals point."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..core._shown import Shown
from ..core._types import (
    AMOUNT,
    Scalar,
    as_float,
    as_optional_float,
    check_direction,
    check_fields,
    is_known,
    plain_array,
    print_by_name,
    within_integers,
)


class Sphere(Shown):
    """A sphere; its front is the outside.

    Attributes:
        centre: (3,) m.
        radius: () m, > 0.

    Example:
        >>> ray = jv.Ray([0, 0, 5], [0, 0, -1])
        >>> float(jv.intersect(ray, jv.Sphere([0, 0, 0], 1)).distance)
        4.0
    """

    centre: Float[Array, "3"] = eqx.field(converter=as_float)
    radius: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, radius=AMOUNT)


class Plane(Shown):
    """An unbounded plane; its front is the side to which the normal points.

    Attributes:
        point: (3,) m, any point on it.
        normal: (3,) unit vector (its length is ignored).

    Example:
        >>> ray = jv.Ray([0, 0, 3], [0.8, 0, -0.6])
        >>> round(float(jv.intersect(ray, jv.Plane([0, 0, 0], [0, 0, 1])).distance), 4)  # 3 / 0.6
        5.0
    """

    point: Float[Array, "3"] = eqx.field(converter=as_float)
    normal: Float[Array, "3"] = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self)
        check_direction("Plane.normal", self.normal)


class Disc(Shown):
    """A flat disc; its front is the side to which the normal points.

    Attributes:
        centre: (3,) m.
        normal: (3,) unit vector (its length is ignored).
        radius: () m, > 0.

    Example:
        >>> table = jv.Disc([0, 0, 0], [0, 0, 1], 0.5)
        >>> falling = (jv.Ray([x, 0, 3], [0, 0, -1]) for x in (0.4, 0.6))
        >>> [float(jv.intersect(ray, table).distance) for ray in falling]
        [3.0, inf]
    """

    centre: Float[Array, "3"] = eqx.field(converter=as_float)
    normal: Float[Array, "3"] = eqx.field(converter=as_float)
    radius: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, radius=AMOUNT)
        check_direction("Disc.normal", self.normal)


class Quad(Shown):
    """A parallelogram; its front is the side of edge_u x edge_v.

    Attributes:
        corner: (3,) m.
        edge_u: (3,) m, from the corner along one side.
        edge_v: (3,) m, from the corner along the other side.

    Example:
        >>> card = jv.Quad([0, 0, 0], [2, 0, 0], [0, 1, 0])
        >>> hit = jv.intersect(jv.Ray([1.9, 0.9, 3], [0, 0, -1]), card)
        >>> print(hit.distance, jv.as_array(hit.normal))
        3.0 [0. 0. 1.]
    """

    corner: Float[Array, "3"] = eqx.field(converter=as_float)
    edge_u: Float[Array, "3"] = eqx.field(converter=as_float)
    edge_v: Float[Array, "3"] = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self)
        check_direction("Quad.edge_u", self.edge_u)
        check_direction("Quad.edge_v", self.edge_v)


class Box(Shown):
    """A box; its front is the outside.

    Attributes:
        centre: (3,) m.
        half_extents: (3,) m, > 0, half of each side.
        rotation: (3, 3) no unit, rows are the unit axes of its sides in the world; None: the
            world's axes.

    Example:
        >>> ray = jv.Ray([0, 0, 5], [0, 0, -1])
        >>> float(jv.intersect(ray, jv.Box([0, 0, 0], [1.0, 1.0, 0.5])).distance)
        4.5
    """

    centre: Float[Array, "3"] = eqx.field(converter=as_float)
    half_extents: Float[Array, "3"] = eqx.field(converter=as_float)
    rotation: Float[Array, "3 3"] | None = eqx.field(
        converter=as_optional_float, default=None, kw_only=True
    )

    def __check_init__(self) -> None:
        check_fields(self, half_extents=AMOUNT)


def _as_indices(x: Any) -> Array:
    """Convert integers to an int32 array; raise `ValueError` for other numbers."""
    array = jnp.asarray(within_integers(plain_array("TriangleMesh.faces", x)))
    if not jnp.issubdtype(array.dtype, jnp.integer):
        raise ValueError(f"TriangleMesh.faces must be whole numbers, got {array.dtype}.")
    return array.astype(jnp.int32)


class TriangleMesh(Shown):
    """A mesh of triangles. The front of a triangle is the side from which its vertices are
    counterclockwise.

    A triangle without area is never hit, and a traced vertex index out of range is clipped.
    `geometry.problems` reports both, and faces that are black because of their vertex normals.

    Attributes:
        vertices: (vertices, 3) m.
        faces: (faces, 3) integers, the vertices of each triangle.
        normals: (vertices, 3) no unit, interpolated for shading; None for flat triangles. Lengths
            are ignored. Where the interpolated normal vanishes, the triangle's own normal is used;
            where it points to the back, the triangle is black.
        uv: (vertices, 2) no unit, or None.

    Example:
        >>> corner = jv.TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
        >>> falling = (jv.Ray([x, x, 3], [0, 0, -1]) for x in (0.4, 0.6))
        >>> [float(jv.intersect(ray, corner).distance) for ray in falling]
        [3.0, inf]
    """

    vertices: Float[Array, "vertices 3"] = eqx.field(converter=as_float)
    faces: Int[Array, "faces 3"] = eqx.field(converter=_as_indices)
    normals: Float[Array, "vertices 3"] | None = eqx.field(
        converter=as_optional_float, default=None, kw_only=True
    )
    uv: Float[Array, "vertices 2"] | None = eqx.field(
        converter=as_optional_float, default=None, kw_only=True
    )

    def __check_init__(self) -> None:
        check_fields(self)
        if 0 in (len(self.vertices), len(self.faces)):
            raise ValueError("TriangleMesh must hold at least one triangle, got none.")
        if is_known(self.faces):
            faces, count = np.asarray(self.faces), len(self.vertices)
            outside = (faces < 0) | (faces >= count)
            if outside.any():
                raise ValueError(
                    f"TriangleMesh.faces must be numbers of its {count} vertices, from 0 to "
                    f"{count - 1}, got {faces[outside][0]}."
                )


Shape = Sphere | Plane | Disc | Quad | Box | TriangleMesh
print_by_name(globals(), "Shape")
