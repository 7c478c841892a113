"""The rendering equation at one surface point, as a sum over sources.

    L(wo) = k_a L_a + sum_i E_i S(wi_i, wo)

with E_i the irradiance a facing surface would receive from source i and S the material's shading:
f_r cos+ of a BRDF, and what the textbook says of Phong and the Gaussian lobe, which put no cosine
on the specular term (Szeliski, Computer Vision, section 2.2.2). Radiance in W m^-2 sr^-1, lengths
in m. Direct light only; it is blocked by the shapes named as occluders, and where none are named no
shadow is traced. For ONE point: the caller vmaps.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from . import brdf
from ._bands import FEW, Bands, apart, plus
from ._directions import balanced, in_frame, in_world, where_clear
from ._groups import group_by_structure
from ._staging import together
from ._types import Colour, Scalar, common_dtype
from ._vector import Vec, Vector, as_vec
from .geometry import Ray, Shapes, sorted_shapes
from .hemisphere import to_local
from .lights import (
    Balanced,
    Incident,
    Rule,
    can_be_seen,
    incident,
    incident_sample,
    incident_samples,
    light_nodes,
    nearest_seen,
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

_UNROLLED = 8  # lights at one place, each of its own code; of more, a loop over one piece of code


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
    frame, viewer = in_frame(normal, wo, tangent)
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
        return tuple(where_clear(passes, e * s) for e, s in pairs)

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
            both = balanced(material, light, point, frame, viewer, of_light, of_material, place)
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
    if (mirror := brdf.seen_in_mirror(material, viewer)) is not None:
        toward, reflectance = mirror
        direction = as_vec(in_world(frame, toward, wo))
        ahead = nearest_seen(lights, Ray(point, direction))
        passes = None if place is None else clear(place, direction, ahead.distance)
        image = where_clear(passes, reflectance * ahead.radiance)
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
    frame, viewer = in_frame(normal, wo, None)
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


def _in_numbers(material: Material) -> Callable[[], Material]:
    """The material, put together anew for each that reads it, of numbers whose cotangents all
    lights share: those of arrays would be put side by side for each light, and added then."""
    leaves, tree = jax.tree.flatten(material)
    few = [i for i, leaf in enumerate(leaves) if leaf.ndim <= 1 and leaf.size <= FEW]
    numbers = [apart(leaves[i].reshape(-1), leaves[i].size) for i in few]

    def assembled() -> Material:
        again = list(leaves)
        for i, own in zip(few, numbers, strict=True):
            again[i] = jnp.stack(own).reshape(leaves[i].shape)
        return jax.tree.unflatten(tree, again)

    return assembled


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
