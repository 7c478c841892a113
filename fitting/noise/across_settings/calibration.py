"""Calibration of a camera over its gains and temperatures: each setting, and all as one."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from jaxvision.errors import InputError

from ...inference.emcee_run import SamplingOptions
from ...inference.importance import laplace_where_it_holds
from ...inference.posterior import Posterior
from ...report.notebook import ShownInNotebooks
from ..calibration import NoiseCalibration, calibrate
from ..levels import Levels, PhotonTransfer
from ..settings import Setting
from .fit import SharedFit, fitted
from .model import Figures, figures, log_density, no_deviations
from .pooled import Pooled, full_well, pattern
from .setting import FramesOfSetting, Told, told_by_calibration, told_by_darks


@dataclass(frozen=True)
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
    """

    frames: tuple[FramesOfSetting, ...]
    calibrations: tuple[NoiseCalibration | None, ...]
    fit: SharedFit
    posterior: Posterior
    full_well: Pooled | None
    dsnu: Pooled | None
    prnu: Pooled | None

    @property
    def settings(self) -> tuple[Setting, ...]:
        return tuple(one.setting for one in self.frames)

    @property
    def figures(self) -> Figures:
        """The best fit's figures at each setting."""
        vector = self.fit.solution.vector
        return figures(self.fit.model, vector, no_deviations(len(self.frames)))


def calibrate_settings(
    frames: Sequence[FramesOfSetting],
    *,
    calibrations: Sequence[NoiseCalibration | None] | None = None,
    seed: int = 0,
) -> CameraCalibration:
    """A camera's noise over its gains and temperatures.

    Quantum efficiency is shared, read noise follows from noise before and behind the amplifier, and
    dark current follows Arrhenius' law; each of these is tested, and given up where it fails.

    Args:
        frames: of two settings or more, as `read_by_setting` gives them.
        calibrations: of each setting by itself, None for darks alone; None to make them.
        seed: of every draw.

    Returns:
        The calibration.

    Raises:
        InputError: for fewer than two settings, two of one gain and temperature, and where a fit
            has no maximum.
    """
    settings = [one.setting for one in frames]
    if len({*settings}) < max(len(settings), 2):
        told = "; ".join(setting.label or "neither gain nor temperature" for setting in settings)
        raise InputError(f"A fit over settings needs two or more that differ, got: {told}.")
    if calibrations is None:
        calibrations = [calibrate_one(one, sampling=None, seed=seed) for one in frames]
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
            log_density, fit.space, fit.solution.vector, fit.covariance, args, seed=seed
        ),
        full_well=full_well(calibrations),
        dsnu=pattern(calibrations, gains, "dsnu"),
        prnu=pattern(calibrations, gains, "prnu"),
    )


def calibrate_one(
    one: FramesOfSetting, *, sampling: SamplingOptions | None, seed: int
) -> NoiseCalibration | None:
    """One setting by itself.

    Args:
        one: setting.
        sampling: how to draw the likelihood's posterior by emcee; None for Laplace.
        seed: of every draw.

    Returns:
        The calibration; None of darks alone.

    Raises:
        InputError: names the setting, where the fit has no maximum.
    """
    if isinstance(one.frames, Levels):
        return None
    try:
        return calibrate(one.frames, sampling=sampling, seed=seed)
    except InputError as error:
        raise InputError(f"{one.setting.label}: {error}") from error


def _told(one: FramesOfSetting, own: NoiseCalibration | None) -> Told:
    if isinstance(one.frames, Levels):
        return told_by_darks(one.setting, one.frames)
    assert own is not None
    return told_by_calibration(own)
