"""Tests autocorrelation times against emcee's, R-hat and effective sample sizes against ArviZ, and
both against an autoregression, where tau = (1 + rho) / (1 - rho)."""

import arviz
import emcee
import numpy as np
import pytest
from scipy.signal import lfilter

from fitting.inference.convergence import (
    autocorrelation_times,
    correct_bias,
    effective_draws,
    split_r_hat,
)


def autoregression(rho, *shape, seed=0):
    """Return x_t = rho x_(t-1) + noise along the first axis, with variance 1 from the start."""
    noise = np.random.default_rng(seed).standard_normal(shape)
    noise[1:] *= np.sqrt(1 - rho**2)
    return lfilter([1.0], [1.0, -rho], noise, axis=0)


def test_autocorrelation_times_are_emcees():
    chain = np.stack([autoregression(rho, 3000, 16) for rho in (0.0, 0.6, 0.9)], axis=-1)
    found = autocorrelation_times(chain)
    reference = emcee.autocorr.integrated_time(chain, tol=0, quiet=True)
    np.testing.assert_allclose(found, np.maximum(reference, 1), rtol=1e-10)
    np.testing.assert_allclose(found, [1, 4, 19], rtol=0.1)


@pytest.mark.parametrize("length", [5, 10, 20, 40])
def test_the_bias_of_short_chains_is_corrected(length):
    """Chains of 5 to 40 autocorrelation times give a third to five sixths of the true value. One
    estimate scatters by 6 %."""
    tau, steps = 39.0, 39 * length
    chain = autoregression(0.95, steps, 64, 20)
    found = np.mean(autocorrelation_times(chain))
    np.testing.assert_allclose(found, tau * length / (length + 10), rtol=0.06)
    np.testing.assert_allclose(correct_bias(found, steps), tau, rtol=0.2)


def test_a_walker_that_never_moved_has_no_autocorrelation_time():
    chain = autoregression(0.5, 200, 4, 2)
    chain[:, 1, 1] = 3.0
    first, second = autocorrelation_times(chain)
    assert np.isfinite(first)
    assert second == np.inf


@pytest.mark.parametrize("rho", [-0.5, 0.0, 0.5, 0.9])
@pytest.mark.parametrize("shift", [0.0, 1.0])
def test_r_hat_and_effective_draws_are_arviz(rho, shift):
    draws = autoregression(rho, 501, 4).T
    draws[0] += shift
    np.testing.assert_allclose(split_r_hat(draws), float(arviz.rhat(draws)), rtol=1e-10)
    np.testing.assert_allclose(effective_draws(draws), float(arviz.ess(draws)), rtol=0.03)
    if shift == 0.0:
        expected = min(draws.size * (1 - rho) / (1 + rho), draws.size * np.log10(draws.size))
        np.testing.assert_allclose(effective_draws(draws), expected, rtol=0.3)


def test_chains_that_differ_only_in_width_are_detected():
    draws = autoregression(0.0, 1000, 4).T
    draws[0] *= 3
    assert split_r_hat(draws) > 1.05
