"""The rendering equation at one surface point: a sum over sources, or an integral over directions.

    L(wo) = k_a L_a + sum_i E_i S(wi_i, wo)                      discrete sources
    L(wo) = integral over the hemisphere of L_i(wi) S(wi, wo) dwi

with E_i the irradiance a facing surface would receive from source i and S the material's shading:
f_r cos+ of a BRDF, and what the textbook says of Phong and the Gaussian lobe, which put no cosine
on the specular term (Szeliski, Computer Vision, section 2.2.2). Radiance in W m^-2 sr^-1, lengths
in m. Direct light only; it is blocked by the shapes named as occluders, and where none are named no
shadow is traced. For ONE point: the caller vmaps.
"""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from . import brdf
from ._bands import Bands, apart, plus
from ._numerics import reciprocal, safe_sqrt
from ._staging import derived_together, together
from ._types import Colour, Key, Scalar, common_dtype, group_by_structure
from ._vector import Vec, Vector, as_array, as_vec
from .brdf.mirror import Mirror
from .geometry import Ray, Shapes, mirror_direction, sorted_shapes
from .hemisphere import Frame, local_frame, product_nodes, to_local, to_world
from .lights import (
    Balanced,
    Incident,
    Rule,
    can_be_seen,
    direction_pdf,
    direction_sample,
    incident,
    incident_sample,
    incident_samples,
    light_nodes,
    nearest_seen,
    seen,
)
from .scene import AmbientLight, Light, Material
from .shadows import (
    DEFAULT_RULE,
    Leaving,
    Place,
    Visible,
    clear,
    comes_through,
    light_comes_through,
)

Angles = tuple[Any | None, ...]

