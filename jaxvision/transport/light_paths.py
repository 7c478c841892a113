"""Light tracing: random paths from the emitters to the camera.

A path begins at an emitter with some flux, and is reflected by surfaces. At each surface, the light
that is reflected to the camera is added to the pixel that sees this point (Arvo, "Backward Ray
Tracing", SIGGRAPH 1986 course 12; Veach, 1997, section 10.3). Light tracing finds caustics
efficiently. A caustic is light that mirrors and glass focus on another surface; about one path from
the eye in a million finds it. Lamps may be points. Light tracing cannot find light that mirrors and
glass send directly to the camera, because a random path reaches the camera by this single direction
with probability 0. Mirrors and glass are therefore black in the picture; `paths` shows them.
Radiance is in W m^-2 sr^-1, flux in W, lengths are in m.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .. import lights
from ..core._arguments import takes_numbers
from ..core._loops.fusion import TILE, entries_per_step, fuse, one_program
from ..core._numerics import divide, dot, norm, safe_sqrt, smallest_divisor
from ..core._random import Stream, seed_of, uniforms
from ..core._types import Key, Scalar, check_count, check_given
from ..core._vector import Vec, as_vec
from ..core.parallel_loops import scan
from ..geometry import Ball, Ray, ball_around, has_area, offset_origin
from ..lights import Emitted, emitted_from_surface, nearest_seen
from ..optics import (
    aperture_point,
    distort,
    distortion_area,
    focus_vergence,
    sensor_vergence,
)
from ..rendering import Traced
from ..scene import Light, Orthographic, Scene, ThinLens, View
from ._emitters import Emissive, Emitters, apply_to_drawn, transmitted
from ._vertices import (
    World,
    absorption_after,
    absorption_around,
    hidden,
    leave,
    meet,
    vertex,
    world_of,
)
from .paths import Paths, path_traced

_Pieces = tuple[Int[Array, " pieces"], Float[Array, "pieces bands"], Bool[Array, ""]]


class _Arrival(eqx.Module):
    """The contribution of a path's vertex to the picture.

    `toward` is the unit vector from the vertex to the camera, and `distance` the distance between
    them, () m. `row` and `column` are the position in the picture, () in pixels. `response`, ()
    m^-2, is the radiance of the pixel for a flux of 1 W and a reflection of 1 sr^-1; it is 0 for a
    vertex behind the camera."""

    toward: Vec
    distance: Scalar
    row: Scalar
    column: Scalar
    response: Scalar


@takes_numbers
def light_traced(
    key: Key, scene: Scene, view: View, *, paths: int, depth: int = 6, samples: int = 16
) -> Traced:
    """Render the radiance picture of a scene by random paths from the emitters.

    Mirrors and glass are black, and so is everything that the camera sees in or through them.
    `transport.missing_light` lists this missing light.

    The random numbers of a path depend only on the key and the index of the path.

    Args:
        key: random key.
        scene: bounded, if light comes from infinity.
        view: any view.
        paths: static, number of paths from the emitters, >= 1; the error falls as 1 / sqrt(paths).
        depth: static, largest number of segments between emitter and eye, >= 1, as `Paths.depth`.
        samples: static, rays of each pixel for emitters that are directly visible, >= 1.

    Returns:
        (h, w, bands) W m^-2 sr^-1, and the standard error, as if the vertices of a path were
        independent.

    Raises:
        ValueError: for a count below 1, for light from infinity in an unbounded scene, and for an
            unbounded surface that emits.

    Example:
        >>> floor = jv.Surface(jv.Disc([0, 0, 0], [0, 0, 1], 1), jv.Lambert([0.5 / np.pi]))
        >>> scene = jv.Scene(floor, jv.DirectionalLight([0, 0, 1], [2 * np.pi]))
        >>> down = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
        >>> view = jv.Orthographic([0, 0, 9], down, 1.0, resolution=(1, 1))
        >>> found = jax.jit(lambda key: jv.light_traced(key, scene, view, paths=4096, depth=2))
        >>> round(float(found(jax.random.key(0)).radiance[0, 0, 0]), 1)  # 2 pi x 0.5 / pi
        1.0
    """
    check_given("light_traced: scene", scene, Scene)
    check_given("light_traced: view", view, View)
    for name, value in (("paths", paths), ("depth", depth), ("samples", samples)):
        check_count(name, value, 1)
    seen = path_traced(key, scene, view, method=Paths(samples, 1))
    if depth == 1:
        return seen
    for i, surface in enumerate(scene.surfaces):
        if surface.emission is not None and not has_area(surface.shape):
            raise ValueError(
                f"Scene.surfaces[{i}] shines without end, which leaves light no place to start "
                "from; give it a shape of finite area, or trace paths from the eye."
            )
    return _add_sources(key, scene, view, seen, paths, depth)


@one_program
def _add_sources(
    key: Key, scene: Scene, view: View, seen: Traced, paths: int, depth: int
) -> Traced:
    """Trace all paths from the emitters, and add their light to `seen`, the picture of visible
    emitters."""
    world = world_of(scene)
    ball = ball_around([surface.shape for surface in scene.surfaces])
    seed = seed_of(jax.random.fold_in(key, 1))
    height, width = view.resolution
    batch = min(paths, entries_per_step(TILE))

    def trace(number: Array) -> _Pieces:
        stream = Stream(number.astype(jnp.uint32), jnp.zeros((), jnp.uint32), seed)
        return _light_path(world, ball, view, stream, depth)

    @jax.checkpoint
    def add(state: tuple[Array, ...], first: Array) -> tuple[tuple[Array, ...], None]:
        total, squares, lost = state
        numbers = first + jnp.arange(batch)
        pixels, values, astray = jax.vmap(trace)(numbers)
        values = jnp.where((numbers < paths)[:, None, None], values, 0)
        pixels, values = pixels.reshape(-1), values.reshape(-1, world.bands)
        total = total.at[pixels].add(values, mode="drop")
        squares = squares.at[pixels].add(values * values, mode="drop")
        return (total, squares, lost | astray.any()), None

    black = jnp.zeros((height * width, world.bands), view.pixel_pitch.dtype)
    begin = black, black, jnp.zeros((), bool)
    (total, squares, lost), _ = scan(add, begin, jnp.arange(0, paths, batch))
    total = jnp.where(lost, jnp.nan, total)  # light of which nobody knows where it goes
    shape = (height, width, world.bands)
    radiance = (total / paths).reshape(shape)
    variance = (squares / float(paths) ** 2).reshape(shape)
    seen_variance = jnp.where(jnp.isfinite(seen.error), seen.error, 0) ** 2
    return Traced(seen.radiance + radiance, safe_sqrt(variance + seen_variance))


def _light_path(world: World, ball: Ball | None, view: View, stream: Stream, depth: int) -> _Pieces:
    """Return, for each vertex of one path, the index of the pixel that sees it and the radiance
    that it adds; and whether the path starts at or toward NaN."""
    dtype = view.pixel_pitch.dtype
    start, more = uniforms(stream, 0, dtype), uniforms(stream, 1, dtype)
    light = _emit(world.emitters, ball, jnp.append(start, more[0]))
    origin = offset_origin(as_vec(light.ray.origin), light.normal, light.ray.direction)
    flux = jnp.broadcast_to(light.flux, (world.bands,))
    height, width = view.resolution

    def step(state, k):
        ray, flux, absorption = state
        met = meet(world.surfaces, ray)
        flux = flux * transmitted(absorption, met.hit.distance)
        flux = jnp.where(met.surface >= 0, flux, 0)
        of_lens, of_surface = uniforms(stream, 2 * k + 2, dtype), uniforms(stream, 2 * k + 3, dtype)
        arrival = fuse(_arrival(view, met.hit.point, of_lens[:2]))
        at = vertex(
            world.surfaces,
            met,
            -ray.direction,
            arrival.toward,
            of_surface[:3],
            carries="light",
            bands=world.bands,
            weighed=False,
        )
        at = fuse(at)
        dark = hidden(world.surfaces, met, arrival.toward, arrival.distance)
        reaches = ~dark & (arrival.response > 0) & (met.surface >= 0)
        if world.emitters.lights:  # a light between vertex and camera hides the vertex
            camera = Ray(met.hit.point + arrival.distance * arrival.toward, -arrival.toward)
            reaches &= ~(nearest_seen(world.emitters.lights, camera).distance < arrival.distance)
        response = arrival.response * transmitted(absorption, arrival.distance)
        value = jnp.where(reaches, flux * jnp.stack(at.shaded) * response, 0)
        row = jnp.floor(arrival.row + 0.5).astype(jnp.int32)
        column = jnp.floor(arrival.column + 0.5).astype(jnp.int32)
        within = reaches & (row >= 0) & (row < height) & (column >= 0) & (column < width)
        pixel = jnp.where(within, row * width + column, height * width)
        onward = at.onward
        flux = flux * jnp.stack(onward.weight)
        goes = ~(flux <= 0).all()  # NaN goes on
        after = leave(met, ray, onward.direction, goes)
        absorption = absorption_after(world.surfaces, met, ray.direction, after, absorption)
        return (after, jnp.where(goes, flux, 0), absorption), (pixel, value)

    ray = Ray(origin, light.ray.direction)
    begin = ray, flux, absorption_around(world.surfaces, ray, bands=world.bands)
    _, found = scan(jax.checkpoint(step), begin, jnp.arange(depth - 1, dtype=jnp.uint32))
    return *found, jnp.isnan(sum(jax.tree.leaves(ray)))


def _arrival(view: View, point: Vec, u: Float[Array, "2"]) -> _Arrival:
    """Return the pixel in which a camera sees a point, m, through the point of the lens that `u`,
    uniform in [0, 1), selects.

    The solid angle of a pixel with side p, on a plane at the distance z behind the pinhole, is dw =
    p^2 cos^3(theta) / z^2. A vertex at the distance d with a flux of 1 W causes the irradiance f_r
    cos(theta_r) / d^2 at the pinhole. The radiance of the pixel is this irradiance divided by dw.
    The function is the inverse of `optics.view_ray`, if a lens gets equal uniform numbers in both
    functions.
    """
    right, down, forward = (as_vec(axis) for axis in view.rotation)
    rows, columns = view.resolution
    away = point - view.position
    if isinstance(view, Orthographic):
        depth, side = dot(away, forward), view.pixel_pitch
        row = dot(away, down) / side - (1 - rows) / 2
        column = dot(away, right) / side - (1 - columns) / 2
        response = jnp.where(depth > 0, 1 / (side * side), 0)
        return _Arrival(-forward, depth, row, column, response)
    a = b = focus = jnp.zeros_like(view.pixel_pitch)
    if isinstance(view, ThinLens):
        radius = view.focal_length / view.f_number / 2
        a, b = (radius * part for part in aperture_point(view.aperture, u))
        focus = focus_vergence(view)
        away = away - a * right - b * down
    depth = dot(away, forward)
    distance = norm(away)
    ahead = depth > smallest_divisor(depth.dtype)
    nearness = divide(1, depth, ahead)
    x = dot(away, right) * nearness + a * focus
    y = dot(away, down) * nearness + b * focus
    area = jnp.ones_like(depth)
    if view.distortion is not None:
        area = distortion_area(view.distortion, x, y)
        x, y = distort(view.distortion, x, y)
    side = view.pixel_pitch * sensor_vergence(view)
    # 1 / cos^3 = (distance / depth)^3, of which 1 / d^2 cancels two factors `distance`
    response = area * distance * nearness**3 / (side * side)
    inverse = divide(1, distance, ahead)
    return _Arrival(
        away * -inverse, distance, y / side - (1 - rows) / 2, x / side - (1 - columns) / 2, response
    )


def _emit(emitters: Emitters, around: Ball | None, u: Float[Array, "5"]) -> Emitted:
    """Draw a ray from one emitter, which u_4 selects. The numbers u_0 and u_1 give the ray's
    origin, and u_2 and u_3 its direction, all uniform in [0, 1). The flux of the ray, W, is an
    unbiased estimate of the flux of all emitters. `around` is a sphere around the scene."""

    def ray(emitter: Light | Emissive) -> Emitted:
        if isinstance(emitter, Emissive):
            shape, radiance = emitter.shape, emitter.emission
            return emitted_from_surface(shape, radiance, u[:4], two_sided=emitter.two_sided)
        return lights.emitted(emitter, u[:4], around=around)

    drawn = apply_to_drawn(emitters, u[4], ray)
    return Emitted(drawn.ray, drawn.flux * emitters.count, drawn.normal)
