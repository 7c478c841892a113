"""Photographs of a glossy sphere by an uncalibrated camera, simulated in NumPy, for the coverage of
joint fits of surface, encoding and sensor."""

from dataclasses import dataclass, field

import numpy as np

from jaxvision.errors import InputError

from ..joint.calibration import calibrate
from ..reflectance.from_images.read import Photographs
from ..rig import Camera
from .reflectance import BITS, GAIN, Sphere, electrons
from .simulations import places_in

NAMES = ("diffuse", "specular", "exponent", "gamma", "system_gain", "read_noise")
BLACK, BLACK_SD = 64.0, 0.5  # DN: black level, and its standard deviation in the rig


@dataclass(frozen=True)
class Lab:
    """A simulated laboratory: a glossy sphere, its lights and an uncalibrated camera."""

    # the sphere with its lights. The fit knows the standard deviations of the errors of the lights.
    sphere: Sphere = field(default_factory=Sphere)
    # gamma of the camera's encoding. For 1 the camera is linear, and the fit treats gamma as known.
    gamma: float = 2.2

    @property
    def truth(self) -> dict[str, float]:
        values = (*self.sphere.truth, self.gamma, GAIN, self.sphere.read_noise)
        return dict(zip(NAMES, values, strict=True))


CASES = {
    "exact lights": Lab(),
    "linear camera": Lab(Sphere(light_sd=0.01), gamma=1.0),
    "4 lights off by 1 %": Lab(Sphere(lights=4, light_sd=0.01)),
    "6 lights off by 1 %": Lab(Sphere(lights=6, light_sd=0.01)),
    "12 lights off by 1 %": Lab(Sphere(light_sd=0.01)),
    "24 lights off by 1 %": Lab(Sphere(lights=24, light_sd=0.01)),
    "12 lights off by 1 degree": Lab(Sphere(direction_sd=np.radians(1.0))),
    "12 lights off by 1 %, PRNU 1 %": Lab(Sphere(light_sd=0.01, prnu=0.01)),
}


def photographed(lab: Lab, seed: int) -> Photographs:
    """Simulate the photographs of one seed, as the input of a joint fit."""
    rng = np.random.default_rng(seed)
    sphere, full = lab.sphere, 2.0**BITS - 1 - BLACK
    linear = np.maximum(GAIN * electrons(sphere, rng), 0)
    black = BLACK + BLACK_SD * rng.standard_normal()
    encoded = black + full * (linear / full) ** (1 / lab.gamma)
    return sphere.read(
        np.clip(np.round(encoded), 0, 2.0**BITS - 1),
        Camera(bits=BITS, black_level=BLACK, black_sd=BLACK_SD, prnu_sd=sphere.prnu),
        intensity_sd=sphere.light_sd or None,
        direction_sd=sphere.direction_sd or None,
    )


def places(lab: Lab, seed: int) -> np.ndarray:
    """Simulate and fit once. Return the cumulative probability of each true value."""
    found = calibrate(photographed(lab, seed), fit_gamma=lab.gamma != 1, seed=seed)
    if not found.posteriors:
        raise InputError("the data leave a parameter open.")
    (posterior,) = found.posteriors.values()
    known = places_in(posterior, lab.truth)
    return np.array([known.get(name, np.nan) for name in NAMES])
