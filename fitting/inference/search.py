"""Find the best fit of a problem: search from many starts, then run Newton's method to the mode.

For likelihoods that are sums of squares, the search is Levenberg and Marquardt's method. This
method needs a sum of squares, so a prior enters the search as a Gaussian with the prior's mean and
standard deviation on the unconstrained scale. Newton's method then leads from the best optimum to
the mode of the exact posterior, with the Gauss-Newton curvature J^T J of the data. For other
likelihoods the search is Newton's method. If such a likelihood has a least-squares surrogate,
Newton's method starts at the Levenberg-Marquardt optimum of the surrogate.

All searches advance together, in NumPy. One compiled program evaluates the cost of the data and its
derivatives at the current point of each search. It also serves to find the mode, to compute the
covariance and to test Laplace's approximation.

The table compares five methods. It states how many of 100 searches, each from its own start within
the bounds, reached the best optimum. The three problems, with 5 unknowns each, are a Phong ball,
two exponential decays and a peak with unknown noise, whose likelihood is not a sum of squares. For
this comparison each search by JAX was one compiled program:

                        ball    decays    peak    CPU seconds, ball (first, again)
    Levenberg-Marquardt  62       58        -        31,  10
    Newton               79       83       64        23,  10
    BFGS (optimistix)    70       81       74        12,   5
    L-BFGS-B (jaxopt)    93      100       17       160,  92
    L-BFGS-B (scipy)     42      100       14        11,   6

No method is reliable from one start. The library uses Levenberg-Marquardt and Newton, which are
cheap and whose final curvature is the information that the posterior needs. From 16 starts they
reached the best optimum of all three problems in 100 of 100 fits. With Student's t noise of known
scale, the log density of the ball has little curvature far from the optimum. Its best optimum was
reached in 30 of 30 fits, and in 55 of 100 without the surrogate.

For data that are read in chunks, the searches use a sample, whose optima are close to those of all
data. The optima found are compared by their cost over all data, and Newton's method continues from
the best. Cost, gradient and curvature are summed over the chunks in float64. Every step reads all
data once.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial, reduce
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float
from scipy.special import ndtri

from jaxvision.core.parallel_loops import map_
from jaxvision.errors import InputError
from jaxvision.programs import targets_cpu

from .candidates import numbers_of
from .compiled import compiled_briefly
from .diagnostics import UNDETERMINED, listed
from .given import require_whole
from .newton import SAME_COST, minimise_many, second_derivatives
from .on_host import to_host
from .parameters import (
    FLAT_QUANTILES,
    ParameterSpace,
    ends,
    log_flat_slopes,
    log_prior,
    natural_slopes,
    numpy_or_jax,
    prior_gaussian,
    prior_values,
    to_unconstrained,
    unconstrained_numbers,
)
from .problem import (
    Problem,
    Vector,
    datum_terms,
    least_squares_residuals,
    log_density,
    log_likelihood,
    log_prior_at,
    missing_in_words,
    prediction,
    start_of_data,
    values_at,
)
from .separable import KNOTS, closed_form_indices, complete, eliminate, require_linear
from .streams import Advance, chunks

_CORE_STARTS = 2  # starts that are searched at a time, because the cache holds the residuals of two
STEPS = 100  # most steps of a search
_BOX = 10.0  # half width of the box for jaxopt's L-BFGS-B, in standard deviations of the prior
MANY_STEPS = 1000  # most steps of a user's solver, which may need more without curvature
BEYOND, NOTHING = 30, 1e-6  # most steps after convergence, and share of its tolerance
COARSEST = 0.03  # error of the cost by rounding that a search allows for
EDGE = 1e-3  # smallest distance of a start from an end of its range, as a share of the range
SAME_PLACE = 0.5  # difference in cost up to which two searches count as one optimum
FARTHEST = 700.0  # unconstrained, in place of infinity: the exponential of more overflows
BATCH = 16  # vectors in one call, as many as the default starts of `fit`

Derivatives = tuple[Any, Any, Any]  # a cost, its gradient and its curvature
Local = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
Ended = Callable[[int], None]


@dataclass(frozen=True)
class Optimum:
    """The best optimum that the searches found, and where each of them ended."""

    vector: Float[np.ndarray, " parameters"]  # (P,) the mode, unconstrained
    cost: float  # negative log posterior density at the mode
    information: Float[np.ndarray, "parameters parameters"]  # (P, P) curvature of the cost
    # (P, P) curvature of the prior's part of the cost
    prior_information: Float[np.ndarray, "parameters parameters"]
    decrement: float  # decrease in cost that one more step predicts
    stationary: bool  # whether the decrement is negligible
    ends: Float[np.ndarray, "starts parameters"]  # (starts, P) end of each search, unconstrained
    costs: Float[np.ndarray, " starts"]  # cost at each end, relative to the lowest
    # parameters whose gradient omits part of their effect, each with the omitted share
    unseen: dict[str, float] = field(default_factory=dict)

    @property
    def data_information(self) -> Float[np.ndarray, "parameters parameters"]:
        """Return the (P, P) information of the data alone."""
        return self.information - self.prior_information

    @property
    def saddle(self) -> bool:
        """Return whether the log density increases to both sides along some direction."""
        return bool(_scaled_eigensystem(self.information)[0][0] < -UNDETERMINED)

    @property
    def curvature(self) -> Float[np.ndarray, "parameters parameters"]:
        """Return the information (P, P) with saddle directions made positive, so that draws
        exist."""
        if not self.saddle:
            return self.information
        values, axes, size = _scaled_eigensystem(self.information)
        half = size[:, None] * axes * np.sqrt(np.abs(values))
        return half @ half.T


def _scaled_eigensystem(information: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return eigenvalues, eigenvectors and scales of a scaled symmetric matrix."""
    information = np.nan_to_num(information)
    size = np.sqrt(np.linalg.norm(information, axis=1))
    size = np.where(size > 0, size, 1)
    values, axes = np.linalg.eigh(information / np.outer(size, size))
    return values, axes, size


