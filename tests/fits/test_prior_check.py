"""Tests priors that the data contradict, and posteriors that accumulate at a bound."""

import numpy as np
import pytest
from scipy.stats import norm

from fitting import Gaussian, HalfNormal, LogNormal, Normal, Parameter, Problem, fit

NOISE = np.array([-1.5, -0.4, 0.2, 0.7, 1.0])  # with mean 0


def level(data, sd=0.1, **stated):
    free = {"m": Parameter(**stated)}
    return Problem(free, lambda m, inputs: m + inputs, Gaussian(sd), data, inputs=0 * data)


def said(found):
    return [one for one in (*found.failures, *found.findings) if "The prior of" in one]


def test_a_prior_is_compared_with_the_likelihood():
    """(1.3 - 1) / sqrt(.05^2 + .1^2 / 5) = 4.47 standard deviations."""
    problem = level(1.3 + 0.05 * NOISE, prior=Normal(1.0, 0.05))
    found = fit(problem, starts=2)
    assert found.converged
    (told,) = said(found)
    assert "The prior of m, 1 ± 0.05, lies 4.5 standard deviations from" in told
    assert "(1.300 ± 0.045)" in told
    near = fit(problem.with_data(1.2 + 0.05 * NOISE), starts=2)  # 2.98
    assert not said(near)
    # Far away, the misfit is attributed to the prior and not to the model.
    far = fit(problem.with_data(5.0 + 0.05 * NOISE), starts=2)
    assert not far.converged
    assert far.failures[0].startswith("The prior of m, 1 ± 0.05, lies 59.6 standard")
    assert "does not describe the data because of it" in far.failures[0]
    assert not any("within their noise" in one for one in far.failures)


@pytest.mark.slow
def test_a_noise_that_grows_to_explain_a_prior_is_not_reported_as_misfit():
    time = np.linspace(0.0, 4.0, 40)
    data = 2 * time + 1 + 0.1 * np.random.default_rng(0).standard_normal(40)
    free = {
        "slope": Parameter(prior=Normal(5.0, 0.01)),
        "level": Parameter(lower=-10, upper=10),
        "sd": Parameter(lower=0.001, upper=100, transform="log"),
    }
    line = Problem(
        free,
        lambda inputs, slope, level: slope * inputs + level,
        Gaussian("sd"),
        data,
        inputs=time,
    )
    (told,) = said(fit(line, starts=4))
    assert "one of them is wrong" in told
    assert "because of it" not in told


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("prior", "value", "z"),
    [
        (LogNormal(1.0, 0.1), 1.6, np.log(1.6) / np.hypot(0.1, 0.1 / 5**0.5 / 1.6)),
        (HalfNormal(1.0), 4.0, 4 / np.hypot(1, 0.1 / 5**0.5)),
    ],
)
def test_other_priors_are_compared_on_their_own_scale(prior, value, z):
    found = fit(level(value + 0.05 * NOISE, prior=prior), starts=2)
    (told,) = said(found)
    at = float(told.split("lies ")[1].split()[0])
    np.testing.assert_allclose(at, z, rtol=0.04)


def test_an_interval_starts_at_the_bound_where_the_posterior_accumulates():
    """For half a Gaussian, 95 and 68 % are within 1.960 and 0.994 standard deviations."""
    data = 1.0 + 0.05 * NOISE
    found = fit(level(data, 0.05, lower=0, upper=1), starts=2)
    error = 0.05 / 5**0.5
    (one,) = found.estimates
    for interval, share in ((one.interval_95, 0.95), (one.interval_68, 0.68)):
        low = 1 - norm.ppf((1 + share) / 2) * error
        np.testing.assert_allclose(interval, (low, 1), atol=0.08 * error)
        assert interval[1] == 1
    assert any("upper end of its range" in s and "begins there" in s for s in found.findings)
    inside = fit(level(data - 0.5, 0.05, lower=0, upper=1), starts=2)
    np.testing.assert_allclose(
        inside.estimates[0].interval_95, 0.5 + 1.96 * error * np.array([-1, 1]), atol=0.1 * error
    )
    assert not any("begins there" in s for s in inside.findings)


@pytest.mark.slow
@pytest.mark.parametrize("truth", [1.0, 0.995, 0.9])
def test_intervals_cover_a_truth_at_or_near_a_bound(truth):
    problem = level(np.zeros(20), 0.05, lower=0, upper=1)
    held = 0
    for seed in range(200):
        data = truth + 0.05 * np.random.default_rng(2000 + seed).standard_normal(20)
        low, high = fit(problem.with_data(data), starts=2).estimates[0].interval_95
        held += low <= truth <= high
    assert 180 <= held <= 197


@pytest.mark.slow
def test_priors_that_are_true_are_not_flagged():
    """One in 1,000 is flagged by chance, and 5 or more of 1,000 in one of 270 runs."""
    problem, alarms = level(np.zeros(5), prior=Normal(1.0, 0.05)), 0
    for seed in range(1000):
        rng = np.random.default_rng(seed)
        data = rng.normal(1.0, 0.05) + 0.1 * rng.standard_normal(5)
        alarms += len(said(fit(problem.with_data(data), starts=2)))
    assert alarms < 5
