"""Tests each source of noise against its distribution, and random numbers against published ones.

Statistical bounds are 5 standard errors, with the fourth moment of the distribution under test, for
one fixed seed."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles.sensor_moments import check_moments
from scipy import stats

from jaxvision import scene as s
from jaxvision.sensor import (
    clipped_moments,
    conversion_gains,
    count,
    expected_signal,
    pattern_variance,
    raw_image,
    reset_noise_rms,
    signal_variance,
)
from jaxvision.sensor._draws import Die, Frame, gaussian, threefry, upper_quantile
from jaxvision.sensor.shot_noise import _inverse_poisson, _poisson_probability

KEY, DIE = jax.random.split(jax.random.key(77))
LEVELS = [0.1, 1.0, 10.0, 1000.0]
SHAPE = (300, 400, 1)
shoot = jax.jit(raw_image)


def flat(level, shape=SHAPE):
    return jnp.full(shape, level)


# ------------------------------------------------ random numbers


def test_threefry_has_the_published_words():
    """The known answers are Random123's (kat_vectors, threefry2x32 20)."""
    ones = 0xFFFFFFFF
    for key, counter, words in [
        ((0, 0), (0, 0), (0x6B200159, 0x99BA4EFE)),
        ((ones, ones), (ones, ones), (0x1CB996FC, 0xBB002BE7)),
        ((0x13198A2E, 0x03707344), (0x243F6A88, 0x85A308D3), (0xC4923A9C, 0x483DF7A0)),
    ]:
        got = threefry(
            jnp.asarray(key, jnp.uint32),
            jnp.asarray([counter[0]], jnp.uint32),
            jnp.asarray(counter[1], jnp.uint32),
        )
        assert tuple(int(word[0]) for word in got) == words


@pytest.mark.sweep
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_gaussian_quantiles_against_scipy(dtype):
    ends = np.geomspace(1, 2**31, 2000).astype(np.int64) - 1
    near_median = 2**31 - 1 - np.arange(50)
    lower = np.unique(np.concatenate([ends, near_median])).astype(np.uint32)
    bits = np.concatenate([lower, ~lower])
    truth = stats.norm.isf((lower + 0.5) / 2**32)
    truth = np.concatenate([truth, -truth])
    got = np.asarray(upper_quantile(jnp.asarray(bits), dtype))
    assert got.dtype == dtype
    error = np.abs(got / truth - 1)
    assert error[np.abs(truth) < 5.3].max() < 1e-6
    assert error.max() < 5e-4


@pytest.mark.slow
def test_draws_are_gaussian_and_independent():
    size = 400_000
    uses = [Frame.SHOT, Frame.READ, Die.DSNU]
    draws = [np.asarray(gaussian(KEY, use, (size,), jnp.float32), float) for use in uses[:2]]
    draws.append(np.asarray(gaussian(DIE, uses[2], (size,), jnp.float32), float))
    for draw in draws:
        assert stats.kstest(draw[:100_000], "norm").pvalue > 1e-3
        check_moments(draw, 0, 1, 3)
        assert abs(np.corrcoef(draw[1:], draw[:-1])[0, 1]) < 5 / np.sqrt(size)
        assert abs(np.corrcoef(draw[400:], draw[:-400])[0, 1]) < 5 / np.sqrt(size)
    assert np.abs(np.corrcoef(draws) - np.eye(3)).max() < 5 / np.sqrt(size)


# ------------------------------------------------ counting

invert = jax.jit(_inverse_poisson)
STRATA = 2**23


