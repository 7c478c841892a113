"""Maximum likelihood in a few unconstrained parameters, by a damped Newton method that escapes
saddles.

For likelihoods that are not sums of squares, the curvature comes from forward-over-reverse
differentiation, so the final Hessian is the observed information. For sums of squares, exact or
approximate, `derivatives` may give the Gauss-Newton curvature instead.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxvision.programs import thoroughly

from .compiled import compiled_briefly

Objective = Callable[[Float[Array, " parameters"], Any], Float[Array, ""]]
Derivatives = Callable[[Float[Array, " parameters"], Any], tuple[Array, Array, Array]]

EASIER, HARDER = 0.1, 8.0  # what a success and a failure do to the damping
STUCK = 1e12  # damping at which no descent is left
FIRST_DAMPING = 1e-3
SAME_COST = 45  # units of rounding by which an equal cost may rise


class NewtonSolution(eqx.Module):
    """The end of a minimisation.

    Attributes:
        vector: (parameters,).
        beyond: (parameters,) end of one more undamped step, where nothing was evaluated.
        cost: the objective at `vector`.
        information: (parameters, parameters), the Hessian at `vector`.
        lowest: smallest eigenvalue of the information scaled to unit diagonal.
        decrement: decrease in cost that one more Newton step promises; 0.5 is half a squared
            standard deviation.
        steps: number of evaluations.
        converged: whether `decrement` is within the tolerance and the Hessian positive definite.
    """

    vector: Float[Array, " parameters"]
    beyond: Float[Array, " parameters"]
    cost: Float[Array, ""]
    information: Float[Array, "parameters parameters"]
    lowest: Float[Array, ""]
    decrement: Float[Array, ""]
    steps: Int[Array, ""]
    converged: Bool[Array, ""]


class _State(eqx.Module):
    """The best point so far with its derivatives, and the next point to evaluate."""

    vector: Array
    cost: Array
    gradient: Array
    information: Array
    proposal: Array
    beyond: Array
    damping: Array
    lowest: Array
    decrement: Array
    steps: Array


def minimise(
    objective: Objective,
    start: Float[Array, " parameters"],
    args: Any,
    *,
    derivatives: Derivatives | None = None,
    max_steps: int | Int[Array, ""] = 100,
    tolerance: float = 1e-7,
    long: bool = False,
) -> NewtonSolution:
    """Minimise objective(vector, args) until a step predicts a decrease below the tolerance. Works
    under `vmap`.

    A step to a point where the objective is not finite is refused. A fit that does not converge
    raises nothing; read `converged`.

    `derivatives`: cost, gradient (parameters,) and curvature (parameters, parameters) of the
    objective at (vector, args); None differentiates it twice.
    """
    most, enough = jnp.asarray(max_steps), jnp.asarray(tolerance, start.dtype)
    search = _minimise_thoroughly if long else _minimise
    return search(objective, start, args, derivatives, most, enough)


def _search(
    objective: Objective,
    start: Array,
    args: Any,
    derivatives: Derivatives | None,
    max_steps: Array,
    tolerance: Array,
) -> NewtonSolution:
    local = derivatives or partial(twice, objective)

    def step(state: _State) -> _State:
        # The only evaluation in the loop, derivatives included: it is most of what is compiled.
        return _advanced(state, *local(state.proposal, args))

    def goes_on(state: _State) -> Array:
        return _goes_on(state, max_steps, tolerance)

    return _solution(jax.lax.while_loop(goes_on, step, _initial_state(start)), tolerance)


_minimise = compiled_briefly(_search)
_minimise_thoroughly = cast(Any, eqx.filter_jit)(_search, compiler_options=thoroughly())


def minimise_read(
    derivatives: Callable[[Any], tuple[Any, Any, Any]],
    start: Float[Any, " parameters"],
    *,
    max_steps: int = 100,
    tolerance: float = 1e-7,
) -> NewtonSolution:
    """As `minimise`, for an objective that is computed by several programs because its data are
    read again at every step."""
    state = _initial_state(start)
    while _goes_on(state, max_steps, tolerance):  # in NumPy, without programs for single numbers
        state = jax.device_get(_advanced_alone(state, *derivatives(state.proposal)))
    return _solution(state, tolerance)


def _goes_on(state: _State, max_steps: int | Array, tolerance: float | Array) -> Array:
    unfinished = (state.decrement > tolerance) & (state.damping < STUCK)
    return unfinished & (state.steps < max_steps)


def _initial_state(start: Any) -> _State:
    def numbers(values: Any, dtype: Any = start.dtype) -> Any:
        return np.array(values, dtype)

    return _State(
        vector=start,
        cost=numbers(np.inf),
        gradient=numbers(np.zeros(start.shape)),
        information=numbers(np.eye(start.size)),
        proposal=start,
        beyond=start,
        damping=numbers(FIRST_DAMPING),
        lowest=numbers(-np.inf),
        decrement=numbers(np.inf),
        steps=numbers(0, int),
    )


def _advanced(state: _State, cost: Array, gradient: Array, information: Array) -> _State:
    """The state after an evaluation: the better of the two points, and the next point to
    evaluate."""
    rounding = SAME_COST * jnp.finfo(cost.dtype).eps * jnp.abs(state.cost)
    better = cost <= state.cost + jnp.where(jnp.isfinite(rounding), rounding, 0)
    here = _State(
        vector=jnp.where(better, state.proposal, state.vector),
        cost=jnp.where(better, cost, state.cost),
        gradient=jnp.where(better, gradient, state.gradient),
        information=jnp.where(better, information, state.information),
        proposal=state.proposal,
        beyond=state.beyond,
        damping=jnp.where(better, EASIER, HARDER) * state.damping,
        lowest=state.lowest,
        decrement=state.decrement,
        steps=state.steps + 1,
    )
    move, full, fall, lowest = _steps(here)
    return eqx.tree_at(
        lambda state: (state.proposal, state.beyond, state.decrement, state.lowest),
        here,
        (here.vector + move, here.vector + full, jnp.where(better, fall, jnp.inf), lowest),
    )


_advanced_alone = jax.jit(_advanced)


def _solution(end: _State, tolerance: float | Array) -> NewtonSolution:
    return NewtonSolution(
        vector=end.vector,
        beyond=end.beyond,
        cost=end.cost,
        information=end.information,
        lowest=end.lowest,
        decrement=end.decrement,
        steps=end.steps,
        converged=(end.decrement <= tolerance) & (end.lowest > 0),
    )


def twice(
    objective: Objective, vector: Float[Array, " parameters"], args: Any
) -> tuple[Array, Array, Array]:
    """Cost, gradient and Hessian, one column at a time. For large data this takes half the time of
    all columns together, whose intermediate arrays exceed the cache."""
    slope = jax.value_and_grad(objective)

    def column(along: Array) -> tuple[tuple[Array, Array], Array]:
        here, (_, change) = jax.jvp(lambda v: slope(v, args), (vector,), (along,))
        return here, change

    (cost, gradient), information = jax.lax.map(column, jnp.eye(vector.size, dtype=vector.dtype))
    return cost[0], gradient[0], information


def _steps(state: _State) -> tuple[Array, Array, Array, Array]:
    """Return Newton's damped step, the undamped step, the decrease of the cost that the latter
    predicts, and the lowest eigenvalue. The Hessian is scaled to unit diagonal, and `damping` is
    added to the absolute values of its eigenvalues. The step goes downhill from any point, also
    away from saddles (Dauphin et al. 2014).

    There is only one decomposition, whose results are used for everything. If two decompositions of
    a batch run at the same time, each waits in XLA's pool for threads that the other holds, which
    deadlocks on two cores (jaxlib 0.10)."""
    size = jnp.sqrt(jnp.abs(jnp.diagonal(state.information)))
    size = jnp.where(size > 0, size, 1)
    curvature, axes = jnp.linalg.eigh(state.information / jnp.outer(size, size))
    along = axes.T @ (state.gradient / size)
    steepness = jnp.abs(curvature)
    undamped = along / jnp.maximum(steepness, jnp.finfo(along.dtype).eps)
    damped = along / (steepness + state.damping)
    move, full = (-axes @ step / size for step in (damped, undamped))
    return move, full, along @ undamped / 2, curvature[0]
