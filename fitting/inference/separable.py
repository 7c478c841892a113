"""Solve for linear parameters in closed form, and search for the nonlinear ones (variable
projection).

Suppose the residuals r of a `Problem` are linear in some numbers a, r(t, a) = r(t, 0) + J(t) a. For
given nonlinear numbers t, the best a, unbounded or at least 0, is then the solution of a small
linear problem, and the search is over t alone (`eliminate`). Its steps include the derivative of
the best a with respect to t, so they equal the steps of the whole problem. No start for a is
needed.

`fit_separable` needs no start at all. It fits data y_b in several bands b by a model with fixed
columns f_1 ... f_K and one column g(t). Its only nonlinear parameter t is shared by all bands:

    y_b ~ a_1b f_1 + ... + a_Kb f_K + a_b g(t),    all a >= 0,

At a given t, the best amplitudes a solve one small non-negative least-squares problem for each
band, so the cost is a function of t alone (Golub & Pereyra, SIAM J. Numer. Anal. 10, 1973). The
search evaluates this function on a grid over the whole interval, and then on finer grids around the
lowest point.
"""

import itertools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxvision.errors import InputError
from jaxvision.programs import short_run_options

from .on_host import to_host
from .parameters import ends, prior_values, to_natural, to_unconstrained
from .problem import Problem, residuals_from

KNOTS = 48
ZOOMS = 4  # each shrinks the interval by (KNOTS - 1) / 2
MOST_SIGNED = 6  # non-negative amplitudes up to which every support is tried
SWEEPS = 300  # sweeps of coordinate descent, which finds the support if there are more
UNROLLED = 8  # amplitudes up to which a factorisation is written out, which batches better
BEND = 1e-3  # relative bend of the residuals from which they are not linear
COLLINEAR = 1e-10  # 1 - cos^2 between columns below which amplitudes are not identifiable

Columns = Callable[[Any], Any]  # of (knots,) values of t: (knots, observations)


class SeparableFit(eqx.Module):
    """The best fit of a separable model."""

    # amplitudes of the fixed columns, then of the searched one
    amplitudes: Float[Any, "bands columns"]
    nonlinear: float  # the nonlinear parameter t; NaN without a searched column
    cost: float  # weighted sum of squared residuals over all bands


def non_negative_amplitudes(
    gram: Float[Array, "columns columns"], moment: Float[Array, " columns"]
) -> tuple[Float[Array, " columns"], Float[Array, ""]]:
    """Return the a >= 0 that minimise a^T G a - 2 a^T b, with G = `gram` and b = `moment`, and that
    minimum. A column of zeros has the amplitude 0."""
    if len(moment) > 4:
        raise ValueError(
            f"at most four columns, got {len(moment)}: the supports grow as 2^columns."
        )
    found, fall = _best_support(gram, moment, (True,) * len(moment))
    return found, -fall


def _supports(signed: tuple[bool, ...]) -> list[tuple[bool, ...]]:
    """Return all possible sets of non-zero columns, the smallest set first. Columns without a bound
    on their sign are in every set."""
    choices = [(False, True) if one else (True,) for one in signed]
    return sorted(itertools.product(*choices), key=sum)


def amplitudes(
    gram: Float[Array, "columns columns"],
    moment: Float[Array, " columns"],
    signed: tuple[bool, ...],
) -> Float[Array, " columns"]:
    """Return the a that minimise a^T G a - 2 a^T b, at least 0 where `signed` is true."""
    if not any(signed):
        return _solve_scaled(gram, moment)[0]
    if sum(signed) > MOST_SIGNED:
        support = _descend_coordinates(*jax.lax.stop_gradient((gram, moment)), np.array(signed))
        found, _ = _support_optimum(support, gram, moment)
        return jnp.where(np.array(signed), jnp.maximum(found, 0), found)
    return _best_support(gram, moment, signed)[0]


def _best_support(gram: Array, moment: Array, signed: tuple[bool, ...]) -> tuple[Array, Array]:
    """Return the best of the optima of all supports, and a^T b there. Without branches, this is
    cheap under `vmap`."""
    supports = jnp.array(_supports(signed))
    found, solvable = jax.vmap(_support_optimum, (0, None, None))(supports, gram, moment)
    inside = jnp.all((found >= 0) | ~np.array(signed)[None], axis=-1)
    fall = jnp.where(solvable & inside, found @ moment, -jnp.inf)
    best = jnp.argmax(fall)
    known = jnp.isfinite(fall[best])
    return jnp.where(known, found[best], 0), jnp.where(known, fall[best], 0)


def _descend_coordinates(gram: Array, moment: Array, signed: np.ndarray) -> Array:
    """Return the support that some sweeps of coordinate descent find."""
    own = jnp.where(jnp.diagonal(gram) > 0, jnp.diagonal(gram), 1)

    def step(i: Array, a: Array) -> Array:
        at = i % len(moment)
        best = a[at] + (moment[at] - gram[at] @ a) / own[at]
        return a.at[at].set(jnp.where(jnp.asarray(signed)[at], jnp.maximum(best, 0), best))

    found = jax.lax.fori_loop(0, SWEEPS * len(moment), step, jnp.zeros_like(moment))
    return (found > 0) | ~signed


