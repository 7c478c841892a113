"""Tests Newton's method against SciPy and closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from decompositions import beside_each_other

from fitting.inference.newton import minimise, minimise_many

RNG = np.random.default_rng(1)
X = np.linspace(0, 3, 40)
Y = 2.0 * np.exp(-1.3 * X) + 0.01 * RNG.standard_normal(40)


def rosenbrock(vector, args):
    x, y = vector
    return (1 - x) ** 2 + args * (y - x**2) ** 2


def test_one_evaluation_of_newton_gives_the_derivatives_at_the_start():
    x, y = start = np.array([-1.2, 1.0])
    found = minimise(rosenbrock, jnp.asarray(start), 100.0, max_steps=1)
    np.testing.assert_array_equal(found.vector, start)
    np.testing.assert_allclose(found.cost, 24.2, rtol=1e-12)
    hessian = [[1200 * x**2 - 400 * y + 2, -400 * x], [-400 * x, 200]]
    np.testing.assert_allclose(found.information, hessian, rtol=1e-12)
    assert not found.converged


def test_many_searches_never_wait_for_each_others_threads():
    """No program runs two batched decompositions at the same time."""
    matrices = jnp.ones((5, 3, 3))

    def hung(matrix):
        return jnp.linalg.eigvalsh(matrix), jnp.linalg.inv(matrix)

    assert beside_each_other(jax.vmap(hung), matrices) == [("eigh", "lu")]
    starts = jnp.ones((5, 2))
    newton = jax.vmap(lambda start: minimise(rosenbrock, start, 100.0))
    assert beside_each_other(newton, starts) == []


def test_newton_knows_whether_it_ended_at_a_minimum():
    """The lowest eigenvalue of the scaled Hessian equals NumPy's at a minimum, a saddle point and a
    maximum. Only the minimum counts as converged."""
    for signs, place in (((1, 1), 0.0), ((1, -1), 0.0), ((-1, -1), 0.0)):
        curvature = jnp.asarray(signs, float) * jnp.array([3.0, 40.0])

        def bowl(vector, args):
            return jnp.sum(args * vector**2) / 2 + vector[0] * vector[1]

        found = minimise(bowl, jnp.full(2, place), curvature)
        hessian = np.diag(np.asarray(curvature)) + np.eye(2)[::-1]
        size = np.sqrt(np.abs(np.diag(hessian)))
        lowest = np.linalg.eigvalsh(hessian / np.outer(size, size))[0]
        np.testing.assert_allclose(found.lowest, lowest, rtol=1e-12)
        assert bool(found.converged) == (signs == (1, 1))


def test_parallel_searches_end_where_scipys_do():
    """A decay is fitted from several starts, including one where the cost is not finite and one
    where it is flat."""
    starts = np.array([[1.0, 1.0], [5.0, 0.3], [1.0, -600.0], [0.5, 4.0]])

    def local(vectors):
        height, rate = vectors.T[..., None]
        shape = np.exp(-rate * X)
        r = (height * shape - Y) / 0.01
        jacobian = np.stack([shape, -height * X * shape], axis=1) / 0.01
        gram = jacobian @ np.swapaxes(jacobian, 1, 2)
        return np.sum(r**2, -1) / 2, np.sum(jacobian * r[:, None], -1), gram

    found = minimise_many(local, starts, careful=True, digit=2.2e-16)
    best = scipy.optimize.least_squares(
        lambda p: (p[0] * np.exp(-p[1] * X) - Y) / 0.01, [1.0, 1.0], xtol=1e-14, ftol=1e-14
    ).x
    assert found.converged.tolist() == [True, True, False, True]
    np.testing.assert_allclose(found.beyond[[0, 1, 3]], [best] * 3, rtol=1e-6)
    np.testing.assert_array_equal(found.vector[2], starts[2])
