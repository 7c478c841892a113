"""How surfaces reflect, one file per family.

A family's file defines `shading(material, normal, wi, wo)` for its record; the table below is
where it is registered, and the only other place a new family touches.
"""

from collections.abc import Callable

from .._types import Colour
from .._vector import Vector
from ..scene import GaussianLobe, Lambert, Material, Phong
from . import gaussian_lobe, lambert, phong

_SHADING: dict[type, Callable[..., Colour]] = {
    Lambert: lambert.shading,
    Phong: phong.shading,
    GaussianLobe: gaussian_lobe.shading,
}


def reflect(material: Material, normal: Vector, wi: Vector, wo: Vector) -> Colour:
    """Radiance toward `wo` per unit of irradiance on a surface facing `wi`: (bands,) in sr^-1.

    The cosine of incidence is inside. `normal`, `wi` (toward the light), `wo` (toward the viewer):
    (3,) unit, pointing away from the surface; light from below it (n.wi <= 0) gives 0.
    """
    return _SHADING[type(material)](material, normal, wi, wo)
