"""EON, the energy-preserving Oren-Nayar model: a rough matte surface whose facets illuminate each
other.

    f_r = k_d A (1 + r s / t)                                single reflection (Fujii's form)
        + k_m A r (c_1 - G_i / pi) (c_1 - G_o / pi) / (c_1 - c_2)    further reflections

where r is the roughness, s = wi.wo - cos(theta_i) cos(theta_o), t the larger of the two cosines if
s > 0, else 1, A = 1 / (1 + c_1 r), c_1 = 1/2 - 2 / (3 pi) and c_2 = 2/3 - 28 / (15 pi). Further,
rho = pi k_d is the albedo of the facets, E = A (1 + c_2 r) the mean albedo of a single reflection
by white facets, and k_m = k_d rho E / (1 - rho (1 - E)). G_i and G_o are values of the function G
in `_missing` for the two directions. White facets (rho = 1) reflect all light in every view, and r
= 0 is Lambert. The model is reciprocal. In the local frame the normal is +z. Source: Portsmouth,
Kutz & Hill, "EON: A Practical Energy-Preserving Rough Diffuse BRDF", JCGT 14(1) (2025).
"""

from typing import Annotated, Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..core._bounds import Ends, Reflection, most, peak
from ..core._numerics import arctan2, safe_sqrt
from ..core._types import (
    AMOUNT,
    FRACTION,
    SHARE,
    Colour,
    Scalar,
    as_float,
    as_optional_float,
    check_fields,
)
from ..core._vector import Direction, Vec, as_vec
from ..scene import Material
from ._lobe import divisor, where_above, where_seen
from ._registry import register

_C1 = 1 / 2 - 2 / (3 * np.pi)
_C2 = 2 / 3 - 28 / (15 * np.pi)


class EON(Material):
    """A rough diffuse surface that loses no light between its facets.

    Attributes:
        diffuse: (bands,) k_d in sr^-1 of the facets, their albedo / pi.
        roughness: () r, no unit, in [0, 1]; 0 is Lambert.
        ambient: (bands,) k_a, no unit, the reflected part of the ambient radiance, or None.
        facet_albedo: (bands,) or (1,) for all bands, no unit, in [0, 1]: albedo of the facets for
            light that they send to each other. None takes pi k_d, at most 1. Give a value in a fit
            with an arbitrary unit of light, where k_d is not albedo / pi.

    Example:
        >>> up, white = jnp.array([0.0, 0.0, 1.0]), jv.EON([1 / np.pi], 0.8)
        >>> print(jv.brdf.albedo(white, up).round(6))
        [1.]
    """

    spectra = ("diffuse",)
    diffuse: Colour = eqx.field(converter=as_float)
    roughness: Scalar = eqx.field(converter=as_float)
    ambient: Colour | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    facet_albedo: Colour | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self, diffuse=AMOUNT, roughness=SHARE, ambient=AMOUNT, facet_albedo=SHARE)


def _missing(w: Vec) -> Scalar:
    """Return c_1 - G / pi >= 0, no unit: the share of light that a single reflection loses, divided
    by A r. The function G is 0 along the normal and pi c_1 at the horizon."""
    sine = safe_sqrt(w.x * w.x + w.y * w.y)
    theta = arctan2(sine, divisor(w.z))
    # (1 - sin^3) / cos = cos (1 + sin + sin^2) / (1 + sin), which is finite at the horizon
    rest = w.z * (1 + sine + sine * sine) / (1 + sine) - 1
    return jnp.maximum(_C1 - sine * (theta - sine * w.z + (2 / 3) * rest) / jnp.pi, 0)


def _multiple_scattering_factor(material: EON) -> Colour:
    """Return k_m / k_d, the factor of the term for further reflections, (bands,), no unit."""
    rho = material.facet_albedo
    if rho is None:
        rho = jnp.minimum(jnp.pi * material.diffuse, 1)
    a = 1 / (1 + _C1 * material.roughness)
    lost = a * material.roughness * (_C1 - _C2)  # 1 - E
    return rho * (1 - lost) / (1 - rho * lost)


def evaluate(material: EON, wi: Direction, wo: Direction) -> Colour:
    """Return the BRDF f_r, (bands,) in sr^-1."""
    i, o, r = as_vec(wi), as_vec(wo), material.roughness
    s = i.x * o.x + i.y * o.y
    single = 1 + r * jnp.where(s > 0, s / divisor(jnp.maximum(i.z, o.z)), s)
    further = r * _missing(i) * _missing(o) / (_C1 - _C2)
    a = 1 / (1 + _C1 * r)
    value = material.diffuse * (
        a * (jnp.maximum(single, 0) + _multiple_scattering_factor(material) * further)
    )
    return where_seen(wi, wo, value)


def _azimuth_mean(material: EON, cos_i: Scalar, cos_o: Scalar) -> Colour:
    """Return the mean of f_r over the azimuth for the cosines of light and viewer above the
    surface, (bands,) in sr^-1. The mean of s / t is sin sin' (1 / max(cos, cos') - 1) / pi."""
    sin_i, sin_o = (safe_sqrt(1 - c * c) for c in (cos_i, cos_o))
    r = material.roughness
    mean = sin_i * sin_o * (1 / divisor(jnp.maximum(cos_i, cos_o)) - 1) / jnp.pi
    missing = _missing(Vec(sin_i, 0 * cos_i, cos_i)) * _missing(Vec(sin_o, 0 * cos_o, cos_o))
    further = _multiple_scattering_factor(material) * (r * missing / (_C1 - _C2))
    return material.diffuse * (((1 + r * mean) + further) / (1 + _C1 * r))


def albedo(material: EON, wo: Direction) -> Colour:
    """Return the albedo pi k_d (1 - L) + pi k_m L, (bands,), no unit, where L = A r (c_1 - G / pi)
    is the share of light that a single reflection loses; 0 for a viewer below the surface."""
    viewer = as_vec(wo)
    lost = material.roughness * _missing(viewer) / (1 + _C1 * material.roughness)
    whole = jnp.pi * material.diffuse * (1 - lost * (1 - _multiple_scattering_factor(material)))
    return where_above(viewer.z, whole)


def _bound(x: Ends[EON]) -> Reflection:
    """Return upper bounds on both terms of f_r cos(theta_i). The first term is at most k_d
    (cos(theta_i) + r), because cos(theta_i) s / t is at most 1. The second term is at most k_d r
    c_1^2 / (c_1 - c_2) < 0.4 k_d r. Without the term in s, the shading differs from Lambert's by at
    most the bound on the second term: the factor A lowers the first term by less, because 1 - A <=
    c_1 r.
    """
    r = most(x, "roughness")
    further = r * _C1 * _C1 / (_C1 - _C2)
    whole, k_d = 1 + r + further, peak(x, "diffuse")
    neutral = x.low.facet_albedo is not None and x.low.facet_albedo.shape == (1,)
    return Reflection(
        k_d * whole,
        plain=k_d * further,
        grazing=r / whole,
        rough=("roughness", "EON to Lambert"),
        angular=not neutral,
    )


def _from_file(*, roughness: Annotated[float, FRACTION], **fields: Any) -> EON:
    """A rough diffuse surface that loses no light."""
    return EON(roughness=roughness, **fields)


register(EON, evaluate=evaluate, albedo=albedo, bound=_bound, from_file=_from_file, isotropic=True)
