"""Oren-Nayar: a rough surface of Lambertian facets, whose shading is flatter than Lambert's and
shows retroreflection.

    qualitative   f_r = k_d (A + B max(0, cos(phi_i - phi_o)) sin(alpha) tan(beta))
    full          with interreflections between facets (the paper's equations 27 to 30)

alpha is the larger of the two polar angles, beta the smaller. A and B depend on the roughness
sigma; sigma = 0 is Lambert. Both forms of the model are reciprocal. Neither form conserves energy
exactly: with facets of albedo 1, at grazing views, the albedo reaches 1.015 in the qualitative form
(sigma 0.2) and 1.05 in the full form (sigma 0.3). The full form is the paper's fit to simulations.
In forward scattering near grazing angles the fit can be negative; it is then set to 0. In the local
frame the normal is +z; angles are in radians. Source: Oren & Nayar, "Generalization of Lambert's
Reflectance Model", SIGGRAPH 1994.
"""

from typing import Annotated, Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..core._bounds import Ends, Reflection, least, most, peak
from ..core._numerics import arctan2, safe_sqrt, smallest_divisor
from ..core._types import (
    AMOUNT,
    NOT_NEGATIVE,
    Colour,
    Range,
    Scalar,
    as_float,
    as_optional_float,
    check_choice,
    check_fields,
)
from ..core._vector import Direction, as_vec
from ..scene import Material
from ._lobe import divisor, where_seen
from ._registry import register


class OrenNayar(Material):
    """Diffuse reflection of a rough surface by the model of Oren and Nayar.

    Attributes:
        diffuse: (bands,) k_d in sr^-1 of the facets, their albedo / pi.
        sigma: () standard deviation of the facets' slope angle, radians, in [0, pi / 2].
        ambient: (bands,) k_a, no unit, the reflected part of the ambient radiance, or None.
        form: "qualitative" or "full"; static.

    Example:
        >>> up, rough = jnp.array([0.0, 0.0, 1.0]), jv.OrenNayar([1.0], 0.5)
        >>> round(float(jv.reflect(rough, up, up, up)[0]), 4)  # 1 - 0.5 x 0.25 / (0.25 + 0.33)
        0.7845
    """

    spectra = ("diffuse",)
    diffuse: Colour = eqx.field(converter=as_float)
    sigma: Scalar = eqx.field(converter=as_float)
    ambient: Colour | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    form: Literal["qualitative", "full"] = eqx.field(
        static=True, default="qualitative", kw_only=True
    )

    def __check_init__(self) -> None:
        check_fields(self, diffuse=AMOUNT, sigma=Range(0, np.pi / 2, nan=True), ambient=AMOUNT)
        check_choice("OrenNayar.form", self.form, ("qualitative", "full"))


def evaluate(material: OrenNayar, wi: Direction, wo: Direction) -> Colour:
    """Return the BRDF f_r, (bands,) in sr^-1."""
    form = _qualitative if material.form == "qualitative" else _full
    return where_seen(wi, wo, form(material, wi, wo))


def _qualitative(material: OrenNayar, wi: Direction, wo: Direction) -> Colour:
    """Return the qualitative form, computed without angles, because sin(theta_i) sin(theta_o)
    cos(phi_i - phi_o) = wi.x wo.x + wi.y wo.y."""
    i, o, variance = as_vec(wi), as_vec(wo), jnp.square(material.sigma)
    a = 1 - 0.5 * variance / (variance + 0.33)
    b = 0.45 * variance / (variance + 0.09)
    toward = jnp.maximum(i.x * o.x + i.y * o.y, 0) / divisor(jnp.maximum(i.z, o.z))
    return material.diffuse * (a + b * toward)


def _full(material: OrenNayar, wi: Direction, wo: Direction) -> Colour:
    """Return the full form: direct light plus one reflection between facets, equations 27 to 30."""
    i, o, variance = as_vec(wi), as_vec(wo), jnp.square(material.sigma)
    sin_i, sin_o = (safe_sqrt(w.x * w.x + w.y * w.y) for w in (i, o))
    theta_i, theta_o = (arctan2(s, divisor(w.z)) for s, w in ((sin_i, i), (sin_o, o)))
    alpha, beta = jnp.maximum(theta_i, theta_o), jnp.minimum(theta_i, theta_o)
    sin_alpha, sin_beta = jnp.maximum(sin_i, sin_o), jnp.minimum(sin_i, sin_o)
    both = sin_i * sin_o
    tilted = both > smallest_divisor(both.dtype)
    cos_phi = (i.x * o.x + i.y * o.y) / jnp.where(tilted, both, 1)
    cos_phi = jnp.where(tilted, jnp.clip(cos_phi, -1, 1), 0)
    tan_beta = sin_beta / divisor(jnp.maximum(i.z, o.z))
    tan_middle = (sin_i + sin_o) / divisor(i.z + o.z)  # of (alpha + beta) / 2

    spread = variance / (variance + 0.09)
    steep = 2 * beta / jnp.pi
    c1 = 1 - 0.5 * variance / (variance + 0.33)
    c2 = 0.45 * spread * (sin_alpha - jnp.where(cos_phi < 0, steep * steep * steep, 0))
    c3 = 0.125 * spread * jnp.square(steep * 2 * alpha / jnp.pi)
    direct = c1 + cos_phi * c2 * tan_beta + (1 - jnp.abs(cos_phi)) * c3 * tan_middle
    bounced = 0.17 * variance / (variance + 0.13) * (1 - cos_phi * steep * steep)
    rho = jnp.pi * material.diffuse
    return jnp.maximum(material.diffuse * (direct + rho * bounced), 0)


def _bound(x: Ends[OrenNayar]) -> Reflection:
    """Return upper bounds on f_r cos(theta_i). In the qualitative form, k_d (A + B sin(alpha)
    tan(beta)) cos(theta_i) is at most k_d (A cos(theta_i) + B), because cos(theta_i) sin(alpha)
    tan(beta) is at most 1. This form differs from Lambert's shading by at most max((1 - A)
    cos(theta_i), B) k_d. In the full form (equations 27 to 30) the second and the third term are
    not large at the same cos(phi), and the light between facets adds at most .34 rho v / (v + .13),
    where v = sigma^2 and rho is the albedo of the facets. The bound is at least k_d, so that it
    also holds if a Lambertian surface replaces the material."""
    v_low, v = least(x, "sigma") ** 2, most(x, "sigma") ** 2
    a_most, a_least = (1 - 0.5 * s / (s + 0.33) for s in (v_low, v))
    b = 0.45 * v / (v + 0.09)
    k_d = peak(x, "diffuse")
    if x.low.form == "qualitative":
        whole, plain = np.maximum(a_most + b, 1), k_d * max(1 - a_least - b, 0)
    else:
        facets = 0.34 * np.pi * k_d * v / (v + 0.13)
        whole = np.maximum(a_most + b + facets, 1)
        plain = k_d * np.maximum(1 - a_least, facets)
    return Reflection(
        k_d * whole,
        plain=plain,
        grazing=float(np.max(b / whole)),
        rough=("sigma", "Oren-Nayar to Lambert"),
        angular=x.low.form == "full",
    )


def _from_file(*, sigma: Annotated[float, NOT_NEGATIVE], **fields: Any) -> OrenNayar:
    """A rough diffuse surface.

    Args:
        sigma: degrees, standard deviation of the facets' slope angle, in [0, 90].
    """
    return OrenNayar(sigma=np.radians(sigma), **fields)


register(OrenNayar, evaluate=evaluate, bound=_bound, from_file=_from_file, isotropic=True)
