"""Render a scene by direct light: compute the radiance along each ray of a camera.

Radiance is in W m^-2 sr^-1, lengths are in m.
"""

from collections.abc import Callable, Sequence
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.ad_checkpoint import checkpoint_name
from jaxtyping import Array, Bool, Float, Int

from ..core._loops.fusion import entries_per_step, fuse
from ..core._loops.groups import group_by_structure, take
from ..core._maps import replace_maps
from ..core._numerics import dot
from ..core._random import Stream, Word
from ..core._types import Colour, Image, Scalar, check_given
from ..core._vector import Vec, as_array, where
from ..core._warnings import one_call
from ..geometry import Encounter, Hit, Ray, Sorted, hit_shape, nearest_shape, sorted_shapes
from ..geometry.checks import warn_of_shapes
from ..lights import (
    Balanced,
    DirectionalLight,
    Incident,
    Rule,
    can_be_seen,
    lights_by_rule,
    nearest_seen,
    rules_of,
)
from ..lights.environment_quadrature import warn_of_skies
from ..lights.near_rectangles import warn_of_near_surfaces
from ..scene import Light, Material, Scene, Surface, TriangleMesh, View
from .edges import Edges, damped, grazing_cosines, moving_edges
from .maps import Patch, Varied, evaluate_maps, patch_of, shading_normal, summed, varied_surfaces
from .pixel_loop import (
    Along,
    PixelRay,
    PixelSamples,
    map_blocks,
    map_rays,
    numbers_of,
    photograph,
)
from .shading import CURE, CURE_NEAR, Lighting, largest_reflected, lighting, reflected_radiance
from .shadows import (
    DEFAULT_RULE,
    TRACED,
    Leaving,
    Place,
    Visible,
    samples_that_reach,
    visible_in_order,
)

TOGETHER = 256  # number of rays that trace the lights in a common order
_LARGEST = 256  # each pixel indexes stacked arrays of at most this size


def radiance_along(scene: Scene, ray: Ray, *, rule: Rule = DEFAULT_RULE) -> Colour:
    """Compute the radiance that arrives along one ray, against its direction, due to direct light.

    The radiance is that of the nearest surface or extended light on the ray. A ray that hits
    neither has the radiance of the environments, or 0. The radiance of a surface is its emission
    plus the reflected light of the scene's lights. Emissive surfaces do not illuminate other
    surfaces here; in `transport` they do. The code is compiled once for each type of material, and
    shadows are traced once for all types.

    Args:
        scene: `Scene.occluders` selects the surfaces that block light, `Scene.rules` the sampling
            rules of single lights.
        ray: origin (3,) m, direction (3,) unit length.
        rule: sampling rule for extended lights without a rule of their own.

    Returns:
        (bands,) W m^-2 sr^-1.

    Example:
        >>> ball = jv.Surface(jv.Sphere([0, 0, 0], 1), jv.Lambert([0.5 / np.pi]))
        >>> scene = jv.Scene(ball, jv.DirectionalLight([0, 0, 1], [2 * np.pi]))
        >>> ray = jv.Ray([0.6, 0, 9], [0, 0, -1])  # to where the normal is (0.6, 0, 0.8)
        >>> round(float(jv.radiance_along(scene, ray)[0]), 4)  # 2 pi x 0.8 x 0.5 / pi
        0.8
    """
    return _direct_radiance(scene, sorted_scene(scene), ray, rules_of(scene, rule))


class SortedScene(eqx.Module):
    """The shapes of a scene, sorted for fast intersection with many rays; lengths in m."""

    shapes: Sorted  # of all surfaces
    # the shapes that may block light; None if no shape can block light
    occluders: Sorted | None
    varied: Varied | None = None  # the surfaces with maps
    # materials of all surfaces, with summed-area tables for maps; None for the scene's own
    # materials
    materials: tuple[Material, ...] | None = None
    # cosines of all surfaces below which `edges.damped` acts; None without moving edges
    grazing: Float[Array, " n"] | None = None


