"""What the frames of one setting tell of the quantities that all settings share.

Of flats and darks, the likelihood's ln K, ln R, ln sigma_d and dark current I with their
covariance; everything else of that fit is marginalised. Of darks alone, weighted lines over the
exposure t,

    mean      y   = black + K I t
    variance  s^2 = K^2 sigma_d^2 + 1/12 + K^2 I t

give K I, K^2 sigma_d^2 and K^2 I. The means know K I a hundred times better than the variances know
K^2 I, and what the two share by the skewness of shot noise is left out.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxvision.errors import InputError

from ...inference.diagnostics import OPEN
from ...inference.parameters import names
from ..calibration import NoiseCalibration, finest_read_noise
from ..levels import Levels, PhotonTransfer
from ..misfit import inflation
from ..settings import Setting
from ..shared import shared_noise

FROM_BOTH = ("system_gain", "responsivity", "read_noise", "dark_current")
FROM_DARKS = ("dark_signal_rate", "read_variance", "dark_variance_rate")
TOLD = FROM_BOTH + FROM_DARKS  # the order of every vector of what settings tell
FEWEST_EXPOSURES = 3  # of darks alone: a line and whether it is one


@dataclass(frozen=True)
class FramesOfSetting:
    """Reduced frames of one setting.

    Attributes:
        setting: gain and temperature.
        frames: of flats and darks; `Levels` where there are darks alone.
    """

    setting: Setting
    frames: PhotonTransfer | Levels


@dataclass(frozen=True)
class Told:
    """What one setting tells.

    Attributes:
        names: of the quantities, some of `TOLD`.
        values: (quantities,): ln DN/e-, ln DN/photon, ln e-, e-/s; or DN/s, DN^2, DN^2/s.
        covariance: (quantities, quantities).
    """

    names: tuple[str, ...]
    values: Float[np.ndarray, " quantities"]
    covariance: Float[np.ndarray, "quantities quantities"]


def told_by_calibration(calibration: NoiseCalibration) -> Told:
    """What flats and darks tell.

    Args:
        calibration: of one setting.

    Returns:
        ln K, ln R where photons are known, ln read noise where it is determined, dark current where
        it was fitted.
    """
    posterior = calibration.posterior
    labels = names(posterior.space)
    deviation = dict(zip(labels, np.sqrt(np.diagonal(posterior.covariance)), strict=True))
    present = [name for name in FROM_BOTH if name in labels]
    too_fine = float(calibration.chosen.values["read_noise"]) < finest_read_noise(
        calibration.chosen
    )
    if deviation["read_noise"] > OPEN or too_fine:
        present.remove("read_noise")
    index = [labels.index(name) for name in present]
    return Told(
        names=tuple(present),
        values=np.asarray(posterior.unconstrained_mode)[index],
        covariance=posterior.covariance[np.ix_(index, index)],
    )


def told_by_darks(setting: Setting, darks: Levels) -> Told:
    """What darks alone tell.

    Args:
        setting: of them, for messages.
        darks: of three different exposures or more.

    Returns:
        K I, K^2 sigma_d^2 and K^2 I.

    Raises:
        InputError: for fewer exposures.
    """
    exposure, mean, variance, frames = (
        np.asarray(x) for x in (darks.exposure, darks.mean, darks.variance, darks.frames)
    )
    if len(np.unique(exposure)) < FEWEST_EXPOSURES:
        raise InputError(
            f"The darks of {setting.label} have no flats and fewer than {FEWEST_EXPOSURES} "
            "different exposures, from which nothing follows; add flats, or other exposures."
        )
    pixels = float(darks.pixels)
    of_mean, of_variance = variance / pixels, 2 * variance**2 / pixels
    shared = shared_noise(darks.shared, variance, frames)
    if shared is not None:
        of_mean = of_mean + float(shared.of_mean)
        of_variance = of_variance + float(shared.of_variance)
    (_, rate), means = _line(exposure, mean, of_mean / frames)
    fitted, variances = _line(exposure, variance, of_variance / (frames - 1))
    covariance = np.zeros((3, 3))
    covariance[0, 0] = means[1, 1]
    covariance[1:, 1:] = variances
    values = np.array([rate, fitted[0] - darks.converter.rounding, fitted[1]])
    return Told(FROM_DARKS, values, covariance)


def _line(x: np.ndarray, y: np.ndarray, variances: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(intercept, slope) and their covariance, inflated by chi-square per degree of freedom where
    that is beyond chance (Birge)."""
    design = np.stack([np.ones_like(x), x], axis=1) / np.sqrt(variances)[:, None]
    scaled = y / np.sqrt(variances)
    covariance = np.linalg.inv(design.T @ design)
    found = covariance @ (design.T @ scaled)
    chi_square, degrees = float(np.sum((scaled - design @ found) ** 2)), len(x) - 2
    return found, covariance * inflation(chi_square, degrees)
