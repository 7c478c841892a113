"""Tests the sensor's noise: mean and variance of each source against theory, counted once.

Statistical bounds are 5 standard errors of the estimator, with the fourth moment of the
distribution under test, for one fixed seed."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles.sensor_moments import check_moments
from scipy import stats

from jaxvision import as_dtype
from jaxvision.scene import GaussianShotNoise, PhotonConversion, PoissonShotNoise, Sensor
from jaxvision.sensor import (
    collect,
    digitise,
    expected_signal,
    mean_photoelectrons,
    pattern_variance,
    photon_rate,
    raw_image,
    signal_to_noise,
    signal_variance,
)

COUNT = 100_000
KEY, DIE = jax.random.split(jax.random.key(2024))
LEVELS = [0.1, 1.0, 10.0, 1000.0]
POISSON, GAUSSIAN = PoissonShotNoise(), GaussianShotNoise()

raw = jax.jit(raw_image)


def flat(level):
    return jnp.full((COUNT, 1), level)


@pytest.mark.sweep
@pytest.mark.parametrize("level", LEVELS)
def test_poisson_shot_noise_replaces_the_mean(level):
    sample = raw(KEY, Sensor(shot_noise=POISSON), flat(level))
    check_moments(sample, level, level, level + 3 * level**2)
    np.testing.assert_array_equal(sample, jnp.round(sample))
    none = float((sample == 0).mean())
    expected = np.exp(-level)
    assert abs(none - expected) < 5 * np.sqrt(expected * (1 - expected) / COUNT) + 1e-12


def test_poisson_counts_follow_the_distribution():
    """A chi-square test of counts at 3 electrons, with SciPy's probabilities."""
    sample = np.asarray(raw(KEY, Sensor(shot_noise=POISSON), flat(3.0))).ravel().astype(int)
    cells = np.bincount(np.minimum(sample, 10), minlength=11)
    probability = np.append(stats.poisson.pmf(range(10), 3), stats.poisson.sf(9, 3))
    assert stats.chisquare(cells, probability * COUNT).pvalue > 1e-3


@pytest.mark.parametrize("level", LEVELS)
def test_gaussian_shot_noise_has_the_same_two_moments(level):
    sample = raw(KEY, Sensor(shot_noise=GAUSSIAN), flat(level))
    check_moments(sample, level, level, 3 * level**2)


@pytest.mark.parametrize("sigma", LEVELS)
def test_read_noise(sigma):
    sample = raw(KEY, Sensor(read_noise=sigma), flat(50.0))
    check_moments(sample, 50, sigma**2, 3 * sigma**4)


@pytest.mark.sweep
@pytest.mark.parametrize("level", LEVELS)
def test_dark_current_has_its_own_shot_noise(level):
    sensor = Sensor(dark_current=level / 0.25, exposure_time=0.25, shot_noise=POISSON)
    check_moments(raw(KEY, sensor, flat(0.0)), level, level, level + 3 * level**2)
    both = level + 10
    check_moments(raw(KEY, sensor, flat(40.0)), both, both, both + 3 * both**2)


@pytest.mark.parametrize("rms", LEVELS)
def test_dsnu_is_fixed_for_a_die(rms):
    sensor = Sensor(dsnu=rms)
    sample = raw(KEY, sensor, flat(20.0), die_key=DIE)
    check_moments(sample, 20, rms**2, 3 * rms**4)
    np.testing.assert_array_equal(sample, raw(DIE, sensor, flat(20.0), die_key=DIE))
    assert (sample != raw(KEY, sensor, flat(20.0), die_key=KEY)).mean() > 0.99


@pytest.mark.parametrize("level", LEVELS)
def test_prnu_is_relative_to_the_light(level):
    sensor = Sensor(prnu=0.02, dark_current=7.0)
    rms = 0.02 * level
    check_moments(raw(None, sensor, flat(level), die_key=DIE), level + 7, rms**2, 3 * rms**4)


