"""Full well and fixed pattern, which do not depend on the gain, averaged over settings.

Each setting sees the same pixels, so settings differ only by temporal noise. The sampling error of
n pixels as a sample of their population is added once, to the average. Full well comes from the
settings whose well fills before the end of the converter's range. Their grids of levels are the
same or similar, so the error of the average is that of the best setting.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...inference.estimates import find
from ..calibration import LIKELIHOOD, NoiseCalibration
from ..full_well import ends_at_full_scale
from ..misfit import MISFIT, p_value
from ..parts import Part
from ..pattern import SEEN

ALIKE = 0.1  # relative deviation of settings up to which one value, less well known, serves all


@dataclass(frozen=True)
class Pooled:
    """An average over settings.

    Attributes:
        settings: indices of the pooled settings.
        value: of the full well, e-; of a pattern its variance, e-^2 or relative.
        error: its standard error; for a pattern from temporal noise alone.
        chi_square: of the settings about the value.
        parts: of a pattern's variance, as this sensor is one sample of its population.
        spread: rms deviation of the settings from the value, in its unit.
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
        """Whether one value is reported: the settings agree, or differ by little."""
        return self.holds or self.spread < ALIKE * abs(self.value)

    @property
    def known_to(self) -> float:
        """Standard error, including the scatter between settings if they disagree."""
        return self.error if self.holds else float(np.hypot(self.error, self.spread))

    @property
    def significant(self) -> bool:
        return self.value > SEEN * self.error


def full_well(calibrations: Sequence[NoiseCalibration | None]) -> Pooled | None:
    """Full well in electrons; None where no well was filled."""
    found = {
        i: find(one.sheet, "saturation_electrons", method=LIKELIHOOD)
        for i, one in enumerate(calibrations)
        if one is not None
        and one.within.saturation is not None
        and not ends_at_full_scale(one)
        and "saturation_electrons" in [estimate.name for estimate in one.sheet]
    }
    if not found:
        return None
    values, errors = np.array([(e.value or 0.0, e.standard_error or 0.0) for e in found.values()]).T
    pooled = _average(tuple(found), values, errors)
    return replace(pooled, error=float(errors.min()))


def pattern(
    calibrations: Sequence[NoiseCalibration | None], gains: np.ndarray, which: str
) -> Pooled | None:
    """DSNU or PRNU squared, for gains in DN/e-; None where only sums over pixels are known."""
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
    pooled = _average(settings, np.array(values), np.array(errors))
    return replace(pooled, parts=parts[int(np.argmin(errors))])


def _average(settings: tuple[int, ...], values: np.ndarray, errors: np.ndarray) -> Pooled:
    """Weighted mean, its standard error, its chi-square, and the scatter between settings."""
    weights = 1 / errors**2
    average = float(np.average(values, weights=weights))
    chi_square = float(np.sum(weights * (values - average) ** 2))
    spread = float(np.sqrt(np.mean((values - average) ** 2)))
    return Pooled(settings, average, float(weights.sum() ** -0.5), chi_square, spread=spread)
