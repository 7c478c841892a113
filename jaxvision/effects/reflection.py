"""Bound the light that each type of material reflects.

The shading f_r cos is that of a diffuse part, at most `body` times the cosine, plus that of a
specular lobe, which is bounded by a function of the angles of a cell. A material type states these
bounds in `register`. A type without bounds is unbounded, and effects that depend on it are kept.
Values have no unit, except those in sr^-1.
"""

from typing import Any

from ..brdf import families
from ..brdf import suprema as reflection_of  # noqa: F401
from ..core._bounds import Lobe as Lobe
from ..core._bounds import Reflection as Reflection


def fills(material: Any) -> bool:
    """Return whether light enters the shape that a material covers."""
    own = families().get(type(material))
    return own is not None and own.absorption is not None


def absorbs(material: Any) -> bool:
    """Return whether a material absorbs light inside its shape."""
    own = families().get(type(material))
    return own is not None and own.absorption is not None and own.absorption(material) is not None
