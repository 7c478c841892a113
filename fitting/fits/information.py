"""Compute the expected (Fisher) information of data about the parameters, as a sum over data:

    F = sum_i E[s_i s_i^T],    s_i = d ln p_i / d vector,

where s_i is the score of datum i with density p_i. For a least-squares likelihood the result is
exact, F = J^T J with the residuals' Jacobian J. For other likelihoods the expectation is a mean
over simulated data.
"""

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxvision.core.parallel_loops import map_
from jaxvision.errors import InputError, nearest

from ..inference.design import Plan, rank
from ..inference.given import require_whole
from ..inference.likelihoods import Clustered
from ..inference.on_host import to_host
from ..inference.posterior import Posterior
from ..inference.problem import (
    Problem,
    Vector,
    as_arrays,
    give,
    least_squares_residuals,
    likelihood_at,
    log_likelihood_terms,
    prediction,
    values_at,
)
from ..inference.search import Optimum

SCORES = 20_000  # squared scores in the mean: an error of 1 % in an element of F
MOST_DRAWS = 2_000
BATCH = 8  # draws evaluated at a time

Target = str | Callable[..., Any]


def expected_information(
    problem: Problem,
    vector: Float[np.ndarray, " parameters"],
    weights: Float[np.ndarray, "parts data"],
    *,
    seed: int = 0,
) -> Float[np.ndarray, "parts parameters parameters"]:
    """Return the Fisher information of future data, with a weight for each datum."""
    size = max(int(np.prod(problem.data.shape)), 1)
    draws = int(np.clip(np.ceil(SCORES / size), 8, MOST_DRAWS))
    exact = problem.likelihood.least_squares
    keys = jax.random.split(jax.random.key(seed), 1 if exact else draws)
    at = jnp.asarray(vector, problem.data.dtype)
    found = _information(at, problem, jnp.asarray(weights, at.dtype), keys)
    return to_host(found, dtype=np.float64)


@eqx.filter_jit
def _information(vector: Vector, problem: Problem, weights: Array, keys: Array) -> Array:
    def outer(slopes: Array) -> Array:
        return jnp.einsum("kn,ni,nj->kij", weights, slopes, slopes)

    if problem.likelihood.least_squares:
        return outer(jax.jacfwd(least_squares_residuals)(vector, problem))
    values = values_at(problem, vector)
    likelihood, predicted = likelihood_at(problem, values), prediction(problem, values)

    def draw_information(key: Array) -> Array:
        drawn = likelihood.draw(key, predicted)
        new = eqx.tree_at(lambda p: p.data, problem, jnp.asarray(drawn, problem.data.dtype))
        return outer(jax.jacfwd(lambda v: log_likelihood_terms(v, new).ravel())(vector))

    return jnp.mean(map_(draw_information, keys, batch_size=BATCH), axis=0)


def replace_inputs(problem: Problem, inputs: Any) -> Problem:
    """Return the problem for data at other inputs, none of them missing."""
    if isinstance(problem.likelihood, Clustered):
        raise InputError(
            "Clustered: the shared error of a new group is unknown; plan with its inner likelihood."
        )
    arrays = jax.tree.map(jnp.asarray, as_arrays(inputs))
    origin = jnp.zeros(len(problem.space))
    try:
        shape = eqx.filter_eval_shape(
            lambda p: jnp.asarray(prediction(p, values_at(p, origin), inputs=arrays)), problem
        ).shape
    except InputError:
        raise
    except (TypeError, ValueError, KeyError, AttributeError) as error:
        raise InputError(
            f"predict cannot use the inputs of a candidate: {str(error).splitlines()[0]}"
        ) from error
    return problem.with_data(np.zeros(shape), inputs=arrays)


def slope_of(
    problem: Problem, target: Target, vector: Float[np.ndarray, " parameters"]
) -> tuple[float, Float[np.ndarray, " parameters"]]:
    """Return the value of a quantity and its derivatives (P,) with respect to the unconstrained
    parameters.
    """
    at = jnp.asarray(vector, problem.data.dtype)
    if isinstance(target, str):
        place = _place(problem, target)
        value, slope = _gradient(at, problem, _number, jnp.asarray(place))
    else:
        value, slope = _gradient(at, problem, target, None)
    return float(value), to_host(slope, dtype=np.float64)


def _place(problem: Problem, target: str) -> int:
    known = [number.name for number in problem.space]
    found = [i for i, name in enumerate(known) if name == target]
    found = found or [i for i, name in enumerate(known) if name.endswith(f".{target}")]
    if len(found) != 1:
        what = "names several numbers" if found else "is no free number"
        raise InputError(f"target = {target!r} {what}; {nearest(target, known)}.")
    return found[0]


def _number(natural: Array, place: Array) -> Array:
    return natural[place]


@eqx.filter_jit
def _gradient(
    vector: Vector, problem: Problem, target: Callable[..., Any], place: Array | None
) -> tuple[Array, Array]:
    def evaluate(vector: Array) -> Array:
        values = values_at(problem, vector)
        if place is not None:
            free = jnp.concatenate([values[p.name].ravel() for p in problem.free])
            return target(free, place)
        found = jnp.asarray(give(problem, target, values, problem.inputs))
        if found.size != 1:
            raise InputError(f"A target is one number, got an array of shape {found.shape}.")
        return found.reshape(())

    return jax.value_and_grad(evaluate)(vector)


def plan(
    problem: Problem,
    optimum: Optimum,
    posterior: Posterior,
    candidates: Mapping[str, Any],
    target: Target,
    *,
    widened: float,
    repeats: int = 1,
) -> Plan:
    """Rank candidate measurements by how much each would reduce the error of a target quantity."""
    if not candidates:
        raise InputError("plan: give at least one candidate.")
    require_whole("repeats", repeats)
    vector = optimum.vector
    value, slope = slope_of(problem, target, vector)
    added = {}
    for name, inputs in candidates.items():
        new = replace_inputs(problem, inputs)
        every = np.ones((1, int(np.prod(new.data.shape))))
        found = expected_information(new, vector, every, seed=posterior.seed)[0]
        if not np.isfinite(found).all():
            raise InputError(
                f"plan: predict or its slope is not finite for candidate {name!r}; check its "
                "inputs for NaN."
            )
        added[name] = found * repeats / widened**2
    return rank(target_name(target), value, slope, posterior.covariance, added)


def target_name(target: Target) -> str:
    """Return the name of a target, which is a parameter's name or a function."""
    return target if isinstance(target, str) else getattr(target, "__name__", "target")
