"""Minimisation in a box by jaxopt's L-BFGS-B, for likelihoods that are not sums of squares (with
censored pixels, for example) under physical bounds. This is the only module that imports jaxopt,
and it does so only for a search.

Every variable is scaled to [0, 1] across its box, and the objective by `scale`. Without the
scaling, the solver misses up to a tenth of the optima and takes far longer.
"""

import warnings
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

Objective = Callable[[Float[Array, " parameters"], Any], Float[Array, ""]]


class BoxSolution(eqx.Module):
    """The end of a bounded minimisation.

    Attributes:
        vector: (parameters,).
        cost: the objective there.
        steps: iterations taken.
        converged: whether the norm of the projected gradient is within the tolerance.
    """

    vector: Float[Array, " parameters"]
    cost: Float[Array, ""]
    steps: Int[Array, ""]
    converged: Bool[Array, ""]


@eqx.filter_jit
def minimise_in_box(
    objective: Objective,
    start: Float[Array, " parameters"],
    lower: Float[Array, " parameters"],
    upper: Float[Array, " parameters"],
    args: Any,
    *,
    scale: float | Float[Array, ""] = 1.0,
    max_steps: int = 300,
    tolerance: float = 1e-6,
) -> BoxSolution:
    """Minimise objective(vector, args) over lower <= vector <= upper.

    A fit that does not converge raises nothing; read `converged`."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="JAXopt is no longer maintained")
        from jaxopt import LBFGSB

    width = upper - lower

    def scaled(unit: Float[Array, " parameters"]) -> Float[Array, ""]:
        return objective(lower + width * unit, args) / scale

    # jaxopt mixes dtypes and ranks freely inside.
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        solver = LBFGSB(scaled, maxiter=max_steps, tol=tolerance)
        box = (jnp.zeros_like(start), jnp.ones_like(start))
        unit = jnp.clip((start - lower) / width, 0, 1)
        end, state = solver.run(unit, bounds=box)
    return BoxSolution(
        vector=lower + width * end,
        cost=scaled(end) * scale,
        steps=state.iter_num,
        converged=state.error <= tolerance,
    )
