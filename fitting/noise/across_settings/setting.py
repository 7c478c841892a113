"""Reduction of a rig's flats and darks, setting by setting, and each setting's estimates of the
parameters that settings share.

From flats and darks, the likelihood fit gives ln K (gain), ln R (responsivity), ln sigma_d (read
noise) and the dark current I, with their covariance. The other parameters of that fit are
marginalised. From darks alone, weighted lines over the exposure t,

    mean      y   = black + K I t
    variance  s^2 = K^2 sigma_d^2 + 1/12 + K^2 I t

give the products K I, K^2 sigma_d^2 and K^2 I. The relative standard error of K I, from the means,
is a hundred times smaller than that of K^2 I, from the variances. Skewed shot noise correlates
means and variances; this correlation is neglected.
"""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from jaxvision.errors import InputError

from ...inference.diagnostics import OPEN_LOG_SD
from ...inference.parameters import names
from ...inference.precision import double_precision
from ...rig import Rig, load_rig
from ..calibration import NoiseCalibration, finest_read_noise
from ..levels import Levels, PhotonTransfer
from ..read import reduce_darks, reduce_rig
from ..regressions import inflation, least_squares, sampling_errors
from ..sensor import mode_without
from ..settings import Setting, split_by_setting
from ..shared import shared_noise
from ..usable import check

FROM_BOTH = ("system_gain", "responsivity", "read_noise", "dark_current")
FROM_DARKS = ("dark_signal_rate", "read_variance", "dark_variance_rate")
ESTIMATED = FROM_BOTH + FROM_DARKS  # the order of every vector of estimates
FEWEST_EXPOSURES = 3  # exposures of darks alone, for a line and a test of it


@dataclass(frozen=True)
class FramesOfSetting:
    """Statistics of the frames of one setting.

    Attributes:
        setting: gain and temperature.
        frames: statistics of flats and darks; `Levels` if there are only darks.
    """

    setting: Setting
    frames: PhotonTransfer | Levels


@dataclass(frozen=True)
class SettingEstimates:
    """Estimates from one setting. Flats and darks give ln K (K in DN/e-), ln R (DN/photon), ln
    sigma_d (e-) and I (e-/s); darks alone give K I (DN/s), K^2 sigma_d^2 (DN^2) and K^2 I
    (DN^2/s)."""

    names: tuple[str, ...]  # some of `ESTIMATED`
    values: Float[np.ndarray, " quantities"]
    covariance: Float[np.ndarray, "quantities quantities"]

    def estimate(self, name: str) -> tuple[float, float]:
        """Return a quantity with its standard error; NaN if the setting does not give it."""
        if name not in self.names:
            return np.nan, np.nan
        place = self.names.index(name)
        return float(self.values[place]), float(np.sqrt(self.covariance[place, place]))

    def dark_current(self, gain: float) -> tuple[float, float]:
        """Return dark current and standard error, e-/s; darks alone need the gain, DN/e-."""
        if "dark_current" in self.names:
            return self.estimate("dark_current")
        rate, error = self.estimate("dark_signal_rate")
        return rate / gain, error / gain


def estimates_from_calibration(
    calibration: NoiseCalibration, *, left_out: Bool[np.ndarray, " levels"] | None = None
) -> SettingEstimates:
    """Return the estimates from flats and darks: ln K, ln R if photons are known, ln sigma_d if
    read noise is determined, and I if dark current was fitted. `left_out` marks levels that are
    excluded from the fit."""
    posterior = calibration.posterior
    labels = names(posterior.space)
    present = [name for name in FROM_BOTH if name in labels]
    place = labels.index("read_noise")
    too_fine = float(calibration.chosen.values["read_noise"]) < finest_read_noise(
        calibration.chosen
    )
    if posterior.covariance[place, place] > OPEN_LOG_SD**2 or too_fine:
        present.remove("read_noise")
    index = [labels.index(name) for name in present]
    mode, covariance = np.asarray(posterior.unconstrained_mode), posterior.covariance
    if left_out is not None:
        mode, covariance = mode_without(calibration, left_out)
    return SettingEstimates(tuple(present), mode[index], covariance[np.ix_(index, index)])


