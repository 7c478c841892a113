"""The Torrance-Sparrow model: microfacets that are tiny mirrors, plus an ideal diffuse part.

    f_r = k_d + k_s F(wo.h) D(h) G(wi, wo) / (4 cos(theta_i) cos(theta_o))

D is a normalised distribution of the half vector h, G the masking and shadowing, and F the exact
Fresnel reflectance. (Textbooks also call the lobe of `gaussian_lobe` Torrance-Sparrow.) The model
is reciprocal. Light that bounces between facets is lost, so even with F = 1 the lobe's albedo falls
below 1 for rougher surfaces, unless `multiple_scattering` adds

    k_s F_m L_i L_o / (pi L)    F_m = F^2 (1 - L) / (1 - F L)

where L_i and L_o are the shares of light that white facets lose for the two directions. L and F are
the means of L_o and of the Fresnel reflectance under uniform light (Kulla & Conty, "Revisiting
Physically Based Shading at Imageworks", SIGGRAPH 2017 courses). White facets then reflect all light
to within 1e-3. The diffuse coefficient k_d is not reduced by the light that the interface reflects
(`coated` does that), so the only bound on the albedo is pi k_d + k_s. A bright body under glass may
exceed 1 at grazing angles: pi k_d = 0.9, k_s = 1, eta = 1.5, alpha = 0.1 reflects 0.94, 0.99, 1.14,
1.25, 1.28 at cos(theta_o) = 1, 0.5, 0.2, 0.05, 0.02. In the local frame the normal is +z. Sources:
Torrance & Sparrow, JOSA 57(9) (1967); Cook & Torrance, ACM TOG 1(1) (1982); see `microfacet` and
`fresnel` for the parts.
"""

from dataclasses import replace
from typing import Annotated, Any, Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._bounds import Angles, Ends, Reflection, numbers, peak
from ..core._bounds import Lobe as LargestLobe
from ..core._bounds import most as largest
from ..core._maps import is_map
from ..core._numerics import (
    arctan2,
    divide,
    dot,
    log1p,
    norm,
    normalize,
    or_one,
    safe_sqrt,
    smallest_divisor,
)
from ..core._quadrature import gauss_legendre
from ..core._types import (
    AMOUNT,
    POSITIVE,
    Colour,
    Scalar,
    as_float,
    as_optional_float,
    check_choice,
    check_fields,
    is_known,
)
from ..core._vector import Direction, Vec, as_vec
from ..scene import Material
from ._facet_energy import SMOOTHEST, lost_energy, mean_lost
from ._half_vector import reflected
from ._lobe import (
    ColourOrNeutral,
    choose,
    diffuse_share,
    divisor,
    mirrored,
    mixed_pdf,
    where_above,
    where_seen,
)
from ._registry import register
from .fresnel import (
    Conductor,
    Dielectric,
    Interface,
    Schlick,
    _largest_reflectance,
    _least_reflectance,
    fresnel,
    mean_reflectance,
)
from .microfacet import (
    LEAST_ROUGHNESS,
    Alpha,
    Distribution,
    Shadowing,
    clamped_roughness,
    facet_pdf,
    half_vector,
    normal_distribution,
    sample_facet,
    visibility,
)

MultipleScattering = Literal["kulla-conty"]
BETWEEN = get_args(MultipleScattering)
LEAST_LOSS = 1e-6  # the mean loss L of facets of roughness 2e-3
ROUGHEST = 3.0  # largest alpha, with facets inclined by 72 degrees; measured ones are below 1.5


