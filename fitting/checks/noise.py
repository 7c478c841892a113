"""Photon transfer of a simulated camera, pixel by pixel in NumPy, and where fits put the truth."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from jaxvision.errors import InputError

from ..noise.calibration import calibrate
from ..noise.levels import Levels, PhotonTransfer
from .simulations import places_in

PIXELS, FRAMES, FULL_SCALE = 2500, 2, 4095.0
EFFICIENCY, DARK_CURRENT = 0.5, 100.0  # e-/photon, e-/s
NAMES = ("system_gain", "responsivity", "black_level", "read_noise", "dark_current")


@dataclass(frozen=True)
class Camera:
    """What is simulated.

    Attributes:
        gain: DN per electron.
        read_noise: electrons rms.
        black: DN.
        brightest: photons per pixel of the brightest level.
        light_sd: relative error of each level's light.
        prnu: relative error of each pixel's gain.
        levels: of light, and darks.
    """

    gain: float = 0.25
    read_noise: float = 6.0
    black: float = 64.0
    brightest: float = 20_000.0
    light_sd: float = 0.0
    prnu: float = 0.0
    levels: int = 10


CASES = {
    "clean": Camera(),
    "lights off by .3 %": Camera(light_sd=0.003),
    "lights off by 1 %": Camera(light_sd=0.01),
    "PRNU 1 %": Camera(prnu=0.01),
    "clipped": Camera(brightest=40_000.0),
    "coarse read noise": Camera(read_noise=60.0),
    "5 levels": Camera(levels=5),
    "5 levels off by 1 %": Camera(levels=5, light_sd=0.01),
    "24 levels off by 1 %": Camera(levels=24, light_sd=0.01),
    "fine read noise": Camera(gain=0.05, read_noise=3.0),
    "black clipped": Camera(gain=0.5, read_noise=4.0, black=0.5, brightest=60.0),
}


def places(camera: Camera, seed: int) -> np.ndarray:
    """Where one fit puts the truth.

    Args:
        camera: to simulate.
        seed: of its frames.

    Returns:
        (parameters,) cumulative probabilities of `NAMES`.

    Raises:
        InputError: where the fit has no maximum.
    """
    posterior = calibrate(measured(camera, seed)).posterior
    true = (camera.gain, camera.gain * EFFICIENCY, camera.black, camera.read_noise, DARK_CURRENT)
    truth: dict[str, float] = dict(zip(NAMES, true, strict=True))
    found = places_in(posterior, truth)
    if len(found) < len(NAMES):
        raise InputError("the fit has fewer parameters than the camera.")
    return np.array([found[name] for name in NAMES])


def measured(camera: Camera, seed: int) -> PhotonTransfer:
    """Flats and darks of one camera: Poisson electrons, read noise, rounding and clipping.

    Args:
        camera: to simulate.
        seed: of every draw.

    Returns:
        Their statistics.
    """
    rng = np.random.default_rng(seed)
    photons = np.linspace(0.01, 1, camera.levels) * camera.brightest
    exposure = np.linspace(0.001, 0.02, camera.levels)
    lights = photons * (1 + camera.light_sd * rng.standard_normal(camera.levels))
    own = 1 + camera.prnu * rng.standard_normal(PIXELS)
    own /= own.mean()  # a camera's responsivity is the mean of its pixels'

    def levels(given: np.ndarray, stated: np.ndarray) -> Levels:
        rate = EFFICIENCY * given[:, None] * own + DARK_CURRENT * exposure[:, None]
        electrons = rng.poisson(rate[:, None], (camera.levels, FRAMES, PIXELS))
        noisy = electrons + camera.read_noise * rng.standard_normal(electrons.shape)
        dn = np.clip(np.round(camera.black + camera.gain * noisy), 0, FULL_SCALE)
        return Levels(
            light=jnp.asarray(stated),
            exposure=jnp.asarray(exposure),
            mean=jnp.asarray(dn.mean(axis=(1, 2))),
            variance=jnp.asarray(dn.var(axis=1, ddof=1).mean(axis=1)),
            frames=jnp.full(camera.levels, float(FRAMES)),
            pixels=jnp.asarray(float(PIXELS)),
        )

    return PhotonTransfer(
        bright=levels(lights, photons),
        dark=levels(0 * photons, 0 * photons),
        dark_of=jnp.arange(camera.levels),
        light_step=jnp.asarray(0.0),
        full_scale=FULL_SCALE,
    )
