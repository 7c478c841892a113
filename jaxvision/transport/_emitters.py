"""Emitters (lights and emissive surfaces), and the weights of the two ways in which a path finds
them: next-event estimation and BRDF sampling.

Next-event estimation picks one emitter uniformly, and a direction toward it. A direction drawn by
BRDF sampling may hit an emitter by chance. Both ways estimate the same integral. Lights do not
block other light: shadow rays and paths pass through them. Only a ray from the camera, directly or
via mirrors and glass, stops at the nearest light. An emissive surface blocks all rays. Radiance is
in W m^-2 sr^-1, lengths are in m, densities in sr^-1. All functions are for one point or ray; use
`jax.vmap` for many.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..core._loops.bands import Bands, plus, split_bands, times
from ..core._loops.fusion import materialise
from ..core._loops.groups import Tree, call_member, fold, group_by_structure, row
from ..core._numerics import divide, dot, or_one, reciprocal, safe_sqrt, smallest_divisor
from ..core._types import Colour, Scalar
from ..core._vector import Vec, as_vec
from ..core.parallel_loops import scan
from ..geometry import Ray, has_area, largest_size, offset_length, point_on, surface_area
from ..lights import (
    Incident,
    Quadrature,
    can_be_seen,
    direction_pdf,
    direction_sample,
    incident,
    incident_sample,
    light_nodes,
    nearest_seen,
    radiance_along,
    split_by_rule,
    square_nodes,
)
from ..scene import Light, Scene, Shape

Strategy = Literal["lights", "surfaces", "balance", "power"]
LARGEST = 256  # each ray indexes stacked arrays of at most this size


class Emissive(eqx.Module):
    """A surface that emits light. `two_sided` is () and tells whether the back emits too. `size` is
    () in m, as in `Hit.size`."""

    shape: Shape
    emission: Colour
    two_sided: Bool[Array, ""]
    size: Scalar


class Toward(eqx.Module):
    """A sampled direction toward an emitter, with its light. `distance` is () in m, inf for an
    emitter at infinity. `clear` is the part of the distance, () in m, that must be unoccluded; it
    ends slightly before an emissive surface, by the rounding error of the surface's position.
    `density` is the sampling density of the direction, () sr^-1, or inf for a light without size.
    `irradiance` is the radiance divided by `density`, (bands,) W m^-2."""

    direction: Vec
    distance: Scalar
    clear: Scalar
    irradiance: Colour
    density: Scalar


class Emitters(eqx.Module):
    """The emitters of a scene, prepared once for all paths. `groups` contains the emitters that can
    be sampled, stacked by structure; `members` (static) contains the indices of the emitters of
    each group. `lights` are the lights that a ray can intersect. `emission`, (surfaces, bands) W
    m^-2 sr^-1, is the radiance that each surface emits, or None if no surface emits. `area`,
    (surfaces,) m^2, is inf for an infinite surface. `two_sided`, (surfaces,), tells whether both
    sides of a surface emit. `count` (static) is the number of emitters that can be sampled.
    `endless` (static) tells whether an infinite surface emits."""

    groups: tuple[Light | Emissive, ...]
    lights: tuple[Light, ...]
    emission: Float[Array, "surfaces bands"] | None
    area: Float[Array, " surfaces"] | None
    two_sided: Bool[Array, " surfaces"]
    members: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    count: int = eqx.field(static=True)
    endless: bool = eqx.field(static=True)


def emitters_of(scene: Scene) -> Emitters:
    """Return the emitters of a scene: first the lights, then the emissive surfaces of finite area,
    m^2."""
    surfaces = scene.surfaces
    two_sided = jnp.asarray([surface.two_sided for surface in surfaces])
    shining = {i: s.emission for i, s in enumerate(surfaces) if s.emission is not None}
    drawn: list[Light | Emissive] = list(scene.lights)
    drawn += [
        Emissive(surfaces[i].shape, emission, two_sided[i], largest_size([surfaces[i].shape]))
        for i, emission in shining.items()
        if has_area(surfaces[i].shape)
    ]
    emission = areas = None
    if shining:
        dark = jnp.zeros_like(next(iter(shining.values())))
        emission = jnp.stack([shining.get(i, dark) for i in range(len(surfaces))])
        areas = jnp.stack(
            [
                surface_area(s.shape) if i in shining else jnp.ones_like(dark[0])
                for i, s in enumerate(surfaces)
            ]
        )
    seen_lights = tuple(filter(can_be_seen, scene.lights))
    groups = group_by_structure(drawn, largest=LARGEST)
    return Emitters(
        tuple(group for _, group in groups),
        seen_lights,
        emission,
        areas,
        two_sided,
        tuple(members for members, _ in groups),
        len(drawn),
        not all(has_area(surfaces[i].shape) for i in shining),
    )


def toward_emitter(emitters: Emitters, point: Vec, u: Float[Array, "3"]) -> Toward:
    """Draw one emitter with the number u_2, and a direction from `point`, m, toward the emitter
    with u_0 and u_1, all uniform in [0, 1). The irradiance of the result, W m^-2, is an unbiased
    estimate of the sum over all emitters."""

    def toward(emitter: Light | Emissive) -> Toward:
        if isinstance(emitter, Emissive):
            return _toward_surface(emitter, point, u[:2])
        return _toward_light(emitter, point, u[:2])

    drawn, count = apply_to_drawn(emitters, u[2], toward), emitters.count
    irradiance, density = drawn.irradiance * count, drawn.density / count
    return Toward(drawn.direction, drawn.distance, drawn.clear, irradiance, density)


def apply_to_drawn(emitters: Emitters, u: Scalar, function: Callable[[Any], Tree]) -> Tree:
    """Draw one emitter with the number `u`, uniform in [0, 1), and return `function` of this
    emitter."""
    count = emitters.count
    index = jnp.minimum((u * count).astype(jnp.int32), count - 1)
    found = call_member(emitters.members, emitters.groups, index, function)
    if found is None:
        raise ValueError("light can only be drawn in a scene with something that shines.")
    return found


def _toward_light(light: Light, point: Vec, u: Float[Array, "2"]) -> Toward:
    everywhere = jnp.full_like(point.x, jnp.inf)
    if not can_be_seen(light):
        return _toward(incident(light, point), everywhere)
    arriving = direction_sample(light, point, u)
    density = arriving.density
    if density is None:
        density = direction_pdf(light, point, arriving.direction)
    return _toward(arriving, density)


def _toward(arriving: Incident, density: Scalar) -> Toward:
    far = jnp.full_like(density, jnp.inf)
    distance = far if arriving.distance is None else arriving.distance
    return Toward(as_vec(arriving.direction), distance, distance, arriving.irradiance, density)


def _toward_surface(emitter: Emissive, point: Vec, u: Float[Array, "2"]) -> Toward:
    """Return a direction toward a random point of an emissive surface. The point is uniform over
    the area A. The density of the direction is d^2 / (A cos(theta)), where d is the distance and
    theta the angle to the surface's normal."""
    place, whole = point_on(emitter.shape, u), surface_area(emitter.shape)
    toward = place.point - point
    distance = safe_sqrt(dot(toward, toward))
    nearness = divide(1, distance, ~(distance <= smallest_divisor(distance.dtype)))
    direction = toward * nearness
    cosine = -dot(place.normal, direction)
    cosine = jnp.where(emitter.two_sided, jnp.abs(cosine), jnp.maximum(cosine, 0))
    solid_angle = whole * cosine * nearness * nearness
    # The shadow ray ends as high above the emitter as a ray that leaves it would start. Along a
    # slanted ray this height is a longer distance.
    own = offset_length(emitter.size + distance) * reciprocal(cosine)
    return Toward(
        direction,
        distance,
        jnp.maximum(distance - own, 0),
        emitter.emission * solid_angle,
        reciprocal(solid_angle),
    )


