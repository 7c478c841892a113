"""From a solved scene to what is seen of it: along one ray, or a whole picture.

Radiance in W m^-2 sr^-1, irradiance in W m^-2, lengths in m. What comes straight from lights is
computed for each point anew, with shadows. What other surfaces send is interpolated between the
elements, or gathered: a final gather sends rays from the point and looks up where they arrive.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..._groups import group_by_structure, take
from ..._numerics import dot
from ..._random import Stream, uniforms
from ..._staging import TILE, in_tiles, stored
from ..._types import Colour, Image, Scalar
from ..._vector import Vec, where
from ...geometry import (
    Encounter,
    Hit,
    Ray,
    Sorted,
    hit_shape,
    nearest_shape,
    offset_origin,
)
from ...hemisphere import cosine_direction, local_frame, to_world
from ...lights import MonteCarlo, Rule, can_be_seen, nearest_seen, rule_for, shifted_lattice
from ...optics import pixel_grid, view_ray
from ...scene import Light, Scene, Shape, View
from ._faces import face_place
from ._grid import Plan, around_place
from ._sources import (
    diffuse_of,
    emission_of,
    irradiance_at,
    largest_of,
    shapes_of,
    sources_of,
)
from .solution import DEFAULT_RULE, Solution

_LARGEST = 256  # numbers in an array of a shape that are gathered by each pixel


def radiosity_along(
    scene: Scene,
    plan: Plan,
    solution: Solution,
    ray: Ray,
    *,
    rule: Rule = DEFAULT_RULE,
    gather: MonteCarlo | None = None,
) -> Colour:
    """Radiance that arrives along one ray, against its direction: (bands,) in W m^-2 sr^-1.

    `rule`: how finely extended lights are taken apart, see `direct_irradiance`. `gather`: how many
    rays look for what surfaces send to the point, or None: it is interpolated between the elements
    around it. The gather shows contacts and creases as finely as the picture, for as many rays a
    point as noise allows: about .7 / sqrt(rays) of the light that is not direct. For another point
    other numbers are wanted: `lights.rule_for` draws both `rule` and `gather` anew.
    """
    return _along(_world_of(scene, solution), plan, solution, ray, rule, gather)


def radiosity_image(
    scene: Scene,
    plan: Plan,
    solution: Solution,
    view: View,
    *,
    rule: Rule = DEFAULT_RULE,
    samples: int = 1,
    gather: MonteCarlo | None = None,
) -> Image:
    """The picture of a solved scene: (h, w, bands) in W m^-2 sr^-1.

    `rule`, `gather`: as in `radiosity_along`; random ones draw for each sample anew. `samples`:
    static, rays a pixel, one through its centre or several spread over it and over the lens.
    """
    if samples < 1:
        raise ValueError(f"samples must be at least 1, got {samples}.")
    rows, columns = pixel_grid(view)
    height, width = view.resolution
    dtype = view.pixel_pitch.dtype
    world = _world_of(scene, solution)

    def sample(row: Scalar, column: Scalar, number: Int[Array, ""], k: Int[Array, ""]) -> Colour:
        if samples == 1:
            ray = view_ray(view, row, column)
        else:
            pixel, none = number.astype(jnp.uint32), jnp.zeros((), jnp.uint32)
            u = uniforms(Stream(pixel, none, jnp.asarray(_SEED)), 0, dtype)
            u = (u + k.astype(dtype) * jnp.asarray(_STEPS, dtype)) % 1
            ray = view_ray(view, row + u[0] - 0.5, column + u[1] - 0.5, u=u[2:])
        own = number * samples + k
        own_rule, own_gather = rule_for(rule, own), gather
        if gather is not None:
            own_gather = MonteCarlo(jax.random.fold_in(gather.key, own), gather.samples)
        return _along(world, plan, solution, ray, own_rule, own_gather)

    def pixel(number: Int[Array, ""]) -> Colour:
        place = rows[number // width], columns[number % width]
        if samples == 1:
            return sample(*place, number, jnp.zeros_like(number))

        def add(total: Colour, k: Int[Array, ""]) -> tuple[Colour, None]:
            return total + sample(*place, number, k), None

        nothing = jnp.zeros(solution.irradiance.shape[1], solution.irradiance.dtype)
        return jax.lax.scan(jax.checkpoint(add), nothing, jnp.arange(samples))[0] / samples

    numbers = jnp.arange(height * width)
    return in_tiles(pixel, numbers, size=TILE).reshape(height, width, -1)


_SEED = np.array([0x2545F491, 0x4F6CDD1D], np.uint32)
# powers of the root of x^5 = x + 1: a Kronecker sequence in four dimensions (Roberts, 2018)
_STEPS = np.array([0.8566748838545029, 0.733891856627126, 0.6287067210378087, 0.5385972572236101])


class _World(NamedTuple):
    """What rays ask of a scene, computed once for all of them. `groups`: its shapes by structure.
    `sources`: its lights and the quads that emit. `diffuse` sr^-1, `emission` W m^-2 sr^-1 and
    `two_sided`: by the surface."""

    shapes: Sorted
    groups: Sequence[tuple[tuple[int, ...], Shape]]
    lights: Sequence[Light]
    sources: Sequence[Light]
    diffuse: Float[Array, "surfaces bands"]
    emission: Float[Array, "surfaces bands"]
    two_sided: Bool[Array, " surfaces"]


def _world_of(scene: Scene, solution: Solution) -> _World:
    shapes = shapes_of(scene)
    return _World(
        shapes,
        group_by_structure([surface.shape for surface in scene.surfaces], largest=_LARGEST),
        scene.lights,
        sources_of(scene, largest_of(shapes)),
        diffuse_of(scene, solution.irradiance),
        emission_of(scene, solution.irradiance),
        jnp.asarray([surface.two_sided for surface in scene.surfaces]),
    )


class _Met(eqx.Module):
    """What a ray meets: where, the normal on the side it came from, the number of the surface,
    whether that side is a front, and the elements around with their weights."""

    distance: Scalar
    point: Vec
    normal: Vec
    surface: Int[Array, ""]
    seen: Bool[Array, ""]
    around: Int[Array, " 4"]
    weights: Float[Array, " 4"]


def _along(
    world: _World,
    plan: Plan,
    solution: Solution,
    ray: Ray,
    rule: Rule,
    gather: MonteCarlo | None,
) -> Colour:
    met = _meet(world, plan, solution, ray)
    direct = irradiance_at(world.sources, world.shapes, met.point, met.normal, rule)
    if gather is None:
        exchanged = _interpolated(solution.irradiance, met)
    else:
        exchanged = _gathered(world, plan, solution, met, gather)
    reflected = world.diffuse[met.surface] * (direct + exchanged)
    own = jnp.where(met.seen, reflected + world.emission[met.surface], 0)
    if not any(can_be_seen(light) for light in world.lights):
        return own
    light = nearest_seen(world.lights, ray)
    missed = jnp.isinf(met.distance)
    return jnp.where((light.distance < met.distance) | missed, light.radiance, own)


def _meet(world: _World, plan: Plan, solution: Solution, ray: Ray) -> _Met:
    encounter = stored(nearest_shape, ray, world.shapes)
    hit = stored(hit_shape, ray, world.shapes, encounter)
    surface = jnp.maximum(encounter.shape, 0)
    behind = dot(hit.normal, ray.direction) > 0
    around, weights = stored(
        partial(_around, world, plan), solution.covered, hit, encounter, behind
    )
    return _Met(
        hit.distance,
        hit.point,
        where(behind, -hit.normal, hit.normal),
        surface,
        (encounter.shape >= 0) & (world.two_sided[surface] | ~behind),
        around,
        weights,
    )


def _gathered(
    world: _World, plan: Plan, solution: Solution, met: _Met, gather: MonteCarlo
) -> Colour:
    """The irradiance by rays that are as dense as the cosine: the mean of what is sent where they
    arrive."""
    frame, size = local_frame(met.normal), world.shapes.size

    def add(total: Colour, u: Float[Array, "2"]) -> tuple[Colour, None]:
        wi = to_world(frame, cosine_direction(u))
        onward = Ray(offset_origin(met.point, met.normal, wi, size=size), wi)
        there = _meet(world, plan, solution, onward)
        arriving = _interpolated(solution.sent, there)
        return total + jnp.where(there.seen, arriving, 0), None

    nothing = jnp.zeros(solution.sent.shape[1], solution.sent.dtype)
    points, _ = shifted_lattice(gather.key, gather.samples, nothing.dtype)
    return jax.lax.scan(jax.checkpoint(add), nothing, points)[0] / gather.samples


def _around(
    world: _World,
    plan: Plan,
    covered: Bool[Array, " elements"],
    hit: Hit,
    encounter: Encounter,
    behind: Bool[Array, ""],
) -> tuple[Int[Array, " 4"], Float[Array, " 4"]]:
    """The elements around a hit and their weights."""
    zero = jnp.zeros((), jnp.int32)
    place = zero, jnp.zeros_like(hit.distance), jnp.zeros_like(hit.distance)
    for members, group in world.groups:
        shape, among = take(members, group, encounter.shape)
        found = face_place(shape, hit.point, encounter.primitive)
        place = jax.tree.map(lambda new, old, here=among: jnp.where(here, new, old), found, place)
    part, u, v = place
    of_surface = [[f for f in plan.faces if f.surface == i] for i in range(len(world.two_sided))]
    firsts = np.cumsum([0, *(len(faces) for faces in of_surface)])[:-1]
    fronts = [sum(f.front for f in faces) for faces in of_surface]
    surface = jnp.maximum(encounter.shape, 0)
    to_back = jnp.where(behind, jnp.asarray(fronts, jnp.int32)[surface], 0)
    face = jnp.asarray(firsts, jnp.int32)[surface] + part + to_back
    return around_place(plan, covered, jnp.minimum(face, len(plan.faces) - 1), u, v)


def _interpolated(values: Float[Array, "elements bands"], met: _Met) -> Colour:
    """A spectrum between elements: extrapolated, it is no less than 0."""
    return jnp.maximum((met.weights[:, None] * values[met.around]).sum(axis=0), 0)