class TorranceSparrow(Material):
    """A material with the BRDF k_d plus k_s times a microfacet lobe.

    Attributes:
        diffuse: (bands,) k_d in sr^-1.
        specular: (bands,) or (1,) for all bands, k_s, no unit: 1 for a surface that consists of
            facets only.
        roughness: () alpha, or (2,) along the tangent and across it, no unit; at least 1e-6.
        interface: Fresnel model of the facets, `Dielectric`, `Conductor` or `Schlick`; None for
            reflectance 1.
        ambient: (bands,) k_a, no unit, the reflected part of the ambient radiance, or None.
        distribution: "ggx" or "beckmann"; static.
        shadowing: "smith" or "v-cavity"; static.
        multiple_scattering: "kulla-conty" includes the light that facets send to each other, for
            Smith's shadowing and one roughness up to 1; None omits this light; static.

    Raises:
        ValueError: if the interface has neither one band nor as many as the others; for a roughness
            above 3, which is probably in degrees or per cent; for multiple scattering with two
            roughnesses, one above 1, or v-cavities.

    Example:
        >>> gloss, up = jv.TorranceSparrow([0.0], [1.0], 0.5), jnp.array([0.0, 0.0, 1.0])
        >>> round(float(jv.reflect(gloss, up, up, up)[0]), 4)  # D / 4 = 1 / (4 pi 0.5^2)
        0.3183
    """

    spectra = ("diffuse",)
    diffuse: Colour = eqx.field(converter=as_float)
    specular: ColourOrNeutral = eqx.field(converter=as_float)
    roughness: Scalar | Alpha = eqx.field(converter=as_float)
    interface: Interface | None = eqx.field(default=None, kw_only=True)
    ambient: Colour | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    distribution: Distribution = eqx.field(static=True, default="ggx", kw_only=True)
    shadowing: Shadowing = eqx.field(static=True, default="smith", kw_only=True)
    multiple_scattering: MultipleScattering | None = eqx.field(
        static=True, default=None, kw_only=True
    )

    def __check_init__(self) -> None:
        check_fields(self, diffuse=AMOUNT, specular=AMOUNT, roughness=AMOUNT, ambient=AMOUNT)
        # inside a trace, `self.roughness.max()` would be a tracer even for known numbers
        largest = np.max(np.asarray(self.roughness)) if is_known(self.roughness) else 0
        if largest > ROUGHEST:
            raise ValueError(
                f"TorranceSparrow.roughness is alpha, at most {ROUGHEST:g}, neither degrees nor "
                f"per cent, got {largest:g}."
            )
        spectra = [self.diffuse, self.specular, *jax.tree.leaves(self.interface, is_leaf=is_map)]
        counts = [x.shape[-1] for x in spectra]
        if len(set(counts) - {1}) > 1:
            raise ValueError(
                f"TorranceSparrow.interface must have 1 band or {max(counts[:2])}, as the others, "
                f"got {counts[-1]}."
            )
        for name, words in (("distribution", Distribution), ("shadowing", Shadowing)):
            check_choice(f"TorranceSparrow.{name}", getattr(self, name), get_args(words))
        if self.multiple_scattering is not None:
            check_choice("TorranceSparrow.multiple_scattering", self.multiple_scattering, BETWEEN)
            if self.roughness.shape or largest > 1 or self.shadowing != "smith":
                raise ValueError(
                    "TorranceSparrow.multiple_scattering needs one roughness, at most 1, and "
                    "shadowing 'smith'."
                )


def _alpha(material: TorranceSparrow) -> Alpha:
    return clamped_roughness(jnp.broadcast_to(material.roughness, (2,)))


def microfacet_lobe(material: TorranceSparrow, wi: Direction, wo: Direction) -> Colour:
    """Return the microfacet lobe F D G / (4 cos(theta_i) cos(theta_o)) without k_s, (bands,) or
    (1,) in sr^-1; 0 if either direction lies below the surface."""
    h, alpha = half_vector(wi, wo), _alpha(material)
    facets = normal_distribution(h, alpha, distribution=material.distribution)
    seen = visibility(
        wi, wo, h, alpha, distribution=material.distribution, shadowing=material.shadowing
    )
    lobe = where_seen(wi, wo, facets * seen)
    if material.interface is None:
        return lobe[None]
    return fresnel(material.interface, dot(as_vec(wo), h)) * lobe


