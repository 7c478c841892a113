"""The radiance of a scene along a ray, or in a whole picture, from its radiosity solution.

Radiance is in W m^-2 sr^-1, irradiance in W m^-2, lengths are in m. Direct light is recomputed for
each point, with shadows. Light from other surfaces is interpolated between the elements of the
solution, or computed by a final gather. A final gather traces rays from the point, and uses the
solution where they hit other surfaces.
"""

from collections.abc import Sequence
from functools import partial, reduce
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...core._loops.fusion import materialise, one_program
from ...core._loops.groups import group_by_structure, take
from ...core._numerics import dot
from ...core._random import Stream
from ...core._types import Colour, Image, Scalar, check_given
from ...core._vector import Vec, where
from ...core.parallel_loops import scan
from ...geometry import (
    Encounter,
    Hit,
    Ray,
    Sorted,
    hit_shape,
    nearest_shape,
    offset_origin,
)
from ...geometry.hemisphere import cosine_direction, local_frame, to_world
from ...lights import (
    MonteCarlo,
    Rule,
    can_be_seen,
    nearest_seen,
    rule_for,
    rules_of,
    shifted_lattice,
)
from ...rendering import Along, PixelSamples, map_rays, numbers_of, photograph
from ...rendering.pixel_loop import check_lens
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

_LARGEST = 256  # each pixel indexes stacked arrays of at most this size


@one_program
def radiosity_along(
    scene: Scene,
    plan: Plan,
    solution: Solution,
    ray: Ray,
    *,
    rule: Rule = DEFAULT_RULE,
    gather: MonteCarlo | None = None,
) -> Colour:
    """Compute the radiance that arrives along one ray, against its direction.

    Args:
        scene, plan, solution: a scene with its own plan and solution.
        ray: origin (3,) m, direction (3,) unit length.
        rule: sampling rule for extended lights without a rule of their own, see
            `direct_irradiance`.
        gather: sampling rule for the rays of a final gather at the point; None interpolates
            indirect light between the surrounding elements. A final gather makes shadows at
            contacts and creases sharp, but adds noise of about 0.7 / sqrt(rays) of the indirect
            light. For another point, `lights.rule_for` draws both `rule` and `gather` anew.

    Returns:
        (bands,) W m^-2 sr^-1.
    """
    enclosure = _enclosure_of(scene, plan, solution)
    rules = rules_of(scene, rule, count=len(enclosure.sources))
    return _radiance_along(enclosure, ray, rules, gather)


def radiosity_rays(
    scene: Scene,
    plan: Plan,
    solution: Solution,
    *,
    rule: Rule = DEFAULT_RULE,
    gather: MonteCarlo | None = None,
) -> Along:
    """Return `radiosity_along` as a function of a block of rays, in the form that `photograph`
    calls.

    Args:
        scene, plan, solution, rule, gather: as in `radiosity_along`; random rules draw anew for
            each pixel and sample.

    Returns:
        A function from a block of rays to (n, bands) W m^-2 sr^-1.
    """
    enclosure = _enclosure_of(scene, plan, solution)

    def radiance_of_ray(ray: Ray, stream: Stream) -> Colour:
        numbers = numbers_of(stream)
        rules = rules_of(scene, rule, numbers=numbers, count=len(enclosure.sources))
        own_gather = None if gather is None else reduce(rule_for, numbers, gather)
        return _radiance_along(enclosure, ray, rules, own_gather)

    return map_rays(radiance_of_ray)


def radiosity_image(
    scene: Scene,
    plan: Plan,
    solution: Solution,
    view: View,
    *,
    rule: Rule = DEFAULT_RULE,
    samples: PixelSamples | None = None,
    gather: MonteCarlo | None = None,
) -> Image:
    """Render the radiance picture of a scene from its radiosity solution.

    Args:
        scene, plan, solution, rule, gather: as in `radiosity_along`; random rules draw anew for
            each pixel and sample.
        view: any view; a thin lens needs `samples` for defocus.
        samples: rays of each pixel, whose mean is taken; None for one ray through each pixel's
            centre.

    Returns:
        (h, w, bands) W m^-2 sr^-1.

    Raises:
        ValueError: for a thin lens without samples, unless its f_number is inf or traced.
    """
    check_given("radiosity_image: scene", scene, Scene)
    check_given("radiosity_image: view", view, View)
    if samples is None:
        check_lens(view)
    return _image(scene, plan, solution, view, rule, samples, gather)


@one_program
def _image(
    scene: Scene,
    plan: Plan,
    solution: Solution,
    view: View,
    rule: Rule,
    samples: PixelSamples | None,
    gather: MonteCarlo | None,
) -> Image:
    along = radiosity_rays(scene, plan, solution, rule=rule, gather=gather)
    return photograph(along, view, samples).radiance


class _Enclosure(NamedTuple):
    """A scene with its radiosity solution, prepared once for all rays.

    `groups` are the shapes, grouped by structure. `sources` are the lights and the emissive quads.
    `diffuse` (sr^-1), `emission` (W m^-2 sr^-1) and `two_sided` have one entry for each surface.
    """

    plan: Plan
    solution: Solution
    shapes: Sorted
    groups: Sequence[tuple[tuple[int, ...], Shape]]
    lights: Sequence[Light]
    sources: Sequence[Light]
    diffuse: Float[Array, "surfaces bands"]
    emission: Float[Array, "surfaces bands"]
    two_sided: Bool[Array, " surfaces"]


