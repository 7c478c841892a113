"""`fit`: a problem to its posterior, with a verdict."""

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxvision.errors import InputError
from jaxvision.progress import progress_bar

from ..inference.clustering import curvature_stretch
from ..inference.diagnostics import UNDETERMINED, identifiability
from ..inference.differences import seen_by_differences
from ..inference.emcee_run import SamplingOptions
from ..inference.given import require_kind, require_seed
from ..inference.importance import laplace_where_it_holds
from ..inference.likelihoods import Clustered, named_width
from ..inference.misfit import judge_sums, sums
from ..inference.nuts import NutsOptions, nuts, require_blackjax
from ..inference.on_host import on_host
from ..inference.parameters import log_prior, scalars
from ..inference.posterior import Posterior, sample
from ..inference.problem import Problem, Vector, log_density, log_likelihood
from ..inference.search import Optimum, joined, search, spread_starts, start_at
from ..inference.search_read import derivatives, search_read
from ..inference.streams import Advance
from .result import Fit
from .widening import Widening, residual_sums, residuals_at, widening
from .words import about_chains, about_posterior, about_search, is_confirmed, verdict

ROUNDS = 4  # of starts, as long as the best of all stands alone
OTHER_SEED = 1_000_003  # between the seeds of rounds
SINGLE_ROUNDING = 1e-6  # of a scaled eigenvalue computed with 7 digits
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
    after: Fit | None = None,
) -> Fit:
    """Fits a problem: the best of many searches, its posterior, and whether to believe it.

    Of data in chunks (`Problem(..., chunk=...)`) a sample is searched; the best end is followed to
    the mode of all data, which are read once a step, and judged by them. The fit's residuals and
    bands are then those of the sample, and a bar shows how far each reading is.

    Where finite differences at the optimum show more than the gradient sees, as where edges of
    shadows move, the fit goes on by them: its verdict and curvature are theirs, and a finding names
    the parameters.

    A second fit of a problem with equal shapes and the same `predict` compiles nothing
    (`Problem.with_data`). Nothing is raised for a fit that does not converge: read `converged` and
    `failures`, or print the result.

    Args:
        problem: parameters, model, likelihood and data.
        start: natural values by name, in their units, from which the only search begins; None for
            `starts` of them.
        starts: searches spread over bounds and priors, of which the best is kept; up to four times
            as many where no other ends where the best one does. If none does then, the fit fails.
            A width of noise to be fitted grows until a wrong optimum passes for noise: then four
            must end there, of up to eight times as many, and a single search always fails.
        posterior: `laplace`, a Gaussian about the mode of the unconstrained values, or draws by
            importance sampling where the posterior is not as Gaussian as that; or draws from the
            exact posterior, by `emcee`, an ensemble that needs no gradient, or by `nuts`, whose
            chains follow the gradient: for many parameters, and where `predict` is smooth (the
            `nuts` extra); their metric is the covariance of `laplace`.
        misfit: what to do where the data scatter more than the likelihood says: `fail` to converge,
            or `inflate` the intervals by the square root of chi-square per degree of freedom
            (Birge's factor), which takes the model for a sufficient approximation. The intervals
            of `Clustered` are wider by themselves; `inflate` then accepts also a misfit that is
            more than an offset and a gain of each group.
        sampling: how long to sample: `SamplingOptions` of emcee, `NutsOptions` of NUTS; None for
            their defaults.
        seed: of starts and draws.
        after: a fit of the same problem and seed whose chains go on, with more steps or draws in
            `sampling`: they end bit-identical to chains that never stopped.

    Returns:
        The fit.

    Raises:
        InputError: for what is no problem or no seed, a start that names no parameter, a model that
            is finite nowhere, data that leave a direction open, chains to go on from that are
            others, and NUTS without blackjax.

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
    require_seed(seed)
    require_kind("fit: problem", problem, Problem)
    if start is not None and not isinstance(start, Mapping):
        raise InputError(f"start: give natural values by name, got {start!r:.60}.")
    options = _options(posterior, sampling)
    if problem.stream is not None and options is not None:
        raise InputError(
            f"posterior = {posterior!r} reads all data at every step of a chain, which takes too "
            "long for data in chunks: use 'laplace', or fit a part of the data without chunk."
        )
    if misfit not in ("fail", "inflate"):
        raise InputError(f"misfit = {misfit!r}: use 'fail' or 'inflate'.")
    if problem.present is not None and not on_host(problem.present).any():
        raise InputError("There is nothing to fit: all data are missing (NaN).")
    with progress_bar("reading data", shown=problem.stream is not None) as advance:
        if after is None:
            if start:
                found = search(problem, _given(problem, start)[None])
                optimum = seen_by_differences(problem, found)
            else:
                optimum = _searched(problem, starts, seed, wide_noise=_fits_width(problem))
            if problem.stream is not None:
                optimum = search_read(problem, optimum, advance)
            optimum = _determined(problem, optimum, advance)
        else:
            optimum = _searched_before(after, options)
        vector = jnp.asarray(optimum.vector, jnp.result_type(float))
        residuals = residuals_at(problem, vector, seed=seed)
        if problem.stream is None:
            totals = sums(_in_order(problem, residuals))
        else:
            totals = residual_sums(problem, vector, advance, seed=seed)
    covariance = _inverse(optimum.curvature)
    checks = judge_sums(totals, float(np.trace(optimum.data_information @ covariance)))
    wide = widening(
        *(problem, optimum, covariance, residuals, checks), inflate=misfit == "inflate", seed=seed
    )
    before = None if after is None else after.posterior
    failures = verdict(optimum, checks, wide.explained, wide_noise=_fits_width(problem))
    drawn = _draw(problem, vector, optimum, wide, options, seed, before, failed=bool(failures))
    failures += about_search(optimum, drawn) + about_chains(drawn)
    findings = (*wide.words, *checks.remarks, *about_posterior(problem, optimum, drawn))
    settings = {
        "starts": len(optimum.costs),
        "posterior": posterior,
        "misfit": misfit,
        "likelihood": type(problem.likelihood).__name__,
        **_numbers(options),
    }
    return Fit(
        *(problem, optimum, drawn, checks, residuals, tuple(failures), findings),
        noise=wide.noise,
        settings=settings,
    )


def _in_order(problem: Problem, residuals: np.ndarray) -> np.ndarray:
    """Residuals of one series in the order of its inputs, where each datum has one number: those
    of neighbours then tell what the model misses, in whatever order the data came."""
    inputs = problem.inputs
    if not isinstance(inputs, jax.Array | np.ndarray):
        return residuals
    single = residuals.ndim == 1 and inputs.shape == residuals.shape
    return residuals[np.argsort(on_host(inputs), kind="stable")] if single else residuals


def _fits_width(problem: Problem) -> bool:
    """Whether the width of the noise is among the parameters."""
    return named_width(problem.likelihood) in {parameter.name for parameter in problem.free}


def _searched(problem: Problem, starts: int, seed: int, *, wide_noise: bool) -> Optimum:
    """The best of many searches; of more, where none of them ends where the best one does."""
    found = search(problem, spread_starts(problem, starts, seed=seed))
    optimum = seen_by_differences(problem, found)
    for again in range(1, ROUNDS * (2 if wide_noise else 1)):
        if starts == 1 or is_confirmed(optimum, wide_noise=wide_noise):
            break
        others = spread_starts(problem, starts + 1, seed=seed + again * OTHER_SEED)[1:]
        optimum = seen_by_differences(problem, joined(optimum, search(problem, others)))
    return optimum


def _numbers(options: Options | None) -> dict[str, Any]:
    """What a report repeats of a sampler's options."""
    if options is None:
        return {}
    return {
        field.name: getattr(options, field.name)
        for field in fields(options)
        if isinstance(getattr(options, field.name), int | float)
    }


