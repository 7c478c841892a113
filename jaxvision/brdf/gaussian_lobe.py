"""Gaussian lobe: an ideal diffuse part plus a Gaussian of the angle to the mirror direction.

The textbook's Torrance-Sparrow term: mirror angle theta_s, unnormalised, no Fresnel, no masking
(the full model is `torrance_sparrow`). Two records share the lobe exp(-(c_s theta_s)^2):

    record             specular term of f_r       ... of the shading, f_r cos(theta_i)
    GaussianLobe       k_s lobe / cos(theta_i)    k_s lobe                SHADING, as in `phong`
    GaussianLobeBRDF   k_s lobe                   k_s lobe cos(theta_i)   the same lobe as a BRDF

GaussianLobe is neither reciprocal nor bounded, GaussianLobeBRDF is reciprocal; a narrow one
(c_s >> 1) reflects no more than it receives where pi k_d + pi k_s / c_s^2 <= 1. Local frame,
normal = +z; angles in radians.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._numerics import dot, safe_sqrt, smallest_divisor
from .._types import Colour, Scalar, Scalars, as_float, as_optional_float
from .._vector import Vec, Vector, as_vec
from ..geometry import mirror_direction
from ..scene import Material
from ._lobe import (
    about,
    check_lobe,
    choose,
    diffuse_share,
    divisor,
    lit_and_seen,
    lobe_integrals,
    mirrored,
    mixed_pdf,
)
from ._registry import register


class GaussianLobe(Material):
    """SHADING k_d cos+ + k_s exp(-(concentration theta_s)^2), no cosine on the specular term.

    `diffuse`, `specular`: (bands,) k_d and k_s in sr^-1; k_s of shape (1,) is neutral.
    `concentration`: () c_s in rad^-1. `ambient`: (bands,) k_a, no unit, or None; the array of k_d
    itself where both share one.
    """

    spectra = ("diffuse",)
    diffuse: Colour = eqx.field(converter=as_float)
    specular: Colour = eqx.field(converter=as_float)
    concentration: Scalar = eqx.field(converter=as_float)
    ambient: Colour | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)

    def __check_init__(self) -> None:
        check_lobe(self, "concentration")


class GaussianLobeBRDF(Material):
    """The BRDF k_d + k_s exp(-(concentration theta_s)^2), fields as in `GaussianLobe`.

    `diffuse`, `specular`: (bands,) k_d and k_s in sr^-1; k_s of shape (1,) is neutral.
    `concentration`: () c_s in rad^-1. `ambient`: (bands,) k_a, no unit, or None.
    """

    spectra = ("diffuse",)
    diffuse: Colour = eqx.field(converter=as_float)
    specular: Colour = eqx.field(converter=as_float)
    concentration: Scalar = eqx.field(converter=as_float)
    ambient: Colour | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)

    def __check_init__(self) -> None:
        check_lobe(self, "concentration")


AnyGaussianLobe = GaussianLobe | GaussianLobeBRDF

# (2 arcsin(sqrt(x) / 2))^2 / x in x <= 2, of least relative error: 9e-10 and 1e-18 (Remez, in 60
# digits). By the size of the number in bytes.
_SQUARED_ANGLE_OVER_CHORD = {
    4: (
        0.9999999991,
        0.08333341759,
        0.01110977379,
        0.001793895788,
        0.0002922766259,
        0.0001040361749,
        -3.37113612e-5,
        3.06659523e-5,
        -9.307069555e-6,
        1.665556077e-6,
    ),
    8: (
        1.0,
        0.0833333333333328394,
        0.0111111111111466703,
        0.00178571428469842832,
        0.00031746033280970402,
        0.0000601249183719813071,
        0.0000118937410952752232,
        2.42434769675485041e-6,
        5.19835968604341836e-7,
        7.96437124460630779e-8,
        7.56952523645030308e-8,
        -6.88863154483541248e-8,
        8.2961759936183568e-8,
        -7.04575663316261834e-8,
        4.76593376160064183e-8,
        -2.47012576740952196e-8,
        9.71699928548570896e-9,
        -2.79940995095411032e-9,
        5.60106074064708988e-10,
        -6.97157599831252155e-11,
        4.12814172122524786e-12,
    ),
}


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
    """k_d [n.l]+ + k_s exp(-(c_s theta_s)^2) in sr^-1, 0 where n.l <= 0 (the attached shadow) or
    n.v <= 0 (a viewer below the surface, as for the record `GaussianLobe`).

    Radiance toward the viewer per unit of irradiance on a surface facing the light. `normal`, `wi`
    (toward the light), `wo` (toward the viewer): (3,) unit. `diffuse`, `specular`: (bands,) sr^-1.
    `concentration`: () c_s in rad^-1.
    """
    cos_i = dot(normal, wi)
    lobe = _lobe_between(mirror_direction(normal, wi), wo, concentration)
    seen = (cos_i > 0) & (dot(normal, wo) > 0)
    return jnp.where(seen, diffuse * cos_i + specular * lobe, 0)


def _lobe_between(axis: Vector, w: Vector, concentration: Scalar) -> Scalar:
    return jnp.exp(-concentration * (concentration * squared_angle_between(axis, w)))


def squared_angle_between(u: Vector, v: Vector) -> Scalar:
    """Square of the angle between unit vectors, in [0, pi^2] rad^2, within a few units in the last
    place from 0 to pi: a series of the squared chord |u - v|^2 up to a right angle, and of
    |u + v|^2, the chord of what is left to pi, beyond. Neither an arccos nor a root stands before
    small angles, whose digits and gradients it would lose."""
    apart, together = u - v, u + v
    chord, other = dot(apart, apart), dot(together, together)
    near = chord <= other
    x = jnp.minimum(chord, other)
    coefficients = _SQUARED_ANGLE_OVER_CHORD[8 if x.dtype == jnp.float64 else 4]
    square = jnp.full_like(x, coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        square = square * x + coefficient
    square = square * x
    return jnp.where(near, square, jnp.square(jnp.pi - safe_sqrt(jnp.where(near, 0, square))))


# ---------------------------------------------------------------- the family


def evaluate(material: AnyGaussianLobe, wi: Vector, wo: Vector) -> Colour:
    """f_r of the table above, (bands,) in sr^-1."""
    lobe = _lobe_between(mirrored(wi), as_vec(wo), material.concentration)
    if isinstance(material, GaussianLobe):
        lobe = lobe / divisor(as_vec(wi).z)
    return jnp.where(lit_and_seen(wi, wo), material.diffuse + material.specular * lobe, 0)


def shading(material: GaussianLobe, wi: Vector, wo: Vector) -> Colour:
    """k_d cos(theta_i) + k_s lobe, (bands,) in sr^-1."""
    light = as_vec(wi)
    lobe = _lobe_between(mirrored(light), as_vec(wo), material.concentration)
    shaded = material.diffuse * light.z + material.specular * lobe
    return jnp.where(lit_and_seen(wi, wo), shaded, 0)


def _kappa(material: AnyGaussianLobe) -> Scalar:
    """Of the von Mises-Fisher density exp(-(c_s chord)^2), which lies over the lobe everywhere."""
    kappa = 2 * jnp.square(material.concentration)
    return jnp.maximum(kappa, smallest_divisor(kappa.dtype))


def sample(material: AnyGaussianLobe, wo: Vector, u: Float[Array, "3"]) -> Vec:
    """A unit direction from the cosine about the normal or a von Mises-Fisher lobe about the
    mirror direction, 1 - cos(alpha) = -log(1 - u_0 (1 - e^(-2 kappa))) / kappa."""
    kappa = _kappa(material)
    one_minus_cos = jnp.clip(-jnp.log1p(u[0] * jnp.expm1(-2 * kappa)) / kappa, 0, 2)
    lobe = about(mirrored(wo), one_minus_cos, 2 * jnp.pi * u[1])
    return choose(_diffuse_part(material), u, lobe)


def pdf(material: AnyGaussianLobe, wi: Vector, wo: Vector) -> Scalar:
    """Density of `sample` in sr^-1."""
    kappa = _kappa(material)
    chord = as_vec(wi) - mirrored(wo)
    lobe = jnp.exp(-kappa / 2 * dot(chord, chord))
    return mixed_pdf(
        _diffuse_part(material), wi, -kappa / (2 * jnp.pi * jnp.expm1(-2 * kappa)) * lobe
    )


def _diffuse_part(material: AnyGaussianLobe) -> Scalar:
    kappa = _kappa(material)
    size = -2 * jnp.pi * jnp.expm1(-2 * kappa) / kappa
    return diffuse_share(jnp.pi * material.diffuse, size * material.specular)


def albedo(material: AnyGaussianLobe, wo: Vector) -> Colour:
    """pi k_d + k_s times the lobe's integral above the horizon, (bands,), no unit."""
    plain, with_cosine = gaussian_integrals(as_vec(wo).z, material.concentration)
    lobe = plain if isinstance(material, GaussianLobe) else with_cosine
    return jnp.pi * material.diffuse + material.specular * lobe


def gaussian_integrals(cos_axis: Scalar, concentration: Scalar) -> tuple[Scalar, Scalar]:
    """Integrals above the horizon of exp(-(c_s alpha)^2), and of it times cos(theta_i), in sr;
    alpha is the angle to an axis at polar cosine `cos_axis` in [0, 1]. Quadrature over 6 widths of
    the lobe, to 1e-10."""
    width = 6 / divisor(jnp.abs(concentration))
    return lobe_integrals(
        lambda alpha: gaussian_lobe(alpha, concentration), cos_axis, width=width, end=np.pi
    )


register(GaussianLobe, evaluate=evaluate, sample=sample, pdf=pdf, albedo=albedo, shading=shading)
register(GaussianLobeBRDF, evaluate=evaluate, sample=sample, pdf=pdf, albedo=albedo)
