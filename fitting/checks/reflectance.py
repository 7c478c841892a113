"""Photographs of a glossy sphere for the coverage of BRDF fits, simulated in NumPy. The signal of a
pixel is the mean over its area."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from jaxvision.errors import InputError

from ..reflectance.from_images.calibration import open_parameters
from ..reflectance.from_images.fit import channel_posterior, fit_channel
from ..reflectance.from_images.read import Photographs, from_photographs
from ..reflectance.from_images.samples import Grouping, Selection, View, cells_of, select
from ..reflectance.from_images.signal import Form
from ..rig import Camera, SphereGeometry
from .simulations import places_in

SIZE, RADIUS, WHITE = 28, 13.0, 3000.0  # pixels, pixels, DN
# of a pixel, along each side
PARTS, WEIGHTS = np.polynomial.legendre.leggauss(5)
GAIN, BITS = 0.25, 12  # DN per electron
NAMES = ("diffuse", "specular", "exponent")
WIDEST = 60.0  # largest angle between lights and view, degrees


@dataclass(frozen=True)
class Sphere:
    """A simulated sphere that follows Phong's shading model exactly.

    Attributes:
        lights: number of lights.
        truth: true k_d, k_s and n of Phong's model.
        light_sd: relative error of each light's intensity.
        direction_sd: error of each light's direction along both perpendicular axes, rad.
        stray_sd: standard deviation of stray light on all pixels, relative to the irradiance. The
            fit knows this standard deviation.
        black_sd: error of the black level, DN, of which the fit knows the standard deviation.
        stated: names of those of `light_sd` and `direction_sd` that the fit knows.
        prnu: relative error of each pixel's gain.
        clip: DN from which pixels saturate.
        read_noise: electrons rms.
        black: black level, DN.
    """

    lights: int = 12
    truth: tuple[float, float, float] = (0.4, 0.45, 40.0)
    light_sd: float = 0.0
    direction_sd: float = 0.0
    stray_sd: float = 0.0
    black_sd: float = 0.0
    stated: tuple[str, ...] = ()
    prnu: float = 0.0
    clip: float = 2.0**BITS - 1
    read_noise: float = 6.0
    black: float = 60.0

    @cached_property
    def signal(self) -> np.ndarray:
        """(lights, h, w) noise-free DN above black, under lights without errors."""
        return self.shaded(directions(self.lights))

    def shaded(self, wi: np.ndarray) -> np.ndarray:
        """Return (lights, h, w) noise-free DN above black, averaged over the area of each pixel,
        for lights in the directions `wi`."""
        across = (np.arange(SIZE)[:, None] + PARTS / 2).ravel() - (SIZE - 1) / 2
        x, y = np.meshgrid(across / RADIUS, -across / RADIUS)
        z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
        normals = np.where((z > 0)[..., None], np.stack([x, y, z], axis=-1), 0)
        diffuse, specular, exponent = self.truth
        cosine = np.einsum("hwc,lc->lhw", normals, wi)
        mirrored = 2 * cosine * normals[..., 2] - wi[:, None, None, 2]
        shaded = diffuse * cosine + specular * np.maximum(mirrored, 0) ** exponent
        parts = np.where(cosine > 0, shaded, 0).reshape(-1, SIZE, len(PARTS), SIZE, len(PARTS))
        return WHITE / 4 * np.einsum("lhiwj,i,j->lhw", parts, WEIGHTS, WEIGHTS)

    def read(self, images: np.ndarray, camera: Camera, **errors: Any) -> Photographs:
        """Return the images as the input of a fit, with the standard deviations `errors` of lights
        and camera."""
        observation = from_photographs(
            list(images),
            directions(self.lights),
            camera=camera,
            sphere=SphereGeometry(centre=((SIZE - 1) / 2, (SIZE - 1) / 2), radius=RADIUS),
            intensities=np.full(self.lights, WHITE),
            **errors,
        )
        return replace(observation, held_out=np.zeros(self.lights, bool))

    @cached_property
    def observed(self) -> tuple[Photographs, Selection, Grouping]:
        """Photographs of seed 0, with their selected samples and cells. Every simulated fit uses
        the samples and cells of these photographs, with new images."""
        camera = Camera(
            bits=BITS,
            black_level=self.black,
            gain=GAIN,
            read_noise=self.read_noise,
            saturation=self.clip,
            black_sd=self.black_sd or None,
        )
        observation = self.read(
            photographs(self, 0),
            camera,
            intensity_sd=self.light_sd * ("light_sd" in self.stated),
            direction_sd=self.direction_sd * ("direction_sd" in self.stated),
            stray_sd=self.stray_sd,
        )
        chosen = select(observation, held_out=False, form=Form("phong"))
        return observation, chosen, cells_of(observation, chosen)


SPHERE = Sphere()

CASES = {
    "clean": SPHERE,
    "lights off by .3 %": Sphere(light_sd=0.003),
    "lights off by 1 %": Sphere(light_sd=0.01),
    "PRNU 1 %": Sphere(prnu=0.01),
    "saturated highlight": Sphere(clip=2000.0),
    "weak highlight": Sphere(truth=(0.4, 0.01, 40.0)),
    "fine read noise": Sphere(read_noise=0.5),
    "coarse read noise": Sphere(read_noise=80.0),
    "black clipped": Sphere(black=0.0, read_noise=80.0),
    "lights off by 1 %, PRNU 1 %": Sphere(light_sd=0.01, prnu=0.01),
    "4 lights": Sphere(lights=4),
    "4 lights off by 1 %": Sphere(lights=4, light_sd=0.01),
    "6 lights off by 1 %": Sphere(lights=6, light_sd=0.01),
    "24 lights": Sphere(lights=24),
    "24 lights off by 1 %": Sphere(lights=24, light_sd=0.01),
    "4 lights off by 1 %, as stated": Sphere(lights=4, light_sd=0.01, stated=("light_sd",)),
    "lights off by 1 %, as stated": Sphere(light_sd=0.01, stated=("light_sd",)),
    "directions off by 0.3 degrees, as stated": Sphere(
        direction_sd=np.radians(0.3), stated=("direction_sd",)
    ),
    "directions off by 1 degree, as stated": Sphere(
        direction_sd=np.radians(1.0), stated=("direction_sd",)
    ),
    "directions off by 1 degree, as stated, lights off by .5 %": Sphere(
        direction_sd=np.radians(1.0), light_sd=0.005, stated=("direction_sd",)
    ),
    "4 lights off by 1 degree and 1 %, as stated": Sphere(
        lights=4, direction_sd=np.radians(1.0), light_sd=0.01, stated=("light_sd", "direction_sd")
    ),
    "black off by 3 DN, as stated": Sphere(black_sd=3.0),
    "stray light of .3 %, as stated": Sphere(stray_sd=0.003),
}


def electrons(sphere: Sphere, rng: np.random.Generator) -> np.ndarray:
    """Simulate the electrons of each pixel: Poisson counts and read noise, with errors of the
    lights and of the pixels' gains."""
    lights = 1 + sphere.light_sd * rng.standard_normal((sphere.lights, 1, 1))
    pixels = 1 + sphere.prnu * rng.standard_normal((SIZE, SIZE))
    signal = sphere.signal
    if sphere.direction_sd:
        wi = directions(sphere.lights)
        step = sphere.direction_sd * rng.standard_normal(wi.shape)
        moved = wi + step - np.sum(step * wi, axis=1, keepdims=True) * wi
        signal = sphere.shaded(moved / np.linalg.norm(moved, axis=1, keepdims=True))
    stray = 0.0
    if sphere.stray_sd:
        stray = WHITE * sphere.stray_sd * rng.standard_normal((sphere.lights, 1, 1))
    counted = rng.poisson(np.maximum((signal * lights + stray) * pixels, 0) / GAIN)
    return counted + sphere.read_noise * rng.standard_normal(counted.shape)


