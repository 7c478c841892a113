"""Errors of few exposure times: mixed over their size, against draws and scipy's integrals."""

import numpy as np
import pytest
from scipy import integrate, optimize, stats

from fitting.response.shutter import Shutter, mix_over_tau, tau_posterior

SPREAD, KNOWN = 4.0, 3e-4  # sum (ln t - mean)^2; errors of pixels' making


def posterior_of_exponent(error, known=0.0):
    """(squared scale, freedom) of an exponent after one error has shown."""
    tau, weights = tau_posterior(np.array([error / KNOWN**2]), np.array([[KNOWN**-2]]), known)
    shutter = Shutter(np.array([1 / SPREAD]), 0.0, tau, weights)
    square, freedom = mix_over_tau(np.array([KNOWN**2]), np.array([1e6]), shutter)
    return square[0], freedom[0]


@pytest.mark.parametrize("error", [0.0, 1e-3, 1e-2])
def test_the_mixture_has_the_quantiles_of_the_integral(error):
    def joint(log_tau, x):
        tau = np.exp(log_tau)
        shown = stats.norm.pdf(error, 0, np.hypot(KNOWN, tau))
        prior = stats.norm.pdf(log_tau, np.log(0.01), 2.5)
        return shown * prior * stats.norm.cdf(x, 0, np.hypot(KNOWN, tau / np.sqrt(SPREAD)))

    square, freedom = posterior_of_exponent(error)
    for level in (stats.norm.cdf(1), 0.975):
        at = np.sqrt(square) * stats.t.ppf(level, freedom)
        grid = np.linspace(np.log(1e-6), 0, 4001)
        below, whole = (integrate.simpson(joint(grid, x), x=grid) for x in (at, np.inf))
        assert below / whole == pytest.approx(level, abs=2e-3)


def places(rng, tau, known=0.0):
    """Where the truth lies, for one shown error and one truth of each tau."""
    shown = np.hypot(tau, KNOWN) * rng.standard_normal(len(tau))
    truth = np.hypot(tau / np.sqrt(SPREAD), KNOWN) * rng.standard_normal(len(tau))
    square, freedom = np.transpose([posterior_of_exponent(error, known) for error in shown])
    return stats.t.cdf(truth / np.sqrt(square), freedom)


@pytest.mark.slow
@pytest.mark.parametrize("tau", [1e-3, 0.01, 0.03])
def test_three_exposures_hold_the_truth_however_small_the_error_that_shows(tau):
    """One error shows, by chance small: with Student's t of one degree of freedom at the likeliest
    tau, 90 % held and the standard deviation of z was 1.6."""
    place = places(np.random.default_rng(0), np.full(400, tau))
    assert np.mean(np.abs(place - 0.5) < 0.475) > 0.915
    assert stats.norm.ppf(place).std() < 1.15


@pytest.mark.slow
def test_intervals_hold_as_often_as_they_say_over_shutters_of_the_prior():
    rng = np.random.default_rng(1)
    place = places(rng, np.minimum(0.01 * np.exp(2.5 * rng.standard_normal(1000)), 1.0))
    for level in (0.68, 0.95):
        held = np.mean(np.abs(place - 0.5) < level / 2)
        assert abs(held - level) < 3 * np.sqrt(level * (1 - level) / 1000)


def test_what_is_known_of_the_times_is_the_least():
    square, freedom = posterior_of_exponent(0.0, known=0.01)
    half = np.sqrt(square) * stats.t.ppf(0.975, freedom)
    assert half > 1.96 * 0.01 / np.sqrt(SPREAD)


@pytest.mark.slow
def test_what_is_stated_of_the_times_is_believed_unless_images_show_more():
    place = places(np.random.default_rng(2), np.full(600, 0.01), known=0.01)
    for level in (0.68, 0.95):
        held = np.mean(np.abs(place - 0.5) < level / 2)
        assert abs(held - level) < 3 * np.sqrt(level * (1 - level) / 600)
    square, freedom = posterior_of_exponent(0.0, known=0.01)
    assert np.sqrt(square) * stats.t.ppf(0.975, freedom) < 1.2 * 1.96 * 0.01 / np.sqrt(SPREAD)
    square, freedom = posterior_of_exponent(0.1, known=0.01)
    assert np.sqrt(square) * stats.t.ppf(0.975, freedom) > 1.96 * 0.1 / np.sqrt(SPREAD) / 2


def test_a_code_of_small_error_beside_an_uncertain_one_has_its_own_quantile():
    """The errors of codes differ by many orders of magnitude where some are extrapolated."""
    tau, variances, per_square = np.geomspace(1e-6, 1, 101), np.array([1e8, 1e-8]), [1.0, 1e-2]
    weights = stats.norm.pdf(np.log(tau), np.log(0.01), 1.5)
    weights /= weights.sum()
    shutter = Shutter(np.array(per_square), 0.01, tau, weights)
    squares, freedoms = mix_over_tau(variances, np.full(2, 1e6), shutter)
    for variance, per, square, freedom in zip(
        variances, per_square, squares, freedoms, strict=True
    ):
        scales = np.sqrt(variance + per * tau**2)
        expected = optimize.brentq(
            lambda x, scales=scales: weights @ stats.norm.cdf(x / scales) - 0.975,
            0,
            1e5,
            xtol=1e-14,
        )
        found = np.sqrt(square) * stats.t.ppf(0.975, freedom)
        np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_nothing_is_uncertain_at_mid_scale():
    shutter = Shutter(np.zeros(2), 0.0, np.array([1e-3, 1e-2]), np.array([0.5, 0.5]))
    square, freedom = mix_over_tau(np.array([0.0, 4.0]), np.array([1e6, 7.0]), shutter)
    assert square[0] == 0
    np.testing.assert_allclose([square[1], freedom[1]], [4.0, 7.0], rtol=0.02)


def test_errors_of_which_images_tell_nothing_tell_nothing():
    """Differences of precisions leave rounding in the place of zeros, of either sign."""
    alone = tau_posterior(np.array([2.0]), np.array([[1e6]]), 0.0)
    beside = tau_posterior(np.array([2.0, 1e-9]), np.diag([1e6, -1e-8]), 0.0)
    np.testing.assert_allclose(alone, beside, rtol=1e-12)
