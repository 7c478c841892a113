"""The base of all lights, and the ambient term."""

from typing import ClassVar

import equinox as eqx

from .._shown import Shown
from .._types import AMOUNT, Colour, as_float, check_fields


class Light(Shown):
    """Base of every kind of light; the record and the equations of a kind share a file in
    `lights/`.

    Attributes:
        spectra: names of the fields whose last axis is a spectrum, one number a band. A class sets
            it, and a `Scene` then checks that all of them have the same number of bands.
    """

    spectra: ClassVar[tuple[str, ...]] = ()


class AmbientLight(Shown):
    """Uniform light from all directions, the L_a of Phong shading.

    Attributes:
        radiance: (bands,) W m^-2 sr^-1.
    """

    radiance: Colour = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, radiance=AMOUNT)
