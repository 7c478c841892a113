"""Tests the fitted spread of residuals against simulation and closed forms."""

import numpy as np

from fitting.reflectance.from_images.optimum import Spread, fit_spread, sensor_spread, variance

COUNT = 40_000


def draw(rng, signal, spread):
    relative = spread.relative or 0.0
    squared = spread.floor + spread.shot * signal + (relative * signal) ** 2 + 1 / 12
    return np.sqrt(squared) * rng.standard_normal(signal.size)


def test_variance_is_the_sum_of_its_terms():
    spread = Spread(floor=4.0, shot=0.5, relative=0.1)
    np.testing.assert_allclose(
        variance(spread, np.array([100.0]), slope=2.0), 4 * (4 + 50 + 100) + 1 / 12, rtol=1e-14
    )
    assert sensor_spread(0.5, 6.0) == Spread(9.0, 0.5, None)


def test_a_known_sensor_that_explains_the_residuals_is_kept():
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
    # The relative error of a standard deviation from N residuals is about 1 / sqrt(N).
    np.testing.assert_allclose(found.relative, 0.01, rtol=5 / np.sqrt(COUNT) * 2)


def test_floor_and_relative_error_of_an_unknown_sensor_are_found():
    rng = np.random.default_rng(2)
    signal = np.exp(rng.uniform(0, np.log(3000), COUNT))
    truth = Spread(25.0, 0.0, 0.03)
    found = fit_spread(draw(rng, signal, truth), signal, np.ones(COUNT), sensor=None)
    np.testing.assert_allclose(np.sqrt(found.floor), 5.0, rtol=0.02)
    np.testing.assert_allclose(found.relative, 0.03, rtol=0.02)