def _support_optimum(support: Array, gram: Array, moment: Array) -> tuple[Array, Array]:
    """Return the optimum with 0 outside the support, and whether it exists."""
    both = support[:, None] & support[None]
    own = jnp.where(both, gram, jnp.eye(len(moment), dtype=gram.dtype))
    return _solve_scaled(own, jnp.where(support, moment, 0))


def _solve_scaled(gram: Array, moment: Array) -> tuple[Array, Array]:
    """Return G^-1 b by the Cholesky factor of G scaled to unit diagonal, and whether it exists."""
    diagonal = jnp.diagonal(gram)
    present = diagonal > 0
    scale = jnp.where(present, jnp.sqrt(jnp.where(present, diagonal, 1)), 1)
    unit = gram / (scale[:, None] * scale[None])
    if len(moment) > UNROLLED:
        factor = jnp.linalg.cholesky(unit + COLLINEAR * jnp.eye(len(moment), dtype=gram.dtype))
        found = jax.scipy.linalg.cho_solve((factor, True), moment / scale)
        return found / scale, jnp.all(present) & jnp.isfinite(found).all()
    lower = [[jnp.zeros((), gram.dtype)] * len(moment) for _ in moment]
    solvable = jnp.all(present)
    for i in range(len(moment)):
        for j in range(i + 1):
            rest = unit[i, j] - sum(lower[i][k] * lower[j][k] for k in range(j))
            if i > j:
                lower[i][j] = rest / lower[j][j]
                continue
            independent = rest > COLLINEAR
            solvable = solvable & independent
            lower[i][i] = jnp.sqrt(jnp.where(independent, rest, 1))
    factor = jnp.stack([jnp.stack(row) for row in lower])
    found = jax.scipy.linalg.cho_solve((factor, True), moment / scale)
    return found / scale, solvable


def fit_separable(
    columns: Columns,
    fixed: Float[Any, "fixed observations"],
    values: Float[Any, "observations bands"],
    weights: Float[Any, "observations bands"],
    *,
    lower: float,
    upper: float,
    coarse: Float[Any, "knots observations"] | None = None,
    finer: int = KNOTS,
) -> SeparableFit:
    """Return the global minimum of sum w (y - fixed^T a - g(t) c)^2 over a, c >= 0 and t. With
    fewer knots in each of the `finer` grids, fewer columns are evaluated, but more grids are
    needed.
    """
    knots = first_knots(lower, upper)
    table = columns(knots.astype(values.dtype)) if coarse is None else coarse
    amplitudes, cost = _project(table, fixed, values, weights)
    shrunk = ZOOMS * np.log((KNOTS - 1) / 2) / np.log((finer - 1) / 2)
    for _ in range(int(np.ceil(shrunk))):
        best = int(np.argmin(cost))
        knots = np.linspace(knots[max(best - 1, 0)], knots[min(best + 1, len(knots) - 1)], finer)
        amplitudes, cost = _project(columns(knots.astype(values.dtype)), fixed, values, weights)
    best = int(np.argmin(cost))
    return SeparableFit(amplitudes[best], float(knots[best]), float(cost[best]))


def first_knots(lower: float, upper: float) -> Float[np.ndarray, " knots"]:
    """Return the grid (knots,) from `lower` to `upper` on which the search begins."""
    return np.linspace(lower, upper, KNOTS)


def fit_amplitudes(
    fixed: Float[Any, "fixed observations"],
    values: Float[Any, "observations bands"],
    weights: Float[Any, "observations bands"],
) -> SeparableFit:
    """Fit the fixed columns alone: the searched amplitude is 0, t is NaN."""
    nothing = np.zeros((1, fixed.shape[1]), values.dtype)
    amplitudes, cost = _project(nothing, fixed, values, weights)
    return SeparableFit(amplitudes[0], float("nan"), float(cost[0]))


def _project(
    columns: Float[Any, "knots observations"],
    fixed: Float[Any, "fixed observations"],
    values: Float[Any, "observations bands"],
    weights: Float[Any, "observations bands"],
) -> tuple[Float[np.ndarray, "knots bands columns"], Float[np.ndarray, " knots"]]:
    """Return the best amplitudes and the cost, summed over bands, for each of several searched
    columns. The sums over observations use NumPy, so that JAX compiles no program for a new number
    of observations."""
    columns, fixed, values, weights = map(np.asarray, (columns, fixed, values, weights))
    weighted = weights * values
    own = np.square(columns) @ weights
    cross = [(columns * column) @ weights for column in fixed[:, None]]
    rows = [
        [*(np.broadcast_to((one * other) @ weights, own.shape) for other in fixed), mixed]
        for one, mixed in zip(fixed, cross, strict=True)
    ]
    rows.append([*cross, own])
    gram = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    moments = [np.broadcast_to(column @ weighted, own.shape) for column in fixed]
    moment = np.stack([*moments, columns @ weighted], axis=-1)
    knots = len(columns)
    padded = (np.resize(x, (KNOTS, *x.shape[1:])) for x in (gram, moment))
    amplitudes, reduction = (np.asarray(x)[:knots] for x in _non_negative(*padded))
    return amplitudes, np.sum(weighted * values) + reduction.sum(axis=-1)


