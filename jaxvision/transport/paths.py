"""Path tracing: the radiance along a ray as a mean over random paths from the eye to the emitters.

    L = L_e + integral over directions of L S(wi, wo)              (Kajiya, SIGGRAPH 1986)

At every surface one emitter is sampled (next-event estimation), and one direction is drawn from the
material. If both methods can find a light, they are weighted so that the weights sum to 1 (Veach
and Guibas, SIGGRAPH 1995). The result is unbiased except for two kinds of light. Paths with more
than `depth` segments are omitted. Light from points and directions that reaches a surface via
mirrors or glass is missing, because neither way of sampling finds it. `light_paths` includes such
light, and `missing` lists it for a scene. The random numbers of a sample depend only on the key,
the pixel and the sample's index (`_random`), so a picture does not depend on the division into
blocks. `Scene.ambient` is a substitute for interreflections and is not added. Radiance is in W m^-2
sr^-1, lengths are in m.

Reverse-mode gradients exist with respect to emission, reflectances, roughnesses, indices of
refraction, the lights and the shapes. These gradients neglect moving edges of shadows and outlines,
where the picture is discontinuous. With the strategy "lights", the gradient with respect to the
position of a lamp neglects only the edges of shadows. The other strategies also neglect the outline
of the lamp itself.
"""

import dataclasses
from collections.abc import Callable
from functools import reduce
from typing import Any, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ..brdf import is_delta
from ..core._arguments import takes_numbers
from ..core._loops.bands import Bands, plus, split_bands, times
from ..core._loops.fusion import entries_per_step, materialise, one_program
from ..core._numerics import divide, dot
from ..core._random import Stream, Word, seed_of, uniforms
from ..core._shown import Shown
from ..core._types import Colour, Key, Scalar, Scalars, check_choice, check_count, check_given
from ..core.parallel_loops import fori_loop, scan, while_loop
from ..geometry import Ray
from ..rendering import Along, PixelSamples, Traced, photograph
from ..rendering.pixel_loop import mean_of_samples
from ..scene import Scene, View
from ._emitters import (
    Strategy,
    purpose_weight,
    shining_ahead,
    toward_emitter,
    transmitted,
)
from ._scene_warnings import warn_of_scene
from ._vertices import (
    SEARCHED,
    Met,
    World,
    absorption_after,
    absorption_around,
    hidden,
    leave,
    meet,
    vertex,
    world_of,
)

# Up to this number of segments, a gradient stores everything that it needs, up to 400 bytes per ray
# and segment. For longer paths it computes the segments again.
_KEPT = 8


class Paths(Shown):
    """The settings of path tracing, all of which are static.

    Attributes:
        samples: paths of each pixel, >= 1; the error falls as 1 / sqrt(samples).
        depth: largest number of segments between eye and emitter, >= 1: 1 includes only emitters
            themselves, 2 direct light. Longer paths are omitted, which darkens the picture by a
            factor of about the albedo to the power of `depth`.
        strategy: how paths are connected to lights. "balance" or "power": by light samples and by
            surface samples, combined with that heuristic. "lights": by light samples only; the
            fastest, and as good for diffuse surfaces under lamps that are not large. "surfaces": by
            surface samples only, except for lights without size.
        roulette: index of the vertex (0 is the first) from which a path ends at random, with a
            probability of 1 minus its weight; None for never. Roulette adds no bias at any `depth`,
            and the loop stops when all paths have ended. With roulette there are no reverse-mode
            gradients.

    Raises:
        ValueError: for a count below its lower limit or an unknown strategy.

    Example:
        A closed room of albedo 0.5 emits 0.5. It shows 0.5 + 0.5 x 0.5 at depth 2, and 1 in the
        limit of large depths.

        >>> grey = jv.Lambert([0.5 / np.pi])
        >>> wall = jv.Surface(jv.Sphere([0, 0, 0], 1), grey, [0.5], two_sided=True)
        >>> method = jv.Paths(samples=2, depth=2, strategy="surfaces")
        >>> ray, key = jv.Ray([0, 0, 0], [0, 0, 1]), jax.random.key(0)
        >>> float(jv.path_radiance(key, jv.Scene(wall, []), ray, method=method).radiance[0])
        0.75
    """

    samples: int = eqx.field(static=True, default=16)
    depth: int = eqx.field(static=True, default=6)
    strategy: Strategy = eqx.field(static=True, default="balance", kw_only=True)
    roulette: int | None = eqx.field(static=True, default=None, kw_only=True)

    def __check_init__(self) -> None:
        for name in ("samples", "depth"):
            check_count(f"Paths.{name}", getattr(self, name), 1)
        check_choice("Paths.strategy", self.strategy, get_args(Strategy))
        if self.roulette is not None:
            check_count("Paths.roulette", self.roulette, 0)


