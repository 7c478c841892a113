"""Phong's model: an ideal diffuse part plus a power of the cosine to the mirror direction.

Three records have the lobe max(cos(theta_s), 0)^n, where theta_s is the angle to the mirror
direction, and multiply it by different factors:

    record             specular term of f_r         ... of the shading, f_r cos(theta_i)
    Phong              k_s lobe / cos(theta_i)      k_s lobe                the textbook's SHADING
    PhongBRDF          k_s lobe                     k_s lobe cos(theta_i)   the textbook's lobe as
                                                                            a BRDF
    NormalisedPhong    k_s (n + 2) / (2 pi) lobe    that times cos(theta_i)

To convert shading into a BRDF, divide the specular term by the cosine of incidence. The diffuse
coefficient k_d, which is albedo / pi, is the same in all three. Phong is neither reciprocal nor
bounded: it reflects more light than it receives if the light is grazing. PhongBRDF is reciprocal,
and conserves energy if and only if pi k_d + 2 pi k_s / (n + 2) <= 1. NormalisedPhong (Lafortune &
Willems, "Using the Modified Phong Reflectance Model for Physically Based Rendering", 1994) is
reciprocal, and its albedo is at most pi k_d + k_s, reached along the normal. In the local frame the
normal is +z; angles are in radians.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._bounds import Angles, Ends, Reflection, least, peak, power_of
from ..core._bounds import Lobe as LargestLobe
from ..core._bounds import most as largest
from ..core._numerics import dot, log1p, log_cos_between, log_of_zero
from ..core._types import Colour, Scalar, Scalars, check_range
from ..core._vector import Direction, Vec, Vector, as_vec
from ..geometry import mirror_direction
from ..scene import Material
from ._conventions import Convention, Lobe, register_lobe
from ._lobe import PowerLobe, about, lobe_integrals, log_cosine, mirrored, where_above


class Phong(PowerLobe):
    """Phong's SHADING, k_d cos(theta_i) + k_s cos(theta_s) ** exponent, without a cosine in the
    specular term.

    Attributes:
        diffuse: (bands,) k_d in sr^-1, >= 0.
        specular: (bands,) k_s in sr^-1; of shape (1,) for all bands.
        exponent: () n >= 0, no unit.
        ambient: (bands,) k_a, no unit, the reflected part of the ambient radiance, or None. It may
            be the array of k_d itself.

    Example:
        >>> gloss = jv.Phong([0.0], [0.5], 10.0)
        >>> up, aside = jnp.array([0.0, 0.0, 1.0]), jnp.array([0.6, 0.0, 0.8])
        >>> round(float(jv.reflect(gloss, up, aside, up)[0]), 4)  # 0.5 x 0.8^10
        0.0537
    """


class PhongBRDF(PowerLobe):
    """A material with the BRDF k_d + k_s cos(theta_s) ** exponent, where theta_s is the angle to
    the mirror direction.

    Attributes:
        diffuse: (bands,) k_d in sr^-1, >= 0.
        specular: (bands,) k_s in sr^-1; of shape (1,) for all bands.
        exponent: () n >= 0, no unit.
        ambient: (bands,) k_a, no unit, the reflected part of the ambient radiance, or None.

    Example:
        >>> gloss = jv.PhongBRDF([0.0], [0.5], 10.0)
        >>> up, aside = jnp.array([0.0, 0.0, 1.0]), jnp.array([0.6, 0.0, 0.8])
        >>> round(float(jv.reflect(gloss, up, aside, up)[0]), 4)  # 0.5 x 0.8^10 x 0.8
        0.0429
    """


class NormalisedPhong(PowerLobe):
    """A material with the BRDF k_d + k_s (n + 2) / (2 pi) cos(theta_s) ** n, whose lobe conserves
    energy. The lobe's albedo is k_s along the normal, and less elsewhere, because the horizon cuts
    the lobe.

    Attributes:
        diffuse: (bands,) k_d in sr^-1, >= 0.
        specular: (bands,) k_s, no unit, the lobe's
            albedo along the normal; of shape (1,) for all bands.
        exponent: () n >= 0, no unit.
        ambient: (bands,) k_a, no unit, the reflected part of the ambient radiance, or None.

    Example:
        >>> lobe = jv.NormalisedPhong([0.0], [1.0], 8.0)
        >>> up = jnp.array([0.0, 0.0, 1.0])
        >>> round(float(jv.reflect(lobe, up, up, up)[0]), 4)  # (8 + 2) / (2 pi)
        1.5915
    """


@takes_numbers
def phong_lobe(log_cos_mirror: Scalars, exponent: Scalars) -> Scalars:
    """Return the Phong lobe max(cos(theta_s), 0) ** exponent, given the logarithm of cos(theta_s).

    Args:
        log_cos_mirror: (...) log of the cosine between view and mirror direction, <= 0, no unit, as
            `log_cos_between` returns it. For an angle of 90 degrees or more, the value of
            `log_cos_between` stands for a cosine of 0; there the lobe and its gradients are 0 for
            every exponent.
        exponent: (...) >= 0, no unit; the arguments broadcast.

    Returns:
        The lobe, not normalised, (...) in [0, 1], no unit.

    Raises:
        ValueError: for a positive number, which is probably the cosine itself. A negative cosine
            cannot be detected, so take the logarithm by `log_cos_between`.

    Source: Szeliski, Computer Vision, section 2.2.2.

    Example:
        >>> print(jv.phong_lobe(jnp.log(jnp.array(0.9)), jnp.array(10.0)).round(6))
        0.348678
    """
    check_range("phong_lobe: log_cos_mirror", log_cos_mirror, -np.inf, 0, finite=False, nan=True)
    least = log_of_zero(log_cos_mirror.dtype)
    behind = log_cos_mirror <= least
    # -inf instead of a result of 0, because XLA may compute `behind` twice with different results
    finite = jnp.where(behind, least, log_cos_mirror)
    return jnp.exp(jnp.where(behind, -jnp.inf, exponent * finite))


@takes_numbers
def phong_shading(
    normal: Direction,
    wi: Direction,
    wo: Direction,
    diffuse: Colour,
    specular: Colour,
    exponent: Scalar,
) -> Colour:
    """Return the Phong shading k_d [n.l]+ + k_s [s.v]+ ** exponent, where [x]+ = max(x, 0), l
    points to the light, v to the viewer, and s is the mirror direction of the light.

    Args:
        normal: (3,) unit.
        wi: (3,) unit, toward the light.
        wo: (3,) unit, toward the viewer.
        diffuse: (bands,) k_d in sr^-1.
        specular: (bands,) k_s in sr^-1.
        exponent: () >= 0, no unit.

    Returns:
        Radiance toward the viewer per unit of irradiance on a surface that faces the light,
        (bands,) in sr^-1; 0 where n.l <= 0 (the attached shadow) or n.v <= 0 (a viewer below the
        surface, as for the record `Phong`).

    Source: Szeliski, Computer Vision, section 2.2.2, "Phong shading".

    Example:
        >>> up, wi = jnp.array([0.0, 0.0, 1.0]), jnp.array([0.6, 0.0, 0.8])
        >>> lobe = jnp.array([0.2]), jnp.array([0.5]), jnp.array(30.0)
        >>> shading = jv.phong_shading(up, wi, jv.mirror_direction(up, wi), *lobe)
        >>> round(float(shading[0]), 4)  # 0.2 x 0.8 + 0.5
        0.66
    """
    cos_i = dot(normal, wi)
    lobe = phong_lobe(log_cos_between(mirror_direction(normal, wi), wo), exponent)
    height = jnp.minimum(cos_i, dot(normal, wo))
    return where_above(height, diffuse * cos_i + specular * lobe)


def power_direction(axis: Vector, exponent: Scalar, u: Float[Array, "2"]) -> Vec:
    """Draw a unit direction with density `power_pdf` about an axis, from `u`, (2,) uniform in [0,
    1). The angle alpha to the axis has cos(alpha) = (1 - u_0)^(1 / (n + 1)), where n is the
    exponent."""
    return about(axis, -jnp.expm1(log1p(-u[0]) / (exponent + 1)), 2 * jnp.pi * u[1])


def power_pdf(axis: Vector, w: Vector, exponent: Scalar) -> Scalar:
    """Return the density of the directions that `power_direction` draws, (n + 1) / (2 pi)
    max(cos(alpha), 0)^n, () in sr^-1."""
    lobe = phong_lobe(log_cos_between(as_vec(axis), as_vec(w)), exponent)
    return (exponent + 1) / (2 * jnp.pi) * lobe


def power_integrals(cos_axis: Scalar, exponent: Scalar) -> tuple[Scalar, Scalar]:
    """Return the integrals of max(cos(alpha), 0)^n, without and with the factor cos(theta_i), over
    directions above the horizon, () each in sr. The angle alpha is relative to the lobe's axis. If
    the horizon does not cut the lobe, the integrals are 2 pi / (n + 1) and 2 pi cos_axis / (n + 2).
    The quadrature covers 8.5 widths of the lobe; its relative error is 1e-10 for n >= 2, and up to
    2e-5, 3e-6, 3e-9 at n = .1, .5, 1.5."""

    def lobe(alpha: Scalars) -> Scalars:
        return phong_lobe(log_cosine(alpha), exponent)

    width = 8.5 / jnp.sqrt(exponent + 1)
    return lobe_integrals(lobe, cos_axis, width=width, end=np.pi / 2)


_LOBE = Lobe(
    value=lambda m, wi, wo: phong_lobe(log_cos_between(mirrored(wi), wo), m.exponent),
    direction=lambda m, wo, u: power_direction(mirrored(wo), m.exponent, u[:2]),
    density=lambda m, wi, wo: power_pdf(mirrored(wo), wi, m.exponent),
    integrals=lambda m, cos_o: power_integrals(cos_o, m.exponent),
    sizes=lambda m: (2 * jnp.pi / (m.exponent + 1), 2 * jnp.pi / (m.exponent + 2)),
    normalisation=lambda m: (m.exponent + 2) / (2 * jnp.pi),
)


def _power_slope(n: float) -> float:
    """Return the largest slope |d cos^n / d angle| = sqrt(n) (1 - 1/n)^((n-1)/2), the maximum of n
    cos^(n-1) sin; it is 1 at n = 1. For n < 1 the slope is unbounded at a right angle, and for n =
    0 the lobe is a step."""
    if n < 1:
        return np.inf
    return float(np.sqrt(n) * (1 - 1 / n) ** ((n - 1) / 2)) if n > 1 else 1.0


def _bound(x: Ends[Material], convention: Convention) -> Reflection:
    """Return upper bounds on k_s max(cos(theta_s), 0)^n, for the smallest exponent, which gives the
    broadest lobe."""
    n, top = least(x, "exponent"), largest(x, "exponent")
    scale = (top + 2) / (2 * np.pi) if convention == "normalised" else 1.0
    cosine = convention != "shading"

    def most(a: Angles) -> np.ndarray:
        cos_mirror = np.where(a.off_mirror < np.pi / 2, np.cos(a.off_mirror), 0)
        return scale * power_of(cos_mirror, n) * (a.cos_i if cosine else 1)

    # slope of the power, which is smallest between n = 1 and 2, plus slope of the cosine
    slope = scale * (max(_power_slope(n), _power_slope(top)) + cosine)
    size = scale * 2 * np.pi / (n + 1)
    lobe = LargestLobe(peak(x, "specular"), most, size, slope, True, not cosine)
    return Reflection(peak(x, "diffuse"), lobe)


register_lobe(Phong, _LOBE, "shading", _bound)
register_lobe(PhongBRDF, _LOBE, "brdf", _bound)
register_lobe(NormalisedPhong, _LOBE, "normalised", _bound)