def toward_each(
    emitters: Emitters,
    point: Vec,
    *,
    rules: Sequence[Quadrature],
    shine: Callable[[Toward], Colour],
    bands: int,
) -> Colour:
    """Return the sum of `shine` over the samples of all emitters, as seen from `point`, m. `shine`
    computes the reflected radiance, (bands,) W m^-2 sr^-1, for one direction toward an emitter.
    Each emitter is sampled by its own rule, and the irradiances of the samples include the weights
    of the rule."""
    dtype = point.x.dtype

    def add_emitter(
        rule: Quadrature, total: Colour, emitter: Light | Emissive
    ) -> tuple[Colour, None]:
        if isinstance(emitter, Emissive):
            nodes, weights = (jnp.asarray(x, dtype) for x in square_nodes(rule.order))
        else:
            nodes, weights = light_nodes(emitter, rule, dtype)

        @jax.checkpoint
        def add_node(total: Colour, node: tuple[Array, Array]) -> tuple[Colour, None]:
            u, weight = node
            if isinstance(emitter, Emissive):
                toward = _toward_surface(emitter, point, u)
                toward = eqx.tree_at(lambda t: t.irradiance, toward, toward.irradiance * weight)
            else:
                everywhere = jnp.full_like(point.x, jnp.inf)
                toward = _toward(incident_sample(emitter, rule, point, u, weight), everywhere)
            return total + shine(toward), None

        return scan(add_node, total, (nodes, weights))

    total = jnp.zeros(bands, dtype)
    for members, group in zip(emitters.members, emitters.groups, strict=True):
        for _, part, rule in split_by_rule(members, group, rules):
            total, _ = scan(partial(add_emitter, rule), total, part)
    return total