def photographs(sphere: Sphere, seed: int) -> np.ndarray:
    """Simulate photographs in DN, with Poisson electrons, read noise, rounding and clipping."""
    rng = np.random.default_rng(seed)
    noisy = electrons(sphere, rng)
    black = sphere.black + sphere.black_sd * rng.standard_normal()
    return np.clip(np.round(black + GAIN * noisy), 0, sphere.clip)


def places(sphere: Sphere, seed: int) -> np.ndarray:
    """Simulate and fit once. Return the cumulative probability of each true value."""
    observation, chosen, cells = sphere.observed
    dn = photographs(sphere, seed)[None][:, :, observation.rows, observation.columns]
    view = View(replace(observation, dn=dn), 0, chosen)
    found, matt = (fit_channel(view, Form(model), cells) for model in ("phong", "lambert"))
    if found.robustness is None or open_parameters(found, matt):
        raise InputError("the data leave a parameter open.")
    posterior = channel_posterior(found, cells, sampling=None, seed=seed)
    truth: dict[str, float] = dict(zip(NAMES, sphere.truth, strict=True))
    return np.array([places_in(posterior, truth)[name] for name in NAMES])


def directions(lights: int) -> np.ndarray:
    """Return unit vectors towards the lights, within 60 degrees of the view. The directions depend
    on the number of lights alone."""
    rng = np.random.default_rng(0)
    z = rng.uniform(np.cos(np.radians(WIDEST)), 1, lights)
    azimuth = rng.uniform(0, 2 * np.pi, lights)
    radius = np.sqrt(1 - z**2)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)
