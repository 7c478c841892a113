"""Calibration of a camera at several settings (pairs of gain and temperature): each setting is
fitted separately, then all are fitted together.

Full well and fixed pattern, which do not depend on the gain, are averaged over settings. All
settings use the same pixels, so the pattern estimates of the settings differ only by temporal
noise. A sampling error arises because these n pixels are one sample of their population. This
sampling error is common to all settings, so it is added once, to the average. The full well is
averaged over the settings at which the well fills before the converter's range ends. The spacing of
the light levels limits the accuracy of the full well. The settings have the same or similar levels,
so averaging does not reduce the error of the full well, and the average has the error of the best
setting.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxvision.errors import InputError

from ...inference.emcee_run import Emcee
from ...inference.estimates import QUANTILES, find
from ...inference.parameters import names
from ...inference.posterior import Posterior
from ...inference.precision import double_precision
from ...report.notebook import ShownInNotebooks
from ..calibration import LIKELIHOOD, NoiseCalibration, calibrate
from ..levels import Levels, PhotonTransfer
from ..pattern import SIGNIFICANCE_SIGMAS
from ..raw_frames import processing_in_words
from ..regressions import MISFIT, Part, p_value
from ..sensor import ends_at_full_scale
from ..settings import Setting
from .setting import FramesOfSetting, estimates_from_calibration, estimates_from_darks
from .statement import Figures, SharedFit, fit_settings

# Relative deviation of settings up to which one value with a larger error is used
LARGEST_RELATIVE_SPREAD = 0.1


@dataclass(frozen=True)
class Pooled:
    """The weighted average of a quantity over settings, with a test of their agreement."""

    settings: tuple[int, ...]  # indices of the pooled settings
    value: float  # full well, e-; for a pattern its variance, e-^2 or relative
    error: float  # its standard error; for a pattern from temporal noise alone
    chi_square: float  # chi-square of the settings about the value
    # standard error of a pattern's variance because the sensor is one sample of its population
    parts: tuple[Part, ...] = ()
    spread: float = 0.0  # rms deviation of the settings from the value, in its unit

    @property
    def p_value(self) -> float:
        return p_value(self.chi_square, len(self.settings) - 1) if self.settings[1:] else 1.0

    @property
    def holds(self) -> bool:
        return self.p_value >= MISFIT

    @property
    def serves(self) -> bool:
        """Whether one value serves all settings, as their values agree or differ by less than
        10 %."""
        return self.holds or self.spread < LARGEST_RELATIVE_SPREAD * abs(self.value)

    @property
    def known_to(self) -> float:
        """Standard error of the average, with the scatter between settings that disagree."""
        return self.error if self.holds else float(np.hypot(self.error, self.spread))

    @property
    def significant(self) -> bool:
        return self.value > SIGNIFICANCE_SIGMAS * self.error


def full_well(calibrations: Sequence[NoiseCalibration | None]) -> Pooled | None:
    """Average the full well over the settings, electrons; None if no setting fills the well."""
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
    """Average the variance of DSNU (e-^2) or PRNU (relative) over the settings; None if only sums
    over pixels are known. The gains of the settings are in DN/e-."""
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
    """Return the weighted mean of the settings' values, with error, chi-square and rms spread."""
    weights = 1 / errors**2
    average = float(np.average(values, weights=weights))
    chi_square = float(np.sum(weights * (values - average) ** 2))
    spread = float(np.sqrt(np.mean((values - average) ** 2)))
    return Pooled(settings, average, float(weights.sum() ** -0.5), chi_square, spread=spread)


@dataclass(frozen=True, repr=False)
class CameraCalibration(ShownInNotebooks):
    """The calibration of a camera at several gains and temperatures.

    Attributes:
        frames: statistics of the frames of each setting.
        calibrations: the separate calibration of each setting; None for a setting of darks alone.
        fit: the joint fit to all settings.
        full_well: e-, from settings at which the pixel fills before the ADC's range ends.
        dsnu: variance of DSNU, e-^2; None if no setting has frames of pixels.
        prnu: relative variance of PRNU; None if no setting has frames of pixels.
        left_out: sentences that name each setting omitted from the fit, with the reason.
    """

    frames: tuple[FramesOfSetting, ...]
    calibrations: tuple[NoiseCalibration | None, ...]
    fit: SharedFit
    full_well: Pooled | None
    dsnu: Pooled | None
    prnu: Pooled | None
    left_out: tuple[str, ...] = ()

    @property
    def settings(self) -> tuple[Setting, ...]:
        return tuple(one.setting for one in self.frames)

    @property
    def posterior(self) -> Posterior:
        return self.fit.posterior

    @property
    def figures(self) -> Figures:
        return self.fit.figures

    @property
    def is_impossible(self) -> bool:
        """Whether the quantum efficiency significantly exceeds 1 at any setting."""
        draws = zip(names(self.posterior.space), self.posterior.samples.T, strict=True)
        own = [one for name, one in draws if name.partition("[")[0] == "quantum_efficiency"]
        return any(np.quantile(one, QUANTILES[0]) > 1 for one in own)

    @property
    def processed(self) -> tuple[str, ...]:
        """Labels of the settings whose frames were not raw (compressed or denoised)."""
        return tuple(
            setting.label
            for setting, own in zip(self.settings, self.calibrations, strict=True)
            if own is not None and processing_in_words(own.measurement, own.usable)
        )


