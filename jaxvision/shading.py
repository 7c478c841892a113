"""The rendering equation at one surface point: a sum over sources, or an integral over directions.

    L(wo) = k_a L_a + sum_i E_i S(wi_i, wo)                      discrete sources
    L(wo) = integral over the hemisphere of L_i(wi) S(wi, wo) dwi

with E_i the irradiance a facing surface would receive from source i and S the material's shading:
f_r cos+ of a BRDF, and what the textbook says of Phong and the Gaussian lobe, which put no cosine
on the specular term (Szeliski, Computer Vision, section 2.2.2). Radiance in W m^-2 sr^-1, lengths
in m. Direct light only, no cast shadows. For ONE point: the caller vmaps.
"""

from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from . import brdf
from ._numerics import safe_sqrt
from ._staging import stored
from ._types import Colour, Key, Scalar, group_by_structure
from ._vector import Vec, Vector, as_array, as_vec
from .brdf.mirror import Mirror
from .geometry import Ray, mirror_direction
from .hemisphere import Frame, local_frame, product_nodes, to_local, to_world
from .lights import (
    Balanced,
    Quadrature,
    Rule,
    can_be_seen,
    direction_pdf,
    direction_sample,
    incident_sample,
    incident_samples,
    light_nodes,
    nearest_seen,
    radiance_from,
)
from .scene import AmbientLight, Light, Material

DEFAULT_RULE = Quadrature(8)  # 1e-5 off a quarter of its side below a square light


class Estimate(eqx.Module):
    """`value`: (bands,) W m^-2 sr^-1. `error`: (bands,), in the same unit: what the function that
    made it says it is."""

    value: Colour
    error: Colour


def outgoing_radiance(
    material: Material,
    lights: Sequence[Light],
    point: Vector,
    normal: Vector,
    wo: Vector,
    *,
    ambient: AmbientLight | None = None,
    tangent: Vector | None = None,
    rule: Rule = DEFAULT_RULE,
) -> Colour:
    """Radiance from `point` toward `wo`, the sum over any lights: (bands,) in W m^-2 sr^-1.

    `point`: (3,) m. `normal`, `wo`: (3,) unit. `tangent`: (3,), for an anisotropic material.
    `rule`: how finely extended lights are taken apart; the default, `Quadrature(8)`, is for diffuse
    surfaces under area lights: a glossy one, or a sky with a sun, wants `Balanced`, and `rules` has
    the figures. A surface seen from behind (n.wo <= 0) is black; a mirror shows the extended light
    it reflects. The ambient term is traced only if the
    material reflects it and there is such a light.
    `ValueError` if spectra differ in their number of bands. Lights of one kind, and the samples of
    one light, are a loop over one piece of code: on the CPU, with 8 lights, 2.5 times faster to run
    than the unrolled sum, which recomputes the hit for each light, and 3 times to compile.
    """
    frame, viewer = stored(_frame, normal, wo, tangent)
    dtype = _dtype(material, lights, point, normal, wo)

    def shaded(light: Light, u: Float[Array, "2"], weight: Scalar) -> Colour:
        arriving = incident_sample(light, rule, point, u, weight)
        wi = to_local(frame, arriving.direction)
        return arriving.irradiance * stored(brdf.shading, material, wi, viewer)

    def spectrum(lights: Light) -> Colour:
        light = jax.tree.map(lambda leaf: leaf[0], lights)
        return incident_samples(light, point, rule).irradiance[0]

    def from_light(radiance: Colour, light: Light) -> tuple[Colour, None]:
        nodes, weights = light_nodes(light, rule, dtype)
        if not can_be_seen(light):
            return radiance + shaded(light, nodes[0], weights[0]), None

        @jax.checkpoint
        def from_node(total: Colour, node: tuple[Array, Array]) -> tuple[Colour, None]:
            return total + shaded(light, *node), None

        @jax.checkpoint
        def from_both(total: Colour, node: tuple[Array, Array, Array]) -> tuple[Colour, None]:
            *u, weight = node
            return total + weight * _balanced(material, light, point, frame, viewer, *u), None

        if not isinstance(rule, Balanced):
            return jax.lax.scan(from_node, radiance, (nodes, weights))
        own = jax.random.uniform(jax.random.fold_in(rule.key, 0), (rule.samples, 3), dtype)
        return jax.lax.scan(from_both, radiance, (nodes, own, weights))

    groups = [group for _, group in group_by_structure(lights)]
    spectra = [jax.eval_shape(brdf.shading, material, viewer, viewer).shape]
    spectra += [jax.eval_shape(spectrum, group).shape for group in groups]
    k_a = getattr(material, "ambient", None)
    if ambient is not None:
        spectra.append(ambient.radiance.shape)
    radiance = jnp.zeros(_check_bands(material, spectra), dtype)
    if ambient is not None and k_a is not None:
        radiance = radiance + k_a * ambient.radiance
    for group in groups:
        radiance, _ = jax.lax.scan(from_light, radiance, group)
    if isinstance(material, Mirror):  # a delta function: no sample meets it, but its ray is known
        ray = Ray(point, mirror_direction(as_vec(normal), as_vec(wo)))
        radiance = radiance + brdf.albedo(material, viewer) * nearest_seen(lights, ray).radiance
    return jnp.where(viewer.z > 0, radiance, 0)


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
    if polar < 2 or azimuths < 2:
        raise ValueError(f"polar and azimuths must be at least 2, got {polar} and {azimuths}.")
    frame, viewer = _frame(normal, wo, tangent)

    def integral(polar: int, azimuths: int) -> Colour:
        directions, weights = (
            jnp.asarray(x, viewer.z.dtype) for x in product_nodes(polar, azimuths)
        )

        def at(wi: Vec) -> Colour:
            return incident_radiance(_world(frame, wi, wo)) * brdf.shading(material, wi, viewer)

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
    _check_samples(samples)
    frame, viewer = _frame(normal, wo, tangent)
    if isinstance(material, Mirror):
        arriving = incident_radiance(mirror_direction(normal, wo))
        return Estimate(brdf.albedo(material, viewer) * arriving, jnp.zeros_like(arriving))

    def draw(u: Float[Array, "3"]) -> Colour:
        wi = as_vec(brdf.sample(material, viewer, u))
        density = brdf.pdf(material, wi, viewer)
        arriving = incident_radiance(_world(frame, wi, wo))
        return arriving * brdf.shading(material, wi, viewer) * _inverse(density)

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
) -> Estimate:
    """Radiance from `point` under one extended light, each sample a direction drawn from the light
    and one from the material, joined by the balance heuristic (Veach and Guibas, "Optimally
    Combining Sampling Techniques for Monte Carlo Rendering", SIGGRAPH 1995): near the better of
    both, whether the lobe or the light is the smaller one.

    `point`: (3,) m. `normal`, `wo`: (3,) unit. `samples`: static, at least 2, else `ValueError`, as
    for a light at one place. (bands,) in W m^-2 sr^-1; the error is the standard error of the mean,
    0 for a mirror, which shows what lies along its one ray. For several lights, and inside a
    `render`, `outgoing_radiance` does the same by the rule `Balanced`.
    """
    _check_samples(samples)
    frame, viewer = _frame(normal, wo, tangent)
    if isinstance(material, Mirror):
        arriving = radiance_from(light, point, mirror_direction(normal, wo))
        return Estimate(brdf.albedo(material, viewer) * arriving, jnp.zeros_like(arriving))

    def draw(u: Float[Array, "5"]) -> Colour:
        return _balanced(material, light, point, frame, viewer, u[:2], u[2:])

    return _mean(jax.vmap(draw)(jax.random.uniform(key, (samples, 5), viewer.z.dtype)))


