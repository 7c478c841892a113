"""Test a model against its data by chi-square and by the correlation of neighbouring residuals.

Under the model, standardised residuals r are standard normal and independent. Then sum r^2 is
chi-square distributed, and the correlation of neighbours along an axis,

    rho = sum r_i r_(i+1) / sqrt(sum r_i^2 sum r_(i+1)^2),    rho sqrt(pairs) ~ Normal(0, 1).

The second test reveals a wrong optimum by the structure of its residuals, even if a fitted noise
level makes chi-square plausible.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import chdtrc, chdtri, ndtri

FAINT = 1e-3  # chi-square per degree of freedom below which structure is lost in the noise
CHANCE = 1e-3  # probability that each of the two tests calls a good fit a misfit


@dataclass(frozen=True)
class Misfit:
    """The results of the two tests: chi-square and the correlation of neighbouring residuals.

    Attributes:
        chi_square: sum of squared residuals.
        dof: number of data less the effective number of parameters.
        p: probability of a larger chi-square. NaN with less than one degree of freedom, unless p
            for one degree is below `CHANCE`.
        correlation: correlation of neighbouring residuals along each axis.
        significance: ratio of each correlation to its standard deviation.
        faults: sentences, empty when the model describes the data.
        remarks: sentences about residuals that are too small.
        count: number of data that are not missing.
    """

    chi_square: float
    dof: float
    p: float
    correlation: tuple[float, ...]
    significance: tuple[float, ...]
    faults: tuple[str, ...]
    remarks: tuple[str, ...]
    count: int


def sums(
    residuals: Float[np.ndarray, "..."], *, before: Float[np.ndarray, "..."] | None = None
) -> Float[np.ndarray, " sums"]:
    """Return the sums over standardised residuals (NaN where a datum is missing) that both tests
    need. The sums over parts of the data add up to those over all data.
    """
    present = ~np.isnan(residuals)
    found = [float(present.sum()), float(np.sum(residuals[present] ** 2))]
    for axis in range(residuals.ndim):
        along = np.moveaxis(residuals, axis, 0)
        if axis == 0 and before is not None:
            along = np.concatenate([before[None], along])
        one, other = along[:-1], along[1:]
        both = np.isfinite(one) & np.isfinite(other)
        one, other = one[both], other[both]
        found += [np.sum(one * other), np.sum(one**2), np.sum(other**2), len(one)]
    return np.array(found, np.float64)


def judge(residuals: Float[np.ndarray, "..."], parameters: float) -> Misfit:
    """Run both tests on standardised residuals, NaN where a datum is missing."""
    return judge_sums(sums(residuals), parameters)


def judge_sums(totals: Float[np.ndarray, " sums"], parameters: float) -> Misfit:
    """Run both tests on the sums over all data."""
    count, chi_square = int(totals[0]), float(totals[1])
    dof = float(count - parameters)
    faults, remarks = [], []
    p = float("nan")
    if 0 < dof < 1 and chdtrc(1, chi_square) < CHANCE:
        p = float(chdtrc(1, chi_square))
        faults.append(
            "The model does not describe the data within their noise: chi-square is "
            f"{chi_square:.4g} with less than one degree of freedom left; with one, "
            f"{_largest(1):.4g} is exceeded by chance in one of {1 / CHANCE:.0f} cases."
        )
    elif dof >= 1:
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
                f"{chi_square / dof:.4g}; the intervals are too wide if the noise is overrated."
            )
    else:
        remarks.append("There are no more data than parameters, so the fit cannot test the model.")
    pairs = []
    for product, one, next_one, number in totals[2:].reshape(-1, 4):
        size = float(np.sqrt(one * next_one))
        correlation = float(product) / size if size else 0.0
        pairs.append((correlation, correlation * float(np.sqrt(number))))
    limit = float(-ndtri(CHANCE / max(len(pairs), 1)))
    for axis, (correlation, significance) in enumerate(pairs):
        if significance > limit and chi_square > FAINT * dof:
            faults.append(
                f"Residuals of neighbours along axis {axis} are correlated (correlation "
                f"{correlation:.2f}, {significance:.0f} standard deviations): the model misses "
                "structure in the data."
            )
    correlation, significance = zip(*pairs, strict=True) if pairs else ((), ())
    return Misfit(
        *(chi_square, dof, p, correlation, significance),
        *(tuple(faults), tuple(remarks), count),
    )


def _largest(dof: float) -> float:
    """Return the chi-square per degree of freedom that chance exceeds with probability `CHANCE`."""
    return float(chdtri(dof, CHANCE)) / dof
