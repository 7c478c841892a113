"""Tests errors of few exposure times, marginalised over their size, against random draws and
SciPy's integrals."""

import numpy as np
import pytest
from scipy import integrate, optimize, stats

from fitting.response.shutter import Shutter, mix_over_tau, tau_posterior

SPREAD, KNOWN = 4.0, 3e-4  # sum (ln t - mean)^2; errors from pixels


def posterior_of_exponent(error, known=0.0):
    """Return (squared scale, degrees of freedom) of an exponent after one observed error."""
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
    """Return the probability position of the true value, for one observed error and one true value
    of each tau."""
    shown = np.hypot(tau, KNOWN) * rng.standard_normal(len(tau))
    truth = np.hypot(tau / np.sqrt(SPREAD), KNOWN) * rng.standard_normal(len(tau))
    square, freedom = np.transpose([posterior_of_exponent(error, known) for error in shown])
    return stats.t.cdf(truth / np.sqrt(square), freedom)


@pytest.mark.slow
@pytest.mark.parametrize("tau", [1e-3, 0.01, 0.03])
def test_three_exposures_cover_for_any_observed_error(tau):
    """One error is observed, by chance a small one. With Student's t of one degree of freedom at
    the most likely tau, 90 % covered, and the standard deviation of z was 1.6."""
    place = places(np.random.default_rng(0), np.full(400, tau))
    assert np.mean(np.abs(place - 0.5) < 0.475) > 0.915
    assert stats.norm.ppf(place).std() < 1.15


@pytest.mark.slow
def test_intervals_cover_over_shutters_of_the_prior():
    rng = np.random.default_rng(1)
    place = places(rng, np.minimum(0.01 * np.exp(2.5 * rng.standard_normal(1000)), 1.0))
    for level in (0.68, 0.95):
        held = np.mean(np.abs(place - 0.5) < level / 2)
        assert abs(held - level) < 3 * np.sqrt(level * (1 - level) / 1000)


def test_the_known_error_of_the_times_is_a_lower_bound():
    square, freedom = posterior_of_exponent(0.0, known=0.01)
    half = np.sqrt(square) * stats.t.ppf(0.975, freedom)
    assert half > 1.96 * 0.01 / np.sqrt(SPREAD)


@pytest.mark.slow
def test_the_stated_error_of_the_times_is_used_unless_images_show_more():
    place = places(np.random.default_rng(2), np.full(600, 0.01), known=0.01)
    for level in (0.68, 0.95):
        held = np.mean(np.abs(place - 0.5) < level / 2)
        assert abs(held - level) < 3 * np.sqrt(level * (1 - level) / 600)
    square, freedom = posterior_of_exponent(0.0, known=0.01)
    assert np.sqrt(square) * stats.t.ppf(0.975, freedom) < 1.2 * 1.96 * 0.01 / np.sqrt(SPREAD)
    square, freedom = posterior_of_exponent(0.1, known=0.01)
    assert np.sqrt(square) * stats.t.ppf(0.975, freedom) > 1.96 * 0.1 / np.sqrt(SPREAD) / 2


def test_codes_with_very_different_errors_have_their_own_quantiles():
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


def test_undetermined_errors_are_uninformative():
    """Differences of precisions are zero up to rounding of either sign."""
    alone = tau_posterior(np.array([2.0]), np.array([[1e6]]), 0.0)
    beside = tau_posterior(np.array([2.0, 1e-9]), np.diag([1e6, -1e-8]), 0.0)
    np.testing.assert_allclose(alone, beside, rtol=1e-12)
