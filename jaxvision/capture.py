"""The one composition, read downward: scene -> radiance -> irradiance -> raw -> picture.

Radiance in W m^-2 sr^-1, irradiance in W m^-2, raw data in DN, pictures relative to white.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from ._types import Colour, Image, Key, group_by_structure, take
from .develop import develop
from .geometry import Ray, hit_shape, nearest_shape
from .optics import camera_ray, pixel_grid, sensor_irradiance
from .scene import Camera, Scene, View
from .sensor import raw_image
from .shading import outgoing_radiance


class Capture(eqx.Module):
    """Every stage of one picture, each (h, w, bands).

    `radiance`: W m^-2 sr^-1 seen by each pixel. `irradiance`: W m^-2 on the sensor. `raw`: DN.
    `picture`: developed, or None for a camera without development.
    """

    radiance: Image
    irradiance: Image
    raw: Image
    picture: Image | None


def radiance_along(scene: Scene, ray: Ray) -> Colour:
    """Radiance that arrives along one ray, against its direction: (bands,) in W m^-2 sr^-1; black
    where the ray meets nothing. Materials of one kind are shaded by one piece of code."""
    shapes = [surface.shape for surface in scene.surfaces]
    index = nearest_shape(ray, shapes)
    hit = hit_shape(ray, shapes, index)
    point = ray.origin + jnp.where(index >= 0, hit.distance, 0) * ray.direction
    radiance = jnp.zeros_like(scene.surfaces[0].material.diffuse)
    for members, group in group_by_structure([surface.material for surface in scene.surfaces]):
        material, among = take(members, group, index)
        shaded = outgoing_radiance(
            material, scene.lights, point, hit.normal, -ray.direction, ambient=scene.ambient
        )
        radiance = jnp.where(among, shaded, radiance)
    return radiance


def render(scene: Scene, view: View) -> Image:
    """The picture in radiance, one ray through each pixel's centre: (h, w, bands) in
    W m^-2 sr^-1."""

    def pixel(row, column):
        return radiance_along(scene, camera_ray(view, row, column))

    rows, columns = pixel_grid(view)
    return jax.vmap(lambda row: jax.vmap(lambda column: pixel(row, column))(columns))(rows)


def capture(
    key: Key | None, scene: Scene, camera: Camera, *, die_key: Key | None = None
) -> Capture:
    """One picture of the scene, with every stage on the way.

    `key` draws what changes from frame to frame, `die_key` what stays with this camera (DSNU,
    PRNU); either may be None where the sensor has nothing to draw from it, else `ValueError`.
    """
    radiance = render(scene, camera.view)
    irradiance = sensor_irradiance(camera.view, radiance)
    raw = raw_image(key, camera.sensor, irradiance, die_key=die_key)
    picture = None if camera.development is None else develop(raw, camera.development)
    return Capture(radiance, irradiance, raw, picture)
