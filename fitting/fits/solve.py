"""`fit`: find a problem's best fit and posterior, and judge both."""

import time
import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxvision.core.progress import progress_bar
from jaxvision.errors import InputError

from ..inference.candidates import Choice, numbers_of, price, squared_ratios, weakest
from ..inference.clustering import curvature_stretch
from ..inference.diagnostics import UNDETERMINED, identifiability
from ..inference.differences import correct_by_differences
from ..inference.emcee_run import Emcee
from ..inference.given import require_kind, require_seed
from ..inference.importance import draw_without_mode, laplace_where_it_holds
from ..inference.likelihoods import Clustered, named_width
from ..inference.misfit import Misfit, judge_sums, sums
from ..inference.nuts import Nuts, nuts, require_blackjax
from ..inference.on_host import to_host
from ..inference.parameters import scalars
from ..inference.posterior import Laplace, Posterior, sample
from ..inference.problem import (
    Problem,
    Vector,
    log_density,
    log_likelihood,
    log_prior_at,
    values_at,
)
from ..inference.search import (
    Optimum,
    derivatives,
    merge_optima,
    search,
    search_read,
    spread_starts,
    start_at,
)
from ..inference.streams import Advance, chunks
from .data_checks import DataCheck, data_check
from .moving_edges import warn_of_moving_edges
from .prior_check import blame_priors, conflicts, loosen
from .result import Fit
from .widening import Widening, residual_sums, residuals_at, widening
from .words import (
    chain_failures,
    few_digits,
    is_confirmed,
    left_out_findings,
    no_maximum,
    posterior_findings,
    search_findings,
    verdict,
)

ROUNDS = 4  # rounds of starts, while no other search confirms the best
OTHER_SEED = 1_000_003  # difference between the seeds of two rounds
SINGLE_ROUNDING = 1e-6  # rounding of a scaled eigenvalue computed in float32
# Gradients of one datum that the second derivatives about the mode may take: up to this number
# their time is short beside that of the searches.
MOST_GRADIENTS = 2_000_000
METHODS = {"laplace": Laplace, "emcee": Emcee, "nuts": Nuts}
Method = Laplace | Emcee | Nuts


