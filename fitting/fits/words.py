"""Write the findings of a fit as sentences."""

import jax.numpy as jnp
import numpy as np

from ..inference.diagnostics import identifiability, listed
from ..inference.joint_prior import Marginal
from ..inference.misfit import Misfit
from ..inference.parameters import (
    ParameterSpace,
    ends,
    natural_numbers,
    prior_values,
    scaled_ends,
)
from ..inference.posterior import PRIOR_RATIO, Posterior, piled_at
from ..inference.problem import Problem
from ..inference.search import SAME_PLACE, Optimum, rounding_of_digits
from ..inference.trust import convergence_in_words, is_trusted

FLAT = 0.3  # share of a parameter in the flattest direction from which it is named
SKEWED = 0.3  # unconstrained standard deviation from which a Gaussian may mislead
SAME_END = 0.02  # difference in cost from which two searches count as different optima
MANY_OPTIMA = 0.4  # share of searches ending alone from which four must agree
HARDLY = 0.95  # posterior over an earlier fit's s.d., from which the data add little
APART = 5.0  # standard deviations between two optima that are reported as different
NARROWEST = 1e-4  # smallest scaled eigenvalue that is used to compare optima
# Standard deviations from a bound to the median: .7 for a density that falls off from the bound,
# 1.1 for half a Gaussian, 1.7 for a flat one.
AT_END = 1.25


def no_maximum(problem: Problem, optimum: Optimum) -> list[str]:
    """Return the reason why a search did not end at a maximum; an empty list if it did."""
    if optimum.saddle:
        return [
            "The search ended at a saddle, from which the density rises to both sides: "
            f"{_bounds_to_give(problem, optimum)}try more starts."
        ]
    if optimum.stationary:
        return []
    promise = f"one more step would raise the log density by {optimum.decrement:.2g}"
    if not np.isfinite(optimum.decrement):
        promise = "its last step led uphill"
    return [
        f"The search stopped before a maximum: {promise}; {_bounds_to_give(problem, optimum)}try "
        "more starts, narrower bounds, or transform='log' for a number whose size is unknown."
    ]


def _bounds_to_give(problem: Problem, optimum: Optimum) -> str:
    """Return advice to bound the parameters along which the density is flat or rises, if they have
    no prior and lack a lower or an upper bound."""
    scale = np.sqrt(np.abs(np.diagonal(optimum.information)))
    scale = np.where(scale > 0, scale, 1)
    _, axes = np.linalg.eigh(np.nan_to_num(optimum.information / np.outer(scale, scale)))
    open_ = [
        parameter.name
        for parameter, part in zip(problem.space, axes[:, 0], strict=True)
        if parameter.prior is None and not np.isfinite(ends(parameter)).all() and abs(part) > FLAT
    ]
    if not open_:
        return ""
    return f"give {listed(open_)} a prior or bounds at both ends, as nothing limits it, or "


def verdict(
    problem: Problem, optimum: Optimum, checks: Misfit, explained: bool, *, wide_noise: bool = False
) -> list[str]:
    """Return the reasons why the end of a search is not accepted as a fit, if there are any."""
    failures = no_maximum(problem, optimum)
    if len(optimum.costs) == 1 and wide_noise:
        failures.append(
            "The width of the noise was fitted. At a wrong optimum it grows until the misfit "
            "counts as noise, so only the agreement of several starts confirms an optimum: use "
            "more starts."
        )
    elif len(optimum.costs) > 1 and not is_confirmed(optimum, wide_noise=wide_noise):
        failures.append(
            f"Of {len(optimum.costs)} starts {agreeing(optimum)} reached this optimum, the others "
            "ended at worse optima, so a better one may have been missed; give more starts, "
            "narrower bounds or a start."
        )
    if not explained:
        failures += checks.faults
    elif checks.faults and agreeing(optimum) < 2:
        failures.append(
            "A misfit is allowed, so only the agreement of several starts confirms an optimum, and "
            "no other start agrees with this one: use more starts."
        )
    return failures


def few_digits(problem: Problem, optimum: Optimum) -> list[str]:
    """Return the reason for a failure if the predictions have too few digits for searches to find
    the minimum of the cost; otherwise an empty list."""
    vector = jnp.asarray(optimum.vector, jnp.result_type(float))
    blur, size, share = (float(x) for x in rounding_of_digits(vector, problem)[1:])
    if not blur > SAME_END:
        return []
    name = jnp.result_type(float).name
    wider = "" if name == "float64" else "jax.config.update('jax_enable_x64', True), or "
    return [
        f"Predictions near {size:.3g} have their last digit in {name} at {share:.2g} times the "
        f"noise of the data, so that rounding moves the log density by about {blur:.2g} and hides "
        f"its maximum: {wider}subtract a constant from data and predictions."
    ]


def agreeing(optimum: Optimum) -> int:
    """Return the number of searches that reached the lowest cost."""
    return int(np.sum(optimum.costs < _optimum_separation(optimum)))


def _optimum_separation(optimum: Optimum) -> float:
    """Return the difference in cost above which two searches count as different optima. The
    difference is larger if the gradient is inaccurate, because such searches stop only near the
    optimum.
    """
    return SAME_PLACE if optimum.unseen else SAME_END


