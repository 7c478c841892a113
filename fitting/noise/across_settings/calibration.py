"""Calibration of a camera over its gains and temperatures: each setting separately, and all
together."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxvision.errors import InputError

from ...inference.emcee_run import Emcee
from ...inference.estimates import QUANTILES
from ...inference.parameters import names
from ...inference.posterior import Posterior
from ...inference.precision import in_double
from ...report.notebook import ShownInNotebooks
from ..calibration import NoiseCalibration, calibrate
from ..levels import Levels, PhotonTransfer
from ..raw_frames import processing_in_words
from ..settings import Setting
from .pooled import Pooled, full_well, pattern
from .setting import FramesOfSetting, estimates_from_calibration, estimates_from_darks
from .statement import Figures, SharedFit, fitted


@dataclass(frozen=True, repr=False)
class CameraCalibration(ShownInNotebooks):
    """A camera calibrated over its settings.

    Attributes:
        frames: of each setting.
        calibrations: of each setting alone; None where it has darks alone.
        fit: of all settings.
        full_well: e-, where the pixel fills before the ADC's range ends.
        dsnu: variance, e-^2, where frames of pixels are known.
        prnu: relative variance, where frames of pixels are known.
        left_out: settings that the fit omits, and why, in sentences.
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
        """Whether the quantum efficiency exceeds 1 at some setting, by more than its error
        explains."""
        draws = zip(names(self.posterior.space), self.posterior.samples.T, strict=True)
        own = [one for name, one in draws if name.partition("[")[0] == "quantum_efficiency"]
        return any(np.quantile(one, QUANTILES[0]) > 1 for one in own)

    @property
    def processed(self) -> tuple[str, ...]:
        """Labels of the settings whose frames were not raw."""
        return tuple(
            setting.label
            for setting, own in zip(self.settings, self.calibrations, strict=True)
            if own is not None and processing_in_words(own.measurement, own.usable)
        )


@in_double
def calibrate_settings(
    frames: Sequence[FramesOfSetting],
    *,
    calibrations: Sequence[NoiseCalibration | InputError | None] | None = None,
    seed: int = 0,
) -> CameraCalibration:
    """A camera's noise over its gains and temperatures.

    Quantum efficiency is shared, read noise follows from noise before and behind the amplifier, and
    dark current follows Arrhenius' law. Each of these assumptions is tested and dropped if it
    fails. A setting that cannot be fitted by itself is left out and named.

    Args:
        frames: of at least two settings, as `read_by_setting` returns them.
        calibrations: of each setting alone, as `calibrate_one` returns them; None makes them.
        seed: of every draw.

    Returns:
        The calibration.

    Raises:
        InputError: for two settings of equal gain and temperature, for fewer than two settings that
            can be fitted, and where they leave a parameter undetermined.
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
    fit = fitted([one.setting for one in frames], estimates, seed=seed)
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
    """The fit of one setting, by emcee or Laplace. It is None for darks alone, and the error where
    the fit has no maximum or the gain is not identifiable."""
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
