"""Non-linear least squares by Levenberg and Marquardt's method.

Residuals must be in units of their standard deviation. Then `cost` is half a chi-square and `gram`
the Fisher information of the vector, and steps below 1e-3 standard deviations are irrelevant.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

FEWEST_UNITS = 8  # of rounding, which tolerances are at least: fewer are never reached
NOTHING = 1e-3  # fall in cost at which a search with 7 digits ends

Residuals = Callable[[Float[Array, " parameters"], Any], Float[Array, " observations"]]


class Solution(eqx.Module):
    """The end of a fit.

    Attributes:
        vector: (parameters,).
        cost: sum r^2 / 2.
        gram: J^T J, the Fisher information of standardised residuals.
        gradient: J^T r.
        steps: iterations taken.
        converged: whether the tolerances were reached.
    """

    vector: Float[Array, " parameters"]
    cost: Float[Array, ""]
    gram: Float[Array, "parameters parameters"]
    gradient: Float[Array, " parameters"]
    steps: Int[Array, ""]
    converged: Bool[Array, ""]


@eqx.filter_jit
def minimise_residuals(
    residuals: Residuals,
    start: Float[Array, " parameters"],
    args: Any,
    *,
    max_steps: int = 200,
    rtol: float = 1e-8,
    atol: float = 1e-8,
    shared_out: bool = False,
) -> Solution:
    """Minimise sum residuals(vector, args)^2 / 2 without bounds; bounds belong in the parameters'
    transforms.

    A fit that does not converge raises nothing; read `converged`.

    `rtol`: relative tolerance on the changes of vector and cost, at least 8 ULP."""
    import lineax as lx  # here, for most fits need none of it
    import optimistix as optx

    from .levenberg_marquardt import LevenbergMarquardt

    least = FEWEST_UNITS * float(jnp.finfo(start.dtype).eps)
    rtol, atol = max(rtol, least), max(atol, least)
    linear = lx.Normal(lx.Cholesky()) if shared_out else lx.QR()
    nothing = NOTHING if start.dtype == jnp.float32 else 0.0
    solver = LevenbergMarquardt(rtol, atol, nothing=nothing, linear_solver=linear)
    found = optx.least_squares(residuals, solver, start, args, max_steps=max_steps, throw=False)
    end, along = jax.linearize(lambda vector: residuals(vector, args), found.value)
    jacobian = jax.vmap(along)(jnp.eye(start.size, dtype=start.dtype))
    return Solution(
        vector=found.value,
        cost=end @ end / 2,
        gram=jacobian @ jacobian.T,
        gradient=jacobian @ end,
        steps=found.stats["num_steps"],
        converged=found.result == optx.RESULTS.successful,
    )
