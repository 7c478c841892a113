"""Cost, gradient and curvature of sums of squares and of priors, for Newton's method."""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .parameters import log_prior, to_natural
from .problem import Problem, Vector, least_squares_residuals


def gauss_newton(vector: Vector, problem: Problem) -> tuple[Array, Array, Array]:
    """Cost, gradient and curvature of a sum of squares and its prior, as `with_prior` says.

    Args:
        vector: (P,) unconstrained.
        problem: whose likelihood is one of least squares.

    Returns:
        (), (P,) and (P, P).
    """
    return with_prior(vector, problem, squares(vector, problem))


def squares(vector: Vector, problem: Problem) -> tuple[Array, Array, Array]:
    """Half the sum of squared residuals, its gradient J^T r, and J^T J.

    Args:
        vector: (P,) unconstrained.
        problem: whose likelihood is one of least squares.

    Returns:
        (), (P,) and (P, P).
    """
    residuals, along = jax.linearize(lambda v: least_squares_residuals(v, problem), vector)
    jacobian = jax.vmap(along)(jnp.eye(vector.size, dtype=vector.dtype))
    return residuals @ residuals / 2, jacobian @ residuals, jacobian @ jacobian.T


def with_prior(
    vector: Vector, problem: Problem, of_data: tuple[Array, Array, Array]
) -> tuple[Array, Array, Array]:
    """Cost, gradient and curvature of a sum of squares, with the prior's exact derivatives.

    The curvature leaves out that of the prediction in the natural values, as J^T J does, but not
    that of the transforms: at a bound that binds the latter is most of it.

    Args:
        vector: (P,) unconstrained.
        problem: whose likelihood is one of least squares.
        of_data: as `squares` gives them, of all data.

    Returns:
        (), (P,) and (P, P).
    """
    cost, steepness, gram = of_data
    unlikely, slope, bend = prior_derivatives(vector, problem)
    bent = jnp.diag(steepness * _relative_bend(problem, vector))
    return cost + unlikely, steepness + slope, gram + bent + bend


def prior_derivatives(vector: Vector, problem: Problem) -> tuple[Array, Array, Array]:
    """The prior's part of the cost, its gradient and curvature.

    Args:
        vector: (P,) unconstrained.
        problem: of P free numbers.

    Returns:
        (), (P,) and (P, P).
    """

    def prior(vector: Array) -> Array:
        return -log_prior(problem.space, vector)

    return *jax.value_and_grad(prior)(vector), jax.hessian(prior)(vector)


def _relative_bend(problem: Problem, vector: Vector) -> Vector:
    """x'' / x' of each natural value x by its unconstrained one."""
    ones = jnp.ones_like(vector)

    def slope(vector: Vector) -> Vector:
        return jax.jvp(partial(to_natural, problem.space), (vector,), (ones,))[1]

    first, second = jax.jvp(slope, (vector,), (ones,))
    return jnp.where(first == 0, 0, second / jnp.where(first == 0, 1, first))
