"""Compare Laplace's approximation, emcee and NUTS, at various chain lengths, on one posterior
density.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxvision.accuracy.records import Compute

from ..inference.emcee_run import Emcee
from ..inference.nuts import Nuts, nuts
from ..inference.parameters import ParameterSpace, unconstrained_numbers
from ..inference.posterior import LogDensity, Posterior, laplace, sample

ENDS = (0.025, 0.16, 0.5, 0.84, 0.975)  # of the 95 and 68 % intervals, and the middle
BLOCK = 100  # steps between two assessments
Turn = Callable[[Any], Compute]


@dataclass(frozen=True)
class Density:
    """A log density, with its mode and the covariance of Laplace's approximation there."""

    # module-level function of (vector, args) that returns the log density up to a constant
    log_density: LogDensity
    space: ParameterSpace  # the P parameters
    mode: Any  # (P,) vector of unconstrained values where the density is largest
    # (P, P) of Laplace's Gaussian about the mode
    covariance: Float[np.ndarray, "parameters parameters"]
    args: Any  # the data, passed to `log_density` as its second argument

    @property
    def errors(self) -> Float[np.ndarray, " parameters"]:
        """Return the standard errors of the unconstrained parameters."""
        return np.sqrt(np.diagonal(self.covariance))


def interval_ends(posterior: Posterior, density: Density) -> Float[np.ndarray, "ends parameters"]:
    """Return quantiles of a posterior's draws, in standard errors from the mode."""
    ends = np.quantile(posterior.samples, ENDS, axis=0)
    vectors = unconstrained_numbers(density.space, ends)
    return (vectors - np.asarray(density.mode)) / density.errors


def chain_knobs(density: Density) -> Mapping[str, Turn]:
    """Return functions that vary the sampler and its chain length, by the setting's name."""
    about = (density.log_density, density.space, density.mode, density.covariance, density.args)

    def sampler(options: Emcee | Nuts | None) -> Compute:
        def compute(seed: int) -> np.ndarray:
            if isinstance(options, Nuts):
                found = nuts(*about, options=options, seed=seed)
            else:
                found = sample(*about, options=options, seed=seed)
            return interval_ends(found, density)

        return compute

    def gaussian(draws: int) -> Compute:
        return lambda seed: interval_ends(
            laplace(
                density.log_density,
                density.space,
                density.mode,
                density.args,
                covariance=density.covariance,
                draws=draws,
                seed=seed,
            ),
            density,
        )

    ways = {"laplace": gaussian(100_000), "nuts": sampler(Nuts()), "emcee": sampler(None)}
    return {
        "posterior": ways.__getitem__,
        "chain length": lambda steps: sampler(Emcee(steps=steps, block=min(BLOCK, steps))),
        "NUTS draws": lambda draws: sampler(Nuts(draws=draws)),
        "Laplace draws": gaussian,
    }