@pytest.mark.parametrize("level", LEVELS)
def test_the_whole_linear_sensor_counts_quantisation_once(level):
    """With a read noise of 2 e- = 1 DN, quantisation noise is white within 1e-8, and adds 1/12
    once."""
    sensor = Sensor(
        quantum_efficiency=0.5,
        exposure_time=0.1,
        dark_current=20.0,
        shot_noise=GAUSSIAN,
        read_noise=2.0,
        gain=0.5,
        offset=100.0,
        bits=12,
    )
    sample = raw(KEY, sensor, flat(level / 0.05))
    variance = 0.25 * (level + 2 + 4) + 1 / 12
    check_moments(sample, 0.5 * (level + 2) + 100, variance, 3 * variance**2)
    np.testing.assert_array_equal(sample, jnp.round(sample))
    one = jnp.asarray([level / 0.05])
    np.testing.assert_allclose(expected_signal(sensor, one), [0.5 * (level + 2) + 100], rtol=1e-14)
    np.testing.assert_allclose(signal_variance(sensor, one), [variance], rtol=1e-14)
    ratio = 0.5 * level / np.sqrt(variance)
    np.testing.assert_allclose(signal_to_noise(sensor, one), [ratio], rtol=1e-12)


def test_pattern_variance_is_that_of_a_noiseless_frame():
    sensor = Sensor(prnu=0.01, dsnu=3.0, gain=0.5, quantum_efficiency=0.5)
    sample = raw(None, sensor, flat(800.0), die_key=DIE)
    variance = 0.25 * (4.0**2 + 9)
    np.testing.assert_allclose(pattern_variance(sensor, jnp.asarray([800.0])), [variance])
    check_moments(sample, 200, variance, 3 * variance**2)
    assert (signal_variance(sensor, jnp.asarray([800.0])) == 0).all()


def test_emva_conversion():
    """EMVA 1288 states it as 50.34 A[um^2] t[ms] lambda[um] E[uW / cm^2] photons."""
    e, wavelength, side, t = 3.0, 0.53, 5.5, 7.0  # uW/cm^2, um, um, ms
    rate = photon_rate(
        jnp.asarray([e * 1e-2]), jnp.asarray(wavelength * 1e-6), jnp.asarray((side * 1e-6) ** 2)
    )
    np.testing.assert_allclose(rate * t * 1e-3, 50.34 * side**2 * t * wavelength * e, rtol=1e-4)


def test_conversion_and_efficiency_are_per_band():
    sensor = Sensor(
        photon_conversion=PhotonConversion([6e-7, 5e-7], 1e-11),
        quantum_efficiency=[0.4, 0.6],
        exposure_time=0.01,
    )
    electrons = mean_photoelectrons(sensor, jnp.ones((4, 5, 2)))
    energy = 6.62607015e-34 * 299792458 / np.array([6e-7, 5e-7])
    np.testing.assert_allclose(
        electrons[2, 3], 1e-11 * 0.01 / energy * np.array([0.4, 0.6]), rtol=1e-14
    )


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_adc_rounds_and_clips_at_every_depth(dtype):
    electrons = jnp.asarray([-3.0, 0.4, 0.6, 1e9], dtype)
    for bits in range(1, 17):
        codes = digitise(as_dtype(Sensor(bits=bits), dtype), electrons)
        np.testing.assert_array_equal(codes, [0, 0, 1, 2**bits - 1])


def test_missing_keys_are_named():
    with pytest.raises(ValueError, match=r"^key must be a random key, got None"):
        collect(None, Sensor(read_noise=1.0), flat(1.0))
    with pytest.raises(ValueError, match=r"^die_key must be a random key, got None"):
        collect(KEY, Sensor(prnu=0.1), flat(1.0))


def test_an_empty_sensor_returns_photons():
    x = jnp.arange(6.0).reshape(2, 3)
    np.testing.assert_array_equal(raw_image(None, Sensor(), x), x)
    np.testing.assert_array_equal(expected_signal(Sensor(), x), x)
