"""Fit many small problems that differ only in their data, in one compiled program.

For each problem, a damped Newton method runs from each of the starts, and the end with the lowest
cost is returned. The curvature is the one that `fit` uses: J^T J with the residuals' Jacobian J for
a sum of squares, the Hessian otherwise. A problem with missing or non-finite data fails without
affecting the others.
"""

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .diagnostics import UNDETERMINED
from .newton import minimise
from .parameters import to_natural
from .problem import (
    Problem,
    least_squares_residuals,
    likelihood_at,
    prediction,
    values_at,
)
from .search import (
    SAME_PLACE,
    gauss_newton,
    given_start,
    negative_log_density,
    prior_derivatives,
    starts_about,
)
from .separable import closed_form_indices, complete

TOLERANCE = 1e-10  # decrease of the cost predicted for one more step, at which a search ends


class Ends(eqx.Module):
    """The results of the searches, one for each problem.

    Attributes:
        vector: (problems, P) the modes, unconstrained.
        slope: (problems, P) d natural / d unconstrained of each value.
        data_information: (problems, P, P) curvature of the data's part of the cost.
        prior_information: (problems, P, P) curvature of the prior's part.
        stationary: (problems,) whether the search ended at a maximum.
        determined: (problems,) whether the curvature is positive along every direction.
        finite: (problems,) whether the cost is finite.
        agreeing: (problems,) number of searches that ended at the lowest cost.
        chi_square: (problems,) sum of squared residuals.
        count: (problems,) number of data that are not missing.
    """

    vector: Float[Array, "problems parameters"]
    slope: Float[Array, "problems parameters"]
    data_information: Float[Array, "problems parameters parameters"]
    prior_information: Float[Array, "problems parameters parameters"]
    stationary: Bool[Array, " problems"]
    determined: Bool[Array, " problems"]
    finite: Bool[Array, " problems"]
    agreeing: Int[Array, " problems"]
    chi_square: Float[Array, " problems"]
    count: Int[Array, " problems"]


@eqx.filter_jit
def fit_side_by_side(
    starts: tuple[Float[Array, "starts parameters"], Float[Array, "starts parameters"]],
    problem: Problem,
    data: Float[Array, "problems ..."],
    own: list[Any],
    max_steps: Int[Array, ""],
    chance: Float[Array, "..."],
) -> Ends:
    """Return the modes of problems that differ in data and `own` inputs (None: shared)."""
    leaves, form = jax.tree.flatten(problem.inputs)

    def fit_pixel(data: Array, own: list[Any]) -> Ends:
        present = ~jnp.isnan(data)
        every = [whole if mine is None else mine for mine, whole in zip(own, leaves, strict=True)]
        here = eqx.tree_at(
            lambda p: (p.data, p.present, p.inputs),
            problem,
            (jnp.where(present, data, 0), present, jax.tree.unflatten(form, every)),
            is_leaf=lambda x: x is None,
        )
        begin = starts_about(*starts, given_start(here).astype(starts[0].dtype))
        if closed := closed_form_indices(here):
            others = np.setdiff1d(np.arange(len(here.space)), closed)
            squares = here.likelihood.least_squares
            likely = here.likelihood if squares else here.likelihood.surrogate
            by_squares = eqx.tree_at(lambda p: p.likelihood, here, likely)
            begin = jax.vmap(lambda start: complete(start[others], by_squares))(begin)
        return _fit_pixels(begin, here, max_steps, chance)

    return jax.vmap(fit_pixel)(data, own)


def _fit_pixels(starts: Array, problem: Problem, max_steps: Array, chance: Array) -> Ends:
    squares = problem.likelihood.least_squares
    precise = starts.dtype == jnp.float64
    found = jax.vmap(
        lambda start: minimise(
            negative_log_density,
            start,
            problem,
            derivatives=gauss_newton if squares else None,
            max_steps=max_steps,
            tolerance=TOLERANCE if precise else 1e-3,
        )
    )(starts)
    costs = jnp.where(jnp.isfinite(found.cost), found.cost, jnp.inf)
    best = jax.tree.map(lambda each: each[jnp.argmin(costs)], found)
    # In float32 the search may end on a decrease that is only rounding; its next step is already
    # computed.
    vector = jnp.where(best.converged, best.beyond, best.vector)
    prior = prior_derivatives(best.vector, problem)[2]
    residuals = _residuals(problem, vector, chance)
    assert problem.present is not None
    return Ends(
        vector=vector,
        slope=jax.jvp(partial(to_natural, problem.space), (vector,), (jnp.ones_like(vector),))[1],
        data_information=best.information - prior,
        prior_information=prior,
        stationary=best.converged,
        determined=best.lowest > (UNDETERMINED if precise else 1e-6),
        finite=jnp.isfinite(best.cost) & jnp.isfinite(best.information).all(),
        agreeing=jnp.sum(costs < jnp.min(costs) + SAME_PLACE),
        chi_square=jnp.sum(jnp.where(problem.present, residuals, 0) ** 2),
        count=jnp.sum(problem.present),
    )


def _residuals(problem: Problem, vector: Array, chance: Array) -> Array:
    if problem.likelihood.least_squares:
        return least_squares_residuals(vector, problem).reshape(problem.data.shape)
    values = values_at(problem, vector)
    likelihood = likelihood_at(problem, values)
    predicted = prediction(problem, values)
    return jnp.asarray(likelihood.residuals(predicted, problem.data, chance))