def spread_starts(
    problem: Problem, count: int, *, seed: int
) -> Float[np.ndarray, "starts parameters"]:
    """Return starts spread evenly over bounds and priors.

    The first start is the one that the user gave or that `start` computes from the data, for each
    parameter that has one. The other starts fill the box of prior quantiles by a Kronecker
    sequence. A parameter with neither bounds nor prior is placed about its start.

    Source:
        The sequence: Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018.
    """
    require_whole("starts", count, of="searches")
    begin = given_start if problem.start is None else _given_start
    given = np.asarray(begin(problem), np.float64)
    found = starts_about(*prior_starts(problem, count, seed=seed), given, xp=np)
    lost = [p.name for p, x in zip(problem.space, found.T, strict=True) if np.isnan(x).any()]
    if lost:
        raise InputError(
            f"Nothing says where to search for {listed(lost)}: give bounds, a prior or a start."
        )
    return found


def prior_starts(
    problem: Problem, count: int, *, seed: int
) -> tuple[Float[np.ndarray, "starts parameters"], Float[np.ndarray, "starts parameters"]]:
    """Return starts spread over bounds and priors, unconstrained, and the distance of each number
    from its own start. A start is NaN for a parameter with neither bounds nor prior, and arbitrary
    for one that is solved in closed form.
    """
    closed = closed_form_indices(problem)
    shares = _kronecker(count, len(problem.space), seed)
    columns = []
    for i, (parameter, share) in enumerate(zip(problem.space, shares.T, strict=True)):
        values = prior_values(parameter)
        unknown = np.full(count, 1.0 if i in closed else np.nan)
        columns.append(unknown if values is None else np.interp(share, FLAT_QUANTILES, values))
    table = unconstrained_numbers(problem.space, np.stack(columns, axis=-1))
    return table, ndtri(np.clip(shares, 0.01, 0.99))


def starts_about(table: Any, distances: Any, given: Any, *, xp: Any = jnp) -> Any:
    """Combine `prior_starts` with the given start, (starts, P); NaN where there is none."""
    table = xp.where(xp.isnan(table), given[None] + distances, table)
    first = xp.where(xp.isnan(given), table[0], given)
    return xp.concatenate([first[None], table[1:]])


