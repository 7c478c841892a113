"""The one composition, read downward: scene -> radiance -> irradiance -> raw -> picture.

Radiance in W m^-2 sr^-1, irradiance in W m^-2, raw data in DN, pictures relative to white.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from ._staging import TILE, in_tiles, stored
from ._types import Colour, Image, Key, group_by_structure, take
from ._vector import Vec
from .develop import develop
from .geometry import Hit, Ray, hit_shape, nearest_shape
from .lights import LightFieldLight, Rule, Window, can_be_seen, nearest_seen, rule_for
from .lights.light_field import light_field_ray
from .optics import camera_ray, pixel_grid, sensor_irradiance
from .scene import Camera, Scene, Shape, View
from .sensor import raw_image
from .shading import DEFAULT_RULE, outgoing_radiance

_LARGEST = 256  # numbers in an array of a material that are gathered by each pixel


class Capture(eqx.Module):
    """Every stage of one picture, each (h, w, bands).

    `radiance`: W m^-2 sr^-1 seen by each pixel. `irradiance`: W m^-2 on the sensor. `raw`: DN.
    `picture`: developed, or None for a camera without development.
    """

    radiance: Image
    irradiance: Image
    raw: Image
    picture: Image | None


def radiance_along(scene: Scene, ray: Ray, *, rule: Rule = DEFAULT_RULE) -> Colour:
    """Radiance that arrives along one ray, against its direction: (bands,) in W m^-2 sr^-1.

    The nearest surface or extended light is seen; a ray that meets neither sees the environments,
    or black. `rule`: how finely extended lights are taken apart where they light a surface.
    Materials of one kind are shaded by one piece of code.
    """
    shapes = [surface.shape for surface in scene.surfaces]
    index = stored(nearest_shape, ray, shapes)
    hit, point = stored(_meet, ray, shapes, index)
    radiance = jnp.zeros((), ray.origin.x.dtype)
    materials = [surface.material for surface in scene.surfaces]
    for members, group in group_by_structure(materials, largest=_LARGEST):
        material, among = stored(partial(take, members), group, index)
        shaded = outgoing_radiance(
            material,
            scene.lights,
            point,
            hit.normal,
            -ray.direction,
            ambient=scene.ambient,
            rule=rule,
        )
        radiance = jnp.where(among, shaded, radiance)
    if not any(can_be_seen(light) for light in scene.lights):
        return radiance
    light = nearest_seen(scene.lights, ray)
    return jnp.where((light.distance < hit.distance) | (index < 0), light.radiance, radiance)


def _meet(ray: Ray, shapes: list[Shape], index: Int[Array, ""]) -> tuple[Hit, Vec]:
    """The hit of the shape of that index, and its point: the ray's origin where none is met."""
    hit = hit_shape(ray, shapes, index)
    return hit, ray.origin + jnp.where(index >= 0, hit.distance, 0) * ray.direction


def render(scene: Scene, view: View, *, rule: Rule = DEFAULT_RULE) -> Image:
    """The picture in radiance, one ray through each pixel's centre: (h, w, bands) in
    W m^-2 sr^-1. `rule`: how finely extended lights are taken apart; `MonteCarlo` draws for each
    pixel anew."""
    rows, columns = pixel_grid(view)
    height, width = view.resolution

    def pixel(row, column, number):
        return radiance_along(scene, camera_ray(view, row, column), rule=rule_for(rule, number))

    def line(row, numbers):
        return jax.vmap(pixel, in_axes=(None, 0, 0))(row, columns, numbers)

    numbers = jnp.arange(height * width).reshape(height, width)
    return in_tiles(line, rows, numbers, size=max(TILE // width, 1))


def render_light_field(
    scene: Scene,
    aperture: Window,
    focal: Window,
    *,
    resolution: tuple[int, int, int, int],
    rule: Rule = DEFAULT_RULE,
) -> LightFieldLight:
    """What leaves a scene through a window, recorded: radiance in W m^-2 sr^-1 along each line
    from a place of the aperture to one of the parallel focal window, corners in m.

    The scene is what lies behind the aperture. `resolution`: samples (s, t, u, v), the outermost
    on the windows' rims; one sample of an axis lies at its start.
    """
    axes = [jnp.linspace(0, 1, count, dtype=aperture.corner.dtype) for count in resolution]
    places = jnp.stack(jnp.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 4)

    def sample(place, number):
        ray = light_field_ray(aperture, focal, place)
        return radiance_along(scene, ray, rule=rule_for(rule, number))

    radiance = in_tiles(sample, places, jnp.arange(len(places)), size=TILE)
    return LightFieldLight(radiance.reshape(*resolution, -1), aperture, focal)


def capture(
    key: Key | None,
    scene: Scene,
    camera: Camera,
    *,
    die_key: Key | None = None,
    rule: Rule = DEFAULT_RULE,
) -> Capture:
    """One picture of the scene, with every stage on the way.

    `key` draws what changes from frame to frame, `die_key` what stays with this camera (DSNU,
    PRNU); either may be None where the sensor has nothing to draw from it, else `ValueError`.
    `rule`: how finely extended lights are taken apart.
    """
    radiance = render(scene, camera.view, rule=rule)
    irradiance = sensor_irradiance(camera.view, radiance)
    raw = raw_image(key, camera.sensor, irradiance, die_key=die_key)
    picture = None if camera.development is None else develop(raw, camera.development)
    return Capture(radiance, irradiance, raw, picture)