def evaluate(material: TorranceSparrow, wi: Direction, wo: Direction) -> Colour:
    """Return the BRDF f_r, (bands,) in sr^-1."""
    body = where_seen(wi, wo, material.diffuse)
    lobe = microfacet_lobe(material, wi, wo)
    if material.multiple_scattering is not None:
        further = (
            _multiple_scattering(material) * _lost_energy(material, wi) * _lost_energy(material, wo)
        )
        lobe = lobe + where_seen(wi, wo, further)
    return body + material.specular * lobe


def _lost_energy(material: TorranceSparrow, w: Direction) -> Scalar:
    """Return the share of light that white facets lose for the direction `w`, no unit."""
    return lost_energy(as_vec(w).z, material.roughness, material.distribution)


def _multiple_scattering(material: TorranceSparrow) -> Colour:
    """Return F_m / (pi L), the factor of the light from multiple scattering, (bands,) or (1,) in
    sr^-1. L in the denominator is at least `LEAST_LOSS`."""
    mean = mean_lost(material.roughness, material.distribution)
    share = 1 / (jnp.pi * jnp.maximum(mean, LEAST_LOSS))
    if material.interface is None:
        return share[None]
    f = mean_reflectance(material.interface)
    return share * f * f * (1 - mean) / (1 - f * mean)


def _cavity_facet(material: TorranceSparrow, wo: Direction, u: Float[Array, "3"]) -> Vec:
    """Draw the normal of a side of a v-shaped groove that is visible from `wo`. First a groove is
    drawn in proportion to its area, then one of its two sides in proportion to the side's area
    projected toward `wo`. Source: Heitz & d'Eon, "Importance Sampling Microfacet-Based BSDFs using
    the Distribution of Visible Normals", CGF 33(4) (2014)."""
    match material.distribution:
        case "ggx":
            squared = u[0] / (1 - u[0])
        case "beckmann":
            squared = -log1p(-u[0])
    slope, phi = safe_sqrt(squared), 2 * jnp.pi * u[1]
    a = _alpha(material) * slope
    h = as_vec(normalize(Vec(a[0] * jnp.cos(phi), a[1] * jnp.sin(phi), jnp.ones_like(phi))))
    near, far = (jnp.maximum(dot(as_vec(wo), side), 0) for side in (h, mirrored(h)))
    seen = near + far > 0
    part = divide(near, near + far, where=seen, otherwise=0.5)
    side = jnp.where(u[2] < part, 1, -1)
    return Vec(side * h.x, side * h.y, h.z)


def _cavity_pdf(material: TorranceSparrow, wi: Direction, wo: Direction) -> Scalar:
    """Return the density, in sr^-1, of the direction `wo` mirrored about a normal that
    `_cavity_facet` draws. The density is D G1 / (4 cos(theta_o)), where G1 = min(1, 2 h.z
    cos(theta_o) / wo.h)."""
    h = half_vector(wi, wo)
    facets = normal_distribution(h, _alpha(material), distribution=material.distribution)
    seen = jnp.maximum(as_vec(wo).z, dot(as_vec(wo), h) / (2 * divisor(h.z)))
    return facets / (4 * divisor(seen))


def _diffuse_part(material: TorranceSparrow, wo: Direction) -> Scalar:
    lobe = material.specular
    if material.interface is not None:
        lobe = lobe * fresnel(material.interface, as_vec(wo).z)
    body = jnp.pi * material.diffuse
    if material.multiple_scattering is not None:
        body = body + lobe.mean() * _lost_energy(material, wo)
    return diffuse_share(body, lobe)