def given_start(problem: Problem) -> Float[Array, " parameters"]:
    """Return each parameter's own start, unconstrained; NaN where it has none."""
    natural: list[Any] = [
        np.broadcast_to(np.nan if p.start is None else np.asarray(p.start), p.shape or ())
        for p in problem.free
    ]
    if problem.start is not None:
        found = start_of_data(problem)
        for i, (p, own) in enumerate(zip(problem.free, natural, strict=True)):
            known: Any = found.get(p.name, own)
            if jnp.shape(known) != own.shape:
                raise InputError(
                    f"start: {p.name} has the shape {own.shape}, its start {jnp.shape(known)}."
                )
            natural[i] = jnp.where(jnp.isfinite(known), known, own)
    xp = np if problem.start is None else jnp
    return start_at(problem.space, xp.concatenate([xp.ravel(xp.asarray(x)) for x in natural]))


_given_start = eqx.filter_jit(given_start)


def start_at(
    space: ParameterSpace, natural: Float[ArrayLike, " parameters"]
) -> Float[Array, " parameters"]:
    """Return a start vector from natural values (P,), moved inside the bounds; NaN stays NaN."""
    low, high = np.array([ends(parameter) for parameter in space]).T
    xp = np if isinstance(natural, np.ndarray) else jnp
    size = xp.where(natural == 0, 1.0, abs(natural))
    range_ = xp.where(np.isfinite(high - low), np.nan_to_num(high - low), size)
    inside = xp.clip(natural, low + EDGE * range_, high - EDGE * range_)
    if isinstance(inside, np.ndarray):
        return jnp.asarray(unconstrained_numbers(space, inside), jnp.result_type(float))
    return to_unconstrained(space, jnp.asarray(inside, jnp.result_type(float)))


def _kronecker(count: int, dimensions: int, seed: int) -> np.ndarray:
    """Return points (count, dimensions) of a Kronecker sequence over the unit cube."""
    ratio = 2.0
    for _ in range(60):
        ratio = (1 + ratio) ** (1 / (dimensions + 1))
    steps = ratio ** -np.arange(1.0, dimensions + 1)
    shift = np.random.default_rng(seed).random(dimensions)
    return (shift + np.outer(np.arange(count), steps)) % 1