_FEW = 8  # numbers in an array of a material that are read one by one
_UNROLLED = 8  # lights at one place, each of its own code; of more, a loop over one piece of code


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
    occluders: Shapes | None = None,
    leaving: Leaving | None = None,
    visible: Visible | None = None,
    angles: Angles | None = None,
) -> Colour:
    """Radiance from `point` toward `wo`, the sum over any lights: (bands,) in W m^-2 sr^-1.

    `point`: (3,) m. `normal`, `wo`: (3,) unit. `tangent`: (3,), for an anisotropic material.
    `rule`: how finely extended lights are taken apart; the default, `Quadrature(8)`, is for diffuse
    surfaces under area lights: a glossy one, or a sky with a sun, wants `Balanced`, and `rules` has
    the figures. `occluders`: what blocks light, the surface's own shape among them if it can, or
    None: nothing. `leaving`: how shadow rays leave a surface whose `normal` is an interpolated one,
    or whose size is known. Shadows are hard for a light at one place; those of an extended one are
    as soft as the rule has samples, each with a shadow ray of its own. Visibility has no gradient.
    `visible`: what `visibility` found of these lights by this rule, instead of occluders; not for
    `Balanced`, whose rays follow the material, else `ValueError`. `angles`: what `light_angles`
    found for materials of this kind, of what is visible: no direction is then computed, and
    nothing asked about what comes through.
    A surface seen from behind (n.wo <= 0) is black; a mirror shows the extended light it reflects.
    The ambient term is traced only if the material reflects it and there is such a light.
    `ValueError` if spectra differ in their number of bands. The samples of one light, and more than
    eight lights of one kind, are a loop over one piece of code; up to eight lights at one place are
    summed in one pass over the rays.
    """
    frame, viewer = _frame(normal, wo, tangent)
    dtype = common_dtype(material, lights, point, normal, wo)
    own = Leaving(normal) if leaving is None else leaving
    place = None if occluders is None else Place(point, own, sorted_shapes(occluders))
    if visible is not None and isinstance(rule, Balanced):
        raise ValueError("visible is known for Quadrature and MonteCarlo, got the rule Balanced.")

    def spectrum(lights: Light) -> Colour:
        light = jax.tree.map(lambda leaf: leaf[0], lights)
        return incident_samples(light, point, rule).irradiance[0]

    grouped = group_by_structure(lights)
    groups = [group for _, group in grouped]
    spectra = [jax.eval_shape(brdf.shading, material, viewer, viewer).shape]
    spectra += [jax.eval_shape(spectrum, group).shape for group in groups]
    k_a = getattr(material, "ambient", None)
    if ambient is not None:
        spectra.append(ambient.radiance.shape)
    (bands,) = _check_bands(material, spectra)
    parameters = _in_numbers(material)

    def shaded(
        light: Light, u: Float[Array, "2"], weight: Scalar, passes: Bool[Array, ""] | None
    ) -> Bands:
        arriving = incident_sample(light, rule, point, u, weight)
        wi = together(to_local(frame, arriving.direction))
        if place is not None:
            passes = comes_through(place, arriving)
        return together(reflected(arriving, brdf.shading(parameters(), wi, viewer), passes))

    def reflected(arriving: Incident, shading: Colour, passes: Bool[Array, ""] | None) -> Bands:
        pairs = zip(apart(arriving.irradiance, bands), apart(shading, bands), strict=True)
        return tuple(_where(passes, e * s) for e, s in pairs)

    def from_places(
        lights: Sequence[Light],
        passes: Sequence[Bool[Array, " 1"] | None],
        angles: Sequence[Any | None],
    ) -> list[Bands]:
        (node,), (weight,) = light_nodes(lights[0], rule, dtype)
        arriving = [incident_sample(light, rule, point, node, weight) for light in lights]
        at_angles = brdf.family(material).at_angles
        shadings = [
            brdf.shading(parameters(), to_local(frame, arrived.direction), viewer)
            if own is None or at_angles is None
            else at_angles(parameters(), own)
            for arrived, own in zip(arriving, angles, strict=True)
        ]
        if place is not None:
            through = [light_comes_through(place, light) for light in lights]
        else:
            through = [
                None if flags is None or own is not None else flags[0]
                for flags, own in zip(passes, angles, strict=True)
            ]
        return [reflected(*of_one) for of_one in zip(arriving, shadings, through, strict=True)]

    def from_light(
        radiance: Bands, item: tuple[Light, Bool[Array, " nodes"] | None]
    ) -> tuple[Bands, None]:
        light, passes = item
        nodes, weights = light_nodes(light, rule, dtype)
        if not can_be_seen(light):
            only = None if passes is None else passes[0]
            return plus(radiance, shaded(light, nodes[0], weights[0], only)), None

        @jax.checkpoint
        def from_node(
            total: Bands, node: tuple[Array, Array, Bool[Array, ""] | None]
        ) -> tuple[Bands, None]:
            return plus(total, shaded(light, *node)), None

        @jax.checkpoint
        def from_both(total: Bands, node: tuple[Array, Array, Array]) -> tuple[Bands, None]:
            of_light, of_material, weight = node
            both = _balanced(material, light, point, frame, viewer, of_light, of_material, place)
            both = weight * both
            return plus(total, apart(both, bands)), None

        if not isinstance(rule, Balanced):
            return jax.lax.scan(from_node, radiance, (nodes, weights, passes))
        own = jax.random.uniform(jax.random.fold_in(rule.key, 0), (rule.samples, 3), dtype)
        return jax.lax.scan(from_both, radiance, (nodes, own, weights))

    radiance = seen_anyhow = (jnp.zeros((), dtype),) * bands
    if ambient is not None and k_a is not None:
        radiance = plus(radiance, apart(k_a * ambient.radiance, bands))
    for members, group in grouped:
        passes = [None if visible is None else visible[member] for member in members]
        if not _in_one_pass(lights, members):
            flags = None if visible is None else jnp.stack([visible[i] for i in members])
            radiance, _ = jax.lax.scan(from_light, radiance, (group, flags))
        else:
            own = [None if angles is None else angles[member] for member in members]
            parts = from_places([lights[member] for member in members], passes, own)
            for part, of_angles in zip(parts, own, strict=True):
                if of_angles is None:
                    radiance = plus(radiance, part)
                else:
                    seen_anyhow = plus(seen_anyhow, part)
    if isinstance(material, Mirror):  # a delta function: no sample meets it, but its ray is known
        direction = mirror_direction(as_vec(normal), as_vec(wo))
        ahead = nearest_seen(lights, Ray(point, direction))
        passes = None if place is None else clear(place, direction, ahead.distance)
        image = _where(passes, brdf.albedo(material, viewer) * ahead.radiance)
        radiance = plus(radiance, apart(image, bands))
    # angles say themselves where the surface is seen from behind
    radiance = tuple(jnp.where(viewer.z > 0, band, 0) for band in radiance)
    return jnp.stack(together(plus(radiance, seen_anyhow)))


