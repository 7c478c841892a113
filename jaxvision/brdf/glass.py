"""A smooth interface of a clear body: part of the light is mirrored, the rest goes through, bent.

Two delta functions, which no number in sr^-1 describes, so that `evaluate`, `shading` and `pdf` are
0, as a mirror's. What a ray does here is `interface`: the mirrored direction with the reflectance F
of Fresnel's exact equations, and the refracted one with 1 - F, by Snell's law

    sin(theta_t) = sin(theta_i) / eta

with eta the index behind the surface over that before it; where no theta_t exists, F = 1 (total
internal reflection). Flux is shared as F and 1 - F. Radiance that comes through is besides
squeezed into another solid angle: L / n^2 is what stays along a ray (Veach, "Robust Monte Carlo
Methods for Light Transport Simulation", 1997, section 5.2), so that who follows radiance from the
eye multiplies by 1 / eta^2, and who follows light does not. In at one side and out at the other it
cancels. Local frame; the body is below the normal, +z.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._numerics import safe_sqrt
from .._types import Colour, Scalar, as_float, as_optional_float, check_shape
from .._vector import Vec, Vector, as_vec, where
from ..scene import Material
from ._lobe import mirrored
from ._registry import register
from .fresnel import fresnel_dielectric


class Glass(Material):
    """What a closed shape with outward normals is filled with: glass, water, a crystal.

    `index`: (), index of refraction of the inside over that of the outside, > 0, no unit: the same
    for all bands, so nothing is dispersed. `absorption`: (bands,) m^-1 by Lambert and Beer,
    exp(-absorption x distance) inside; None is perfectly clear.
    """

    index: Scalar = eqx.field(converter=as_float)
    absorption: Colour | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)

    def __check_init__(self) -> None:
        check_shape("Glass.index", self.index, ())
        check_shape("Glass.absorption", self.absorption, ("bands",))


class Split(eqx.Module):
    """What becomes of a ray at an interface. `mirrored`, `refracted`: unit, local, away from the
    surface. `reflectance`: () part of the flux that is mirrored, no unit; 1 in total reflection,
    where `refracted` is the direction along the surface. `eta`: () index behind over before."""

    mirrored: Vec
    refracted: Vec
    reflectance: Scalar
    eta: Scalar


def refracted_direction(w: Vector, eta: Scalar) -> Vec:
    """The direction through a smooth interface of relative index `eta` (behind over before, no
    unit) on the other side than `w`: -x / eta, -y / eta, and the rest of a unit vector.

    `w`: (3,) unit, local, on either side. In total reflection, where nothing goes through, it is
    the direction along the surface, and z is 0.
    """
    v = as_vec(w)
    # 1 - (1 - z^2) / eta^2 = (eta^2 - 1 + z^2) / eta^2: nothing cancels near equal indices
    below = safe_sqrt((eta - 1) * (eta + 1) + v.z * v.z) / eta
    aside = v.x * v.x + v.y * v.y
    through = (eta - 1) * (eta + 1) + v.z * v.z > 0
    slant = aside > 0
    along = 1 / jnp.sqrt(jnp.where(slant, aside, 1))
    scale = jnp.where(through, 1 / eta, along)
    return Vec(-v.x * scale, -v.y * scale, jnp.where(v.z > 0, -below, below))


def interface(material: Glass, w: Vector) -> Split:
    """Where a ray against `w`, (3,) unit, local, goes on: `w` above the surface comes from
    outside, below from inside; no unit."""
    v = as_vec(w)
    eta = jnp.where(v.z > 0, material.index, 1 / material.index)
    reflectance = fresnel_dielectric(jnp.abs(v.z), eta[None])[0]
    return Split(mirrored(v), refracted_direction(v, eta), reflectance, eta)


def evaluate(material: Glass, wi: Vector, wo: Vector) -> Colour:
    """0 everywhere: (1,) in sr^-1."""
    del wi, wo
    return jnp.zeros_like(material.index)[None]


def sample(material: Glass, wo: Vector, u: Float[Array, "3"]) -> Vec:
    """The mirrored direction with probability F, else the refracted one; by u_2."""
    split = interface(material, wo)
    return where(u[2] < split.reflectance, split.mirrored, split.refracted)


def pdf(material: Glass, wi: Vector, wo: Vector) -> Scalar:
    """0: a delta function has no density in sr^-1."""
    del material, wi
    return jnp.zeros_like(as_vec(wo).z)


def albedo(material: Glass, wo: Vector) -> Colour:
    """The mirrored part, (1,), no unit; 0 from below: what goes through is not reflected."""
    return jnp.where(as_vec(wo).z > 0, interface(material, wo).reflectance, 0)[None]


register(Glass, evaluate=evaluate, sample=sample, pdf=pdf, albedo=albedo)