def estimates_from_darks(setting: Setting, darks: Levels) -> SettingEstimates:
    """Return the estimates from darks alone, of three different exposures or more."""
    exposure, mean, variance = (np.asarray(x) for x in (darks.exposure, darks.mean, darks.variance))
    if len(np.unique(exposure)) < FEWEST_EXPOSURES:
        raise InputError(
            f"The darks of {setting.label} have no flats and fewer than {FEWEST_EXPOSURES} "
            "different exposures, which determine nothing; add flats, or other exposures."
        )
    errors = sampling_errors(darks, shared=shared_noise(darks))
    (rate, _), means = _line(exposure, mean, np.asarray(errors.mean))
    (slope, intercept), variances = _line(exposure, variance, np.asarray(errors.variance))
    covariance = np.zeros((3, 3))
    covariance[0, 0] = means[0, 0]
    covariance[1:, 1:] = variances[::-1, ::-1]
    return SettingEstimates(
        FROM_DARKS, np.array([rate, intercept - darks.converter.rounding, slope]), covariance
    )


def _line(x: np.ndarray, y: np.ndarray, variances: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fit a weighted line; return (slope, intercept) and their covariance, widened by a misfit."""
    found, degrees = least_squares((x, 1.0), y, errors=np.sqrt(variances)), len(x) - 2
    return found.values, found.covariance * inflation(found.misfit * degrees, degrees)


@double_precision
def read_by_setting(
    path: str | os.PathLike[str], *, channel: str = ""
) -> tuple[FramesOfSetting, ...]:
    """Read and reduce the photon transfer frames of a rig at several gains and temperatures.

    A setting may have darks without flats, which give the dark current at its temperature.

    Args:
        path: a rig folder or file.
        channel: site of a Bayer mosaic; empty for the first green.

    Returns:
        The frames of each setting, ordered by gain and temperature.

    Raises:
        InputError: for files that cannot be used.
    """
    return reduce_by_setting(load_rig(path), channel=channel)


@double_precision
def reduce_by_setting(
    rig: Rig,
    *,
    channel: str = "",
    failed: dict[Setting, InputError] | None = None,
) -> tuple[FramesOfSetting, ...]:
    """Reduce the frames of a loaded rig as `read_by_setting` does. Unusable settings are left out
    and added to `failed` with the reason. If `failed` is None, an unusable setting raises
    InputError."""
    rigs = split_by_setting(rig)
    found: dict[Setting, FramesOfSetting] = {}
    lit = {setting.gain for setting, own in rigs.items() if own.flat}
    for setting in sorted(rigs, key=lambda one: not rigs[one].flat):  # flats first
        place = Path(rig.folder) / f"({setting.label})" if len(rigs) > 1 else rig.folder
        try:
            found[setting] = _reduce(place, setting, rigs[setting], lit, channel)
        except InputError as error:
            if failed is None:
                raise
            failed[setting] = error
            lit = {one.gain for one in rigs if rigs[one].flat and one not in failed}
    if not found and failed:
        raise next(iter(failed.values()))
    return tuple(found[setting] for setting in rigs if setting in found)


def _reduce(
    place: Path, setting: Setting, own: Rig, lit: set[float | None], channel: str
) -> FramesOfSetting:
    """Reduce the frames of one setting. `lit` is the set of gains for which the rig has flats."""
    if not own.dark:
        raise InputError(f"{place}: its flats have no darks of their gain and temperature.")
    if own.flat:
        frames = reduce_rig(own, channel=channel)
        check(place, frames)
    elif setting.gain in lit:
        frames = reduce_darks(own, channel=channel)
    else:
        raise InputError(f"{place}: its darks have no flats of their gain at any temperature.")
    return FramesOfSetting(setting, frames)
