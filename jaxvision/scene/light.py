"""The base class of all lights, and the record of ambient light."""

from typing import ClassVar

import equinox as eqx

from ..core._shown import Shown
from ..core._types import AMOUNT, Colour, as_float, check_fields


class Light(Shown):
    """Base class of all lights. Each file in `lights/` contains the record and the equations of one
    light.

    Attributes:
        spectra: names of the fields whose last axis is a spectrum, one number for each band. A
            class sets it; a `Scene` then checks that all have the same number of bands.

    Example:
        >>> kinds = jv.PointLight, jv.RectangleLight, jv.EnvironmentMap, jv.Lambert
        >>> [issubclass(kind, jv.Light) for kind in kinds]
        [True, True, True, False]
    """

    spectra: ClassVar[tuple[str, ...]] = ()


class AmbientLight(Shown):
    """Uniform light from all directions, the ambient term L_a of Phong shading.

    Attributes:
        radiance: (bands,) W m^-2 sr^-1.

    Example:
        >>> up, sky = jnp.array([0.0, 0.0, 1.0]), jv.AmbientLight([5.0])
        >>> paint = jv.Lambert([0.1], ambient=[0.3])
        >>> seen = jv.outgoing_radiance(paint, [], jnp.zeros(3), up, up, ambient=sky)
        >>> round(float(seen[0]), 4)  # k_a L_a
        1.5
    """

    radiance: Colour = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, radiance=AMOUNT)
