"""Blinn's model: an ideal diffuse part plus a power of the cosine between normal and half vector.

Three records have the lobe (n.h)^n, where n.h is the cosine between normal and half vector. They
multiply the lobe by different factors, like the records of `phong`:

    record             specular term of f_r         ... of the shading, f_r cos(theta_i)
    Blinn              k_s lobe / cos(theta_i)      k_s lobe                SHADING, as published
    BlinnBRDF          k_s lobe                     k_s lobe cos(theta_i)
    NormalisedBlinn    k_s C(n) lobe                that times cos(theta_i)

    C(n) = (n + 2) (n + 4) / (8 pi (n + 2^(-n / 2)))

With C(n), the lobe's albedo is k_s along the normal and at most k_s elsewhere. Blinn is not
reciprocal, and reflects more light than it receives if the light is grazing. BlinnBRDF and
NormalisedBlinn are reciprocal. The lobe is as wide as a Phong lobe with a quarter of the exponent,
and it narrows at grazing angles, as measured lobes do. Sources: Blinn, "Models of Light Reflection
for Computer Synthesized Pictures", SIGGRAPH 1977; C(n) was derived by integration. In the local
frame the normal is +z; angles are in radians.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._bounds import Angles, Ends, Reflection, least, peak, power_of
from ..core._bounds import Lobe as LargestLobe
from ..core._bounds import most as largest
from ..core._numerics import arctan2, dot, log1p, or_one, smallest_divisor
from ..core._types import Scalar, Scalars
from ..core._vector import Direction, Vec, as_vec
from ..geometry.hemisphere import direction_at
from ..scene import Material
from ._conventions import Convention, Lobe, register_lobe
from ._lobe import PowerLobe, circles, log_cosine
from .phong import phong_lobe


class Blinn(PowerLobe):
    """Blinn's SHADING, k_d cos(theta_i) + k_s (n.h) ** exponent, without a cosine in the specular
    term.

    Attributes:
        diffuse: (bands,) k_d in sr^-1, >= 0.
        specular: (bands,) k_s in sr^-1; of shape (1,) for all bands.
        exponent: () n >= 0, no unit.
        ambient: (bands,) k_a, no unit, the reflected part of the ambient radiance, or None.

    Example:
        >>> gloss = jv.Blinn([0.0], [0.5], 10.0)
        >>> up, aside = jnp.array([0.0, 0.0, 1.0]), jnp.array([0.6, 0.0, 0.8])
        >>> round(float(jv.reflect(gloss, up, aside, up)[0]), 4)  # n.h = sqrt(0.9): 0.5 x 0.9^5
        0.2952
    """


class BlinnBRDF(PowerLobe):
    """A material with the BRDF k_d + k_s (n.h) ** exponent, h being the half vector.

    Attributes:
        diffuse: (bands,) k_d in sr^-1, >= 0.
        specular: (bands,) k_s in sr^-1; of shape (1,) for all bands.
        exponent: () n >= 0, no unit.
        ambient: (bands,) k_a, no unit, the reflected part of the ambient radiance, or None.

    Example:
        >>> gloss = jv.BlinnBRDF([0.0], [0.5], 10.0)
        >>> up, aside = jnp.array([0.0, 0.0, 1.0]), jnp.array([0.6, 0.0, 0.8])
        >>> round(float(jv.reflect(gloss, up, aside, up)[0]), 4)  # 0.5 x 0.9^5 x 0.8
        0.2362
    """


class NormalisedBlinn(PowerLobe):
    """A material with the BRDF k_d + k_s C(exponent) (n.h) ** exponent, where h is the half vector.
    The lobe conserves energy: its albedo is k_s along the normal and less elsewhere.

    Attributes:
        diffuse: (bands,) k_d in sr^-1, >= 0.
        specular: (bands,) k_s, no unit, the lobe's
            albedo along the normal; of shape (1,) for all bands.
        exponent: () n >= 0, no unit.
        ambient: (bands,) k_a, no unit, the reflected part of the ambient radiance, or None.

    Example:
        >>> lobe, up = jv.NormalisedBlinn([0.0], [1.0], 8.0), jnp.array([0.0, 0.0, 1.0])
        >>> round(float(jv.reflect(lobe, up, up, up)[0]), 4)  # 10 x 12 / (8 pi (2^-4 + 8))
        0.5922
    """


def log_cos_half(wi: Direction, wo: Direction) -> Scalars:
    """Return the logarithm of n.h, () <= 0, no unit, for unit local directions, as -log(1 + (H.x^2
    + H.y^2) / H.z^2) / 2 with H = wi + wo, which is precise enough for the sharpest lobe. The
    result is 0 where H.z <= 0."""
    both = as_vec(wi) + as_vec(wo)
    above = ~(both.z <= smallest_divisor(both.z.dtype))
    z = or_one(both.z, above)
    squared = jnp.square(both.x / z) + jnp.square(both.y / z)
    return -log1p(jnp.where(above, squared, 0)) / 2


def normalisation(exponent: Scalar) -> Scalar:
    """Return the factor C(n) that normalises Blinn's lobe with exponent n, () in sr^-1."""
    n = exponent
    rest = jnp.exp2(-n / 2)
    return (1 + (2 - rest) / (n + rest)) * (n + 4) / (8 * jnp.pi)