def sample(material: TorranceSparrow, wo: Direction, u: Float[Array, "3"]) -> Vec:
    """Draw a unit direction: cosine-distributed about the normal, or `wo` mirrored by a visible
    facet.

    The weight f_r cos(theta_i) / pdf of the lobe is at most k_s F for v-cavities and for GGX facets
    with Smith's shadowing. For Beckmann facets with Smith's shadowing, which are sampled as GGX,
    the weight is at most 2.7 k_s F.
    """
    part = _diffuse_part(material, wo)
    match material.shadowing:
        case "smith":
            h = sample_facet(wo, _alpha(material), u[:2])
        case "v-cavity":  # the rescaled u_2 chooses the side
            left = (u[2] - part) / or_one(1 - part)
            h = _cavity_facet(material, wo, u.at[2].set(left))
    return choose(part, u, reflected(as_vec(wo), h))


def pdf(material: TorranceSparrow, wi: Direction, wo: Direction) -> Scalar:
    """Return the density of the directions that `sample` draws, in sr^-1."""
    match material.shadowing:
        case "smith":
            lobe = facet_pdf(wi, wo, _alpha(material))
        case "v-cavity":
            lobe = _cavity_pdf(material, wi, wo)
    return mixed_pdf(_diffuse_part(material, wo), wi, lobe)


_RADII, _TURNS = 32, 64
_WIDEST = 6.5  # slope, in units of alpha; only 1e-18 of a Beckmann surface's area is steeper


