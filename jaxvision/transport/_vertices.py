"""The vertices of a path: the surface that a ray hits, and the direction in which the path
continues.

Directions are unit vectors that point away from the surface; `back` points to where the ray came
from. Paths from the eye and paths from a light are computed in the same way, except for the factor
of a reflection, which `carries` selects. With the material's shading S (f_r cos(theta_i) for a
BRDF), the factor is

    radiance   S(wi = onward, wo = back)
    light      S(wi = back, wo = onward) cos(onward) / cos(back)

where the cosines are relative to the geometric normal, not to an interpolated one (Veach, "Robust
Monte Carlo Methods for Light Transport Simulation", 1997, section 5.3). If the two normals disagree
about the side of a direction, the geometric normal is used. Light is then never reflected into the
surface, and mirrors and glass use the geometric normal. Lengths are in m, densities in sr^-1. All
functions are for one ray; use `jax.vmap` for many.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.ad_checkpoint import checkpoint_name
from jaxtyping import Array, Bool, Float, Int

from .. import brdf
from ..brdf import Carries, Specular, draw_way, is_body, is_delta, transmitted
from ..core._loops.bands import Bands, split_bands
from ..core._loops.fusion import fuse, run_search
from ..core._loops.groups import group_by_structure, take
from ..core._maps import mean_of, replace_maps
from ..core._numerics import divide, dot, reciprocal, select, smallest_divisor
from ..core._types import Colour, Scalar, common_dtype
from ..core._vector import Vec, as_vec, where
from ..geometry import (
    Hit,
    Ray,
    Sorted,
    hit_shape,
    nearest_shape,
    occluded,
    offset_origin,
    sorted_shapes,
)
from ..geometry.hemisphere import Frame, local_frame, to_local, to_world
from ..rendering.band_count import band_count
from ..rendering.maps import Patch, Varied, evaluate_maps, patch_of, shading_normal, varied_surfaces
from ..scene import Material, Scene
from ._emitters import LARGEST, Emitters, emitters_of

# name of the results of a search among all shapes, which a gradient stores; see `paths`
SEARCHED = "searched"


class Surfaces(eqx.Module):
    """The surfaces of a scene, prepared once for all rays. `materials` are stacked by structure;
    `members` (static) contains the indices of the surfaces of each stack. `turns`, (surfaces,),
    tells whether the normal is flipped toward the viewer. `filled`, (surfaces,), tells whether the
    surface bounds a body, as glass does. `absorption`, (surfaces, bands) m^-1, belongs to the body
    behind each surface; it is None if all bodies are clear. `bodies` and `body_numbers` contain the
    shape of each body and the index of its surface; they are empty if all bodies are clear.
    `varied` contains the surfaces with maps, or is None. `splits` (static) tells whether a ray
    splits in two at some surface."""

    shapes: Sorted
    materials: tuple[Material, ...]
    turns: Bool[Array, " surfaces"]
    filled: Bool[Array, " surfaces"]
    absorption: Float[Array, "surfaces bands"] | None
    bodies: tuple[Sorted, ...]
    varied: Varied | None
    body_numbers: tuple[int, ...] = eqx.field(static=True)
    members: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    splits: bool = eqx.field(static=True)


class Met(eqx.Module):
    """The first surface that a ray hits. `surface`, (), is its index, or -1 if there is none. `hit`
    is the intersection, in m. `patch` is the place where maps are evaluated, or None in a scene
    without maps."""

    surface: Int[Array, ""]
    hit: Hit
    patch: Patch | None = None


class Onward(eqx.Module):
    """The continuation of a path. `direction` is a unit vector. `density` is the sampling density
    of the direction, () sr^-1, or inf at a mirror or glass. `weight`, (bands,), is the reflection
    factor divided by `density`, no unit."""

    direction: Vec
    weight: Bands
    density: Scalar


class Vertex(eqx.Module):
    """The result of shading one vertex. `shaded`, (bands,) sr^-1, is the shading for the requested
    direction. `density`, () sr^-1, is the density of BRDF sampling at the requested direction, or
    None if no weight needs it. `onward` is the continuation of the path."""

    shaded: Bands
    density: Scalar | None
    onward: Onward


def surfaces_of(scene: Scene) -> Surfaces:
    """Prepare the surfaces of a scene for many rays; lengths in m."""
    materials = [surface.material for surface in scene.surfaces]
    filled = [is_body(material) for material in materials]
    absorptions = [brdf.absorption(material) for material in materials]
    absorption = None
    if given := [x for x in absorptions if x is not None]:
        clear = jnp.zeros_like(given[0])
        absorption = jnp.stack([clear if x is None else x for x in absorptions])
    numbers = tuple(i for i, bounds in enumerate(filled) if bounds and given)
    groups = group_by_structure(materials, largest=LARGEST)
    return Surfaces(
        sorted_shapes([surface.shape for surface in scene.surfaces]),
        tuple(group for _, group in groups),
        jnp.asarray([s.two_sided for s in scene.surfaces]) & ~jnp.asarray(filled),
        jnp.asarray(filled),
        absorption,
        tuple(sorted_shapes([scene.surfaces[i].shape]) for i in numbers),
        varied_surfaces(scene),
        numbers,
        tuple(members for members, _ in groups),
        any(map(_splits, materials)),
    )


def _splits(material: Material) -> bool:
    """Return whether a ray may continue in two directions from a material, as it does at glass."""
    if not is_delta(material):
        return False
    up = jnp.zeros(3, common_dtype(material))
    return jax.eval_shape(brdf.specular, replace_maps(material, mean_of), up).refracted is not None


def meet(surfaces: Surfaces, ray: Ray) -> Met:
    """Return the first surface that a ray hits, in m. Gradients are with respect to this shape
    alone."""
    encounter = checkpoint_name(run_search(nearest_shape, ray, surfaces.shapes), SEARCHED)
    hit, patch = fuse(hit_shape(ray, surfaces.shapes, encounter)), None
    if surfaces.varied is not None:
        patch = patch_of(surfaces.varied, encounter.shape, encounter.primitive, hit)
    return Met(encounter.shape, hit, patch)


def _here(material: Material, met: Met) -> Material:
    """Return a material with its maps evaluated at the point that the ray hit."""
    return material if met.patch is None else evaluate_maps(material, met.patch)


def hidden(surfaces: Surfaces, met: Met, direction: Vec, distance: Scalar) -> Bool[Array, ""]:
    """Return whether a surface blocks the ray from the hit `met` in a unit direction, up to a
    distance in m."""
    hit = met.hit
    way = hit.point, hit.normal, direction, distance
    blocked = run_search(occluded, *way, surfaces.shapes, size=hit.size)
    return checkpoint_name(blocked, SEARCHED)


def vertex(
    surfaces: Surfaces,
    met: Met,
    back: Vec,
    asked: Vec,
    u: Float[Array, "3"],
    *,
    carries: Carries,
    bands: int,
    weighed: bool = True,
) -> Vertex:
    """Return the shading of the surface for the direction `asked`, and a continuation of the path,
    drawn with `u`, uniform in [0, 1). `back` and `asked` are unit vectors in the world. All results
    are 0 if the surface is seen from behind.

    Gradients treat the drawn direction and its density as constants. Such gradients are unbiased
    for every parameter of a material, although another value of the parameter would lead to another
    direction. If `weighed` (static) is False, the density of `asked` is not computed and is None.
    """
    frame, viewer, light, flat = _shading_frame(surfaces, met, back, asked)
    chosen = None
    for members, group in zip(surfaces.members, surfaces.materials, strict=True):
        material, among = take(members, group, met.surface)
        here = _vertex(
            _here(material, met),
            viewer,
            light,
            u,
            flat,
            carries=carries,
            bands=bands,
            weighed=weighed,
        )
        chosen = here if chosen is None else select(among, here, chosen)
    assert chosen is not None  # a scene has at least one surface
    # `fuse` stores the direction; otherwise XLA would draw it again for every use
    world = fuse(as_vec(to_world(frame, chosen.onward.direction)))
    return eqx.tree_at(lambda v: v.onward.direction, chosen, world)


def shaded_toward(surfaces: Surfaces, met: Met, back: Vec, asked: Vec, *, bands: int) -> Colour:
    """Return the shading S(wi = asked, wo = back) of the surface that a ray hit, (bands,) sr^-1; 0
    for mirrors, for glass, and for a surface seen from behind. `back` and `asked` are unit vectors
    in the world."""
    _, viewer, light, flat = _shading_frame(surfaces, met, back, asked)
    seen = (viewer.z > 0) & (_height(viewer, flat) > 0) & (_height(light, flat) > 0)
    shaded = jnp.zeros(bands, back.x.dtype)
    for members, group in zip(surfaces.members, surfaces.materials, strict=True):
        if not is_delta(group):
            material, among = take(members, group, met.surface)
            here = jnp.where(seen, brdf.shading(_here(material, met), light, viewer), 0)
            shaded = jnp.where(among, here, shaded)
    return shaded


class Branches(eqx.Module):
    """The two continuations of a ray at a mirror or glass. `mirrored` and `refracted` are unit
    vectors in the world. The weights are (bands,), no unit, and 0 for a continuation that does not
    exist."""

    mirrored: Vec
    refracted: Vec
    mirrored_weight: Colour
    refracted_weight: Colour


def branches(surfaces: Surfaces, met: Met, back: Vec, *, bands: int) -> Branches:
    """Return the reflected and the refracted continuation of a ray at the surface that it hit.
    `back` is the unit vector in the world against the ray."""
    frame, viewer, _, flat = _shading_frame(surfaces, met, back, back)
    mirrored = refracted = jnp.zeros(bands, back.x.dtype)
    up = down = viewer
    for members, group in zip(surfaces.members, surfaces.materials, strict=True):
        material, among = take(members, group, met.surface)
        if is_delta(material):
            ways = _specular(_here(material, met), viewer, flat)
            mirrored = jnp.where(among, ways.reflectance, mirrored)
            up = where(among, ways.mirrored, up)
            if ways.refracted is not None:
                refracted = jnp.where(among, transmitted(ways, "radiance"), refracted)
                down = where(among, ways.refracted, down)
    return Branches(as_vec(to_world(frame, up)), as_vec(to_world(frame, down)), mirrored, refracted)


def _shading_frame(
    surfaces: Surfaces, met: Met, back: Vec, asked: Vec
) -> tuple[Frame, Vec, Vec, Vec | None]:
    """Return the local frame of the shading normal, and `back`, `asked` and the geometric normal in
    this frame. The normals of a two-sided surface are flipped toward the viewer. The geometric
    normal is None if it equals the shading normal."""
    hit = met.hit
    turned = surfaces.turns[jnp.maximum(met.surface, 0)] & (dot(hit.normal, back) < 0)
    side = jnp.where(turned, -1, 1).astype(back.x.dtype)
    tilted = None if met.patch is None else met.patch.tilted
    smooth = tilted or hit.shading_normal
    shading = (hit.normal if smooth is None else smooth) * side
    if met.patch is not None and tilted is not None:
        shading = shading_normal(shading, hit.normal * side, back)
    frame = local_frame(shading)
    flat = None if smooth is None else as_vec(to_local(frame, hit.normal * side))
    return frame, as_vec(to_local(frame, back)), as_vec(to_local(frame, asked)), flat


def _height(w: Vec, flat: Vec | None) -> Scalar:
    """Return the cosine between a direction and the geometric normal, both local."""
    return w.z if flat is None else dot(w, flat)


def _vertex(
    material: Material,
    back: Vec,
    asked: Vec,
    u: Float[Array, "3"],
    flat: Vec | None,
    *,
    carries: Carries,
    bands: int,
    weighed: bool,
) -> Vertex:
    """Compute the result of `vertex` in the local frame, for one material."""
    zero, everywhere = jnp.zeros_like(back.z), jnp.full_like(back.z, jnp.inf)
    if is_delta(material):
        onward, weight = draw_way(_specular(material, back, flat), u[2], carries=carries)
        return Vertex(
            (zero,) * bands,
            zero if weighed else None,
            Onward(onward, split_bands(weight, bands), everywhere),
        )
    onward, density = fuse(jax.lax.stop_gradient(_draw_direction(material, back, u)))
    weight = _transfer(material, onward, back, flat, carries) * reciprocal(density)
    shaded = _transfer(material, asked, back, flat, carries)
    front = back.z > 0
    shows, goes = front, front
    if flat is not None:
        front &= dot(back, flat) > 0
        shows, goes = front & (dot(asked, flat) > 0), front & (dot(onward, flat) > 0)
    return Vertex(
        split_bands(jnp.where(shows, shaded, 0), bands),
        jnp.where(front, jax.lax.stop_gradient(brdf.pdf(material, asked, back)), 0)
        if weighed
        else None,
        Onward(onward, split_bands(jnp.where(goes, weight, 0), bands), density),
    )


def _draw_direction(material: Material, back: Vec, u: Float[Array, "3"]) -> tuple[Vec, Scalar]:
    onward = as_vec(brdf.sample(material, back, u))
    return onward, brdf.pdf(material, onward, back)


def _transfer(
    material: Material, onward: Vec, back: Vec, flat: Vec | None, carries: Carries
) -> Colour:
    if carries == "radiance":
        return brdf.shading(material, onward, back)
    into, out = _height(back, flat), _height(onward, flat)
    slant = divide(jnp.maximum(out, 0), into, into > smallest_divisor(into.dtype))
    return brdf.shading(material, back, onward) * slant


def _specular(material: Material, back: Vec, flat: Vec | None) -> Specular:
    """Return the continuations of a ray at a mirror or glass, in the local frame. If the shading
    normal would put a continuation on the wrong side of the surface, the geometric normal is used
    instead."""
    ways = brdf.specular(material, back)
    if flat is None:
        return ways
    side = dot(back, flat)
    right = (back.z * side > 0) & (dot(ways.mirrored, flat) * side > 0)
    if ways.refracted is not None and ways.transmittance is not None:
        right &= (dot(ways.refracted, flat) * side < 0) | (ways.transmittance.max() <= 0)
    frame = local_frame(flat)
    plain = jax.tree.map(
        lambda x: as_vec(to_world(frame, x)) if isinstance(x, Vec) else x,
        brdf.specular(material, as_vec(to_local(frame, back))),
        is_leaf=lambda x: isinstance(x, Vec),
    )
    return select(right, ways, plain)


def leave(met: Met, ray: Ray, direction: Vec, goes: Bool[Array, ""]) -> Ray:
    """Return the ray that continues from a hit along a unit direction. Where `goes` is False the
    path has ended, and the old ray is returned, so that later intersections remain finite."""
    hit = met.hit
    origin = offset_origin(hit.point, hit.normal, direction, size=hit.size)
    return Ray(where(goes, origin, ray.origin), where(goes, direction, ray.direction))


def absorption_around(surfaces: Surfaces, ray: Ray, *, bands: int) -> Colour | None:
    """Return the absorption, (bands,) m^-1, of the innermost glass body around a ray's origin. The
    absorption is 0 outside all bodies, and None if no body absorbs."""
    if surfaces.absorption is None:
        return None
    around, ray = jnp.zeros(bands, ray.origin.x.dtype), jax.lax.stop_gradient(ray)
    nearest = jnp.full_like(ray.origin.x, jnp.inf)
    for number, body in zip(surfaces.body_numbers, surfaces.bodies, strict=True):
        hit = hit_shape(ray, body, nearest_shape(ray, body))
        inside = (dot(hit.normal, ray.direction) > 0) & (hit.distance < nearest)
        nearest = jnp.where(inside, hit.distance, nearest)
        around = jnp.where(inside, surfaces.absorption[number], around)
    return around


def absorption_after(
    surfaces: Surfaces, met: Met, came: Vec, onward: Ray, before: Colour | None
) -> Colour | None:
    """Return the absorption, (bands,) m^-1, of the body that contains a path after a vertex. The
    path arrives along the unit direction `came` and continues along the ray `onward`. If the path
    enters glass at the vertex, the result is the absorption of the glass. If the path leaves glass,
    the result is the absorption of the surroundings. Otherwise the result is `before`. If no body
    in the scene absorbs, the result is None."""
    if surfaces.absorption is None or before is None:
        return None
    surface = jnp.maximum(met.surface, 0)
    inside = dot(onward.direction, met.hit.normal) < 0
    left = ~inside & (dot(came, met.hit.normal) > 0)
    around = absorption_around(surfaces, onward, bands=len(before))
    outside = before if around is None else jnp.where(left, around, before)
    after = jnp.where(inside, surfaces.absorption[surface], outside)
    return jnp.where(surfaces.filled[surface], after, before)


class World(eqx.Module):
    """A scene prepared for path tracing: its surfaces, its emitters, and the number of bands."""

    surfaces: Surfaces
    emitters: Emitters
    bands: int = eqx.field(static=True)


def world_of(scene: Scene) -> World:
    """Prepare a scene for path tracing; lengths in m."""
    surfaces, emitters = surfaces_of(scene), emitters_of(scene)
    emissions = [surface.emission for surface in scene.surfaces if surface.emission is not None]
    materials = [surface.material for surface in scene.surfaces]
    return World(surfaces, emitters, band_count(materials, scene.lights, spectra=emissions))
