"""Three conventions for the factor that multiplies a specular lobe, in the BRDF and in the shading.

    convention    specular term of f_r         ... of the shading, f_r cos(theta_i)
    shading       k_s lobe / cos(theta_i)      k_s lobe                the textbook's SHADING
    brdf          k_s lobe                     k_s lobe cos(theta_i)   the lobe as a BRDF
    normalised    k_s C lobe                   k_s C lobe cos(theta_i)

The diffuse term of the BRDF is k_d = albedo / pi in all three. The constant C is chosen so that the
lobe's albedo along the normal is k_s. In the local frame the normal is +z.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..core._bounds import Reflection
from ..core._loops.bands import map_bands
from ..core._types import Colour, Scalar
from ..core._vector import Direction, Vec, as_vec
from ._lobe import choose, diffuse_share, divisor, mixed_pdf, where_seen
from ._registry import register

Convention = Literal["shading", "brdf", "normalised"]


class Lobe(NamedTuple):
    """The functions that describe the shape of a specular lobe, without the factor of its
    convention. Each takes the material, which contains the parameters of the shape."""

    value: Callable[[Any, Vec, Vec], Scalar]  # `value(material, wi, wo)`, () in [0, 1], no unit
    # `direction(material, wo, u)`, a unit direction from `u`, (3,) uniform in [0, 1)
    direction: Callable[[Any, Vec, Float[Array, "3"]], Vec]
    # `density(material, wi, wo)`, () in sr^-1, the density of `direction`
    density: Callable[[Any, Vec, Vec], Scalar]
    # `integrals(material, cos_o)`, the integrals of the lobe, and of the lobe times cos(theta_i),
    # over the directions above the horizon, sr
    integrals: Callable[[Any, Scalar], tuple[Scalar, Scalar]]
    # `sizes(material)`, rough values of the same two integrals for `wo` along the normal, which
    # determine the share of samples for the lobe
    sizes: Callable[[Any], tuple[Scalar, Scalar]]
    # `normalisation(material)`, C in sr^-1; None for a lobe that has none
    normalisation: Callable[[Any], Scalar] | None = None


def register_lobe(
    record: type, lobe: Lobe, convention: Convention, bound: Callable[..., Reflection]
) -> None:
    """Register a record whose BRDF is `diffuse` (k_d) plus `specular` (k_s) times a lobe.
    `bound(ends, convention)` returns upper bounds on the shading of a material between two
    `Ends`."""

    def scale_lobe(material: Any, value: Scalar) -> Scalar:
        if convention != "normalised" or lobe.normalisation is None:
            return value
        return lobe.normalisation(material) * value

    def evaluate(material: Any, wi: Direction, wo: Direction) -> Colour:
        light, viewer = as_vec(wi), as_vec(wo)
        value = scale_lobe(material, lobe.value(material, light, viewer))
        if convention == "shading":
            value = value / divisor(light.z)
        return _two_terms(material, light, viewer, jnp.ones_like(value), value)

    def shading(material: Any, wi: Direction, wo: Direction) -> Colour:
        light, viewer = as_vec(wi), as_vec(wo)
        value = scale_lobe(material, lobe.value(material, light, viewer))
        if convention != "shading":
            value = value * light.z
        return _two_terms(material, light, viewer, light.z, value)

    def diffuse_part(material: Any) -> Scalar:
        plain, with_cosine = lobe.sizes(material)
        match convention:
            case "shading":
                size = plain
            case "brdf":
                size = with_cosine
            case "normalised":
                size = jnp.ones_like(with_cosine)
        return diffuse_share(jnp.pi * material.diffuse, size * material.specular)

    def sample(material: Any, wo: Direction, u: Float[Array, "3"]) -> Vec:
        return choose(diffuse_part(material), u, lobe.direction(material, as_vec(wo), u))

    def pdf(material: Any, wi: Direction, wo: Direction) -> Scalar:
        density = lobe.density(material, as_vec(wi), as_vec(wo))
        return mixed_pdf(diffuse_part(material), wi, density)

    def albedo(material: Any, wo: Direction) -> Colour:
        plain, with_cosine = lobe.integrals(material, as_vec(wo).z)
        size = plain if convention == "shading" else scale_lobe(material, with_cosine)
        return jnp.pi * material.diffuse + material.specular * size

    register(
        record,
        evaluate=evaluate,
        sample=sample,
        pdf=pdf,
        albedo=albedo,
        shading=shading,
        bound=partial(bound, convention=convention),
        isotropic=True,
    )


def _two_terms(material: Any, wi: Vec, wo: Vec, body: Scalar, lobe: Scalar) -> Colour:
    """Return k_d body + k_s lobe, (bands,) in sr^-1; 0 if light or viewer is below the surface."""
    body, lobe = where_seen(wi, wo, body), where_seen(wi, wo, lobe)
    return map_bands(lambda k_d, k_s: k_d * body + k_s * lobe, material.diffuse, material.specular)
