"""A diffuse body under a clear coat, such as plastic, varnished wood or glazed ceramics.

    f_r = F D V                                                         at the interface
        + T_i T_o / eta^2 (f_b(wi', wo') + a_i a_o R / (pi (1 - a R)))  from the body

The first term is the lobe of `TorranceSparrow`. The facets of the interface transmit the share T of
the light, which is 1 minus the share that they reflect. A coat without absorption therefore loses
no light, because light that one facet sends to another is counted as transmitted. The refracted
directions are wi' and wo', f_b is the body's own BRDF and eta the index of the coat. The interface
reflects the share R of the light from the body back to the body. The body's albedo is a_i and a_o
for the two directions, and a on average over all directions. Without absorption R = 1 - (1 - M) /
eta^2 by reciprocity, where M is the reflectance of the interface for uniform light from outside. A
coat of optical depth tau along the normal multiplies the light by exp(-tau / cos') on each way
through. The model is exact for a Lambertian body under a smooth interface. For other bodies, light
that the interface reflects back to the body is assumed to be uniform. A white Lambertian body under
a coat without absorption reflects all light. The model is reciprocal. In the local frame the normal
is +z.
"""

from typing import Annotated

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._bounds import Ends, Reflection, least, most
from ..core._numerics import safe_sqrt
from ..core._quadrature import gauss_legendre
from ..core._types import (
    AMOUNT,
    FRACTION,
    Colour,
    Range,
    Scalar,
    as_float,
    as_optional_float,
    check_fields,
    is_known,
)
from ..core._vector import Direction, Vec, as_vec
from ..scene import Material
from . import torrance_sparrow
from ._facet_energy import LARGEST_INDEX, LEAST_INDEX, reflected
from ._half_vector import reflected as mirrored_by
from ._lobe import choose, diffuse_share, mixed_pdf, where_seen
from ._registry import family, integrate_shading, is_delta, register, suprema
from .eon import EON
from .fresnel import Dielectric
from .lambert import Lambert
from .microfacet import Distribution, clamped_roughness, facet_pdf, sample_facet
from .torrance_sparrow import TorranceSparrow


class Coated(Material):
    """A body under a clear coat, with an albedo of at most 1.

    Attributes:
        body: the material under the coat, which has a BRDF, such as `Lambert` or `EON`.
        interface: between the coat and the air, with one index from 1.1 to 2.5.
        roughness: () alpha of the interface, no unit, in [0, 1]; below 1e-6 it counts as 1e-6.
        optical_depth: (bands,) of the coat along the normal, no unit: its absorption per metre
            times its thickness; None for a perfectly clear coat.
        distribution: "ggx" or "beckmann"; static.

    Raises:
        ValueError: for an index outside this range, and if the body is a mirror or glass, or
            reflects more than it receives.

    Example:
        >>> white, up = jv.Lambert([1 / np.pi]), jnp.array([0.0, 0.0, 1.0])
        >>> glazed = jv.Coated(white, jv.Dielectric([1.5]), 0.1)
        >>> print(jv.brdf.albedo(glazed, up).round(3))
        [1.]
    """

    body: Material
    interface: Dielectric
    roughness: Scalar = eqx.field(converter=as_float, default=0.0)
    optical_depth: Colour | None = eqx.field(
        converter=as_optional_float, default=None, kw_only=True
    )
    distribution: Distribution = eqx.field(static=True, default="ggx", kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self, roughness=Range(0, 1, nan=True), optical_depth=AMOUNT)
        if is_delta(self.body):
            raise ValueError(
                f"Coated.body must have a BRDF in sr^-1, got {type(self.body).__name__}, a delta "
                "function: a polished TorranceSparrow (roughness 1e-3) has one."
            )
        diffuse = getattr(self.body, "diffuse", None)
        known = diffuse is not None and is_known(diffuse)
        most = np.pi * np.max(np.asarray(diffuse)) if known else 0
        if most > 1 + 1e-3:
            raise ValueError(
                f"Coated.body reflects {most:.3g} of its light, and at most 1 is possible; diffuse "
                "is in sr^-1, the albedo over pi."
            )
        eta = self.interface.eta
        if jnp.size(eta) != 1 or (
            is_known(eta) and not LEAST_INDEX <= np.asarray(eta).item() <= LARGEST_INDEX
        ):
            raise ValueError(
                f"Coated.interface must have one index from {LEAST_INDEX} to {LARGEST_INDEX}, got "
                f"{eta}."
            )
        _facets(self)  # checks the distribution


