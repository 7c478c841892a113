"""Tests variable projection against SciPy's non-negative least squares and multistart searches."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

from fitting.inference.separable import fit_separable, non_negative_amplitudes

X = np.linspace(0.0, 5.0, 200)


def decays(log_rates):
    return jnp.exp(-jnp.exp(log_rates)[:, None] * jnp.asarray(X, log_rates.dtype)[None])


def best(y, fixed, *, lower, upper, weights=None):
    """Return the fit of one band with fixed columns, (count, observations)."""
    y, fixed = jnp.asarray(y)[:, None], jnp.asarray(fixed, y.dtype)
    weights = jnp.ones_like(y) if weights is None else jnp.asarray(weights)[:, None]
    return fit_separable(decays, fixed, y, weights, lower=lower, upper=upper)


def scipy_best(y, fixed, lower, upper, *, count=20_001):
    """Return the best fit by brute force: SciPy's NNLS on a fine grid of log rates."""
    best = (np.inf, None, None)
    for t in np.linspace(lower, upper, count):
        amplitudes, norm = scipy.optimize.nnls(np.column_stack([*fixed, np.exp(-np.exp(t) * X)]), y)
        if norm**2 < best[0]:
            best = (norm**2, t, amplitudes)
    return best


@pytest.mark.slow
@pytest.mark.parametrize("columns", [1, 2, 3, 4])
def test_amplitudes_agree_with_scipy_nnls(columns):
    rng = np.random.default_rng(columns)
    for _ in range(20):
        design = rng.standard_normal((30, columns))
        y = rng.standard_normal(30)
        expected, norm = scipy.optimize.nnls(design, y)
        found, lowest = non_negative_amplitudes(
            jnp.asarray(design.T @ design), jnp.asarray(design.T @ y)
        )
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(y @ y + lowest, norm**2, rtol=1e-9)


@pytest.mark.slow
def test_equal_and_empty_columns_share_no_amplitude():
    design = np.column_stack([X, X, np.zeros_like(X)])
    found, _ = non_negative_amplitudes(jnp.asarray(design.T @ design), jnp.asarray(design.T @ X))
    np.testing.assert_allclose(found[0] + found[1], 1.0, rtol=1e-12)
    assert np.isfinite(found).all()
    assert found[2] == 0


def test_too_many_columns_are_refused():
    with pytest.raises(ValueError, match="at most four"):
        non_negative_amplitudes(jnp.eye(5), jnp.ones(5))


@pytest.mark.slow
def test_finds_the_brute_force_optimum_with_weights():
    rng = np.random.default_rng(0)
    y = 0.5 + 2.0 * np.exp(-1.7 * X) + 0.05 * rng.standard_normal(X.size)
    weights = rng.uniform(0.0, 2.0, X.size)
    found = best(y, np.ones((1, X.size)), lower=-4.0, upper=4.0, weights=weights)
    root = np.sqrt(weights)

    def residuals(p):
        return root * (p[0] + p[1] * np.exp(-p[2] * X) - y)

    reference = scipy.optimize.least_squares(residuals, [0.5, 2.0, 1.7], xtol=1e-15, ftol=1e-15)
    got = [*found.amplitudes[0], np.exp(found.nonlinear)]
    np.testing.assert_allclose(got, reference.x, rtol=1e-5)
    np.testing.assert_allclose(found.cost, 2 * reference.cost, rtol=1e-9)


def test_negative_amplitudes_are_held_at_zero():
    rng = np.random.default_rng(1)
    y = 1.0 - 0.4 * np.exp(-2.0 * X) + 0.01 * rng.standard_normal(X.size)
    found = best(y, np.ones((1, X.size)), lower=-2.0, upper=4.0)
    cost, _, amplitudes = scipy_best(y, [np.ones_like(X)], -2.0, 4.0, count=601)
    assert found.amplitudes[0, 1] == amplitudes[1] == 0
    np.testing.assert_allclose(found.cost, cost, rtol=1e-9)


def test_a_cost_that_only_falls_ends_at_the_bound():
    y = np.exp(-0.01 * X)  # slower than the slowest rate
    found = best(y, np.zeros((0, X.size)), lower=-1.0, upper=3.0)
    np.testing.assert_allclose(found.nonlinear, -1.0, atol=1e-6)


@pytest.mark.slow
def test_two_fixed_columns_beside_the_searched_one():
    """The reference is SciPy's NNLS at the fitted rate."""
    rng = np.random.default_rng(3)
    y = 0.2 + 0.1 * X + 2 * np.exp(-3 * X) + 0.02 * rng.standard_normal(X.size)
    found = best(y, np.stack([np.ones_like(X), X]), lower=-4.0, upper=4.0)
    design = np.column_stack([np.ones_like(X), X, np.exp(-np.exp(found.nonlinear) * X)])
    expected, norm = scipy.optimize.nnls(design, y)
    np.testing.assert_allclose(found.amplitudes[0], expected, rtol=1e-8)
    np.testing.assert_allclose(found.cost, norm**2, rtol=1e-9)
    cost, _, _ = scipy_best(y, design.T[:2], -4.0, 4.0, count=801)
    assert found.cost <= cost
