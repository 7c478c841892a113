"""The base of all lights, and the ambient term."""

import equinox as eqx

from .._types import Colour, as_float, check_shape


class Light(eqx.Module):
    """Base of every kind of light; the record and the equations of a kind share a file in
    `lights/`.
    """


class AmbientLight(eqx.Module):
    """Uniform light from all directions, the L_a of Phong shading.

    Attributes:
        radiance: (bands,) W m^-2 sr^-1.
    """

    radiance: Colour = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_shape("AmbientLight.radiance", self.radiance, ("bands",))