def shining_ahead(
    emitters: Emitters,
    ray: Ray,
    surface: Int[Array, ""],
    distance: Scalar,
    cosine: Scalar,
    density: Scalar,
    absorption: Colour | None,
    *,
    strategy: Strategy,
    bands: int,
) -> tuple[Bands, Bool[Array, ""]]:
    """Return the emitted radiance of the emitters that a ray hits, W m^-2 sr^-1, and whether the
    ray ends at a light.

    `surface` is the index of the surface that the ray hits (-1 for none), `distance` its distance
    in m, and `cosine` the cosine of the angle between its outward normal and the reversed ray.
    `density` is the sampling density of the ray's direction in sr^-1, or inf for a ray from the
    camera. `absorption` is the absorption of the surrounding body, (bands,) m^-1, or None. Emitters
    that next-event estimation can sample are weighted according to `strategy`.
    """
    looks = jnp.isinf(density)
    left = split_bands(transmitted(absorption, distance), bands)
    found, ends = (jnp.zeros_like(distance),) * bands, jnp.zeros_like(looks)
    if emitters.emission is not None:
        shines, on_purpose = materialise(_shining_surface, emitters, surface, distance, cosine)
        counts = jnp.where(shines, chance_weight(strategy, density, on_purpose), 0)
        met = jnp.maximum(surface, 0)
        emission = (row(emitters.emission[:, k], met) for k in range(emitters.emission.shape[1]))
        found = tuple(counts * x for x in times(split_bands(tuple(emission), bands), left))
    if not emitters.lights:
        return found, ends

    def visible(away: Scalar) -> Bool[Array, ""]:
        return jnp.where(jnp.isinf(away), surface < 0, (away < distance) | (surface < 0))

    nearest = nearest_seen(emitters.lights, ray)
    shown = nearest.radiance * transmitted(absorption, nearest.distance)
    shown = jnp.where(visible(nearest.distance), shown, 0)
    ends = looks & visible(nearest.distance) & jnp.isfinite(nearest.distance)
    passed = jnp.zeros_like(shown)

    def passing(so_far: Colour, light: Light) -> Colour:
        ahead = radiance_along(light, ray)
        drawn = direction_pdf(light, ray.origin, ray.direction) / emitters.count
        weight = chance_weight(strategy, density, drawn)
        arriving = ahead.radiance * transmitted(absorption, ahead.distance)
        return so_far + jnp.where(visible(ahead.distance), weight, 0) * arriving

    if strategy != "lights":
        passed = fold(passing, passed, emitters.lights)
    of_lights = split_bands(jnp.where(looks, shown, passed), bands)
    return plus(tuple(jnp.where(ends, 0, x) for x in found), of_lights), ends


