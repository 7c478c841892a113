"""A diffuse body under a clear coat, such as plastic, varnished wood or glazed ceramics.

    f_r = F D V                                                    at the interface
        + T_i T_o / eta^2 (f_b(wi', wo') + a_i a_o / (pi (R - S)))    from the body

The first term is the lobe of `TorranceSparrow`. The facets of the interface transmit the share T of
the light, which is 1 minus the share that they reflect. A coat without absorption therefore loses
no light, because light that one facet sends to another is counted as transmitted. The refracted
directions are wi' and wo', f_b is the body's own BRDF and eta the index of the coat. The interface
returns the share r(c) of light that reaches it from the body at the cosine c; r = 1 beyond the
critical angle. A coat of optical depth tau along the normal multiplies the light by exp(-tau / c)
on each passage; r includes both passages. Let a_o be the integral of f_b(w, wo') r c over the
directions w: the share of the light from wo' that the body reflects and the interface returns. R
and S are the means of r and of r a_o under uniform light. The angular distribution of the light
that the interface returns is assumed to be proportional to r, so that the body reflects a_i a_o /
(pi R) of it, and further reflections form a geometric series of the ratio S / R. This assumption is
exact for a Lambertian body under a smooth interface. The model is reciprocal if the body is. The
coat returns at most the share A of the light that its interface transmits, where A is the largest
albedo of the body. A white body under a coat without absorption reflects all light, with an error
of 1e-3 for Lambertian, EON and broad glossy bodies, and of 3e-3 for a glossy body of roughness
0.15.

If the body has a narrower lobe, the returned light stays near the mirror direction, and the model
is less accurate. The table compares the albedo of metal of reflectance 0.9, under a smooth coat of
index 1.5, with a random walk:

    roughness of the metal    largest error of the albedo
    0.4                       0.3 %
    0.2                       1 %
    0.1                       3 %
    0.04                      5 %
    (0.2, 0.4)                3 %
    (0.1, 0.3)                4 %
    (0.05, 0.4)               4 %
    (0.02, 0.2)               6 %

The quadrature of `albedo` does not resolve narrower lobes.

In the local frame the normal is +z."""

from typing import Annotated, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._bounds import Ends, Reflection, least, most
from ..core._numerics import divide, safe_sqrt, smallest_divisor
from ..core._quadrature import gauss_legendre, interpolate_legendre
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
from ..core.parallel_loops import map_
from ..scene import Map, Material
from . import eon, torrance_sparrow
from ._facet_energy import LARGEST_INDEX, LEAST_INDEX, reflected
from ._half_vector import reflected as mirrored_by
from ._lobe import choose, diffuse_share, divisor, mixed_pdf, where_seen
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
        if isinstance(eta, Map):
            raise ValueError("Coated.interface must have one index, got a Map; map the roughness.")
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


def _returned_by_coat(material: Coated, cosine: Scalar) -> Colour:
    """Return r, the share of light at a cosine inside the coat that the interface returns to the
    body, after both ways through the coat, (bands,) or (1,), no unit."""
    eta = material.interface.eta
    squared = 1 - eta[0] * eta[0] * (1 - cosine * cosine)  # of the cosine outside
    outside = reflected(safe_sqrt(squared), material.roughness, eta, material.distribution)
    share = jnp.where(squared > 0, outside, 1)
    if material.optical_depth is None:
        return share
    return share * jnp.exp(-2 * material.optical_depth / divisor(cosine))


def _returned_uniform(
    material: Coated, order: int, *, dense: Literal["grazing", "normal"] | None = None
) -> tuple[Float[Array, " n"], Array]:
    """Return the nodes c of a quadrature over the cosine inside the coat, (n,), and the weights 2 c
    r dc, (n, bands) or (n, 1), whose sum is R. Beyond the critical angle r = 1. At smaller angles c
    dc = t dt / eta^2, where t is the cosine outside the coat. The nodes may be denser near t = 0,
    where r is steep, or near t = 1, where the body's light may depend on sqrt(1 - t)."""
    eta = material.interface.eta[0]
    beyond = safe_sqrt((eta - 1) * (eta + 1)) / eta
    t, dt = gauss_legendre(order)
    if dense == "grazing":
        t, dt = t * t, 2 * t * dt
    elif dense == "normal":
        t, dt = t * (2 - t), 2 * (1 - t) * dt
    t, dt = jnp.asarray(t, eta.dtype), jnp.asarray(dt, eta.dtype)
    inside = safe_sqrt((eta - 1) * (eta + 1) + t * t) / eta
    cosines = jnp.concatenate([beyond * t, inside])
    weights = jnp.concatenate([2 * t * dt * beyond * beyond, 2 * t * dt / (eta * eta)])
    return cosines, weights[:, None] * jax.vmap(lambda c: _returned_by_coat(material, c))(cosines)


