"""Variable projection: amplitudes >= 0 in closed form, one nonlinear parameter by search.

For a model that is linear but for one parameter t,

    y ~ a_1 f_1 + ... + a_K f_K + a g(t),    all a >= 0,

the best amplitudes at a given t are a small non-negative least-squares problem, so that the cost
is a curve over t alone (Golub & Pereyra, SIAM J. Numer. Anal. 10, 1973). The minimum of a curve on
an interval is found by looking at all of it: a grid, then a golden section in the best bracket. No
start is needed, and none can lead astray.
"""

import itertools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Column = Callable[[Float[Array, ""], Any], Float[Array, " observations"]]

GOLDEN = (5**0.5 - 1) / 2
COLLINEAR = 1e-10  # of 1 - cos^2 between columns: below it their amplitudes are not told apart


class SeparableFit(eqx.Module):
    """amplitudes: of the fixed columns, then of the searched one. cost: the weighted sum of squared
    residuals."""

    amplitudes: Float[Array, " columns"]
    nonlinear: Float[Array, ""]
    cost: Float[Array, ""]


def non_negative_amplitudes(
    gram: Float[Array, "columns columns"], moment: Float[Array, " columns"]
) -> tuple[Float[Array, " columns"], Float[Array, ""]]:
    """The a >= 0 that minimise a^T G a - 2 a^T b for G = `gram`, b = `moment`, and that minimum.

    The optimum solves the unconstrained problem on its own support, so with few columns (four at
    most) every support is tried; branch-free, hence cheap under `vmap`. A column of zeros gets 0.
    """
    count = len(moment)
    if count > 4:
        raise ValueError(f"at most four columns, got {count}: the supports grow as 2^columns.")
    best, lowest = jnp.zeros_like(moment), jnp.zeros((), moment.dtype)
    for size in range(1, count + 1):
        for support in itertools.combinations(range(count), size):
            chosen = jnp.array(support)
            found, solvable = _solve_scaled(gram[chosen[:, None], chosen[None]], moment[chosen])
            amplitudes = jnp.zeros_like(moment).at[chosen].set(found)
            cost = -found @ moment[chosen]
            better = solvable & jnp.all(found >= 0) & (cost < lowest)
            best = jnp.where(better, amplitudes, best)
            lowest = jnp.where(better, cost, lowest)
    return best, lowest


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


@eqx.filter_jit
def fit_separable(
    fixed: Float[Array, "fixed observations"],
    column: Column,
    values: Float[Array, " observations"],
    args: Any,
    *,
    lower: float | Float[Array, ""],
    upper: float | Float[Array, ""],
    weights: Float[Array, " observations"] | None = None,
    grid: int = 48,
    refinements: int = 30,
) -> SeparableFit:
    """The global minimum of sum w (y - fixed^T a - column(t, args) a_last)^2 over a >= 0 and
    lower <= t <= upper.

    `column`: module-level (it is part of the compile key), evaluated once a grid point and once a
    refinement, each of which shrinks the bracket by 0.618. `weights`: inverse variances, 0 to
    leave an observation out. `grid` must be fine enough to show the deepest valley; choose a
    coordinate (a logarithm, say) in which valleys are alike. At an end of the interval the search
    stops there.
    """
    weighted = values if weights is None else weights * values
    total = weighted @ values
    weighted_fixed = fixed if weights is None else weights[None] * fixed
    fixed_gram, fixed_moment = weighted_fixed @ fixed.T, weighted_fixed @ values

    def projected(t: Array) -> tuple[Array, Array]:
        searched = column(t, args)
        cross = weighted_fixed @ searched
        own = searched if weights is None else weights * searched
        gram = jnp.block(
            [[fixed_gram, cross[:, None]], [cross[None], (own @ searched)[None, None]]]
        )
        return non_negative_amplitudes(gram, jnp.append(fixed_moment, searched @ weighted))

    def cost_at(t: Array) -> Array:
        return projected(t)[1]

    knots = jnp.linspace(lower, upper, grid, dtype=values.dtype)
    deepest = jnp.argmin(jax.lax.map(cost_at, knots))
    low = knots[jnp.maximum(deepest - 1, 0)]
    high = knots[jnp.minimum(deepest + 1, grid - 1)]
    t = _golden_section(cost_at, low, high, refinements)
    amplitudes, reduction = projected(t)
    return SeparableFit(amplitudes, t, total + reduction)


def _golden_section(
    cost_at: Callable[[Array], Array], low: Array, high: Array, refinements: int
) -> Array:
    """Middle of the bracket after `refinements` evaluations beyond the first two."""

    def shrink(_: Any, state: tuple[Array, ...]) -> tuple[Array, ...]:
        low, left, right, high, at_left, at_right = state
        down = at_left < at_right
        low, high = jnp.where(down, low, left), jnp.where(down, right, high)
        new = jnp.where(down, high - GOLDEN * (high - low), low + GOLDEN * (high - low))
        at_new = cost_at(new)
        return (
            low,
            jnp.where(down, new, right),
            jnp.where(down, left, new),
            high,
            jnp.where(down, at_new, at_right),
            jnp.where(down, at_left, at_new),
        )

    left, right = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
    state = (low, left, right, high, cost_at(left), cost_at(right))
    low, _, _, high, *_ = jax.lax.fori_loop(0, refinements, shrink, state)
    return (low + high) / 2
