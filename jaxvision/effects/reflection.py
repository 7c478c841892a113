"""Bound the light that each type of material reflects.

The shading f_r cos of a material is the sum of two terms. The diffuse part is at most `body` times
the cosine. The specular lobe is bounded by a function of the angles of a cell. Each material type
registers these bounds with `register`. Effects of a material type without registered bounds are
never dropped. Units are stated in the records `Reflection` and `Lobe`.
"""

from typing import Any

from ..brdf import families
from ..brdf import suprema as reflection_of  # noqa: F401
from ..core._bounds import Lobe as Lobe
from ..core._bounds import Reflection as Reflection


def fills(material: Any) -> bool:
    """Return whether light enters a shape with this material."""
    own = families().get(type(material))
    return own is not None and own.absorption is not None


def absorbs(material: Any) -> bool:
    """Return whether a material absorbs light inside its shape."""
    own = families().get(type(material))
    return own is not None and own.absorption is not None and own.absorption(material) is not None
