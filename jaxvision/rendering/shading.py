"""The rendering equation at one surface point for direct light, as a sum over light sources.

    L(wo) = k_a L_a + sum_i E_i S(wi_i, wo)

E_i is the irradiance from source i of a surface that faces it, S the material's shading, k_a its
ambient reflectance and L_a the ambient radiance. For a BRDF f_r, S is f_r max(cos(theta_i), 0).
Phong and the Gaussian lobe follow the textbook, without a cosine on the specular term (Szeliski,
Computer Vision, section 2.2.2). Radiance is in W m^-2 sr^-1, lengths are in m. All functions are
for one point; use `jax.vmap` for many.
"""

from collections.abc import Callable, Sequence
from functools import partial, reduce
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from .. import brdf
from ..core._arguments import takes_numbers
from ..core._loops.bands import MAX_NUMBERS, Bands, plus, split_bands
from ..core._loops.fusion import fuse
from ..core._types import Colour, Scalar, common_dtype
from ..core._vector import Direction, Vec, Vector, as_vec
from ..core.parallel_loops import scan
from ..geometry import Ray, Shapes, sorted_shapes
from ..geometry.hemisphere import to_local
from ..lights import (
    Balanced,
    Incident,
    Rule,
    can_be_seen,
    incident,
    incident_sample,
    light_nodes,
    lights_by_rule,
    nearest_seen,
    rule_of_each,
)
from ..lights.environment_quadrature import warn_of_skies
from ..lights.near_rectangles import warn_of_near_receiver
from ..scene import AmbientLight, Light, Material
from ._directions import balanced, local_viewer, where_clear, world_direction
from .band_count import band_count
from .shadows import DEFAULT_RULE, UNROLLED, Leaving, Place, Visible, clear, visibility

CURE_NEAR = "Give rule = Balanced(key, samples)."
CURE = "Give rule = Balanced(key, samples), or take the sun out of the map and add a SunDisc."


class Lighting(eqx.Module):
    """The light that arrives at one point of a surface, computed once for all materials that the
    surface may have."""

    lights: tuple[Light, ...]  # the sources
    rules: tuple[Rule, ...]  # sampling rule of each light, see `lights.rules`
    point: Vector  # (3,) m
    ambient: AmbientLight | None  # light from everywhere, or None
    place: Place | None  # the point and the shapes that may block light; None if no shape can
    # which samples of each light reach the point, from `shadows.visibility`; None if nothing can
    # block light
    visible: Visible | None
    # for each light, () whether any of the rays computed together traced it; None if all lights
    # were traced
    traced: tuple[Bool[Array, ""], ...] | None = None


