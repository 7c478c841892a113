"""Flats and darks of a camera, simulated pixel by pixel in NumPy, for the coverage of fits to
photon transfer."""

from dataclasses import dataclass

import numpy as np

from jaxvision.errors import InputError

from ..noise.calibration import calibrate
from ..noise.from_memory import from_frames
from ..noise.levels import PhotonTransfer
from ..rig import Camera as BitDepth
from .simulations import places_in

SHAPE, FRAMES = (50, 50), 2
EFFICIENCY, DARK_CURRENT = 0.5, 100.0  # e-/photon, e-/s
NAMES = ("system_gain", "responsivity", "black_level", "read_noise", "dark_current")


@dataclass(frozen=True)
class Camera:
    """A simulated camera.

    Attributes:
        gain: DN per electron.
        read_noise: electrons rms.
        black: black level, DN.
        brightest: photons per pixel of the brightest level.
        light_sd: relative error of each level's light.
        prnu: relative error of each pixel's gain.
        levels: number of light levels, each with a dark level.
        bits: of the codes.
        row_noise: noise that the pixels of a row share, new in every frame, electrons rms.
        banding: fixed differences between columns, electrons rms.
        drift: variation of the black level between frames, DN rms.
    """

    gain: float = 0.25
    read_noise: float = 6.0
    black: float = 64.0
    brightest: float = 20_000.0
    light_sd: float = 0.0
    prnu: float = 0.0
    levels: int = 10
    bits: int = 12
    row_noise: float = 0.0
    banding: float = 0.0
    drift: float = 0.0

    @property
    def truth(self) -> dict[str, float]:
        """True values of the fitted parameters by name. The read noise includes the row noise."""
        read = float(np.hypot(self.read_noise, self.row_noise))
        values = (self.gain, self.gain * EFFICIENCY, self.black, read, DARK_CURRENT)
        return dict(zip(NAMES, values, strict=True))


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
    "black clipped": Camera(gain=0.5, read_noise=4.0, black=0.5, brightest=60.0, bits=8),
    "rows that share noise": Camera(row_noise=7.5),
    "columns that differ": Camera(banding=7.5),
    "frames that drift": Camera(drift=2.0),
}


def places(camera: Camera, seed: int) -> np.ndarray:
    """Simulate and fit once. Return the cumulative probability of each true value."""
    posterior = calibrate(measured(camera, seed)).posterior
    found = places_in(posterior, camera.truth)
    if len(found) < len(NAMES):
        raise InputError("the fit has fewer parameters than the camera.")
    return np.array([found[name] for name in NAMES])


def measured(camera: Camera, seed: int) -> PhotonTransfer:
    """Simulate one camera's flats and darks, with all its noise. Return statistics."""
    rng = np.random.default_rng(seed)
    photons = np.linspace(0.01, 1, camera.levels) * camera.brightest
    exposures = np.linspace(0.001, 0.02, camera.levels)
    lights = photons * (1 + camera.light_sd * rng.standard_normal(camera.levels))
    own = 1 + camera.prnu * rng.standard_normal(SHAPE)
    own /= own.mean()  # the camera's responsivity is the mean over pixels
    banding = camera.banding * rng.standard_normal(SHAPE[1])
    banding -= banding.mean()  # and the black level is the mean over columns

    def frames(light: float, exposure: float) -> np.ndarray:
        rate = EFFICIENCY * light * own + DARK_CURRENT * exposure
        electrons = rng.poisson(rate, (FRAMES, *SHAPE))
        read = camera.read_noise * rng.standard_normal(electrons.shape)
        rows = camera.row_noise * rng.standard_normal((FRAMES, SHAPE[0], 1))
        drift = camera.drift * rng.standard_normal((FRAMES, 1, 1))
        dn = camera.black + drift + camera.gain * (electrons + read + rows + banding)
        return np.clip(np.round(dn), 0, 2.0**camera.bits - 1)

    return from_frames(
        [list(frames(light, t)) for light, t in zip(lights, exposures, strict=True)],
        [list(frames(0.0, t)) for t in exposures],
        list(exposures),
        list(photons),
        camera=BitDepth(bits=camera.bits),
    )
