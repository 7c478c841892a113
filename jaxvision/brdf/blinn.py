"""Blinn: an ideal diffuse part plus a power of the cosine between normal and half vector.

Three records share the lobe [n.h]^n and differ in what stands before it, as those of `phong`:

    record             specular term of f_r         ... of the shading, f_r cos(theta_i)
    Blinn              k_s lobe / cos(theta_i)      k_s lobe                SHADING, as published
    BlinnBRDF          k_s lobe                     k_s lobe cos(theta_i)
    NormalisedBlinn    k_s C(n) lobe                that times cos(theta_i)

    C(n) = (n + 2) (n + 4) / (8 pi (n + 2^(-n / 2)))

makes the lobe's albedo along the normal k_s, and nowhere more. Blinn is not reciprocal, and
reflects more than it receives at a grazing light; the other two are reciprocal. The lobe is as
wide as Phong's of a quarter of the exponent, and narrows at grazing angles as real ones do.
Sources: Blinn, "Models of Light Reflection for Computer Synthesized Pictures", SIGGRAPH 1977; C(n)
by integration. Local frame, normal = +z; angles in radians.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._numerics import arctan2, dot, smallest_divisor
from .._types import Colour, Scalar, Scalars
from .._vector import Vec, Vector, as_vec
from ..hemisphere import direction_at
from ._lobe import (
    PowerLobe,
    choose,
    circles,
    diffuse_share,
    divisor,
    lit_and_seen,
    log_cosine,
    mixed_pdf,
)
from ._registry import register
from .phong import phong_lobe


class Blinn(PowerLobe):
    """SHADING k_d cos+ + k_s (n.h) ** exponent, no cosine on the specular term.

    `diffuse`, `specular`: (bands,) k_d and k_s in sr^-1; k_s of shape (1,) is neutral.
    `exponent`: () >= 0, no unit. `ambient`: (bands,) k_a, no unit, or None.
    """


class BlinnBRDF(PowerLobe):
    """The BRDF k_d + k_s (n.h) ** exponent.

    `diffuse`, `specular`: (bands,) k_d and k_s in sr^-1; k_s of shape (1,) is neutral.
    `exponent`: () >= 0, no unit. `ambient`: (bands,) k_a, no unit, or None.
    """


class NormalisedBlinn(PowerLobe):
    """The BRDF k_d + k_s C(exponent) (n.h) ** exponent, energy-conserving: the lobe's albedo is
    at most k_s, and less away from the normal.

    `diffuse`: (bands,) k_d in sr^-1. `specular`: (bands,) or neutral (1,), k_s, no unit: the
    lobe's albedo along the normal. `exponent`: () >= 0, no unit. `ambient`: (bands,) k_a, no
    unit, or None.
    """


AnyBlinn = Blinn | BlinnBRDF | NormalisedBlinn


def log_cos_half(wi: Vector, wo: Vector) -> Scalars:
    """log of the cosine between normal and half vector, <= 0, no unit: with H = wi + wo,
    -log(1 + (H.x^2 + H.y^2) / H.z^2) / 2, which keeps its digits for the sharpest lobe. 0 where
    H.z <= 0, which happens only below the surface."""
    both = as_vec(wi) + as_vec(wo)
    above = both.z > smallest_divisor(both.z.dtype)
    z = jnp.where(above, both.z, 1)
    squared = jnp.square(both.x / z) + jnp.square(both.y / z)
    return -jnp.log1p(jnp.where(above, squared, 0)) / 2


def normalisation(exponent: Scalar) -> Scalar:
    """C(n) of the table above, in sr^-1. `exponent`: () >= 0."""
    n = exponent
    return (n + 2) * (n + 4) / (8 * jnp.pi * (n + jnp.exp2(-n / 2)))


def evaluate(material: AnyBlinn, wi: Vector, wo: Vector) -> Colour:
    """f_r of the table above, (bands,) in sr^-1."""
    lobe = phong_lobe(log_cos_half(wi, wo), material.exponent)
    match material:
        case Blinn():
            lobe = lobe / divisor(as_vec(wi).z)
        case NormalisedBlinn():
            lobe = normalisation(material.exponent) * lobe
    return jnp.where(lit_and_seen(wi, wo), material.diffuse + material.specular * lobe, 0)


def shading(material: Blinn, wi: Vector, wo: Vector) -> Colour:
    """k_d cos(theta_i) + k_s lobe, (bands,) in sr^-1."""
    lobe = phong_lobe(log_cos_half(wi, wo), material.exponent)
    shaded = material.diffuse * as_vec(wi).z + material.specular * lobe
    return jnp.where(lit_and_seen(wi, wo), shaded, 0)


def _diffuse_part(material: AnyBlinn) -> Scalar:
    peak = 1 / normalisation(material.exponent)
    lobe = jnp.ones_like(peak) if isinstance(material, NormalisedBlinn) else peak
    return diffuse_share(jnp.pi * material.diffuse, lobe * material.specular)


def sample(material: AnyBlinn, wo: Vector, u: Float[Array, "3"]) -> Vec:
    """A unit direction from the cosine about the normal, or `wo` mirrored about a half vector of
    density (n + 1) / (2 pi) (n.h)^n."""
    shortfall = -jnp.expm1(jnp.log1p(-u[0]) / (material.exponent + 1))
    h, viewer = direction_at(shortfall, 2 * jnp.pi * u[1]), as_vec(wo)
    return choose(_diffuse_part(material), u, 2 * dot(viewer, h) * h - viewer)


def pdf(material: AnyBlinn, wi: Vector, wo: Vector) -> Scalar:
    """Density of `sample` in sr^-1: that of the half vector over 4 wo.h."""
    both = as_vec(wi) + as_vec(wo)
    upright = Vec(both.x, both.y, jnp.abs(both.z))
    zero = jnp.zeros_like(both.z)
    tall = upright.z > smallest_divisor(both.z.dtype)
    lobe = phong_lobe(log_cos_half(upright, Vec(zero, zero, zero)), material.exponent)
    length = jnp.sqrt(jnp.where(tall, dot(both, both), 1))  # 2 wo.h
    n = material.exponent
    density = jnp.where(tall, (n + 1) * lobe / (4 * jnp.pi * length), 0)
    return mixed_pdf(_diffuse_part(material), wi, density)


def albedo(material: AnyBlinn, wo: Vector) -> Colour:
    """pi k_d + k_s times the lobe's integral above the horizon, (bands,), no unit."""
    plain, with_cosine = half_vector_integrals(as_vec(wo).z, material.exponent)
    match material:
        case Blinn():
            lobe = plain
        case BlinnBRDF():
            lobe = with_cosine
        case NormalisedBlinn():
            lobe = normalisation(material.exponent) * with_cosine
    return jnp.pi * material.diffuse + material.specular * lobe


