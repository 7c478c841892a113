"""Simulate measurements in a lab as image files: flats and darks at several exposures, an exposure
stack, and a sphere under many lights. Each set of images is in a folder with its `rig.toml`. The
calibrations see only the files.

One camera takes all images. Its 12-bit sensor resembles CMOS and has a fixed-pattern noise that is
the same in every image. The exposure stack is stored as 8-bit gamma-encoded colour pictures, the
rest as raw numbers.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import tomli_w

from jaxvision.brdf.lambert import Lambert
from jaxvision.brdf.phong import Phong
from jaxvision.core.side_by_side import side_by_side
from jaxvision.development import to_integers
from jaxvision.files.images import replaced_on_success, write_image
from jaxvision.lights import DirectionalLight, PointLight
from jaxvision.optics import look_at
from jaxvision.rendering import PixelSamples
from jaxvision.scene import (
    AmbientLight,
    Camera,
    Development,
    FastPoissonShotNoise,
    Gamma,
    Orthographic,
    Pinhole,
    Plane,
    Scene,
    Sensor,
    Sphere,
    Surface,
)
from jaxvision.sensor import raw_image
from jaxvision.shot import capture

from ..inference.emcee_run import Progress
from ..rig import RIG_FILE

FLAT_SIZE, STACK_SIZE, SPHERE_SIZE = (240, 320), (96, 128), (128, 128)
FLAT_EXPOSURES = np.round(np.linspace(5e-4, 2.45e-2, 25), 6)  # 1.08 times saturation at the end
STACK_EXPOSURES = tuple(float(2.0**stop) for stop in range(-11, -2))
SPATIAL_FRAMES = 16
RAYS = 64  # rays per pixel of the sphere, averaged over the pixel's area
RED_GREEN_BLUE = ("red", "green", "blue")


@dataclass(frozen=True)
class Truth:
    """The true values of the simulated lab.

    Attributes:
        system_gain: DN per electron.
        quantum_efficiency: electrons per photon.
        read_noise: e- rms.
        dark_current: e- s^-1.
        dsnu: e- rms over the pixels.
        prnu: relative, rms over the pixels.
        full_well: e-.
        offset: DN.
        bits: bits of the ADC.
        gamma: encoding exponent of the exposure stack.
        diffuse: k_d of the sphere, red, green, blue.
        specular: k_s of the sphere.
        exponent: exponent of the sphere's Phong lobe.
    """

    system_gain: float = 0.25  # DN per electron
    quantum_efficiency: float = 0.55
    read_noise: float = 6.0  # electrons
    dark_current: float = 150.0  # electrons per second
    dsnu: float = 1.5  # electrons
    prnu: float = 0.008
    full_well: float = 15_000.0  # electrons
    offset: float = 60.0  # DN
    bits: int = 12
    gamma: float = 2.2
    diffuse: tuple[float, float, float] = (0.42, 0.30, 0.18)
    specular: tuple[float, float, float] = (0.45, 0.45, 0.45)
    exponent: float = 40.0


class _Bench(eqx.Module):
    """The sensor of the simulated camera, with the random keys of its fixed pattern and of its
    frames.
    """

    sensor: Sensor
    die_key: jax.Array
    frame_key: jax.Array


@partial(jax.jit, static_argnames="shape")
def _flat_frame(bench: _Bench, photon_rate: jax.Array, frame: jax.Array, *, shape: tuple) -> Any:
    key = jax.random.fold_in(bench.frame_key, frame)
    field = jnp.full(shape, photon_rate)
    return raw_image(key, bench.sensor, field, die_key=bench.die_key)


@partial(jax.jit, static_argnames="rays")
def _picture(
    bench: _Bench, scene: Scene, camera: Camera, frame: jax.Array, *, rays: int | None = None
) -> Any:
    key = jax.random.fold_in(bench.frame_key, frame)
    samples = None if rays is None else PixelSamples(jax.random.fold_in(key, rays), rays)
    return capture(key, scene, camera, die_key=bench.die_key, samples=samples)


def simulate_lab(folder: Path, *, seed: int = 0, progress: Progress | None = None) -> Truth:
    """Simulate the images of the rigs `noise`, `response` and `brdf`, and write each rig to its
    folder.

    Args:
        folder: folder for the three rigs.
        seed: seed of the sensor's fixed pattern and of the noise of every frame.
        progress: called with (images written, all images).

    Returns:
        The true values behind the files.
    """
    truth = Truth()
    bench = _Bench(_sensor(truth), *jax.random.split(jax.random.key(seed)))
    total = 4 * len(FLAT_EXPOSURES) + 2 * (SPATIAL_FRAMES - 2)
    total += len(STACK_EXPOSURES) + len(sphere_lights())
    counted = _Counted(total, progress)
    last = total - len(sphere_lights())
    parts = (
        partial(_photon_transfer, folder / "noise", _Film(0, counted)),
        partial(_exposure_stack, folder / "response", _Film(last - len(STACK_EXPOSURES), counted)),
        partial(_sphere_under_lights, folder / "brdf", _Film(last, counted)),
    )
    side_by_side([partial(part, truth, bench) for part in parts])
    return truth


def sphere_lights(*, count: int = 24) -> np.ndarray:
    """Return `count` light directions (count, 3) on a Fibonacci spiral. They cover all directions
    within 65 degrees of the view direction +z evenly.
    """
    index = np.arange(count) + 0.5
    z = 1 - (1 - np.cos(np.radians(65))) * index / count
    azimuth = np.pi * (1 + 5**0.5) * index
    radius = np.sqrt(1 - z**2)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)


def _sensor(truth: Truth) -> Sensor:
    return Sensor(
        quantum_efficiency=truth.quantum_efficiency,
        exposure_time=1.0,
        prnu=truth.prnu,
        dark_current=truth.dark_current,
        shot_noise=FastPoissonShotNoise(),
        full_well=truth.full_well,
        dsnu=truth.dsnu,
        read_noise=truth.read_noise,
        gain=truth.system_gain,
        offset=truth.offset,
        bits=float(truth.bits),
    )


def _expose(bench: _Bench, exposure: float) -> _Bench:
    sensor = replace(bench.sensor, exposure_time=jnp.asarray(exposure))
    return _Bench(sensor, bench.die_key, bench.frame_key)


class _Counted:
    """A counter that reports how many frames of all parts have been written."""

    def __init__(self, total: int, progress: Progress | None) -> None:
        self.numbers, self.total, self.progress = itertools.count(1), total, progress

    def count(self) -> None:
        done = next(self.numbers)
        if self.progress is not None:
            self.progress(done, self.total)


class _Film:
    """A writer of images that counts its frames from `first`, so that each frame has its own random
    key.
    """

    def __init__(self, first: int, counted: _Counted) -> None:
        self.next, self.counted = first, counted

    def write(self, path: Path, pixels: np.ndarray) -> None:
        write_image(path, pixels)
        self.next += 1
        self.counted.count()


def _photon_transfer(folder: Path, film: _Film, truth: Truth, bench: _Bench) -> None:
    """Write pairs of flats up to and past saturation, and pairs of darks. At half saturation, write
    a deep stack of flats and one of darks for the spatial statistics.
    """
    photons_per_second = 1.08 * truth.full_well / truth.quantum_efficiency / FLAT_EXPOSURES[-1]
    half_full = truth.full_well / truth.quantum_efficiency / 2  # photons per pixel
    half = int(np.argmin(np.abs(FLAT_EXPOSURES * photons_per_second - half_full)))
    flats, darks = [], []
    for i, exposure in enumerate(FLAT_EXPOSURES):
        frames = SPATIAL_FRAMES if i == half else 2
        for kind, rate, entries in (("flat", photons_per_second, flats), ("dark", 0.0, darks)):
            names = [f"{kind}_{i:02d}_{frame:02d}.tif" for frame in range(frames)]
            for name in names:
                raw = _flat_frame(
                    _expose(bench, float(exposure)),
                    jnp.asarray(rate),
                    jnp.asarray(film.next),
                    shape=FLAT_SIZE,
                )
                film.write(folder / name, np.asarray(raw, np.uint16))
            entries.append({"files": names, "exposure": float(exposure)})
        flats[-1]["photons"] = float(photons_per_second * exposure)
    _write_rig(folder, {"camera": {"bits": truth.bits}, "flat": flats, "dark": darks})


def _exposure_stack(folder: Path, film: _Film, truth: Truth, bench: _Bench) -> None:
    """Write an exposure stack of three spheres on a floor as 8-bit gamma-encoded pictures. The
    spheres' brightnesses differ by a few stops.
    """
    floor = Surface(Plane((0.0, -1.0, 0.0), (0.0, 1.0, 0.0)), Lambert((0.25, 0.24, 0.22)))
    balls = [
        Surface(Sphere((x, -0.5, z), 0.5), Phong(colour, (0.3, 0.3, 0.3), 30.0))
        for x, z, colour in (
            (-1.1, 0.0, (0.4, 0.08, 0.05)),
            (0.0, 0.4, (0.1, 0.3, 0.1)),
            (1.1, 0.0, (0.05, 0.1, 0.4)),
        )
    ]
    lights = (
        PointLight((1.5, 3.0, 3.0), (2e8, 2e8, 2e8)),
        PointLight((-3.0, 1.0, 2.0), (2e7,) * 3),
    )
    scene = Scene((floor, *balls), lights, AmbientLight((1e5, 1e5, 1e5)))
    eye, target, up = (jnp.array(v) for v in ((0.0, 0.6, 4.0), (0.0, -0.4, 0.0), (0.0, 1.0, 0.0)))
    view = Pinhole(eye, look_at(eye, target, up), 0.02, 1.1e-4, resolution=STACK_SIZE)
    white = truth.system_gain * truth.full_well + truth.offset
    development = Development(black_level=truth.offset, white_level=white, tone=Gamma(truth.gamma))
    entries = []
    for i, exposure in enumerate(STACK_EXPOSURES):
        camera = Camera(view, _expose(bench, exposure).sensor, development)
        taken = _picture(bench, scene, camera, jnp.asarray(film.next))
        name = f"stack_{i:02d}.png"
        film.write(folder / name, np.asarray(to_integers(taken.picture, bits=8)))
        entries.append({"file": name, "exposure": exposure})
    _write_rig(folder, {"camera": {"bits": 8}, "exposure": entries})


def _sphere_under_lights(folder: Path, film: _Film, truth: Truth, bench: _Bench) -> None:
    """Write one raw image of a Phong sphere for each of many distant lights. In some images the
    highlight is clipped.
    """
    ball = Surface(
        Sphere((0.0, 0.0, 0.0), 1.0), Phong(truth.diffuse, truth.specular, truth.exponent)
    )
    eye = jnp.array((0.0, 0.0, 5.0))
    rotation = look_at(eye, jnp.zeros(3), jnp.array((0.0, 1.0, 0.0)))
    height, width = SPHERE_SIZE
    radius = 0.45 * width
    view = Orthographic(eye, rotation, 1 / radius, resolution=SPHERE_SIZE)
    exposure = 0.01
    per_photon = truth.system_gain * truth.quantum_efficiency * exposure
    white = 1.25 * truth.system_gain * truth.full_well  # DN of a facing k_d of one
    entries = []
    for i, direction in enumerate(sphere_lights()):
        light = DirectionalLight(direction, jnp.full(3, white / per_photon))
        camera = Camera(view, _expose(bench, exposure).sensor)
        scene, frame = Scene((ball,), (light,)), jnp.asarray(film.next)
        taken = _picture(bench, scene, camera, frame, rays=RAYS)
        name = f"light_{i:02d}.tif"
        film.write(folder / name, np.asarray(taken.raw, np.uint16))
        entries.append(
            {
                "file": name,
                "direction": [float(x) for x in direction],
                "intensity": [white] * 3,
                "held_out": i % 4 == 3,
            }
        )
    cap_on = _flat_frame(
        _expose(bench, exposure), jnp.zeros(()), jnp.asarray(film.next), shape=FLAT_SIZE
    )
    camera = {
        "bits": truth.bits,
        "black_level": float(jnp.mean(cap_on)),
        "saturation": truth.system_gain * truth.full_well,
    }
    sphere = {"centre": [(width - 1) / 2, (height - 1) / 2], "radius": radius}
    _write_rig(folder, {"camera": camera, "geometry": {"sphere": sphere}, "light": entries})


def _write_rig(folder: Path, content: dict[str, Any]) -> None:
    with replaced_on_success(folder / RIG_FILE) as partial_file:
        partial_file.write_text(tomli_w.dumps(content), encoding="utf-8")


def rgb(values: Sequence[float]) -> dict[str, float]:
    """Return a dictionary from red, green and blue to three values."""
    return dict(zip(RED_GREEN_BLUE, values, strict=True))