def search(
    problem: Problem,
    starts: Float[np.ndarray, "starts parameters"],
    *,
    solver: Any = None,
    as_given: bool = True,
    progress: Ended | None = None,
    without: Sequence[str] = (),
) -> Optimum:
    """Return the mode of a problem's posterior. `solver` is a solver of optimistix or jaxopt; None
    takes the method that suits the likelihood. `progress` is called with the count of ended
    searches. The candidates in `without` are absent. Newton's method still uses the compiled
    program of the problem with all candidates, so that no choice of candidates needs a new
    compilation."""
    begin, modes = np.asarray(starts, np.float64), None
    free, whole = present_numbers(problem, without)
    begin = begin[:, free]
    if without and (solver or problem.likelihood.least_squares or problem.likelihood.surrogate):
        last = sorted(
            without, key=lambda name: any(name in c.requires for c in problem.candidates)
        )  # after those that require them
        problem = reduce(Problem.without, last, problem)
        return search(problem, begin, solver=solver, as_given=as_given, progress=progress)

    def local(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        cost, gradient, curvature = derivatives(whole(vectors), problem)
        return cost, gradient[:, free], curvature[:, free][:, :, free]

    if solver is not None:
        _require_solver(solver, problem)
        mean, sd = (jnp.asarray(x, jnp.result_type(float)) for x in prior_gaussian(problem.space))
        vectors = _solver_end(jnp.asarray(begin, mean.dtype), problem, mean, 1 / sd, solver)
        vectors = to_host(vectors, dtype=np.float64)
        costs = derivatives(vectors, problem)[0]
    elif problem.likelihood.least_squares:
        vectors, costs = _levenberg_marquardt(begin, problem, as_given=as_given, progress=progress)
    else:
        modes = _modes(_surrogate_ends(begin, problem, as_given, progress), local, progress)
        vectors, costs = modes.vector, modes.cost
    costs = np.where(np.isfinite(costs), costs, np.inf)
    best = int(np.argmin(costs))
    if not np.isfinite(costs[best]):
        why = _missing(problem) or "check predict, bounds and start."
        raise InputError(f"The log density is finite at none of the {len(costs)} starts: {why}")
    if modes is None or not modes.converged[best]:
        found = _mode(vectors[best][None], local)
        if not found.converged[0]:
            vector = jnp.asarray(found.vector[0], jnp.result_type(float))
            blur = float(rounding_of_digits(vector, problem)[0])
            allowed = SAME_COST * _tolerances()["digit"] * max(abs(float(found.cost[0])), 1.0)
            if blur > allowed:  # every search allows for the rounding of sums
                found = _mode(found.vector, local, min(blur, COARSEST))
        found = jax.tree.map(lambda x: x[0], found)
    else:
        found = jax.tree.map(lambda x: x[best], modes)
    bend = prior_derivatives(whole(found.vector[None]), problem)[2][0]
    return Optimum(
        vector=found.beyond if found.converged else found.vector,
        cost=float(found.cost),
        information=found.information,
        prior_information=bend[free][:, free],
        decrement=float(found.decrement),
        stationary=bool(found.converged),
        ends=vectors,
        costs=costs - costs[best],
    )


def present_numbers(
    problem: Problem, without: Sequence[str]
) -> tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]:
    """Return the indices of the numbers that are left if the candidates in `without` are absent,
    and a function that inserts the absent numbers into vectors."""
    gone = [one for one in problem.candidates if one.name in without]
    absent = np.full(len(problem.space), np.nan)
    for candidate in gone:
        absent[numbers_of(candidate, problem.space)] = candidate.absent
    free = np.flatnonzero(np.isnan(absent))
    absent = np.clip(unconstrained_numbers(problem.space, absent), -FARTHEST, FARTHEST)

    def whole(vectors: np.ndarray) -> np.ndarray:
        filled = np.tile(absent, (len(vectors), 1))
        filled[:, free] = vectors
        return filled

    return free, whole


def merge_optima(one: Optimum, other: Optimum) -> Optimum:
    """Return the better of two optima of a problem, with the ends of the searches of both."""
    costs = np.concatenate([one.cost + one.costs, other.cost + other.costs])
    return replace(
        one if one.cost <= other.cost else other,
        ends=np.concatenate([one.ends, other.ends]),
        costs=costs - costs.min(),
    )


def _surrogate_ends(
    starts: np.ndarray, problem: Problem, as_given: bool, progress: Ended | None
) -> np.ndarray:
    """Return the better of each start and the end of its search with the surrogate."""
    surrogate = problem.likelihood.surrogate
    if surrogate is None:
        return starts
    squares = eqx.tree_at(lambda problem: problem.likelihood, problem, surrogate)
    ends, _ = _levenberg_marquardt(starts, squares, as_given=as_given, progress=progress)
    costs = [derivatives(vectors, problem)[0] for vectors in (ends, starts)]
    at_end, at_start = (np.where(np.isnan(cost), np.inf, cost) for cost in costs)
    return np.where((at_end < at_start)[:, None], ends, starts)


def _is_of_jaxopt(solver: Any) -> bool:
    """Return whether a solver is a class of jaxopt's minimisers, or a partial of one."""
    kind = getattr(solver, "func", solver)
    fields = getattr(kind, "__dataclass_fields__", ())
    return isinstance(kind, type) and kind.__module__.startswith("jaxopt.") and "fun" in fields


def _require_solver(solver: Any, problem: Problem) -> None:
    from optimistix import AbstractLeastSquaresSolver, AbstractMinimiser

    if _is_of_jaxopt(solver):
        return
    if not isinstance(solver, AbstractLeastSquaresSolver | AbstractMinimiser):
        raise InputError(
            f"solver = {solver!r:.60}: give a least-squares solver or a minimiser of optimistix, "
            "such as optimistix.Dogleg(rtol=1e-8, atol=1e-8), or a class of jaxopt, such as "
            "jaxopt.LBFGSB."
        )
    if isinstance(solver, AbstractLeastSquaresSolver) and not problem.likelihood.least_squares:
        raise InputError(
            f"solver = {type(solver).__name__}(...) solves least squares, and "
            f"{type(problem.likelihood).__name__} is none: give a minimiser, such as "
            "optimistix.BFGS(rtol=1e-8, atol=1e-8)."
        )


