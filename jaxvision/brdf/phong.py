"""Phong: an ideal diffuse part plus a power of the cosine to the mirror direction.

Three records share the lobe [cos theta_s]+^n and differ in what stands before it:

    record             specular term of f_r         ... of the shading, f_r cos(theta_i)
    Phong              k_s lobe / cos(theta_i)      k_s lobe                the textbook's SHADING
    PhongBRDF          k_s lobe                     k_s lobe cos(theta_i)   the textbook's lobe as
                                                                            a BRDF
    NormalisedPhong    k_s (n + 2) / (2 pi) lobe    that times cos(theta_i)

So from shading to BRDF, divide the specular term by the cosine of incidence; k_d, which is
albedo / pi, is the same in all three. Phong is neither reciprocal nor bounded: at a grazing light
it reflects more than it receives. PhongBRDF is reciprocal, and reflects no more than it receives
exactly where pi k_d + 2 pi k_s / (n + 2) <= 1. NormalisedPhong (Lafortune & Willems, "Using the
Modified Phong Reflectance Model for Physically Based Rendering", 1994) is reciprocal, and its
albedo is at most pi k_d + k_s, reached along the normal. Local frame, normal = +z; angles in
radians.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._bands import by_band
from .._numerics import dot, log_cos_between, log_of_zero
from .._types import Colour, Scalar, Scalars
from .._vector import Vec, Vector, as_vec
from ..geometry import mirror_direction
from ._lobe import (
    PowerLobe,
    about,
    choose,
    diffuse_share,
    divisor,
    lit_and_seen,
    lobe_integrals,
    log_cosine,
    mirrored,
    mixed_pdf,
)
from ._registry import register


class Phong(PowerLobe):
    """Phong SHADING: k_d cos+ + k_s cos(theta_s) ** exponent, no cosine on the specular term.

    `diffuse`, `specular`: (bands,) k_d and k_s in sr^-1; k_s of shape (1,) is neutral.
    `exponent`: () >= 0, no unit. `ambient`: (bands,) k_a, no unit, or None; the array of k_d
    itself where both share one.
    """


class PhongBRDF(PowerLobe):
    """The BRDF k_d + k_s cos(theta_s) ** exponent, fields as in `Phong`.

    `diffuse`, `specular`: (bands,) k_d and k_s in sr^-1; k_s of shape (1,) is neutral.
    `exponent`: () >= 0, no unit. `ambient`: (bands,) k_a, no unit, or None.
    """


class NormalisedPhong(PowerLobe):
    """The BRDF k_d + k_s (n + 2) / (2 pi) cos(theta_s) ** n, energy-conserving: the lobe's
    albedo is at most k_s, and less away from the normal, where the horizon cuts it off.

    `diffuse`: (bands,) k_d in sr^-1. `specular`: (bands,) or neutral (1,), k_s, no unit: the
    lobe's albedo along the normal. `exponent`: () n >= 0, no unit. `ambient`: (bands,) k_a, no
    unit, or None.
    """


AnyPhong = Phong | PhongBRDF | NormalisedPhong


def phong_lobe(log_cos_mirror: Scalars, exponent: Scalars) -> Scalars:
    """[cos theta_s]+ ** exponent, from the logarithm of the cosine; unnormalised, in [0, 1].

    `log_cos_mirror`: log of the cosine between view and mirror direction, <= 0, as
    `log_cos_between` gives it; its value for a right angle or more means a cosine of 0, where the
    lobe and its gradients are exactly 0 for every exponent. `exponent`: >= 0, no unit. The
    arguments broadcast. Source: Szeliski, Computer Vision, section 2.2.2.
    """
    front = log_cos_mirror > log_of_zero(log_cos_mirror.dtype)
    return jnp.exp(jnp.where(front, exponent * jnp.where(front, log_cos_mirror, 0), -jnp.inf))


def phong_shading(
    normal: Vector, wi: Vector, wo: Vector, diffuse: Colour, specular: Colour, exponent: Scalar
) -> Colour:
    """k_d [n.l]+ + k_s [s.v]+ ** exponent in sr^-1, 0 where n.l <= 0 (the attached shadow) or
    n.v <= 0 (a viewer below the surface, as for the record `Phong`).

    Radiance toward the viewer per unit of irradiance on a surface facing the light. `normal`, `wi`
    (toward the light), `wo` (toward the viewer): (3,) unit. `diffuse`, `specular`: (bands,) sr^-1.
    `exponent`: () >= 0. Source: Szeliski, Computer Vision, section 2.2.2, "Phong shading".
    """
    cos_i = dot(normal, wi)
    lobe = phong_lobe(log_cos_between(mirror_direction(normal, wi), wo), exponent)
    seen = (cos_i > 0) & (dot(normal, wo) > 0)
    return jnp.where(seen, diffuse * cos_i + specular * lobe, 0)


# ---------------------------------------------------------------- the family


def _lobe(wi: Vec, wo: Vec, exponent: Scalar) -> Scalar:
    return phong_lobe(log_cos_between(mirrored(wi), wo), exponent)


def evaluate(material: AnyPhong, wi: Vector, wo: Vector) -> Colour:
    """f_r of the table above, (bands,) in sr^-1."""
    lobe = _lobe(as_vec(wi), as_vec(wo), material.exponent)
    match material:
        case Phong():
            lobe = lobe / divisor(as_vec(wi).z)
        case NormalisedPhong():
            lobe = (material.exponent + 2) / (2 * jnp.pi) * lobe
    seen = lit_and_seen(wi, wo)
    return _body_and_lobe(material, seen.astype(lobe.dtype), jnp.where(seen, lobe, 0))


def angles(wi: Vec, wo: Vec) -> tuple[Scalar, Scalar]:
    """(cosine of incidence, logarithm of the cosine to the mirror direction), no unit; of 0 where
    either direction lies below the surface."""
    seen, log_cos = lit_and_seen(wi, wo), log_cos_between(mirrored(wi), wo)
    return jnp.where(seen, wi.z, 0), jnp.where(seen, log_cos, log_of_zero(log_cos.dtype))


def at_angles(material: AnyPhong, angles: tuple[Scalar, Scalar]) -> Colour:
    """f_r cos(theta_i) of the table above, (bands,) in sr^-1."""
    cosine, log_cos = angles
    lobe = phong_lobe(log_cos, material.exponent)
    match material:
        case PhongBRDF():
            lobe = lobe * cosine
        case NormalisedPhong():
            lobe = (material.exponent + 2) / (2 * jnp.pi) * lobe * cosine
    return _body_and_lobe(material, cosine, lobe)


def _body_and_lobe(material: AnyPhong, body: Scalar, lobe: Scalar) -> Colour:
    """k_d body + k_s lobe, sr^-1."""
    return by_band(lambda k_d, k_s: k_d * body + k_s * lobe, material.diffuse, material.specular)


def power_direction(axis: Vector, exponent: Scalar, u: Float[Array, "2"]) -> Vec:
    """A unit direction of density `power_pdf` about `axis`: cos(alpha) = (1 - u_0)^(1 / (n + 1))
    from two uniform numbers in [0, 1)."""
    return about(axis, -jnp.expm1(jnp.log1p(-u[0]) / (exponent + 1)), 2 * jnp.pi * u[1])


def power_pdf(axis: Vector, w: Vector, exponent: Scalar) -> Scalar:
    """(n + 1) / (2 pi) [cos alpha]+^n in sr^-1, alpha being the angle between `axis` and `w`."""
    lobe = phong_lobe(log_cos_between(as_vec(axis), as_vec(w)), exponent)
    return (exponent + 1) / (2 * jnp.pi) * lobe


def sample(material: AnyPhong, wo: Vector, u: Float[Array, "3"]) -> Vec:
    """A unit direction from the cosine about the normal or the lobe about the mirror direction."""
    lobe = power_direction(mirrored(wo), material.exponent, u[:2])
    return choose(_diffuse_part(material), u, lobe)


def pdf(material: AnyPhong, wi: Vector, wo: Vector) -> Scalar:
    """Density of `sample` in sr^-1."""
    lobe = power_pdf(mirrored(wo), wi, material.exponent)
    return mixed_pdf(_diffuse_part(material), wi, lobe)


def _diffuse_part(material: AnyPhong) -> Scalar:
    n = material.exponent
    match material:
        case Phong():
            lobe = 2 * jnp.pi / (n + 1)
        case PhongBRDF():
            lobe = 2 * jnp.pi / (n + 2)
        case NormalisedPhong():
            lobe = jnp.ones_like(n)
    return diffuse_share(jnp.pi * material.diffuse, lobe * material.specular)


def albedo(material: AnyPhong, wo: Vector) -> Colour:
    """pi k_d + k_s times the lobe's integral above the horizon, (bands,), no unit."""
    plain, with_cosine = power_integrals(as_vec(wo).z, material.exponent)
    match material:
        case Phong():
            lobe = plain
        case PhongBRDF():
            lobe = with_cosine
        case NormalisedPhong():
            lobe = (material.exponent + 2) / (2 * jnp.pi) * with_cosine
    return jnp.pi * material.diffuse + material.specular * lobe


