"""Variable projection: amplitudes >= 0 in closed form, one nonlinear parameter by search.

For a model that is linear but for one parameter t, which all bands b share,

    y_b ~ a_1b f_1 + ... + a_Kb f_K + a_b g(t),    all a >= 0,

the best amplitudes at a given t are one small non-negative least-squares problem a band, so that
the cost is a curve over t alone (Golub & Pereyra, SIAM J. Numer. Anal. 10, 1973). The search
evaluates that curve on a grid over the whole interval and then on finer grids about the lowest
knot: it needs no start, and none can lead it astray.
"""

import itertools
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .compiled import compiled_briefly

KNOTS = 48
ZOOMS = 4  # each shrinks the interval by (KNOTS - 1) / 2
COLLINEAR = 1e-10  # of 1 - cos^2 between columns: below it their amplitudes cannot be separated

Columns = Callable[[Float[Array, " knots"]], Float[Array, "knots observations"]]


class SeparableFit(eqx.Module):
    """The best fit of a separable model.

    Attributes:
        amplitudes: (bands, columns), of the fixed columns, then of the searched one.
        nonlinear: t, NaN without a searched column.
        cost: weighted sum of squared residuals over all bands.
    """

    amplitudes: Float[Array, "bands columns"]
    nonlinear: float
    cost: float


def non_negative_amplitudes(
    gram: Float[Array, "columns columns"], moment: Float[Array, " columns"]
) -> tuple[Float[Array, " columns"], Float[Array, ""]]:
    """The a >= 0 that minimise a^T G a - 2 a^T b.

    The optimum solves the unconstrained problem on its own support, so with few columns every
    support is tried: branch-free, hence cheap under `vmap`. A column of zeros gets 0.

    Args:
        gram: (columns, columns) G, symmetric and positive semi-definite.
        moment: (columns,) b.

    Returns:
        a, (columns,), and the minimum.

    Raises:
        ValueError: for more than four columns.

    Example:
        >>> from fitting.inference.separable import non_negative_amplitudes
        >>> amplitudes, _ = non_negative_amplitudes(jnp.eye(2), jnp.array([3.0, -1.0]))
        >>> amplitudes.tolist()
        [3.0, 0.0]
    """
    count = len(moment)
    if count > 4:
        raise ValueError(f"at most four columns, got {count}: the supports grow as 2^columns.")
    supports = sorted(itertools.product((False, True), repeat=count), key=sum)[1:]
    found, solvable = jax.vmap(_on_support, (0, None, None))(jnp.array(supports), gram, moment)
    cost = jnp.where(solvable & jnp.all(found >= 0, axis=-1), -found @ moment, jnp.inf)
    best = jnp.argmin(cost)
    better = cost[best] < 0
    return jnp.where(better, found[best], 0), jnp.where(better, cost[best], 0)


def _on_support(support: Array, gram: Array, moment: Array) -> tuple[Array, Array]:
    """The unconstrained optimum of some columns, 0 of the others, and whether it exists."""
    both = support[:, None] & support[None]
    own = jnp.where(both, gram, jnp.eye(len(moment), dtype=gram.dtype))
    return _solve_scaled(own, jnp.where(support, moment, 0))


def _solve_scaled(gram: Array, moment: Array) -> tuple[Array, Array]:
    """G^-1 b through the Cholesky factor of G scaled to unit diagonal, and whether it exists."""
    diagonal = jnp.diagonal(gram)
    present = diagonal > 0
    scale = jnp.where(present, jnp.sqrt(jnp.where(present, diagonal, 1)), 1)
    unit = gram / (scale[:, None] * scale[None])
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
    fixed: Float[Array, "fixed observations"],
    values: Float[Array, "observations bands"],
    weights: Float[Array, "observations bands"],
    *,
    lower: float,
    upper: float,
    coarse: Float[Array, "knots observations"] | None = None,
) -> SeparableFit:
    """The global minimum of sum w (y - fixed^T a - g(t) c)^2 over a, c >= 0 and t.

    Args:
        columns: g at many t in one call: (knots,) to (knots, observations). The grid must show the
            deepest valley, so t should be a coordinate (a logarithm, say) in which valleys are
            alike.
        fixed: (fixed, observations), at most three columns.
        values: (observations, bands) y.
        weights: (observations, bands), inverse variances; 0 leaves an observation out.
        lower: lower end of the interval of t.
        upper: upper end; at either end the search stops there.
        coarse: `columns` of the first grid, `first_knots(lower, upper)`, where fits share it.

    Returns:
        The best fit, t to about 1e-7 of the interval.
    """
    knots = first_knots(lower, upper)
    table = columns(jnp.asarray(knots, values.dtype)) if coarse is None else coarse
    amplitudes, cost = _projected(table, fixed, values, weights)
    for _ in range(ZOOMS):
        best = int(jnp.argmin(cost))
        knots = np.linspace(knots[max(best - 1, 0)], knots[min(best + 1, KNOTS - 1)], KNOTS)
        amplitudes, cost = _projected(
            columns(jnp.asarray(knots, values.dtype)), fixed, values, weights
        )
    best = int(jnp.argmin(cost))
    return SeparableFit(amplitudes[best], float(knots[best]), float(cost[best]))


def first_knots(lower: float, upper: float) -> Float[np.ndarray, " knots"]:
    """The grid on which the search begins: (knots,) from `lower` to `upper`."""
    return np.linspace(lower, upper, KNOTS)


def fit_amplitudes(
    fixed: Float[Array, "fixed observations"],
    values: Float[Array, "observations bands"],
    weights: Float[Array, "observations bands"],
) -> SeparableFit:
    """`fit_separable` without a searched column: its amplitudes are 0, its t is NaN.

    Args:
        fixed: (fixed, observations).
        values: (observations, bands).
        weights: (observations, bands), inverse variances.

    Returns:
        The best fit.
    """
    nothing = jnp.zeros((1, fixed.shape[1]), values.dtype)
    amplitudes, cost = _projected(nothing, fixed, values, weights)
    return SeparableFit(amplitudes[0], float("nan"), float(cost[0]))


@compiled_briefly
def _projected(
    columns: Float[Array, "knots observations"],
    fixed: Float[Array, "fixed observations"],
    values: Float[Array, "observations bands"],
    weights: Float[Array, "observations bands"],
) -> tuple[Float[Array, "knots bands columns"], Float[Array, " knots"]]:
    """Best amplitudes and the cost, summed over bands, for each of several searched columns."""
    weighted = weights * values
    own = jnp.square(columns) @ weights

    def of_fixed(i: int, j: int) -> Array:
        return jnp.broadcast_to((fixed[i] * fixed[j]) @ weights, own.shape)

    count = len(fixed)
    cross = [(columns * column) @ weights for column in fixed[:, None]]
    rows = [[of_fixed(i, j) for j in range(count)] + [cross[i]] for i in range(count)]
    rows.append([*cross, own])
    gram = jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)
    moments = [jnp.broadcast_to(column @ weighted, own.shape) for column in fixed]
    moment = jnp.stack([*moments, columns @ weighted], axis=-1)
    amplitudes, reduction = jax.vmap(jax.vmap(non_negative_amplitudes))(gram, moment)
    return amplitudes, jnp.sum(weighted * values) + reduction.sum(axis=-1)
