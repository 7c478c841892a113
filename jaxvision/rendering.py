"""Scene and view -> radiance: what each ray of a camera sees by direct light.

Radiance in W m^-2 sr^-1, lengths in m.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.ad_checkpoint import checkpoint_name
from jaxtyping import Array, Bool, Float, Int

from ._bands import FEW, apart
from ._groups import group_by_structure, take
from ._numerics import dot
from ._staging import in_tiles, reordered, stored, together
from ._types import Colour, Image, Key, Scalar
from ._vector import Vec, where
from .geometry import Hit, Ray, Sorted, hit_shape, nearest_shape, sorted_shapes
from .lights import Balanced, LightFieldLight, Rule, Window, can_be_seen, nearest_seen, rule_for
from .lights.light_field import light_field_ray
from .optics import pixel_grid, view_ray
from .scene import Scene, TriangleMesh, View
from .shading import Angles, light_angles, outgoing_radiance
from .shadows import DEFAULT_RULE, TRACED, Leaving, visibility

# Rays at once: cores share each loop over a tile, which must be long beside the start of a task.
_TILE = 65536
_LARGEST = 256  # numbers in an array of a material that are gathered by each pixel
_BLOCK = 256  # pixels of one surface that are shaded together: a material is read once for them
_BLOCKS = 2048  # blocks at once of baked angles: what a gradient keeps of them is no more than they


def radiance_along(
    scene: Scene, ray: Ray, *, rule: Rule = DEFAULT_RULE, shadows: bool = True
) -> Colour:
    """Radiance that arrives along one ray, against its direction: (bands,) in W m^-2 sr^-1.

    The nearest surface or extended light is seen; a ray that meets neither sees the environments,
    or black. A surface shows what it emits and what it reflects of the lights; what surfaces emit
    lights no other surface here, see `transport`. `rule`: how finely extended lights are taken
    apart where they light a surface. `shadows`: static; without them nothing is traced of them,
    nor is it for one shape that cannot shade itself. Materials of one kind are shaded by one piece
    of code.
    """
    return _along(scene, _shapes_of(scene), ray, rule, shadows)


def _shapes_of(scene: Scene) -> Sorted:
    return sorted_shapes([surface.shape for surface in scene.surfaces])


def _along(scene: Scene, shapes: Sorted, ray: Ray, rule: Rule, shadows: bool) -> Colour:
    """`radiance_along` one of many rays, for which the shapes have been sorted."""
    encounter = checkpoint_name(nearest_shape(ray, shapes), TRACED)
    hit = together(hit_shape(ray, shapes, encounter))
    normal, leaving = _facing(scene, ray, encounter.shape, hit)
    radiance = jnp.zeros((), ray.origin.x.dtype)
    materials = [surface.material for surface in scene.surfaces]
    for members, group in group_by_structure(materials, largest=_LARGEST):
        material, among = take(members, group, encounter.shape)
        shaded = outgoing_radiance(
            material,
            scene.lights,
            hit.point,
            normal,
            -ray.direction,
            ambient=scene.ambient,
            rule=rule,
            occluders=shapes if shadows and _can_shade(scene) else None,
            leaving=leaving,
        )
        radiance = jnp.where(among, shaded, radiance)
    emissions = [surface.emission for surface in scene.surfaces]
    if any(emission is not None for emission in emissions):
        emitted = _of_surface(emissions, encounter.shape)
        radiance = radiance + jnp.where(dot(leaving.normal, ray.direction) < 0, emitted, 0)
    if not any(can_be_seen(light) for light in scene.lights):
        return radiance
    light = nearest_seen(scene.lights, ray)
    missed = encounter.shape < 0
    return jnp.where((light.distance < hit.distance) | missed, light.radiance, radiance)


def _can_shade(scene: Scene) -> bool:
    """Whether light can be blocked at all: a shape without dents, alone, shades only its back."""
    first = scene.surfaces[0]
    return len(scene.surfaces) > 1 or first.two_sided or isinstance(first.shape, TriangleMesh)


def _facing(scene: Scene, ray: Ray, index: Int[Array, ""], hit: Hit) -> tuple[Vec, Leaving]:
    """The normal that shades, and how shadow rays leave: turned to the viewer where both sides of
    the surface are fronts."""
    smooth, sides = hit.shading_normal or hit.normal, [s.two_sided for s in scene.surfaces]
    if not any(sides):
        return smooth, Leaving(hit.normal, hit.size)
    turned = jnp.asarray(sides)[jnp.maximum(index, 0)] & (dot(hit.normal, ray.direction) > 0)
    normal = where(turned, -hit.normal, hit.normal)
    return where(turned, -smooth, smooth), Leaving(normal, hit.size)


def _of_surface(emissions: list[Colour | None], index: Int[Array, ""]) -> Colour:
    """The emission of the surface of that index, 0 where there is none, W m^-2 sr^-1."""
    known = next(emission for emission in emissions if emission is not None)
    table = jnp.stack([jnp.zeros_like(known) if e is None else e for e in emissions])
    return jnp.where(index >= 0, table[jnp.maximum(index, 0)], 0)


class PixelSamples(eqx.Module):
    """Rays a pixel, spread at random over its square and over the lens of a thin-lens view.

    `key`: random key. `count`: static, >= 1.
    """

    key: Key
    count: int = eqx.field(static=True)

    def __check_init__(self) -> None:
        if self.count < 1:
            raise ValueError(f"PixelSamples.count must be at least 1, got {self.count}.")


def sample_ray(
    samples: PixelSamples,
    view: View,
    row: Scalar,
    column: Scalar,
    number: Int[Array, ""],
    sample: Int[Array, ""],
) -> Ray:
    """The ray of one of the samples, by its number, of the pixel at `row` and `column`, (), that
    counts as `number`; lengths in m."""
    key = jax.random.fold_in(jax.random.fold_in(samples.key, number), sample)
    u = jax.random.uniform(key, (4,), view.pixel_pitch.dtype)
    return view_ray(view, row + u[0] - 0.5, column + u[1] - 0.5, u=u[2:])


def render(
    scene: Scene,
    view: View,
    *,
    rule: Rule = DEFAULT_RULE,
    shadows: bool = True,
    samples: PixelSamples | None = None,
) -> Image:
    """The picture in radiance by direct light, (h, w, bands) in W m^-2 sr^-1: what surfaces emit
    is seen, and lights nothing here; in `transport` it does.

    `rule`: how finely extended lights are taken apart; `MonteCarlo` draws for each pixel anew.
    `shadows`: static, as in `radiance_along`. `samples`: the mean over many rays of each pixel,
    which a thin lens needs to defocus, or None: one ray through each pixel's centre.

    On CPUs of 512-bit vectors, `jax.jit(render, compiler_options={"xla_cpu_prefer_vector_width":
    "512"})` takes about three quarters of the time.
    """
    rows, columns = pixel_grid(view)
    height, width = view.resolution
    shapes = _shapes_of(scene)

    def centre(row, column, number):
        return _along(scene, shapes, view_ray(view, row, column), rule_for(rule, number), shadows)

    def mean(samples, row, column, number):
        def one(sample):
            ray = sample_ray(samples, view, row, column, number, sample)
            own = rule_for(rule, number * samples.count + sample)
            return _along(scene, shapes, ray, own, shadows)

        return jax.lax.map(one, jnp.arange(samples.count)).mean(axis=0)

    pixel = centre if samples is None else partial(mean, samples)

    def line(row, numbers):
        return jax.vmap(pixel, in_axes=(None, 0, 0))(row, columns, numbers)

    numbers = jnp.arange(height * width).reshape(height, width)
    keep = (TRACED,) if samples is None else ()  # of one ray a pixel: of many it would be much
    return in_tiles(line, rows, numbers, size=max(_TILE // width, 1), keep=keep)


class Baked(eqx.Module):
    """What the rays of a view meet, sorted by surface into blocks of pixels of one surface each.

    `pixels`: (blocks, block) their numbers, one past the last where a block is not full.
    `places`: where in them a pixel is, one past the last for one that sees no surface.
    `surface`: (blocks,). `point`: m. `normal`: unit, that shades. `facing`: unit, of the surface
    itself, to the front. `wo`: unit; (blocks, block) each. `blocked`: which nodes of each light
    do not come through, see `shadows.visibility`, or None: none. `angles`: for each of the static
    `kinds` of material what `shading.light_angles` gives of each light, (blocks, block) in its
    arrays; a kind that is not there is shaded by the directions. `background`: (pixels, bands)
    W m^-2 sr^-1 of what is seen that is no surface, 0 elsewhere. `rule`: how extended lights were
    taken apart. `resolution`: static.
    """

    pixels: Int[Array, "blocks block"]
    places: Int[Array, " pixels"]
    surface: Int[Array, " blocks"]
    point: Vec
    normal: Vec
    facing: Vec
    wo: Vec
    blocked: tuple[Bool[Array, "blocks block _"], ...] | None
    angles: tuple[Angles | None, ...]
    background: Float[Array, "pixels bands"]
    rule: Rule
    kinds: tuple[type, ...] = eqx.field(static=True)
    resolution: tuple[int, int] = eqx.field(static=True)


def bake(scene: Scene, view: View, *, rule: Rule = DEFAULT_RULE, shadows: bool = True) -> Baked:
    """Traces all rays of a view once, so that `shade_baked` renders other materials and other
    brightness without tracing any, for fits of reflectance; lengths in m. Eager: the number of
    pixels of each surface becomes a shape.

    `rule`, `shadows`: as in `render`, but for `Balanced`, whose rays follow the material:
    `ValueError`.
    """
    if isinstance(rule, Balanced):
        raise ValueError("bake needs rays that follow no material, got the rule Balanced.")
    height, width = view.resolution
    numbers = jnp.arange(height * width)

    def pixel(scene: Scene, view: View, shapes: Sorted, number: Int[Array, ""]) -> tuple:
        dtype = view.pixel_pitch.dtype
        ray = view_ray(view, (number // width).astype(dtype), (number % width).astype(dtype))
        encounter = nearest_shape(ray, shapes)
        hit = hit_shape(ray, shapes, encounter)
        normal, leaving = _facing(scene, ray, encounter.shape, hit)
        light = nearest_seen(scene.lights, ray)
        light_first = (light.distance < hit.distance) | (encounter.shape < 0)
        seen = jnp.where(light_first, jnp.atleast_1d(light.radiance), 0)
        surface = jnp.where(light_first, -1, encounter.shape)
        blocked = visible = None
        if shadows and _can_shade(scene):
            own = rule_for(rule, number)
            visible = visibility(scene.lights, hit.point, shapes, leaving, rule=own)
            blocked = jax.tree.map(jnp.logical_not, visible)
        wo = -ray.direction
        one_of_each = {type(own.material): own.material for own in scene.surfaces}.values()
        angles = tuple(
            light_angles(one, scene.lights, hit.point, normal, wo, visible=visible)
            for one in one_of_each
        )
        return surface, seen, (hit.point, normal, leaving.normal, wo, blocked, angles)

    @jax.jit
    def trace(scene: Scene, view: View) -> tuple:
        return in_tiles(partial(pixel, scene, view, _shapes_of(scene)), numbers, size=_TILE)

    surface, background, met = trace(scene, view)
    pixels, of_block = _blocks_of(np.asarray(surface))
    inside = np.minimum(pixels, height * width - 1)
    places = np.full(height * width + 1, pixels.size)
    places[pixels.reshape(-1)] = np.arange(pixels.size)
    point, normal, facing, wo, blocked, angles = jax.tree.map(lambda x: x[inside], met)
    return Baked(
        jnp.asarray(pixels),
        jnp.asarray(places[:-1]),
        jnp.asarray(of_block),
        point,
        normal,
        facing,
        wo,
        blocked,
        angles,
        background,
        rule,
        tuple(dict.fromkeys(type(surface.material) for surface in scene.surfaces)),
        (height, width),
    )


def _blocks_of(surface: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """((blocks, block) numbers of the pixels, (blocks,) their surface): pixels that see a surface,
    surface by surface, the last block of each filled up with the number of pixels. Where none sees
    one, a block of filling. Further such blocks make the tiles of `shade_baked` equally long."""
    pixels, of_block = [], []
    seen = np.unique(surface[surface >= 0])
    for index in seen if len(seen) else [0]:
        mine = np.flatnonzero(surface == index)
        count = max(-(-len(mine) // _BLOCK), 1)
        filled = np.full(count * _BLOCK, len(surface))
        filled[: len(mine)] = mine
        pixels.append(filled.reshape(count, _BLOCK))
        of_block += [index] * count
    short = -len(of_block) % _tiles(len(of_block))
    pixels.append(np.full((short, _BLOCK), len(surface)))
    return np.concatenate(pixels), np.asarray(of_block + of_block[-1:] * short, int)


def _tiles(blocks: int) -> int:
    """In how many parts so many blocks are shaded."""
    return -(-blocks // _BLOCKS)


def shade_baked(baked: Baked, scene: Scene) -> Image:
    """What `render` gives, (h, w, bands) in W m^-2 sr^-1, of the scene that was baked with other
    materials, emissions or brightness of its lights; as many surfaces and lights as then."""
    materials = [surface.material for surface in scene.surfaces]
    groups = group_by_structure(materials, largest=_LARGEST)
    emissions = [surface.emission for surface in scene.surfaces]

    def block(pixels, surface, point, normal, facing, wo, blocked, angles) -> Array:
        if size < blocks:  # a slice is stored, or each loop that reads it would slice again
            point = together(point)
        visible = jax.tree.map(jnp.logical_not, blocked)
        radiance = jnp.zeros((), point.x.dtype)
        for members, group in groups:
            material, among = stored(partial(take, members), group, surface)
            kind = type(materials[members[0]])
            of_kind = angles[baked.kinds.index(kind)] if kind in baked.kinds else None

            def pixel(number, point, normal, wo, visible, material, angles) -> Colour:
                return outgoing_radiance(
                    material,
                    scene.lights,
                    point,
                    normal,
                    wo,
                    ambient=scene.ambient,
                    rule=rule_for(baked.rule, number),
                    visible=visible,
                    angles=angles,
                )

            of_each = jax.tree.map(partial(_for_each, len(pixels)), material)
            shaded = jax.vmap(pixel)(pixels, point, normal, wo, visible, of_each, of_kind)
            radiance = jnp.where(among, shaded, radiance)
        if any(emission is not None for emission in emissions):
            emitted = _of_surface(emissions, surface)
            radiance = radiance + jnp.where((dot(facing, wo) > 0)[:, None], emitted[None], 0)
        return radiance

    known = dict(zip(baked.kinds, baked.angles, strict=True))
    of_all = [known.get(type(material)) for material in materials]
    blocks = len(baked.surface)
    parted = all(angles is not None and None not in angles for angles in of_all)
    size = blocks // _tiles(blocks) if parted else _TILE // _BLOCK
    sorted_radiance = in_tiles(
        block,
        baked.pixels,
        baked.surface,
        baked.point,
        baked.normal,
        baked.facing,
        baked.wo,
        baked.blocked,
        baked.angles,
        size=size,
    )
    bands = sorted_radiance.shape[-1]
    sorted_radiance = sorted_radiance.reshape(baked.pixels.size, bands)
    image = reordered(sorted_radiance, baked.places, baked.pixels.reshape(-1))
    return (image + baked.background).reshape(*baked.resolution, bands)


def _for_each(count: int, leaf: Array) -> Array:
    """The array once for each of many rays; a short one number by number, so that each number's
    cotangents are summed up alone, not side by side with those of others."""
    if leaf.ndim != 1 or leaf.size > FEW:
        return jnp.broadcast_to(leaf, (count, *leaf.shape))
    return jnp.stack([jnp.broadcast_to(x, (count,)) for x in apart(leaf, leaf.size)], axis=-1)


def render_light_field(
    scene: Scene,
    aperture: Window,
    focal: Window,
    *,
    resolution: tuple[int, int, int, int],
    rule: Rule = DEFAULT_RULE,
    shadows: bool = True,
) -> LightFieldLight:
    """What leaves a scene through a window, recorded: radiance in W m^-2 sr^-1 along each line
    from a place of the aperture to one of the parallel focal window, corners in m.

    The scene is what lies behind the aperture. `resolution`: samples (s, t, u, v), the outermost
    on the windows' rims; one sample of an axis lies at its start.
    """
    shapes = _shapes_of(scene)
    axes = [jnp.linspace(0, 1, count, dtype=aperture.corner.dtype) for count in resolution]
    places = jnp.stack(jnp.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 4)

    def sample(place, number):
        ray = light_field_ray(aperture, focal, place)
        return _along(scene, shapes, ray, rule_for(rule, number), shadows)

    radiance = in_tiles(sample, places, jnp.arange(len(places)), size=_TILE)
    return LightFieldLight(radiance.reshape(*resolution, -1), aperture, focal)
