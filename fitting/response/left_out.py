"""Stated errors of a rig that the pixels of a response cannot detect.

The energy of the code pairs, v' A v / 2 for a shift v of the curve and of the log exposures, is
half the squared shift in standard deviations of all pixels, with their irradiances eliminated.
Therefore |h|^2 = v' A v for an error of one standard deviation (`inference.left_out`).
"""

import numpy as np
from jaxtyping import Float

from ..inference.left_out import LeftOut, distance, negligible
from .curve import ResponseCurve


def without_effect(
    curve: ResponseCurve,
    of_black: Float[np.ndarray, " bins"],
    overstated: float,
    *,
    black_sd: float,
    exposure_sd: float,
) -> tuple[LeftOut, ...]:
    """Stated errors of the black level and the exposures that no pixel can detect.

    Args:
        curve: with the sufficient statistics of its pixels.
        of_black: (bins,) change of ln X where black lies `black_sd` higher.
        overstated: number of pixels that count as one independent pixel.
        black_sd: standard deviation of the black level, DN; 0 where exact.
        exposure_sd: relative standard deviation of the independent errors of the exposures; 0 where
            exact.

    Returns:
        The negligible errors, with their bounds.
    """
    found, size = [], len(of_black)
    matrix = curve.statistics.matrix / overstated
    if black_sd:
        square = max(float(of_black @ matrix[:size, :size] @ of_black), 0.0)
        found.append(LeftOut("black_sd", black_sd, distance(np.array(square))))
    if exposure_sd:
        squares = np.linalg.eigvalsh(exposure_sd**2 * matrix[size:, size:])
        found.append(LeftOut("exposure_sd", exposure_sd, distance(np.maximum(squares, 0))))
    return negligible(found)
