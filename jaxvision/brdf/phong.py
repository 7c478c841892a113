"""Phong: an ideal diffuse part plus a power of the cosine to the mirror direction.

This is Phong SHADING: no cosine of incidence on the specular term, no 1 / pi in k_d, unnormalised,
neither reciprocal nor bounded by 1. The BRDF that gives the same picture inside the rendering
equation is k_d + k_s lobe / [n.l]+.
"""

import jax.numpy as jnp

from .._numerics import dot, log_cos_between, log_of_zero
from .._types import Colour, Scalar, Scalars
from .._vector import Vector
from ..geometry import mirror_direction
from ..scene import Phong


def phong_lobe(log_cos_mirror: Scalars, exponent: Scalars) -> Scalars:
    """[cos theta_s]+ ** exponent, from the logarithm of the cosine; unnormalised, in [0, 1].

    `log_cos_mirror`: log of the cosine between view and mirror direction, <= 0, as
    `log_cos_between` gives it; its value for a right angle or more means a cosine of 0, where the
    lobe and its gradients are exactly 0 for every exponent. `exponent`: >= 0, no unit. The
    arguments broadcast. Source: Szeliski, Computer Vision, section 2.2.2.
    """
    front = log_cos_mirror > log_of_zero(log_cos_mirror.dtype)
    return jnp.where(front, jnp.exp(exponent * jnp.where(front, log_cos_mirror, 0)), 0)


def phong_shading(
    normal: Vector, wi: Vector, wo: Vector, diffuse: Colour, specular: Colour, exponent: Scalar
) -> Colour:
    """k_d [n.l]+ + k_s [s.v]+ ** exponent in sr^-1, 0 where n.l <= 0 (the attached shadow).

    Radiance toward the viewer per unit of irradiance on a surface facing the light. `normal`, `wi`
    (toward the light), `wo` (toward the viewer): (3,) unit. `diffuse`, `specular`: (bands,) sr^-1.
    `exponent`: () >= 0. Source: Szeliski, Computer Vision, section 2.2.2, "Phong shading".
    """
    cos_i = dot(normal, wi)
    lobe = phong_lobe(log_cos_between(mirror_direction(normal, wi), wo), exponent)
    return jnp.where(cos_i > 0, diffuse * cos_i + specular * lobe, 0)


def shading(material: Phong, normal: Vector, wi: Vector, wo: Vector) -> Colour:
    """`phong_shading` of the record, (bands,) in sr^-1."""
    return phong_shading(normal, wi, wo, material.diffuse, material.specular, material.exponent)