def sorted_scene(
    scene: Scene, *, wide: bool = False, grazing: Float[Array, " n"] | None = None
) -> SortedScene:
    """Sort the shapes of a scene once for all rays, and prepare its maps; lengths in m. With
    `wide`, maps are prepared for averages over the footprint of a pixel."""
    shapes = sorted_shapes([surface.shape for surface in scene.surfaces])
    varied, materials = varied_surfaces(scene), None
    if wide and varied is not None:
        varied, materials = replace_maps(
            (varied, tuple(surface.material for surface in scene.surfaces)), summed
        )
    if scene.occluders is None:
        blocking = shapes if can_shade(scene.surfaces) else None
        return SortedScene(shapes, blocking, varied, materials, grazing)
    blocking = [scene.surfaces[i].shape for i in scene.occluders]
    return SortedScene(
        shapes, sorted_shapes(blocking) if blocking else None, varied, materials, grazing
    )


class Met(eqx.Module):
    """The point where a ray hits a surface, with the data for its shading; lengths in m."""

    ray: Ray
    encounter: Encounter
    hit: Hit
    patch: Patch | None  # where maps are evaluated; None without maps
    normal: Vec  # the shading normal
    leaving: Leaving


def _meet(
    scene: Scene,
    shapes: SortedScene,
    seen: Ray | PixelRay,
    known: Encounter | None = None,
    hit: Hit | None = None,
) -> Met:
    """Find the point where a ray hits a surface. `known` and `hit` are the results of the ray's
    intersection test and of `hit_shape`, if they were computed before."""
    wide = seen if isinstance(seen, PixelRay) else None
    ray = seen.ray if isinstance(seen, PixelRay) else seen
    encounter = known or checkpoint_name(nearest_shape(ray, shapes.shapes), TRACED)
    met: Hit = fuse(hit_shape(ray, shapes.shapes, encounter)) if hit is None else hit
    if shapes.grazing is not None:
        met = damped(met, ray, encounter, shapes.grazing)
    patch = None
    if shapes.varied is not None:
        patch = patch_of(shapes.varied, encounter.shape, encounter.primitive, met, seen=wide)
    return Met(ray, encounter, met, patch, *_facing(scene, ray, encounter.shape, met, patch))


def _direct_radiance(
    scene: Scene,
    shapes: SortedScene,
    seen: Ray | PixelRay,
    rules: tuple[Rule, ...],
    known: Encounter | None = None,
    hit: Hit | None = None,
) -> Colour:
    """Compute `radiance_along` for one of many rays, with sorted shapes. `known` and `hit` are as
    in `_meet`."""
    met = _meet(scene, shapes, seen, known, hit)
    light = lighting(
        scene.lights,
        met.hit.point,
        met.leaving,
        ambient=scene.ambient,
        rule=rules,
        occluders=shapes.occluders,
    )
    return _radiance_along(scene, shapes, met, light)


def _radiance_along(scene: Scene, shapes: SortedScene, met: Met, light: Lighting) -> Colour:
    """Return the radiance along a ray, W m^-2 sr^-1, given the light on the surface that it
    hits."""
    ray, encounter = met.ray, met.encounter
    radiance = _reflect(scene, light, ray, encounter, met.normal, met.patch, shapes.materials)
    emissions = [surface.emission for surface in scene.surfaces]
    if any(emission is not None for emission in emissions):
        emitted = _emission_of(emissions, encounter.shape)
        radiance = radiance + jnp.where(dot(met.leaving.normal, ray.direction) < 0, emitted, 0)
    if any(can_be_seen(light) for light in scene.lights):
        ahead = nearest_seen(scene.lights, ray)
        nearer = (ahead.distance < met.hit.distance) | (encounter.shape < 0)
        radiance = jnp.where(nearer, ahead.radiance, radiance)
    return jnp.where(jnp.isnan(met.hit.distance), jnp.nan, radiance)  # no ray, see `hit_shape`


