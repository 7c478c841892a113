"""A perfect mirror, which reflects light only into the mirrored direction.

In the local frame the mirrored direction of `wo` = (x, y, z) is s = (-x, -y, z). The BRDF of a
mirror is a delta function, reflectance * delta(wi - s) / cos(theta_i). A sample in the direction s
has the reflectance as its weight, instead of f_r cos(theta_i) / pdf.
"""

import equinox as eqx
import numpy as np

from ..core._bounds import Ends, Reflection, peak
from ..core._types import AMOUNT, Colour, as_float, check_fields
from ..core._vector import Vec
from ..scene import Material
from ._lobe import mirrored, where_above
from ._registry import register_delta
from ._specular import Specular


class Mirror(Material):
    """A perfect mirror with an opaque back.

    Attributes:
        reflectance: (bands,) or (1,) for all bands, no unit, 1 for a mirror without loss.

    Example:
        >>> lamp = jv.RectangleLight([-1, -1, 1], [0, 2, 0], [2, 0, 0], [5.0])
        >>> up = jnp.array([0.0, 0.0, 1.0])
        >>> seen = jv.outgoing_radiance(jv.Mirror([0.9]), [lamp], jnp.zeros(3), up, up)
        >>> round(float(seen[0]), 4)
        4.5
    """

    neutral_spectra = ("reflectance",)
    reflectance: Colour = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, reflectance=AMOUNT)


def specular(material: Mirror, w: Vec) -> Specular:
    """Return the mirror direction of `w`, unit, local, and the reflectance; 0 if `w` is below the
    surface."""
    return Specular(mirrored(w), where_above(w.z, material.reflectance))


def _bound(x: Ends[Mirror]) -> Reflection:
    return Reflection(np.zeros(1), mirror=peak(x, "reflectance"))


def _from_file(*, reflectance: Colour | float = 1.0) -> Mirror:
    """A smooth mirror."""
    return Mirror(reflectance)


register_delta(Mirror, specular=specular, bound=_bound, from_file=_from_file)