@double_precision
def calibrate_settings(
    frames: Sequence[FramesOfSetting],
    *,
    calibrations: Sequence[NoiseCalibration | InputError | None] | None = None,
    seed: int = 0,
) -> CameraCalibration:
    """Calibrate a camera's noise over its gains and temperatures.

    The model has one quantum efficiency for all settings, a read noise with a part before and a
    part behind the amplifier, and a dark current that follows Arrhenius' law. Each of these
    assumptions is tested, and dropped if its test fails. A setting whose separate fit fails is left
    out and listed in `left_out`.

    Args:
        frames: of at least two settings, as `read_by_setting` returns them.
        calibrations: of each setting alone, as `calibrate_one` returns them; None computes them.
        seed: of every draw.

    Returns:
        The calibration.

    Raises:
        InputError: for two settings of equal gain and temperature, for fewer than two settings that
            can be fitted, and where the settings do not determine a parameter.
    """
    settings = [one.setting for one in frames]
    if len({*settings}) < max(len(settings), 2):
        labels = "; ".join(setting.label or "neither gain nor temperature" for setting in settings)
        raise InputError(f"A fit over settings needs two or more that differ, got: {labels}.")
    if calibrations is None:
        calibrations = [calibrate_one(one, sampling=None, seed=seed) for one in frames]
    why = {
        one.setting.label: str(own)
        for one, own in zip(frames, calibrations, strict=True)
        if isinstance(own, InputError)
    }
    flats = [one.setting for one in frames if isinstance(one.frames, PhotonTransfer)]
    lit = {setting.gain for setting in flats}
    lost = lit - {setting.gain for setting in flats if setting.label not in why}
    for setting in settings:
        if setting.gain not in lit:
            raise InputError(f"The darks of {setting.label} have no flats of their gain.")
        if setting.gain in lost:
            why.setdefault(setting.label, "it has darks alone, and no flats of its gain are left.")
    left_out = tuple(f"{label} is left out of the fit: {reason}" for label, reason in why.items())
    kept = [
        (one, own)
        for one, own in zip(frames, calibrations, strict=True)
        if one.setting.label not in why and not isinstance(own, InputError)
    ]
    if len(kept) < 2:
        raise InputError(" ".join((*left_out, "A fit over settings needs two or more.")))
    frames, calibrations = zip(*kept, strict=True)
    estimates = []
    for one, own in kept:
        if own is not None:
            estimates.append(estimates_from_calibration(own))
        elif isinstance(one.frames, Levels):
            estimates.append(estimates_from_darks(one.setting, one.frames))
    fit = fit_settings([one.setting for one in frames], estimates, seed=seed)
    gains = np.exp(np.asarray(fit.figures.log_gain))
    return CameraCalibration(
        frames=frames,
        calibrations=calibrations,
        fit=fit,
        full_well=full_well(calibrations),
        dsnu=pattern(calibrations, gains, "dsnu"),
        prnu=pattern(calibrations, gains, "prnu"),
        left_out=left_out,
    )


def calibrate_one(
    one: FramesOfSetting, *, sampling: Emcee | None, seed: int
) -> NoiseCalibration | InputError | None:
    """Fit one setting separately, by emcee or Laplace's approximation. Return None for a setting of
    darks alone. If the likelihood has no maximum or the gain is not identifiable, return the
    InputError as a value."""
    if isinstance(one.frames, Levels):
        return None
    try:
        found = calibrate(one.frames, sampling=sampling, seed=seed)
    except InputError as error:
        return error
    why = [doubt.sentence for doubt in one.frames.doubts if "system_gain" in doubt.of]
    if found.likelihood is None:
        why.append(found.no_likelihood)
    return InputError(why[0]) if why else found
