"""A small flat lamp, whose intensity is proportional to the cosine of the angle to its normal.

A flat lamp of uniform radiance becomes such a light if it is small relative to every distance. A
distant `RectangleLight` of area A and radiance L is equivalent to a `SmallLight` of intensity A L.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._bounds import Ends, Source, numbers, unit
from ..core._loops.bands import map_bands
from ..core._numerics import dot, normalize
from ..core._types import AMOUNT, Colour, as_float, check_fields
from ..core._vector import Vector, as_vec
from ..geometry.hemisphere import cosine_direction, local_frame, to_world
from ..scene import Light
from ._emission import emitted_from_point
from ._registry import Emitted, Incident, register
from .point import _place_bound, _toward


class SmallLight(Light):
    """A flat source whose size is small compared with all distances, such as an LED chip.

    The light emits to the side of its normal, with the intensity I cos(theta) at the angle theta to
    the normal. The irradiance on a receiver at the distance d is E = I cos(theta) cos(theta_s) /
    d^2, where theta_s is the angle between the receiver's normal and the light.

    Attributes:
        position: (3,) m.
        normal: (3,) unit, the brightest direction (its length is ignored).
        intensity: (bands,) W sr^-1 along the normal.

    Example:
        >>> lamp = jv.SmallLight([0.0, 0.0, 2.0], [0.0, 0.0, -1.0], [8.0])
        >>> arriving = jv.incident(lamp, jnp.zeros(3))
        >>> print(arriving.irradiance.round(6), arriving.distance.round(6))
        [2.] 2.0
    """

    spectra = ("intensity",)
    position: Float[Array, "3"] = eqx.field(converter=as_float)
    normal: Float[Array, "3"] = eqx.field(converter=as_float)
    intensity: Colour = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, intensity=AMOUNT)


def from_small_light(light: SmallLight, point: Vector) -> Incident:
    """Return the light that arrives from a small light: the unit direction, the irradiance E = I
    cos(theta) / d^2 on a surface that faces it, (bands,) W m^-2, and the distance d, m. The
    irradiance is 0 behind the light, and at distances below `smallest_divisor`."""
    direction, distance, dilution = _toward(light.position, point)
    cosine = jnp.maximum(-dot(direction, normalize(light.normal)), 0)
    factor = cosine * dilution
    irradiance = map_bands(lambda band: band * factor, light.intensity)
    return Incident(direction, irradiance, distance)


def _emit(light: SmallLight, u: Float[Array, "4"]) -> Emitted:
    """Draw a ray that is cosine-distributed about the light's normal, from u_2 and u_3. The flux of
    the ray is pi I, W, where I is the intensity."""
    local = cosine_direction(u[2:])
    direction = as_vec(to_world(local_frame(normalize(light.normal)), local))
    return emitted_from_point(as_vec(light.position), direction, jnp.pi * light.intensity)


def _bound(light: Ends[SmallLight]) -> Source:
    """Return upper bounds on the light of a small lamp. The bounds use the lamp's normal only if it
    is fixed."""
    fixed = np.array_equal(light.low.normal, light.high.normal)
    return _place_bound(light, normal=unit(numbers(light.low.normal)) if fixed else None)


register(SmallLight, incident=from_small_light, emitted=_emit, bound=_bound)