def power_integrals(cos_axis: Scalar, exponent: Scalar) -> tuple[Scalar, Scalar]:
    """Integrals above the horizon of [cos alpha]+^n, and of it times cos(theta_i), in sr; alpha is
    the angle to an axis at polar cosine `cos_axis` in [0, 1].

    2 pi / (n + 1) and 2 pi cos_axis / (n + 2) where the horizon cuts nothing off. Quadrature over
    8.5 widths of the lobe: to 1e-10 for whole exponents and from n = 2 on. Between, the lobe ends
    at alpha = pi / 2 as no polynomial does: relative errors, largest along the normal, reach
    2e-5, 3e-6 and 3e-9 without the cosine at n = .1, .5, 1.5, and 1.1e-8 with it at n = .1.
    """

    def lobe(alpha: Scalars) -> Scalars:
        return phong_lobe(log_cosine(alpha), exponent)

    width = 8.5 / jnp.sqrt(exponent + 1)
    return lobe_integrals(lobe, cos_axis, width=width, end=np.pi / 2)


for _record in (Phong, PhongBRDF, NormalisedPhong):
    register(
        _record,
        evaluate=evaluate,
        sample=sample,
        pdf=pdf,
        albedo=albedo,
        angles=angles,
        at_angles=at_angles,
    )