class _Path(eqx.Module):
    """The state of a path: its ray, its throughput, the radiance found so far, the density of its
    direction (inf from the camera and after a mirror or glass), the absorption around it (None if
    nothing absorbs), and whether it continues."""

    ray: Ray
    weight: Bands
    radiance: Bands
    density: Scalar
    absorption: Colour | None
    alive: Bool[Array, ""]


@one_program
def path_sample(scene: Scene, ray: Ray, stream: Stream, *, method: Paths) -> Colour:
    """Compute the radiance along a ray from a single random path.

    Args:
        scene: any scene; `Scene.ambient` is not added.
        ray: origin (3,) m, direction (3,) unit length.
        stream: the random numbers of this path.
        method: settings of the paths; `samples` is ignored.

    Returns:
        (bands,) W m^-2 sr^-1; its mean over streams is the radiance along the ray.
    """
    return jnp.stack(_walk(world_of(scene), ray, stream, method))


def _walk(
    world: World,
    ray: Ray,
    stream: Stream,
    method: Paths,
    depth: Array | None = None,
    of_each: Callable[[Callable[..., Any]], Callable[..., Any]] = lambda function: function,
) -> tuple[Scalars, ...]:
    """Compute the radiance of one path. If `of_each` is `jax.vmap`, compute one path for each ray
    and pixel of arrays. A `vmap` of the whole loop would trace its body several times, to determine
    which values are batched."""
    method = _simplest(world, method)

    def start(ray: Ray, pixel: Word) -> _Path:
        # a zero that depends on the path, so that `vmap` batches the whole state from the start
        zero = (0 * pixel).astype(ray.origin.x.dtype)
        finite = jnp.isfinite(sum(jax.tree.leaves(ray)))
        if world.surfaces.shapes.size is not None:
            finite &= ~jnp.isnan(world.surfaces.shapes.size)
        radiance = jnp.where(finite, zero, jnp.nan)  # of a ray or a shape at NaN as of its hits
        return _Path(
            ray,
            (zero + 1,) * world.bands,
            (radiance,) * world.bands,
            zero + jnp.inf,
            absorption_around(world.surfaces, ray, bands=world.bands),
            zero == 0,
        )

    def step(path: _Path, k: Array) -> _Path:
        def bounce(path: _Path, pixel: Word) -> _Path:
            return _bounce(world, path, Stream(pixel, stream.sample, stream.seed), k, method)

        return of_each(bounce)(path, stream.pixel)

    path = of_each(start)(ray, stream.pixel)
    pieces = method.depth - 1 if depth is None else depth.astype(jnp.uint32) - 1
    if depth is not None and method.roulette is None:
        path = fori_loop(jnp.zeros((), jnp.uint32), pieces, lambda k, path: step(path, k), path)
    elif method.roulette is None:
        if method.depth > _KEPT:
            keep = jax.checkpoint_policies.save_only_these_names(SEARCHED)
            step = jax.checkpoint(step, policy=keep)
        path, _ = scan(
            lambda path, k: (step(path, k), None),
            path,
            jnp.arange(pieces, dtype=jnp.uint32),
        )
    else:
        _, path = while_loop(
            lambda state: (state[0] < pieces) & jnp.any(state[1].alive),
            lambda state: (state[0] + 1, step(state[1], state[0])),
            (jnp.zeros((), jnp.uint32), path),
        )
    if method.depth == 1 or method.strategy != "lights" or _has_chance_only(world):
        path, _ = of_each(lambda path: _look(world, path, method))(path)
    return path.radiance


def _simplest(world: World, method: Paths) -> Paths:
    """Return the settings with the simplest strategy that gives the same result. If no ray can hit
    an emitter, every weight is 1 and densities are not needed."""
    if world.emitters.lights or world.emitters.emission is not None:
        return method
    return dataclasses.replace(method, strategy="lights")


def _has_chance_only(world: World) -> bool:
    """Return whether some light is found by BRDF sampling only: light via a mirror or glass, or
    from an emissive plane, whose infinite area cannot be sampled."""
    met_by_mirrors = world.emitters.lights or world.emitters.emission is not None
    mirrors = any(map(is_delta, world.surfaces.materials))
    return bool(met_by_mirrors and mirrors) or world.emitters.endless