def _balanced(
    material: Material,
    light: Light,
    point: Vector,
    frame: Frame,
    viewer: Vec,
    of_light: Float[Array, "2"],
    of_material: Float[Array, "3"],
) -> Colour:
    """One direction from the light and one from the material, each weighed by the density of both
    samplers together: the mean over uniform numbers is the radiance, W m^-2 sr^-1."""

    def weighed(wi: Vec) -> Colour:
        world = _world(frame, wi, point)
        density = direction_pdf(light, point, world) + brdf.pdf(material, wi, viewer)
        arriving = radiance_from(light, point, world)
        return arriving * brdf.shading(material, wi, viewer) * _inverse(density)

    from_light = to_local(frame, direction_sample(light, point, of_light).direction)
    from_material = brdf.sample(material, viewer, of_material)
    return weighed(as_vec(from_light)) + weighed(as_vec(from_material))


def _frame(normal: Vector, wo: Vector, tangent: Vector | None) -> tuple[Frame, Vec]:
    frame = local_frame(normal, tangent=tangent)
    return frame, as_vec(to_local(frame, wo))


def _world(frame: Frame, wi: Vec, like: Vector) -> Vector:
    """In the world, and of the kind, array or `Vec`, of `like`."""
    world = to_world(frame, wi)
    return as_array(world) if isinstance(like, Array) else world


def _inverse(density: Scalar) -> Scalar:
    """1 / density, 0 where nothing can be drawn."""
    drawn = density > 0
    return jnp.where(drawn, 1 / jnp.where(drawn, density, 1), 0)


def _mean(values: Float[Array, "samples bands"]) -> Estimate:
    count = values.shape[0]
    return Estimate(values.mean(axis=0), safe_sqrt(values.var(axis=0, ddof=1) / count))


def _check_samples(samples: int) -> None:
    if samples < 2:
        raise ValueError(f"samples must be at least 2, got {samples}.")


def _dtype(*records: object) -> jnp.dtype:
    """The common floating dtype of all numbers."""
    leaves = jax.tree.leaves(records)
    return jnp.result_type(*(x for x in leaves if jnp.issubdtype(x.dtype, jnp.floating)))


def _check_bands(material: Material, spectra: Sequence[tuple[int, ...]]) -> tuple[int, ...]:
    """The shape that spectra share: one number of bands, or 1 for what is neutral."""
    try:
        return jnp.broadcast_shapes(*spectra)
    except ValueError:
        raise ValueError(
            "materials and lights must share one number of bands, got "
            f"{spectra[0][0]} from {type(material).__name__} and "
            f"{[shape[0] for shape in spectra[1:]]} from the lights."
        ) from None
