"""Minimise a function of a few unconstrained parameters by a damped Newton method that escapes
saddles.

The curvature is the exact Hessian, by forward-over-reverse differentiation, so that at the end it
is the observed information. For sums of squares, exact or approximate, `derivatives` may return the
Gauss-Newton curvature instead.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxvision.core.parallel_loops import map_

from .compiled import compiled_briefly
from .parameters import numpy_or_jax

Objective = Callable[[Float[Array, " parameters"], Any], Float[Array, ""]]
Derivatives = Callable[[Float[Array, " parameters"], Any], tuple[Array, Array, Array]]

EASIER, HARDER = 0.1, 8.0  # factors on the damping after a success and after a failure
MAX_DAMPING = 1e12  # damping at which no descent is left
FIRST_DAMPING = 1e-3
CAREFUL = 0.1  # the first damping from a start that may lie anywhere
SAME_COST = 45  # increase of the cost, in units of rounding, that still counts as no increase
SAME_BLUR = 4  # the same increase in units of `blur`


class NewtonSolution(eqx.Module):
    """The point at which a minimisation ended, and the objective's derivatives there."""

    vector: Float[Array, " parameters"]  # the best point
    # the end of one more undamped step; the objective was not evaluated there
    beyond: Float[Array, " parameters"]
    cost: Float[Array, ""]  # the objective at `vector`
    # (parameters, parameters), the Hessian at `vector`
    information: Float[Array, "parameters parameters"]
    lowest: Float[Array, ""]  # smallest eigenvalue of the information scaled to unit diagonal
    # decrease in cost that one more Newton step predicts; 0.5 corresponds to a step of one standard
    # deviation
    decrement: Float[Array, ""]
    steps: Int[Array, ""]  # number of evaluations
    # whether `decrement` is within the tolerance and the Hessian positive definite
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
) -> NewtonSolution:
    """Minimise objective(vector, args) until the predicted decrease of a step is below the
    tolerance. `derivatives` returns cost, gradient and curvature; if None, the objective is
    differentiated twice. A step to a point where the objective is not finite is refused.
    """
    most, enough = jnp.asarray(max_steps), jnp.asarray(tolerance, start.dtype)
    return _minimise(objective, start, args, derivatives, most, enough)


def _search(
    objective: Objective,
    start: Array,
    args: Any,
    derivatives: Derivatives | None,
    max_steps: Array,
    tolerance: Array,
) -> NewtonSolution:
    local = derivatives or partial(second_derivatives, objective)
    digit = float(jnp.finfo(start.dtype).eps)

    def step(state: _State) -> _State:
        # The only evaluation in the loop, derivatives included: it is most of what is compiled.
        return _advance(state, *local(state.proposal, args), digit=digit)

    end = jax.lax.while_loop(
        lambda state: _is_unfinished(state, max_steps, tolerance), step, _initial_state(start)
    )
    return _solution(end, tolerance)


_minimise = compiled_briefly(_search)


def minimise_many(
    derivatives: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]],
    start: Float[np.ndarray, "searches parameters"],
    *,
    max_steps: int = 100,
    tolerance: float = 1e-7,
    digit: float,
    careful: bool = False,
    blur: float = 0.0,
    progress: Callable[[int], None] | None = None,
) -> Any:
    """Run `minimise` from several starts at once, in NumPy. Only the derivatives are compiled; they
    are evaluated for the searches that have not ended. Returns a `NewtonSolution` of NumPy arrays.

    `derivatives` returns costs (n,), gradients (n, P) and curvatures (n, P, P) at vectors (n, P).
    `digit` is the relative rounding error of the costs. With `careful` the damping also limits
    steps along numbers that the data hardly determine, as a prior of width 1 would. Without it a
    first step may end far away, where all slopes vanish. `blur` is an absolute error of the costs.
    `progress` is called with the count of ended searches."""
    state = _initial_state(np.array(start, np.float64), CAREFUL if careful else FIRST_DAMPING)
    how = {"digit": digit, "least": float(careful), "blur": blur}
    active = np.ones(len(start), bool)
    while active.any():
        part = jax.tree.map(lambda x: x[active], state)  # noqa: B023
        with np.errstate(all="ignore"):
            cost, gradient, information = derivatives(part.proposal)
            known = np.isfinite(cost) & np.isfinite(gradient).all(-1)
            known &= np.isfinite(information).all((-1, -2))
            part = _advance(part, np.where(known, cost, np.nan), gradient, information, **how)
        for whole, own in zip(jax.tree.leaves(state), jax.tree.leaves(part), strict=True):
            whole[active] = own
        active = _is_unfinished(state, max_steps, tolerance) & np.isfinite(state.cost)
        if progress is not None:
            progress(int(np.sum(~active)))
    return _solution(state, tolerance)


