"""Errors that a likelihood can neglect, because no fit can detect them.

In units of their noise, the data have the covariance 1 without an error h that they share, and 1 +
h h' with it. The 2-Wasserstein distance of the two distributions is

    sqrt(1 + |h|^2) - 1,     |h|^2 = sum of h^2 / Var,

The squared distances of independent parts of the data add. A fixed shift h of all data has the
distance |h|. If the distance is at most .1, an error h moves no estimate by more than a tenth of
its standard deviation. The likelihood then omits the error.

Source:
    Dowson and Landau, "The Frechet distance between multivariate normal distributions", J.
    Multivariate Analysis 12 (1982).
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

TOLERANCE = 0.1  # standard deviations of the noise of all data


@dataclass(frozen=True)
class LeftOut:
    """An error that a likelihood omits.

    Attributes:
        name: of the error, in the rig or the model.
        size: as the rig states it, in its unit; None where it is estimated from the data.
        bound: largest change of the expected data that the error causes, in standard deviations of
            their noise.
    """

    name: str
    size: float | None
    bound: float


def distance(
    squares: Float[np.ndarray, "..."], *, parts: float | Float[np.ndarray, "..."] = 1.0
) -> float:
    """The change of the data's distribution by errors of independent parts."""
    return float(np.sqrt(np.sum(parts * (np.sqrt(1 + squares) - 1) ** 2)))


def negligible(errors: Iterable[LeftOut]) -> tuple[LeftOut, ...]:
    """The errors that may be omitted together."""
    found = sorted(errors, key=lambda own: own.bound)
    total = np.cumsum([own.bound for own in found])
    return tuple(own for own, moved in zip(found, total, strict=True) if moved <= TOLERANCE)
