"""The one composition, read downward: scene -> radiance -> irradiance -> raw -> picture.

Radiance in W m^-2 sr^-1, irradiance in W m^-2, raw data in DN, pictures relative to white.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import equinox as eqx
from jaxtyping import Array, Float

from ._types import Image, Key, Scalar
from .development import develop
from .lights import Rule
from .optics import sensor_irradiance
from .rendering import PixelSamples, render
from .scene import Camera, PixelAperture, Scene, View
from .sensor import exposed, pixel_means, raw_image
from .shading import DEFAULT_RULE

Motion = Callable[[Scene, View, Scalar], tuple[Scene, View]]
Renderer = Callable[[Scene, View], Image]


class Capture(eqx.Module):
    """Every stage of one picture, each (h, w, bands).

    `radiance`: W m^-2 sr^-1 seen by each pixel. `irradiance`: W m^-2 on the sensor. `raw`: DN, (h,
    w, 1) under a colour filter. `picture`: developed, or None for a camera without development.
    """

    radiance: Image
    irradiance: Image
    raw: Float[Array, "*batch h w channels"]
    picture: Float[Array, "*batch h w colours"] | None


def capture(
    key: Key | None,
    scene: Scene,
    camera: Camera,
    *,
    die_key: Key | None = None,
    rule: Rule = DEFAULT_RULE,
    shadows: bool = True,
    samples: PixelSamples | None = None,
    motion: Motion | None = None,
    moments: int = 8,
) -> Capture:
    """One picture of the scene, with every stage on the way.

    `key` draws what changes from frame to frame, `die_key` what stays with this camera; either may
    be None where the sensor has nothing to draw from it, else `ValueError`. `rule`, `shadows`,
    `samples`: of `render`; a thin lens needs samples to defocus. `motion`: the scene and the view
    at a time in s after the first row's exposure began, from what they are at rest; they are looked
    at in so many `moments` (`sensor.exposure_slots` places them) over the sensor's exposure time,
    which must be given.
    """
    renderer = partial(render, rule=rule, shadows=shadows, samples=samples)
    radiance, irradiance = _light_on_sensor(renderer, scene, camera, motion, moments)
    raw = raw_image(key, camera.sensor, irradiance, die_key=die_key)
    picture = None if camera.development is None else develop(raw, camera.development)
    return Capture(radiance, irradiance, raw, picture)


def _light_on_sensor(
    renderer: Renderer, scene: Scene, camera: Camera, motion: Motion | None, moments: int
) -> tuple[Image, Image]:
    """Radiance and irradiance of each pixel, over its aperture and its exposure."""
    sensor = camera.sensor
    if motion is None:
        return _seen(renderer, scene, camera.view, sensor.pixel_aperture)
    if sensor.exposure_time is None:
        raise ValueError("Sensor.exposure_time must be given in seconds for a motion, got None.")

    def seen_at(time: Scalar) -> tuple[Image, Image]:
        return _seen(renderer, *motion(scene, camera.view, time), sensor.pixel_aperture)

    rows, _ = camera.view.resolution
    return exposed(sensor.shutter, sensor.exposure_time, seen_at, rows=rows, slots=moments)


def _seen(
    renderer: Renderer, scene: Scene, view: View, aperture: PixelAperture | None
) -> tuple[Image, Image]:
    """What stands still: radiance and irradiance, sampled as finely as the aperture asks."""
    if aperture is None or aperture.oversampling == 1:
        radiance = renderer(scene, view)
        return radiance, sensor_irradiance(view, radiance)
    n = aperture.oversampling
    rows, columns = view.resolution
    fine = replace(view, resolution=(n * rows, n * columns), pixel_pitch=view.pixel_pitch / n)
    radiance = renderer(scene, fine)
    irradiance = sensor_irradiance(fine, radiance)
    return pixel_means(radiance, aperture), pixel_means(irradiance, aperture)
