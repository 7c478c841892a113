"""Gaussian lobe: an ideal diffuse part plus a Gaussian of the angle to the mirror direction.

Shading in the sense of `phong`: no cosine of incidence on the specular term, unnormalised, no
Fresnel, no masking. The BRDF with the same picture is k_d + k_s lobe / [n.l]+.
"""

import jax.numpy as jnp

from .._numerics import angle_between, dot
from .._types import Colour, Scalar, Scalars
from .._vector import Vector
from ..geometry import mirror_direction
from ..scene import GaussianLobe


def gaussian_lobe(theta_mirror: Scalars, concentration: Scalars) -> Scalars:
    """exp(-(concentration theta_s)^2), unnormalised, in [0, 1].

    `theta_mirror`: angle between view and mirror direction, radians in [0, pi], as
    `angle_between` gives it. `concentration`: rad^-1; the lobe falls to 1/e at its inverse. The
    arguments broadcast. Source: Szeliski, Computer Vision, section 2.2.2, after Torrance and
    Sparrow.
    """
    return jnp.exp(-jnp.square(concentration * theta_mirror))


def gaussian_lobe_shading(
    normal: Vector,
    wi: Vector,
    wo: Vector,
    diffuse: Colour,
    specular: Colour,
    concentration: Scalar,
) -> Colour:
    """k_d [n.l]+ + k_s exp(-(c_s theta_s)^2) in sr^-1, 0 where n.l <= 0 (the attached shadow).

    Radiance toward the viewer per unit of irradiance on a surface facing the light. `normal`, `wi`
    (toward the light), `wo` (toward the viewer): (3,) unit. `diffuse`, `specular`: (bands,) sr^-1.
    `concentration`: () c_s in rad^-1.
    """
    cos_i = dot(normal, wi)
    lobe = gaussian_lobe(angle_between(mirror_direction(normal, wi), wo), concentration)
    return jnp.where(cos_i > 0, diffuse * cos_i + specular * lobe, 0)


def shading(material: GaussianLobe, normal: Vector, wi: Vector, wo: Vector) -> Colour:
    """`gaussian_lobe_shading` of the record, (bands,) in sr^-1."""
    return gaussian_lobe_shading(
        normal, wi, wo, material.diffuse, material.specular, material.concentration
    )