def half_vector_integrals(cos_o: Scalar, exponent: Scalar) -> tuple[Scalar, Scalar]:
    """Integrals over light above the horizon of (n.h)^n, and of it times cos(theta_i), in sr, for
    a viewer at polar cosine `cos_o` in [0, 1].

    In the half vector's angle t to the normal and its azimuth phi from the viewer's, with
    dwi = 4 d dh, d = wo.h = P + Q cos(phi), P = cos_o cos(t), Q = sin_o sin(t), and
    cos(theta_i) = 2 d cos(t) - cos_o, the azimuths are integrals of polynomials in cos(phi) up to
    the horizon, cos(phi_m) = -cot(2 t) cot(theta_o). What remains in t is quadrature, to 1e-10.
    """
    width = 2 * 8.5 / jnp.sqrt(exponent + 1)
    (inner, inner_weight), (outer, outer_weight), (p, q) = circles(cos_o, width=width, end=np.pi)
    sin_o = jnp.sqrt(jnp.maximum((1 - cos_o) * (1 + cos_o), jnp.finfo(cos_o.dtype).tiny))

    def ring(doubled: Scalars, phi_m: Scalars, sin_m: Scalars) -> tuple[Scalars, Scalars]:
        """The integrals over |phi| < phi_m at t = doubled / 2."""
        cos_t, sin_t = jnp.cos(doubled / 2), jnp.sin(doubled / 2)
        lobe = phong_lobe(log_cosine(doubled / 2), exponent) * sin_t / 2  # dt = d(doubled) / 2
        a, b = cos_o * cos_t, sin_o * sin_t
        cos_m = jnp.cos(phi_m)
        d = 2 * (a * phi_m + b * sin_m)
        d_squared = 2 * a * (a * phi_m + 2 * b * sin_m) + b * b * (phi_m + sin_m * cos_m)
        return 4 * lobe * d, 4 * lobe * (2 * cos_t * d_squared - cos_o * d)

    whole = ring(inner, jnp.full_like(inner, jnp.pi), jnp.zeros_like(inner))
    phi_m = arctan2(q, -p)
    cut = ring(outer, phi_m, jnp.sin(phi_m))
    plain, cosine = (
        (inner_weight * w).sum() + (outer_weight * c).sum() for w, c in zip(whole, cut, strict=True)
    )
    return plain, cosine


register(Blinn, evaluate=evaluate, sample=sample, pdf=pdf, albedo=albedo, shading=shading)
for _record in (BlinnBRDF, NormalisedBlinn):
    register(_record, evaluate=evaluate, sample=sample, pdf=pdf, albedo=albedo)