@eqx.filter_jit
def _solver_end(starts: Array, problem: Problem, mean: Array, weight: Array, solver: Any) -> Array:
    """Return where the searches by a solver of optimistix or jaxopt end."""
    if _is_of_jaxopt(solver):
        return map_(partial(_jaxopt_end, problem, mean, weight, solver), starts)
    import optimistix as optx

    squares = isinstance(solver, optx.AbstractLeastSquaresSolver)
    others = _nonlinear(problem)
    if squares and others.size:
        starts, mean, weight = starts[:, others], mean[others], weight[others]

    def search(start: Array) -> Array:
        if squares:
            args = (problem, mean, weight)
            how: Any = (_penalised_residuals, solver, start, args)
            found = optx.least_squares(*how, max_steps=MANY_STEPS, throw=False)
            partly = found.value.size < len(problem.space)
            return complete(found.value, problem) if partly else found.value
        how = (negative_log_density, solver, start, problem)
        return optx.minimise(*how, max_steps=MANY_STEPS, throw=False).value

    return map_(search, starts, batch_size=searches_at_once(starts))


def _jaxopt_end(problem: Problem, mean: Array, weight: Array, solver: Any, start: Array) -> Array:
    """Return where the search by jaxopt's minimiser ends. Numbers are scaled by their prior's
    width, and the cost is divided by the number of data.

    L-BFGS-B needs bounds, which are ten prior standard deviations to either side. Without the
    scaling it misses up to a tenth of the optima."""
    count = max(int(np.size(problem.data)), 1)

    known = weight > 0
    middle, width = jnp.where(known, mean, 0), jnp.where(known, 1 / jnp.where(known, weight, 1), 1)

    def cost(scaled: Array) -> Array:
        return negative_log_density(middle + width * scaled, problem) / count

    begin = (start - middle) / width
    most = jnp.where(known, _BOX, jnp.inf)
    kind = getattr(solver, "func", solver)
    box = {"bounds": (-most, most)} if kind.__name__ == "LBFGSB" else {}
    # jaxopt mixes dtypes and ranks freely inside.
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        made = solver(
            fun=cost, **({} if kind is not solver else {"tol": 1e-8, "maxiter": MANY_STEPS})
        )
        return middle + width * made.run(begin, **box).params


def negative_log_density(vector: Vector, problem: Problem) -> Float[Array, ""]:
    """Return the cost that Newton's method minimises, the negative log posterior density."""
    return -log_density(vector, problem)


def _residuals(vector: Vector, problem: Problem) -> Array:
    """Return the residuals of the data. `vector` holds all numbers, or only those that are not
    solved in closed form."""
    if vector.size < len(problem.space):
        return eliminate(vector, problem).residuals
    return least_squares_residuals(vector, problem)


def _penalised_residuals(vector: Vector, args: Any) -> Array:
    """Return the residuals of the data and of a Gaussian prior on `vector`."""
    problem, mean, weight = args
    return jnp.concatenate([_residuals(vector, problem), weight * (vector - mean)])


def searches_at_once(vectors: Any) -> int:
    """Return how many searches of a user's solver run at once: on a CPU two fit the cache."""
    return min(_CORE_STARTS if targets_cpu() else len(vectors), len(vectors))