def is_confirmed(optimum: Optimum, *, wide_noise: bool = False) -> bool:
    """Return whether enough searches from different starts ended at the best optimum. Two searches
    are enough, but four are needed if the width of the noise was fitted, because residuals then do
    not reveal a
    wrong optimum, or if most searches ended at different optima. The share of searches that end
    alone estimates the chance that one more search finds a new optimum.

    Source:
        Good, "The population frequencies of species and the estimation of population parameters",
        Biometrika 40, 1953.
    """
    depths = np.sort(optimum.costs)
    apart = np.diff(depths, prepend=-np.inf, append=np.inf) > _optimum_separation(optimum)
    alone = np.mean(apart[1:] & apart[:-1])
    return agreeing(optimum) >= (4 if wide_noise or alone >= MANY_OPTIMA else 2)


def search_findings(optimum: Optimum, posterior: Posterior) -> list[str]:
    """Return a finding on other optima that fit as well, if the searches found any."""
    ends = natural_numbers(posterior.space, optimum.ends)
    spread = np.cov(posterior.samples.T).reshape(len(posterior.space), -1)
    size = np.sqrt(np.diagonal(spread))
    size = np.where(size > 0, size, 1)
    values, axes = np.linalg.eigh(spread / np.outer(size, size))
    apart = (ends - ends[np.argmin(optimum.costs)]) / size @ axes
    distance = np.linalg.norm(apart / np.sqrt(np.maximum(values, NARROWEST)), axis=-1)
    limit = APART * np.sqrt(len(size))
    others = int(np.sum((optimum.costs < SAME_PLACE) & (distance > limit)))
    if not others:
        return []
    return [
        f"{others} of {len(optimum.costs)} starts ended elsewhere and fit as well: the data allow "
        "several solutions. Narrower bounds or a prior can select one."
    ]


def left_out_findings(problem: Problem) -> list[str]:
    """Return sentences on how far each dropped effect may move the target of `called_for`."""
    gone = () if problem.left_out is None else problem.left_out.dropped
    return [f"Leaving out {e.name} {e.why}." for e in gone if e.rank == "estimate"]


def chain_failures(posterior: Posterior) -> list[str]:
    """Return the reason why the draws of a posterior are unreliable; empty if they are reliable."""
    return [] if is_trusted(posterior) else [convergence_in_words(posterior)]


def posterior_findings(problem: Problem, optimum: Optimum, posterior: Posterior) -> tuple[str, ...]:
    """Return sentences on parameters that are not identifiable, on parameters that only the prior
    determines, and on the validity of the intervals.
    """
    found = []
    if len(optimum.costs) == 1:
        found.append("Only one search was made, so a better optimum may have been missed.")
    if optimum.unseen:
        found.append(
            f"The gradient by {listed(list(optimum.unseen))} misses up to "
            f"{min(max(optimum.unseen.values()), 1):.0%} of what finite differences show, as where "
            "edges of shadows or outlines move: convergence and curvature are those of finite "
            "differences."
        )
    if not optimum.saddle and not posterior.shifted:
        judged = identifiability(problem.space, optimum.data_information, vector=optimum.vector)
        found += judged.sentences
    found += _prior_alone(problem.space, posterior)
    found += _bound_findings(problem.space, posterior)
    if posterior.method == "Laplace" and problem.stream is not None:
        spread = np.sqrt(np.diagonal(posterior.covariance))
        skew = [
            parameter.name
            for parameter, sd in zip(problem.space, spread, strict=True)
            if sd > SKEWED  # a Gaussian in a number on its own scale has no skewness
            and (parameter.transform != "identity" or np.isfinite(ends(parameter)).any())
        ]
        if skew:
            found.append(
                f"The intervals of {listed(skew)} are wide, so that a Gaussian may misjudge them: "
                "posterior=Emcee() or Nuts() draws from the posterior itself."
            )
    if is_trusted(posterior):
        found.append(convergence_in_words(posterior))
    if problem.data.dtype != jnp.float64:
        found.append(
            "The fit was computed with 7 digits. jax.config.update('jax_enable_x64', True) gives "
            "16, with which searches find optima more accurately."
        )
    return tuple(found)


def prior_share(space: ParameterSpace, posterior: Posterior) -> tuple[np.ndarray, np.ndarray]:
    """Return the prior standard deviations in each parameter's unit, and the ratios of posterior to
    prior standard deviation. Without a prior the two values are infinity and 0.
    """
    known = [prior_values(parameter) for parameter in space]
    before = np.array([np.inf if x is None else np.std(x) for x in known])
    return before, np.std(posterior.samples, axis=0) / before


def _prior_alone(space: ParameterSpace, posterior: Posterior) -> list[str]:
    before, share = prior_share(space, posterior)
    return [
        f"{parameter.name} is known from its prior or bounds, hardly from the data: its standard "
        f"deviation is {part * width:.3g} with the data and {width:.3g} without them."
        for parameter, width, part in zip(space, before, share, strict=True)
        if part > (HARDLY if isinstance(parameter.prior, Marginal) else PRIOR_RATIO)
    ]


def _bound_findings(space: ParameterSpace, posterior: Posterior) -> list[str]:
    """Return findings on bounds close enough to truncate the posterior of a parameter."""
    found = []
    _, share = prior_share(space, posterior)
    for parameter, natural, known in zip(space, posterior.samples.T, share, strict=True):
        side = piled_at(parameter, natural) if posterior.sampled else ""
        draws = natural if parameter.transform == "identity" else np.log(natural)
        low, high = scaled_ends(parameter)
        middle, sd = np.median(draws), np.std(draws)
        for end, distance in (("lower", middle - low), ("upper", high - middle)):
            if not (side == end or (distance < AT_END * sd and known <= PRIOR_RATIO)):
                continue
            begins = ", and its 95 % interval begins there" if side == end else ""
            found.append(
                f"{parameter.name} lies {distance / sd:.1f} standard deviations from the {end} "
                f"end of its range: its best value may lie beyond{begins}."
            )
    return found
