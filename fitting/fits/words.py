"""What a fit shows, in sentences."""

import jax.numpy as jnp
import numpy as np

from ..inference.diagnostics import identifiability, listed
from ..inference.misfit import Misfit
from ..inference.parameters import ParameterSpace, ends, names, prior_values
from ..inference.posterior import Posterior, convergence_in_words
from ..inference.problem import Problem
from ..inference.search import SAME_PLACE, Optimum

PRIOR_ALONE = 0.7  # posterior over prior standard deviation from which the prior is what is seen
SKEWED = 0.3  # unconstrained standard deviation from which a Gaussian may mislead
APART = 5.0  # standard deviations between two optima
AT_END = 0.01  # share of a range that is its end


def verdict(optimum: Optimum, checks: Misfit, explanation: tuple[str, ...]) -> list[str]:
    """Why the end of a search is no fit; empty if it is one.

    Args:
        optimum: the end.
        checks: of its residuals.
        explanation: of a misfit, where one is allowed for.

    Returns:
        Sentences.
    """
    failures = []
    if not optimum.stationary:
        failures.append(
            "The search stopped before a maximum: another step promises "
            f"{optimum.decrement:.2g} in log density; try more starts, or narrower bounds."
        )
    if not explanation:
        failures += checks.faults
    elif checks.faults and agreeing(optimum) < 2:
        failures.append(
            "A misfit is allowed for, so that only the agreement of several starts can tell the "
            "best optimum, and none agrees with this one: use more starts."
        )
    return failures


def agreeing(optimum: Optimum) -> int:
    """How many searches ended as deep as the best."""
    return int(np.sum(optimum.costs < SAME_PLACE))


def about_search(optimum: Optimum) -> list[str]:
    """Another place that fits as well, where the searches found one."""
    values, axes = np.linalg.eigh(optimum.information)
    root = np.sqrt(np.maximum(values, 0))[:, None] * axes.T
    distance = np.linalg.norm((optimum.ends - optimum.vector) @ root.T, axis=-1)
    limit = APART * np.sqrt(len(optimum.vector))
    others = int(np.sum((optimum.costs < SAME_PLACE) & (distance > limit)))
    if not others:
        return []
    return [
        f"{others} of {len(optimum.costs)} starts ended elsewhere and fit as well: the data allow "
        "several answers; bounds or a prior that exclude the others would choose one."
    ]


def about_posterior(problem: Problem, optimum: Optimum, posterior: Posterior) -> tuple[str, ...]:
    """What the data cannot tell, what only the prior tells, and how far the intervals hold.

    Args:
        problem: that was fitted.
        optimum: its best fit.
        posterior: of all parameters.

    Returns:
        Sentences.
    """
    found = [*identifiability(problem.space, optimum.data_information).sentences]
    found += _prior_alone(problem.space, posterior)
    found += _at_ends(problem.space, posterior)
    if posterior.method == "Laplace":
        spread = np.sqrt(np.diagonal(posterior.covariance))
        skew = [name for name, sd in zip(names(problem.space), spread, strict=True) if sd > SKEWED]
        if skew:
            found.append(
                f"The intervals of {listed(skew)} are wide, so that a Gaussian may misjudge them: "
                "posterior='emcee' or 'nuts' draws from the posterior itself."
            )
    found.append(convergence_in_words(posterior))
    if problem.data.dtype != jnp.float64:
        found.append(
            "Computed with 7 digits: jax.config.update('jax_enable_x64', True) gives 16, which a "
            "search for an optimum can use."
        )
    return tuple(found)


def prior_share(space: ParameterSpace, posterior: Posterior) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations before the data, in each parameter's unit, and posterior over prior.

    Args:
        space: the P parameters.
        posterior: of them.

    Returns:
        (P,) infinite without a prior, and (P,) 0 there.
    """
    known = [prior_values(parameter) for parameter in space]
    before = np.array([np.inf if x is None else np.std(x) for x in known])
    return before, np.std(posterior.samples, axis=0) / before


def _prior_alone(space: ParameterSpace, posterior: Posterior) -> list[str]:
    before, share = prior_share(space, posterior)
    return [
        f"{parameter.name} is known from its prior or bounds, hardly from the data: its standard "
        f"deviation is {part * width:.3g} after and {width:.3g} before them."
        for parameter, width, part in zip(space, before, share, strict=True)
        if part > PRIOR_ALONE
    ]


def _at_ends(space: ParameterSpace, posterior: Posterior) -> list[str]:
    found = []
    for parameter, value in zip(space, posterior.mode, strict=True):
        low, high = ends(parameter)
        width = high - low
        if not np.isfinite(width):
            continue
        for end, distance in (("lower", value - low), ("upper", high - value)):
            if distance < AT_END * width and parameter.transform == "identity":
                found.append(
                    f"{parameter.name} lies at the {end} end of its range: the data may want it "
                    "beyond."
                )
    return found
