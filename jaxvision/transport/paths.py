"""Path tracing: radiance along a ray as a mean over random walks from the eye to what shines.

    L = L_e + integral over directions of L S(wi, wo)              (Kajiya, SIGGRAPH 1986)

At every surface one emitter is drawn on purpose and one direction is drawn as the material
reflects; where both find the same light, each counts by a weight, and the weights sum to 1 (Veach
and Guibas, SIGGRAPH 1995). Unbiased but for what lies beyond `depth`, and for light that reaches a
surface by way of mirrors or glass from points and directions: neither aim nor chance finds those,
and they are missing; `light_paths` has them. The numbers of a sample are a function of its pixel
and its number alone (`_random`), so a picture does not depend on how it is cut. `Scene.ambient`,
which stands for light that bounces, is not added to the light that does.
Radiance in W m^-2 sr^-1, lengths in m.

Gradients by reverse mode reach emission, reflectances, roughnesses, indices, the lights and the
shapes. Where one thing ends before another (shadow and outline) the picture leaps, and no
gradient sees an edge move: the position of a lamp has its right gradient under "lights" up to the
shadows that it throws, and with the other strategies also lacks the lamp's own edge.
"""

from collections.abc import Callable
from functools import reduce

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, UInt32

from .._bands import Bands, apart, plus, times
from .._numerics import divide, dot, safe_sqrt
from .._random import Stream, seed_of, uniforms
from .._staging import LANES, stored
from .._types import Colour, Key, Scalar, Scalars, Spectrum
from ..brdf import is_delta
from ..geometry import Ray
from ..optics import view_ray
from ..scene import Scene, View
from ._emitters import (
    Strategy,
    purpose_weight,
    shining_ahead,
    toward_emitter,
    transmitted,
)
from ._vertices import (
    SEARCHED,
    Met,
    absorption_after,
    absorption_around,
    hidden,
    leave,
    meet,
    vertex,
)
from ._world import World, world_of

Samples = tuple[Scalars, ...]  # of many rays, one array a band

# Pieces of a path of which a gradient keeps all that it needs, up to 400 bytes a ray and piece: of
# more, it computes them again.
_KEPT = 8
_BLOCK = 65536  # pixels at once: a bounce is many small loops, and to start each one costs


class Paths(eqx.Module):
    """How finely light is followed; all static.

    `samples`: paths a pixel, >= 1; the error falls as 1 / sqrt(samples). `depth`: the most straight
    pieces between eye and emitter, >= 1: 1 shows only what shines, 2 direct light; longer paths are
    left out, which darkens by the albedo to the power of `depth`, about. `strategy`: how light is
    found: "balance" or "power", both ways joined by that heuristic; "lights", only on purpose: the
    fastest, and as good for diffuse surfaces under lamps that are not large; "surfaces", only by
    chance, except for lights without size. `roulette`: from which vertex on (0 is the first) a path
    ends at random, with the probability that its weight falls short of 1, or None. With it the walk
    is a loop that stops when the last path has ended: unbiased at any `depth`, but reverse-mode
    gradients need None.
    """

    samples: int = eqx.field(static=True, default=16)
    depth: int = eqx.field(static=True, default=6)
    strategy: Strategy = eqx.field(static=True, default="balance", kw_only=True)
    roulette: int | None = eqx.field(static=True, default=None, kw_only=True)

    def __check_init__(self) -> None:
        for name in ("samples", "depth"):
            if getattr(self, name) < 1:
                raise ValueError(f"Paths.{name} must be at least 1, got {getattr(self, name)}.")
        if self.strategy not in ("lights", "surfaces", "balance", "power"):
            raise ValueError(
                "Paths.strategy must be 'lights', 'surfaces', 'balance' or 'power', got "
                f"{self.strategy!r}."
            )
        if self.roulette is not None and self.roulette < 0:
            raise ValueError(f"Paths.roulette must be at least 0 or None, got {self.roulette}.")


class Traced(eqx.Module):
    """`radiance`: (..., bands) W m^-2 sr^-1, the mean of the samples. `error`: (..., bands), its
    standard error, in the same unit: low whenever a rare bright path was not met; inf of one
    sample."""

    radiance: Spectrum
    error: Spectrum


