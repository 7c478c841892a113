"""A light at infinity in one direction, such as the sun if its size is neglected."""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ..core._bounds import Ends, Source, cone, peak
from ..core._numerics import normalize
from ..core._types import AMOUNT, Colour, as_float, check_direction, check_fields
from ..core._vector import Vector
from ..scene import Light
from ._registry import Incident, register


class DirectionalLight(Light):
    """A light at infinity, whose rays are parallel.

    Attributes:
        direction: (3,) unit vector from the scene toward the light (its length is ignored).
        irradiance: (bands,) W m^-2 on a surface that faces the light.

    Example:
        >>> sun = jv.DirectionalLight([0, 0, 1], [1000.0])
        >>> roof = jnp.array([0.6, 0.0, 0.8])  # its normal, turned away by arccos 0.8
        >>> round(float(jv.irradiance(sun, jnp.zeros(3), roof, rule=jv.Quadrature(1))[0]), 2)
        800.0
    """

    spectra = ("irradiance",)
    direction: Float[Array, "3"] = eqx.field(converter=as_float)
    irradiance: Colour = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, irradiance=AMOUNT)
        check_direction("DirectionalLight.direction", self.direction)


def from_directional_light(light: DirectionalLight, point: Vector) -> Incident:
    """Return the light at any point: the unit direction and the irradiance, (bands,) W m^-2. The
    distance is None."""
    del point
    return Incident(normalize(light.direction), light.irradiance)


def _bound(light: Ends[DirectionalLight]) -> Source:
    """Return upper bounds on the light: its largest irradiance, from a cone of directions."""
    middle, width = cone(light)
    own = np.array([1.0])
    return Source(peak(light, "irradiance"), middle, own * width, own, None, None, "direction")


register(DirectionalLight, incident=from_directional_light, bound=_bound)