def half_vector_integrals(cos_o: Scalar, exponent: Scalar) -> tuple[Scalar, Scalar]:
    """Return the integrals of (n.h)^exponent and of (n.h)^exponent cos(theta_i) over directions
    `wi` above the horizon, () each in sr, with a relative error of 1e-10. With the half vector's
    polar angle t and azimuth phi, dwi = 4 d dh, d = wo.h = P + Q cos(phi), P = cos_o cos(t), Q =
    sin_o sin(t), and cos(theta_i) = 2 d cos(t) - cos_o. The integrals over phi, up to cos(phi_m) =
    -cot(2 t) cot(theta_o), are polynomials in cos(phi) and have closed forms. The integral over t
    is computed by quadrature."""
    width = 2 * 8.5 / jnp.sqrt(exponent + 1)
    (inner, inner_weight), (outer, outer_weight), (p, q) = circles(cos_o, width=width, end=np.pi)
    sin_o = jnp.sqrt(jnp.maximum((1 - cos_o) * (1 + cos_o), jnp.finfo(cos_o.dtype).tiny))

    def ring(doubled: Scalars, phi_m: Scalars, sin_m: Scalars) -> tuple[Scalars, Scalars]:
        """Return the integrands in `doubled` = 2 t: the integrals over |phi| < phi_m at t."""
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


def _direction(material: PowerLobe, wo: Vec, u: Float[Array, "3"]) -> Vec:
    """Draw a half vector h with the density (n + 1) / (2 pi) (n.h)^n, and return `wo` mirrored
    about it."""
    shortfall = -jnp.expm1(log1p(-u[0]) / (material.exponent + 1))
    h = direction_at(shortfall, 2 * jnp.pi * u[1])
    return 2 * dot(wo, h) * h - wo


def _density(material: PowerLobe, wi: Vec, wo: Vec) -> Scalar:
    """Return the density of the directions that `_direction` draws, in sr^-1: the density of the
    half vector h divided by 4 wo.h."""
    both = wi + wo
    upright = Vec(both.x, both.y, jnp.abs(both.z))
    zero = jnp.zeros_like(both.z)
    tall = upright.z > smallest_divisor(both.z.dtype)
    lobe = phong_lobe(log_cos_half(upright, Vec(zero, zero, zero)), material.exponent)
    length = jnp.sqrt(jnp.where(tall, dot(both, both), 1))  # 2 wo.h
    n = material.exponent
    return jnp.where(tall, (n + 1) * lobe / (4 * jnp.pi * length), 0)


def _sizes(material: PowerLobe) -> tuple[Scalar, Scalar]:
    size = 1 / normalisation(material.exponent)
    return size, size


_LOBE = Lobe(
    value=lambda m, wi, wo: phong_lobe(log_cos_half(wi, wo), m.exponent),
    direction=_direction,
    density=_density,
    integrals=lambda m, cos_o: half_vector_integrals(cos_o, m.exponent),
    sizes=_sizes,
    normalisation=lambda m: normalisation(m.exponent),
)


def _bound(x: Ends[Material], convention: Convention) -> Reflection:
    """Return upper bounds on k_s (n.h)^n and on its integral. The integral of the lobe is at most 8
    pi / (n + 1), because dwi = 4 wo.h dh."""
    n, top = least(x, "exponent"), largest(x, "exponent")
    scale = 1.0
    if convention == "normalised":
        scale = (top + 2) * (top + 4) / (8 * np.pi * (n + 2 ** (-n / 2)))
    cosine = convention != "shading"

    def most(a: Angles) -> np.ndarray:
        return scale * power_of(a.cos_half, n) * (a.cos_i if cosine else 1)

    size = scale * min(2 * np.pi, 8 * np.pi / (n + 1))
    return Reflection(
        peak(x, "diffuse"), LargestLobe(peak(x, "specular"), most, size, None, True, not cosine)
    )


register_lobe(Blinn, _LOBE, "shading", _bound)
register_lobe(BlinnBRDF, _LOBE, "brdf", _bound)
register_lobe(NormalisedBlinn, _LOBE, "normalised", _bound)
