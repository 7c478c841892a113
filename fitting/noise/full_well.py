"""The full well in electrons, from flats that fill it before the end of the converter's range."""

import numpy as np
from scipy.optimize import root_scalar
from scipy.special import ndtr

from .brighter_fatter import electrons_and_steps
from .calibration import NoiseCalibration
from .levels import CLEAR_OF_CLIPPING
from .model import compressed

AT_FULL_SCALE = 0.98  # of it, from which a brightest level counts as the converter's end
CUT = 0.5  # of the shot noise of so many electrons, below which a level is one of full wells


def ends_at_full_scale(calibration: NoiseCalibration) -> bool:
    """Whether the converter's range ends before the well of one setting is full."""
    measurement = calibration.measurement
    if measurement.full_scale is None:
        return False
    bright = measurement.bright
    reached = np.asarray(bright.mean) + CLEAR_OF_CLIPPING * np.sqrt(np.asarray(bright.variance))
    return float(reached.max()) >= AT_FULL_SCALE * measurement.full_scale


def full_well(calibration: NoiseCalibration) -> tuple[float, float] | None:
    """The full well times the gain at zero signal, from the levels whose wells are full.

    A level of mu electrons has the mean E[min(N, W)] with N Gaussian of variance mu, which is
    solved for W.
    """
    if calibration.within.saturation is None or ends_at_full_scale(calibration):
        return None
    measurement, chosen = calibration.measurement, calibration.chosen
    bright, dark = measurement.bright, measurement.dark
    values = {name: float(value) for name, value in chosen.values.items()}
    gain, top = values["system_gain"], float(chosen.data.top_signal)
    above = np.asarray(bright.mean) - values["black_level"]
    shot = np.asarray(bright.variance) - np.asarray(dark.variance)[np.asarray(measurement.dark_of)]
    light = np.asarray(bright.light)
    electrons = np.asarray(electrons_and_steps(chosen)[0])[: len(calibration.usable)]
    per_light = electrons[-1] / light[calibration.usable[-1]]
    found = []
    for level in range(int(calibration.usable[-1]) + 1, len(light)):
        if above[level] <= 0 or shot[level] > CUT * gain * above[level]:
            continue
        signal = root_scalar(
            lambda x, to: float(compressed(values, x, top)) - to,  # type: ignore[arg-type]
            bracket=(0.0, 3 * above[level]),
            args=(above[level],),
        ).root
        mean = light[level] * per_light
        if signal / gain < mean:
            found.append(gain * _well_of(signal / gain, mean))
    if not found:
        return None
    pixels = float(bright.pixels)
    noise = np.sqrt(np.max(np.asarray(bright.variance)) / pixels)
    return float(np.median(found)), float(np.hypot(np.std(found), noise))


def _well_of(held: float, mean: float) -> float:
    """W of E[min(N, W)] = held, with N Gaussian of this mean and variance."""
    sigma = np.sqrt(mean)

    def missed(well: float) -> float:
        z = (well - mean) / sigma
        return well - held - sigma * (z * ndtr(z) + np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi))

    return root_scalar(missed, bracket=(held, mean + 10 * sigma)).root
