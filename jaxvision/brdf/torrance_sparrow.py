"""Torrance-Sparrow: a rough surface of tiny mirrors over an ideal diffuse part.

    f_r = k_d + k_s F(wo.h) D(h) G(wi, wo) / (4 cos(theta_i) cos(theta_o))

in full: half-vector, normalised distribution, masking and shadowing, exact Fresnel. (The
textbook's Gaussian of the mirror angle that goes by the same name is `gaussian_lobe`.) Reciprocal.
Light that bounces between facets is lost, so that even where F = 1 the lobe's albedo falls below 1
as the surface gets rougher; k_d is not reduced by what the interface reflects. Local frame,
normal = +z. Sources: Torrance & Sparrow, JOSA 57(9) (1967); Cook & Torrance, ACM TOG 1(1) (1982);
see `microfacet` and `fresnel` for the parts.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._numerics import dot
from .._types import Colour, Scalar, as_float, as_optional_float, check_shape
from .._vector import Vec, Vector, as_vec
from ..scene import Material
from ._lobe import choose, diffuse_share, lit_and_seen, mixed_pdf
from ._registry import register
from .fresnel import Interface, fresnel
from .microfacet import (
    Alpha,
    Distribution,
    Shadowing,
    facet_pdf,
    half_vector,
    normal_distribution,
    sample_facet,
    visibility,
)


class TorranceSparrow(Material):
    """k_d plus k_s times the microfacet lobe.

    `diffuse`: (bands,) k_d in sr^-1. `specular`: (bands,) or neutral (1,), k_s, no unit: 1 for a
    surface that is all facets. `roughness`: () alpha, or (2,) along the tangent and across it, no
    unit; below 1e-6 counts as 1e-6. `interface`: what the facets are made of, `Dielectric`,
    `Conductor` or `Schlick`; None reflects all. `distribution`: "ggx" or "beckmann".
    `shadowing`: "smith" or "v-cavity". `ambient`: (bands,) k_a, no unit, or None.
    """

    diffuse: Colour = eqx.field(converter=as_float)
    specular: Colour = eqx.field(converter=as_float)
    roughness: Scalar | Alpha = eqx.field(converter=as_float)
    interface: Interface | None = eqx.field(default=None, kw_only=True)
    ambient: Colour | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    distribution: Distribution = eqx.field(static=True, default="ggx", kw_only=True)
    shadowing: Shadowing = eqx.field(static=True, default="smith", kw_only=True)

    def __check_init__(self) -> None:
        check_shape("TorranceSparrow.diffuse", self.diffuse, ("bands",))
        check_shape("TorranceSparrow.specular", self.specular, self.diffuse.shape, (1,))
        check_shape("TorranceSparrow.roughness", self.roughness, (), (2,))
        check_shape("TorranceSparrow.ambient", self.ambient, self.diffuse.shape)
        if self.distribution not in ("ggx", "beckmann"):
            raise ValueError(
                "TorranceSparrow.distribution must be 'ggx' or 'beckmann', got "
                f"{self.distribution!r}."
            )
        if self.shadowing not in ("smith", "v-cavity"):
            raise ValueError(
                f"TorranceSparrow.shadowing must be 'smith' or 'v-cavity', got {self.shadowing!r}."
            )


def _alpha(material: TorranceSparrow) -> Alpha:
    return jnp.broadcast_to(material.roughness, (2,))


def microfacet_lobe(material: TorranceSparrow, wi: Vector, wo: Vector) -> Colour:
    """F D G / (4 cos cos), (bands,) or (1,), in sr^-1, without k_s; 0 outside the hemisphere."""
    h, alpha = half_vector(wi, wo), _alpha(material)
    facets = normal_distribution(h, alpha, distribution=material.distribution)
    seen = visibility(
        wi, wo, h, alpha, distribution=material.distribution, shadowing=material.shadowing
    )
    lobe = jnp.where(lit_and_seen(wi, wo), facets * seen, 0)
    if material.interface is None:
        return lobe[None]
    return fresnel(material.interface, dot(as_vec(wo), h)) * lobe


def evaluate(material: TorranceSparrow, wi: Vector, wo: Vector) -> Colour:
    """f_r, (bands,) in sr^-1."""
    body = jnp.where(lit_and_seen(wi, wo), material.diffuse, 0)
    return body + material.specular * microfacet_lobe(material, wi, wo)


def _mirror_about_facet(material: TorranceSparrow, wo: Vector, u: Float[Array, "2"]) -> Vec:
    h = sample_facet(wo, _alpha(material), u)
    viewer = as_vec(wo)
    return 2 * dot(viewer, h) * h - viewer


def _diffuse_part(material: TorranceSparrow, wo: Vector) -> Scalar:
    lobe = material.specular
    if material.interface is not None:
        lobe = lobe * fresnel(material.interface, as_vec(wo).z)
    return diffuse_share(jnp.pi * material.diffuse, lobe)


def sample(material: TorranceSparrow, wo: Vector, u: Float[Array, "3"]) -> Vec:
    """A unit direction from the cosine about the normal, or `wo` mirrored by a facet."""
    lobe = _mirror_about_facet(material, wo, u[:2])
    return choose(_diffuse_part(material, wo), u, lobe)


def pdf(material: TorranceSparrow, wi: Vector, wo: Vector) -> Scalar:
    """Density of `sample` in sr^-1."""
    lobe = facet_pdf(wi, wo, _alpha(material))
    return mixed_pdf(_diffuse_part(material, wo), wi, lobe)


_RADII, _TURNS = 32, 64


def albedo(material: TorranceSparrow, wo: Vector) -> Colour:
    """pi k_d + k_s times the lobe's albedo, (bands,), no unit.

    The lobe is integrated over the unit square of its sampler, 32 Gauss-Legendre nodes times 64
    equal steps, so that one rule serves every roughness; the horizon's edge costs it 2e-4.
    """
    dtype = as_vec(wo).z.dtype
    node, weight = np.polynomial.legendre.leggauss(_RADII)
    turn = (np.arange(_TURNS) + 0.5) / _TURNS
    square = np.stack(np.meshgrid((node + 1) / 2, turn, indexing="ij"), axis=-1).reshape(-1, 2)
    weights = np.repeat(weight / (2 * _TURNS), _TURNS)

    def ratio(u: Float[Array, "2"]) -> Colour:
        wi = _mirror_about_facet(material, wo, u)
        density = facet_pdf(wi, wo, _alpha(material))
        possible = density > 0
        lobe = microfacet_lobe(material, wi, wo) * jnp.maximum(wi.z, 0)
        return jnp.where(possible, lobe / jnp.where(possible, density, 1), 0)

    ratios = jax.vmap(ratio)(jnp.asarray(square, dtype))
    lobe = (jnp.asarray(weights, dtype)[:, None] * ratios).sum(axis=0)
    return jnp.pi * material.diffuse + material.specular * lobe


register(TorranceSparrow, evaluate=evaluate, sample=sample, pdf=pdf, albedo=albedo)
