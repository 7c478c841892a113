"""Find errors that a likelihood can neglect because no fit can detect them.

Suppose that all data share an error with a standard deviation of h_i in datum i. In units of the
noise, the data have the identity as covariance without this error, and 1 + h h' with it. The
2-Wasserstein distance of the two distributions is

    sqrt(1 + |h|^2) - 1,     |h|^2 = sum of h^2 / Var,

where Var is the noise variance. The squared distances of independent parts of the data add. For a
fixed shift h of all data the distance is |h|. If the distance is at most 0.1, the error moves no
estimate by more than a tenth of its standard deviation, and the likelihood omits it.

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
    """An error that a likelihood omits."""

    name: str  # name of the error, in the rig or the model
    # size that the rig states, in its unit; None where it is estimated from the data
    size: float | None
    # largest change of the expected data that the error causes, in standard deviations of their
    # noise
    bound: float


def distance(
    squares: Float[np.ndarray, "..."], *, parts: float | Float[np.ndarray, "..."] = 1.0
) -> float:
    """Return the 2-Wasserstein distance by which independent errors change the data's
    distribution."""
    return float(np.sqrt(np.sum(parts * (np.sqrt(1 + squares) - 1) ** 2)))


def negligible(errors: Iterable[LeftOut]) -> tuple[LeftOut, ...]:
    """Return the errors that may be omitted together."""
    found = sorted(errors, key=lambda own: own.bound)
    total = np.cumsum([own.bound for own in found])
    return tuple(own for own, moved in zip(found, total, strict=True) if moved <= TOLERANCE)