def _look(world: World, path: _Path, method: Paths) -> tuple[_Path, Met]:
    """Add the emission that the current ray of a path hits. Return the path, and the surface that
    the ray hits."""
    met = meet(world.surfaces, path.ray)
    found, ends = shining_ahead(
        world.emitters,
        path.ray,
        met.surface,
        met.hit.distance,
        -dot(met.hit.normal, path.ray.direction),
        path.density,
        path.absorption,
        strategy=method.strategy,
        bands=world.bands,
    )
    weight = path.weight
    if path.absorption is not None:
        left = transmitted(path.absorption, met.hit.distance)
        weight = times(weight, split_bands(left, world.bands))
    radiance = plus(path.radiance, _where(path.alive, times(path.weight, found)))
    alive = path.alive & (met.surface >= 0) & ~ends
    return _Path(path.ray, weight, radiance, path.density, path.absorption, alive), met


def _bounce(world: World, path: _Path, stream: Stream, k: Array, method: Paths) -> _Path:
    """Follow one segment of a path, and shade the surface at its end."""
    came = path.ray
    path, met = _look(world, path, method)
    dtype = met.hit.distance.dtype
    of_light = uniforms(stream, 2 * k + 1, dtype)
    of_surface = uniforms(stream, 2 * k + 2, dtype)
    back = -came.direction
    purposeful = world.emitters.count > 0 and not all(map(is_delta, world.surfaces.materials))
    if purposeful:
        light = toward_emitter(world.emitters, met.hit.point, of_light[:3])
        asked = light.direction
    else:
        light, asked = None, back
    at = vertex(
        world.surfaces,
        met,
        back,
        asked,
        of_surface[:3],
        carries="radiance",
        bands=world.bands,
        weighed=method.strategy in ("balance", "power"),
    )
    radiance = path.radiance
    if light is not None:
        blocked = hidden(world.surfaces, met, light.direction, light.clear)
        arriving = light.irradiance * transmitted(path.absorption, light.distance)
        arriving = arriving * purpose_weight(method.strategy, light.density, at.density)
        shown = times(times(path.weight, at.shaded), split_bands(arriving, world.bands))
        radiance = plus(radiance, _where(path.alive & ~blocked, shown))
    onward = at.onward
    weight = times(path.weight, onward.weight)
    largest = reduce(jnp.maximum, weight)
    alive = path.alive & ~(largest <= 0)  # NaN goes on
    if method.roulette is not None:
        likely = jnp.where(k >= method.roulette, jnp.fmin(jax.lax.stop_gradient(largest), 1), 1)
        alive &= of_surface[3] < likely
        weight = tuple(divide(w, likely) for w in weight)
    ray = materialise(leave, met, came, onward.direction, alive)
    absorption = absorption_after(world.surfaces, met, came.direction, ray, path.absorption)
    return _Path(ray, _where(alive, weight), radiance, onward.density, absorption, alive)


def _where(counts: Bool[Array, ""], bands: Bands) -> Bands:
    return tuple(jnp.where(counts, band, 0) for band in bands)


@takes_numbers
def path_radiance(key: Key, scene: Scene, ray: Ray, *, method: Paths) -> Traced:
    """Compute the radiance that arrives along one ray, against its direction.

    Args:
        key: random key.
        scene: any scene; `Scene.ambient` is not added.
        ray: origin (3,) m, direction (3,) unit length.
        method: settings of the paths.

    Returns:
        (bands,) W m^-2 sr^-1, and the standard error.

    Example:
        A closed room of albedo 0.5 emits 0.5 W m^-2 sr^-1, and is seen by paths of two segments.

        >>> grey = jv.Lambert([0.5 / np.pi])
        >>> wall = jv.Surface(jv.Sphere([0, 0, 0], 1), grey, [0.5], two_sided=True)
        >>> method = jv.Paths(samples=2, depth=2, strategy="surfaces")
        >>> ray, key = jv.Ray([0, 0, 0], [0, 0, 1]), jax.random.key(0)
        >>> float(jv.path_radiance(key, jv.Scene(wall, []), ray, method=method).radiance[0])
        0.75
    """
    warn_of_scene(scene)
    return _path_radiance(key, scene, ray, method)


@one_program
def _path_radiance(key: Key, scene: Scene, ray: Ray, method: Paths) -> Traced:
    world, seed, pixel = world_of(scene), seed_of(key), jnp.zeros((), jnp.uint32)
    radiance, error = mean_of_samples(
        lambda number: _walk(world, ray, Stream(pixel, number, seed), method),
        method.samples,
        room=entries_per_step(1),
    )
    return Traced(jnp.stack(radiance), jnp.stack(error))


