"""Implement the values of `[render] integrator` as functions from pixels, or from passes, to
radiance.

Four integrators compute each pixel separately, so the picture is rendered in tiles. One of the four
is radiosity, which solves the exchange of light before the first tile. Light tracing renders
several independent pictures, called passes, and takes their mean.
"""

import math
import re
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from functools import cache, lru_cache, partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from ..brdf.lambert import Lambert
from ..core._types import Image, Key
from ..errors import InputError
from ..files.scenes import SceneFile
from ..files.scenes.schema import RenderEntry
from ..lights import Balanced, MonteCarlo, Quadrature, Rule
from ..programs import ray_options, store_whole
from ..rendering import Along, PixelSamples, direct_along, photograph
from ..rendering.maps import varied_surfaces
from ..rendering.scene_checks import idle_lamps
from ..scene import Scene, ThinLens, View
from ..transport import Paths, light_traced, missing_light, path_along, ray_tree_along
from ..transport.radiosity import (
    Plan,
    Solution,
    form_factor_table,
    patches_of,
    plan_patches,
    radiosity,
    radiosity_rays,
    trapping_surface,
)

BY_PIXEL = ("direct", "rays", "path", "radiosity")

Numbers = Int[Array, " pixels"]
Computed = Callable[..., Any]
Solve = Callable[[Key], Solution | None]
RaysOf = Callable[[Scene, Key, Solution | None, Array, Array | None], Along]
Pixels = Float[Array, "pixels bands"]