def fit(
    problem: Problem,
    *,
    start: dict[str, Any] | None = None,
    starts: int = 16,
    solver: Any = None,
    posterior: Method | str | None = None,
    misfit: Literal["fail", "inflate"] = "fail",
    seed: int = 0,
    after: Fit | None = None,
    sampling: Emcee | Nuts | None = None,
) -> Fit:
    """Fit a problem: run many searches, take the best optimum, compute the posterior there, and
    judge the result.

    For data in chunks (`Problem(..., chunk=...)`) the searches use a sample of the data. Newton's
    method then starts at the best optimum and finds the mode for all data, which it reads once per
    step. The tests of the fit use all data. Residuals and bands describe the sample. A bar shows
    the progress of each reading.

    A `Candidate` is kept only if the data support it. The candidate must satisfy Schwarz'
    criterion, and its distance from the value that means absence must be significant. The weakest
    candidate is dropped first. The estimates are those of the problem without the dropped terms,
    and `Fit.choices` gives the reasons.

    Automatic derivatives can be wrong, for example where edges of shadows move. If they differ from
    finite differences at the optimum, the fit uses finite differences for its curvature and its
    test of convergence, and a finding names the parameters. If a free position or shape in a scene
    moves such edges, a warning before the first search states what share of the change the gradient
    misses at the start.

    A second fit of a problem with equal shapes and the same `predict` needs no compilation
    (`Problem.with_data`). A fit that does not converge raises no error: read `converged` and
    `failures`, or print the result.

    Args:
        problem: parameters, model, likelihood and data.
        start: natural values by name, in their units, for a single search; None runs `starts`
            searches.
        starts: number of searches, spread over bounds and priors; the best one is taken. If no
            other search ends at the same point, up to four times as many are run; if none does
            then, the fit fails. If the width of the noise is fitted, it grows at a wrong optimum
            until the misfit counts as noise. Then four searches must end at the same point, up to
            eight times as many searches are run, and a single search always fails.
        solver: the method of the searches: any least-squares solver or minimiser of optimistix
            (`optimistix.Dogleg(rtol=1e-8, atol=1e-8)`), or a class of jaxopt's minimisers
            (`jaxopt.LBFGSB`, or a `functools.partial` with its options). A least-squares solver
            needs a least-squares likelihood. None takes the Levenberg-Marquardt method for such a
            likelihood and Newton's method for any other.
        posterior: `Laplace()` is a Gaussian about the mode of the unconstrained values; where the
            posterior is not Gaussian enough, it draws by importance sampling. `Emcee(...)` and
            `Nuts(...)` draw from the exact posterior. Emcee is an ensemble sampler and needs no
            gradient. NUTS (the `nuts` extra) follows the gradient, for many parameters and a smooth
            `predict`; its metric is the covariance of `Laplace`. None for `Laplace()`.
        misfit: what to do where the data scatter more than the likelihood states. `fail`: the fit
            does not converge. `inflate`: the intervals widen by the square root of chi-square per
            degree of freedom (Birge's factor), which assumes that the model is approximately right.
            The intervals of `Clustered` widen by themselves; with `Clustered`, `inflate` also
            accepts a misfit that an offset and a gain of each group do not explain.
        seed: seed of the starts and of the draws.
        after: an earlier fit of the same problem and seed, whose chains are continued with more
            steps or draws in `posterior`. The result is bit-identical to that of uninterrupted
            chains.
        sampling: deprecated; use `posterior`.

    Returns:
        The fit.

    Raises:
        InputError: for an invalid problem or seed, a start with unknown names, a model that is
            finite nowhere, data that leave a direction of the parameters undetermined, chains in
            `after` of another problem, and NUTS without blackjax.

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
    begun = time.perf_counter()
    require_seed(seed)
    require_kind("fit: problem", problem, Problem)
    if start is not None and not isinstance(start, Mapping):
        raise InputError(f"start: give natural values by name, got {start!r:.60}.")
    method = method_of(posterior, sampling=sampling)
    if problem.stream is not None and not isinstance(method, Laplace):
        raise InputError(
            f"posterior = {type(method).__name__}() reads all data at every step of a chain, which "
            "takes too long for data in chunks: use Laplace(), or fit a part of the data without "
            "chunk."
        )
    if misfit not in ("fail", "inflate"):
        raise InputError(f"misfit = {misfit!r}: use 'fail' or 'inflate'.")
    if problem.present is not None and not to_host(problem.present).any():
        raise InputError("There is nothing to fit: all data are missing (NaN).")
    warn_of_moving_edges(problem)
    how = _How(starts, start, solver, misfit == "inflate", seed)
    choices: tuple[Choice, ...] = ()
    held = problem.stream is None
    title = "compiling, then searching from several starts" if held else "reading data"
    with progress_bar(title, transient=held) as advance:
        if after is not None:
            if isinstance(method, Laplace) or not after.posterior.blocks:
                raise InputError(
                    "after: only chains go on; give a fit by posterior=Emcee() or Nuts(), and the "
                    "same posterior here."
                )
            optimum, choices = after.optimum, after.choices
            for choice in choices:
                problem = problem if choice.kept else problem.without(choice.name)
        elif problem.candidates:
            problem, optimum, choices = _choose_candidates(problem, how, advance)
        else:
            optimum = _optimum(problem, how, advance)
        end = _test_optimum(problem, optimum, how, advance)
    optimum, residuals, checks, wide = end.optimum, end.residuals, end.checks, end.wide
    vector = jnp.asarray(optimum.vector, jnp.result_type(float))
    before = None if after is None else after.posterior
    failures = verdict(problem, optimum, checks, wide.explained, wide_noise=_fits_width(problem))
    against = conflicts(problem, optimum, wide)
    why = _contradicted_priors(problem, end, how) if failures else ()
    failures = [*why] or failures
    own = DataCheck()
    if not why:
        # At a saddle, a misfit is not a fault of the data.
        explained = wide.explained or optimum.saddle
        own = data_check(problem, optimum.vector, checks, explained=explained, seed=seed)
    failures = [*own.failures, *failures]
    run = (problem, vector, optimum, wide, method, seed, before)
    endless = bool(failures) and failures == no_maximum(problem, optimum)
    drawn = _draw(*run, failed=bool(failures), endless=endless)
    if endless and drawn.shifted:
        failures = []
    several = [] if why or np.isinf(drawn.shifted) else search_findings(optimum, drawn)
    failures += chain_failures(drawn) + several
    lost = set(failures) - set(checks.faults)  # of the search
    digits = few_digits(problem, optimum) if lost else []
    if digits:
        failures = [*digits, *(one for one in failures if one in checks.faults)]
        optimum = replace(optimum, unseen={})  # differences are as inaccurate as the cost
    contradicted = () if why else against
    remarks = (*own.findings, *wide.words, *(() if own.overrated else checks.remarks))
    carried = () if problem.prior is None else problem.prior.words
    remarks += (*contradicted, *carried)
    findings = (*remarks, *(() if why else posterior_findings(problem, optimum, drawn)))
    findings = (*map(str, choices), *left_out_findings(problem), *findings)
    settings = {
        "starts": len(optimum.costs),
        "posterior": type(method).__name__.lower(),
        "misfit": misfit,
        "likelihood": type(problem.likelihood).__name__,
        **{k: x for k, x in vars(method).items() if isinstance(x, int | float)},
    }
    return Fit(
        *(problem, optimum, drawn, checks, residuals, tuple(failures), findings),
        noise=wide.noise,
        settings=settings,
        choices=choices,
        seconds=time.perf_counter() - begun,
    )


@dataclass(frozen=True)
class _How:
    """The options of `fit` for the search and the tests of its result."""

    starts: int
    start: dict[str, Any] | None
    solver: Any
    inflate: bool
    seed: int


@dataclass(frozen=True)
class _End:
    """A best fit, its residuals, and the checks and the covariance that follow from them."""

    optimum: Optimum
    residuals: np.ndarray
    checks: Misfit
    wide: Widening


def _optimum(
    problem: Problem, how: _How, advance: Advance, *, near: dict[str, Any] | None = None
) -> Optimum:
    """Return the best optimum of all searches. If `near` is given, or a user's `start`, it is the
    only start.
    """
    begin = how.start if near is None else near
    if begin:
        found = search(problem, _start_from(problem, begin)[None], solver=how.solver)
        optimum = correct_by_differences(problem, found)
    else:
        optimum = _search_more(problem, how.starts, how.seed, how.solver, advance)
    if problem.stream is not None:
        optimum = search_read(problem, optimum, advance)
    return optimum


def _choose_candidates(
    problem: Problem, how: _How, advance: Advance
) -> tuple[Problem, Optimum, tuple[Choice, ...]]:
    """Return the problem without the candidates that the data do not support, its optimum, and the
    reasons. The weakest candidate is dropped first, and the remaining ones are tested again.
    """
    optimum, gone = _optimum(problem, how, advance), []
    while True:
        choices = _choices(problem, optimum, how, advance)
        shares = {one.name: one.ratio**2 for one in choices}
        prices = {one.name: one.needed**2 for one in choices}
        name = weakest(shares, prices, problem.candidates)
        if name is None:
            break
        gone += [replace(one, kept=False) for one in choices if one.name == name]
        near = values_at(problem, jnp.asarray(optimum.vector, jnp.result_type(float)))
        problem = problem.without(name)
        near = {p.name: np.asarray(near[p.name]) for p in problem.free}
        if how.start is not None:
            how = replace(how, start={p.name: how.start[p.name] for p in problem.free})
        if not problem.candidates:
            choices = ()
            break
        optimum = _optimum(problem, how, advance, near=near)
    if gone:
        optimum = _optimum(problem, how, advance)
    return problem, optimum, (*choices, *gone)


def _choices(problem: Problem, optimum: Optimum, how: _How, advance: Advance) -> tuple[Choice, ...]:
    """Return the test of each candidate while all of them are in the model: its ratio of estimate
    to standard error and the threshold for this ratio.
    """
    information, end = np.asarray(optimum.curvature), None
    freedom, count = np.full(len(information), np.inf), float(problem.data.size)
    if problem.stream is not None:
        count = float(problem.stream.count)
    elif problem.present is not None:
        count = float(to_host(problem.present).sum())
    with suppress(InputError):  # without a term, a parameter may be undetermined
        end = _test_optimum(problem, optimum, how, advance)
        information = np.linalg.inv(end.wide.covariance)
    if end is not None and end.wide.noise > 1:
        freedom[:] = max(end.checks.dof, 1)
    if end is not None and end.wide.freedom is not None:
        freedom = end.wide.freedom
    ratios = squared_ratios(problem.space, optimum.vector, information, problem.candidates)
    scatter = (int(count), len(information) - 1) if _fits_width(problem) else None
    found = []
    for candidate, ratio in zip(problem.candidates, ratios, strict=True):
        own = numbers_of(candidate, problem.space)
        needed = price(
            count,
            chance=candidate.chance,
            numbers=int(own.sum()),
            freedom=float(np.min(freedom[own])),
            scatter=scatter,
        )
        sizes = float(np.sqrt(ratio)), float(np.sqrt(needed))
        found.append(Choice(candidate.name, True, *sizes, candidate.absent))
    return tuple(found)


def _contradicted_priors(problem: Problem, end: _End, how: _How) -> tuple[str, ...]:
    """Return sentences on the priors that made a fit fail: with wider priors the model describes
    the data, and the data disagree with the stated priors. The result is empty if priors are not
    the cause.
    """
    loose = problem.with_priors(loosen)
    if loose.free == problem.free and loose.prior is None:
        return ()
    near = values_at(problem, jnp.asarray(end.optimum.vector, jnp.result_type(float)))
    near = {p.name: np.asarray(near[p.name]) for p in problem.free}

    def discard_progress(done: int, total: int) -> None:
        """Show no progress."""

    try:
        alone = _test_optimum(
            loose, _optimum(loose, how, discard_progress, near=near), how, discard_progress
        )
    except InputError:  # without its priors the problem has no maximum
        return ()
    if not alone.optimum.stationary or (alone.checks.faults and not alone.wide.explained):
        return ()
    return blame_priors(problem, alone.optimum.vector, alone.wide, end.checks, alone.checks)


def _test_optimum(problem: Problem, optimum: Optimum, how: _How, advance: Advance) -> _End:
    """Return the optimum with its residuals, their checks, and the covariance that includes a
    misfit. An optimum with an unidentifiable direction is refused.
    """
    optimum = _require_identifiable(problem, optimum, advance)
    vector = jnp.asarray(optimum.vector, jnp.result_type(float))
    residuals = residuals_at(problem, vector, seed=how.seed)
    if problem.stream is None:
        inputs, ordered = problem.inputs, residuals
        one_series = isinstance(inputs, jax.Array | np.ndarray) and residuals.ndim == 1
        if one_series and inputs.shape == residuals.shape:
            # Neighbours in the order of the inputs show a misfit for any order of the data.
            ordered = residuals[np.argsort(to_host(inputs), kind="stable")]
        totals = sums(ordered)
    else:
        totals = residual_sums(problem, vector, advance, seed=how.seed)
    covariance = _inverse(optimum.curvature)
    checks = judge_sums(totals, float(np.trace(optimum.data_information @ covariance)))
    stated = (problem, optimum, covariance, residuals, checks)
    return _End(optimum, residuals, checks, widening(*stated, inflate=how.inflate, seed=how.seed))


def _fits_width(problem: Problem) -> bool:
    """Return whether the standard deviation of the noise is a free parameter."""
    return named_width(problem.likelihood) in {parameter.name for parameter in problem.free}


def _search_more(
    problem: Problem, starts: int, seed: int, solver: Any, advance: Advance
) -> Optimum:
    """Return the best of many searches. If no other search ends at the same optimum, run more
    searches."""
    wide_noise = _fits_width(problem)
    begin = spread_starts(problem, starts, seed=seed)
    how: dict[str, Any] = {"solver": solver}
    if problem.stream is None:
        how["progress"] = lambda ended: advance(ended, len(begin))
    found = search(problem, begin, as_given=False, **how)
    optimum = correct_by_differences(problem, found)
    for again in range(1, ROUNDS * (2 if wide_noise else 1)):
        if starts == 1 or is_confirmed(optimum, wide_noise=wide_noise):
            break
        others = spread_starts(problem, starts + 1, seed=seed + again * OTHER_SEED)[1:]
        found = search(problem, others, **how)
        optimum = correct_by_differences(problem, merge_optima(optimum, found))
    return optimum


def _require_identifiable(problem: Problem, optimum: Optimum, advance: Advance) -> Optimum:
    """Return the optimum if every direction is identifiable, and raise otherwise. The optimum of a
    saddle is returned with the exact curvature there.
    """
    precise = problem.data.dtype == jnp.float64
    rounding = UNDETERMINED if precise else SINGLE_ROUNDING
    judged = identifiability(problem.space, optimum.curvature, rounding=rounding)
    if judged.determined:
        return optimum
    parts = chunks(problem, advance=advance)
    curvature = derivatives(optimum.vector[None], problem, parts=parts, exact=True)[2][0]
    exact = replace(optimum, information=curvature)
    if (
        exact.saddle
        and identifiability(problem.space, exact.curvature, rounding=rounding).determined
    ):
        return replace(exact, stationary=False)
    hint = (
        () if precise else ("jax.config.update('jax_enable_x64', True), for 16 digits, may help.",)
    )
    raise InputError(" ".join((*judged.sentences, *hint)))


def method_of(posterior: Method | str | None, *, sampling: Emcee | Nuts | None = None) -> Method:
    """Return the method for a posterior, given as an object or by its deprecated name. A method
    that cannot run is refused before the search.
    """
    method: Any = Laplace() if posterior is None else posterior
    if isinstance(posterior, str):
        if posterior not in METHODS:
            raise InputError(f"posterior = {posterior!r}: use Laplace(), Emcee() or Nuts().")
        kind = METHODS[posterior]
        method = kind() if sampling is None else sampling
        if not isinstance(method, kind):
            raise InputError(
                f"posterior = {posterior!r} does not go with {type(sampling).__name__}: write "
                "posterior=Laplace(), Emcee(...) or Nuts(...), and leave sampling out."
            )
        new = f"{kind.__name__}({'' if sampling is None else '...'})"
        warnings.warn(
            f"posterior={posterior!r} is deprecated: write posterior={new}.",
            DeprecationWarning,
            stacklevel=3,
        )
    elif sampling is not None:
        raise InputError(
            "sampling: write posterior=Emcee(...) or Nuts(...) with the same options, and leave "
            "sampling out."
        )
    if not isinstance(method, Method):
        raise InputError(f"posterior = {posterior!r}: use Laplace(), Emcee() or Nuts().")
    if isinstance(method, Nuts):
        require_blackjax()
    return method


def _start_from(problem: Problem, start: dict[str, Any]) -> np.ndarray:
    """Return one start vector from natural values by name."""
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
    return np.asarray(start_at(problem.space, np.concatenate(parts)), np.float64)


def _inverse(information: np.ndarray) -> np.ndarray:
    """Return the inverse of an information matrix, computed from the eigenvalues of the matrix
    scaled to a unit diagonal.
    """
    scale = np.sqrt(np.diagonal(information))
    values, axes = np.linalg.eigh(information / np.outer(scale, scale))
    half = axes / np.sqrt(values) / scale[:, None]
    return half @ half.T


def _stretched_log_density(vector: Vector, args: tuple[Problem, Array, Array]) -> Array:
    """Return the log posterior after stretching it about its mode to a wider covariance."""
    problem, mode, stretch = args
    return log_density(mode + stretch @ (vector - mode), problem)


def _tempered_log_density(vector: Vector, args: tuple[Problem, Array]) -> Array:
    """Return the log posterior for noise multiplied by a factor, with the prior unchanged."""
    problem, factor = args
    return log_likelihood(vector, problem) / factor**2 + log_prior_at(problem, vector)


def _gradients_about(problem: Problem) -> int:
    """Return the computing cost, in gradients of one datum, of the second derivatives at the mode
    and at two points for each parameter."""
    parameters = len(problem.space)
    return (2 * parameters + 1) * parameters * problem.data.size


def _draw(
    problem: Problem,
    vector: Array,
    optimum: Optimum,
    wide: Widening,
    method: Method,
    seed: int,
    after: Posterior | None,
    *,
    failed: bool,
    endless: bool,
) -> Posterior:
    space, covariance = problem.space, wide.gaussian_covariance
    density: tuple[Any, Any] = (log_density, problem)
    if wide.noise > 1:
        density = (_tempered_log_density, (problem, jnp.asarray(wide.noise, vector.dtype)))
    elif isinstance(problem.likelihood, Clustered):
        stretch = jnp.asarray(curvature_stretch(optimum.curvature, covariance), vector.dtype)
        density = (_stretched_log_density, (problem, vector, stretch))
    if not isinstance(method, Emcee):
        described: dict[str, Any] = {
            "freedom": wide.freedom,
            "wider": covariance,
            "by_chain": False,
        }
        described["local"] = None
        if (
            density[0] is log_density
            and problem.stream is None
            and not optimum.unseen
            and _gradients_about(problem) <= MOST_GRADIENTS
        ):
            described["local"] = partial(derivatives, problem=problem)
        if failed or problem.stream is not None:
            described["missed"] = np.zeros(len(space))
        run = (density[0], space, vector, wide.covariance, density[1])
        found = None
        if endless and described["local"] is not None:
            found = draw_without_mode(
                *run, optimum.information, seed=seed, local=described["local"]
            )
        if found is None:
            found = laplace_where_it_holds(*run, seed=seed, **described)
        if isinstance(method, Laplace):
            untested = failed or problem.stream is not None
            return replace(found, miss=np.nan) if untested else found
        if found.method != "Laplace":
            covariance = found.covariance
            vector = jnp.asarray(found.unconstrained_mode, vector.dtype)
    run = (density[0], space, vector, covariance, density[1])
    if isinstance(method, Nuts):
        return nuts(*run, options=method, seed=seed, after=after)
    return sample(*run, options=method, seed=seed, after=after)
