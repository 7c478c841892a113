"""Levenberg and Marquardt's method by optimistix, for sums whose rounding drowns their falls.

A fall in cost is summed over the changes of the residuals. The difference of two sums of a million
squares is no better than the last digit of the sums: in single precision, a search that is judged
by it refuses every step near the optimum, makes ever smaller ones and never ends. A line through
10,000 points took all of 100 steps that way, and takes 5.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Bool, Float

GOOD, FAIR = 0.99, 0.01  # of the promised fall: the step grows, or is taken
GROWS, SHRINKS = 3.5, 0.25  # then or otherwise (Gould et al. 2005, as optimistix has them)


class Reached(eqx.Module):
    """How far a search has come: its step size, and whether no more can be gained."""

    step_size: Float[Array, ""]
    ended: Bool[Array, ""]


class Falls(optx.AbstractSearch):
    """Takes a step or refuses it, as optimistix' classical trust region does.

    Attributes:
        nothing: fall in cost that means nothing. A step that promises no more is taken even if the
            cost rises by as much, and is the last one, or the last but few where the damping made
            it small.
    """

    nothing: float

    def init(self, y: Array, f_info_struct: Any) -> Reached:
        return Reached(jnp.ones((), y.dtype), jnp.array(False))

    def step(
        self,
        first_step: Bool[Array, ""],
        y: Array,
        y_eval: Array,
        f_info: Any,
        f_eval_info: Any,
        state: Reached,
    ) -> tuple[Array, Array, optx.RESULTS, Reached]:
        before, after = f_info.residual, f_eval_info.residual
        linear = f_info.jac.mv(y_eval - y)
        promised = jnp.sum(linear * (before + linear / 2))
        change = jnp.sum((after - before) * (after + before)) / 2
        small = jnp.abs(promised) <= self.nothing
        accept = first_step | (change <= FAIR * promised + jnp.where(small, self.nothing, 0))
        good = (change < GOOD * promised) & (promised < 0) & ~first_step
        damped = state.step_size < 1  # so much that a small promise may be the damping's
        grows = jnp.where(small & damped, GROWS**2, jnp.where(good, GROWS, 1))
        factor = jnp.where(accept, grows, SHRINKS)
        ended = small & accept & ~first_step & ~damped
        size = (factor * state.step_size).astype(y.dtype)
        return size, accept, optx.RESULTS.successful, Reached(size, ended)


class LevenbergMarquardt(optx.AbstractGaussNewton):
    """Optimistix' method of that name, whose steps `Falls` takes or refuses."""

    rtol: float
    atol: float
    norm: Callable
    descent: optx.DampedNewtonDescent
    search: Falls
    verbose: Callable

    def __init__(
        self, rtol: float, atol: float, *, nothing: float, linear_solver: lx.AbstractLinearSolver
    ) -> None:
        self.rtol, self.atol, self.norm = rtol, atol, optx.max_norm
        self.descent = optx.DampedNewtonDescent(linear_solver)
        self.search = Falls(nothing)
        self.verbose = lambda **_: None

    def terminate(
        self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any
    ) -> tuple[Array, optx.RESULTS]:
        ended, result = super().terminate(fn, y, args, options, state, tags)
        return ended | state.search_state.ended, result
