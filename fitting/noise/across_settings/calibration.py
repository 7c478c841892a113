"""Calibration of a camera over its gains and temperatures: each setting, and all as one."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from jaxvision.errors import InputError

from ...inference.emcee_run import SamplingOptions
from ...inference.importance import laplace_where_it_holds
from ...inference.posterior import Posterior
from ...inference.precision import in_double
from ...report.notebook import ShownInNotebooks
from ..calibration import NoiseCalibration, calibrate
from ..levels import Levels, PhotonTransfer
from ..settings import Setting
from .fit import SharedFit, fitted
from .model import Figures, figures, log_density, no_deviations
from .pooled import Pooled, full_well, pattern
from .setting import FramesOfSetting, Told, told_by_calibration, told_by_darks


@dataclass(frozen=True, repr=False)
class CameraCalibration(ShownInNotebooks):
    """A camera calibrated over its settings.

    Attributes:
        frames: of each setting.
        calibrations: of each by itself; None where there are darks alone.
        fit: of all settings.
        posterior: of the fit's parameters.
        full_well: e-, where a well was filled before the converter's range ended.
        dsnu: squared, e-^2, where pixels are known.
        prnu: squared, relative, where pixels are known.
        left_out: settings that the fit is without, and why, in sentences.
    """

    frames: tuple[FramesOfSetting, ...]
    calibrations: tuple[NoiseCalibration | None, ...]
    fit: SharedFit
    posterior: Posterior
    full_well: Pooled | None
    dsnu: Pooled | None
    prnu: Pooled | None
    left_out: tuple[str, ...] = ()

    @property
    def settings(self) -> tuple[Setting, ...]:
        return tuple(one.setting for one in self.frames)

    @property
    def figures(self) -> Figures:
        """The best fit's figures at each setting."""
        vector = self.fit.solution.vector
        return figures(self.fit.model, vector, no_deviations(len(self.frames)))


@in_double
def calibrate_settings(
    frames: Sequence[FramesOfSetting],
    *,
    calibrations: Sequence[NoiseCalibration | InputError | None] | None = None,
    seed: int = 0,
) -> CameraCalibration:
    """A camera's noise over its gains and temperatures.

    Quantum efficiency is shared, read noise follows from noise before and behind the amplifier, and
    dark current follows Arrhenius' law; each of these is tested, and given up where it fails. A
    setting that cannot be fitted by itself is left out and named.

    Args:
        frames: of two settings or more, as `read_by_setting` gives them.
        calibrations: of each setting by itself, as `calibrate_one` gives them; None to make them.
        seed: of every draw.

    Returns:
        The calibration.

    Raises:
        InputError: for two settings of one gain and temperature, for fewer than two, or fewer than
            two that can be fitted.
    """
    settings = [one.setting for one in frames]
    if len({*settings}) < max(len(settings), 2):
        told = "; ".join(setting.label or "neither gain nor temperature" for setting in settings)
        raise InputError(f"A fit over settings needs two or more that differ, got: {told}.")
    if calibrations is None:
        calibrations = [calibrate_one(one, sampling=None, seed=seed) for one in frames]
    frames, calibrations, left_out = _kept(frames, calibrations)
    settings = [one.setting for one in frames]
    lit = {one.setting.gain for one in frames if isinstance(one.frames, PhotonTransfer)}
    for one in frames:
        if one.setting.gain not in lit:
            raise InputError(f"The darks of {one.setting.label} have no flats of their gain.")
    told = [_told(one, own) for one, own in zip(frames, calibrations, strict=True)]
    fit = fitted(settings, told)
    at = figures(fit.model, fit.solution.vector, no_deviations(len(settings)))
    gains = np.exp(np.asarray(at.log_gain))
    args = fit.model, jnp.asarray(1 / fit.inflation)
    return CameraCalibration(
        frames=tuple(frames),
        calibrations=tuple(calibrations),
        fit=fit,
        posterior=laplace_where_it_holds(
            *(log_density, fit.space, fit.solution.vector, fit.covariance, args),
            seed=seed,
            by_chain=False,
        ),
        full_well=full_well(calibrations),
        dsnu=pattern(calibrations, gains, "dsnu"),
        prnu=pattern(calibrations, gains, "prnu"),
        left_out=left_out,
    )


def calibrate_one(
    one: FramesOfSetting, *, sampling: SamplingOptions | None, seed: int
) -> NoiseCalibration | InputError | None:
    """One setting by itself.

    Args:
        one: setting.
        sampling: how to draw the likelihood's posterior by emcee; None for Laplace.
        seed: of every draw.

    Returns:
        The calibration; None of darks alone, and the error where the fit has no maximum.
    """
    if isinstance(one.frames, Levels):
        return None
    try:
        return calibrate(one.frames, sampling=sampling, seed=seed)
    except InputError as error:
        return error


def _kept(
    frames: Sequence[FramesOfSetting], calibrations: Sequence[NoiseCalibration | InputError | None]
) -> tuple[list[FramesOfSetting], list[NoiseCalibration | None], tuple[str, ...]]:
    """The settings that could be fitted, with the darks of their gains; and why not the others."""
    why = {}
    for one, own in zip(frames, calibrations, strict=True):
        if isinstance(own, InputError):
            why[one.setting.label] = str(own)
    flats = [one for one in frames if isinstance(one.frames, PhotonTransfer)]
    lost = {one.setting.gain for one in flats}
    lost -= {one.setting.gain for one in flats if one.setting.label not in why}
    for one in frames:
        if one.setting.gain in lost:
            why.setdefault(
                one.setting.label, "it has darks alone, and no flats of its gain are left."
            )
    kept = [
        (one, own)
        for one, own in zip(frames, calibrations, strict=True)
        if one.setting.label not in why and not isinstance(own, InputError)
    ]
    told = tuple(f"{label} is left out of the fit: {reason}" for label, reason in why.items())
    if len(kept) < 2:
        raise InputError(" ".join((*told, "A fit over settings needs two or more.")))
    return [one for one, _ in kept], [own for _, own in kept], told


def _told(one: FramesOfSetting, own: NoiseCalibration | None) -> Told:
    if isinstance(one.frames, Levels):
        return told_by_darks(one.setting, one.frames)
    assert own is not None
    return told_by_calibration(own)