def _levenberg_marquardt(
    starts: np.ndarray, problem: Problem, *, as_given: bool, progress: Ended | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends of the searches and their costs, under a Gaussian prior."""
    mean, sd = prior_gaussian(problem.space)
    closed, searched, others = closed_form_indices(problem), problem.space, _nonlinear(problem)
    if closed:
        starts, mean, sd = starts[:, others], mean[others], sd[others]
        searched = tuple(problem.space[i] for i in others)
        first = jnp.asarray(starts[0], jnp.result_type(float))
        require_linear(first, problem)
        if not others.size:
            end = to_host(_complete_all(first[None], problem), dtype=np.float64)
            return np.tile(end, (len(starts), 1)), np.zeros(len(starts))

    def local(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        cost, gradient, gram = _grouped_calls(_squares_at, vectors, problem)
        away = (vectors - mean) / sd
        # Near a bound the prediction hardly changes, and a Gauss-Newton step may be enormous.
        bent = np.maximum(gradient * natural_slopes(searched, vectors)[1], 0)
        curvature = gram + _diagonal(bent + sd**-2.0)
        return cost + np.sum(away**2, -1) / 2, gradient + away / sd, curvature

    if closed and others.size == 1 and not as_given:
        starts = _lowest_of_grid(starts, problem, lambda knots: local(knots)[0])
    how = _tolerances()
    found = minimise_many(local, starts, max_steps=STEPS, careful=True, progress=progress, **how)
    if not closed:
        return found.vector, found.cost
    ends = _complete_all(jnp.asarray(found.vector, jnp.result_type(float)), problem)
    return to_host(ends, dtype=np.float64), found.cost


def _modes(starts: np.ndarray, local: Local, progress: Ended | None = None) -> Any:
    """Return where Newton's method ends from each start."""
    return minimise_many(local, starts, max_steps=STEPS, progress=progress, **_tolerances())


def _mode(start: np.ndarray, local: Local, blur: float = 0.0) -> Any:
    """Return where Newton's method ends from one start, continued while steps become smaller,
    because the Gauss-Newton curvature is approximate. `blur` is the error of the cost by the digits
    of the predictions."""
    how = _tolerances()
    how["tolerance"] = max(how["tolerance"], blur**2)  # a parameter has no more digits
    found = minimise_many(local, start, max_steps=STEPS, blur=blur, **how)
    for _ in range(BEYOND):
        if not found.converged[0] or found.decrement[0] <= NOTHING * _tolerances()["tolerance"]:
            break
        nearer = _modes(found.beyond, local)
        if not (nearer.converged[0] and nearer.decrement[0] < found.decrement[0]):
            break
        found = nearer
    return found


def _tolerances() -> dict[str, Any]:
    """Return the predicted decrease of the cost at which a search ends, and the relative rounding
    error. In single precision, a sum over many data cannot resolve a smaller decrease.
    """
    precise = jnp.result_type(float) == jnp.float64
    digit = float(jnp.finfo(jnp.result_type(float)).eps)
    return {"tolerance": 1e-7 if precise else 1e-3, "digit": digit}


@compiled_briefly
def rounding_of_digits(vector: Vector, problem: Problem) -> tuple[Array, Array, Array, Array]:
    """Return four numbers: the rms error of the cost if each prediction is rounded to its digits;
    this error for residuals of one standard deviation; and, for the median datum, the size of the
    prediction, and its last digit in standard deviations of the noise.
    """
    values = values_at(problem, vector)
    seen = prediction(problem, values)
    if not eqx.is_inexact_array(seen) or not seen.size:
        zero = jnp.zeros(())
        return zero, zero, zero, zero
    slope = jax.grad(lambda seen: -jnp.sum(datum_terms(problem, values, seen)))
    gradient, bend = jax.jvp(slope, (seen,), (jnp.ones_like(seen),))
    digit = float(jnp.finfo(seen.dtype).eps) * jnp.abs(seen)
    share = (digit * jnp.sqrt(jnp.abs(bend))).ravel()
    middle = jnp.argsort(share)[share.size // 2]
    expected = share**2 * (1 + share**2 / 4)  # of a residual of one standard deviation
    blur = jnp.sqrt(jnp.sum(expected)) / 2
    whole = jnp.sqrt(jnp.sum(expected + (digit * gradient).ravel() ** 2)) / 2
    return whole, blur, jnp.abs(seen).ravel()[middle], share[middle]


def _nonlinear(problem: Problem) -> np.ndarray:
    """Return the indices of the numbers that are searched and not solved in closed form."""
    return np.setdiff1d(np.arange(len(problem.space)), closed_form_indices(problem))


@compiled_briefly
def _complete_all(vectors: Array, problem: Problem) -> Array:
    return map_(lambda vector: complete(vector, problem), vectors)


def _lowest_of_grid(
    starts: np.ndarray, problem: Problem, cost: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """Return the lowest points, (starts, 1), of a grid over the only searched number."""
    parameter = problem.space[int(_nonlinear(problem)[0])]
    values = prior_values(parameter)
    if values is None:
        return starts
    shares = (np.arange(KNOTS) + 0.5) / KNOTS
    knots = unconstrained_numbers((parameter,), np.interp(shares, FLAT_QUANTILES, values)[:, None])
    every = np.concatenate([starts[:1], knots])
    costs = cost(every)
    order = np.argsort(np.where(np.isfinite(costs), costs, np.inf), kind="stable")
    return every[np.resize(order, len(starts))]


def gauss_newton(vector: Vector, problem: Problem) -> Derivatives:
    """Return cost, gradient and curvature of a sum of squares with its prior (see `add_prior`)."""
    return add_prior(vector, problem, squares(vector, problem))


def squares(vector: Vector, problem: Problem) -> Derivatives:
    """Return half the sum of squared `_residuals` r, its gradient J^T r, and J^T J."""

    residuals, along = jax.linearize(partial(_residuals, problem=problem), vector)
    jacobian = jax.vmap(along)(jnp.eye(vector.size, dtype=vector.dtype))
    return residuals @ residuals / 2, jacobian @ residuals, jacobian @ jacobian.T


def add_prior(
    vector: Any, problem: Problem, of_data: Derivatives, *, squared: bool = True
) -> Derivatives:
    """Add the prior's exact derivatives to cost, gradient and curvature of the data.

    For a sum of squares, J^T J neglects the second derivatives of the prediction with respect to
    the natural values. The second derivatives of the parameters' transforms dominate near an active
    bound and are included."""
    cost, steepness, curvature = of_data
    unlikely, slope, bend = prior_derivatives(vector, problem)
    if squared:
        bent = steepness * natural_slopes(problem.space, vector)[1]
        curvature = curvature + _diagonal(bent)
    return cost + unlikely, steepness + slope, curvature + bend


def prior_derivatives(vector: Any, problem: Problem) -> Derivatives:
    """Return the prior's part of the cost, its gradient and its curvature. They are computed by JAX
    at one vector (P,), or by NumPy at each of several vectors (n, P).
    """
    space = problem.space
    if problem.prior is None and all(parameter.prior is None for parameter in space):
        first, second = log_flat_slopes(space, vector)
        return -log_prior(space, vector), -first, -_diagonal(second)
    if isinstance(vector, np.ndarray):
        return _grouped_calls(_prior_at, vector, problem)

    def prior(vector: Array) -> Array:
        return -log_prior_at(problem, vector)

    return *jax.value_and_grad(prior)(vector), jax.hessian(prior)(vector)


def _diagonal(values: Any) -> Any:
    xp = numpy_or_jax(values)
    return values[..., None] * xp.eye(values.shape[-1], dtype=values.dtype)


def _negative_log_likelihood(vector: Vector, problem: Problem) -> Float[Array, ""]:
    return -log_likelihood(vector, problem)


def _derivatives_at(
    local: Callable[[Vector, Problem], Derivatives], vectors: Array, wanted: Array, problem: Problem
) -> Derivatives:
    """Return derivatives at each vector `wanted`; on an accelerator all at once."""
    count = vectors.shape[1]
    nothing = tuple(jnp.zeros((count,) * axes, vectors.dtype) for axes in (0, 1, 2))

    def derivatives(pair: tuple[Array, Array]) -> Derivatives:
        vector, asked = pair
        return jax.lax.cond(asked, lambda v: local(v, problem), lambda _: nothing, vector)

    together = None if targets_cpu() else len(vectors)
    return map_(derivatives, (vectors, wanted), batch_size=together)


@partial(compiled_briefly, always=False)
def _squares_at(vectors: Array, wanted: Array, problem: Problem) -> Derivatives:
    return _derivatives_at(squares, vectors, wanted, problem)


@partial(compiled_briefly, always=False)
def _twice_at(vectors: Array, wanted: Array, problem: Problem) -> Derivatives:
    return _derivatives_at(
        partial(second_derivatives, _negative_log_likelihood), vectors, wanted, problem
    )


@compiled_briefly
def _prior_at(vectors: Array, wanted: Array, problem: Problem) -> Derivatives:
    del wanted
    return jax.vmap(lambda vector: prior_derivatives(vector, problem))(vectors)


def _grouped_calls(
    program: Callable[..., Derivatives], vectors: np.ndarray, problem: Problem
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Evaluate vectors (n, P) in groups of `BATCH`: one program for any n."""
    found = []
    for begin in range(0, len(vectors), BATCH):
        own = vectors[begin : begin + BATCH]
        filled = np.resize(own, (BATCH, own.shape[1]))
        wanted = np.arange(BATCH) < len(own)
        parts = program(filled.astype(jnp.result_type(float)), wanted, problem)
        found.append([to_host(part, dtype=np.float64)[: len(own)] for part in parts])
    cost, gradient, curvature = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return cost, gradient, curvature


# Squared distance, in standard errors of the sample, up to which two searches of the sample count
# as one optimum. All data resolve finer differences than the sample.
ONE_END = 0.1


def _missing(problem: Problem) -> str:
    """Name the first NaN among the arguments of `predict`, with its row in all data."""
    if problem.stream is None:
        return missing_in_words(problem)
    parts = enumerate(chunks(problem))
    sentences = (missing_in_words(part, first=i * len(part.data)) for i, part in parts)
    return next(filter(None, sentences), "")


def search_read(problem: Problem, sampled: Optimum, advance: Advance) -> Optimum:
    """Return the mode of the posterior for all data of a problem that reads them in chunks."""
    assert problem.stream is not None
    dtype, count = problem.data.dtype, problem.stream.count
    ends = jnp.asarray(sampled.ends, dtype)
    costs = (
        sum(
            np.asarray(_costs_read(ends, part), np.float64)
            for part in chunks(problem, advance=advance)
        )
        + prior_derivatives(sampled.ends, problem)[0]
    )
    costs = np.where(np.isfinite(costs), costs, np.inf)
    best = int(np.argmin(costs))
    if not np.isfinite(costs[best]):
        raise InputError(
            "The log density of all data is finite at none of the places where a search of "
            f"{problem.data.shape[0]} of them ended: "
            f"{_missing(problem) or 'check predict and the data.'}"
        )
    start = sampled.vector if best == int(np.argmin(sampled.costs)) else sampled.ends[best]
    found = minimise_many(
        lambda vectors: derivatives(vectors, problem, parts=chunks(problem, advance=advance)),
        start[None],
        **_tolerances(),
    )
    found = jax.tree.map(lambda x: x[0], found)
    information = found.information
    apart = sampled.ends - sampled.ends[best]
    share = min(1.0, problem.data.shape[0] / count)
    one_end = share * np.einsum("ip,pq,iq->i", apart, information, apart) < ONE_END
    return Optimum(
        vector=found.vector,
        cost=float(found.cost),
        information=information,
        prior_information=prior_derivatives(found.vector[None], problem)[2][0],
        decrement=float(found.decrement),
        stationary=bool(found.converged),
        ends=sampled.ends,
        costs=np.where(one_end, 0.0, costs - costs[best]),
    )


def derivatives(
    vectors: Float[np.ndarray, "searches parameters"],
    problem: Problem,
    *,
    parts: Iterable[Problem] | None = None,
    exact: bool = False,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return cost (n,), gradient (n, P) and curvature (n, P, P) at each of n vectors (n, P), summed
    over `parts` if they are given. With `exact`, the curvature of a sum of squares includes the
    second derivatives of the residuals.
    """
    squared = problem.likelihood.least_squares and not exact
    program = _squares_at if squared else _twice_at
    found = [_grouped_calls(program, vectors, part) for part in parts or [problem]]
    cost, gradient, curvature = (sum(sums) for sums in zip(*found, strict=True))
    return add_prior(vectors, problem, (cost, gradient, curvature), squared=squared)


@eqx.filter_jit
def _costs_read(vectors: Array, problem: Problem) -> Array:
    return map_(
        lambda vector: _negative_log_likelihood(vector, problem),
        vectors,
        batch_size=searches_at_once(vectors),
    )