@pytest.mark.slow
@pytest.mark.parametrize("mean", [0.1, 1.0, 3.0, 9.99, 10.01, 30.0, 100.0, 1000.0, 1e5])
def test_fast_counts_have_poissons_distribution(mean):
    """All quantiles are compared: the total variation, and the mean and variance that `count`
    states."""
    bits = jnp.arange(STRATA, dtype=jnp.uint32) * jnp.uint32(2**32 // STRATA)
    bits = bits + jnp.uint32(2**31 // STRATA)
    counts = np.asarray(invert(bits, jnp.full(STRATA, mean, jnp.float32)))
    np.testing.assert_array_equal(counts, np.round(counts))
    assert counts.min() >= 0
    # an inverse distribution function is monotone, except for rounding of its argument
    assert np.diff(counts).max() <= 1
    assert (np.diff(counts) > 0).mean() < 1e-5
    share = np.bincount(counts.astype(int)) / STRATA
    numbers = np.arange(share.size)
    rounded = float(np.float32(mean))
    truth = stats.poisson.pmf(numbers, rounded)
    resolution = np.count_nonzero(share) / STRATA / 2  # an edge is within a stratum
    variation = np.abs(share - truth).sum() / 2
    assert variation < (2e-6 if mean < 10 else 1.4e-4) + resolution
    average = share @ numbers
    assert abs(average / rounded - 1) < 1e-6 + 30 / STRATA
    assert abs(share @ (numbers - average) ** 2 / rounded - 1) < 3e-4 + 100 / STRATA


@pytest.mark.slow
def test_fast_counts_of_one_photon_in_ten_million_frames():
    """The probability of a photon is accurate far below float32's rounding of 1."""
    mean = jnp.asarray(1e-7, jnp.float32)
    threshold = 1e-7 * 2**32
    words = jnp.asarray([int(0.99 * threshold), int(1.01 * threshold)], jnp.uint32)
    np.testing.assert_array_equal(_inverse_poisson(words, jnp.full(2, mean)), [1, 0])


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("kind", [s.PoissonShotNoise(), s.FastPoissonShotNoise()])
@pytest.mark.sweep
def test_counts_have_poissons_moments_at_every_light_level(kind, dtype):
    """From a hundredth of an electron to 2^31, moments are within 5 standard errors of 300,000
    draws."""
    draw = jax.jit(lambda mean: count(KEY, mean, kind))
    for level in (0.01, 1.0, 9.99, 10.01, 200.0, 5e5, 1e6, 1e8, 2.0**31):
        mean = jnp.full((500, 600), level, dtype)
        rounded = float(mean[0, 0])
        check_moments(draw(mean), rounded, rounded, rounded + 3 * rounded**2)


@pytest.mark.sweep("31.4", "2147483648")
@pytest.mark.parametrize("mean", [10.0, 31.4, 1e3, 5e5, 2.0**24, 2.0**31])
def test_acceptance_of_counts_is_poissons_probability(mean):
    """In float32, to 5 standard deviations, n ln mu - mu - ln n! would lose all digits."""
    steps = np.unique(np.round(np.linspace(-5, 5, 201) * np.sqrt(mean)))
    steps = steps[steps >= -np.floor(mean)]
    part = mean - np.floor(mean)
    excess = jnp.asarray(steps - part, jnp.float32)
    got = np.asarray(_poisson_probability(excess, jnp.float32(mean)), float)
    truth = stats.poisson.pmf(np.floor(mean) + steps, mean)
    np.testing.assert_allclose(got, truth, rtol=5e-5)


def test_exact_counts_reach_every_integer():
    """Odd and even counts occur, at a mean where counts in float32 would be multiples of 8."""
    drawn = np.asarray(count(KEY, jnp.full(20_000, 1e8, jnp.float64), s.PoissonShotNoise()))
    shares = np.bincount(drawn.astype(int) % 8, minlength=8) / drawn.size
    assert np.abs(shares - 1 / 8).max() < 5 * np.sqrt(7 / 64 / drawn.size)


@pytest.mark.sweep
@pytest.mark.parametrize("kind", [s.PoissonShotNoise(), s.FastPoissonShotNoise()])
def test_electrons_beyond_the_range_of_counts_are_refused_or_nan(kind):
    """They are refused if known, NaN if traced, and full if they exceed the well."""
    means = jnp.asarray([1.0, 1e10, jnp.inf, jnp.nan])
    with pytest.raises(ValueError, match=r"at most 2147483648 electrons .* got 1e[+]10; give the"):
        count(KEY, means, kind)
    traced = np.asarray(jax.jit(lambda mean: count(KEY, mean, kind))(means))
    np.testing.assert_array_equal(np.isnan(traced), [False, True, True, True])
    assert np.isnan(count(KEY, jnp.asarray([jnp.nan]), kind)).all()
    sensor = s.Sensor(shot_noise=kind, full_well=1e4)
    assert raw_image(KEY, sensor, means[1:2]) == 1e4


KINDS = (s.FastPoissonShotNoise(), s.PoissonShotNoise(), s.GaussianShotNoise())


@pytest.mark.sweep
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: type(kind).__name__)
def test_gradients_of_counts_are_unbiased_for_two_moments(kind):
    """d E[N] / d mean = 1 and d E[N^2] / d mean = 2 mean + 1, from one photon in a hundred pixels,
    within 3 standard errors of the sample."""
    means = jnp.asarray([0.01, 0.1, 0.5, 2.0, 9.0, 30.0, 1000.0])

    @jax.jit
    def slopes(mean):
        number, slope = jax.jvp(lambda m: count(KEY, m, kind), (mean,), (jnp.ones_like(mean),))
        return slope, 2 * number * slope

    first, second = map(np.asarray, slopes(jnp.broadcast_to(means, (100_000, len(means)))))
    for found, true in ((first, np.ones(len(means))), (second, 2 * np.asarray(means) + 1)):
        error = found.std(axis=0) / np.sqrt(len(found))
        assert (np.abs(found.mean(axis=0) - true) <= 3 * error).all(), (found.mean(axis=0), error)
    np.testing.assert_allclose(first.var(axis=0), 1 / (4 * np.asarray(means)), rtol=0.1)


# ------------------------------------------------ reading out


@pytest.mark.sweep
@pytest.mark.parametrize("level", LEVELS)
def test_heavy_tailed_read_noise(level):
    noise = s.HeavyTailedReadNoise(level, 5 * level, 0.02)
    variance = level**2 * (0.98 + 0.02 * 25)
    fourth = 3 * level**4 * (0.98 + 0.02 * 625)
    sample = shoot(KEY, s.Sensor(read_noise=noise), flat(7.0))
    check_moments(sample, 7, variance, fourth)
    sensor = s.Sensor(read_noise=noise, gain=2.0)
    np.testing.assert_allclose(signal_variance(sensor, flat(1.0, (1, 1, 1))), 4 * variance)
    kurtosis = stats.kurtosis(np.asarray(sample).ravel())
    assert kurtosis > 0.8 * (fourth / variance**2 - 3)


def test_reset_noise_is_ktc_noise():
    """sqrt(k T C) / q is 12.57 e- at 1 fF and 293.15 K, by hand, also in float32."""
    for dtype in (jnp.float32, jnp.float64):
        reset = s.ResetNoise(jnp.asarray(1e-15, dtype), jnp.asarray(293.15, dtype))
        rms = reset_noise_rms(reset)
        np.testing.assert_allclose(rms, np.sqrt(1.380649e-23 * 293.15 * 1e-15) / 1.602176634e-19)
        assert rms.dtype == dtype
    sensor = s.Sensor(reset_noise=reset, read_noise=5.0)
    variance = float(rms) ** 2 + 25
    check_moments(shoot(KEY, sensor, flat(100.0)), 100, variance, 3 * variance**2)


@pytest.mark.parametrize("level", LEVELS)
def test_telegraph_noise_jumps_in_some_pixels(level):
    sensor = s.Sensor(telegraph_noise=s.TelegraphNoise(0.25, level))
    frames = [np.asarray(shoot(key, sensor, flat(50.0), die_key=DIE)) for key in (KEY, DIE)]
    variance = 0.25 * level**2 / 2
    check_moments(frames[0], 50, variance, variance * level**2)
    np.testing.assert_allclose(signal_variance(sensor, flat(50.0, (1, 1, 1))), variance)
    values = np.unique(np.round(frames[0] - 50, 9))
    np.testing.assert_allclose(values, [-level, 0, level], atol=1e-9)
    quiet = (frames[0] == 50) & (frames[1] == 50)
    assert abs(quiet.mean() - (0.75 + 0.25 / 4)) < 0.01  # trapped pixels keep their trap


@pytest.mark.parametrize("level", LEVELS)
def test_row_noise_is_one_draw_per_row(level):
    sensor = s.Sensor(row_noise=level)
    sample = np.asarray(shoot(KEY, sensor, flat(20.0, (40_000, 3, 1))))
    np.testing.assert_array_equal(sample[:, 1:], sample[:, :-1])
    check_moments(sample[:, 0], 20, level**2, 3 * level**4)


def test_banding_has_its_period_and_a_random_phase():
    sensor = s.Sensor(banding=s.Banding(3.0, 20.0))
    frames = jax.vmap(lambda key: shoot(key, sensor, flat(0.0, (200, 2, 1))))(
        jax.random.split(KEY, 2000)
    )
    frames = np.asarray(frames)[..., 0]
    np.testing.assert_allclose(frames[:, 20:], frames[:, :-20], atol=1e-9)
    spectrum = np.abs(np.fft.rfft(frames[0, :, 0])) / 100
    assert spectrum.argmax() == 10
    np.testing.assert_allclose(spectrum[10], 3.0, rtol=1e-9)
    check_moments(frames[:, 0, 0], 0, 4.5, 3 * 3.0**4 / 8)


# ------------------------------------------------ transfer


@pytest.mark.slow
@pytest.mark.parametrize(
    ("noise", "well"),
    [
        (s.FastPoissonShotNoise(), None),
        (s.FastPoissonShotNoise(), 1e9),
        (s.FastPoissonShotNoise(), 105.0),
        (s.GaussianShotNoise(), None),
    ],
)
def test_electrons_are_left_behind_one_by_one(noise, well):
    """The reference draws a binomial for each electron of each packet in NumPy."""
    eps, rows, packets = 0.005, 80, 20_000
    seen = slice(70, rows)
    light = np.zeros(rows)
    light[seen] = 100.0, 100.0, 20.0, 100.0, 100.0, 100.0, 100.0, 0.0, 100.0, 100.0
    sensor = s.Sensor(
        shot_noise=noise,
        dark_current=3.0,
        full_well=well,
        charge_transfer=s.ChargeTransfer(eps, trail=8),
    )
    image = jnp.broadcast_to(jnp.asarray(light)[:, None, None], (rows, packets, 1))
    got = np.asarray(shoot(KEY, sensor, image))[seen, :, 0]

    random = np.random.default_rng(4)
    counted = random.poisson(light[:, None] + 3.0, size=(rows, packets))
    counted = counted if well is None else np.minimum(counted, int(well))
    read = np.zeros((rows + 9, packets), int)
    for row in range(60, rows):
        left = counted[row]
        for behind in range(8):
            law = stats.nbinom(row + 1, 1 - eps)
            share = law.pmf(behind) / law.sf(behind - 1)
            stays = random.binomial(left, share)
            read[row + behind] += stays
            left = left - stays
    means, variances = read[seen].mean(axis=1), read[seen].var(axis=1)
    # both are samples; the limit is 5 standard errors of their difference
    assert (np.abs(got.mean(axis=1) - means) < 5 * np.sqrt(2 * variances / packets)).all()
    error = variances * np.sqrt(2 * (2 + 1 / means) / packets)
    assert (np.abs(got.var(axis=1) - variances) < 5 * error).all()
    formula = np.asarray(signal_variance(sensor, image[:, :1]))[seen, 0, 0]
    mean = np.asarray(expected_signal(sensor, image[:, :1]))[seen, 0, 0]
    np.testing.assert_allclose(formula, mean, rtol=1e-12)  # below clipping
    if well is None:
        assert abs(np.corrcoef(got[0], got[1])[0, 1]) < 5 / np.sqrt(packets)
        closed = clipped_moments(sensor, image[:, :1])
        np.testing.assert_allclose(closed.variance[seen, 0, 0], closed.mean[seen, 0, 0])


# ------------------------------------------------ fixed pattern


@pytest.mark.sweep
@pytest.mark.parametrize("level", LEVELS)
def test_columns_and_rows_keep_their_offsets(level):
    for field, axis, shape in (("column_dsnu", 0, (3, 40_000, 1)), ("row_dsnu", 1, (40_000, 3, 1))):
        sensor = s.Sensor(**{field: level})
        sample = np.asarray(shoot(KEY, sensor, flat(20.0, shape), die_key=DIE))
        np.testing.assert_array_equal(sample, shoot(DIE, sensor, flat(20.0, shape), die_key=DIE))
        line = np.moveaxis(sample, axis, 0)
        np.testing.assert_array_equal(line[1:], line[:-1])
        check_moments(line[0], 20, level**2, 3 * level**4)


def test_column_amplifiers_differ():
    sensor = s.Sensor(column_prnu=0.02, gain=2.0, offset=7.0)
    sample = np.asarray(shoot(None, sensor, flat(100.0, (2, 40_000, 1)), die_key=DIE))
    np.testing.assert_array_equal(sample[0], sample[1])
    check_moments(sample[0], 207, 16, 3 * 16**2)
    variance = pattern_variance(sensor, flat(100.0, (1, 1, 1)))
    np.testing.assert_allclose(variance, 16, rtol=1e-12)


@pytest.mark.slow
def test_conversion_gains_differ_and_scale_the_counts():
    """Over frames, a pixel of gain g has mean g mu and variance g^2 mu."""
    sensor = s.Sensor(conversion_prnu=0.1, shot_noise=s.FastPoissonShotNoise())
    take = jax.vmap(lambda key: shoot(key, sensor, flat(400.0, (20, 25, 1)), die_key=DIE))
    frames = np.asarray(take(jax.random.split(KEY, 400)))[..., 0]
    gains = np.asarray(conversion_gains(DIE, jnp.asarray(0.1), shape=(20, 25, 1), dtype=float))
    gains = gains[..., 0]
    check_moments(gains, 1, 0.01, 3e-4)
    # the mean of 400 frames estimates g, and their variance has a relative error of sqrt(2 / 400)
    assert np.abs(frames.mean(axis=0) - 400 * gains).max() < 5 * gains.max()
    spread = frames.var(axis=0, ddof=1) / (400 * gains**2)
    assert abs(spread.mean() - 1) < 5 * np.sqrt(2 / 400 / gains.size)
    one = flat(400.0, (1, 1, 1))
    np.testing.assert_allclose(signal_variance(sensor, one), 400 * 1.01, rtol=1e-12)
    np.testing.assert_allclose(pattern_variance(sensor, one), 40**2, rtol=1e-12)


def test_dead_and_hot_pixels():
    """The fractions and the exponential distribution are right, and no pixel is both."""
    sensor = s.Sensor(dead_pixels=0.1, hot_pixels=s.HotPixels(0.05, 400.0), exposure_time=0.5)
    sample = np.asarray(shoot(None, sensor, flat(2000.0), die_key=DIE)).ravel()
    n = sample.size
    dead, hot = sample == 0, sample > 1000
    assert abs(dead.mean() - 0.1) < 5 * np.sqrt(0.09 / n)
    assert abs(hot.mean() - 0.05) < 5 * np.sqrt(0.0475 / n)
    assert ((sample == 0) | (sample >= 1000)).all()
    assert stats.kstest(sample[hot] - 1000, "expon", args=(0, 200)).pvalue > 1e-3
    wanted = 1000**2 * 0.09 + (2 * 0.05 - 0.05**2) * 200**2
    formula = pattern_variance(sensor, flat(2000.0, (1, 1, 1)))
    np.testing.assert_allclose(formula, wanted, rtol=1e-12)
    # dead and hot pixels exclude each other, which the sum of independent variances neglects
    exact = wanted + 2 * 0.1 * 0.05 * 1000 * 200
    assert abs(sample.var() - exact) < 0.03 * exact


def test_a_defect_has_a_fixed_position():
    sensor = s.Sensor(hot_pixels=s.HotPixels(0.01, 50.0), shot_noise=s.FastPoissonShotNoise())
    frames = [np.asarray(shoot(key, sensor, flat(0.0), die_key=DIE)) for key in (KEY, DIE)]
    hot = [frame > 10 for frame in frames]
    both = (hot[0] & hot[1]).sum() / hot[0].sum()
    assert both > 0.8
    assert (frames[0] != frames[1])[hot[0]].mean() > 0.5


def test_rows_and_columns_need_an_image():
    for field in ("row_noise", "column_dsnu", "column_prnu", "crosstalk", "smear"):
        sensor = s.Sensor(**{field: 0.1})
        with pytest.raises(ValueError, match=r"an image \(..., h, w, bands\), got shape \(5, 1\)"):
            raw_image(KEY, sensor, jnp.ones((5, 1)), die_key=DIE)


@pytest.mark.parametrize("law", [s.PoissonShotNoise(), s.FastPoissonShotNoise()])
@pytest.mark.parametrize("mean", [5, 100])
@pytest.mark.slow
def test_counts_of_narrow_and_whole_means_are_those_of_float32(law, mean):
    truth = count(KEY, jnp.full(500, mean, jnp.float32), law)
    for dtype in (jnp.float16, jnp.bfloat16, jnp.uint8, jnp.int32):
        got = count(KEY, jnp.full(500, mean, dtype), law)
        assert got.dtype == (
            dtype if jnp.issubdtype(dtype, jnp.floating) else jnp.result_type(float)
        )
        np.testing.assert_array_equal(got, truth.astype(got.dtype))


@pytest.mark.slow
def test_a_float16_frame_has_the_noise_of_its_light():
    sensor = s.Sensor(
        quantum_efficiency=1.0,
        full_well=10_000.0,
        gain=1.0,
        bits=12,
        hot_pixels=s.HotPixels(0.1, 300.0),
        shot_noise=s.PoissonShotNoise(),
    )
    with jax.numpy_dtype_promotion("standard"):
        frames = [
            raw_image(KEY, sensor, flat(100.0, (100, 100, 1)).astype(dtype), die_key=DIE)
            for dtype in (jnp.float16, jnp.float32)
        ]
    np.testing.assert_allclose(*(np.asarray(x, float) for x in frames), rtol=2e-3, atol=1)
