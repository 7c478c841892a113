"""Whether the conversion gain is proportional to the gain that a camera states."""

import numpy as np
from scipy.special import chdtrc

from .calibration import CameraCalibration
from .fit import OwnDeviation


def proportional_gain(
    calibration: CameraCalibration,
) -> tuple[float, float, tuple[OwnDeviation, ...]] | None:
    """The test of K = c times the stated gain, by generalised least squares of ln K.

    Args:
        calibration: of a camera.

    Returns:
        c in DN/e- per stated unit, the p-value, and how far each gain is off the others, relative;
        None with one gain.
    """
    fit = calibration.fit
    count = fit.model.sizes[0]
    first = [int(np.argmax(np.asarray(fit.model.gain_of) == i)) for i in range(count)]
    factors = np.array([fit.settings[i].gain_factor for i in first])
    if len(np.unique(factors)) < 2:
        return None
    ratio = np.asarray(fit.solution.vector)[:count] - np.log(factors)
    precision = np.linalg.inv(fit.covariance[:count, :count])
    common = float(np.sum(precision @ ratio) / precision.sum())
    missed = ratio - common
    chi_square = float(missed @ precision @ missed)
    own = []
    for i, label in enumerate(fit.labels[0]):
        # One gain off, all others in proportion: the score of its indicator.
        column = precision[:, i] - precision.sum(axis=1) * precision[:, i].sum() / precision.sum()
        size = float(column[i])
        own.append(OwnDeviation(label, float(column @ ratio) / size, size**-0.5))
    return float(np.exp(common)), float(chdtrc(count - 1, chi_square)), tuple(own)
