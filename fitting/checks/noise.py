"""Photon transfer of a simulated camera, pixel by pixel in NumPy, and where fits put the truth."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from scipy.special import ndtr

from jaxvision.errors import InputError

from ..inference.parameters import names, to_unconstrained
from ..noise.calibration import calibrate
from ..noise.levels import Levels, PhotonTransfer

PIXELS, FRAMES, LEVELS, FULL_SCALE = 2500, 2, 10, 4095.0
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
    """

    gain: float = 0.25
    read_noise: float = 6.0
    black: float = 64.0
    brightest: float = 20_000.0
    light_sd: float = 0.0


CASES = {
    "clean": Camera(),
    "lights off by .3 %": Camera(light_sd=0.003),
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
    space = tuple(p for p in posterior.space if p.name in truth)
    wanted = to_unconstrained(space, jnp.asarray([truth[p.name] for p in space]))
    at = [names(posterior.space).index(p.name) for p in space]
    if len(at) < len(NAMES):
        raise InputError("the fit has fewer parameters than the camera.")
    deviation = np.sqrt(np.diagonal(posterior.covariance)[at])
    return ndtr((np.asarray(wanted) - posterior.unconstrained_mode[at]) / deviation)


def measured(camera: Camera, seed: int) -> PhotonTransfer:
    """Flats and darks of one camera: Poisson electrons, read noise, rounding and clipping.

    Args:
        camera: to simulate.
        seed: of every draw.

    Returns:
        Their statistics.
    """
    rng = np.random.default_rng(seed)
    photons = np.linspace(0.01, 1, LEVELS) * camera.brightest
    exposure = np.linspace(0.001, 0.02, LEVELS)
    lights = photons * (1 + camera.light_sd * rng.standard_normal(LEVELS))

    def levels(given: np.ndarray, stated: np.ndarray) -> Levels:
        rate = EFFICIENCY * given + DARK_CURRENT * exposure
        electrons = rng.poisson(rate[:, None, None], (LEVELS, FRAMES, PIXELS))
        noisy = electrons + camera.read_noise * rng.standard_normal(electrons.shape)
        dn = np.clip(np.round(camera.black + camera.gain * noisy), 0, FULL_SCALE)
        return Levels(
            light=jnp.asarray(stated),
            exposure=jnp.asarray(exposure),
            mean=jnp.asarray(dn.mean(axis=(1, 2))),
            variance=jnp.asarray(dn.var(axis=1, ddof=1).mean(axis=1)),
            frames=jnp.full(LEVELS, float(FRAMES)),
            pixels=jnp.asarray(float(PIXELS)),
        )

    return PhotonTransfer(
        bright=levels(lights, photons),
        dark=levels(0 * photons, 0 * photons),
        dark_of=jnp.arange(LEVELS),
        light_step=jnp.asarray(0.0),
        full_scale=FULL_SCALE,
    )
