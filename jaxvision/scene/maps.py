"""A record for material parameters that vary over a surface, given as an array of texels."""

from typing import Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..core._shown import Shown
from ..core._types import (
    FINITE,
    Varying,
    as_float,
    as_optional_float,
    check_choice,
    check_range,
)


class Map(Shown, Varying):
    """A texture: numbers that vary over a surface, in place of one number or spectrum of a
    material.

    Between the centres of texels the numbers are interpolated bilinearly. Texture coordinates (u,
    v) increase from 0 to 1 over the map: u along each row, v along each column. (0, 0) is at the
    corner of the first texel. A `Quad` has texture coordinates along its edges, and a
    `TriangleMesh` at its vertices. On a `Sphere`, u = phi / 2 pi is the longitude about the world's
    z axis, and v = theta / pi the angle to this axis.

    Attributes:
        values: (rows, columns, ...) in the unit of the replaced field: (rows, columns, bands) for a
            spectrum, (rows, columns) for one number.
        uv: (2, 3) no unit, maps the shape's (u, v, 1) to the map's (u, v); (2, 4) maps (x, y, z, 1)
            of a point in the world, m, and suits any shape; None for the shape's own coordinates.
        wrap: continuation beyond the map: "repeat" tiles it, "clamp" extends its border; static.

    Raises:
        ValueError: for values without rows and columns.

    Example:
        A floor of dark and bright tiles of 0.5 m.

        >>> tiles = jv.Map([[[0.1], [0.3]], [[0.3], [0.1]]], [[1, 0, 0, 0], [0, 1, 0, 0]])
        >>> floor = jv.Surface(jv.Plane([0, 0, 0], [0, 0, 1]), jv.Lambert(tiles))
        >>> scene = jv.Scene(floor, jv.DirectionalLight([0, 0, 1], [1.0]))
        >>> seen = (jv.Ray([x, 0.25, 9], [0, 0, -1]) for x in (0.25, 0.75, 0.5))
        >>> [round(float(jv.radiance_along(scene, ray)[0]), 4) for ray in seen]
        [0.1, 0.3, 0.2]
    """

    values: Float[Array, "rows columns ..."] = eqx.field(converter=as_float)
    uv: Float[Array, "2 affine"] | None = eqx.field(converter=as_optional_float, default=None)
    wrap: Literal["repeat", "clamp"] = eqx.field(static=True, default="repeat", kw_only=True)

    def __check_init__(self) -> None:
        if jnp.ndim(self.values) < 2 or 0 in self.values.shape[:2]:
            raise ValueError(
                f"Map.values must have rows and columns first, got shape {self.values.shape}."
            )
        if self.uv is not None and self.uv.shape not in ((2, 3), (2, 4)):
            raise ValueError(f"Map.uv must have shape (2, 3) or (2, 4), got {self.uv.shape}.")
        check_range("Map.uv", self.uv, **FINITE._asdict())
        check_choice("Map.wrap", self.wrap, ("repeat", "clamp"))