def albedo(material: TorranceSparrow, wo: Direction) -> Colour:
    """Return the albedo, pi k_d + k_s times the lobe's albedo, (bands,), no unit. The lobe's albedo
    has an error of at most 4e-4 for every roughness and view, and of at most 1e-4 with Smith's
    shadowing where cos(theta_o) > 0.1.

    The lobe's albedo is the mean of F G wo.h / (h.z cos(theta_o)) over the slopes of facets that
    mirror light from above. In units of alpha a slope is r (cos psi, sin psi), where psi is
    relative to the viewer's azimuth. The quadrature over r ends at the horizon, which is the
    positive root of a quadratic equation. There are 32 Gauss-Legendre nodes in r and 32 in each
    half turn of psi. The nodes in psi are denser near pi / 2, where the root changes fast at a
    grazing view. The largest error comes from the kink of the minimum in G of a v-cavity.
    """
    viewer, alpha = as_vec(wo), _alpha(material)
    cos_o = divisor(viewer.z)
    dtype, whole = cos_o.dtype, jnp.ones_like(cos_o)[None]
    lean = Vec(viewer.x * alpha[0], viewer.y * alpha[1], jnp.zeros_like(cos_o))
    steep = norm(lean)
    tilted = steep > smallest_divisor(steep.dtype)
    ahead_x = divide(lean.x, steep, where=tilted, otherwise=1)
    ahead_y = divide(lean.y, steep, where=tilted)

    def towards_light(r: Scalar, k: Scalar, slope: Vec, squared: Scalar) -> Colour:
        """Return F G wo.h / (h.z cos(theta_o)) for the facet whose slope is r times the vector
        `slope`."""
        facing = cos_o + r * k  # wo.h / h.z
        h_z = 1 / jnp.sqrt(1 + r * r * squared)
        h = Vec(r * slope.x * h_z, r * slope.y * h_z, h_z)
        d = facing * h_z
        cos_i = jnp.maximum((cos_o + r * (2 * k - cos_o * r * squared)) * h_z * h_z, 0)
        wi = Vec(2 * d * h.x - viewer.x, 2 * d * h.y - viewer.y, cos_i)
        seen = visibility(
            wi, viewer, h, alpha, distribution=material.distribution, shadowing=material.shadowing
        )
        reflectance = whole if material.interface is None else fresnel(material.interface, d)
        return reflectance * (4 * facing * cos_i * seen)

    def ray(cos_psi: Scalar, sin_psi: Scalar) -> Colour:
        """Return the integral over the length r of the slope, from the normal to the horizon."""
        slope = Vec(
            alpha[0] * (cos_psi * ahead_x - sin_psi * ahead_y),
            alpha[1] * (cos_psi * ahead_y + sin_psi * ahead_x),
            jnp.ones_like(cos_psi),
        )
        squared = slope.x * slope.x + slope.y * slope.y
        # cos(theta_i) = 0 at r = (k + root) / (cos_o squared) = cos_o / (root - k).
        k = steep * cos_psi
        root = jnp.sqrt(k * k + cos_o * cos_o * squared)
        above = jnp.where(k > 0, k + root, cos_o)
        below = jnp.where(k > 0, cos_o * squared, root - k)
        match material.distribution:
            case "ggx":  # r = tan(chi), of density sin(2 chi)
                end = arctan2(above, below)
                r, area = jnp.tan(end * t), end * dt * jnp.sin(2 * end * t)
            case "beckmann":  # of density 2 r exp(-r^2)
                within = above < _WIDEST * below
                end = divide(above, below, where=within, otherwise=_WIDEST)
                r = end * t
                area = end * dt * 2 * r * jnp.exp(-r * r)
        return area @ jax.vmap(towards_light, in_axes=(0, None, None, None))(r, k, slope, squared)

    t, dt = (jnp.asarray(x, dtype) for x in gauss_legendre(_RADII))
    s, ds = (jnp.asarray(x, dtype) for x in gauss_legendre(_TURNS // 2))
    leap = jnp.clip(cos_o / jnp.maximum(steep, cos_o / 8), 1e-3)
    crowding = jnp.arcsinh(jnp.pi / 2 / leap)
    beyond = leap * jnp.sinh(crowding * (2 * s - 1))  # psi - pi / 2
    turn = ds * 2 * crowding * jnp.sqrt(leap * leap + beyond * beyond) / (2 * jnp.pi)
    rays = jax.vmap(ray)
    cos_psi, sin_psi = -jnp.sin(beyond), jnp.cos(beyond)
    lobe = turn @ (rays(cos_psi, sin_psi) + rays(cos_psi, -sin_psi))
    if material.multiple_scattering is not None:
        mean = mean_lost(material.roughness, material.distribution)
        lobe = lobe + jnp.pi * mean * _multiple_scattering(material) * _lost_energy(
            material, viewer
        )
    return jnp.pi * material.diffuse + material.specular * where_above(viewer.z, lobe)


def _bound(x: Ends[TorranceSparrow]) -> Reflection:
    """Return upper bounds on k_s F D V cos(theta_i), where V = G / (4 cos(theta_i) cos(theta_o)).
    Each factor is replaced by its largest value over the angles of a cell.

    D = (1 + t)^2 / (pi ax ay (1 + t / a^2)^2) for GGX, with exp(-t / a^2) in place of the quotient
    for Beckmann; t is the squared tangent of the half vector's polar angle. Smith: V cos_i <= 1 /
    (4 (c_o + H_o)), with c_o + H_o = (c_o + sqrt(c_o^2 + a^2 s_o^2)) / 2 for GGX and at least
    max(c_o, a s_o / (2 sqrt pi)) for Beckmann. V-cavity: V cos_i <= 1 / (4 max(c_o, d^2 / (c_i +
    c_o))). The integral of the lobe is at most 1, because facets never add light. The term of
    multiple scattering is at most cos_i times its largest value over a grid of cosines.
    """
    wide = max(largest(x, "roughness"), LEAST_ROUGHNESS)
    small = np.min([np.broadcast_to(numbers(end.roughness), (2,)) for end in x], axis=0)
    narrow = np.maximum(small, LEAST_ROUGHNESS)
    top, tight = 1 / (np.pi * narrow[0] * narrow[1]), narrow.min()

    def facets(cos_half: np.ndarray) -> np.ndarray:
        least = 1 / np.maximum(cos_half, 1e-150) ** 2  # 1 + t
        if x.low.distribution == "ggx":

            def shape(s: np.ndarray | float) -> np.ndarray | float:
                return (s / (1 + (s - 1) / wide**2)) ** 2

            return top * np.maximum(shape(least), wide**4 if wide > 1 else 0)
        s = np.maximum(least, 2 * wide**2)
        return top * np.minimum(s, 1e150) ** 2 * np.exp(-np.minimum((s - 1) / wide**2, 700))

    def view_bound(a: Angles) -> np.ndarray:
        if x.low.shadowing == "v-cavity":
            both = np.maximum(a.cos_i + a.cos_o_most, 1e-150)
            below = np.maximum(a.cos_o, a.cos_between**2 / both)
        elif x.low.distribution == "ggx":
            root = np.sqrt(a.cos_o**2 + tight**2 * (1 - a.cos_o**2))
            below = np.minimum((a.cos_o + root) / 2, 1)
        else:
            k = tight / (2 * np.sqrt(np.pi))
            below = np.maximum(a.cos_o, k / np.sqrt(1 + k * k))
        return 0.25 / np.maximum(below, 1e-150)

    reflectance, neutral = _largest_reflectance(x.field("interface"))

    further = _largest_returned(x)

    def most(a: Angles) -> np.ndarray:
        single = reflectance(a.cos_between) * facets(a.cos_half) * view_bound(a)
        return single + further * np.maximum(a.cos_i, 0)

    lobe = LargestLobe(peak(x, "specular"), most, float(reflectance(0.0)), None, neutral, False)
    neglected = None
    if x.low.interface is not None:
        full = _bound(Ends(*(replace(end, interface=None) for end in x))).lobe
        assert full is not None
        neglected = _least_reflectance(x.field("interface")) if further == 0 else 0.0, full
    return Reflection(peak(x, "diffuse"), lobe, facets=neglected)


def _largest_returned(x: Ends[TorranceSparrow]) -> float:
    """Return an upper bound on the multiple-scattering term F_m L_i L_o / (pi L) for roughnesses
    between the two ends, in sr^-1. The term is evaluated at several roughnesses and enlarged by 5 %
    to cover roughnesses in between."""
    if x.low.multiple_scattering is None:
        return 0.0
    ends = [float(np.clip(numbers(end.roughness), SMOOTHEST, 1)) for end in x]
    cosines = jnp.linspace(0, 1, 65)
    found = 0.0
    for alpha in np.geomspace(min(ends), max(ends), 16 if ends[0] != ends[1] else 1):
        a = jnp.asarray(alpha, cosines.dtype)
        largest_lost = float(lost_energy(cosines, a, x.low.distribution).max())
        mean = float(mean_lost(a, x.low.distribution))
        found = max(found, largest_lost**2 / (np.pi * max(mean, LEAST_LOSS)))
    return 1.05 * found


def _from_file(
    *,
    specular: Colour | float = 1.0,
    roughness: Annotated[float, POSITIVE] | Annotated[Alpha, POSITIVE],
    eta: Colour | None = None,
    k: Colour | None = None,
    f0: Colour | None = None,
    interface: None = None,
    **fields: Any,
) -> TorranceSparrow:
    """A surface of microfacets, which reflect all light unless `eta` or `f0` is given.

    Args:
        eta: (bands,) index of refraction of the facets, no unit; for a metal the real part.
        k: (bands,) extinction coefficient of a metal, no unit; with `eta` only.
        f0: (bands,) reflectance at normal incidence, no unit, for Schlick's approximation in place
            of `eta`.
    """
    if f0 is not None and eta is not None:
        raise ValueError("give either eta (with k for a metal) or f0.")
    if k is not None and eta is None:
        raise ValueError("k belongs to a metal; give its eta too.")
    made: Interface | None = interface
    if f0 is not None:
        made = Schlick(f0)
    elif eta is not None:
        made = Dielectric(eta) if k is None else Conductor(eta, k)
    return TorranceSparrow(specular=specular, roughness=roughness, interface=made, **fields)


register(
    TorranceSparrow,
    evaluate=evaluate,
    sample=sample,
    pdf=pdf,
    albedo=albedo,
    bound=_bound,
    from_file=_from_file,
    isotropic=lambda material: jnp.ndim(material.roughness) == 0,
)