def _enclosure_of(scene: Scene, plan: Plan, solution: Solution) -> _Enclosure:
    shapes = shapes_of(scene)
    return _Enclosure(
        plan,
        solution,
        shapes,
        group_by_structure([surface.shape for surface in scene.surfaces], largest=_LARGEST),
        scene.lights,
        sources_of(scene, largest_of(shapes)),
        diffuse_of(scene, solution.irradiance),
        emission_of(scene, solution.irradiance),
        jnp.asarray([surface.two_sided for surface in scene.surfaces]),
    )


class _Met(eqx.Module):
    """The point where a ray hits a surface, the normal on the side of the ray, the index of the
    surface, whether this side is the front, and the surrounding elements with their interpolation
    weights."""

    distance: Scalar
    point: Vec
    normal: Vec
    surface: Int[Array, ""]
    seen: Bool[Array, ""]
    around: Int[Array, " 4"]
    weights: Float[Array, " 4"]


def _radiance_along(
    enclosure: _Enclosure, ray: Ray, rules: Sequence[Rule], gather: MonteCarlo | None
) -> Colour:
    met = _meet(enclosure, ray)
    direct = irradiance_at(enclosure.sources, enclosure.shapes, met.point, met.normal, rules)
    if gather is None:
        exchanged = _interpolate(enclosure.solution.irradiance, met)
    else:
        exchanged = _gather_irradiance(enclosure, met, gather)
    reflected = enclosure.diffuse[met.surface] * (direct + exchanged)
    own = jnp.where(met.seen, reflected + enclosure.emission[met.surface], 0)
    if any(can_be_seen(light) for light in enclosure.lights):
        light = nearest_seen(enclosure.lights, ray)
        nearer = (light.distance < met.distance) | jnp.isinf(met.distance)
        own = jnp.where(nearer, light.radiance, own)
    return jnp.where(jnp.isnan(met.distance), jnp.nan, own)  # no ray, see `hit_shape`


def _meet(enclosure: _Enclosure, ray: Ray) -> _Met:
    encounter = materialise(nearest_shape, ray, enclosure.shapes)
    hit = materialise(hit_shape, ray, enclosure.shapes, encounter)
    surface = jnp.maximum(encounter.shape, 0)
    behind = dot(hit.normal, ray.direction) > 0
    around, weights = materialise(
        partial(_surrounding_elements, enclosure),
        enclosure.solution.covered,
        hit,
        encounter,
        behind,
    )
    return _Met(
        hit.distance,
        hit.point,
        where(behind, -hit.normal, hit.normal),
        surface,
        (encounter.shape >= 0) & (enclosure.two_sided[surface] | ~behind),
        around,
        weights,
    )


def _gather_irradiance(enclosure: _Enclosure, met: _Met, gather: MonteCarlo) -> Colour:
    """Return the irradiance from other surfaces, as a mean over rays with cosine-distributed
    directions."""
    sent = enclosure.solution.sent
    frame, size = local_frame(met.normal), enclosure.shapes.size

    def add(total: Colour, u: Float[Array, "2"]) -> tuple[Colour, None]:
        wi = to_world(frame, cosine_direction(u))
        onward = Ray(offset_origin(met.point, met.normal, wi, size=size), wi)
        there = _meet(enclosure, onward)
        arriving = _interpolate(sent, there)
        return total + jnp.where(there.seen, arriving, 0), None

    nothing = jnp.zeros(sent.shape[1], sent.dtype)
    points, _ = shifted_lattice(gather.key, gather.samples, nothing.dtype)
    return scan(jax.checkpoint(add), nothing, points)[0] / gather.samples


def _surrounding_elements(
    enclosure: _Enclosure,
    covered: Bool[Array, " elements"],
    hit: Hit,
    encounter: Encounter,
    behind: Bool[Array, ""],
) -> tuple[Int[Array, " 4"], Float[Array, " 4"]]:
    """Return the four elements around a hit, and their interpolation weights."""
    zero = jnp.zeros((), jnp.int32)
    place = zero, jnp.zeros_like(hit.distance), jnp.zeros_like(hit.distance)
    for members, group in enclosure.groups:
        shape, among = take(members, group, encounter.shape)
        found = face_place(shape, hit.point, encounter.primitive)
        place = jax.tree.map(lambda new, old, here=among: jnp.where(here, new, old), found, place)
    part, u, v = place
    of_surface = [
        [f for f in enclosure.plan.faces if f.surface == i] for i in range(len(enclosure.two_sided))
    ]
    firsts = np.cumsum([0, *map(len, of_surface)])[:-1]
    fronts = [sum(f.front for f in own) for own in of_surface]
    surface = jnp.maximum(encounter.shape, 0)
    to_back = jnp.where(behind, jnp.asarray(fronts, jnp.int32)[surface], 0)
    face = jnp.asarray(firsts, jnp.int32)[surface] + part + to_back
    face = jnp.minimum(face, len(enclosure.plan.faces) - 1)
    return around_place(enclosure.plan, covered, face, u, v)


def _interpolate(values: Float[Array, "elements bands"], met: _Met) -> Colour:
    """Interpolate spectra between the elements around a hit, and set negative results to 0."""
    return jnp.maximum((met.weights[:, None] * values[met.around]).sum(axis=0), 0)
