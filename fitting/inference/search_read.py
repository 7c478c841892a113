"""The best fit of data that are read in chunks.

A search of the sample ends near every optimum. Its ends are compared by their cost over all data,
and Newton's method goes on from the best, its cost, gradient and curvature summed over the chunks
in float64. Every step reads all data once.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxvision.errors import InputError

from .curvature import prior_derivatives, squares, with_prior
from .newton import minimise_read, twice
from .on_host import on_host
from .parameters import log_prior
from .problem import Problem, Vector, log_likelihood
from .search import Optimum, at_a_time
from .streams import Advance, chunks

# Squared standard errors of the sample within which its searches ended at one place: all data tell
# apart what the sample's searches, at rest in its own precision, do not.
ONE_END = 0.1

Derivatives = tuple[Array, Array, Array]


def search_read(problem: Problem, sampled: Optimum, advance: Advance) -> Optimum:
    """The mode of the posterior of all data.

    Args:
        problem: whose data are read in chunks.
        sampled: where searches of its sample ended.
        advance: is told how far each reading is.

    Returns:
        The mode, and the searches' ends with their cost by all data, 0 for those at one place with
        the best.

    Raises:
        InputError: when the prediction is finite at none of the ends.
    """
    assert problem.stream is not None
    dtype, count = problem.data.dtype, problem.stream.count
    ends = jnp.asarray(sampled.ends, dtype)
    costs = sum(
        np.asarray(_costs(ends, part), np.float64) for part in chunks(problem, advance=advance)
    ) + np.asarray(_prior_costs(ends, problem), np.float64)
    costs = np.where(np.isfinite(costs), costs, np.inf)
    best = int(np.argmin(costs))
    if not np.isfinite(costs[best]):
        raise InputError(
            "The log density of all data is finite at none of the places where a search of "
            f"{problem.data.shape[0]} of them ended: check predict and the data."
        )
    start = sampled.vector if best == int(np.argmin(sampled.costs)) else sampled.ends[best]
    found = minimise_read(
        lambda vector: derivatives(vector, problem, advance),
        jnp.asarray(start, dtype),
        tolerance=1e-7 if dtype == jnp.float64 else 1e-3,
    )
    information = np.asarray(found.information, np.float64)
    apart = sampled.ends - sampled.ends[best]
    share = min(1.0, problem.data.shape[0] / count)
    one_end = share * np.einsum("ip,pq,iq->i", apart, information, apart) < ONE_END
    return Optimum(
        vector=np.asarray(found.vector, np.float64),
        cost=float(found.cost),
        information=information,
        prior_information=np.asarray(_of_prior(found.vector, problem)[2], np.float64),
        decrement=float(found.decrement),
        stationary=bool(found.converged),
        ends=sampled.ends,
        costs=np.where(one_end, 0.0, costs - costs[best]),
    )


def derivatives(
    vector: Vector, problem: Problem, advance: Advance, *, exact: bool = False
) -> Derivatives:
    """Cost, gradient and curvature over all data.

    Args:
        vector: (P,) unconstrained.
        problem: whose data are read in chunks, or which has but one.
        advance: is told how far the reading is.
        exact: the Hessian itself, also where the likelihood is one of least squares.

    Returns:
        (), (P,) and (P, P).
    """
    by_squares = problem.likelihood.least_squares and not exact
    of_chunk = _squares if by_squares else _of_data
    totals: Any = None
    for part in chunks(problem, advance=advance):
        found = [on_host(x, dtype=np.float64) for x in of_chunk(vector, part)]
        totals = found if totals is None else [a + b for a, b in zip(totals, found, strict=True)]
    cost, gradient, curvature = (jnp.asarray(x, vector.dtype) for x in totals)
    if by_squares:
        return _with_prior(vector, problem, (cost, gradient, curvature))
    prior = _of_prior(vector, problem)
    return cost + prior[0], gradient + prior[1], curvature + prior[2]


_squares = eqx.filter_jit(squares)
_with_prior = eqx.filter_jit(with_prior)
_of_prior = eqx.filter_jit(prior_derivatives)


def _negative_log_likelihood(vector: Vector, problem: Problem) -> Float[Array, ""]:
    return -log_likelihood(vector, problem)


@eqx.filter_jit
def _of_data(vector: Vector, problem: Problem) -> Derivatives:
    return twice(_negative_log_likelihood, vector, problem)


@eqx.filter_jit
def _costs(vectors: Array, problem: Problem) -> Array:
    return jax.lax.map(
        lambda vector: _negative_log_likelihood(vector, problem),
        vectors,
        batch_size=at_a_time(vectors),
    )


@eqx.filter_jit
def _prior_costs(vectors: Array, problem: Problem) -> Array:
    return -log_prior(problem.space, vectors)
