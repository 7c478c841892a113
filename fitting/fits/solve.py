"""`fit`: a problem to its posterior, with a verdict."""

from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxvision.errors import InputError

from ..inference.clustering import cluster_robust, curvature_stretch
from ..inference.diagnostics import identifiability
from ..inference.emcee_run import SamplingOptions
from ..inference.likelihoods import Clustered
from ..inference.misfit import Misfit, judge
from ..inference.nuts import NutsOptions, nuts, require_blackjax
from ..inference.posterior import Posterior, laplace, sample
from ..inference.problem import (
    Problem,
    Vector,
    likelihood_at,
    log_density,
    log_likelihood_terms,
    prediction,
    values_at,
)
from ..inference.search import Optimum, search, spread_starts, start_at
from .result import Fit
from .words import about_posterior, about_search, verdict

Options = SamplingOptions | NutsOptions


def fit(
    problem: Problem,
    *,
    start: dict[str, Any] | None = None,
    starts: int = 16,
    posterior: Literal["laplace", "emcee", "nuts"] = "laplace",
    misfit: Literal["fail", "inflate"] = "fail",
    sampling: Options | None = None,
    seed: int = 0,
) -> Fit:
    """Fits a problem: the best of many searches, its posterior, and whether to believe it.

    A second fit of a problem with equal shapes and the same `predict` compiles nothing
    (`Problem.with_data`). Nothing is raised for a fit that does not converge: read `converged` and
    `failures`, or print the result.

    Args:
        problem: parameters, model, likelihood and data.
        start: natural values by name, in their units, from which the only search begins; None for
            `starts` of them.
        starts: searches spread over bounds and priors, of which the best is kept.
        posterior: `laplace`, a Gaussian about the mode of the unconstrained values; or draws from
            the exact posterior, by `emcee`, an ensemble that needs no gradient, or by `nuts`, whose
            chains follow the gradient: for many parameters, and where `predict` is smooth (the
            `nuts` extra).
        misfit: what to do where the data scatter more than the likelihood says: `fail` to converge,
            or `inflate` the intervals by the square root of chi-square per degree of freedom
            (Birge's factor), which takes the model for a sufficient approximation.
        sampling: how long to sample: `SamplingOptions` of emcee, `NutsOptions` of NUTS; None for
            their defaults.
        seed: of starts and draws.

    Returns:
        The fit.

    Raises:
        InputError: for a start that names no parameter, a model that is finite nowhere, data that
            leave a direction open, and NUTS without blackjax.

    Example:
        >>> from fitting import Gaussian, Parameter, Problem, fit
        >>> time = jnp.linspace(0.0, 3.0, 50)
        >>> noise = 0.01 * np.random.default_rng(0).standard_normal(50)
        >>> problem = Problem(
        ...     {"height": Parameter(lower=0, upper=10), "rate": Parameter(lower=0, upper=5)},
        ...     predict=lambda height, rate, inputs: height * jnp.exp(-rate * inputs),
        ...     likelihood=Gaussian(sd=0.01),
        ...     data=2 * np.exp(-1.3 * time) + noise,
        ...     inputs=time,
        ... )
        >>> result = fit(problem)
        >>> result.converged
        True
        >>> abs(float(result.values["rate"]) - 1.3) < 0.05
        True
    """
    options = _options(posterior, sampling)
    if start is None:
        begin = spread_starts(problem, starts, seed=seed)
    else:
        begin = _given(problem, start)[None]
    optimum = search(problem, begin)
    vector = jnp.asarray(optimum.vector, jnp.result_type(float))
    judged = identifiability(problem.space, optimum.information)
    if not judged.determined:
        raise InputError(" ".join(judged.sentences))
    covariance = _inverse(optimum)
    residuals = _residuals(problem, vector)
    determined = float(np.trace(optimum.data_information @ covariance))
    checks = judge(residuals, determined)
    widened, words, explained = _widened(problem, vector, optimum, covariance, checks, misfit)
    drawn = _draw(problem, vector, optimum, widened, options, seed)
    failures = verdict(optimum, checks, words if explained else ())
    failures += about_search(optimum)
    findings = (*words, *checks.remarks, *about_posterior(problem, optimum, drawn))
    return Fit(problem, optimum, drawn, checks, residuals, tuple(failures), findings)


def _options(posterior: str, sampling: Options | None) -> Options | None:
    """How to run the sampler, None for Laplace; what cannot be run is said before the search."""
    kinds = {"laplace": type(None), "emcee": SamplingOptions, "nuts": NutsOptions}
    if posterior not in kinds:
        raise InputError(f"posterior = {posterior!r}: use 'laplace', 'emcee' or 'nuts'.")
    if posterior == "nuts":
        require_blackjax()
    if sampling is None:
        return kinds[posterior]()
    if not isinstance(sampling, kinds[posterior]):
        raise InputError(
            f"posterior = {posterior!r} does not go with {type(sampling).__name__}: "
            "SamplingOptions are emcee's, NutsOptions those of NUTS."
        )
    return sampling


