"""Whether a model describes its data: chi-square, and neighbours that move together.

Standardised residuals r are standard normal and independent if it does. Then sum r^2 is chi-square
distributed, and the correlation of neighbours along an axis,

    rho = sum r_i r_(i+1) / sqrt(sum r_i^2 sum r_(i+1)^2),    rho sqrt(pairs) ~ Normal(0, 1).

A wrong optimum leaves structure even where a fitted noise swallows the chi-square.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import chdtrc, ndtri

CHANCE = 1e-3  # of calling a good fit a misfit, by each of the two tests


@dataclass(frozen=True)
class Misfit:
    """What the residuals of a fit show.

    Attributes:
        chi_square: sum of their squares.
        dof: data less what the parameters take up.
        p: chance of a larger chi-square; NaN without degrees of freedom.
        correlation: of neighbours along each axis.
        significance: the same in its own standard deviations.
        faults: sentences, empty when the model describes the data.
        remarks: sentences about residuals that are too small.
    """

    chi_square: float
    dof: float
    p: float
    correlation: tuple[float, ...]
    significance: tuple[float, ...]
    faults: tuple[str, ...]
    remarks: tuple[str, ...]


def judge(residuals: Float[np.ndarray, "..."], parameters: float) -> Misfit:
    """Both tests.

    Args:
        residuals: standardised, of any shape; NaN where a datum is missing.
        parameters: how many the data determine.

    Returns:
        The verdict.
    """
    present = ~np.isnan(residuals)
    chi_square = float(np.sum(residuals[present] ** 2))
    dof = float(present.sum() - parameters)
    faults, remarks = [], []
    p = float("nan")
    if dof > 0:
        p, other = float(chdtrc(dof, chi_square)), float(1 - chdtrc(dof, chi_square))
        if not p > CHANCE:
            faults.append(
                "The model does not describe the data within their noise: chi-square per degree of "
                f"freedom is {chi_square / dof:.4g}; {_largest(dof):.4g} is exceeded by chance in "
                f"one of {1 / CHANCE:.0f} cases."
            )
        elif other < CHANCE:
            remarks.append(
                f"The data scatter less than stated: chi-square per degree of freedom is "
                f"{chi_square / dof:.4g}; the intervals are too wide if the noise was overrated."
            )
    else:
        remarks.append("As many parameters as data: nothing is left to test the model by.")
    pairs = [_neighbours(residuals, axis) for axis in range(residuals.ndim)]
    limit = float(-ndtri(CHANCE / max(len(pairs), 1)))
    for axis, (correlation, significance) in enumerate(pairs):
        if significance > limit:
            faults.append(
                f"Residuals of neighbours along axis {axis} move together (correlation "
                f"{correlation:.2f}, {significance:.0f} standard deviations): the model misses "
                "structure in the data."
            )
    correlation, significance = zip(*pairs, strict=True) if pairs else ((), ())
    return Misfit(chi_square, dof, p, correlation, significance, tuple(faults), tuple(remarks))


def _neighbours(residuals: np.ndarray, axis: int) -> tuple[float, float]:
    """Correlation of neighbours along an axis, and in standard deviations."""
    along = np.moveaxis(residuals, axis, 0)
    one, other = along[:-1], along[1:]
    both = np.isfinite(one) & np.isfinite(other)
    one, other = one[both], other[both]
    size = float(np.sqrt(np.sum(one**2) * np.sum(other**2)))
    if size == 0:
        return 0.0, 0.0
    correlation = float(np.sum(one * other)) / size
    return correlation, correlation * np.sqrt(len(one))


def _largest(dof: float) -> float:
    """Chi-square per degree of freedom that is exceeded by chance (Wilson & Hilferty 1931)."""
    return (1 - 2 / (9 * dof) - ndtri(CHANCE) * np.sqrt(2 / (9 * dof))) ** 3