def _reflect(
    scene: Scene,
    light: Lighting,
    ray: Ray,
    encounter: Encounter,
    normal: Vec,
    patch: Patch | None,
    materials: Sequence[Material] | None = None,
    reflected: Callable[..., Array] = reflected_radiance,
) -> Colour | Scalar:
    """Return the radiance that the surface hit by a ray reflects back along the ray, W m^-2 sr^-1.
    `materials` are the materials of all surfaces with prepared maps, or None for the scene's own.
    `reflected` computes this radiance from a material, its light, the normal and the direction to
    the viewer."""
    radiance = jnp.zeros((), ray.origin.x.dtype)
    materials = materials or [surface.material for surface in scene.surfaces]
    for members, group in group_by_structure(materials, largest=_LARGEST):
        material, among = take(members, group, encounter.shape)
        material = material if patch is None else evaluate_maps(material, patch)
        shaded = reflected(material, light, normal, -ray.direction)
        radiance = jnp.where(among, shaded, radiance)
    return radiance


def can_shade(surfaces: Sequence[Surface]) -> bool:
    """Return whether any surface can block light, no unit.

    A scene of a single convex shape needs no shadow rays, because it shadows only its own back.
    """
    first = surfaces[0]
    return len(surfaces) > 1 or first.two_sided or isinstance(first.shape, TriangleMesh)


def _facing(
    scene: Scene, ray: Ray, index: Int[Array, ""], hit: Hit, patch: Patch | None
) -> tuple[Vec, Leaving]:
    """Return the shading normal at a hit, and the offset of shadow rays from the surface. For a
    two-sided surface both are on the viewer's side."""
    smooth, sides = hit.shading_normal or hit.normal, [s.two_sided for s in scene.surfaces]
    normal, tilted = hit.normal, None if patch is None else patch.tilted
    smooth = tilted or smooth
    if any(sides):
        turned = jnp.asarray(sides)[jnp.maximum(index, 0)] & (dot(normal, ray.direction) > 0)
        normal = where(turned, -normal, normal)
        smooth = where(turned, -smooth, smooth)
    if patch is not None and tilted is not None:
        smooth = shading_normal(smooth, normal, -ray.direction)
    return smooth, Leaving(normal, hit.size)


def _emission_of(emissions: list[Colour | None], index: Int[Array, ""]) -> Colour:
    """Return the emission of the surface `index`, W m^-2 sr^-1; 0 for a surface that emits no
    light."""
    known = next(emission for emission in emissions if emission is not None)
    table = jnp.stack([jnp.zeros_like(known) if e is None else e for e in emissions])
    return jnp.where(index >= 0, table[jnp.maximum(index, 0)], 0)


def direct_along(
    scene: Scene,
    rule: Rule,
    *,
    wide: bool = False,
    threshold: Scalar | float | None = None,
    grazing: Float[Array, " n"] | None = None,
) -> Along:
    """Return `radiance_along` as a function of a block of rays, in the form that `photograph`
    calls.

    Args:
        scene: as in `radiance_along`.
        rule: sampling rule for extended lights without a rule of their own; a random rule draws
            anew for each pixel and sample.
        wide: whether each ray is a `PixelRay`, over whose width maps are averaged.
        threshold: as in `render`.
        grazing: (n,) cosines below which `edges.damped` acts, for each surface; None without moving
            edges.

    Returns:
        A function from a block of rays to (n, bands) W m^-2 sr^-1.
    """
    shapes = sorted_scene(scene, wide=wide, grazing=grazing)

    def radiance_of_ray(ray: Ray | PixelRay, stream: Stream) -> Colour:
        return _direct_radiance(
            scene, shapes, ray, rules_of(scene, rule, numbers=numbers_of(stream))
        )

    if threshold is None or shapes.occluders is None:
        return map_rays(radiance_of_ray)
    return _direct_by_order(scene, shapes, rule, threshold)


