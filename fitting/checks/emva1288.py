"""Simulated cameras of 48 x 64 pixels for the coverage of the intervals of EMVA 1288, release
4.0."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from ..noise.from_memory import stacks_from_frames
from ..noise.release_4.nonuniformity import Loss, loss_of_filter
from ..noise.release_4.sheet import FILTERED, PARTS, PLAIN, release_4_sheet
from ..rig import Camera as BitDepth

SHAPE, FRAMES, LEVELS = (48, 64), 16, 14
GAIN, EFFICIENCY, READ_NOISE, BLACK, TOP = 0.3, 0.5, 6.0, 64.0, 4095
BRIGHTEST, HALF = 28_000.0, 6  # photons per pixel; index of the level with `FRAMES` frames
FIGURES = ("saturation_photons", "snr_max", "threshold_photons", "dynamic_range")
GENERAL = ("input_snr_max", "threshold_photons", "dynamic_range")
NAMES = (
    *(f"{kind} {part}, {how}" for how in (PLAIN, FILTERED) for kind in ("DSNU", "PRNU")
      for part in PARTS),
    *(f"Linear {name}" for name in FIGURES),
    *(f"General {name}" for name in GENERAL),
)  # fmt: skip


@dataclass(frozen=True)
class Camera:
    """A simulated camera: the standard deviations of the offsets and gains of its rows, columns and
    pixels.

    Attributes:
        offsets: standard deviations of the offsets of rows, columns and pixels, electrons.
        gains: relative standard deviations of the gains of rows, columns and pixels.
        degrees: degrees of freedom of Student's t, from which the pixels' offsets and gains are
            drawn; infinite for a Gaussian.
    """

    offsets: tuple[float, float, float] = (1.5, 2.0, 3.0)
    gains: tuple[float, float, float] = (0.004, 0.006, 0.01)
    degrees: float = np.inf


CASES = {
    "rows, columns and pixels": Camera(),
    "pixels only": Camera(offsets=(0.0, 0.0, 3.0), gains=(0.0, 0.0, 0.01)),
    "columns most": Camera(offsets=(0.5, 5.0, 2.0), gains=(0.001, 0.02, 0.005)),
    "heavy-tailed pixels": Camera(degrees=8.0),
}


def places(camera: Camera, seed: int) -> np.ndarray:
    """Simulate and compute one sheet. Return the cumulative probability of each true value."""
    rng = np.random.default_rng(seed)
    dark, response = (
        _pattern(sizes, camera.degrees, rng) for sizes in (camera.offsets, camera.gains)
    )
    response += 1 - response.mean()  # the camera's responsivity is the mean over pixels
    photons = np.linspace(0.02, 1, LEVELS) * BRIGHTEST

    def frames(light: float, count: int) -> list[np.ndarray]:
        electrons = rng.poisson(EFFICIENCY * light * response, (count, *SHAPE))
        read = READ_NOISE * rng.standard_normal(electrons.shape)
        return list(np.clip(np.round(BLACK + GAIN * (electrons + read + dark)), 0, TOP))

    counts = [FRAMES if i == HALF else 2 for i in range(LEVELS)]
    stacks = stacks_from_frames(
        [frames(light, count) for light, count in zip(photons, counts, strict=True)],
        [frames(0.0, FRAMES)],
        [0.01] * LEVELS,
        photons=list(photons),
        camera=BitDepth(bits=12),
        dark_exposures=[0.01],
    )
    sheet = release_4_sheet(stacks, seed=seed)
    found = []
    for how, loss in ((PLAIN, Loss()), (FILTERED, loss_of_filter())):
        one = sheet.nonuniformity[how]
        of_kinds = ((one.dsnu, camera.offsets, GAIN), (one.prnu, camera.gains, 1.0))
        for draws, sizes, scale in of_kinds:
            truth = dict(zip(PARTS[1:], scale**2 * np.square(sizes), strict=True))
            for part in truth:
                truth[part] *= loss.pixels if part == "pixel" else loss.lines
            truth["total"] = sum(truth.values())
            found += [float(np.mean(draws[part] < truth[part])) for part in PARTS]
    saturated = _saturation(dark, response)
    truth = _truth(saturated, float(stacks.measurement.bright.light[len(sheet.general.light) - 1]))
    for name in FIGURES:
        value, error = (float(x[name]) for x in (sheet.linear.values, sheet.linear.errors))
        found.append(float(ndtr(np.log(truth[name] / value) * value / error)))
    found += [float(np.mean(sheet.general.draws[name] < truth[name])) for name in GENERAL]
    return np.array(found)


def _pattern(
    sizes: tuple[float, float, float], degrees: float, rng: np.random.Generator
) -> np.ndarray:
    rows, columns, pixels = sizes
    own = rng.standard_normal(SHAPE)
    if np.isfinite(degrees):
        own = rng.standard_t(degrees, SHAPE) * np.sqrt(1 - 2 / degrees)
    return (
        rows * rng.standard_normal((SHAPE[0], 1))
        + columns * rng.standard_normal(SHAPE[1])
        + pixels * own
    )


def _saturation(dark: np.ndarray, response: np.ndarray) -> float:
    """Return the photons at which .15 % of the pixels' values are at full scale."""

    def excess(light: float) -> float:
        electrons = EFFICIENCY * light * response
        mean = BLACK + GAIN * (electrons + dark)
        return float(np.mean(ndtr((mean - TOP + 0.5) / (GAIN * _noise(electrons))))) - 0.0015

    return float(brentq(excess, 0.5 * BRIGHTEST, 1.5 * BRIGHTEST))  # pyright: ignore


def _noise(electrons: np.ndarray | float) -> np.ndarray | float:
    return np.sqrt(electrons + READ_NOISE**2 + 1 / 12 / GAIN**2)


def _truth(saturated: float, brightest: float) -> dict[str, float]:
    least = float(np.sqrt(_noise(0.0) ** 2 + 0.25) + 0.5) / EFFICIENCY
    electrons = EFFICIENCY * brightest
    return {
        "saturation_photons": saturated,
        "snr_max": float(np.sqrt(EFFICIENCY * saturated)),
        "threshold_photons": least,
        "dynamic_range": saturated / least,
        "input_snr_max": float(electrons / _noise(electrons)),
    }