def _facets(material: Coated) -> TorranceSparrow:
    """Return the interface as a microfacet material whose diffuse part is black."""
    dtype = material.roughness.dtype
    return TorranceSparrow(
        jnp.zeros(1, dtype),
        jnp.ones(1, dtype),
        material.roughness,
        interface=material.interface,
        distribution=material.distribution,
    )


def _refracted_inside(material: Coated, w: Vec) -> Vec:
    """Return the refracted direction inside the coat for a direction above it; both point up."""
    eta = material.interface.eta[0]
    down = safe_sqrt((eta - 1) * (eta + 1) + w.z * w.z) / eta
    return Vec(w.x / eta, w.y / eta, down)


def _transmitted_by_coat(material: Coated, w: Vec) -> Colour:
    """Return the transmittance T exp(-tau / cos') of interface and coat for the direction `w`,
    (bands,) or (1,), no unit. Here tau is the optical depth, and cos' the cosine inside the
    coat."""
    eta = material.interface.eta
    passed = 1 - reflected(w.z, material.roughness, eta, material.distribution)
    if material.optical_depth is None:
        return passed
    return passed * jnp.exp(-material.optical_depth / _refracted_inside(material, w).z)


def _internal_reflectance(material: Coated) -> Colour:
    """Return R, the share of the body's light that the interface returns to it, (bands,) or (1,),
    no unit. R is the integral of 2 c exp(-2 tau / c) r(c) over the cosine c inside the coat, where
    r is the reflectance of the interface. Beyond the critical angle r = 1. At smaller angles c dc =
    c_o dc_o / eta^2, where c_o is the cosine outside the coat."""
    eta = material.interface.eta
    critical = safe_sqrt((eta - 1) * (eta + 1)) / eta

    def traverse(
        cosine: Float[Array, " _"],
    ) -> Float[Array, " _"]:  # transmittance of the coat for both ways; (1,) or (bands,)
        if material.optical_depth is None:
            return jnp.ones_like(cosine)
        return jnp.exp(-2 * material.optical_depth / cosine)

    def at(t: Scalar) -> Colour:
        outside = reflected(t, material.roughness, eta, material.distribution)
        inside = safe_sqrt((eta - 1) * (eta + 1) + t * t) / eta
        beyond = outside * traverse(inside) / (eta * eta)
        return 2 * t * (critical * critical * traverse(critical * t) + beyond)

    t, dt = (jnp.asarray(x, eta.dtype) for x in gauss_legendre(24))
    return dt @ jax.vmap(at)(t)


def _mean_albedo(material: Coated) -> Colour:
    """Return the mean albedo a of the body under uniform light, (bands,), no unit."""
    if isinstance(material.body, Lambert):
        return jnp.pi * material.body.diffuse
    t, dt = (jnp.asarray(x, material.roughness.dtype) for x in gauss_legendre(8))
    views = jax.vmap(lambda c: _albedo_of_body(material, Vec(jnp.sqrt(1 - c * c), 0 * c, c)))(t)
    return (2 * t * dt) @ views


def _albedo_of_body(material: Coated, w: Vec) -> Colour:
    return family(material.body).albedo(material.body, w)


def _from_body(material: Coated, wi: Direction, wo: Direction) -> Colour:
    """Return the part of f_r that is due to light from the body, (bands,) in sr^-1."""
    light, viewer = as_vec(wi), as_vec(wo)
    i, o = _refracted_inside(material, light), _refracted_inside(material, viewer)
    again = _internal_reflectance(material)
    first = family(material.body).evaluate(material.body, i, o)
    further = _albedo_of_body(material, i) * _albedo_of_body(material, o) * again
    further = further / (jnp.pi * (1 - _mean_albedo(material) * again))
    way = (
        _transmitted_by_coat(material, light)
        * _transmitted_by_coat(material, viewer)
        / material.interface.eta**2
    )
    return where_seen(wi, wo, way * (first + further))


