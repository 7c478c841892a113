"""Vertices of a path: the surface that a ray hits, and the direction in which it continues.

Directions are unit and point away from the surface: `back` is the direction in which the ray came.
Paths from the eye and paths from a source use the same vertices. Only the factor of a reflection
differs, as `carries` selects. With S the material's shading (f_r cos(theta_i) for a BRDF), it is

    radiance   S(wi = onward, wo = back)
    light      S(wi = back, wo = onward) cos(onward) / cos(back)

with cosines about the geometric normal, not an interpolated one (Veach, "Robust Monte Carlo Methods
for Light Transport Simulation", 1997, section 5.3). If the two normals disagree about the side of a
direction, the geometric one decides: nothing is reflected into the surface, and mirrors and glass
use its own normal. Lengths in m, densities in sr^-1. For ONE ray; the caller vmaps.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.ad_checkpoint import checkpoint_name
from jaxtyping import Array, Bool, Float, Int

from .. import brdf
from ..brdf import Carries, Specular, draw_way, is_body, is_delta, transmitted
from ..core._loops.bands import Bands, split_bands
from ..core._loops.fusion import fuse, searched
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
from ..rendering.maps import Patch, Varied, at_patch, patch_of, shading_normal, varied_surfaces
from ..scene import Material, Scene
from ._emitters import LARGEST, Emitters, emitters_of

# marks results of a search among all shapes, which a gradient stores, see `paths`
SEARCHED = "searched"


class Surfaces(eqx.Module):
    """The surfaces of a scene, sorted once. `materials`: stacked by structure. `members`: static,
    indices of the surfaces of each stack. `turns`: (surfaces,) whether the normal is flipped toward
    the viewer. `filled`: (surfaces,) whether the surface bounds a body, as glass does.
    `absorption`: (surfaces, bands) m^-1 of the body behind each surface, or None if all bodies are
    clear. `bodies`, `body_numbers`: each body separately, and the index of its surface; empty if
    all are clear. `varied`: the surfaces with maps, or None. `splits`: static, whether a ray splits
    in two at some surface."""

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
    """The first surface on a ray. `surface`: () its index, -1 for none. `hit`: the intersection, in
    m. `patch`: the place where maps are evaluated; None in a scene without maps."""

    surface: Int[Array, ""]
    hit: Hit
    patch: Patch | None = None


class Onward(eqx.Module):
    """The continuation of a path. `direction`: unit. `weight`: (bands,), the reflection factor
    divided by the density, no unit. `density`: () sr^-1, inf at a mirror or glass."""

    direction: Vec
    weight: Bands
    density: Scalar


class Vertex(eqx.Module):
    """The result of one vertex. `shaded`: (bands,), sr^-1, the shading for the requested direction.
    `density`: () sr^-1, with which BRDF sampling would draw that direction; None if no weight needs
    it. `onward`: the actual continuation."""

    shaded: Bands
    density: Scalar | None
    onward: Onward


def surfaces_of(scene: Scene) -> Surfaces:
    """Sort the surfaces of a scene once for all rays; lengths in m."""
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
    """Whether a ray may continue in two directions from the material."""
    if not is_delta(material):
        return False
    up = jnp.zeros(3, common_dtype(material))
    return jax.eval_shape(brdf.specular, replace_maps(material, mean_of), up).refracted is not None


def meet(surfaces: Surfaces, ray: Ray) -> Met:
    """Return the first surface that a ray meets, in m; gradients reach only this shape."""
    encounter = checkpoint_name(searched(nearest_shape, ray, surfaces.shapes), SEARCHED)
    hit, patch = fuse(hit_shape(ray, surfaces.shapes, encounter)), None
    if surfaces.varied is not None:
        patch = patch_of(surfaces.varied, encounter.shape, encounter.primitive, hit)
    return Met(encounter.shape, hit, patch)


def _here(material: Material, met: Met) -> Material:
    """Return a material with its maps evaluated at the point that the ray met."""
    return material if met.patch is None else at_patch(material, met.patch)


def hidden(surfaces: Surfaces, met: Met, direction: Vec, distance: Scalar) -> Bool[Array, ""]:
    """Whether a surface blocks the ray from the point `met` in a unit direction, up to a distance
    in m."""
    hit = met.hit
    way = hit.point, hit.normal, direction, distance
    blocked = searched(occluded, *way, surfaces.shapes, size=hit.size)
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
    """Shade the surface toward `asked`, and draw the continuation of the path by `u`, uniform in
    [0, 1). `back`, `asked`: unit, world. All is 0 if the surface is seen from behind.

    Gradients treat the drawn direction and its density as constants. This is right for every
    parameter of a material, although a changed parameter would draw another direction. `weighed`:
    static; if False, the density toward `asked` is not computed and is None.
    """
    frame, viewer, light, flat = _seen_from(surfaces, met, back, asked)
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
    """Return the shading S(wi = asked, wo = back) at the surface that was met, (bands,) sr^-1; 0
    for mirrors, for glass, and for a surface seen from behind. `back`, `asked`: unit, world."""
    _, viewer, light, flat = _seen_from(surfaces, met, back, asked)
    seen = (viewer.z > 0) & (_height(viewer, flat) > 0) & (_height(light, flat) > 0)
    shaded = jnp.zeros(bands, back.x.dtype)
    for members, group in zip(surfaces.members, surfaces.materials, strict=True):
        if not is_delta(group):
            material, among = take(members, group, met.surface)
            here = jnp.where(seen, brdf.shading(_here(material, met), light, viewer), 0)
            shaded = jnp.where(among, here, shaded)
    return shaded


class Branches(eqx.Module):
    """The two continuations at a mirror or glass. `mirrored`, `refracted`: unit, world. The weights
    are (bands,), no unit, and 0 for a continuation that does not exist."""

    mirrored: Vec
    refracted: Vec
    mirrored_weight: Colour
    refracted_weight: Colour


def branches(surfaces: Surfaces, met: Met, back: Vec, *, bands: int) -> Branches:
    """Return the reflected and the refracted continuation of a ray at the surface that it met.
    `back`: unit, world, against the ray."""
    frame, viewer, _, flat = _seen_from(surfaces, met, back, back)
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


def _seen_from(
    surfaces: Surfaces, met: Met, back: Vec, asked: Vec
) -> tuple[Frame, Vec, Vec, Vec | None]:
    """Return the frame about the shading normal, then `back`, `asked` and the geometric normal in
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
    """Do what `vertex` does, in the local frame and for one material."""
    zero, everywhere = jnp.zeros_like(back.z), jnp.full_like(back.z, jnp.inf)
    if is_delta(material):
        onward, weight = draw_way(_specular(material, back, flat), u[2], carries=carries)
        return Vertex(
            (zero,) * bands,
            zero if weighed else None,
            Onward(onward, split_bands(weight, bands), everywhere),
        )
    onward, density = fuse(jax.lax.stop_gradient(_drawn(material, back, u)))
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


