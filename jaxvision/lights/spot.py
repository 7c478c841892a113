"""A spot light: a point light that shines into a cone.

    smooth        I t^2              t = (cos(theta) - cos(outer)) / (cos(inner) - cos(outer)),
                                     as in glTF
    smoothstep    I t^2 (3 - 2 t)    as in pbrt
    linear        I (outer - theta) / (outer - inner)    as in Mitsuba

is the intensity at the angle theta to the axis, between the half angles inner and outer of two
cones. The intensity is I within the inner cone, and 0 outside the outer cone.
"""

from typing import Annotated, Any, Literal, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._loops.bands import map_bands
from ..core._numerics import angle_between, dot, normalize, or_one
from ..core._types import (
    AMOUNT,
    Colour,
    Range,
    Scalar,
    as_float,
    check_choice,
    check_direction,
    check_fields,
    is_known,
)
from ..core._vector import Vector, as_array, as_vec
from ..geometry.hemisphere import direction_at, local_frame, to_world
from ..scene import Light
from ._emission import emitted_from_point
from ._registry import Emitted, Incident, register
from .point import _place_bound, _toward

Falloff = Literal["smooth", "smoothstep", "linear"]
_ANGLE = Range(0, np.pi, nan=True)


class SpotLight(Light):
    """A point light that shines into a cone, such as a stage lamp.

    Attributes:
        position: (3,) m.
        direction: (3,) of the axis, away from the lamp (its length is ignored).
        intensity: (bands,) W sr^-1 within the inner cone.
        inner: () rad, half angle of the inner cone, at least 0.
        outer: () rad, half angle of the outer cone, above `inner` and at most pi.
        falloff: how the intensity decreases between the cones: "smooth" (quadratic) or "smoothstep"
            (cubic) in the cosine, or "linear" in the angle; static.

    Example:
        >>> spot = jv.SpotLight([0, 0, 2], [0, 0, -1], [8.0], np.radians(20), np.radians(40))
        >>> for x in (0.0, 1.0, 2.0):  # m to the side: at 0, 27 and 45 degrees
        ...     print(jv.incident(spot, jnp.array([x, 0, 0])).irradiance.round(3))
        [2.]
        [0.875]
        [0.]
    """

    spectra = ("intensity",)
    position: Float[Array, "3"] = eqx.field(converter=as_float)
    direction: Float[Array, "3"] = eqx.field(converter=as_float)
    intensity: Colour = eqx.field(converter=as_float)
    inner: Scalar = eqx.field(converter=as_float)
    outer: Scalar = eqx.field(converter=as_float)
    falloff: Falloff = eqx.field(static=True, default="smooth", kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self, intensity=AMOUNT, inner=_ANGLE, outer=_ANGLE)
        check_direction("SpotLight.direction", self.direction)
        check_choice("SpotLight.falloff", self.falloff, get_args(Falloff))
        if not (is_known(self.inner) and is_known(self.outer)):
            return
        inner, outer = np.asarray(self.inner), np.asarray(self.outer)
        if np.any(inner >= outer):
            raise ValueError(
                f"SpotLight.inner must be below outer, got {float(inner):g} and "
                f"{float(outer):g} rad."
            )


def _share(light: SpotLight, away: Vector) -> Scalar:
    """Return the intensity in a unit direction, relative to the intensity on the axis, no unit."""
    axis = normalize(light.direction)
    match light.falloff:
        case "smooth" | "smoothstep":
            cosine, full, dark = dot(axis, away), jnp.cos(light.inner), jnp.cos(light.outer)
            within = jnp.clip((cosine - dark) / or_one(full - dark), 0, 1)
            cubic = light.falloff == "smoothstep"
            return within * within * (3 - 2 * within if cubic else 1)
        case "linear":
            theta = angle_between(as_array(axis), as_array(away))
            wide = or_one(light.outer - light.inner)
            return jnp.clip((light.outer - theta) / wide, 0, 1)


def from_spot_light(light: SpotLight, point: Vector) -> Incident:
    """Return the light that arrives from a spot light: the unit direction, the irradiance E = I /
    d^2 on a surface that faces it, (bands,) W m^-2, and the distance d, m. Here I is the intensity
    in that direction. Direction, irradiance and distance are 0 at the light itself."""
    direction, distance, dilution = _toward(light.position, point)
    factor = _share(light, -direction) * dilution
    return Incident(direction, map_bands(lambda band: band * factor, light.intensity), distance)


def _emit(light: SpotLight, u: Float[Array, "4"]) -> Emitted:
    """Draw a ray that is uniform in the outer cone, from u_2 and u_3. The flux of the ray is 2 pi
    (1
    - cos(outer)) times the intensity in its direction, W."""
    wide = 1 - jnp.cos(light.outer)
    local = direction_at(wide * u[2], 2 * jnp.pi * u[3])
    direction = as_vec(to_world(local_frame(normalize(light.direction)), local))
    flux = 2 * jnp.pi * wide * _share(light, direction) * light.intensity
    return emitted_from_point(as_vec(light.position), direction, flux)


def _from_file(
    *,
    inner: Annotated[float, Range(0, 180)] = 0.0,
    outer: Annotated[float, Range(0, 180, above=True)],
    **fields: Any,
) -> SpotLight:
    """A point that shines into a cone, whose half angles are in degrees.

    Args:
        inner: degrees, half angle of the inner cone, at least 0.
        outer: degrees, half angle of the outer cone, above `inner` and at most 180.
    """
    return SpotLight(inner=np.radians(inner), outer=np.radians(outer), **fields)


register(
    SpotLight,
    incident=from_spot_light,
    emitted=_emit,
    bound=_place_bound,
    from_file=_from_file,
)
