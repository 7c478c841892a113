"""Lambert: the same radiance in every direction."""

import jax.numpy as jnp

from .._numerics import dot
from .._types import Colour
from .._vector import Vector
from ..scene import Lambert


def lambert_shading(normal: Vector, wi: Vector, diffuse: Colour) -> Colour:
    """k_d [n.l]+ in sr^-1: radiance per unit of irradiance on a surface facing the light.

    `normal`, `wi` (toward the light): (3,) unit. `diffuse`: (bands,) k_d in sr^-1, which is the
    BRDF itself: albedo / pi. Source: Szeliski, Computer Vision, section 2.2.2.
    """
    return diffuse * jnp.maximum(dot(normal, wi), 0)


def shading(material: Lambert, normal: Vector, wi: Vector, wo: Vector) -> Colour:
    """`lambert_shading` of the record, (bands,) in sr^-1."""
    del wo
    return lambert_shading(normal, wi, material.diffuse)
