"""Deterministic ray tracing of directly lit surfaces, also as seen in mirrors and through glass.

Source: Whitted, "An Improved Illumination Model for Shaded Display", CACM 23(6) (1980). A ray
splits in two at glass, so the tree of rays has up to 2^n rays after n surfaces, most of which carry
almost no light. Pending rays are therefore stored in a pool, and the ray with the largest weight is
traced next. In this way the `rays` rays of largest weight are traced, at any depth. Rays that
remain in the pool add no radiance. Caustics and light between diffuse surfaces are missing; `paths`
and `light_paths` include them. Radiance is in W m^-2 sr^-1, lengths are in m.

For each traced ray, the cost is one intersection, and one shadow ray for each node of each light
(order^2 nodes for a rectangle, twice that number for an environment). Most pixels trace one ray;
pixels that see a mirror or glass trace up to `rays`. Blocks in which no tree has pending rays are
skipped.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..brdf import is_delta
from ..core._loops.fusion import TILE, entries_per_step, one_program
from ..core._numerics import dot
from ..core._types import Colour, Image, check_count, check_given
from ..core._vector import Vec, as_array
from ..core._warnings import one_call
from ..core.parallel_loops import map_, scan
from ..geometry import Ray
from ..geometry.checks import warn_of_shapes
from ..lights import Quadrature, rules_of
from ..lights.environment_quadrature import warn_of_skies
from ..lights.near_rectangles import warn_of_near_surfaces
from ..rendering import Along, PixelSamples, photograph
from ..rendering.pixel_loop import check_lens, map_blocks
from ..scene import Scene, View
from ._emitters import Toward, shining_ahead, toward_each, transmitted
from ._vertices import (
    Met,
    World,
    absorption_after,
    absorption_around,
    branches,
    hidden,
    leave,
    meet,
    shaded_toward,
    world_of,
)

DEFAULT_RULE = Quadrature(4)
Rules = tuple[Quadrature, ...]
_BLOCK = 512  # rays that are traced, or skipped, together


class _Tree(eqx.Module):
    """The tree of rays of one pixel: the pool of pending rays, with their origins, directions,
    weights and the absorption of their surroundings (None if nothing absorbs), and the radiance
    found so far."""

    origin: Float[Array, "slots 3"]
    direction: Float[Array, "slots 3"]
    absorption: Float[Array, "slots bands"] | None
    weight: Float[Array, "slots bands"]
    radiance: Colour


@one_program
def ray_tree_radiance(
    scene: Scene, ray: Ray, *, rays: int = 16, rule: Quadrature = DEFAULT_RULE
) -> Colour:
    """Compute the radiance that arrives along one ray, against its direction.

    Args:
        scene: any scene; `Scene.ambient` is not added.
        ray: origin (3,) m, direction (3,) unit length.
        rays: static, number of rays of the tree, >= 1. In a scene without glass the tree has no
            branches, and this is the number of mirrors in a row plus one.
        rule: sampling rule for the emitters that light a surface; a light may have its own in
            `Scene.rules`.

    Returns:
        (bands,) W m^-2 sr^-1.

    Raises:
        ValueError: for fewer than one ray, or a random rule in `Scene.rules`.

    Example:
        >>> lamp = jv.Surface(jv.Disc([0, 0, 9], [0, 0, -1], 1), jv.Lambert([0.0]), [2.0])
        >>> ray = jv.Ray([0, 0, 0], [0, 0, 1])
        >>> print(jv.transport.ray_tree_radiance(jv.Scene(lamp, []), ray, rays=1))
        [2.]
    """
    world = world_of(scene)
    rays, rules = _count_rays(world, rays), _rules(scene, world, rule)

    @jax.checkpoint
    def follow(tree: _Tree, k: Array) -> tuple[_Tree, None]:
        return _follow(world, rules, k, tree), None

    tree, _ = scan(follow, _start_tree(world, ray, rays), jnp.arange(rays))
    return tree.radiance


@one_program
def ray_tree_radiances(
    scene: Scene, along: Ray, *, rays: int = 16, rule: Quadrature = DEFAULT_RULE
) -> Float[Array, "n bands"]:
    """Return `ray_tree_radiance` for many rays. A call for all rays is faster than one call for
    each ray if few rays hit mirrors or glass.

    Args:
        scene, rays, rule: as in `ray_tree_radiance`.
        along: origins and directions, components (n,).

    Returns:
        (n, bands) W m^-2 sr^-1.
    """
    world = world_of(scene)
    rays, rules = _count_rays(world, rays), _rules(scene, world, rule)

    def tile(along: Ray) -> Float[Array, "n bands"]:
        forest = jax.vmap(lambda ray: _start_tree(world, ray, rays))(along)
        numbers = jnp.arange(len(along.origin.x))

        @jax.checkpoint
        def follow(state: tuple[_Tree, Array], k: Array) -> tuple[tuple[_Tree, Array], None]:
            return _follow_living(world, rules, k, *state), None

        (forest, numbers), _ = scan(follow, (forest, numbers), jnp.arange(rays))
        return jnp.zeros_like(forest.radiance).at[numbers].set(forest.radiance)

    leaves, tree = jax.tree.flatten(along)

    def block(*leaves: Array) -> Float[Array, "n bands"]:
        return tile(tree.unflatten(leaves))

    return map_blocks(block, *leaves, size=entries_per_step(TILE), lanes=_block(len(leaves[0])))


def _block(rays: int) -> int:
    """Return the number of trees in a block, which are traced or skipped together."""
    return min(entries_per_step(_BLOCK), -(-rays // _BLOCK) * _BLOCK)


def _follow_living(
    world: World, rules: Rules, k: Array, forest: _Tree, numbers: Array
) -> tuple[_Tree, Array]:
    """Trace one pending ray of each tree. Trees with pending rays are sorted to the front, so that
    the blocks behind them are skipped. `numbers` contains the original position of each tree."""
    alive = (~(forest.weight <= 0)).any(axis=(1, 2))  # NaN is followed
    order = jnp.argsort(~alive)

    def split_into_blocks(x: Array) -> Array:
        return x[order].reshape(-1, _block(len(x)), *x.shape[1:])

    def block(entry: tuple[_Tree, Array]) -> _Tree:
        trees, alive = entry
        follow = jax.vmap(lambda tree: _follow(world, rules, k, tree))
        return jax.lax.cond(alive.any(), follow, lambda trees: trees, trees)

    followed = map_(block, jax.tree.map(split_into_blocks, (forest, alive)))
    forest = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), followed)
    return forest, numbers[order]


def _count_rays(world: World, rays: int) -> int:
    """Return the largest number of rays of a tree: `rays`, or 1 if the scene has no mirror and no
    glass."""
    check_count("rays", rays, 1)
    return rays if any(map(is_delta, world.surfaces.materials)) else 1


def _rules(scene: Scene, world: World, rule: Quadrature) -> Rules:
    """Return one sampling rule for each emitter."""
    rules: list[Quadrature] = []
    for i, own in enumerate(rules_of(scene, rule, count=world.emitters.count)):
        if not isinstance(own, Quadrature):
            raise ValueError(
                "ray trees leave nothing to chance: rules must be Quadrature, got "
                f"{type(own).__name__} for emitter {i}."
            )
        rules.append(own)
    return tuple(rules)


def _start_tree(world: World, ray: Ray, rays: int) -> _Tree:
    """Return a tree with one pending ray, and empty slots in the pool for further rays."""
    slots = rays + 1 if world.surfaces.splits else 1
    dtype = ray.origin.x.dtype
    dark = jnp.zeros((slots, world.bands), dtype)
    around = absorption_around(world.surfaces, ray, bands=world.bands)
    return _Tree(
        jnp.zeros((slots, 3), dtype).at[0].set(as_array(ray.origin)),
        jnp.zeros((slots, 3), dtype).at[0].set(as_array(ray.direction)),
        None if around is None else dark.at[0].set(around),
        dark.at[0].set(1),
        dark[0],
    )


def _follow(world: World, rules: Rules, k: Array, tree: _Tree) -> _Tree:
    """Trace the pending ray of largest weight, which is ray number `k` of the tree. Return the new
    tree."""
    slots, dtype = len(tree.weight), tree.weight.dtype
    known = jnp.nan_to_num(jax.lax.stop_gradient(tree.weight), nan=jnp.inf)  # NaN comes first
    next_one = jnp.argmax(known.max(axis=1))
    ray = Ray(tree.origin[next_one], tree.direction[next_one])
    absorption = None if tree.absorption is None else tree.absorption[next_one]
    weight = tree.weight[next_one]
    met = meet(world.surfaces, ray)
    back = -ray.direction
    found, ends = shining_ahead(
        world.emitters,
        ray,
        met.surface,
        met.hit.distance,
        dot(met.hit.normal, back),
        jnp.full((), jnp.inf, dtype),
        absorption,
        strategy="lights",
        bands=world.bands,
    )
    radiance = tree.radiance + weight * jnp.stack(found)
    on_surface = (met.surface >= 0) & ~ends
    weight = jnp.where(on_surface, weight * transmitted(absorption, met.hit.distance), 0)
    radiance = radiance + weight * _direct(world, met, back, absorption, rules)
    tree = eqx.tree_at(lambda t: t.radiance, tree, radiance)
    way = branches(world.surfaces, met, back, bands=world.bands)
    for slot, direction, part in (
        (jnp.minimum(k + 1, slots - 1), way.refracted, way.refracted_weight),
        (next_one, way.mirrored, way.mirrored_weight),
    ):
        onward = leave(met, ray, direction, ~(weight * part <= 0).all())
        after = absorption_after(world.surfaces, met, ray.direction, onward, absorption)
        tree = _store(tree, slot, onward, weight * part, after)
    return tree


def _store(tree: _Tree, slot: Array, ray: Ray, weight: Colour, absorption: Colour | None) -> _Tree:
    return _Tree(
        tree.origin.at[slot].set(as_array(ray.origin)),
        tree.direction.at[slot].set(as_array(ray.direction)),
        None if tree.absorption is None else tree.absorption.at[slot].set(absorption),
        tree.weight.at[slot].set(weight),
        tree.radiance,
    )


def _direct(world: World, met: Met, back: Vec, absorption: Colour | None, rules: Rules) -> Colour:
    """Return the radiance that a surface reflects of the direct light from all emitters, with
    shadows."""

    def shine(toward: Toward) -> Colour:
        shaded = shaded_toward(world.surfaces, met, back, toward.direction, bands=world.bands)
        dark = hidden(world.surfaces, met, toward.direction, toward.clear)
        arriving = toward.irradiance * transmitted(absorption, toward.distance)
        return jnp.where(dark, 0, shaded * arriving)

    return toward_each(world.emitters, met.hit.point, rules=rules, shine=shine, bands=world.bands)


def ray_tree_along(scene: Scene, *, rays: int, rule: Quadrature = DEFAULT_RULE) -> Along:
    """Return `ray_tree_radiances` as a function of a block of rays, in the form that `photograph`
    calls.

    Args:
        scene, rays, rule: as in `ray_tree_radiance`.

    Returns:
        A function from a block of rays to (n, bands) W m^-2 sr^-1.
    """
    return lambda along, stream: ray_tree_radiances(scene, along, rays=rays, rule=rule)


@one_call()
def ray_traced(
    scene: Scene,
    view: View,
    *,
    rays: int = 16,
    rule: Quadrature = DEFAULT_RULE,
    samples: PixelSamples | None = None,
) -> Image:
    """Render the radiance picture by ray trees.

    Light that mirrors and glass cast onto other surfaces is missing, so objects behind a window are
    dark. `transport.missing_light` lists this missing light.

    Args:
        scene: any scene; `Scene.ambient` is not added.
        view: any view; a thin lens needs `samples` for defocus.
        rays: static, >= 1, number of rays of each tree.
        rule: sampling rule for the emitters that light a surface.
        samples: rays of each pixel, whose mean is taken; None for one ray through each pixel's
            centre.

    Returns:
        (h, w, bands) W m^-2 sr^-1.

    Raises:
        ValueError: for fewer than one ray, for a random rule in `Scene.rules`, and for a thin lens
            without samples, unless its f_number is inf or traced.

    Example:
        A lamp is seen in a mirror that reflects nine tenths.

        >>> lamp = jv.Surface(jv.Disc([0, 0, 9], [0, 0, -1], 1), jv.Lambert([0.0]), [2.0])
        >>> mirror = jv.Surface(jv.Disc([0, 0, 0], [0, 0, 1], 1), jv.Mirror([0.9]))
        >>> down = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
        >>> view = jv.Orthographic([0, 0, 5], down, 0.1, resolution=(1, 1))
        >>> picture = jax.jit(lambda scene: jv.ray_traced(scene, view, rays=2))
        >>> round(float(picture(jv.Scene([lamp, mirror], []))[0, 0, 0]), 4)
        1.8
    """
    check_given("ray_traced: scene", scene, Scene)
    check_given("ray_traced: view", view, View)
    warn_of_shapes(*(surface.shape for surface in scene.surfaces))
    rules = rules_of(scene, rule)
    warn_of_skies(
        scene.lights, rules, "Take path_traced, or take the sun out of the map and add a SunDisc."
    )
    warn_of_near_surfaces(scene.lights, rules, scene.surfaces, "Take path_traced.")
    if samples is None:
        check_lens(view)
    return _ray_traced(scene, view, rays, rule, samples)


@one_program
def _ray_traced(
    scene: Scene, view: View, rays: int, rule: Quadrature, samples: PixelSamples | None
) -> Image:
    along = ray_tree_along(scene, rays=rays, rule=rule)
    # under `vmap`, blocks without pending rays would be traced too
    return photograph(along, view, samples, several=False).radiance