def _direct_by_order(
    scene: Scene, shapes: SortedScene, rule: Rule, threshold: Scalar | float
) -> Along:
    """Return `direct_along` with a threshold: in each block of `TOGETHER` rays, the weakest lights
    are omitted."""
    groups = [
        (members, group)
        for members, group, own in lights_by_rule(scene.lights, rules_of(scene, rule))
        if not (can_be_seen(scene.lights[members[0]]) and isinstance(own, Balanced))
    ]

    def radiance_of_rays(rays: Ray | PixelRay, stream: Stream) -> Colour:
        leaves, tree = jax.tree.flatten((rays, stream.pixel))

        def rules_at(pixel: Word) -> tuple[Rule, ...]:
            numbers = numbers_of(Stream(pixel, stream.sample, stream.seed))
            return rules_of(scene, rule, numbers=numbers)

        def light_contribution(number: int, light: Light, met: Met, pixel: Word) -> Scalar:
            rules = rules_at(pixel)[number : number + 1]
            own = lighting([light], met.hit.point, met.leaving, rule=rules)
            place = met.ray, met.encounter, met.normal, met.patch, shapes.materials
            return _reflect(scene, own, *place, largest_reflected)

        def trace_samples(number: int, light: Light, met: Met, pixel: Word) -> Bool[Array, " _"]:
            return samples_that_reach(_place(shapes, met), rules_at(pixel)[number], light)

        def trace_block(*leaves: Array) -> Colour:
            rays, pixels = tree.unflatten(leaves)
            met = jax.vmap(partial(_meet, scene, shapes))(rays)

            def map_over_rays(one: Callable[..., Array], number: int) -> Callable[[Light], Array]:
                return lambda light: jax.vmap(partial(one, number, light))(met, pixels)

            visible: list[Array | None] = [None] * len(scene.lights)
            traced = [jnp.ones((), bool)] * len(scene.lights)
            least = jnp.asarray(threshold, met.hit.distance.dtype) / max(len(groups), 1)
            for members, group in groups:
                first = members[0]
                flags, needed = visible_in_order(
                    group,
                    map_over_rays(light_contribution, first),
                    map_over_rays(trace_samples, first),
                    least,
                )
                for k, i in enumerate(members):
                    visible[i], traced[i] = flags[k], needed[k]

            def radiance_of_ray(met: Met, pixel: Word, visible: Visible) -> Colour:
                own = scene.lights, rules_at(pixel), met.hit.point, scene.ambient
                light = Lighting(*own, _place(shapes, met), visible, tuple(traced))
                return _radiance_along(scene, shapes, met, light)

            return jax.vmap(radiance_of_ray)(met, pixels, tuple(visible))

        return map_blocks(trace_block, *leaves, size=entries_per_step(TOGETHER))

    return radiance_of_rays


def _place(shapes: SortedScene, met: Met) -> Place:
    assert shapes.occluders is not None
    return Place(met.hit.point, met.leaving, shapes.occluders)


