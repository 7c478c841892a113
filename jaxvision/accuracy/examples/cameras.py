"""Example problems for cameras: lens, motion, pixel aperture, diffraction and shot noise."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...brdf.lambert import Lambert
from ...lights import PointLight
from ...optics import airy_kernel, layered_defocus, sensor_irradiance
from ...rendering import PixelSamples, render
from ...scene import (
    BrighterFatter,
    Camera,
    Diffraction,
    FastPoissonShotNoise,
    GaussianShotNoise,
    Pinhole,
    PixelAperture,
    Plane,
    PoissonShotNoise,
    Scene,
    Sensor,
    Sphere,
    Surface,
    ThinLens,
    View,
)
from ...sensor import count, gathered
from ...shot import capture
from ..records import Compute, Problem
from . import problem_of
from .pictures import picture

SIDE = 64  # pixels
FOCAL_LENGTH = 0.05  # m
WIDE_PITCH = 4e-4  # m, pixel pitch for a field of 29 degrees: the balls, whose edges are blurred
BLUR_PITCH = 4e-5  # m, pixel pitch at which the blur covers several pixels
_NOISES = {
    "gaussian": GaussianShotNoise,
    "fast": FastPoissonShotNoise,
    "exact": PoissonShotNoise,
}


def _balls() -> Scene:
    """Make a scene of three balls at different depths in front of a wall."""
    places = ((-0.25, 0.0, 1.2), (0.05, 0.05, 1.8), (0.35, -0.1, 2.6))
    colours = ((0.25, 0.1, 0.05), (0.1, 0.2, 0.1), (0.05, 0.1, 0.25))
    balls = [
        Surface(Sphere(place, 0.18), Lambert(colour))
        for place, colour in zip(places, colours, strict=True)
    ]
    wall = Surface(Plane((0, 0, 3.0), (0, 0, -1)), Lambert((0.2, 0.2, 0.2)))
    return Scene([*balls, wall], [PointLight((-1, -1, 0), (9.0, 9.0, 9.0))])


def _lens(pitch: float, f_number: float = 1.4, focus_distance: float = 1.8) -> ThinLens:
    return ThinLens(
        (0, 0, 0),
        np.eye(3),
        FOCAL_LENGTH,
        pitch,
        resolution=(SIDE, SIDE),
        f_number=f_number,
        focus_distance=focus_distance,
    )


def _lens_samples() -> Problem:
    lens, scene = _lens(WIDE_PITCH), _balls()
    return problem_of(
        "three balls out of focus",
        "lens samples",
        lambda count: lambda key: render(scene, lens, samples=PixelSamples(key, count)),
        seeded=True,
    )


def _layers() -> Problem:
    lens = _lens(BLUR_PITCH)
    image = jnp.asarray(picture()[:SIDE, :SIDE])
    depth = jnp.asarray(np.linspace(1.0, 3.0, SIDE)[None, :] * np.ones((SIDE, 1)))
    return problem_of(
        "a ramp of depth out of focus",
        "defocus layers",
        lambda layers: partial(layered_defocus, lens, depth=depth, radius=12, layers=layers),
        image,
    )


def _view() -> Pinhole:
    return Pinhole((0, 0, 0), np.eye(3), FOCAL_LENGTH, WIDE_PITCH, resolution=(SIDE, SIDE))


def _moments() -> Problem:
    scene, camera = _balls(), Camera(_view(), Sensor(exposure_time=0.02))

    def pan(scene: Scene, view: View, time: Any) -> tuple[Scene, View]:
        return scene, replace(view, position=view.position + jnp.asarray([2.0, 0, 0]) * time)

    return problem_of(
        "three balls, panned",
        "motion moments",
        lambda n: lambda scene: capture(None, scene, camera, motion=pan, moments=n).irradiance,
        scene,
    )


def _oversampling() -> Problem:
    def make(oversampling: int) -> Callable[[Scene], jax.Array]:
        sensor = Sensor(pixel_aperture=PixelAperture(1.0, oversampling=oversampling))
        camera = Camera(_view(), sensor)
        return lambda scene: capture(None, scene, camera).irradiance

    return problem_of("three balls, pixels with an area", "oversampling", make, _balls())


def _charge_steps() -> Problem:
    spots = np.full((SIDE, SIDE, 1), 100.0)
    spots[8:40:8, 8:40:8] = 1e5
    light, kernel = jnp.asarray(spots), np.array([[8e-7, 2e-7], [2e-7, 5e-8]])

    def make(steps: int) -> Callable[[jax.Array], jax.Array]:
        effect = BrighterFatter(kernel, steps=steps)
        return lambda light: gathered(None, light, effect)

    return problem_of("spots of 1e5 electrons that repel", "charge steps", make, light)


def _diffraction_size() -> Problem:
    image = np.zeros((SIDE, SIDE, 1))
    image[20:24, 8:40] = 1.0

    def make(size: int) -> Callable[[jax.Array], jax.Array]:
        view = replace(_lens(4e-6, 16.0, 1e3), diffraction=Diffraction(550e-9, size=size))
        return partial(sensor_irradiance, view)

    return problem_of("a slit at f/16", "diffraction size", make, jnp.asarray(image))


def _diffraction_nodes() -> Problem:
    numbers = (jnp.asarray(x) for x in (550e-9, 8.0, 4e-6))
    return problem_of(
        "an Airy pattern over pixels",
        "diffraction nodes",
        lambda order: partial(airy_kernel, size=17, order=order),
        *numbers,
    )


def _shot_noise() -> Problem:
    """Compare 2^18 draws at means of 1 to 100 electrons with Poisson's law."""
    from scipy.stats import poisson

    draws, most = 2**18, 160
    means = np.array([1.0, 3.0, 10.0, 30.0, 100.0])
    exact = poisson.cdf(np.arange(most)[None, :], means[:, None])

    def prepare(settings: Mapping[str, Any]) -> Compute:
        noise = _NOISES[settings["shot noise"]]()

        @jax.jit
        def draw_counts(key: Any) -> jax.Array:
            return count(key, jnp.broadcast_to(jnp.asarray(means)[:, None], (5, draws)), noise)

        def distribution(seed: int) -> np.ndarray:
            whole = np.round(np.asarray(draw_counts(jax.random.key(seed)))).astype(int)
            counts = [np.bincount(np.clip(row, 0, most), minlength=most)[:most] for row in whole]
            return np.cumsum(counts, axis=1) / draws

        return distribution

    return Problem("a law of counts", prepare, exact=exact)


EXAMPLES = {
    "lens samples": _lens_samples,
    "defocus layers": _layers,
    "motion moments": _moments,
    "oversampling": _oversampling,
    "charge steps": _charge_steps,
    "diffraction size": _diffraction_size,
    "diffraction nodes": _diffraction_nodes,
    "shot noise": _shot_noise,
}
