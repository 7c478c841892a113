"""Use finite differences where automatic derivatives miss a part of the prediction's change.

A picture is discontinuous at the edge of a shadow or an outline, and automatic differentiation
misses the motion of the edge. It also misses jumps at rounding and branches. The test computes the
residuals half a standard deviation to both sides of an optimum and compares their change with the
derivative's prediction. If the discrepancy exceeds a tenth of the change and curvature does not
explain it, finite differences are used for the optimum, its curvature and the test of convergence.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxvision.core.parallel_loops import map_

from .compiled import compiled_briefly
from .on_host import to_host
from .problem import Problem, Vector, least_squares_residuals, log_density
from .search import Optimum, add_prior

REACH = 0.5  # posterior standard deviations from the optimum at which residuals are compared
MISSED_SHARE = 0.1  # share of a derivative that a gradient may miss without a warning
LEAST_GAIN = 0.05  # least gain in log density (.3 standard deviations) for a step to be taken
LEAST_RISE = 0.1  # least rise of the cost within a standard deviation; 0.5 for a Gaussian
STEPS = 20
_ROUNDING_SHARE = 1e-3  # share of a step at which differences show only rounding
_SHARES = np.array([1.0, 0.5, 0.25, 0.125])  # shares of a step that are tried


def correct_by_differences(problem: Problem, optimum: Optimum) -> Optimum:
    """Return the optimum, found anew by finite differences if its gradient is incomplete."""
    squares = problem.likelihood.least_squares and problem.stream is None
    if not squares or not np.isfinite(optimum.information).all():
        return optimum
    sizes = REACH * _deviations(optimum.curvature)
    if not (np.isfinite(sizes) & (sizes > 0)).all():
        return optimum
    dtype = problem.data.dtype
    vector = jnp.asarray(optimum.vector, dtype)
    whole, missed, own, rounding = to_host(
        _compare_derivatives(vector, jnp.asarray(sizes, dtype), problem), dtype=np.float64
    ).T
    with np.errstate(invalid="ignore", divide="ignore"):  # NaN is not flagged
        # smooth residuals: `missed` is a third of `own`, and no less than a sixtieth
        near = missed - own / 2 - 2 * rounding > MISSED_SHARE * whole
        farther = own - 60 * missed - 2 * rounding > whole
        share, flagged = np.where(near, missed / whole, own / (own + whole)), near | farther
    if not flagged.any():
        return optimum
    names = [parameter.name for parameter in problem.space]
    unseen = {name: float(s) for name, s, is_so in zip(names, share, flagged, strict=True) if is_so}
    return replace(_descend(problem, optimum, sizes), unseen=unseen)


def _descend(problem: Problem, optimum: Optimum, sizes: np.ndarray) -> Optimum:
    """Search by Gauss-Newton steps with differences, and along the axes; return the lowest
    point."""
    dtype, best = problem.data.dtype, int(np.argmin(optimum.costs))
    vector, settled, begun = np.asarray(optimum.vector, np.float64), False, np.nan
    cost, decrement, information = np.nan, optimum.decrement, optimum.information
    for _ in range(STEPS):
        of_data = _second_differences(
            jnp.asarray(vector, dtype), jnp.asarray(sizes, dtype), problem
        )
        at, steepness, curvature = (to_host(x, dtype=np.float64)[None] for x in of_data)
        found = add_prior(vector[None], problem, (at, steepness, curvature))
        _, gradient, information = (x[0] for x in found)
        values = np.linalg.eigvalsh(information) if np.isfinite(information).all() else [0.0]
        if not values[0] > 0:
            return optimum
        step = -np.linalg.solve(information, gradient)
        decrement = float(-gradient @ step / 2)
        ways = [np.zeros((1, len(step))), _SHARES[:, None] * step, np.diag(sizes), -np.diag(sizes)]
        tried = vector + np.concatenate(ways)
        cost, *costs = to_host(_costs(jnp.asarray(tried, dtype), problem), dtype=np.float64)
        begun = cost if np.isnan(begun) else begun
        lowest = int(np.argmin(np.nan_to_num(costs, nan=np.inf)))
        if settled := not costs[lowest] < cost - LEAST_GAIN:
            break
        vector = tried[1 + lowest]
        sizes = REACH * _deviations(information)
    information = _double_deviations(problem, vector, cost, information)
    fall = float(begun - cost)
    ends, depths = optimum.ends.copy(), optimum.costs + fall
    ends[best], depths[best] = vector, 0.0
    return replace(
        optimum,
        vector=vector,
        cost=optimum.cost - fall,
        information=information,
        decrement=decrement,
        stationary=settled,
        ends=ends,
        costs=depths - depths.min(),
    )


def _double_deviations(
    problem: Problem, vector: np.ndarray, cost: float, information: np.ndarray
) -> np.ndarray:
    """Return the information after doubling each standard deviation until the cost rises on both
    sides: next to a jump of the prediction the cost is flat, and its curvature unreliable."""
    sizes = _deviations(information)
    if not np.isfinite(sizes).all():
        return information
    factors = np.ones(len(sizes))
    for _ in range(STEPS):
        steps = np.diag(factors * sizes)
        tried = jnp.asarray(vector + np.concatenate([steps, -steps]), problem.data.dtype)
        rise = to_host(_costs(tried, problem), dtype=np.float64).reshape(2, -1) - cost
        flat = (rise < LEAST_RISE).any(axis=0)
        if not flat.any():
            break
        factors[flat] *= 2
    return information / np.outer(factors, factors)


def _deviations(information: np.ndarray) -> np.ndarray:
    """Return the standard deviations (P,) from an information matrix; NaN if it has no inverse."""
    scale = np.sqrt(np.abs(np.diagonal(information)))
    with np.errstate(all="ignore"):
        try:
            inverse = np.linalg.inv(information / np.outer(scale, scale))
        except np.linalg.LinAlgError:
            return np.full(len(scale), np.nan)
        return np.sqrt(np.diagonal(inverse)) / scale


@partial(compiled_briefly, always=False)
def _compare_derivatives(
    vector: Vector, sizes: Float[Array, " parameters"], problem: Problem
) -> Float[Array, "parameters 4"]:
    """Compare the residuals' derivative with finite differences, for each parameter. Let D be the
    change of the residuals by a central difference over half of `sizes`. Return four norms over all
    residuals: of D, of D minus the derivative, of D minus the difference over all of `sizes`, and
    of the rounding error.
    """

    residuals = partial(least_squares_residuals, problem=problem)
    here, along = jax.linearize(residuals, vector)

    def norms(number: Array) -> Array:
        way = jnp.zeros_like(vector).at[number].set(sizes[number])
        full, half = (
            (residuals(vector + x * way) - residuals(vector - x * way)) / (2 * x)
            for x in (1.0, 0.5)
        )
        exact = along(way)
        rounding = residuals(vector + _ROUNDING_SHARE * way) - here - _ROUNDING_SHARE * exact
        parts = half, half - exact, full - half, rounding
        return jnp.stack([jnp.sqrt(jnp.sum(part**2)) for part in parts])

    return map_(norms, jnp.arange(vector.size))


@partial(compiled_briefly, always=False)
def _second_differences(
    vector: Vector, sizes: Float[Array, " parameters"], problem: Problem
) -> tuple[Array, Array, Array]:
    """Compute the result of `squares` by central differences."""

    residuals = partial(least_squares_residuals, problem=problem)

    def step(number: Array) -> Array:
        way = jnp.zeros_like(vector).at[number].set(sizes[number])
        return (residuals(vector + way) - residuals(vector - way)) / (2 * sizes[number])

    here, jacobian = residuals(vector), map_(step, jnp.arange(vector.size))
    return here @ here / 2, jacobian @ here, jacobian @ jacobian.T


@partial(compiled_briefly, always=False)
def _costs(vectors: Array, problem: Problem) -> Array:
    return map_(lambda vector: -log_density(vector, problem), vectors)