_non_negative = jax.jit(
    jax.vmap(jax.vmap(non_negative_amplitudes)), compiler_options=short_run_options()
)


def closed_form_indices(problem: Problem) -> tuple[int, ...]:
    """Return the indices, in a problem's space, of the numbers that are solved in closed form."""
    surrogate = problem.likelihood.surrogate
    if not (
        problem.likelihood.least_squares or (surrogate is not None and surrogate.least_squares)
    ):
        return ()
    return tuple(i for i, parameter in enumerate(problem.space) if parameter.linear)


class Eliminated(eqx.Module):
    """A problem with its linear numbers eliminated."""

    # (data + K,) residuals of the data, then of the priors of the K linear numbers
    residuals: Float[Array, " residuals"]
    natural: Float[Array, " linear"]  # (K,) the best values, in their units
    precision: Float[Array, " linear"]  # (K,) curvature of the cost along each linear number alone


def eliminate(nonlinear: Float[Array, " nonlinear"], problem: Problem) -> Eliminated:
    """Return the best linear numbers for given nonlinear ones, with the residuals that remain."""
    closed = closed_form_indices(problem)
    rest, along = jax.linearize(
        lambda a: residuals_from(_natural(nonlinear, a, problem), problem),
        jnp.zeros(len(closed), nonlinear.dtype),
    )
    columns = jax.vmap(along)(jnp.eye(len(closed), dtype=nonlinear.dtype))
    known = [prior_values(problem.space[i]) for i in closed]
    mean = jnp.array([0.0 if x is None else np.mean(x) for x in known], nonlinear.dtype)
    weight = jnp.array([0.0 if x is None else 1 / np.std(x) for x in known], nonlinear.dtype)
    gram = columns @ columns.T + jnp.diag(weight**2)
    signed = tuple(bool(ends(problem.space[i])[0] == 0) for i in closed)
    best = amplitudes(gram, weight**2 * mean - columns @ rest, signed)
    missed = jnp.concatenate([rest + best @ columns, weight * (best - mean)])
    return Eliminated(missed, best, jnp.diagonal(gram))


def _natural(nonlinear: Array, linear: Array, problem: Problem) -> Array:
    """Return linear and nonlinear numbers, in their units, as one vector (P,)."""
    closed = np.array(closed_form_indices(problem), int)
    others = np.setdiff1d(np.arange(len(problem.space)), closed)
    space = tuple(problem.space[i] for i in others)
    whole = jnp.zeros(len(problem.space), nonlinear.dtype).at[closed].set(linear)
    return whole.at[others].set(to_natural(space, nonlinear)) if len(others) else whole


def complete(nonlinear: Float[Array, " nonlinear"], problem: Problem) -> Float[Array, " all"]:
    """Return the unconstrained vector (P,) of the nonlinear numbers and the best linear ones. A
    linear number that is at least 0 takes the mode of its posterior on the logarithmic scale, (a_0
    + sqrt(a_0^2 + 4 sd^2)) / 2, with a_0 its best value and sd its standard deviation.
    """
    found = eliminate(nonlinear, problem)
    signed = np.array([ends(problem.space[i])[0] == 0 for i in closed_form_indices(problem)], bool)
    variance = 1 / jnp.where(found.precision > 0, found.precision, 1)
    inside = (found.natural + jnp.sqrt(found.natural**2 + 4 * variance)) / 2
    linear = jnp.where(signed, inside, found.natural)
    return to_unconstrained(problem.space, _natural(nonlinear, linear, problem))


def require_linear(nonlinear: Float[Array, " nonlinear"], problem: Problem) -> None:
    """Refuse parameters that are stated to be linear if the prediction is not linear in them."""
    on_line, own = (to_host(x) for x in _bends(nonlinear, problem))
    size = np.max(np.abs(on_line)) + np.finfo(on_line.dtype).tiny
    if np.isfinite(own).all() and np.max(np.abs(own)) > BEND * size:
        names = [problem.space[i].name for i in closed_form_indices(problem)]
        raise InputError(
            f"predict is not linear in {', '.join(names)}: state linear=True only of numbers that "
            "multiply or add."
        )


@eqx.filter_jit
def _bends(nonlinear: Array, problem: Problem) -> tuple[Array, Array]:
    found = eliminate(nonlinear, problem)
    step = jnp.abs(found.natural) + jnp.sqrt(1 / jnp.where(found.precision > 0, found.precision, 1))
    at = [residuals_from(_natural(nonlinear, k * step, problem), problem) for k in (0.0, 1.0, 2.0)]
    return jnp.stack(at), at[2] - 2 * at[1] + at[0]
