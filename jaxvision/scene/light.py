"""What shines: the base of all lights, and the ambient term."""

import equinox as eqx

from .._types import Colour, as_float, check_shape


class Light(eqx.Module):
    """What shines: the base of every kind of light, whose record and equations share a file in
    `lights/`."""


class AmbientLight(eqx.Module):
    """The same light from everywhere, the L_a of Phong shading.

    `radiance`: (bands,) W m^-2 sr^-1, a colour of its own.
    """

    radiance: Colour = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_shape("AmbientLight.radiance", self.radiance, ("bands",))