def _drawn(material: Material, back: Vec, u: Float[Array, "3"]) -> tuple[Vec, Scalar]:
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
    """Return the continuations at a mirror or glass, local. The geometric normal replaces the
    shading normal if that would put a continuation on the wrong side of the surface."""
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
    path has ended and keeps its old ray, so that its hits stay finite."""
    hit = met.hit
    origin = offset_origin(hit.point, hit.normal, direction, size=hit.size)
    return Ray(where(goes, origin, ray.origin), where(goes, direction, ray.direction))


def absorption_around(surfaces: Surfaces, ray: Ray, *, bands: int) -> Colour | None:
    """Return the absorption, (bands,) m^-1, of the innermost glass body around a ray's origin. It
    is 0 outside all bodies, and None if no body absorbs."""
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
    path `came` along one unit direction and continues `onward` along another. It is in the glass
    that it has entered, or in the surroundings of the glass that it has left, otherwise in the same
    body as `before`. None if no body absorbs."""
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
    """A scene prepared for tracing."""

    surfaces: Surfaces
    emitters: Emitters
    bands: int = eqx.field(static=True)


def world_of(scene: Scene) -> World:
    """Prepare a scene for tracing; lengths in m."""
    surfaces, emitters = surfaces_of(scene), emitters_of(scene)
    emissions = [surface.emission for surface in scene.surfaces if surface.emission is not None]
    materials = [surface.material for surface in scene.surfaces]
    return World(surfaces, emitters, band_count(materials, scene.lights, spectra=emissions))