def _given(problem: Problem, start: dict[str, Any]) -> np.ndarray:
    """One start from natural values by name."""
    wanted = {parameter.name: parameter for parameter in problem.free}
    for name in (*start, *wanted):
        if name in start and name in wanted:
            continue
        what = "is no free parameter" if name in start else "has no value"
        raise InputError(f"start: {name!r} {what}; give one of each: {', '.join(wanted)}.")
    parts = [
        np.broadcast_to(np.asarray(start[p.name], np.float64), p.shape or ()).ravel()
        for p in problem.free
    ]
    return start_at(problem.space, np.concatenate(parts))


def _inverse(optimum: Optimum) -> np.ndarray:
    """Covariance from the information, its saddle directions taken positive: a search that did not
    end at a maximum says so in words, not by a matrix that cannot be drawn from."""
    scale = np.sqrt(np.abs(np.diagonal(optimum.information)))
    values, axes = np.linalg.eigh(optimum.information / np.outer(scale, scale))
    half = axes / np.sqrt(np.abs(values)) / scale[:, None]
    return half @ half.T


@eqx.filter_jit
def _at_mode(vector: Vector, problem: Problem) -> tuple[Array, Any]:
    values = values_at(problem, vector)
    return prediction(problem, values), likelihood_at(problem, values)


def _residuals(problem: Problem, vector: Array) -> Float[np.ndarray, "..."]:
    """Standardised residuals, NaN where a datum is missing."""
    predicted, likelihood = _at_mode(vector, problem)
    chance = np.random.default_rng(0).uniform(size=problem.data.shape)
    found = np.asarray(
        likelihood.residuals(np.asarray(predicted), np.asarray(problem.data), chance), np.float64
    )
    return found if problem.present is None else np.where(problem.present, found, np.nan)


@eqx.filter_jit
def _scores(vector: Vector, problem: Problem) -> Array:
    """(P, data) gradient of every datum's log density."""
    terms = jax.jacfwd(lambda v: log_likelihood_terms(v, problem).ravel())(vector)
    return terms.T


def _widened(
    problem: Problem,
    vector: Array,
    optimum: Optimum,
    covariance: np.ndarray,
    checks: Misfit,
    misfit: str,
) -> tuple[np.ndarray, tuple[str, ...], bool]:
    """The covariance that allows for what the model misses, why, in words, and whether a misfit is
    explained by it: groups explain one only where they share errors."""
    if isinstance(problem.likelihood, Clustered):
        labels = np.unique(np.asarray(problem.likelihood.labels).ravel(), return_inverse=True)[1]
        scores = np.asarray(_scores(vector, problem), np.float64)
        prior = optimum.information - optimum.data_information
        robust = cluster_robust(scores, optimum.information, labels, None, prior=prior)
        words = f"Residuals share errors within the {labels.max() + 1} groups"
        if np.isnan(robust.by_light):
            words = "Too few groups to see errors that they share"
        elif robust.design_effect == 1:
            words = "The groups' residuals show no shared errors"
        sentence = (
            f"{words}; the variance is {robust.design_effect:.3g} times that of independent data."
        )
        return robust.gaussian_covariance, (sentence,), robust.design_effect > 1
    if misfit == "inflate" and checks.dof > 0 and checks.chi_square > checks.dof:
        factor = checks.chi_square / checks.dof
        prior = optimum.information - optimum.data_information
        widened = np.linalg.inv(optimum.data_information / factor + prior)
        sentence = (
            f"Chi-square per degree of freedom is {factor:.4g}; what the data say is widened by "
            f"{np.sqrt(factor):.3g}, as if their noise were that much larger."
        )
        return widened, (sentence,), True
    return covariance, (), False


def _stretched_log_density(vector: Vector, args: tuple[Problem, Array, Array]) -> Array:
    """The posterior, stretched about its mode to a wider covariance."""
    problem, mode, stretch = args
    return log_density(mode + stretch @ (vector - mode), problem)


def _draw(
    problem: Problem,
    vector: Array,
    optimum: Optimum,
    covariance: np.ndarray,
    options: Options | None,
    seed: int,
) -> Posterior:
    space = problem.space
    if options is None:
        return laplace(log_density, space, vector, problem, covariance=covariance, seed=seed)
    stretch = jnp.asarray(curvature_stretch(optimum.information, covariance), vector.dtype)
    exact = (_stretched_log_density, space, vector, covariance, (problem, vector, stretch))
    if isinstance(options, NutsOptions):
        return nuts(*exact, options=options, seed=seed)
    return sample(*exact, options=options, seed=seed)
