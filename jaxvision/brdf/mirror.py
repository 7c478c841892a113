"""A perfect mirror: all light goes from one direction into the mirrored one. Local frame.

Its BRDF is a delta function, reflectance * delta(wi - s) / cos(theta_i) with s = (-x, -y, z) of
`wo`, which no number in sr^-1 describes. So `evaluate`, `shading` and `pdf` are 0: point and
directional lights are never met exactly, and a quadrature sees nothing. `sample` always gives s,
and there the weight of the light that arrives is `albedo` itself, the reflectance, instead of
f_r cos / pdf. A caller that follows rays treats this one record apart.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._types import Colour, Scalar, as_float, check_shape
from .._vector import Vec, Vector, as_vec
from ..scene import Material
from ._lobe import mirrored
from ._registry import register


class Mirror(Material):
    """`reflectance`: (bands,), no unit, 1 for a perfect mirror."""

    reflectance: Colour = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_shape("Mirror.reflectance", self.reflectance, ("bands",))


def evaluate(material: Mirror, wi: Vector, wo: Vector) -> Colour:
    """0 everywhere: (bands,) in sr^-1."""
    del wi, wo
    return jnp.zeros_like(material.reflectance)


def sample(material: Mirror, wo: Vector, u: Float[Array, "3"]) -> Vec:
    """The mirror direction of `wo`, unit; `u` is not used."""
    del material, u
    return mirrored(wo)


def pdf(material: Mirror, wi: Vector, wo: Vector) -> Scalar:
    """0: a delta function has no density in sr^-1."""
    del material, wi
    return jnp.zeros_like(as_vec(wo).z)


def albedo(material: Mirror, wo: Vector) -> Colour:
    """The reflectance, (bands,), no unit; 0 from below."""
    return jnp.where(as_vec(wo).z > 0, material.reflectance, 0)


register(Mirror, evaluate=evaluate, sample=sample, pdf=pdf, albedo=albedo)
