"""What a die has once, whatever its gain: full well and fixed pattern, averaged over settings.

The same pixels are seen at each setting, so that settings differ by temporal noise alone; how far n
pixels stand for their population is added to the average once. Full well comes from the settings
whose well fills before the converter's range ends, on the same grid of levels or a similar one, so
that its error is that of the best of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...inference.estimates import find
from ..calibration import LIKELIHOOD, NoiseCalibration
from ..levels import CLEAR_OF_CLIPPING
from ..misfit import MISFIT, p_value
from ..parts import Part
from ..pattern import SEEN

ALIKE = 0.1  # relative deviation of settings up to which one value, less well known, serves all
AT_FULL_SCALE = 0.98  # of it, from which a brightest level counts as the converter's end


@dataclass(frozen=True)
class Pooled:
    """An average over settings.

    Attributes:
        settings: indices of those that enter.
        value: of full well, e-; of a pattern its variance, e-^2 or relative squared.
        error: its standard error; of a pattern by temporal noise alone.
        chi_square: of the settings about it.
        parts: of a pattern's variance, in which the die stands for its population.
        spread: deviation of the settings from the value, rms, in its unit.
    """

    settings: tuple[int, ...]
    value: float
    error: float
    chi_square: float
    parts: tuple[Part, ...] = ()
    spread: float = 0.0

    @property
    def p_value(self) -> float:
        return p_value(self.chi_square, len(self.settings) - 1) if self.settings[1:] else 1.0

    @property
    def holds(self) -> bool:
        return self.p_value >= MISFIT

    @property
    def serves(self) -> bool:
        """Whether one value is given: settings agree, or differ by little."""
        return self.holds or self.spread < ALIKE * abs(self.value)

    @property
    def known_to(self) -> float:
        """Standard error, with the settings' deviation where they do not agree."""
        return self.error if self.holds else float(np.hypot(self.error, self.spread))

    @property
    def seen(self) -> bool:
        return self.value > SEEN * self.error


def ends_at_full_scale(calibration: NoiseCalibration) -> bool:
    """Whether the converter's range ends before the well is full.

    Args:
        calibration: of one setting.
    """
    measurement = calibration.measurement
    if measurement.full_scale is None:
        return False
    bright = measurement.bright
    reached = np.asarray(bright.mean) + CLEAR_OF_CLIPPING * np.sqrt(np.asarray(bright.variance))
    return float(reached.max()) >= AT_FULL_SCALE * measurement.full_scale


def full_well(calibrations: Sequence[NoiseCalibration | None]) -> Pooled | None:
    """Electrons at saturation where the well fills first.

    Args:
        calibrations: of the settings; None where there are darks alone.

    Returns:
        The average; None where no well was filled.
    """
    found = []
    for i, one in enumerate(calibrations):
        if one is None or one.within.saturation is None or ends_at_full_scale(one):
            continue
        names = [estimate.name for estimate in one.sheet]
        if "saturation_electrons" in names:
            estimate = find(one.sheet, "saturation_electrons", method=LIKELIHOOD)
            found.append((i, estimate.value or 0.0, estimate.standard_error or 0.0))
    if not found:
        return None
    index, values, errors = (np.array(column) for column in zip(*found, strict=True))
    average, _, chi_square = _average(values, errors)
    spread = float(np.sqrt(np.mean((values - average) ** 2)))
    return Pooled(tuple(index.tolist()), average, float(errors.min()), chi_square, spread=spread)


def pattern(
    calibrations: Sequence[NoiseCalibration | None], gains: np.ndarray, which: str
) -> Pooled | None:
    """DSNU or PRNU, squared.

    Args:
        calibrations: of the settings; None where there are darks alone.
        gains: (settings,) DN/e-.
        which: "dsnu" or "prnu".

    Returns:
        The average; None where only sums over the pixels are known.
    """
    found = []
    for i, one in enumerate(calibrations):
        if one is None or one.patterns is None:
            continue
        fitted = one.patterns[1]
        spread = fitted.response if which == "prnu" else fitted.dark
        scale = 1.0 if which == "prnu" else float(gains[i]) ** 2
        parts = tuple(Part(part.variance / scale, part.degrees) for part in spread.parts)
        found.append((i, spread.variance / scale, spread.noise / scale, parts))
    if not found:
        return None
    settings, values, errors, parts = zip(*found, strict=True)
    average, error, chi_square = _average(np.array(values), np.array(errors))
    spread = float(np.sqrt(np.mean((np.array(values) - average) ** 2)))
    return Pooled(settings, average, error, chi_square, parts[int(np.argmin(errors))], spread)


def _average(values: np.ndarray, errors: np.ndarray) -> tuple[float, float, float]:
    """Weighted mean, its standard error, and chi-square about it."""
    weights = 1 / errors**2
    average = float(np.average(values, weights=weights))
    return average, float(weights.sum() ** -0.5), float(np.sum(weights * (values - average) ** 2))
