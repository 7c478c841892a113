"""Check whether priors and data agree, by comparing each prior with the information from everything
else.

Let F be a prior's distribution function and Phi that of N(0, 1). On the scale g = Phi^-1(F(x)) the
prior is N(0, 1). A prior density that decreases from its lower end is half a normal density on the
scale g = Phi^-1((1 + F(x)) / 2). Let H be the curvature of the log posterior at its mode, u the
unconstrained parameters, h the contribution of prior i to H_ii, and V = (H^-1)_ii. Without that
prior the variance is c = V / (1 - h V). The mode moves by c dL/du_i, where L is the log density of
all other terms. At the mode, dL/du_i is minus the slope of the log prior. With g taken at the moved
mode, prior and other information differ by z standard deviations:

    z = g / sqrt(1 + c (dg/du)^2).

Source:
    Box, "Sampling and Bayes' inference in scientific modelling and robustness", J. R. Stat. Soc. A
    143, 1980, the check of a prior by its predictive distribution.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.special import chdtrc, ndtr, ndtri

from ..inference.diagnostics import listed
from ..inference.formatting import format_with_error
from ..inference.joint_prior import JointPrior, Marginal, places_of, scores
from ..inference.likelihoods import Clustered
from ..inference.misfit import CHANCE, Misfit
from ..inference.parameters import Parameter, share_below, to_natural
from ..inference.priors import Gamma, HalfNormal, LogNormal, Normal, Prior, Uniform
from ..inference.problem import Problem, log_prior_at
from ..inference.search import Optimum
from .widening import Widening

LOOSE = 1e3  # factor on the width of a prior that leaves the decision to the data
LEAST = 1e-4  # smallest share of the data in the information on a parameter that is compared


def conflicts(problem: Problem, optimum: Optimum, wide: Widening) -> tuple[str, ...]:
    """Return sentences on the priors that differ significantly from the data, in order of
    decreasing difference.

    In a fraction `CHANCE` of fits with correct priors, at least one sentence is a false alarm."""
    space, joint = problem.space, problem.prior
    together = () if joint is None else places_of(joint, space)
    tested = [
        i
        for i, p in enumerate(space)
        if p.prior is not None and not isinstance(p.prior, Uniform) and i not in together
    ]
    if not (tested or joint) or not optimum.stationary:
        return ()
    vector = jnp.asarray(optimum.vector, jnp.result_type(float))
    chance = CHANCE / (len(tested) + (joint is not None))
    to_x = partial(to_natural, space)
    values, slopes = jax.jvp(to_x, (vector,), (jnp.ones_like(vector),))
    values, slopes = np.asarray(values, np.float64), np.asarray(slopes, np.float64)
    gradient = -np.asarray(jax.grad(partial(log_prior_at, problem))(vector), np.float64)
    known = np.diagonal(np.linalg.inv(optimum.curvature))
    prior_part = np.diagonal(optimum.prior_information)
    limit = -ndtri(chance / 2)
    found = []
    for i in tested:
        share = 1 - known[i] * prior_part[i]
        if not share > LEAST:
            continue
        variance = known[i] / share
        step = variance * gradient[i]
        spread = variance * wide.noise**2
        if isinstance(problem.likelihood, Clustered):  # its covariance has the prior's part too
            outer = wide.gaussian_covariance[i, i] - known[i] ** 2 * prior_part[i]
            spread = max(variance, outer / share**2)
        place, slope = _standard_scale(space[i].prior, values[i])
        turned = slope * slopes[i]
        z = (place + turned * step) / np.sqrt(1 + turned**2 * spread)
        if abs(z) > limit:
            alone = _estimate_without_prior(space[i], values[i], slopes[i], step, np.sqrt(spread))
            found.append((abs(z), _conflict_in_words(space[i], abs(z), alone)))
    if joint is not None and (one := _joint_conflict(problem, joint, vector, wide, chance)):
        found.append(one)
    return tuple(one for _, one in sorted(found, key=lambda pair: -pair[0]))


def _joint_conflict(
    problem: Problem, joint: JointPrior, vector: Array, wide: Widening, chance: float
) -> tuple[float, str] | None:
    """Compare a joint prior with all other information, in the directions that the data determine.
    The difference between the means of prior and posterior has the covariance of the prior minus
    that of the posterior (Hausman, Econometrica 46, 1978).
    """
    on_scale = partial(scores, joint, problem.space)
    z = np.asarray(on_scale(vector), np.float64)
    slope = np.asarray(jax.jacfwd(on_scale)(vector), np.float64)
    narrowed = joint.correlation - slope @ wide.gaussian_covariance @ slope.T
    root = np.linalg.cholesky(np.asarray(joint.correlation, np.float64))
    scaled = np.linalg.solve(root, np.linalg.solve(root, narrowed).T)
    values, axes = np.linalg.eigh(scaled)
    along = (axes.T @ np.linalg.solve(root, z))[values > LEAST]
    square = float(np.sum(along**2 / values[values > LEAST]))
    words = _joint_in_words(joint, square, len(along), chance)
    return (square**0.5, words[0]) if words else None


def loosen(prior: Any) -> Any:
    """Return a prior that is much wider, so that the estimate follows data that contradict the
    prior.
    """
    match prior:
        case Normal() | HalfNormal() | Marginal():
            return replace(prior, sd=LOOSE * prior.sd)
        case LogNormal():
            return replace(prior, log_sd=LOOSE * prior.log_sd)
        case Gamma():
            return LogNormal(float(prior.quantile(np.array(0.5))), LOOSE)
    return prior


def blame_priors(
    problem: Problem, vector: np.ndarray, wide: Widening, before: Misfit, alone: Misfit
) -> tuple[str, ...]:
    """Return sentences on the priors that contradict a fit with widened priors (see `loosen`), in
    order of decreasing difference. The result is empty if no prior contradicts the fit. If the fit
    with widened priors describes the data, these sentences replace the finding of a misfit.
    """
    space, joint = problem.space, problem.prior
    together = () if joint is None else places_of(joint, space)
    at = jnp.asarray(vector, jnp.result_type(float))
    values, slopes = jax.jvp(partial(to_natural, space), (at,), (jnp.ones_like(at),))
    values, slopes = np.asarray(values, np.float64), np.asarray(slopes, np.float64)
    errors, found = np.sqrt(np.diagonal(wide.gaussian_covariance)), []
    tested = [i for i, p in enumerate(space) if loosen(p.prior) != p.prior]
    limit = -ndtri(CHANCE / max(len(tested), 1) / 2)
    for i in tested:
        place, slope = _standard_scale(space[i].prior, values[i])
        z = abs(place) / float(np.hypot(1, slope * slopes[i] * errors[i]))
        if z > limit:
            own = _estimate_without_prior(space[i], values[i], slopes[i], 0.0, errors[i])
            found.append((z, _conflict_in_words(space[i], z, own, earlier=i in together)))
    sentences = [words for _, words in sorted(found, key=lambda pair: -pair[0])]
    if joint is not None:
        sentences = [*_joint_difference(problem, joint, at, wide), *sentences]
    if not sentences or not before.faults or before.p > CHANCE:
        return tuple(
            sentences
        )  # a width that is a parameter grows until it explains the difference
    return (
        f"{sentences[0]} The model does not describe the data because of it: chi-square per degree "
        f"of freedom is {before.chi_square / max(before.dof, 1):.4g}, and would be about "
        f"{alone.chi_square / max(alone.dof, 1):.2g} without that prior.",
        *sentences[1:],
    )


def _joint_difference(
    problem: Problem, joint: JointPrior, vector: Array, wide: Widening
) -> tuple[str, ...]:
    """Return a sentence on all numbers of a joint prior; empty if prior and data agree."""
    on_scale = partial(scores, joint, problem.space)
    z = np.asarray(on_scale(vector), np.float64)
    slope = np.asarray(jax.jacfwd(on_scale)(vector), np.float64)
    root = np.linalg.cholesky(np.asarray(joint.correlation, np.float64))
    scaled = np.linalg.solve(root, slope @ wide.gaussian_covariance @ slope.T)
    values, axes = np.linalg.eigh(np.linalg.solve(root, scaled.T))
    informative = values < 1 / LEAST  # directions in which the data are informative
    along = (axes.T @ np.linalg.solve(root, z))[informative]
    return _joint_in_words(
        joint, float(np.sum(along**2 / (1 + values[informative]))), len(along), CHANCE
    )


def _joint_in_words(
    joint: JointPrior, square: float, numbers: int, chance: float
) -> tuple[str, ...]:
    if not numbers or chdtrc(numbers, square) > chance:
        return ()
    return (
        f"The prior of {listed(list(joint.names))}, from an earlier fit, differs from what the "
        f"data alone say by a chi-square of {square:.4g} for {numbers} "
        f"degree{'s' * (numbers > 1)} of freedom: one of them is wrong, or its error is too "
        "small.",
    )


def _standard_scale(prior: Prior, x: float) -> tuple[float, float]:
    """Return a value g on the scale on which its prior is N(0, 1), and the derivative dg/dx."""
    match prior:
        case Normal():
            return (x - prior.mean) / prior.sd, 1 / prior.sd
        case LogNormal():
            return float(np.log(x / prior.median)) / prior.log_sd, 1 / (x * prior.log_sd)
        case HalfNormal():
            return x / prior.sd, 1 / prior.sd
        case Marginal():
            place, slope = jax.value_and_grad(prior.score)(jnp.asarray(x))
            return float(place), float(slope)
    below = share_below(prior, x)
    density = float(np.exp(prior.log_density(jnp.asarray(x))))
    if _falls(prior):
        below, density = (1 + below) / 2, density / 2
    place = float(ndtri(below))
    if abs(place) < 6:
        return place, float(density * np.sqrt(2 * np.pi) * np.exp(place**2 / 2))
    # Where a share rounds to 1, extrapolate linearly from the quantiles at g = 1 and 2.
    one, two = (_quantile(prior, np.sign(place) * k) for k in (1.0, 2.0))
    slope = float(np.sign(place) / (two - one))
    return float(np.sign(place) + slope * (x - one)), slope


def _quantile(prior: Prior, g: float) -> float:
    share = ndtr(g)
    return float(prior.quantile(np.array(2 * share - 1 if _falls(prior) else share)))


def _falls(prior: Prior) -> bool:
    """Return whether a density decreases from its lower end."""
    first, middle = (prior.log_density(jnp.asarray(prior.quantile(np.array(p)))) for p in (0, 0.5))
    return bool(np.isfinite(first) and first > middle)


def _estimate_without_prior(p: Parameter, x: float, slope: float, step: float, error: float) -> str:
    """Return, in words, the estimate of a parameter without its prior. For a parameter with a log
    transform, the estimate is computed on the logarithmic scale.
    """
    if p.transform == "log":
        best = float(x * np.exp(slope * step / x))
        return format_with_error(best, float(best * slope / x * error))
    return format_with_error(x + slope * step, abs(slope) * error)


def _conflict_in_words(p: Parameter, z: float, alone: str, *, earlier: bool = False) -> str:
    low, middle, high = (p.prior.quantile(ndtr(np.array(k))) for k in (-1.0, 0.0, 1.0))
    return (
        f"The prior of {p.name}{' in it' * earlier}, {middle:.4g} ± {(high - low) / 2:.3g}, lies "
        f"{z:.1f} standard deviations from what the data alone say ({alone})"
        f"{': one of them is wrong, or its error is too small' * (not earlier)}."
    )
