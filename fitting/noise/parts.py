"""Intervals of a variance that is a sum of parts, some known from few degrees of freedom.

Part i, of pixels, rows or columns, has variance V_i with nu_i degrees of freedom; w columns have w
- 1. Its estimate has a chi-square distribution. For small nu_i neither its logarithm nor its square
root is symmetric. With V = sum V_i and an error sigma from temporal noise, the quantile at p is

    V +- sqrt(sum (nu_i / q_i - 1)^2 V_i^2 + z^2 sigma^2),    plus for p > 1/2

where q_i is the chi-square that nu_i degrees exceed with probability p, and z the Gaussian quantile
at p (Graybill and Wang, J. Am. Stat. Assoc. 75, 869, 1980).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri, ndtri

from ..inference.estimates import QUANTILES


class Part(NamedTuple):
    """A part of a variance, as an estimate from a sample.

    Attributes:
        variance: of the population.
        degrees: of freedom of its estimate.
    """

    variance: float
    degrees: float


def sampling_variance(parts: Sequence[Part]) -> float:
    """Variance of the sum of parts, sum 2 V_i^2 / nu_i."""
    return sum(2 * part.variance**2 / part.degrees for part in parts)


def deviation_quantiles(
    variance: float, noise: float, parts: Sequence[Part], *, relative: float = 0.0
) -> Float[np.ndarray, "5"]:
    """Ends of the intervals of a standard deviation.

    Example:
        >>> from fitting.noise.parts import Part, deviation_quantiles
        >>> low, _, middle, _, high = deviation_quantiles(1.0, 0.0, [Part(1.0, 15)])
        >>> np.round([low**2, middle, high**2], 3).tolist()  # 15 / 27.488, 15 / 6.262
        [0.546, 1.0, 2.395]
    """
    z = ndtri(QUANTILES)
    square = (z * noise) ** 2
    for part in parts:
        factor = part.degrees / chdtri(part.degrees, QUANTILES)
        square = square + np.where(z == 0, 0.0, (factor - 1) * part.variance) ** 2
    ratio = np.maximum(1 + np.sign(z) * np.sqrt(square) / variance, 0.0)
    with np.errstate(divide="ignore"):  # the logarithm of 0 is an end at 0
        steps = np.sign(z) * np.hypot(np.log(ratio) / 2, z * relative)
    return np.sqrt(variance) * np.exp(steps)
