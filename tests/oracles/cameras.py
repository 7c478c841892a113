"""A camera in NumPy: Poisson electrons, Gaussian read noise, gain, rounding, clipping."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class CameraTruth:
    """gain: DN/e-; efficiency: electrons per photon; read_noise: e-; dark_current: e-/s; offset:
    DN; compression: fraction of the signal lost at `top` DN; light_offset: photons; light_scatter:
    relative; black_scatter: DN; dsnu: e-; prnu: relative; full_scale: DN."""

    gain: float = 0.3
    efficiency: float = 0.5
    read_noise: float = 8.0
    dark_current: float = 100.0
    offset: float = 60.0
    compression: float = 0.0
    top: float = 1.0
    light_offset: float = 0.0
    light_scatter: float = 0.0
    black_scatter: float = 0.0
    dsnu: float = 0.0
    prnu: float = 0.0
    full_scale: int = 4095


def expose(rng, camera, photons, exposure, shape, *, die=None):
    """Return digital numbers of `shape` (frames, ...pixels) at `photons` and `exposure` (s)."""
    light = photons
    if photons > 0:
        light = (photons + camera.light_offset) * (1 + camera.light_scatter * rng.normal())
    response, dark = (1.0, 0.0) if die is None else die
    mean = camera.efficiency * light * response + camera.dark_current * exposure
    electrons = rng.poisson(np.broadcast_to(mean, shape)).astype(float)
    x = camera.gain * electrons
    x = x * (1 - camera.compression * x / camera.top)
    black = camera.offset + camera.black_scatter * rng.normal()
    read = camera.gain * (camera.read_noise * rng.standard_normal(shape) + dark)
    return np.clip(np.round(black + x + read), 0, camera.full_scale)


def make_die(rng, camera, pixels):
    """Return (relative response, dark electrons) of each pixel of one die."""
    return 1 + camera.prnu * rng.standard_normal(pixels), camera.dsnu * rng.standard_normal(pixels)


def moments(frames):
    """Return (mean, temporal variance, spatial variance of the pixels' means) of (frames,
    ...pixels)."""
    average = frames.mean(axis=0)
    return frames.mean(), frames.var(axis=0, ddof=1).mean(), average.var(ddof=1)


def sweep(rng, camera, photons, exposures, shape, *, die=None):
    """Return rows of `moments`, (levels, 3), for a sweep of bright levels and one of their
    darks."""
    return tuple(
        np.array(
            [
                moments(expose(rng, camera, light, exposure, shape, die=die))
                for light, exposure in zip(amounts, exposures, strict=True)
            ]
        )
        for amounts in (photons, 0 * photons)
    )