class _Path(eqx.Module):
    """A path under way: what it looks along, what its light will count, what it has found, the
    density of its direction (inf where it looks), what absorbs, None where nothing can, and whether
    it goes on."""

    ray: Ray
    weight: Bands
    radiance: Bands
    density: Scalar
    absorption: Colour | None
    alive: Bool[Array, ""]


def path_sample(scene: Scene, ray: Ray, stream: Stream, *, method: Paths) -> Colour:
    """The radiance of ONE random path that begins along `ray`: (bands,) in W m^-2 sr^-1, whose
    mean over streams is the radiance along the ray."""
    return jnp.stack(_walk(world_of(scene), ray, stream, method))


def _walk(world: World, ray: Ray, stream: Stream, method: Paths) -> Bands:
    # a zero of its own for each path: a loop that has to find that out batches its body twice
    zero = (0 * stream.pixel).astype(ray.origin.x.dtype)
    path = _Path(
        ray,
        (zero + 1,) * world.bands,
        (zero,) * world.bands,
        zero + jnp.inf,
        absorption_around(world.surfaces, ray, bands=world.bands),
        zero == 0,
    )

    def step(path: _Path, k: Array) -> _Path:
        return _bounce(world, path, stream, k, method)

    pieces = method.depth - 1
    if method.roulette is None:
        if method.depth > _KEPT:
            keep = jax.checkpoint_policies.save_only_these_names(SEARCHED)
            step = jax.checkpoint(step, policy=keep)
        path, _ = jax.lax.scan(
            lambda path, k: (step(path, k), None),
            path,
            jnp.arange(pieces, dtype=jnp.uint32),
        )
    else:
        _, path = jax.lax.while_loop(
            lambda state: (state[0] < pieces) & state[1].alive,
            lambda state: (state[0] + 1, step(state[1], state[0])),
            (jnp.zeros((), jnp.uint32), path),
        )
    if method.depth == 1 or method.strategy != "lights" or _has_chance_only(world):
        path, _ = _look(world, path, method)
    return path.radiance


def _has_chance_only(world: World) -> bool:
    """Whether some light can only be found by chance: by way of a mirror or glass, or on a plane
    that shines, which has no place to draw."""
    return any(map(is_delta, world.surfaces.materials)) or world.emitters.endless


def _look(world: World, path: _Path, method: Paths) -> tuple[_Path, Met]:
    """The path with what it runs into by chance, and the surface that it met."""
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
        weight = times(weight, apart(left, world.bands))
    radiance = plus(path.radiance, _where(path.alive, times(path.weight, found)))
    alive = path.alive & (met.surface >= 0) & ~ends
    return _Path(path.ray, weight, radiance, path.density, path.absorption, alive), met


def _bounce(world: World, path: _Path, stream: Stream, k: Array, method: Paths) -> _Path:
    """One piece of a path and the surface at its end."""
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
        world.surfaces, met, back, asked, of_surface[:3], carries="radiance", bands=world.bands
    )
    radiance = path.radiance
    if light is not None:
        blocked = hidden(world.surfaces, met, light.direction, light.clear)
        counts = purpose_weight(method.strategy, light.density, at.density)
        arriving = light.irradiance * transmitted(path.absorption, light.distance) * counts
        shown = times(times(path.weight, at.shaded), apart(arriving, world.bands))
        radiance = plus(radiance, _where(path.alive & ~blocked, shown))
    onward = at.onward
    weight = times(path.weight, onward.weight)
    largest = reduce(jnp.maximum, weight)
    alive = path.alive & (largest > 0)
    if method.roulette is not None:
        likely = jnp.where(k >= method.roulette, jnp.minimum(jax.lax.stop_gradient(largest), 1), 1)
        alive &= of_surface[3] < likely
        weight = tuple(divide(w, likely) for w in weight)
    ray = stored(leave, met, came, onward.direction, alive)
    absorption = absorption_after(world.surfaces, met, came.direction, ray, path.absorption)
    return _Path(ray, _where(alive, weight), radiance, onward.density, absorption, alive)


def _where(counts: Bool[Array, ""], bands: Bands) -> Bands:
    return tuple(jnp.where(counts, band, 0) for band in bands)


