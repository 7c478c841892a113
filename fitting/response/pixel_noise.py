"""The noise of a pixel's log exposure:  var(ln X) = relative + shot / X + read / X^2."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class NoiseModel:
    """Variance of ln X at relative exposure X: relative + shot / X + read / X^2.

    Attributes:
        relative: of the pixels' own gains.
        shot: at mid-scale.
        read: at mid-scale.
    """

    relative: float
    shot: float
    read: float


def noise_variance(
    noise: NoiseModel, log_exposure: Float[np.ndarray, " points"]
) -> Float[np.ndarray, " points"]:
    """Variance of the logarithm of an exposure because of noise."""
    inverse = np.exp(-log_exposure)
    return noise.relative + noise.shot * inverse + noise.read * inverse**2
