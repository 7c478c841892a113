"""Tests importance sampling where Laplace's approximation fails: densities with known quantiles,
Jeffreys' prior of scatters, and the report of a posterior."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm, t

from fitting import Gaussian, Problem, fit
from fitting.inference import importance
from fitting.inference.emcee_run import Emcee
from fitting.inference.importance import gaussian_miss, laplace_where_it_holds
from fitting.inference.parameters import Parameter
from fitting.inference.posterior import estimates
from fitting.inference.trust import convergence_in_words, cost_in_words
from fitting.noise.model import NoiseData, scatter_prior

SPACE = (Parameter("a"), Parameter("scale", transform="log"))


def gaussian(vector, args):
    return -jnp.sum(vector @ args * vector) / 2


def level(vector, data):
    """Return the log density of mean and ln scale of normal data, flat in both, where the mean's
    posterior is Student's t."""
    mean, log_scale = vector
    return -data.size * log_scale - jnp.sum((data - mean) ** 2) / (2 * jnp.exp(2 * log_scale))


def test_a_gaussian_needs_only_laplace():
    precision = jnp.asarray([[4.0, 1.5], [1.5, 1.0]])
    covariance = np.linalg.inv(np.asarray(precision))
    mode = jnp.zeros(2)
    np.testing.assert_allclose(gaussian_miss(gaussian, mode, covariance, precision), 0, atol=1e-9)
    found = laplace_where_it_holds(gaussian, SPACE, mode, covariance, precision, seed=0)
    assert found.method == "Laplace"
    assert not found.missed


@pytest.mark.slow
@pytest.mark.parametrize("count", [6, 10])
def test_few_data_give_students_t(count):
    """With 6 data, a Gaussian 95 % interval is too narrow by a factor of at least 2.57 / 1.96."""
    data = jnp.asarray(norm.ppf((np.arange(count) + 0.5) / count))
    mean, log_scale = float(data.mean()), float(jnp.log(data.std()))
    mode = jnp.asarray([mean, log_scale])
    covariance = np.linalg.inv(-np.asarray(jax.hessian(level)(mode, data)))
    found = laplace_where_it_holds(level, SPACE, mode, covariance, data, seed=1)
    assert found.method == "importance sampling"
    assert found.effective > 1000
    own = estimates(found)[0]
    assert own.interval_95 is not None
    exact = t.interval(0.95, count - 1, mean, float(data.std(ddof=1)) / np.sqrt(count))
    np.testing.assert_allclose(own.interval_95, exact, rtol=0.1)
    assert "scale" in convergence_in_words(found)
    assert "importance sampling" in convergence_in_words(found)
    again = laplace_where_it_holds(level, SPACE, mode, covariance, data, seed=1)
    np.testing.assert_array_equal(found.draws, again.draws)


def test_the_prior_of_a_scatter_is_jeffreys():
    """The prior is the root of the information, from differences of the Gaussian's entropy."""
    one = jnp.ones(3)
    data = NoiseData(
        light=1e4 * jnp.arange(1.0, 4.0),
        lit=one,
        exposure=one,
        frames=2 * one,
        pixels=jnp.asarray(1000.0),
        top_signal=jnp.asarray(1e4),
    )
    values = {"system_gain": 0.25, "responsivity": 0.125, "black_level": 60.0, "read_noise": 6.0}
    camera = {name: jnp.asarray(value) for name, value in values.items()}

    def prior(tau):
        return float(scatter_prior({**camera, "light_scatter": jnp.asarray(tau)}, data))

    assert prior(1.0) - prior(0.1) == pytest.approx(0, abs=1e-3)
    assert prior(1e-7) - prior(1e-8) == pytest.approx(2 * np.log(10), abs=1e-3)
    signal = 0.125 * np.asarray(data.light)
    pixels = (0.25 * signal + (0.25 * 6) ** 2 + 1 / 12) / 2000
    tau = 3e-4
    information = np.sum(2 * tau**2 * signal**4 / (pixels + tau**2 * signal**2) ** 2)
    far = np.sum(2 * 1e-14 * signal**4 / (pixels + 1e-14 * signal**2) ** 2)
    expected = np.log(tau * np.sqrt(information)) - np.log(1e-7 * np.sqrt(far))
    assert prior(tau) - prior(1e-7) == pytest.approx(expected, abs=1e-6)


@pytest.mark.slow
def test_a_short_chain_that_was_not_requested_is_not_needed(monkeypatch):
    """If importance sampling fails and the chain is short, the intervals are reported as
    Laplace's."""
    data = jnp.asarray(norm.ppf((np.arange(6) + 0.5) / 6))
    mode = jnp.asarray([float(data.mean()), float(jnp.log(data.std()))])
    covariance = np.linalg.inv(-np.asarray(jax.hessian(level)(mode, data)))
    options = Emcee(walkers=8, steps=20, block=10)
    monkeypatch.setattr(importance, "_importance", lambda *args: None)
    monkeypatch.setattr(importance, "Emcee", lambda **given: options)
    found = laplace_where_it_holds(level, SPACE, mode, covariance, data, seed=1)
    assert (found.method, found.missing_steps) == ("Laplace", 0)
    assert "far from a Gaussian, so Laplace's intervals may mislead" in convergence_in_words(found)


@pytest.mark.slow
def test_a_fit_states_the_error_of_its_approximation():
    """The ends of Laplace's 95 % interval differ from the integrated density by the stated error.
    For draws, it is the standard error of a Gaussian's quantile."""
    problem = Problem({"u": Parameter(start=0.7)}, lambda u: jnp.exp(u)[None], Gaussian(0.1), [2.0])
    found = fit(problem, starts=2)
    u = np.linspace(0.3, 1.1, 200_001)
    places = np.cumsum(np.exp(-((np.exp(u) - 2) ** 2) / 0.02))
    exact = np.interp([0.025, 0.975], places / places[-1], u)
    one = found.estimates[0]
    apart = np.abs(np.array(one.interval_95) - exact).max() / one.standard_error
    assert 0.8 * found.posterior.miss == pytest.approx(apart, rel=0.2)
    assert "95 % intervals by about 0.2 standard errors. The fit took " in str(found)
    assert "posterior=Emcee() draws from the posterior itself." in str(found)
    drawn = replace(found.posterior, method="importance sampling", effective=1e4)
    error = np.sqrt(0.025 * 0.975 / 1e4) / norm.pdf(norm.ppf(0.975))
    told = cost_in_words([drawn], np.nan, typed=True)
    assert f"by about {error:.1g} standard errors. --mcmc" in told
