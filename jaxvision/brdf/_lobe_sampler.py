"""Importance sampling of a tabulated material in proportion to the light that it reflects.

For a grid of directions `wo`, the reflected luminance is tabulated over the unit square of half
vectors, and `_warp` maps uniform numbers to this density. For directions between the nodes of the
grid, the densities are interpolated. One sample in eight is cosine-distributed instead, so that the
weight f_r cos(theta_i) / pdf never exceeds 8 pi f_r, even where the table underestimates.
Directions are in the local frame, angles in radians, densities in sr^-1.
"""

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._bounds import Ends, Reflection, numbers
from ..core._numerics import divide, normalize, smallest_divisor
from ..core._types import Colour, Scalar
from ..core._vector import Direction, Vec, as_vec
from ..geometry.hemisphere import cosine_direction, cosine_pdf
from ._half_vector import (
    azimuth,
    elevation,
    half_to_square,
    reflected,
    spherical,
    square_to_half,
    stretch,
)
from ._lobe import choose, mixed_pdf
from ._registry import family, integrate_shading
from ._warp import Slices, Square, Warp, slices, tabulated_warp, unwarp, warp

COSINE_PART = 0.125
ALBEDO_ORDER = 64


class LobeSampler(eqx.Module):
    """A sampler for a tabulated material. `lobe` maps uniform numbers to half vectors, for nodes
    (phi, theta) of `wo`. If phi has a single node, the material is isotropic, and the azimuths of
    half vectors are relative to that of `wo`."""

    lobe: Warp


@partial(jax.jit, static_argnames=("rows", "columns"))
def tabulated_lobe(
    material: Any, phi: Float[Array, " p"], theta: Float[Array, " t"], rows: int, columns: int
) -> LobeSampler:
    """Tabulate a material's shading, averaged over bands, and return a sampler that draws from the
    table. For each direction `wo` of the grid phi x theta, in rad, the table has rows x columns
    half vectors. The shading is multiplied by `stretch`, the solid angle per unit of area of the
    square."""
    shading = family(material).shading
    y, x = jnp.linspace(0, 1, rows, dtype=phi.dtype), jnp.linspace(0, 1, columns, dtype=phi.dtype)

    def reflected_part(phi_o: Scalar, theta_o: Scalar, y: Scalar, x: Scalar) -> Scalar:
        wo = spherical(theta_o, phi_o)
        h = square_to_half((x, y), phi_o if phi.shape[0] == 1 else jnp.zeros_like(phi_o))
        return jnp.mean(shading(material, reflected(wo, h), wo)) * stretch(x, h, wo)

    table = reflected_part
    for axis in (3, 2, 1, 0):
        table = jax.vmap(table, [0 if i == axis else None for i in range(4)])
    return LobeSampler(tabulated_warp(phi, theta, jnp.maximum(table(phi, theta, y, x), 0)))


def _view_terms(sampler: LobeSampler, wo: Vec) -> tuple[Slices, Scalar]:
    phi = azimuth(wo)
    origin = phi if sampler.lobe.phi.shape[0] == 1 else jnp.zeros_like(phi)
    return slices(sampler.lobe, phi, elevation(wo)), origin


def _lobe_direction(sampler: LobeSampler, wo: Vec, u: Square) -> Vec:
    at, origin = _view_terms(sampler, wo)
    place, _ = warp(sampler.lobe, at, u)
    return reflected(wo, square_to_half(place, origin))


def _lobe_pdf(sampler: LobeSampler, wi: Vec, wo: Vec) -> Scalar:
    at, origin = _view_terms(sampler, wo)
    h = as_vec(normalize(wi + wo))
    place = half_to_square(h, origin)
    _, density = unwarp(sampler.lobe, at, place)
    area = stretch(place[0], h, wo)
    usable = (h.z > 0) & (area > smallest_divisor(area.dtype))
    return divide(density, area, where=usable)


def sample(material: Any, wo: Direction, u: Float[Array, "3"]) -> Vec:
    """Draw `wi` from the material's `sampler`, or from the cosine distribution if the sampler is
    None, by the numbers `u`, (3,) uniform in [0, 1)."""
    if material.sampler is None:
        return cosine_direction(u[:2])
    part = jnp.asarray(COSINE_PART, u.dtype)
    return choose(part, u, _lobe_direction(material.sampler, as_vec(wo), (u[0], u[1])))


def pdf(material: Any, wi: Direction, wo: Direction) -> Scalar:
    """Return the density of the directions that `sample` draws, in sr^-1 over the whole sphere."""
    if material.sampler is None:
        return cosine_pdf(wi)
    lobe = _lobe_pdf(material.sampler, as_vec(wi), as_vec(wo))
    return mixed_pdf(jnp.asarray(COSINE_PART, lobe.dtype), wi, lobe)


def albedo(material: Any, wo: Direction) -> Colour:
    """Compute the directional albedo, (bands,), no unit. For a material with a sampler, the
    integral is a midpoint rule over the uniform numbers from which directions are drawn, which
    resolves narrow lobes. Other materials use the default product quadrature."""
    shading = family(material).shading
    sampler, wo = material.sampler, as_vec(wo)
    if sampler is None:
        return integrate_shading(shading, material, wo)

    nodes = (jnp.arange(ALBEDO_ORDER, dtype=wo.z.dtype) + 0.5) / ALBEDO_ORDER
    u = jnp.stack(jnp.meshgrid(nodes, nodes), axis=-1).reshape(-1, 2)
    lobe = jax.vmap(lambda u: _lobe_direction(sampler, wo, (u[0], u[1])))(u)
    directions = jax.tree.map(lambda *parts: jnp.stack(parts), lobe, jax.vmap(cosine_direction)(u))

    def weight(wi: Vec) -> Colour:
        density = pdf(material, wi, wo)
        positive = density > 0
        return divide(shading(material, wi, wo), density, where=positive)

    from_lobe, from_cosine = jnp.mean(jax.vmap(jax.vmap(weight))(directions), axis=1)
    return (1 - COSINE_PART) * from_lobe + COSINE_PART * from_cosine


def table_bound(x: Ends[Any]) -> Reflection:
    """Return the largest entry of a table as an upper bound on the BRDF. Linear interpolation never
    exceeds the largest entry. Extrapolation may exceed it, so the bound is then infinite."""
    values = np.maximum(*(np.abs(numbers(end.values)) for end in x))
    body = values.reshape(-1, values.shape[-1]).max(0)
    if getattr(x.low, "outside", "clamp") == "extrapolate":
        return Reflection(body + np.inf, why="a table that is extrapolated has no largest value")
    return Reflection(body, plain=np.inf)
