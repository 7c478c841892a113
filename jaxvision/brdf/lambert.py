"""Lambert's reflection: the surface has the same radiance in every direction. In the local frame
the normal is +z."""

import equinox as eqx
import jax.numpy as jnp

from ..core._arguments import takes_numbers
from ..core._bounds import Reflection, peak
from ..core._numerics import dot
from ..core._types import AMOUNT, Colour, as_float, as_optional_float, check_fields
from ..core._vector import Direction
from ..scene import Material
from ._lobe import where_seen
from ._registry import register


class Lambert(Material):
    """Ideal diffuse reflection.

    Attributes:
        diffuse: (bands,) k_d in sr^-1; a surface of albedo rho has k_d = rho / pi. Values above
            1 / pi are accepted, since a fit may use an arbitrary unit of light.
        ambient: (bands,) k_a, no unit, the reflected part of the ambient radiance, or None. The k_a
            of the same surface is rho; textbooks often use one number for k_a and k_d.

    Example:
        >>> paper = jv.Lambert([0.8 / np.pi])
        >>> round(float(jv.brdf.albedo(paper, jnp.array([0.0, 0.0, 1.0]))[0]), 4)
        0.8
    """

    spectra = ("diffuse",)
    diffuse: Colour = eqx.field(converter=as_float)
    ambient: Colour | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self, diffuse=AMOUNT, ambient=AMOUNT)


@takes_numbers
def lambert_shading(normal: Direction, wi: Direction, diffuse: Colour) -> Colour:
    """Return Lambert's shading k_d max(n.l, 0), where n is the normal and l points to the light.
    Shading is radiance per unit of irradiance on a surface that faces the light.

    Args:
        normal: (3,) unit.
        wi: (3,) unit, toward the light.
        diffuse: (bands,) k_d in sr^-1, which is the BRDF itself: albedo / pi.

    Returns:
        The shading, (bands,) in sr^-1.

    Source: Szeliski, Computer Vision, section 2.2.2.

    Example:
        >>> up, wi = jnp.array([0.0, 0.0, 1.0]), jnp.array([0.6, 0.0, 0.8])
        >>> grey = jnp.array([0.5 / np.pi])
        >>> round(float(jv.lambert_shading(up, wi, grey)[0]), 4)  # 0.8 x 0.5 / pi
        0.1273
    """
    return diffuse * jnp.maximum(dot(normal, wi), 0)


def evaluate(material: Lambert, wi: Direction, wo: Direction) -> Colour:
    """Return the BRDF f_r = k_d, (bands,) in sr^-1."""
    return where_seen(wi, wo, material.diffuse)


def albedo(material: Lambert, wo: Direction) -> Colour:
    """Return the albedo pi k_d, (bands,), no unit, the same for every direction."""
    del wo
    return jnp.pi * material.diffuse


register(
    Lambert,
    evaluate=evaluate,
    albedo=albedo,
    bound=lambda x: Reflection(peak(x, "diffuse")),
    isotropic=True,
)