def path_along(scene: Scene, method: Paths, *, depth: Array | None = None) -> Along:
    """Return a function that computes one path for each ray of a block, in the form that
    `photograph` calls.

    Args:
        scene: any scene; `Scene.ambient` is not added.
        method: settings of the paths; `samples` is ignored.
        depth: () whole number of segments, >= 2, which replaces the method's. It may be traced, so
            that one program serves any depth; then there are no reverse-mode gradients.

    Returns:
        A function from a block of rays to the radiance of their paths, W m^-2 sr^-1.
    """
    world = world_of(scene)
    return lambda rays, stream: _walk(world, rays, stream, method, depth, jax.vmap)


@takes_numbers
def path_traced_pixels(
    key: Key,
    scene: Scene,
    view: View,
    rows: Array,
    columns: Array,
    *,
    method: Paths,
    first_sample: int = 0,
) -> Traced:
    """Compute some pixels of the picture of `path_traced`.

    Args:
        key: random key.
        scene: any scene; `Scene.ambient` is not added.
        view: any view. Each sample passes through another point of its pixel, and of a lens.
        rows, columns: (n,) whole numbers of pixels.
        method: settings of the paths.
        first_sample: static, index of the first sample. The result of a pixel depends only on the
            key, the pixel and the indices of its samples.

    Returns:
        (n, bands) W m^-2 sr^-1, and the standard error.

    Example:
        >>> lamp = jv.Surface(jv.Disc([0, 0, 9], [0, 0, -1], 1), jv.Lambert([0.0]), [2.0])
        >>> view = jv.Pinhole([0, 0, 0], np.eye(3), 0.05, 1e-5, resolution=(4, 4))
        >>> method, first = jv.Paths(samples=1, depth=1), jnp.array([0])
        >>> key, scene = jax.random.key(0), jv.Scene(lamp, [])
        >>> print(jv.path_traced_pixels(key, scene, view, first, first, method=method).radiance)
        [[2.]]
    """
    check_given("path_traced_pixels: scene", scene, Scene)
    check_given("path_traced_pixels: view", view, View)
    warn_of_scene(scene)
    pixels = jnp.asarray(rows), jnp.asarray(columns)
    return _traced_pixels(key, scene, view, pixels, method, first_sample)


@one_program
def _traced_pixels(
    key: Key, scene: Scene, view: View, pixels: tuple[Array, Array], method: Paths, first: int
) -> Traced:
    samples = PixelSamples(key, method.samples)
    return photograph(path_along(scene, method), view, samples, pixels=pixels, first_sample=first)


@takes_numbers
def path_traced(key: Key, scene: Scene, view: View, *, method: Paths) -> Traced:
    """Render the radiance picture by path tracing.

    Light from points and directions that mirrors or glass cast onto other surfaces is missing, and
    the standard error does not include it. `transport.missing_light` lists this missing light.
    Derivatives with respect to positions neglect moving edges, like those of `render` without
    `edges`.

    Args:
        key: random key.
        scene: any scene; `Scene.ambient` is not added.
        view: any view.
        method: settings of the paths.

    Returns:
        (h, w, bands) W m^-2 sr^-1, and the standard error.

    Example:
        A closed sphere of albedo 0.5 that emits 0.5 W m^-2 sr^-1 everywhere shows radiance 1.

        >>> grey = jv.Lambert([0.5 / np.pi])
        >>> wall = jv.Surface(jv.Sphere([0, 0, 0], 1), grey, [0.5], two_sided=True)
        >>> view = jv.Pinhole([0, 0, 0], np.eye(3), 1.0, 0.1, resolution=(2, 2))
        >>> method = jv.transport.Paths(samples=4, depth=20, strategy="surfaces")
        >>> key = jax.random.key(0)
        >>> picture = jv.transport.path_traced(key, jv.Scene(wall, []), view, method=method)
        >>> print(picture.radiance.round(3).ravel())
        [1. 1. 1. 1.]
    """
    check_given("path_traced: scene", scene, Scene)
    check_given("path_traced: view", view, View)
    warn_of_scene(scene)
    return _path_traced(key, scene, view, method)


@one_program
def _path_traced(key: Key, scene: Scene, view: View, method: Paths) -> Traced:
    return photograph(path_along(scene, method), view, PixelSamples(key, method.samples))