def path_radiance(key: Key, scene: Scene, ray: Ray, *, method: Paths) -> Traced:
    """Radiance that arrives along one ray, against its direction: (bands,) in W m^-2 sr^-1."""
    world, seed = world_of(scene), seed_of(key)

    def sample(number: UInt32[Array, ""]) -> Bands:
        return _walk(world, ray, Stream(jnp.zeros((), jnp.uint32), number, seed), method)

    dark = (jnp.zeros((), ray.origin.x.dtype),) * world.bands
    return _mean(sample, 0, method.samples, dark)


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
    """The radiance, W m^-2 sr^-1, of some pixels of a picture: (n, bands).

    `rows`, `columns`: (n,) whole numbers, pixels. Each sample goes through a random place of its
    pixel. What a pixel gets depends on the key, the pixel and the numbers of its samples, which
    start at `first_sample`, and not on which others are asked for with it.
    """
    world, seed = world_of(scene), seed_of(key)
    dtype = view.pixel_pitch.dtype

    def of_pixel(row: Array, column: Array, count: UInt32[Array, ""]) -> Bands:
        stream = Stream((row * view.resolution[1] + column).astype(jnp.uint32), count, seed)
        u = uniforms(stream, 0, dtype)
        down, right = row.astype(dtype) + u[0] - 0.5, column.astype(dtype) + u[1] - 0.5
        return _walk(world, view_ray(view, down, right, u=u[2:]), stream, method)

    def of_block(rows: Array, columns: Array) -> Traced:
        def sample(count: UInt32[Array, ""]) -> Samples:
            return jax.vmap(of_pixel, in_axes=(0, 0, None))(rows, columns, count)

        dark = jnp.zeros(rows.shape, dtype)
        return _mean(sample, first_sample, method.samples, (dark,) * world.bands)

    return _in_blocks(of_block, rows, columns)


def _in_blocks(of_block: Callable[[Array, Array], Traced], rows: Array, columns: Array) -> Traced:
    """All pixels, a block at a time. Blocks are full, if need be with pixels
    that are thrown away: where vector code ends and leaves a rest to plain code, the last bit of a
    pixel would tell how the picture was cut."""
    count = len(rows)
    size = min(_BLOCK, -(-count // LANES) * LANES)
    blocks = -(-count // size)
    padded = [
        jnp.pad(jnp.asarray(x), (0, blocks * size - count), mode="edge").reshape(blocks, size)
        for x in (rows, columns)
    ]
    if blocks == 1:  # each loop around a loop takes a gradient about as long again to compile
        traced = of_block(*(x[0] for x in padded))
    else:
        traced = jax.lax.map(lambda block: of_block(*block), tuple(padded))
    return jax.tree.map(lambda x: x.reshape(blocks * size, -1)[:count], traced)


def path_traced(key: Key, scene: Scene, view: View, *, method: Paths) -> Traced:
    """The picture in radiance: (h, w, bands) in W m^-2 sr^-1, and its standard error."""
    rows, columns = (jnp.arange(size) for size in view.resolution)
    grid = jnp.meshgrid(rows, columns, indexing="ij")
    pixels = path_traced_pixels(key, scene, view, *(x.reshape(-1) for x in grid), method=method)
    return jax.tree.map(lambda x: x.reshape(*view.resolution, -1), pixels)


def _mean(sample: Callable[[Array], Samples], first: int, count: int, dark: Samples) -> Traced:
    """The mean of samples, one after another, and its standard error (Welford, Technometrics 4(3)
    (1962)): no sum of squares cancels. `dark`: zeros of the shape of a sample."""

    @jax.checkpoint
    def add(state: tuple[Samples, Samples], k: Array) -> tuple[tuple[Samples, Samples], None]:
        value, number = sample(k + jnp.uint32(first)), (k + 1).astype(dark[0].dtype)
        means, squares = [], []
        for x, mean, square in zip(value, *state, strict=True):
            means.append(mean + (x - mean) / number)
            squares.append(square + (x - mean) * (x - means[-1]))
        return (tuple(means), tuple(squares)), None

    state, _ = jax.lax.scan(add, (dark, dark), jnp.arange(count, dtype=jnp.uint32))
    mean, squares = (jnp.stack(x, axis=-1) for x in state)
    if count == 1:
        return Traced(mean, jnp.full_like(mean, jnp.inf))
    return Traced(mean, safe_sqrt(squares / (float(count) * (count - 1))))
