"""Spread of residuals and cluster-robust errors against simulation and closed forms."""

import numpy as np
import pytest

from fitting.misfit import Spread, cluster_robust, fit_spread, sensor_spread, variance

COUNT = 40_000


def draw(rng, signal, spread):
    return np.sqrt(variance(spread, signal)) * rng.standard_normal(signal.size)


def test_variance_adds_what_it_says():
    spread = Spread(floor=4.0, shot=0.5, relative=0.1)
    np.testing.assert_allclose(
        variance(spread, np.array([100.0]), slope=2.0), 4 * (4 + 50 + 100) + 1 / 12, rtol=1e-14
    )
    assert sensor_spread(0.5, 6.0) == Spread(9.0, 0.5, None)


def test_a_known_sensor_that_explains_the_residuals_stays():
    rng = np.random.default_rng(0)
    signal = rng.uniform(10, 3000, COUNT)
    sensor = sensor_spread(0.25, 6.0)
    slope = np.ones(COUNT)
    assert fit_spread(draw(rng, signal, sensor), signal, slope, sensor=sensor) is sensor


def test_a_relative_error_beyond_the_sensor_is_found():
    rng = np.random.default_rng(1)
    signal = rng.uniform(10, 3000, COUNT)
    sensor = sensor_spread(0.25, 6.0)
    truth = Spread(sensor.floor, sensor.shot, 0.01)
    found = fit_spread(draw(rng, signal, truth), signal, np.ones(COUNT), sensor=sensor)
    # Relative error of a standard deviation from N residuals that it dominates: about 1 / sqrt(N).
    np.testing.assert_allclose(found.relative, 0.01, rtol=5 / np.sqrt(COUNT) * 2)


def test_floor_and_relative_error_of_an_unknown_sensor_are_found():
    rng = np.random.default_rng(2)
    signal = np.exp(rng.uniform(0, np.log(3000), COUNT))
    truth = Spread(25.0, 0.0, 0.03)
    found = fit_spread(draw(rng, signal, truth), signal, np.ones(COUNT), sensor=None)
    np.testing.assert_allclose(np.sqrt(found.floor), 5.0, rtol=0.02)
    np.testing.assert_allclose(found.relative, 0.03, rtol=0.02)


def mean_with_clusters(rng, *, lights, pixels, shared_by_light, shared_by_pixel):
    """Scores of a mean whose unit-variance errors share terms, and the variance of that mean."""
    light, pixel = (x.ravel() for x in np.indices((lights, pixels)))
    own = np.sqrt(1 - shared_by_light**2 - shared_by_pixel**2)
    error = (
        own * rng.standard_normal(light.size)
        + shared_by_light * rng.standard_normal(lights)[light]
        + shared_by_pixel * rng.standard_normal(pixels)[pixel]
    )
    true = own**2 / light.size + shared_by_light**2 / lights + shared_by_pixel**2 / pixels
    scores = (error - error.mean())[None]
    return scores, np.array([[float(light.size)]]), light, pixel, true


def test_independent_errors_keep_the_inverse_information():
    kept = 0
    for seed in range(50):
        data = mean_with_clusters(
            np.random.default_rng(seed), lights=20, pixels=200, shared_by_light=0, shared_by_pixel=0
        )
        found = cluster_robust(*data[:4])
        kept += found.design_effect == 1
        if found.design_effect == 1:
            np.testing.assert_allclose(found.covariance, 1 / data[1], rtol=1e-12)
    # Two tests at 1 % each: 49 of 50 kept on average; 45 or fewer happens once in 2000.
    assert kept >= 46


@pytest.mark.parametrize(("by_light", "by_pixel"), [(0.3, 0.0), (0.0, 0.3), (0.2, 0.2)])
def test_shared_errors_widen_the_covariance_to_the_true_one(by_light, by_pixel):
    ratios = []
    for seed in range(60):
        *data, true = mean_with_clusters(
            np.random.default_rng(seed),
            lights=40,
            pixels=200,
            shared_by_light=by_light,
            shared_by_pixel=by_pixel,
        )
        ratios.append(cluster_robust(*data).covariance[0, 0] / true)
    # J of 40 clusters scatters by sqrt(2/39) = 0.23; widened to Student's t, 39/37 on average.
    assert abs(np.mean(ratios) - 1) < 0.15


def test_few_clusters_are_not_judged():
    data = mean_with_clusters(
        np.random.default_rng(0), lights=4, pixels=100, shared_by_light=0.5, shared_by_pixel=0.0
    )
    found = cluster_robust(*data[:4])
    assert np.isnan(found.by_light)
    assert not np.isnan(found.by_pixel)