@takes_numbers
def outgoing_radiance(
    material: Material,
    lights: Sequence[Light],
    point: Vector,
    normal: Direction,
    wo: Direction,
    *,
    ambient: AmbientLight | None = None,
    tangent: Vector | None = None,
    rule: Rule | Sequence[Rule] = DEFAULT_RULE,
    occluders: Shapes | None = None,
    leaving: Leaving | None = None,
) -> Colour:
    """Compute the radiance of a surface point toward a viewer, as the sum over all lights.

    A light without size casts hard shadows. For an extended light, one shadow ray is traced for
    each sample. Visibility has no gradient. A mirror shows the extended light in its mirror
    direction.

    Args:
        material: of the surface, of any registered BRDF family.
        lights: any number of sources with the same number of bands.
        point: (3,) m.
        normal: (3,) unit length, the shading normal.
        wo: (3,) unit length, toward the viewer. Below the surface (n.wo <= 0) the result is 0.
        ambient: uniform light from all directions; it affects only a material with an ambient
            reflectance.
        tangent: (3,) of any length, for an anisotropic material; None: any tangent.
        rule: sampling rule of extended lights, one for all or one for each light. The default,
            `Quadrature(8)`, suits diffuse surfaces under area lights; a glossy surface, or a sky
            with a sun, needs `Balanced` (`lights.rules` gives the errors).
        occluders: the shapes that block light, including the surface's own shape if it can shadow
            itself. For None or an empty sequence no shadow rays are traced.
        leaving: offset of shadow rays from the surface, needed for an interpolated `normal` or a
            surface of known size; None for an offset along `normal`.

    Returns:
        (bands,) W m^-2 sr^-1.

    Raises:
        ValueError: if spectra differ in their number of bands, or if `rule` has not one rule for
            each light.

    Example:
        A Lambert surface of albedo 0.5 under 3 W m^-2 at normal incidence: 0.5 / pi * 3.

        >>> up = jnp.array([0.0, 0.0, 1.0])
        >>> sun = jv.DirectionalLight([0, 0, 1], [3.0])
        >>> grey = jv.Lambert([0.5 / np.pi])
        >>> print(jv.outgoing_radiance(grey, [sun], jnp.zeros(3), up, up).round(4))
        [0.4775]
    """
    rules = rule_of_each(lights, rule)
    warn_of_skies(lights, rules, CURE)
    warn_of_near_receiver(lights, rules, point, normal, CURE_NEAR)
    leaving = Leaving(normal) if leaving is None else leaving
    light = lighting(lights, point, leaving, ambient=ambient, rule=rule, occluders=occluders)
    return reflected_radiance(material, light, normal, wo, tangent=tangent)


def lighting(
    lights: Sequence[Light],
    point: Vector,
    leaving: Leaving,
    *,
    ambient: AmbientLight | None = None,
    rule: Rule | Sequence[Rule] = DEFAULT_RULE,
    occluders: Shapes | None = None,
) -> Lighting:
    """Compute the light on one point of a surface, m, with its shadows. `reflected_radiance` uses
    the result for any number of materials, and traces only the shadow rays whose direction depends
    on the material."""
    rules = rule_of_each(lights, rule)
    place = visible = None
    if occluders is not None and (ready := sorted_shapes(occluders)).size is not None:
        place = Place(point, leaving, ready)
        visible = visibility(lights, point, ready, leaving, rule=rules)
    return Lighting(tuple(lights), rules, point, ambient, place, visible)


def reflected_radiance(
    material: Material,
    light: Lighting,
    normal: Direction,
    wo: Direction,
    *,
    tangent: Vector | None = None,
) -> Colour:
    """Compute the radiance that a surface point reflects toward `wo`, (bands,) in W m^-2 sr^-1; 0
    if `wo` lies below the surface."""
    return jnp.stack(fuse(reflected_bands(material, light, normal, wo, tangent=tangent)))


def largest_reflected(
    material: Material, light: Lighting, normal: Direction, wo: Direction
) -> Scalar:
    """Return the largest absolute value of `reflected_radiance` over the bands, () W m^-2 sr^-1."""
    return reduce(jnp.maximum, map(jnp.abs, reflected_bands(material, light, normal, wo)))


