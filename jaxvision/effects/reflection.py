"""Upper bounds on the light that a material reflects.

The shading f_r cos of a family is a body, at most `body` times the cosine, plus a lobe, at most a
function of the angles of a cell. A family states these bounds in `register`. Without them it is not
bounded, and effects that depend on it are kept. Everything is without a unit, except sr^-1 values.
"""

from typing import Any

from ..brdf import families
from ..brdf import suprema as reflection_of  # noqa: F401
from ..core._bounds import Lobe as Lobe
from ..core._bounds import Reflection as Reflection


def fills(material: Any) -> bool:
    """Return whether light continues inside the shape that a material covers."""
    own = families().get(type(material))
    return own is not None and own.absorption is not None


def absorbs(material: Any) -> bool:
    """Whether a material absorbs inside its shape."""
    own = families().get(type(material))
    return own is not None and own.absorption is not None and own.absorption(material) is not None