def pixels_of(
    source: SceneFile, settings: RenderEntry, *, threshold: float | None = None
) -> Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Return a function from the (rows, columns) of n pixels to their radiance and its standard
    error, (n, bands) float32 each in W m^-2 sr^-1. The standard error assumes independent samples,
    and is inf for a single sample. The value of a pixel depends on other pixels only if there is a
    `threshold`, in W m^-2 sr^-1, as in `render`."""
    compute = _seeded_traces_of(source, settings, threshold)(settings.seed)

    def compute_float32(rows: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        radiance, error = compute(rows, columns)
        return radiance.astype(np.float32), error.astype(np.float32)

    return compute_float32


def seeded_pixels_of(source: SceneFile, settings: RenderEntry) -> Callable[..., Computed]:
    """Return a function from a seed to a function that computes pixels. A second seed, for the
    positions of rays within pixels, is optional. The function that computes pixels takes rows,
    columns and the index of the first sample. For paths, that function optionally takes another
    depth. The radiance, in W m^-2 sr^-1, has the dtype of the scene. One compiled program serves
    all seeds."""
    traces = _seeded_traces_of(source, settings)

    def seed_pixels(seed: int, within_pixels: int | None = None) -> Computed:
        compute = traces(seed, within_pixels)
        return lambda *pixels, **more: compute(*pixels, **more)[0]

    return seed_pixels


def _seeded_traces_of(
    source: SceneFile, settings: RenderEntry, threshold: float | None = None
) -> Callable[..., Computed]:
    """Return a function like that of `seeded_pixels_of`, but for pixels with standard errors."""
    least = None if threshold is None else np.float32(threshold)
    _check_light(source, settings)
    _check_lens(source, settings)
    if settings.integrator == "radiosity":
        solved, along = _solve_radiosity(source, settings)
        tile = _tile_of(along, settings)
    else:
        solved, tile = _nothing, _compiled_tile(_compiled_in(settings), _structure(source))  # pyright: ignore[reportArgumentType]

    def seed_traces(seed: int, within_pixels: int | None = None) -> Computed:
        key = jax.random.key(seed)
        within = key if within_pixels is None else jax.random.key(within_pixels)
        ready = jax.block_until_ready(solved(key))

        def compute(
            rows: np.ndarray, columns: np.ndarray, first: int = 0, depth: int = settings.depth
        ) -> tuple[np.ndarray, np.ndarray]:
            places = rows.astype(np.int32), columns.astype(np.int32)
            numbers = np.uint32(first), np.uint32(depth)
            with _refusals_in_words(source):
                found = tile(
                    source.scene, source.view, key, within, ready, *places, *numbers, least
                )
            shape = len(rows), source.bands
            radiance, error = (np.asarray(x).reshape(len(rows), -1) for x in found)
            return np.broadcast_to(radiance, shape), np.broadcast_to(error, shape)

        return compute

    return seed_traces


def passes_of(source: SceneFile, settings: RenderEntry) -> tuple[int, Callable[[int], np.ndarray]]:
    """Return the number of passes, and a function from the index of a pass to the picture of that
    pass, (h, w, bands) in W m^-2 sr^-1. The final picture is the mean of all passes."""
    passes = seeded_passes_of(source, settings)
    return settings.samples, lambda number: passes(settings.seed, number)


def seeded_passes_of(source: SceneFile, settings: RenderEntry) -> Callable[[int, int], np.ndarray]:
    """Return a function from a seed and the index of a pass to the picture of that pass, (h, w,
    bands) W m^-2 sr^-1. The function is compiled once for all seeds."""
    _check_light(source, settings)
    one = _compiled_pass(_compiled_in(settings), _structure(source))  # pyright: ignore[reportArgumentType]

    def compute(seed: int, number: int) -> np.ndarray:
        key = jax.random.fold_in(jax.random.key(seed), number)
        with _refusals_in_words(source):
            return np.asarray(one(key, source.scene, source.view))

    return compute


def light_findings(source: SceneFile, settings: RenderEntry) -> list[str]:
    """List sentences about lamps that illuminate nothing, about light that the integrator cannot
    find, and about effects of the lens that a picture of radiance lacks.
    """
    return [
        *_lens_findings(source.view),
        *idle_lamps(source.scene, lights=source.lights),
        *missing_light(
            source.scene,
            integrator=settings.integrator,
            depth=settings.depth,
            rule=_rule(settings, jax.random.key(settings.seed)),
            samples=settings.samples,
            view=source.view,
            surfaces=source.surfaces,
            lights=source.lights,
        ),
    ]


def _lens_findings(view: View) -> list[str]:
    """Name the effects of a lens that change irradiance, not radiance."""
    present = [name for name in ("rim", "diffraction") if getattr(view, name, None) is not None]
    if not present:
        return []
    return [
        f"The picture of radiance is without the lens's {' and '.join(present)}, which "
        "jaxvision.capture includes in the sensor's irradiance."
    ]


def _compiled_in(settings: RenderEntry) -> RenderEntry:
    """Return the settings, with fixed values for those that do not affect the compiled program."""
    return settings.model_copy(update={"seed": 0, "tile": 1})


def _structure(source: SceneFile) -> Hashable:
    """Return the structure, shapes and dtypes of the scene and its view, on which the compiled
    program depends."""
    leaves, tree = jax.tree.flatten((source.scene, source.view))
    return tree, tuple(map(jax.typeof, leaves))


@lru_cache(maxsize=1)
def _compiled_tile(
    settings: RenderEntry, structure: Hashable
) -> Callable[..., tuple[Pixels, Pixels]]:
    """Return the compiled program for tiles, cached for one combination of settings and structure.
    A scene with the same structure uses the cached program without another compilation. The cache
    does not hold the scene. For a scene with another structure, the cached program is replaced."""
    return store_whole(_tile_of(_radiance_function(settings), settings), f"tile {settings!r}")


@lru_cache(maxsize=1)
def _compiled_pass(settings: RenderEntry, structure: Hashable) -> Callable[..., Image]:
    """Return the compiled program for one pass of light tracing, cached for one combination of
    settings and structure."""

    @partial(jax.jit, compiler_options=ray_options(paths=False))
    def trace_pass(key: Key, scene: Scene, view: View) -> Image:
        traced = light_traced(
            key, scene, view, paths=math.prod(view.resolution), depth=settings.depth, samples=1
        )
        return traced.radiance

    return store_whole(trace_pass, f"pass {settings!r}")


def _tile_of(along: RaysOf, settings: RenderEntry) -> Callable[..., tuple[Pixels, Pixels]]:
    """Return the compiled program from pixels to their radiance and standard error."""

    @partial(jax.jit, compiler_options=ray_options(paths=settings.integrator == "path"))
    def tile(
        scene: Scene,
        view: View,
        key: Key,
        within: Key,
        ready: Solution | None,
        rows: Numbers,
        columns: Numbers,
        first: Array,
        depth: Array,
        threshold: Array | None,
    ) -> tuple[Pixels, Pixels]:
        samples = PixelSamples(jax.random.fold_in(within, 1), settings.samples)
        if settings.samples == 1 and settings.integrator != "path":
            samples = None
        rays, pixels = along(scene, key, ready, depth, threshold), (rows, columns)
        wide = _is_wide(scene, settings)
        traced = photograph(rays, view, samples, pixels=pixels, first_sample=first, wide=wide)
        return traced.radiance, traced.error

    return tile


def _check_light(source: SceneFile, settings: RenderEntry) -> None:
    """Raise `InputError` if all light is ambient and the integrator is not "direct". Ambient light
    is a substitute for the light that other integrators trace.
    """
    scene = source.scene
    shines = scene.lights or any(surface.emission is not None for surface in scene.surfaces)
    if settings.integrator != "direct" and not shines:
        raise InputError(
            f"{source.path}: all light is [ambient], which integrator = {settings.integrator!r} "
            "leaves out; add a [[light]] or an emission, or set integrator = 'direct'."
        )


def _check_lens(source: SceneFile, settings: RenderEntry) -> None:
    """Raise `InputError` for a thin lens with a single ray per pixel, which would show the picture
    of a pinhole."""
    lens = isinstance(source.view, ThinLens) and np.isfinite(source.view.f_number)
    if lens and settings.samples == 1 and settings.integrator != "path":
        raise InputError(
            f"{source.path}: a thin lens defocuses by rays spread over its aperture; set samples "
            "to more than 1, or the camera's kind to 'pinhole'."
        )


def _nothing(key: Key) -> None:
    """Do nothing before the first pixel. Only radiosity replaces this function."""


def _is_wide(scene: Scene, settings: RenderEntry) -> bool:
    """Return whether maps on surfaces are averaged over the footprint of each pixel."""
    one = settings.integrator == "direct" and settings.samples == 1
    return one and varied_surfaces(scene) is not None


def _radiance_function(settings: RenderEntry) -> RaysOf:
    """Return the function that computes radiance along rays from a scene and a key, which may both
    be traced by JAX."""
    match settings.integrator:
        case "direct":
            return lambda scene, key, _solution, _depth, threshold: direct_along(
                scene, _rule(settings, key), wide=_is_wide(scene, settings), threshold=threshold
            )
        case "path":
            method = Paths(settings.samples, settings.depth)
            if settings.depth == 1:
                return lambda scene, *_: path_along(scene, method)
            return lambda scene, key, _, depth, *__: path_along(scene, method, depth=depth)
        case _:
            rule = _fixed_rule(settings)
            return lambda scene, *_: ray_tree_along(scene, rays=settings.depth, rule=rule)


def _solve_radiosity(source: SceneFile, settings: RenderEntry) -> tuple[Solve, RaysOf]:
    """Divide the scene into patches, and return two functions. The first function solves the
    exchange of light between patches for a random key, before the first pixel. The second function
    computes radiance along rays from that solution."""
    with _refusals_in_words(source):
        scene = source.scene
        whole = float(patches_of(scene, plan_patches(scene, size=np.inf, split=1)).area.sum())
        plan = plan_patches(scene, size=float(np.sqrt(whole / settings.patches)))
    exchanged = jax.jit(partial(radiosity, plan=plan))

    @cache
    def table() -> Array:
        found = jax.jit(lambda scene: form_factor_table(scene, plan))(scene)
        _check_balance(scene, plan, found)
        return found

    def solve(key: Key) -> Solution:
        with _refusals_in_words(source):
            return exchanged(scene, table=table(), rule=_rule(settings, key))

    def radiosity_along(scene: Scene, key: Key, solution: Solution | None, *_: Any) -> Along:
        assert solution is not None
        gather = None
        if settings.gather > 0:
            gather = MonteCarlo(jax.random.fold_in(key, 2), settings.gather)
        return radiosity_rays(scene, plan, solution, rule=_rule(settings, key), gather=gather)

    return solve, radiosity_along


def _check_balance(scene: Scene, plan: Plan, table: Array) -> None:
    """Raise `ValueError`, with the index of a surface, if light is trapped between this surface and
    others."""
    materials = [surface.material for surface in scene.surfaces]
    diffuse = [np.asarray(own.diffuse) for own in materials if isinstance(own, Lambert)]
    albedo = np.pi * np.stack(np.broadcast_arrays(*diffuse))  # `plan_patches` refuses all others
    caught = trapping_surface(np.asarray(table), albedo, plan)
    if caught is not None:
        raise ValueError(
            f"Scene.surfaces[{caught}].material has albedo 1 in a closed room of such surfaces, "
            "where the light of radiosity grows without end; give one of them less."
        )


def _fixed_rule(settings: RenderEntry) -> Quadrature:
    """Return the quadrature rule. Raise `InputError` if the settings ask for random samples of
    lights."""
    if settings.rule != "quadrature":
        raise InputError(
            f"render: integrator = 'rays' has no random samples of lights, but rule = "
            f"{settings.rule!r}; set rule = 'quadrature'."
        )
    return Quadrature(settings.order)


def _rule(settings: RenderEntry, key: Key) -> Rule:
    match settings.rule:
        case "quadrature":
            return Quadrature(settings.order)
        case "monte_carlo":
            return MonteCarlo(key, settings.order)
        case "balanced":
            return Balanced(key, settings.order)


def named_text(source: SceneFile, text: str) -> str:
    """Replace the indices of surfaces and lights in a text by their names in the scene file."""
    names = {"surfaces": source.surfaces, "lights": source.lights}
    return re.sub(
        r"(?:Scene\.)?\b(surfaces|lights)\[(\d+)\]",
        lambda found: names[found[1]][int(found[2])],
        text,
    )


@contextmanager
def _refusals_in_words(source: SceneFile) -> Iterator[None]:
    """Rephrase a `ValueError` of the library as an `InputError` with the names in the scene file,
    for a `with` block."""
    try:
        yield
    except ValueError as error:
        raise InputError(f"{source.path}: {named_text(source, str(error))}") from error