def reflected_bands(
    material: Material,
    light: Lighting,
    normal: Direction,
    wo: Direction,
    *,
    tangent: Vector | None = None,
) -> Bands:
    """Return `reflected_radiance` as a tuple with one scalar per band, W m^-2 sr^-1.

    A loop sums the samples of an extended light, and also lights without size if there are more
    than eight. Up to eight lights without size are summed in one pass over the rays.
    """
    frame, viewer = local_viewer(normal, wo, tangent)
    point, dtype = light.point, common_dtype(material, light, normal, wo)
    around = [] if light.ambient is None else [light.ambient.radiance]
    bands = band_count([material], light.lights, spectra=around)
    parameters, k_a = _split_into_scalars(material), getattr(material, "ambient", None)

    def reflect(arriving: Incident, wi: Direction, passes: Bool[Array, ""] | None) -> Bands:
        shading = brdf.shading(parameters(), wi, viewer)
        pairs = zip(
            split_bands(arriving.irradiance, bands), split_bands(shading, bands), strict=True
        )
        return tuple(where_clear(passes, e * s) for e, s in pairs)

    def sum_samples(rule: Rule, radiance: Bands, item: tuple[Light, Array | None, Any]) -> tuple:
        source, visible, traced = item
        paired = rule if can_be_seen(source) and isinstance(rule, Balanced) else None
        own = None
        if paired is not None:  # one direction from the material for each one from the light
            key = jax.random.fold_in(paired.key, 0)
            own = jax.random.uniform(key, (paired.samples, 3), dtype)

        @jax.checkpoint
        def add(total: Bands, node: tuple) -> tuple[Bands, None]:
            u, weight, passes, of_material = node
            if paired is not None:
                both = balanced(material, source, point, frame, viewer, u, of_material, light.place)
                return plus(total, split_bands(weight * both, bands)), None
            arriving = incident_sample(source, rule, point, u, weight)
            wi = fuse(to_local(frame, arriving.direction))
            return plus(total, fuse(reflect(arriving, wi, passes))), None

        nodes = *light_nodes(source, rule, dtype), visible, own

        def add_samples(radiance: Bands) -> Bands:
            return scan(add, radiance, nodes)[0]

        if traced is not None:
            return jax.lax.cond(traced, add_samples, lambda dark: dark, radiance), None
        return add_samples(radiance), None

    radiance = (jnp.zeros((), dtype),) * bands
    if light.ambient is not None and k_a is not None:
        radiance = plus(radiance, split_bands(k_a * light.ambient.radiance, bands))
    for members, group, rule in lights_by_rule(light.lights, light.rules):
        passes = [None if light.visible is None else light.visible[i] for i in members]
        if can_be_seen(light.lights[members[0]]) or len(members) > UNROLLED:
            # The flags of all members, or None for all
            known = [flags for flags in passes if flags is not None]
            flags = jnp.stack(known) if known else None
            traced = None
            if light.traced is not None:
                traced = jnp.stack([light.traced[i] for i in members])
            radiance, _ = scan(partial(sum_samples, rule), radiance, (group, flags, traced))
            continue
        arriving = [incident(light.lights[i], point) for i in members]
        for one, flags in zip(arriving, passes, strict=True):
            wi, flag = to_local(frame, one.direction), None if flags is None else flags[0]
            radiance = plus(radiance, reflect(one, wi, flag))
    if (mirror := brdf.seen_in_mirror(material, viewer)) is not None:
        toward, reflectance = mirror
        seen = _visible_radiance(light, as_vec(world_direction(frame, toward, wo)))
        radiance = plus(radiance, split_bands(reflectance * seen, bands))
    unseen = jnp.where(viewer.z <= 0, 0, viewer.z)  # or NaN
    return tuple(jnp.where(viewer.z > 0, band, unseen) for band in radiance)


def _visible_radiance(light: Lighting, direction: Vec) -> Colour:
    """Return the radiance of the extended lights that a ray in a unit direction sees, W m^-2
    sr^-1."""
    ahead = nearest_seen(light.lights, Ray(light.point, direction))
    passes = None if light.place is None else clear(light.place, direction, ahead.distance)
    return where_clear(passes, ahead.radiance)


def _split_into_scalars(material: Material) -> Callable[[], Material]:
    """Return a function that assembles the material from scalars at each use. In the gradient, the
    cotangents of scalars are summed over the lights directly, whereas the cotangents of arrays
    would be stored for all lights and then summed."""
    leaves, tree = jax.tree.flatten(material)
    few = [i for i, leaf in enumerate(leaves) if leaf.ndim <= 1 and leaf.size <= MAX_NUMBERS]
    numbers = [split_bands(leaves[i].reshape(-1), leaves[i].size) for i in few]

    def assemble() -> Material:
        again = list(leaves)
        for i, own in zip(few, numbers, strict=True):
            again[i] = jnp.stack(own).reshape(leaves[i].shape)
        return jax.tree.unflatten(tree, again)

    return assemble
