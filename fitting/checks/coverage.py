"""Coverage of intervals, from the cumulative probability of the true value in each posterior.

For one fit, u is the cumulative probability of the true value in its posterior. If the posteriors
are right, u is uniform between 0 and 1 over many simulations. An interval of probability q contains
the true value if |u - 1/2| < q / 2. The normal deviate of u is z = Phi^-1(u). The ranks in
simulation-based calibration (Talts et al. 2018) are values of u rounded to whole steps.
Kolmogorov's test compares the largest distance of the cumulative distribution of u from the
diagonal with the distance expected by chance. If the posteriors are right, the sum of z^2 over the
fits has a chi-square distribution. Of these tests, the chi-square test needs the fewest fits to
detect standard errors that are too small or too large.
"""

import warnings
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri
from scipy.stats import binom, chi2, kstwo

from ..inference.formatting import format_percent

LEVELS = (0.50, 0.68, 0.95)
CHANCE = 0.01  # probability of flagging a correct fit, over all parameters and tests together
EDGE = 1e-12  # smallest distance of u from 0 and 1
FARTHEST = 3.7  # largest |z| that a few thousand draws of a posterior determine
TESTS = len(LEVELS) + 2


@dataclass(frozen=True)
class Coverage:
    """Coverage of the intervals of one parameter."""

    name: str  # name of the parameter
    simulations: int  # number of fits that gave an interval
    # share of the intervals that contain the true value, for each nominal probability in `LEVELS`
    covered: tuple[float, ...]
    # (low, high) range of `covered` that chance explains, for each nominal probability
    band: tuple[tuple[float, float], ...]
    z_mean: float  # mean of z
    z_sd: float  # standard deviation of z; 1 if errors are right, larger if they are too small
    departure: float  # largest distance of the cumulative distribution of u from the diagonal
    allowed: float  # largest distance from the diagonal that chance explains
    # a sentence on each of these figures that is outside the range explained by chance
    faults: tuple[str, ...]

    @property
    def held(self) -> tuple[float, ...]:
        """Former name of `covered`."""
        warnings.warn("Coverage.held is now Coverage.covered.", DeprecationWarning, stacklevel=2)
        return self.covered


def coverage(
    places: Float[np.ndarray, "simulations parameters"], names: tuple[str, ...]
) -> tuple[Coverage, ...]:
    """Test whether the intervals of many fits have the right coverage, from the cumulative
    probability `places` of each true value in its posterior.

    Example:
        >>> from fitting.checks.coverage import coverage
        >>> narrow = np.random.default_rng(0).beta(0.7, 0.7, size=(2000, 1))
        >>> coverage(narrow, ("gain",))[0].faults[0]
        '39 % of the 50 % intervals contain the truth'
    """
    chance = CHANCE / (len(names) * TESTS)
    return tuple(
        _coverage_of(u[np.isfinite(u)], name, chance)
        for u, name in zip(places.T, names, strict=True)
    )


def _coverage_of(u: np.ndarray, name: str, chance: float) -> Coverage:
    count = len(u)
    covered = tuple(float(np.mean(np.abs(u - 0.5) < q / 2)) if count else np.nan for q in LEVELS)
    ends = [binom.ppf((chance / 2, 1 - chance / 2), count, q) / max(count, 1) for q in LEVELS]
    band = tuple((float(low), float(high)) for low, high in ends)
    z = ndtri(np.clip(u, EDGE, 1 - EDGE))
    ranked = np.sort(u)
    steps = np.arange(count + 1) / max(count, 1)
    departure = float(np.max(np.maximum(steps[1:] - ranked, ranked - steps[:-1]), initial=0.0))
    allowed = float(kstwo.ppf(1 - chance, max(count, 1)))
    faults = [
        f"{format_percent(share)} of the {format_percent(q)} intervals contain the truth"
        for q, share, (low, high) in zip(LEVELS, covered, band, strict=True)
        if count and not low <= share <= high
    ]
    if departure > allowed:
        faults.append(f"ranks depart by {departure:.3f} (chance explains {allowed:.3f})")
    scatter = float(np.sqrt(np.mean(np.clip(z, -FARTHEST, FARTHEST) ** 2))) if count else np.nan
    low, high = np.sqrt(chi2.ppf((chance / 2, 1 - chance / 2), max(count, 1)) / max(count, 1))
    if count and not low <= scatter <= high:
        faults.append(f"z scatters by {scatter:.2f} (chance explains {low:.2f} to {high:.2f})")
    return Coverage(
        *(name, count, covered, band),
        *(float(np.mean(z)) if count else np.nan, float(np.std(z)) if count else np.nan),
        *(departure, allowed, tuple(faults)),
    )