def light_angles(
    material: Material,
    lights: Sequence[Light],
    point: Vector,
    normal: Vector,
    wo: Vector,
    *,
    visible: Visible | None = None,
) -> Angles | None:
    """What the shading of a material takes of the directions of light and viewer, the same for all
    materials of its kind: for each light at one place what the family's `angles` gives, no unit,
    None for others, and for all where the family parts nothing. Arguments as in
    `outgoing_radiance`, for fits that shade one point with many materials. A light that does not
    come through counts as one below the surface."""
    of_family = brdf.family(material).angles
    if of_family is None:
        return None
    frame, viewer = _frame(normal, wo, None)
    found: list[Any | None] = [None] * len(lights)
    for members, _ in group_by_structure(lights):
        for member in members if _in_one_pass(lights, members) else ():
            wi = as_vec(to_local(frame, incident(lights[member], point).direction))
            if visible is not None:
                wi = Vec(wi.x, wi.y, jnp.where(visible[member][0], wi.z, -1))
            found[member] = of_family(wi, viewer)
    return tuple(found)


def _in_one_pass(lights: Sequence[Light], members: Sequence[int]) -> bool:
    """Whether these lights, all of one kind, are summed in one pass over the rays."""
    return not can_be_seen(lights[members[0]]) and len(members) <= _UNROLLED


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
    _check_samples(samples)
    frame, viewer = _frame(normal, wo, tangent)
    place = None if occluders is None else Place(point, Leaving(normal), sorted_shapes(occluders))
    if isinstance(material, Mirror):
        arriving = _arriving(light, point, mirror_direction(normal, wo), place)
        return Estimate(brdf.albedo(material, viewer) * arriving, jnp.zeros_like(arriving))

    def draw(u: Float[Array, "5"]) -> Colour:
        return _balanced(material, light, point, frame, viewer, u[:2], u[2:], place)

    return _mean(jax.vmap(draw)(jax.random.uniform(key, (samples, 5), viewer.z.dtype)))


def _balanced(
    material: Material,
    light: Light,
    point: Vector,
    frame: Frame,
    viewer: Vec,
    of_light: Float[Array, "2"],
    of_material: Float[Array, "3"],
    place: Place | None,
) -> Colour:
    """One direction from the light and one from the material, each weighed by the density of both
    samplers together: the mean over uniform numbers is the radiance, W m^-2 sr^-1."""

    def weighed(wi: Vec) -> Colour:
        world = _world(frame, wi, point)
        density = direction_pdf(light, point, world) + brdf.pdf(material, wi, viewer)
        arriving = _arriving(light, point, world, place)
        return arriving * brdf.shading(material, wi, viewer) * reciprocal(density)

    from_light = to_local(frame, direction_sample(light, point, of_light).direction)
    from_material = brdf.sample(material, viewer, of_material)
    return weighed(as_vec(from_light)) + weighed(as_vec(from_material))


def _arriving(light: Light, point: Vector, wi: Vector, place: Place | None) -> Colour:
    """Radiance, W m^-2 sr^-1, that reaches the point from `wi`, 0 where something is between."""
    ahead = seen(light, Ray(point, wi))
    passes = None if place is None else clear(place, wi, ahead.distance)
    return _where(passes, ahead.radiance)


def _where(condition: Bool[Array, ""] | None, value: Array) -> Array:
    """The value where the condition holds, else 0; without a condition the value."""
    return value if condition is None else jnp.where(condition, value, 0)


def _in_numbers(material: Material) -> Callable[[], Material]:
    """The material, put together anew for each that reads it, of numbers whose cotangents all
    lights share: those of arrays would be put side by side for each light, and added then."""
    leaves, tree = jax.tree.flatten(material)
    few = [i for i, leaf in enumerate(leaves) if leaf.ndim <= 1 and leaf.size <= _FEW]
    numbers = [apart(leaves[i].reshape(-1), leaves[i].size) for i in few]
    numbers = derived_together(numbers)

    def assembled() -> Material:
        again = list(leaves)
        for i, own in zip(few, numbers, strict=True):
            again[i] = jnp.stack(own).reshape(leaves[i].shape)
        return jax.tree.unflatten(tree, again)

    return assembled


def _frame(normal: Vector, wo: Vector, tangent: Vector | None) -> tuple[Frame, Vec]:
    frame = local_frame(normal, tangent=tangent)
    return frame, as_vec(to_local(frame, wo))


def _world(frame: Frame, wi: Vec, like: Vector) -> Vector:
    """In the world, and of the kind, array or `Vec`, of `like`."""
    world = to_world(frame, wi)
    return as_array(world) if isinstance(like, Array) else world


def _mean(values: Float[Array, "samples bands"]) -> Estimate:
    count = values.shape[0]
    return Estimate(values.mean(axis=0), safe_sqrt(values.var(axis=0, ddof=1) / count))


def _check_samples(samples: int) -> None:
    if samples < 2:
        raise ValueError(f"samples must be at least 2, got {samples}.")


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
