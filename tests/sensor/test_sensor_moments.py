"""Tests mean and variance in closed form, against integrals and frames with every effect at
once."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles.sensors import OF_PHOTONS
from scipy import integrate, stats
from scipy.special import ndtr
from scipy.stats import poisson

from jaxvision import scene as s
from jaxvision.sensor import (
    Moments,
    censored,
    clipped_moments,
    expected_signal,
    pattern_variance,
    raw_image,
    signal_variance,
)

KEY, DIE = jax.random.split(jax.random.key(5))
FULL = replace(OF_PHOTONS, dead_pixels=None, full_well=None, blooming=None)  # nothing is clipped


def quadrature(mean, sigma, low, high):
    def moment(f):
        inner = integrate.quad(
            lambda x: f(x) * stats.norm.pdf(x, mean, sigma), low, high, epsabs=1e-13, limit=200
        )[0]
        below, above = stats.norm.cdf(low, mean, sigma), stats.norm.sf(high, mean, sigma)
        return inner + f(low) * below + f(high) * above

    first = moment(lambda x: x)
    return first, moment(lambda x: (x - first) ** 2)


@pytest.mark.sweep
@pytest.mark.parametrize("mean", [-8.0, -1.0, 0.0, 3.0, 10.0, 12.0, 18.0])
@pytest.mark.parametrize("sigma", [0.3, 2.0, 20.0])
def test_clipped_gaussians_against_quadrature(mean, sigma):
    got = censored(
        Moments(jnp.asarray(mean), jnp.asarray(sigma**2)),
        low=jnp.asarray(0.0),
        high=jnp.asarray(10.0),
    )
    first, second = quadrature(mean, sigma, 0.0, 10.0)
    np.testing.assert_allclose(got.mean, first, atol=1e-9)
    np.testing.assert_allclose(got.variance, second, atol=1e-9)


@pytest.mark.slow
def test_without_noise_the_mean_is_clipped():
    moments = Moments(jnp.asarray([-1.0, 5.0, 20.0]), jnp.zeros(3))
    got = censored(moments, low=jnp.asarray(0.0), high=jnp.asarray(10.0))
    np.testing.assert_array_equal(got.mean, [0, 5, 10])
    np.testing.assert_array_equal(got.variance, 0)


@pytest.mark.sweep
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_an_infinite_well_clips_nothing(dtype):
    """Values and gradients equal those without a well."""
    light = jnp.asarray([1e-3, 10.0, 1e4], dtype)
    plain = s.Sensor(shot_noise=s.PoissonShotNoise(), read_noise=jnp.asarray(2.0, dtype))
    endless = replace(plain, full_well=jnp.asarray(np.inf, dtype))

    def values(sensor):
        return jax.jit(lambda x: jnp.stack(clipped_moments(sensor, x)))

    def slopes(sensor):
        return jax.jit(jax.grad(lambda x: sum(m.sum() for m in clipped_moments(sensor, x))))

    for of in (values, slopes):
        np.testing.assert_allclose(of(endless)(light), of(plain)(light), rtol=1e-6)


@pytest.fixture(scope="module")
def frames():
    """Return 60 frames of each of 40 dies, (dies, frames, h, w), with every effect at once."""

    def shoot(key, die):
        light = jnp.full((24, 32, 1), 40_000.0)
        return raw_image(key, FULL, light, die_key=die)[..., 0]

    @jax.jit
    def afternoon(keys, dies):
        return jax.lax.map(lambda x: jax.vmap(shoot, (0, None))(x[0], x[1]), (keys, dies))

    return np.asarray(afternoon(jax.random.split(KEY, (40, 60)), jax.random.split(DIE, 40)))


@pytest.mark.slow
def test_all_sources_together_have_the_formulas_mean_and_variances(frames):
    light = jnp.full((24, 32, 1), 40_000.0)
    middle = (slice(6, 18), slice(6, 26))
    mean = np.asarray(expected_signal(FULL, light))[..., 0][middle]
    temporal = np.asarray(signal_variance(FULL, light))[..., 0][middle]
    pattern = np.asarray(pattern_variance(FULL, light))[..., 0][middle]
    sample = frames[:, :, 6:18, 6:26]
    of_pixels = sample.mean(axis=1)
    assert abs(sample.mean() / mean.mean() - 1) < 1e-3
    assert abs(sample.var(axis=1, ddof=1).mean() / temporal.mean() - 1) < 0.01
    measured = of_pixels.var(axis=0, ddof=1).mean() - temporal.mean() / 60
    # 40 dies; pixels of a row or column share an offset, about 0.3 of the variance, known to 25 %
    assert abs(measured / pattern.mean() - 1) < 0.12


@pytest.mark.slow
@pytest.mark.parametrize("light", [0.0, 2000.0, 19_500.0, 20_500.0, 60_000.0])
def test_clipping_by_well_and_converter(light):
    """The frames have black clipped at 0 DN, a full well 200 e- below the ADC's range, and light
    beyond."""
    sensor = s.Sensor(
        exposure_time=0.01,
        shot_noise=s.FastPoissonShotNoise(),
        full_well=200.0,
        read_noise=12.0,
        gain=0.5,
        offset=3.0,
        bits=7,
    )
    shape = (400, 500, 1)
    sample = np.asarray(jax.jit(raw_image)(KEY, sensor, jnp.full(shape, light))).ravel()
    mean, variance = (float(x[0]) for x in clipped_moments(sensor, jnp.asarray([light])))
    error = 5 * sample.std() / np.sqrt(sample.size)
    off = 0.07 * np.sqrt(0.25 * 200 / 200)
    assert abs(sample.mean() - mean) < error + off
    assert abs(sample.var() / variance - 1) < 0.03


def test_pattern_of_light_conversion_and_columns_has_the_variance_of_a_product():
    """Each factor is 1 + d or 1 - d in half of the pixels, independently."""
    prnu, conversion, column = 0.3, 0.2, 0.25
    sensor = s.Sensor(prnu=prnu, conversion_prnu=conversion, column_prnu=column, gain=0.5)
    signs = np.stack(np.meshgrid(*[[-1, 1]] * 3), -1).reshape(-1, 3)
    signals = 0.5 * 400 * np.prod(1 + signs * [prnu, conversion, column], axis=1)
    np.testing.assert_allclose(pattern_variance(sensor, jnp.array([400.0])), signals.var())


def by_counts(electrons, read_noise, gain, offset, bits, well=np.inf):
    """Return mean and variance of integer numbers, by a sum over Poisson counts and the ADC's
    codes."""
    counts = np.arange(0, electrons + 12 * np.sqrt(electrons) + 40)
    codes = np.arange(2.0**bits)
    ends = (codes - 0.5 - offset) / gain, (codes + 0.5 - offset) / gain
    ends[0][0], ends[1][-1] = -np.inf, np.inf
    held = np.minimum(counts, well)[:, None]
    share = ndtr((ends[1] - held) / read_noise) - ndtr((ends[0] - held) / read_noise)
    share = poisson.pmf(counts, electrons) @ share
    mean = share @ codes
    return mean, share @ (codes - mean) ** 2


@pytest.mark.parametrize(
    ("electrons", "read_noise", "gain", "offset", "bits", "well", "error"),
    [
        (0.2, 0.1, 1.0, 0.0, 12, np.inf, 1e-5),
        (0.01, 0.2, 1.0, 0.0, 1, np.inf, 1e-5),  # a one-bit sensor
        (2.0, 0.15, 1.0, 0.0, 1, np.inf, 1e-5),
        (10.0, 0.3, 1.0, 0.0, 3, np.inf, 1e-5),
        (19.9, 2.0, 0.7, 8.0, 10, np.inf, 1e-5),
        (5.0, 0.3, 1.0, 2.0, 8, 4.0, 1e-5),
        (30.0, 2.0, 0.1, 0.3, 12, np.inf, 5e-3),  # Gaussian
        (900.0, 3.0, 0.25, 8.0, 8, np.inf, 1e-3),
    ],
)
@pytest.mark.sweep
def test_faint_light_and_few_bits_have_the_moments_of_counts(
    electrons, read_noise, gain, offset, bits, well, error
):
    sensor = s.Sensor(
        shot_noise=s.PoissonShotNoise(),
        read_noise=read_noise,
        gain=gain,
        offset=offset,
        bits=float(bits),
        full_well=None if well == np.inf else well,
    )
    found = clipped_moments(sensor, jnp.asarray([electrons]))
    truth = by_counts(electrons, read_noise, gain, offset, bits, well)
    np.testing.assert_allclose([x[0] for x in found], truth, rtol=error)


@pytest.mark.slow
def test_counts_without_read_noise_are_rounded_as_the_converter_does():
    """Halves are rounded to even codes, and a full well gives one code without variance."""

    @jax.jit
    def found(electrons, gain, well):
        noise = s.PoissonShotNoise()
        sensor = s.Sensor(shot_noise=noise, gain=gain, offset=3.0, bits=12, full_well=well)
        return jnp.stack(clipped_moments(sensor, electrons))[:, 0]

    for gain, well in ((0.5, 1e3), (0.25, 1e3), (0.25, 2.0), (1.0, 10.3), (0.25, 250.0)):
        for electrons in (5.0, 1e5):
            counts = np.arange(60) if electrons < 20 else np.array([electrons])
            share = poisson.pmf(counts, electrons) if electrons < 20 else np.ones(1)
            numbers = np.round(gain * np.minimum(counts, well) + 3)
            mean = share @ numbers
            truth = mean, share @ (numbers - mean) ** 2
            one = found(jnp.asarray([electrons]), gain, well)
            np.testing.assert_allclose(one, truth, rtol=1e-5, atol=1e-12)


@pytest.mark.slow
def test_a_signal_far_above_a_narrow_window_is_its_upper_end():
    """In float32, a signal of 10^15 DN with noise of 3e10 DN has the mean 65535 DN and variance 0
    if the converter ends at 65535 DN."""
    far = Moments(jnp.array(1e15, jnp.float32), jnp.array(1e21, jnp.float32))
    ends = {name: jnp.array(x, jnp.float32) for name, x in (("low", 0), ("high", 65535))}
    assert [float(x) for x in censored(far, **ends)] == [65535, 0]
