"""Least squares and bounded minimisation against scipy and closed forms."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from decompositions import beside_each_other

from fitting.inference.bounded import minimise_in_box
from fitting.inference.least_squares import minimise_residuals
from fitting.inference.newton import minimise, minimise_many

RNG = np.random.default_rng(1)
X = np.linspace(0, 3, 40)
Y = 2.0 * np.exp(-1.3 * X) + 0.01 * RNG.standard_normal(40)


def decay(vector, args):
    x, y = args
    return (vector[0] * jnp.exp(-vector[1] * x) - y) / 0.01


def test_least_squares_agrees_with_scipy():
    found = minimise_residuals(decay, jnp.array([1.0, 1.0]), (jnp.asarray(X), jnp.asarray(Y)))
    reference = scipy.optimize.least_squares(
        lambda p: (p[0] * np.exp(-p[1] * X) - Y) / 0.01, [1.0, 1.0], xtol=1e-14, ftol=1e-14
    )
    assert found.converged
    sd = np.sqrt(np.diag(np.linalg.inv(reference.jac.T @ reference.jac)))
    np.testing.assert_allclose((found.vector - reference.x) / sd, 0, atol=1e-3)
    np.testing.assert_allclose(found.cost, reference.cost, rtol=1e-8)
    np.testing.assert_allclose(found.gram, reference.jac.T @ reference.jac, rtol=1e-3)
    # At the optimum the step that the gradient still asks for is far below a standard deviation.
    step = np.linalg.solve(np.asarray(found.gram), np.asarray(found.gradient))
    np.testing.assert_allclose(step / sd, 0, atol=1e-3)


def test_least_squares_batches():
    starts = jnp.array([[1.0, 1.0], [3.0, 0.5], [0.5, 2.0]])
    args = (jnp.asarray(X), jnp.asarray(Y))
    many = jax.vmap(lambda start: minimise_residuals(decay, start, args))(starts)
    np.testing.assert_allclose(np.ptp(many.vector, axis=0), 0, atol=1e-5)


def bounded_line(vector, args):
    """Both numbers within their bounds, with a weak prior."""
    x, y = args
    gain, bias = jax.nn.sigmoid(vector)
    return jnp.concatenate([(9 * gain * x + 18 * bias - 9 - y) / 0.1, vector / 1.8])


def test_a_search_with_7_digits_ends_although_its_sum_rounds():
    """Where a fall was the difference of two sums, no step was small enough to be taken."""
    noise = 0.1 * np.random.default_rng(2).standard_normal(10_000)
    for count in (1_000, 10_000):
        x = np.linspace(-1, 1, count)
        y = 2 * x + 0.3 + noise[:count]
        exact, _, _, _ = np.linalg.lstsq(np.stack([x, np.ones_like(x)], -1), y, rcond=None)
        sd = 0.1 / np.sqrt(count) * np.array([np.sqrt(3), 1])
        for start in ([0.0, 0.0], [1.0, -3.0], [-2.0, 2.0]):
            with jax.enable_x64(False):
                given = jnp.asarray(x), jnp.asarray(y)
                found = minimise_residuals(bounded_line, jnp.array(start), given)
            assert found.vector.dtype == jnp.float32
            assert found.converged
            assert found.steps < 30
            natural = [9, 18] / (1 + np.exp(-np.asarray(found.vector, np.float64))) - [0, 9]
            np.testing.assert_allclose((natural - exact) / sd, 0, atol=0.03)


def hopeless(vector, args):
    return jnp.exp(-vector) * args


def test_least_squares_that_cannot_end_says_so():
    found = minimise_residuals(hopeless, jnp.zeros(1), jnp.ones(3), max_steps=3)
    assert not found.converged


def rosenbrock(vector, args):
    x, y = vector
    return (1 - x) ** 2 + args * (y - x**2) ** 2


@pytest.mark.slow
def test_box_minimum_on_a_bound_agrees_with_scipy():
    lower, upper = np.array([-2.0, -1.0]), np.array([0.5, 3.0])
    found = minimise_in_box(
        rosenbrock,
        jnp.array([-1.0, 2.0]),
        jnp.asarray(lower),
        jnp.asarray(upper),
        jnp.asarray(100.0),
        scale=100.0,
    )
    reference = scipy.optimize.minimize(
        lambda p: (1 - p[0]) ** 2 + 100 * (p[1] - p[0] ** 2) ** 2,
        [-1.0, 2.0],
        bounds=list(zip(lower, upper, strict=True)),
        method="L-BFGS-B",
        options={"ftol": 1e-15, "gtol": 1e-10},
    )
    assert found.converged
    np.testing.assert_allclose(found.vector, reference.x, atol=1e-5)
    assert found.vector[0] == upper[0]
    assert lower[1] < found.vector[1] < upper[1]
    np.testing.assert_allclose(found.cost, reference.fun, rtol=1e-6)


def test_only_the_maintenance_notice_of_jaxopt_is_silenced():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        import importlib

        import fitting.inference.bounded

        importlib.reload(fitting.inference.bounded)


def test_one_evaluation_of_newton_gives_the_derivatives_at_the_start():
    x, y = start = np.array([-1.2, 1.0])
    found = minimise(rosenbrock, jnp.asarray(start), 100.0, max_steps=1)
    np.testing.assert_array_equal(found.vector, start)
    np.testing.assert_allclose(found.cost, 24.2, rtol=1e-12)
    hessian = [[1200 * x**2 - 400 * y + 2, -400 * x], [-400 * x, 200]]
    np.testing.assert_allclose(found.information, hessian, rtol=1e-12)
    assert not found.converged


def test_many_searches_never_wait_for_each_other_s_threads():
    """No program of ours runs two decompositions of a batch at the same time: see `decompositions`,
    which finds those that hung."""
    matrices = jnp.ones((5, 3, 3))

    def hung(matrix):
        return jnp.linalg.eigvalsh(matrix), jnp.linalg.inv(matrix)

    assert beside_each_other(jax.vmap(hung), matrices) == [("eigh", "lu")]
    starts = jnp.ones((5, 2))
    newton = jax.vmap(lambda start: minimise(rosenbrock, start, 100.0))
    assert beside_each_other(newton, starts) == []
    data = (jnp.asarray(X), jnp.asarray(Y))
    squares = jax.vmap(lambda start: minimise_residuals(decay, start, data))
    assert beside_each_other(squares, starts) == []


def test_newton_knows_whether_it_ended_at_a_minimum():
    """The lowest eigenvalue of the scaled Hessian is NumPy's, at a minimum, a saddle and a maximum;
    only the first counts as the end of a search."""
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


def test_searches_in_step_end_where_scipys_do_and_none_spoils_another():
    """A decay from three places, one where the cost is not finite and one where it is flat."""
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