@one_call()
def render(
    scene: Scene,
    view: View,
    *,
    rule: Rule = DEFAULT_RULE,
    samples: PixelSamples | None = None,
    edges: Edges | None = None,
    threshold: Scalar | float | None = None,
) -> Image:
    """Render the radiance picture of a scene by direct light.

    Emissive surfaces are visible but do not illuminate others here; in `transport` they do. Glass
    is black and casts full shadows. A mirror shows lamps with a size, but no surfaces.
    `transport.missing_light` lists the light that a scene loses by these limits.
    `scene_checks.idle_lamps` names lamps that face away from all surfaces. The command `jaxvision
    render` prints both lists.

    Derivatives with respect to radiance and materials are exact. Derivatives with respect to the
    position of a lamp, a camera or a shape neglect moving edges of shadows and outlines, unless
    `edges` are given. For a ball on a floor under a lamp of 0.5 m, derivatives without `edges` are
    30 % too small. `Edges` lists the included edges. The picture itself does not depend on `edges`.

    Without `samples`, each `Map` is averaged over the footprint of the pixel, by an exact integral
    over a box in its coordinates. For a reflectance the result is the mean radiance. For other
    quantities, such as a roughness, the result is the radiance for their mean value. With
    `samples`, each ray uses the map's value at the point where it meets the surface.

    On CPUs with 512-bit vectors, `jax.jit(render, compiler_options={"xla_cpu_prefer_vector_width":
    "512"})` takes about three quarters of the time.

    Args:
        scene: `Scene.occluders` selects the surfaces that block light, `Scene.rules` the sampling
            rules of single lights.
        view: any view; a thin lens needs `samples` to defocus.
        rule: sampling rule for extended lights without their own. A random rule draws new samples
            for each pixel and sample. The default, `Quadrature(8)`, suits diffuse surfaces. On a
            glossy surface of roughness 0.03 it may miss half of a lamp's highlight, while
            `Balanced` is accurate (`lights.rules` gives the errors).
        samples: rays of each pixel, whose mean is taken; None for one ray through each pixel's
            centre.
        edges: how moving edges are included in derivatives; None neglects them.
        threshold: W m^-2 sr^-1, largest radiance that each pixel may lose; None loses nothing. For
            every 256 successive pixels, lights are traced in order of the largest radiance that
            each can add there. The last lights, which together add at most the threshold to any of
            these pixels, are omitted. With a threshold of 1 % of the brightest pixel, a street of
            100 lamps and 60 houses in 256 x 256 pixels needs 5 % of the shadow rays, and a sixth of
            the time on one core. With few lights or few shapes, a threshold saves no time. Lights
            under the rule `Balanced` are all traced. `effects.prune` finds the threshold for a
            tolerance.

    Returns:
        (h, w, bands) W m^-2 sr^-1.

    All integrators warn of a shape so far from the origin that rounding deforms it. Integrators
    that use quadrature also warn of a sky whose sun falls between the nodes. Integrators that
    follow reflected light also warn of a surface that reflects more than it receives. Values that
    JAX traces are not checked.

    Raises:
        ValueError: for a thin lens without samples, unless its f_number is inf or traced.

    Example:
        >>> floor = jv.Surface(jv.Plane([0, 0, 0], [0, 0, 1]), jv.Lambert([0.5 / np.pi]))
        >>> scene = jv.Scene(floor, jv.DirectionalLight([0, 0, 1], [3.0]))
        >>> down = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
        >>> view = jv.Orthographic([0, 0, 9], down, 0.1, resolution=(1, 2))
        >>> print(jv.render(scene, view).round(4).ravel())
        [0.4775 0.4775]
    """
    check_given("render: scene", scene, Scene)
    check_given("render: view", view, View)
    warn_of_shapes(*(surface.shape for surface in scene.surfaces))
    rules = rules_of(scene, rule)
    warn_of_skies(scene.lights, rules, CURE)
    warn_of_near_surfaces(scene.lights, rules, scene.surfaces, CURE_NEAR)
    wide = samples is None and varied_surfaces(scene) is not None
    grazing = None if edges is None else grazing_cosines(scene, view)
    along = direct_along(scene, rule, wide=wide, threshold=threshold, grazing=grazing)
    traced = photograph(along, view, samples, keep=(TRACED,), wide=wide)
    if edges is None:
        return traced.radiance

    def camera_radiance(
        scene: Scene, ray: Ray, met: Encounter, number: Array, hit: Hit | None
    ) -> Colour:
        own = rules_of(scene, rule, numbers=(number,))
        return _direct_radiance(scene, sorted_scene(scene), ray, own, met, hit)

    def radiance_under(
        scene: Scene, ray: Ray, met: Encounter, hit: Hit, arriving: Incident
    ) -> Colour | Scalar:
        varied = varied_surfaces(scene)
        patch = None if varied is None else patch_of(varied, met.shape, met.primitive, hit)
        normal, leaving = _facing(scene, ray, met.shape, hit, patch)
        lamp = DirectionalLight(as_array(arriving.direction), arriving.irradiance)
        return _reflect(scene, lighting([lamp], hit.point, leaving), ray, met, normal, patch)

    def pixels(
        scene: Scene, view: View, place: tuple[Array, Array], samples: PixelSamples, first: Array
    ) -> Array:
        own = {"threshold": threshold, "grazing": grazing_cosines(scene, view)}
        along = direct_along(scene, rule, **own)
        return photograph(along, view, samples, pixels=place, first_sample=first).radiance

    rules = rules_of(scene, rule) if can_shade(scene.surfaces) else None
    own = {"picture": traced.radiance, "samples": samples}
    return traced.radiance + moving_edges(
        scene, view, edges, camera_radiance, radiance_under, rules, pixels, **own
    )
