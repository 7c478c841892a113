"""Variable projection over many bands: amplitudes >= 0 of each, one shape common to all.

    y_b ~ a_b f + c_b g(t)        b = 1 .. bands,    a, c >= 0

At a given t every band is a non-negative least-squares problem of two columns, solved in closed
form; their costs add up to a curve over t alone, whose lowest point is found by looking at all of
it: a grid over the interval, then finer grids about the best knot.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .separable import non_negative_amplitudes

KNOTS = 48
ZOOMS = 4  # each shrinks the interval by (KNOTS - 1) / 2

Columns = Callable[[Float[Array, " knots"]], Float[Array, "knots observations"]]


class SharedShapeFit(eqx.Module):
    """amplitudes: of `fixed` and of the searched column, by band. cost: the weighted sum of squared
    residuals."""

    amplitudes: Float[Array, "bands 2"]
    shape: float
    cost: float


@jax.jit
def _projected(
    columns: Float[Array, "knots observations"],
    fixed: Float[Array, " observations"],
    values: Float[Array, "observations bands"],
    weights: Float[Array, "observations bands"],
) -> tuple[Float[Array, "knots bands 2"], Float[Array, " knots"]]:
    """Best amplitudes and the cost, summed over bands, for each of several searched columns."""
    own = jnp.square(columns) @ weights
    cross = (columns * fixed[None]) @ weights
    constant = jnp.broadcast_to(jnp.square(fixed) @ weights, own.shape)
    gram = jnp.stack([constant, cross, cross, own], axis=-1).reshape(*own.shape, 2, 2)
    weighted = weights * values
    moment = jnp.stack([jnp.broadcast_to(fixed @ weighted, own.shape), columns @ weighted], axis=-1)
    amplitudes, reduction = jax.vmap(jax.vmap(non_negative_amplitudes))(gram, moment)
    return amplitudes, jnp.sum(weighted * values) + reduction.sum(axis=-1)


def fit_shared_shape(
    columns: Columns,
    fixed: Float[Array, " observations"],
    values: Float[Array, "observations bands"],
    weights: Float[Array, "observations bands"],
    *,
    lower: float,
    upper: float,
    coarse: Float[Array, "knots observations"] | None = None,
) -> SharedShapeFit:
    """The global minimum of sum w (y - a f - c g(t))^2 over a, c >= 0 and lower <= t <= upper.

    `columns`: g at many t in one call. `coarse`: what it gives for the first grid,
    `first_knots(lower, upper)`, where several fits share it. At an end of the interval the search
    stops there.
    """
    knots = first_knots(lower, upper)
    table = columns(jnp.asarray(knots, values.dtype)) if coarse is None else coarse
    amplitudes, cost = _projected(table, fixed, values, weights)
    for _ in range(ZOOMS):
        best = int(jnp.argmin(cost))
        knots = np.linspace(knots[max(best - 1, 0)], knots[min(best + 1, KNOTS - 1)], KNOTS)
        table = columns(jnp.asarray(knots, values.dtype))
        amplitudes, cost = _projected(table, fixed, values, weights)
    best = int(jnp.argmin(cost))
    return SharedShapeFit(amplitudes[best], float(knots[best]), float(cost[best]))


def first_knots(lower: float, upper: float) -> Float[np.ndarray, " knots"]:
    """Where the search looks first."""
    return np.linspace(lower, upper, KNOTS)


def fit_amplitudes(
    fixed: Float[Array, " observations"],
    values: Float[Array, "observations bands"],
    weights: Float[Array, "observations bands"],
) -> SharedShapeFit:
    """The same without a searched column: its amplitudes are 0, its shape NaN."""
    nothing = jnp.zeros((1, *fixed.shape), values.dtype)
    amplitudes, cost = _projected(nothing, fixed, values, weights)
    return SharedShapeFit(amplitudes[0], float("nan"), float(cost[0]))