def _searched_before(after: Fit, options: Options | None) -> Optimum:
    """The optimum of a fit whose chain goes on."""
    if options is None or not after.posterior.blocks:
        raise InputError(
            "after: only chains go on; give a fit by posterior='emcee' or 'nuts', and the same one."
        )
    return after.optimum


def _determined(problem: Problem, optimum: Optimum, advance: Advance) -> Optimum:
    """The optimum, refused where some direction is open; a saddle comes with its own curvature."""
    precise = problem.data.dtype == jnp.float64
    rounding = UNDETERMINED if precise else SINGLE_ROUNDING
    judged = identifiability(problem.space, optimum.curvature, rounding=rounding)
    if judged.determined:
        return optimum
    vector = jnp.asarray(optimum.vector, problem.data.dtype)
    curvature = derivatives(vector, problem, advance, exact=True)[2]
    exact = replace(optimum, information=np.asarray(curvature, np.float64))
    if (
        exact.saddle
        and identifiability(problem.space, exact.curvature, rounding=rounding).determined
    ):
        return replace(exact, stationary=False)
    hint = () if precise else ("jax.config.update('jax_enable_x64', True) may tell, by 16 digits.",)
    raise InputError(" ".join((*judged.sentences, *hint)))


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
    parts = []
    for parameter in problem.free:
        stated, shape = replace(parameter, start=start[parameter.name]), parameter.shape or ()
        scalars(stated, shape)  # refuses a start of another shape
        parts.append(np.broadcast_to(np.asarray(stated.start), shape).ravel())
    return start_at(problem.space, np.concatenate(parts))


