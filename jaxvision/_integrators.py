"""The words of `[render] integrator` as functions from pixels, or from passes, to radiance.

Four of them know each pixel alone and can be cut into tiles; radiosity is solved before the first
of them. Light tracing makes whole pictures, as the mean of independent passes.
"""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ._staging import LANES, TILE, in_tiles
from ._types import Colour, Image, Key
from .brdf.lambert import Lambert
from .errors import InputError
from .geometry import Ray
from .lights import Balanced, MonteCarlo, Quadrature, Rule, rule_for
from .optics import view_ray
from .rendering import PixelSamples, radiance_along, sample_ray
from .scene import Scene, View
from .scene_files import SceneFile
from .scene_files.schema import RenderEntry
from .transport import Paths, light_traced, path_traced_pixels, ray_tree_radiances
from .transport.radiosity import (
    Plan,
    form_factor_table,
    patches_of,
    plan_patches,
    radiosity,
    radiosity_along,
)
from .transport.radiosity._trapped import trapping_surface

BY_PIXEL = ("direct", "rays", "path", "radiosity")

Numbers = Int[Array, " pixels"]
Pixels = Float[Array, "pixels bands"]
Along = Callable[[Scene, Ray, Rule, Numbers], Pixels]


def pixels_of(
    source: SceneFile, settings: RenderEntry
) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """(rows, columns) of n pixels to their radiance, (n, bands) float32 in W m^-2 sr^-1; compiled
    once for each n. What a pixel gets does not depend on the others."""
    _check_light(source, settings)
    key = jax.random.key(settings.seed)
    along = None if settings.integrator == "path" else _along(source, settings)

    @jax.jit
    def tile(scene: Scene, view: View, key: Key, rows: Numbers, columns: Numbers) -> Pixels:
        count = len(rows)
        rows, columns = (jnp.pad(x, (0, -count % LANES), mode="edge") for x in (rows, columns))
        return radiance(scene, view, key, rows, columns)[:count]

    def radiance(scene: Scene, view: View, key: Key, rows: Numbers, columns: Numbers) -> Pixels:
        if along is not None:
            return _means(along, key, scene, view, rows, columns, settings)
        method = Paths(settings.samples, settings.depth)
        return path_traced_pixels(key, scene, view, rows, columns, method=method).radiance

    def compute(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        places = rows.astype(np.int32), columns.astype(np.int32)
        with _in_words_of(source):
            radiance = np.asarray(tile(source.scene, source.view, key, *places), np.float32)
        return np.broadcast_to(radiance.reshape(len(rows), -1), (len(rows), source.bands))

    return compute


def passes_of(source: SceneFile, settings: RenderEntry) -> tuple[int, Callable[[int], np.ndarray]]:
    """How many passes there are, and from the number of one to its picture, (h, w, bands) in
    W m^-2 sr^-1. The mean of all is the picture."""
    _check_light(source, settings)
    key = jax.random.key(settings.seed)
    height, width = source.view.resolution

    @jax.jit
    def one(key: Key, scene: Scene, view: View) -> Image:
        traced = light_traced(
            key, scene, view, paths=height * width, depth=settings.depth, samples=1
        )
        return traced.radiance

    def compute(number: int) -> np.ndarray:
        with _in_words_of(source):
            return np.asarray(one(jax.random.fold_in(key, number), source.scene, source.view))

    return settings.samples, compute


def _check_light(source: SceneFile, settings: RenderEntry) -> None:
    """`InputError` where all light is ambient, which stands for the light that others follow."""
    scene = source.scene
    shines = scene.lights or any(surface.emission is not None for surface in scene.surfaces)
    if settings.integrator != "direct" and not shines:
        raise InputError(
            f"{source.path}: all light is [ambient], which integrator = {settings.integrator!r} "
            "leaves out; add a [[light]] or an emission, or set integrator = 'direct'."
        )


def _along(source: SceneFile, settings: RenderEntry) -> Along:
    match settings.integrator:
        case "direct":
            return _direct(settings)
        case "rays":
            return _rays(settings)
        case _:
            return _solved(source, settings)


def _direct(settings: RenderEntry) -> Along:
    def along(scene: Scene, rays: Ray, rule: Rule, numbers: Numbers) -> Pixels:
        def one(ray: Ray, number: Array) -> Colour:
            own = rule_for(rule, number)
            return radiance_along(scene, ray, rule=own, shadows=settings.shadows)

        return in_tiles(one, rays, numbers, size=TILE)

    return along


def _rays(settings: RenderEntry) -> Along:
    def along(scene: Scene, rays: Ray, rule: Rule, numbers: Numbers) -> Pixels:
        if not isinstance(rule, Quadrature):
            raise InputError(
                f"render: integrator = 'rays' leaves nothing to chance, but rule = "
                f"{settings.rule!r}; set rule = 'quadrature'."
            )
        return ray_tree_radiances(scene, rays, rays=settings.depth, rule=rule)

    return along


def _solved(source: SceneFile, settings: RenderEntry) -> Along:
    """The scene cut into patches, and what is seen of the light that they exchange."""
    with _in_words_of(source):
        scene, rule = source.scene, _rule(settings, jax.random.key(settings.seed))
        whole = float(patches_of(scene, plan_patches(scene, size=np.inf, split=1)).area.sum())
        plan = plan_patches(scene, size=float(np.sqrt(whole / settings.patches)))
        table = jax.jit(lambda scene: form_factor_table(scene, plan))(scene)
        _check_balance(scene, plan, table)
        solution = jax.jit(partial(radiosity, plan=plan))(scene, table=table, rule=rule)
    gather = None
    if settings.gather > 0:
        gather = MonteCarlo(jax.random.fold_in(jax.random.key(settings.seed), 2), settings.gather)

    def along(scene: Scene, rays: Ray, rule: Rule, numbers: Numbers) -> Pixels:
        def one(ray: Ray, number: Array) -> Colour:
            own = rule_for(rule, number)
            anew = gather
            if gather is not None:
                anew = MonteCarlo(jax.random.fold_in(gather.key, number), gather.samples)
            return radiosity_along(scene, plan, solution, ray, rule=own, gather=anew)

        return in_tiles(one, rays, numbers, size=TILE)

    return along


def _check_balance(scene: Scene, plan: Plan, table: Array) -> None:
    """`ValueError` with the number of a surface between whose likes light is caught for ever."""
    materials = [surface.material for surface in scene.surfaces]
    diffuse = [np.asarray(own.diffuse) for own in materials if isinstance(own, Lambert)]
    albedo = np.pi * np.stack(np.broadcast_arrays(*diffuse))  # `plan_patches` refuses all others
    caught = trapping_surface(np.asarray(table), albedo, plan)
    if caught is not None:
        raise ValueError(
            f"Scene.surfaces[{caught}].material has albedo 1 in a closed room of such surfaces, "
            "where the light of radiosity grows without end; give one of them less."
        )


def _means(
    along: Along,
    key: Key,
    scene: Scene,
    view: View,
    rows: Numbers,
    columns: Numbers,
    settings: RenderEntry,
) -> Pixels:
    """The mean of each pixel's rays: one through its centre and the middle of the lens, or several
    through random places of both."""
    rule, numbers = _rule(settings, key), rows * view.resolution[1] + columns
    places = rows.astype(view.pixel_pitch.dtype), columns.astype(view.pixel_pitch.dtype)
    if settings.samples == 1:
        return along(scene, jax.vmap(partial(view_ray, view))(*places), rule, numbers)
    samples = PixelSamples(jax.random.fold_in(key, 1), settings.samples)

    def sample(k: Array) -> Pixels:
        ray_of = jax.vmap(partial(sample_ray, samples, view), in_axes=(0, 0, 0, None))
        rays = ray_of(*places, numbers, k)
        return along(scene, rays, rule, numbers * samples.count + k)

    first = sample(jnp.int32(0))
    total = jax.lax.fori_loop(1, samples.count, lambda k, total: total + sample(k), first)
    return total / samples.count


def _rule(settings: RenderEntry, key: Key) -> Rule:
    match settings.rule:
        case "quadrature":
            return Quadrature(settings.order)
        case "monte_carlo":
            return MonteCarlo(key, settings.order)
        case "balanced":
            return Balanced(key, settings.order)


@contextmanager
def _in_words_of(source: SceneFile) -> Iterator[None]:
    """What the library refuses, told by the names of the scene file."""
    names = {"surfaces": source.surfaces, "lights": source.lights}
    try:
        yield
    except ValueError as error:
        sentence = re.sub(
            r"Scene\.(surfaces|lights)\[(\d+)\]",
            lambda found: names[found[1]][int(found[2])],
            str(error),
        )
        raise InputError(f"{source.path}: {sentence}") from error