def evaluate(material: Coated, wi: Direction, wo: Direction) -> Colour:
    """Return the BRDF f_r, (bands,) in sr^-1."""
    lobe = torrance_sparrow.microfacet_lobe(_facets(material), wi, wo)
    return lobe + _from_body(material, wi, wo)


def _body_part(material: Coated, wo: Direction) -> Scalar:
    """Return the probability of sampling the body, not the interface."""
    passed = 1 - reflected(
        as_vec(wo).z, material.roughness, material.interface.eta, material.distribution
    )
    return diffuse_share(passed * _mean_albedo(material), 1 - passed)


def _alpha(material: Coated) -> Float[Array, "2"]:
    return clamped_roughness(jnp.broadcast_to(material.roughness, (2,)))


def sample(material: Coated, wo: Direction, u: Float[Array, "3"]) -> Vec:
    """Draw a unit direction, either cosine-distributed about the normal or `wo` mirrored by a facet
    that is visible from `wo`."""
    h = sample_facet(wo, _alpha(material), u[:2])
    return choose(_body_part(material, wo), u, mirrored_by(as_vec(wo), h))


def pdf(material: Coated, wi: Direction, wo: Direction) -> Scalar:
    """Return the density of the directions that `sample` draws, in sr^-1."""
    return mixed_pdf(_body_part(material, wo), wi, facet_pdf(wi, wo, _alpha(material)))


def albedo(material: Coated, wo: Direction) -> Colour:
    """Return the sum of the interface's albedo and, by quadrature, the body's albedo, (bands,), no
    unit."""

    def from_body(own: Coated, wi: Vec, viewer: Vec) -> Colour:
        return _from_body(own, wi, viewer) * jnp.maximum(wi.z, 0)

    lobe = torrance_sparrow.albedo(_facets(material), wo)
    return lobe + integrate_shading(from_body, material, wo)


def _bound(x: Ends[Coated]) -> Reflection:
    """Return an upper bound on the shading: the bound on the lobe of the facets plus a bound on the
    light from the body. The light from the body is at most (b + A^2 R / (pi (1 - A R))) / eta^2,
    its value if the interface transmits all light. Here b is the largest f_b / cos', A the body's
    largest albedo, and R <= 1 - (1 - M) / eta^2. M is at most 0.6 for all indices up to 2.5, also
    for a rough interface."""
    body = suprema(x.of("body"))
    lobe = suprema(Ends(*(_facets(end) for end in x))).lobe
    eta = least(x.of("interface"), "eta"), most(x.of("interface"), "eta")
    down = np.sqrt(1 - 1 / eta[0] ** 2)
    own = body.body * (1 - body.grazing + body.grazing / down)
    brightest = np.pi * body.body * (1 + body.grazing)
    again = 1 - 0.4 / eta[1] ** 2
    left = 1 - brightest * again
    further = np.where(left > 0, brightest**2 * again / np.where(left > 0, left, 1), np.inf)
    whole = (own + further / np.pi) / eta[0] ** 2
    if body.lobe is not None:
        whole = whole + np.inf
    return Reflection(whole, lobe, np.inf, why=body.why, angular=True)


def _from_file(
    *,
    diffuse: Colour,
    roughness: Annotated[float, FRACTION] = 0.0,
    eta: Annotated[float, Range(LEAST_INDEX, LARGEST_INDEX)] = 1.5,
    body_roughness: Annotated[float, FRACTION] | None = None,
    optical_depth: Colour | None = None,
    distribution: Distribution = "ggx",
) -> Coated:
    """A matt body under a clear coat; `body_roughness` is the roughness of an `EON` body, without
    which the body is `Lambert`.

    Args:
        diffuse: (bands,) k_d of the body in sr^-1.
        eta: index of refraction of the coat, no unit, from 1.1 to 2.5.
        body_roughness: r of the body, no unit, in [0, 1].
    """
    body = Lambert(diffuse) if body_roughness is None else EON(diffuse, body_roughness)
    return Coated(
        body,
        Dielectric(np.atleast_1d(eta)),
        roughness,
        optical_depth=optical_depth,
        distribution=distribution,
    )


register(
    Coated,
    evaluate=evaluate,
    sample=sample,
    pdf=pdf,
    albedo=albedo,
    bound=_bound,
    from_file=_from_file,
)
