"""Gaussian lobe: an ideal diffuse part plus a Gaussian of the angle to the mirror direction.

Szeliski's textbook calls this lobe the Torrance-Sparrow term. The lobe depends only on the angle
theta_s to the mirror direction; it is not normalised, and has no Fresnel reflectance and no
masking. The full model is in `torrance_sparrow`. Two records have the lobe exp(-(c_s theta_s)^2)
with the concentration c_s:

    record             specular term of f_r       ... of the shading, f_r cos(theta_i)
    GaussianLobe       k_s lobe / cos(theta_i)    k_s lobe                SHADING, as in `phong`
    GaussianLobeBRDF   k_s lobe                   k_s lobe cos(theta_i)   the same lobe as a BRDF

GaussianLobe is neither reciprocal nor bounded. GaussianLobeBRDF is reciprocal, and a narrow one
(c_s >> 1) conserves energy if pi k_d + pi k_s / c_s^2 <= 1. In the local frame the normal is +z;
angles are in radians.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._bounds import Angles, Ends, Reflection, least, peak
from ..core._bounds import Lobe as LargestLobe
from ..core._bounds import most as largest
from ..core._numerics import dot, log1p, polynomial, safe_sqrt, smallest_divisor
from ..core._types import AMOUNT, Colour, Scalar, Scalars, as_float, as_optional_float, check_fields
from ..core._vector import Direction, Vec, Vector
from ..geometry import mirror_direction
from ..scene import Material
from ._conventions import Convention, Lobe, register_lobe
from ._lobe import ColourOrNeutral, about, divisor, lobe_integrals, mirrored, where_above


class _Concentrated(Material):
    """The fields that the two records of a Gaussian lobe have in common."""

    spectra = ("diffuse",)
    diffuse: Colour = eqx.field(converter=as_float)
    specular: ColourOrNeutral = eqx.field(converter=as_float)
    concentration: Scalar = eqx.field(converter=as_float)
    ambient: Colour | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self, diffuse=AMOUNT, specular=AMOUNT, concentration=AMOUNT, ambient=AMOUNT)


class GaussianLobe(_Concentrated):
    """SHADING by a Gaussian lobe, k_d cos(theta_i) + k_s exp(-(concentration theta_s)^2), without a
    cosine in the specular term.

    Attributes:
        diffuse: (bands,) k_d in sr^-1, >= 0.
        specular: (bands,) k_s in sr^-1; of shape (1,) for all bands.
        concentration: () c_s in rad^-1.
        ambient: (bands,) k_a, no unit, the reflected part of the ambient radiance, or None. It may
            be the array of k_d itself.

    Example:
        >>> gloss, up = jv.GaussianLobe([0.2], [0.5], 30.0), jnp.array([0.0, 0.0, 1.0])
        >>> wi, mirrored = jnp.array([0.6, 0.0, 0.8]), jnp.array([-0.6, 0.0, 0.8])
        >>> round(float(jv.reflect(gloss, up, wi, mirrored)[0]), 4)  # 0.2 x 0.8 + 0.5
        0.66
    """


class GaussianLobeBRDF(_Concentrated):
    """A material with the BRDF k_d + k_s exp(-(concentration theta_s)^2), where theta_s is the
    angle to the mirror direction.

    Attributes:
        diffuse: (bands,) k_d in sr^-1, >= 0.
        specular: (bands,) k_s in sr^-1; of shape (1,) for all bands.
        concentration: () c_s in rad^-1.
        ambient: (bands,) k_a, no unit, the reflected part of the ambient radiance, or None.

    Example:
        >>> gloss, up = jv.GaussianLobeBRDF([0.2], [0.5], 30.0), jnp.array([0.0, 0.0, 1.0])
        >>> wi, mirrored = jnp.array([0.6, 0.0, 0.8]), jnp.array([-0.6, 0.0, 0.8])
        >>> round(float(jv.reflect(gloss, up, wi, mirrored)[0]), 4)  # (0.2 + 0.5) x 0.8
        0.56
    """


# Coefficients of (2 arcsin(sqrt(x) / 2))^2 / x for x <= 2, with the smallest relative error (Remez,
# with 60 digits): 9e-10 for numbers of 4 bytes, 1e-18 for 8 bytes.
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


@takes_numbers
def gaussian_lobe(theta_mirror: Scalars, concentration: Scalars) -> Scalars:
    """Return the Gaussian lobe exp(-(concentration theta_s)^2), theta_s being `theta_mirror`.

    Args:
        theta_mirror: (...) angle between view and mirror direction, radians in [0, pi], as
            `angle_between` returns it.
        concentration: (...) c_s in rad^-1; the lobe falls to 1/e at the angle 1 / c_s. The
            arguments broadcast.

    Returns:
        The lobe, not normalised, (...) in [0, 1], no unit.

    Source: Szeliski, Computer Vision, section 2.2.2, after Torrance and Sparrow.

    Example:
        >>> round(float(jv.gaussian_lobe(jnp.array(0.1), jnp.array(10.0))), 4)  # 1 / e
        0.3679
    """
    return jnp.exp(-jnp.square(concentration * theta_mirror))


@takes_numbers
def gaussian_lobe_shading(
    normal: Direction,
    wi: Direction,
    wo: Direction,
    diffuse: Colour,
    specular: Colour,
    concentration: Scalar,
) -> Colour:
    """Return the shading k_d [n.l]+ + k_s exp(-(c_s theta_s)^2), where [x]+ = max(x, 0), l points
    to the light, and theta_s is the angle between the viewer and the mirror direction.

    Args:
        normal: (3,) unit.
        wi: (3,) unit, toward the light.
        wo: (3,) unit, toward the viewer.
        diffuse: (bands,) k_d in sr^-1.
        specular: (bands,) k_s in sr^-1.
        concentration: () c_s in rad^-1.

    Returns:
        Radiance toward the viewer per unit of irradiance on a surface that faces the light,
        (bands,) in sr^-1; 0 where n.l <= 0 (the attached shadow) or n.v <= 0 (a viewer below the
        surface, as for the record `GaussianLobe`).

    Example:
        >>> up, wi = jnp.array([0.0, 0.0, 1.0]), jnp.array([0.6, 0.0, 0.8])
        >>> lobe = jnp.array([0.2]), jnp.array([0.5]), jnp.array(30.0)
        >>> shading = jv.gaussian_lobe_shading(up, wi, jv.mirror_direction(up, wi), *lobe)
        >>> round(float(shading[0]), 4)  # 0.2 x 0.8 + 0.5
        0.66
    """
    cos_i = dot(normal, wi)
    lobe = _lobe_between(mirror_direction(normal, wi), wo, concentration)
    height = jnp.minimum(cos_i, dot(normal, wo))
    return where_above(height, diffuse * cos_i + specular * lobe)


def _lobe_between(axis: Vector, w: Vector, concentration: Scalar) -> Scalar:
    return jnp.exp(-concentration * (concentration * squared_angle_between(axis, w)))


def squared_angle_between(u: Vector, v: Vector) -> Scalar:
    """Return the square of the angle between unit vectors, () in [0, pi^2] rad^2, within a few ULP.
    The result is a series in the squared chord |u - v|^2, or in |u + v|^2 beyond a right angle,
    which avoids the rounding error of square roots."""
    apart, together = u - v, u + v
    chord, other = dot(apart, apart), dot(together, together)
    coefficients = _SQUARED_ANGLE_OVER_CHORD[8 if chord.dtype == jnp.float64 else 4][::-1]
    near, far = (x * polynomial(coefficients, x) for x in (chord, other))
    return jnp.where(chord <= other, near, jnp.square(jnp.pi - safe_sqrt(far)))


def gaussian_integrals(cos_axis: Scalar, concentration: Scalar) -> tuple[Scalar, Scalar]:
    """Return the integrals of exp(-(c_s alpha)^2), c_s in rad^-1, without and with the factor
    cos(theta_i), over directions above the horizon, () each in sr, with a relative error of 1e-10.
    The angle alpha is relative to the lobe's axis, which has the cosine `cos_axis` to the
    normal."""
    width = 6 / divisor(jnp.abs(concentration))
    return lobe_integrals(
        lambda alpha: gaussian_lobe(alpha, concentration), cos_axis, width=width, end=np.pi
    )


def _kappa(material: _Concentrated) -> Scalar:
    """Return the concentration kappa of the von Mises-Fisher density that is proportional to
    exp(-(c_s chord)^2). This density, before normalisation, is nowhere below the lobe, because a
    chord is shorter than its angle."""
    kappa = 2 * jnp.square(material.concentration)
    return jnp.maximum(kappa, smallest_divisor(kappa.dtype))


def _direction(material: _Concentrated, wo: Vec, u: Float[Array, "3"]) -> Vec:
    """Draw a direction from a von Mises-Fisher distribution about the mirror direction, with 1 -
    cos(alpha) = -log(1 - u_0 (1 - e^(-2 kappa))) / kappa."""
    kappa = _kappa(material)
    one_minus_cos = jnp.clip(-log1p(u[0] * jnp.expm1(-2 * kappa)) / kappa, 0, 2)
    return about(mirrored(wo), one_minus_cos, 2 * jnp.pi * u[1])


def _density(material: _Concentrated, wi: Vec, wo: Vec) -> Scalar:
    """Return the density of the directions that `_direction` draws, in sr^-1."""
    kappa, chord = _kappa(material), wi - mirrored(wo)
    lobe = jnp.exp(-kappa / 2 * dot(chord, chord))
    return -kappa / (2 * jnp.pi * jnp.expm1(-2 * kappa)) * lobe


def _sizes(material: _Concentrated) -> tuple[Scalar, Scalar]:
    kappa = _kappa(material)
    size = -2 * jnp.pi * jnp.expm1(-2 * kappa) / kappa
    return size, size


_LOBE = Lobe(
    value=lambda m, wi, wo: _lobe_between(mirrored(wi), wo, m.concentration),
    direction=_direction,
    density=_density,
    integrals=lambda m, cos_o: gaussian_integrals(cos_o, m.concentration),
    sizes=_sizes,
)


def _bound(x: Ends[Material], convention: Convention) -> Reflection:
    """Return upper bounds on k_s exp(-(c theta_s)^2) and on its integral. The integral of the lobe
    is at most pi / c^2."""
    c = min(abs(least(x, "concentration")), abs(largest(x, "concentration")))
    top = max(abs(least(x, "concentration")), abs(largest(x, "concentration")))
    cosine = convention != "shading"

    def most(a: Angles) -> np.ndarray:
        return np.exp(-((c * a.off_mirror) ** 2)) * (a.cos_i if cosine else 1)

    size = min(2 * np.pi, np.pi / c**2 if c > 0 else np.inf)
    slope = top * np.sqrt(2 / np.e) + cosine
    lobe = LargestLobe(peak(x, "specular"), most, size, slope, True, not cosine)
    return Reflection(peak(x, "diffuse"), lobe)


register_lobe(GaussianLobe, _LOBE, "shading", _bound)
register_lobe(GaussianLobeBRDF, _LOBE, "brdf", _bound)
