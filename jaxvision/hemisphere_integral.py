"""The rendering equation at one surface point, as an integral over directions, with its error.

    L(wo) = integral over the hemisphere of L_i(wi) S(wi, wo) dwi

with L_i the radiance that arrives and S the material's shading, as in `shading`. Radiance in
W m^-2 sr^-1, lengths in m. For ONE point: the caller vmaps.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from . import brdf
from ._directions import arriving_from, balanced, in_frame, in_world
from ._numerics import reciprocal, safe_sqrt
from ._types import Colour, Key, check_count
from ._vector import Vec, Vector, as_vec
from .geometry import Shapes, sorted_shapes
from .hemisphere import product_nodes
from .scene import Light, Material
from .shadows import Leaving, Place


class Estimate(eqx.Module):
    """`value`: (bands,) W m^-2 sr^-1. `error`: (bands,), in the same unit: what the function that
    made it says it is."""

    value: Colour
    error: Colour


def hemisphere_radiance(
    material: Material,
    incident_radiance: Callable[[Vector], Colour],
    normal: Vector,
    wo: Vector,
    *,
    tangent: Vector | None = None,
    polar: int = 32,
    azimuths: int = 64,
) -> Estimate:
    """The integral over the hemisphere by Gauss-Legendre in cos(theta) times the trapezium rule.

    `incident_radiance(wi)`: (bands,) W m^-2 sr^-1 that arrives from the unit direction `wi`.
    `normal`, `wo`: (3,) unit. `polar`, `azimuths`: static node counts, at least 2 each, else
    `ValueError`. The error is the difference to the rule of half as many nodes each way: far above
    the truth for smooth light and surface, about it for light with edges, and blind to a lobe or a
    light that falls between all nodes (a mirror among them).
    """
    check_count("polar", polar, 2)
    check_count("azimuths", azimuths, 2)
    frame, viewer = in_frame(normal, wo, tangent)

    def integral(polar: int, azimuths: int) -> Colour:
        directions, weights = (
            jnp.asarray(x, viewer.z.dtype) for x in product_nodes(polar, azimuths)
        )

        def at(wi: Vec) -> Colour:
            return incident_radiance(in_world(frame, wi, wo)) * brdf.shading(material, wi, viewer)

        return (weights[:, None] * jax.vmap(at)(as_vec(directions))).sum(axis=0)

    value = integral(polar, azimuths)
    return Estimate(value, jnp.abs(value - integral(polar // 2, azimuths // 2)))


def sampled_radiance(
    key: Key,
    material: Material,
    incident_radiance: Callable[[Vector], Colour],
    normal: Vector,
    wo: Vector,
    *,
    samples: int,
    tangent: Vector | None = None,
) -> Estimate:
    """The integral over the hemisphere by directions drawn as the material reflects them.

    `incident_radiance(wi)`: (bands,) W m^-2 sr^-1 that arrives from the unit direction `wi`.
    `normal`, `wo`: (3,) unit. `samples`: static, at least 2, else `ValueError`. The error is the
    standard error of the mean: unbiased, but low whenever a rare bright light was not met.
    """
    check_count("samples", samples, 2)
    frame, viewer = in_frame(normal, wo, tangent)
    if (mirror := brdf.seen_in_mirror(material, viewer)) is not None:
        toward, reflectance = mirror
        arriving = incident_radiance(in_world(frame, toward, wo))
        return Estimate(reflectance * arriving, jnp.zeros_like(arriving))

    def draw(u: Float[Array, "3"]) -> Colour:
        wi = as_vec(brdf.sample(material, viewer, u))
        density = brdf.pdf(material, wi, viewer)
        arriving = incident_radiance(in_world(frame, wi, wo))
        return arriving * brdf.shading(material, wi, viewer) * reciprocal(density)

    return _mean(jax.vmap(draw)(jax.random.uniform(key, (samples, 3), viewer.z.dtype)))


def lit_radiance(
    key: Key,
    material: Material,
    light: Light,
    point: Vector,
    normal: Vector,
    wo: Vector,
    *,
    samples: int,
    tangent: Vector | None = None,
    occluders: Shapes | None = None,
) -> Estimate:
    """Radiance from `point` under one extended light, each sample a direction drawn from the light
    and one from the material, joined by the balance heuristic (Veach and Guibas, "Optimally
    Combining Sampling Techniques for Monte Carlo Rendering", SIGGRAPH 1995): near the better of
    both, whether the lobe or the light is the smaller one.

    `point`: (3,) m. `normal`, `wo`: (3,) unit. `samples`: static, at least 2, else `ValueError`, as
    for a light at one place. `occluders`: as `outgoing_radiance` takes them. (bands,) in
    W m^-2 sr^-1; the error is the standard error of the mean, 0 for a mirror, which shows what lies
    along its one ray. For several lights, and inside a `render`, `outgoing_radiance` does the same
    by the rule `Balanced`.
    """
    check_count("samples", samples, 2)
    frame, viewer = in_frame(normal, wo, tangent)
    place = None if occluders is None else Place(point, Leaving(normal), sorted_shapes(occluders))
    if (mirror := brdf.seen_in_mirror(material, viewer)) is not None:
        toward, reflectance = mirror
        arriving = arriving_from(light, point, in_world(frame, toward, point), place)
        return Estimate(reflectance * arriving, jnp.zeros_like(arriving))

    def draw(u: Float[Array, "5"]) -> Colour:
        return balanced(material, light, point, frame, viewer, u[:2], u[2:], place)

    return _mean(jax.vmap(draw)(jax.random.uniform(key, (samples, 5), viewer.z.dtype)))


def _mean(values: Float[Array, "samples bands"]) -> Estimate:
    count = values.shape[0]
    return Estimate(values.mean(axis=0), safe_sqrt(values.var(axis=0, ddof=1) / count))