def _mean_albedo(material: Coated) -> Colour:
    """Return the mean albedo of the body under uniform light, (bands,), no unit."""
    if isinstance(material.body, Lambert):
        return jnp.pi * material.body.diffuse
    t, dt = (jnp.asarray(x, material.roughness.dtype) for x in gauss_legendre(8))
    of_body = family(material.body).albedo
    views = jax.vmap(lambda c: of_body(material.body, Vec(jnp.sqrt(1 - c * c), 0 * c, c)))(t)
    return (2 * t * dt) @ views


_POLAR, _AZIMUTHS, _NARROW = 12, 48, 10.0  # _NARROW in sr^-1: a denser lobe is sampled
_TURNS = 15  # odd number of azimuths at which the share of an anisotropic body is computed
_AZIMUTHS_OF_SHARES = 2 * np.pi / _TURNS * np.arange(_TURNS)
_DRAWS = (np.arange(1024)[:, None] * np.array([0.8191725134, 0.6710436067, 0.5497004779])) % 1


def _returned_share(material: Coated, w: Vec) -> Colour:
    """Return a_o, the share of the light from the direction `w` inside the coat that the body
    reflects and the interface returns to the body, (bands,), no unit.

    For an EON body, the mean over the azimuth has a closed form, with a kink at the cosine of `w`.
    This function is evaluated at the nodes of `_further`. The sum uses other nodes, so that no node
    lies on a kink. For other bodies, two methods are combined: a product quadrature on both sides
    of the critical angle, which integrates broad lobes, and draws from the body's own sampler,
    which integrate narrow lobes. In each direction the weights of both methods sum to 1 (Veach's
    power heuristic). The draws are a Kronecker sequence (Roberts, "The Unreasonable Effectiveness
    of Quasirandom Sequences", 2018).
    """
    body = material.body
    if isinstance(body, EON):
        cosines, weights = _returned_uniform(material, 16, dense="grazing")
        mean = jax.vmap(lambda c: eon._azimuth_mean(body, c, w.z))(cosines)
        return jnp.pi * (weights * mean).sum(axis=0)
    own = family(body)

    def density(wi: Vec) -> Scalar:
        return jax.lax.stop_gradient(own.pdf(body, wi, w))

    def broad(c: Scalar, phi: Scalar) -> Colour:
        wi = _direction(c, phi)
        return own.evaluate(body, wi, w) / (1 + (density(wi) / _NARROW) ** 2)

    def narrow(u: Float[Array, "3"]) -> Colour:
        wi = jax.lax.stop_gradient(as_vec(own.sample(body, w, u)))
        p = divisor(density(wi))
        light = own.shading(body, wi, w) * _returned_by_coat(material, jnp.maximum(wi.z, 0))
        return light / (p + _NARROW**2 / p)

    cosines, weights = _returned_uniform(material, _POLAR)
    phi = jnp.asarray(2 * np.pi * (np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS, cosines.dtype)
    rings = jax.vmap(lambda c: jax.vmap(lambda angle: broad(c, angle))(phi).mean(axis=0))(cosines)
    drawn = jax.vmap(narrow)(jnp.asarray(_DRAWS, w.z.dtype)).mean(axis=0)
    return jnp.pi * (weights * rings).sum(axis=0) + drawn


def _interpolated(shares: Float[Array, "turns order bands"], w: Vec) -> Colour:
    """Interpolate the share a to a direction outside the coat, from its values at several azimuths
    and at nodes of `_returned_uniform`, by a Fourier series whose terms vanish at the normal."""
    turns = len(shares)
    sine = safe_sqrt(w.x * w.x + w.y * w.y)
    angles = 2 * np.pi / turns * np.outer(np.arange(1, (turns + 1) // 2), np.arange(turns))
    series = np.concatenate([np.full((1, turns), 0.5), np.cos(angles), np.sin(angles)])
    usable = sine > smallest_divisor(sine.dtype)
    x, y = (divide(z, sine, where=usable) for z in (w.x, w.y))
    powers = [(jnp.ones_like(sine), jnp.zeros_like(sine))]  # of x + i y
    for _ in range(turns // 2):
        re, im = powers[-1]
        powers.append((re * x - im * y, re * y + im * x))
    harmonics = jnp.stack([re for re, _ in powers] + [im for _, im in powers[1:]])
    weights = harmonics @ jnp.asarray(2 / turns * series, sine.dtype)
    place = 1 - safe_sqrt(sine * sine / (1 + w.z))  # 1 - sqrt(1 - cos)
    return interpolate_legendre((weights[:, None, None] * shares).sum(axis=0), place)


def _direction(cosine: Scalar, azimuth: Scalar) -> Vec:
    sine = safe_sqrt(1 - cosine * cosine)
    return Vec(sine * jnp.cos(azimuth), sine * jnp.sin(azimuth), cosine)


def _further(material: Coated, wi: Vec, wo: Vec) -> Colour:
    """Return a_i a_o / (pi (R - S)), the body's light after at least one return by the interface,
    (bands,) sr^-1, for two directions outside the coat. If the coat absorbs all light, return 0.
    The share a is computed at a few nodes for all directions together, and interpolated: over the
    cosine and, unless the body is isotropic, the azimuth."""
    if isinstance(material.body, Lambert):
        kept = _returned_uniform(material, 12)[1].sum(axis=0)
        whole = jnp.pi * material.body.diffuse
        return whole * whole * kept / (jnp.pi * (1 - whole * kept))
    order = 12
    cosines, weights = _returned_uniform(material, order, dense="normal")

    def ring(azimuth: Scalar) -> Float[Array, "n bands"]:
        return jax.vmap(lambda c: _returned_share(material, _direction(c, azimuth)))(cosines)

    if family(material.body).isotropic(material.body):
        shares = ring(jnp.zeros((), cosines.dtype))[None]
    else:
        shares = map_(ring, jnp.asarray(_AZIMUTHS_OF_SHARES, cosines.dtype))
    left = weights.sum(axis=0) - (weights * shares.mean(axis=0)).sum(axis=0)
    i, o = (_interpolated(shares[:, order:], w) for w in (wi, wo))
    return divide(i * o, jnp.pi * left, where=~(left <= smallest_divisor(left.dtype)))


def _body_brdf(material: Coated, wi: Direction, wo: Direction) -> Colour:
    """Return the part of f_r that is due to light from the body, (bands,) in sr^-1."""
    light, viewer = as_vec(wi), as_vec(wo)
    i, o = _refracted_inside(material, light), _refracted_inside(material, viewer)
    first = family(material.body).evaluate(material.body, i, o)
    way = (
        _transmitted_by_coat(material, light)
        * _transmitted_by_coat(material, viewer)
        / material.interface.eta**2
    )
    return where_seen(wi, wo, way * (first + _further(material, light, viewer)))


def evaluate(material: Coated, wi: Direction, wo: Direction) -> Colour:
    """Return the BRDF f_r, (bands,) in sr^-1."""
    lobe = torrance_sparrow.microfacet_lobe(_facets(material), wi, wo)
    return lobe + _body_brdf(material, wi, wo)


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

    def body_shading(own: Coated, wi: Vec, viewer: Vec) -> Colour:
        return _body_brdf(own, wi, viewer) * jnp.maximum(wi.z, 0)

    lobe = torrance_sparrow.albedo(_facets(material), wo)
    return lobe + integrate_shading(body_shading, material, wo)


def _bound(x: Ends[Coated]) -> Reflection:
    """Return an upper bound on the shading: the bound on the lobe of the facets plus a bound on the
    light from the body. The light from the body is at most (b + pi b^2 R / (1 - q)) / eta^2, its
    value if the interface transmits all light. Here b is the largest f_b for a direction that
    leaves the coat, so that a_o <= pi b R. The largest a_o of any direction is at most q = pi B (R
    + g), where B (g + (1 - g) cos) bounds f_b cos, because the integral of r dc is at most (1 + R)
    / 2; it is also at most the albedo of the body, k_d pi for `Lambert` and `EON`. R <= 1 - (1 - M)
    / eta^2, where M, the reflectance of the interface for uniform light from outside, is at most
    0.6 for all indices up to 2.5, also for a rough interface."""
    body = suprema(x.field("body"))
    lobe = suprema(Ends(*(_facets(end) for end in x))).lobe
    eta = least(x.field("interface"), "eta"), most(x.field("interface"), "eta")
    down = np.sqrt(1 - 1 / eta[0] ** 2)
    own = body.body * (1 - body.grazing + body.grazing / down)
    again = 1 - 0.4 / eta[1] ** 2
    left = 1 - np.pi * body.body * (again + body.grazing)
    if isinstance(x.low.body, Lambert | EON):
        left = np.maximum(left, 1 - np.pi * most(x.field("body"), "diffuse"))
    further = np.where(left > 0, (np.pi * own) ** 2 * again / np.where(left > 0, left, 1), np.inf)
    whole = (own + further / np.pi) / eta[0] ** 2
    if body.lobe is not None:
        whole = whole + np.inf
    return Reflection(whole, lobe, np.inf, why=body.why, angular=True)


def _from_file(
    *,
    diffuse: Colour | None = None,
    body: Material | None = None,
    roughness: Annotated[float, FRACTION] = 0.0,
    eta: Annotated[float, Range(LEAST_INDEX, LARGEST_INDEX)] = 1.5,
    body_roughness: Annotated[float, FRACTION] | None = None,
    optical_depth: Colour | None = None,
    distribution: Distribution = "ggx",
) -> Coated:
    """A body under a clear coat: `Lambert`, `EON` if `body_roughness` is given, or the material of
    the table `body`.

    Args:
        diffuse: (bands,) k_d of the body in sr^-1.
        body: a table of a material with a BRDF, such as `{ family = "torrance_sparrow", ... }`, in
            place of `diffuse`.
        eta: index of refraction of the coat, no unit, from 1.1 to 2.5.
        body_roughness: r of the body, no unit, in [0, 1].
    """
    if body is not None and body_roughness is not None:
        raise ValueError("body_roughness is that of a matte body; give it within the body.")
    if body is None:
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
    isotropic=lambda material: family(material.body).isotropic(material.body),
)