def _shining_surface(
    emitters: Emitters, surface: Int[Array, ""], distance: Scalar, cosine: Scalar
) -> tuple[Bool[Array, ""], Scalar]:
    """Return whether a ray hits an emissive side of a surface, and the density, sr^-1, with which
    light sampling would have drawn the direction of the ray."""
    assert emitters.area is not None  # not None if any surface emits
    met = jnp.maximum(surface, 0)
    facing = jnp.where(emitters.two_sided[met], jnp.abs(cosine), cosine)
    shines = (surface >= 0) & (facing > 0)
    nearness = or_one(facing * emitters.area[met], shines)
    density = jnp.where(shines, distance * distance / nearness, 0)
    return shines, density / max(emitters.count, 1)  # 0 if no surface can be sampled


def transmitted(absorption: Colour | None, distance: Scalar) -> Colour:
    """Return the transmittance of a body over a distance in m, no unit. `absorption` is (bands,)
    m^-1, or None for a clear body. For an infinite distance the transmittance is 1."""
    if absorption is None:
        return jnp.ones_like(distance)[None]
    return jnp.exp(-absorption * jnp.where(jnp.isinf(distance), 0, distance))


def chance_weight(strategy: Strategy, by_chance: Scalar, on_purpose: Scalar) -> Scalar:
    """Return the weight, no unit, of a direction drawn by BRDF sampling. `by_chance` and
    `on_purpose` are the densities of the direction, sr^-1, under BRDF and light sampling. This
    weight and `purpose_weight` sum to 1."""
    match strategy:
        case "lights":  # includes only emitters that light sampling cannot draw
            return jnp.where(jnp.isinf(by_chance) | (on_purpose <= 0), 1, 0).astype(by_chance.dtype)
        case "surfaces":
            return jnp.ones_like(by_chance)
    return _heuristic(strategy, by_chance, on_purpose)


def purpose_weight(strategy: Strategy, on_purpose: Scalar, by_chance: Scalar | None) -> Scalar:
    """Return the weight, no unit, of a direction drawn by light sampling. `on_purpose` and
    `by_chance` are the densities of the direction, sr^-1, under light and BRDF sampling. For a
    light without size `on_purpose` is inf, because only light sampling finds it."""
    match strategy:
        case "lights":
            return jnp.ones_like(on_purpose)
        case "surfaces":
            return jnp.where(jnp.isinf(on_purpose), 1, 0).astype(on_purpose.dtype)
    assert by_chance is not None  # `vertex` computed this density
    return _heuristic(strategy, on_purpose, by_chance)


def _heuristic(strategy: Strategy, own: Scalar, other: Scalar) -> Scalar:
    """Return the weight of multiple importance sampling for densities p = `own` and q = `other`: p
    / (p + q) or p^2 / (p^2 + q^2) (Veach and Guibas, SIGGRAPH 1995). Both forms are computed as 1 /
    (1 + (q / p)^n), which does not overflow. Gradients treat the weight as a constant."""
    own, other = jax.lax.stop_gradient((own, other))
    ratio = divide(other, own, otherwise=jnp.inf)
    return 1 / (1 + (ratio if strategy == "balance" else ratio * ratio))