def minimise_read(
    derivatives: Callable[[Any], tuple[Any, Any, Any]],
    start: Float[Any, " parameters"],
    *,
    tolerance: float = 1e-7,
) -> NewtonSolution:
    """Minimise as `minimise` does, with derivatives summed outside JAX, for data in chunks."""

    def local(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        found = derivatives(vectors[0].astype(start.dtype))
        cost, gradient, curvature = (np.asarray(x, np.float64)[None] for x in found)
        return cost, gradient, curvature

    digit = float(jnp.finfo(start.dtype).eps)
    found = minimise_many(local, np.asarray(start)[None], tolerance=tolerance, digit=digit)
    return jax.tree.map(lambda x: x[0], found)


def _is_unfinished(state: _State, max_steps: Any, tolerance: Any) -> Any:
    unfinished = (state.decrement > tolerance) & (state.damping < MAX_DAMPING)
    return unfinished & (state.steps < max_steps)


def _initial_state(start: Any, damping: float = FIRST_DAMPING) -> _State:
    """Return the first state of one search from (P,), or of many from (searches, P)."""
    xp, one = numpy_or_jax(start), start[..., 0]
    return _State(
        vector=start,
        cost=xp.full_like(one, np.inf),
        gradient=xp.zeros_like(start),
        information=xp.zeros_like(start)[..., None] + xp.eye(start.shape[-1], dtype=start.dtype),
        proposal=xp.array(start),
        beyond=xp.array(start),
        damping=xp.full_like(one, damping),
        lowest=xp.full_like(one, -np.inf),
        decrement=xp.full_like(one, np.inf),
        steps=xp.zeros(one.shape, int),
    )


def _advance(
    state: _State,
    cost: Any,
    gradient: Any,
    information: Any,
    *,
    digit: float,
    least: float = 0.0,
    blur: float = 0.0,
) -> _State:
    """Return the state after a proposal: the better of two points, and the next proposal."""
    xp = numpy_or_jax(state.vector)
    rounding = SAME_COST * digit * xp.abs(state.cost) + SAME_BLUR * blur
    better = cost <= state.cost + xp.where(xp.isfinite(rounding), rounding, 0)
    here = replace(
        state,
        vector=xp.where(better[..., None], state.proposal, state.vector),
        cost=xp.where(better, cost, state.cost),
        gradient=xp.where(better[..., None], gradient, state.gradient),
        information=xp.where(better[..., None, None], information, state.information),
        damping=xp.where(better, EASIER, HARDER) * state.damping,
        steps=state.steps + 1,
    )
    move, full, fall, lowest = _steps(here, digit, least)
    return replace(
        here,
        proposal=here.vector + move,
        beyond=here.vector + full,
        decrement=xp.where(better, fall, np.inf),
        lowest=lowest,
    )


def _solution(end: _State, tolerance: Any) -> NewtonSolution:
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


def second_derivatives(
    objective: Objective, vector: Float[Array, " parameters"], args: Any
) -> tuple[Array, Array, Array]:
    """Return cost, gradient and Hessian, column by column, which is faster for large data."""
    slope = jax.value_and_grad(objective)

    def column(along: Array) -> tuple[tuple[Array, Array], Array]:
        here, (_, change) = jax.jvp(lambda v: slope(v, args), (vector,), (along,))
        return here, change

    (cost, gradient), information = map_(column, jnp.eye(vector.size, dtype=vector.dtype))
    return cost[0], gradient[0], information


def _steps(state: _State, digit: float, least: float) -> tuple[Any, Any, Any, Any]:
    """Return Newton's damped step, the undamped step, the decrease of the cost that the undamped
    step predicts, and the lowest eigenvalue. The Hessian is scaled to unit diagonal, where each
    diagonal element counts as at least `least`, and `damping` is added to the absolute values of
    its eigenvalues. The step goes downhill from any point, and away from saddles (Dauphin et al.
    2014).

    All results come from one eigendecomposition. Two decompositions of a batch at the same time
    would deadlock on two cores (jaxlib 0.10), because each waits in XLA's pool for threads that the
    other holds."""
    xp = numpy_or_jax(state.vector)
    diagonal = xp.diagonal(state.information, axis1=-2, axis2=-1)
    size = xp.sqrt(xp.maximum(xp.abs(diagonal), least))
    size = xp.where(size > 0, size, 1)
    curvature, axes = xp.linalg.eigh(state.information / (size[..., :, None] * size[..., None, :]))
    along = ((state.gradient / size)[..., None, :] @ axes)[..., 0, :]
    steepness = xp.abs(curvature)
    undamped = along / xp.maximum(steepness, digit)
    damped = along / (steepness + state.damping[..., None])
    move, full = (-(axes @ step[..., None])[..., 0] / size for step in (damped, undamped))
    return move, full, xp.sum(along * undamped, axis=-1) / 2, curvature[..., 0]
