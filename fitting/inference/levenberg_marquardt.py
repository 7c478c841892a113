"""Levenberg-Marquardt method by optimistix, for costs so large that rounding hides their decrease
per step.

The decrease of the cost is summed over the changes of the residuals. The difference of two sums of
a million squares has the rounding error of the sums. In single precision, a search that uses it
refuses every step near the optimum, takes smaller and smaller ones and never ends. For a line
through 10,000 points with bounded parameters, that search took all of its 100 steps, and this one
takes 5 to 23.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Bool, Float


class Reached(eqx.Module):
    """The state of a search: its step size, and whether it has converged."""

    step_size: Float[Array, ""]
    ended: Bool[Array, ""]


class Falls(optx.ClassicalTrustRegion):
    """Accept or refuse a step by the ratio of actual to predicted decrease, with optimistix'
    constants.

    Attributes:
        nothing: decrease in cost that is negligible; 0 for one of the last digit of the cost. A
            step with a smaller promised decrease is taken even if the cost rises by as much. It is
            the last step, or one of the last few where the damping made it small.
    """

    nothing: float = 0.0

    def init(self, y: Array, f_info_struct: Any) -> Any:
        return Reached(jnp.ones((), y.dtype), jnp.array(False))

    def step(
        self,
        first_step: Bool[Array, ""],
        y: Array,
        y_eval: Array,
        f_info: Any,
        f_eval_info: Any,
        state: Any,
    ) -> tuple[Array, Array, optx.RESULTS, Any]:
        before, after = f_info.residual, f_eval_info.residual
        step = y_eval - y
        linear = f_info.jac.mv(step)
        promised = jnp.sum(linear * (before + linear / 2))
        change = jnp.sum((after - before) * (after + before)) / 2
        digit = jnp.finfo(y.dtype).eps * (before @ before) / 2
        nothing = self.nothing if self.nothing else digit
        small = jnp.abs(promised) <= nothing
        allowed = self.low_cutoff * promised + jnp.where(small, nothing, 0)
        accept = first_step | (change <= allowed)
        good = (change < self.high_cutoff * promised) & (promised < 0) & ~first_step
        # So much that a small promise may be the damping's:
        damped = (state.step_size < 1) | (step @ step > state.step_size * (linear @ linear))
        grows = jnp.where(good, self.high_constant, 1)
        grows = jnp.where(small & damped, self.high_constant**2, grows)
        factor = jnp.where(accept, grows, self.low_constant)
        ended = small & accept & ~first_step & ~damped
        size = (factor * state.step_size).astype(y.dtype)
        return size, accept, optx.RESULTS.successful, Reached(size, ended)


class LevenbergMarquardt(optx.LevenbergMarquardt):
    """Optimistix' solver of that name, with `Falls` to accept or refuse steps."""

    def __init__(
        self, rtol: float, atol: float, *, nothing: float, linear_solver: lx.AbstractLinearSolver
    ) -> None:
        super().__init__(rtol, atol, linear_solver=linear_solver)
        self.search = Falls(nothing=nothing)

    def terminate(
        self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any
    ) -> tuple[Array, optx.RESULTS]:
        ended, result = super().terminate(fn, y, args, options, state, tags)
        return ended | state.search_state.ended, result
