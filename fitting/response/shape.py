"""Test whether a response is a pure gamma, given the errors of its curve.

Among hundreds of codes, the largest deviation from a gamma may be large by chance. Therefore the
deviations of all codes are tested together. The deviations d = P g are the residuals of the
measured curve g after a straight line in ln (code - black) is removed, where P is the matrix of
that projection. If C is the covariance of g, the covariance of d is P C P^T. The largest of

    |d_i| / sqrt((P C P^T)_ii + v_i^2)

over the codes i is compared with the largest of as many simulated Gaussian numbers with the same
correlation. Here v_i is the variance of one pixel's ln X, which is the size of second-order terms
of the noise in a mean of logarithms. The response counts as not a pure gamma if a significant
deviation exceeds 5 %.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import ndtr, stdtrit

from .calibration import ChannelResponse
from .curve import ResponseCurve

PURE = 0.05  # departure in ln exposure up to which gamma is given
LARGEST_STANDARD_ERROR = 0.05  # standard error of ln exposure up to which a departure is judged
LARGEST_PIXEL_NOISE = 0.1  # relative noise of one pixel up to which a departure is judged
EDGES = 0.05, 0.95  # shares of the range of codes between which a departure is judged
# Probability of a significant departure if all channels are pure gammas
FALSE_ALARM_PROBABILITY = 0.01
MOST_CODES, DRAWS = 64, 20000
SURELY_KNOWN = 1e-3  # standard error below which codes have equal weights


@dataclass(frozen=True)
class Shape:
    """The largest deviations of a response from the best pure gamma, over the codes that are
    tested.

    Attributes:
        size: largest deviation from the best gamma, in ln exposure; NaN where no code can be
            tested.
        code: DN at which the deviation is `size`.
        significant: largest significant deviation, in ln exposure; 0 where no deviation is
            significant.
        significant_code: DN at which the deviation is `significant`.
        significant_error: standard error of `significant`, in ln exposure.
    """

    size: float
    code: float
    significant: float = 0.0
    significant_code: float = float("nan")
    significant_error: float = 0.0

    @property
    def pure(self) -> bool:
        """Whether the data are consistent with a pure gamma."""
        return not self.significant > PURE


def judged_codes(curve: ResponseCurve) -> Bool[np.ndarray, " bins"]:
    """Return the tested codes: 5 to 95 % of the range, curve known to 5 %, a pixel's light to
    10 %."""
    share = (curve.codes - curve.bins.black) / (curve.bins.edges[-1] - curve.bins.black)
    central = (share > EDGES[0]) & (share < EDGES[1])
    known = (curve.standard_error < LARGEST_STANDARD_ERROR) & (
        curve.pixel_noise < LARGEST_PIXEL_NOISE
    )
    return central & curve.seen & known


def largest_departure(
    curve: ResponseCurve, departure: Float[np.ndarray, " bins"]
) -> tuple[float, float]:
    """Return the largest deviation among the tested codes, and the code at which it occurs."""
    return largest(curve, departure, judged_codes(curve))


def largest(
    curve: ResponseCurve, departure: Float[np.ndarray, " bins"], counted: Bool[np.ndarray, " bins"]
) -> tuple[float, float]:
    """Return the largest deviation among codes `counted`, and its code; NaN if none."""
    counted = counted & np.isfinite(departure)
    if not counted.any():
        return float("nan"), float("nan")
    size = np.where(counted, np.abs(departure), -1)
    return float(size.max()), float(curve.codes[np.argmax(size)])


def error_of_departure(curve: ResponseCurve) -> Float[np.ndarray, " bins"]:
    """Return the standard error of each deviation, with second-order terms of noise."""
    return np.hypot(curve.standard_error, curve.pixel_noise**2)


def shapes(channels: Sequence[ChannelResponse]) -> list[Shape]:
    """Test each channel's shape, at a level that holds for all channels together."""
    chance = FALSE_ALARM_PROBABILITY / max(len(channels), 1)
    return [_shape(channel.curve, channel.gamma.departure, chance) for channel in channels]


def _shape(curve: ResponseCurve, departure: np.ndarray, chance: float) -> Shape:
    size, code = largest_departure(curve, departure)
    judged = np.flatnonzero(judged_codes(curve) & np.isfinite(departure))
    if len(judged) <= 2:
        return Shape(size, code)
    places = np.linspace(0, len(judged) - 1, min(MOST_CODES, len(judged)))
    judged = judged[np.unique(places.astype(int))]
    beyond, error = _significant_codes(curve, judged, chance)
    if not beyond.any():
        return Shape(size, code)
    sizes = np.where(beyond, np.abs(departure[judged]), 0)
    worst = int(np.argmax(sizes))
    at = float(curve.codes[judged[worst]])
    return Shape(size, code, float(sizes[worst]), at, float(error[worst]))


def _significant_codes(
    curve: ResponseCurve, judged: np.ndarray, chance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Test all deviations from a line together; return a mask and their errors."""
    log_z = np.log(curve.codes[judged] - curve.bins.black)
    line = np.stack([np.ones(len(judged)), log_z], axis=1)
    weight = np.maximum(curve.standard_error[judged], SURELY_KNOWN) ** -2
    weighted = line * weight[:, None]
    left = np.eye(len(judged)) - line @ np.linalg.solve(line.T @ weighted, weighted.T)
    covariance = left @ curve.covariance[np.ix_(judged, judged)] @ left.T
    covariance += np.diag(curve.pixel_noise[judged] ** 4)
    error = np.sqrt(np.diagonal(covariance))
    known, axes = np.linalg.eigh(covariance / np.outer(error, error))
    normal = np.random.default_rng(0).standard_normal((DRAWS, len(judged)))
    most = np.abs(normal @ (axes * np.sqrt(np.maximum(known, 0))).T).max(axis=1)
    allowed = 2 * ndtr(-np.quantile(most, 1 - chance))  # significance level of a single code
    limit = stdtrit(curve.freedom[judged], 1 - allowed / 2)
    return np.abs(left @ curve.log_exposure[judged]) > limit * error, error