def _inverse(information: np.ndarray) -> np.ndarray:
    """By the eigenvalues of the scaled matrix, positive to the last digit."""
    scale = np.sqrt(np.diagonal(information))
    values, axes = np.linalg.eigh(information / np.outer(scale, scale))
    half = axes / np.sqrt(values) / scale[:, None]
    return half @ half.T


def _stretched_log_density(vector: Vector, args: tuple[Problem, Array, Array]) -> Array:
    """The posterior, prior and all, stretched about its mode to a wider covariance."""
    problem, mode, stretch = args
    return log_density(mode + stretch @ (vector - mode), problem)


def _tempered_log_density(vector: Vector, args: tuple[Problem, Array]) -> Array:
    """The posterior of data whose every error is larger by a factor; the prior as it is."""
    problem, factor = args
    return log_likelihood(vector, problem) / factor**2 + log_prior(problem.space, vector)


def _draw(
    problem: Problem,
    vector: Array,
    optimum: Optimum,
    wide: Widening,
    options: Options | None,
    seed: int,
    after: Posterior | None,
    *,
    failed: bool,
) -> Posterior:
    space, covariance = problem.space, wide.gaussian_covariance
    density: tuple[Any, Any] = (log_density, problem)
    if wide.noise > 1:
        density = (_tempered_log_density, (problem, jnp.asarray(wide.noise, vector.dtype)))
    elif isinstance(problem.likelihood, Clustered):
        stretch = jnp.asarray(curvature_stretch(optimum.curvature, covariance), vector.dtype)
        density = (_stretched_log_density, (problem, vector, stretch))
    if not isinstance(options, SamplingOptions):
        told: dict[str, Any] = {"freedom": wide.freedom, "wider": covariance, "by_chain": False}
        if failed or problem.stream is not None:
            told["missed"] = np.zeros(len(space))
        run = (density[0], space, vector, wide.covariance, density[1])
        found = laplace_where_it_holds(*run, seed=seed, **told)
        if options is None:
            return found
        if found.method != "Laplace":
            covariance = found.covariance
    run = (density[0], space, vector, covariance, density[1])
    if isinstance(options, NutsOptions):
        return nuts(*run, options=options, seed=seed, after=after)
    return sample(*run, options=options, seed=seed, after=after)
