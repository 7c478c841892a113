"""The sensor at its limits, in both precisions: no photon, far too many, wells just full, and
closed forms that cancel. Values are compared with 50-digit results; gradients are finite
everywhere.
"""

from dataclasses import replace
from fractions import Fraction
from math import comb

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from oracles import exact
from oracles.sensors import OF_PHOTONS
from precisions import assert_finite, both_precisions, eps

from jaxvision import as_dtype
from jaxvision import scene as s
from jaxvision.sensor import (
    Moments,
    bloomed,
    censored,
    clipped_moments,
    exposure_slots,
    raw_image,
    transferred,
)
from jaxvision.sensor.ccd import counted_variance, transfer_noise
from jaxvision.sensor.shot_noise import _inverse_poisson

KEY = jax.random.key(3)
IDLE = replace(  # every effect, most of zero size
    OF_PHOTONS,
    exposure_time=1.0,
    smear=1e-3,
    dead_pixels=0.1,
    dark_current=s.ArrheniusDarkCurrent(0.0, 200.0, 293.0, 1.1),
    hot_pixels=s.HotPixels(0.0, 100.0),
    blooming=1.0,
    charge_transfer=s.ChargeTransfer(0.0, trail=2),
    conversion_prnu=0.0,
    dsnu=None,
    column_dsnu=None,
    row_dsnu=None,
    reset_noise=s.ResetNoise(0.0, 0.0),
    read_noise=s.HeavyTailedReadNoise(0.0, 0.0, 0.0),
    telegraph_noise=s.TelegraphNoise(0.5, 0.0),
    row_noise=0.0,
    banding=s.Banding(0.0, 3.0),
    column_prnu=0.0,
    gain=1.0,
    offset=None,
    bits=12,
)


@pytest.mark.slow
@both_precisions
def test_every_effect_without_light_and_overexposed(dtype):
    sensor = as_dtype(IDLE, dtype)

    @jax.jit
    def shoot(sensor, light):
        raw, pull = jax.vjp(lambda s, x: raw_image(KEY, s, x, die_key=KEY), sensor, light)
        return raw, pull(jnp.ones_like(raw))

    @jax.jit
    def expect(sensor, light):
        moments, pull = jax.vjp(lambda s, x: tuple(clipped_moments(s, x)), sensor, light)
        return moments, pull(jax.tree.map(jnp.ones_like, moments))

    for level in (0.0, 1e-30, 0.1, 1e4, 2e4, 1e12):
        light = jnp.full((4, 3, 1), level, dtype)
        raw, gradient = shoot(sensor, light)
        assert raw.dtype == dtype
        assert ((raw >= 0) & (raw <= 4095)).all()
        assert_finite((raw, gradient))
        moments, gradient = expect(sensor, light)
        assert_finite((moments, gradient))
        if level == 0:
            assert (raw == 0).all()
            assert (moments[0] < 0.2).all()  # rounding's 1/12, clipped at 0
        if level == 1e12:
            assert (moments[0] > 4094.8).all()
            assert (moments[1] < 1e-6).all()


def of_clipped(mean, sigma, low=None, high=None):
    """Return mean and variance of a Gaussian variable clipped to [low, high], computed from its
    tails."""
    ends = [(sign, end) for sign, end in ((1, low), (-1, high)) if end is not None]
    first, second = mean, sigma**2 + mean**2
    for sign, end in ends:
        t = sign * (end - mean) / sigma  # the part beyond the end moves to it
        lost, bell = mp.ncdf(t), mp.npdf(t)
        first += (end - mean) * lost + sign * sigma * bell
        second += (end**2 - mean**2 - sigma**2) * lost + sigma * (
            2 * mean * sign + sigma * t
        ) * bell
    return first, second - first**2


@pytest.mark.slow
@both_precisions
def test_clipped_moments_of_noise_wider_than_the_window(dtype):
    """With windows down to a millionth of a deviation, half of the values lie at each end and the
    variance is 1/4."""
    cases = [(0.5, 0.3), (-1, 2), (0.2, 8), (3, 9), (-1e3, 1e3), (70, 30), (0.4, 1e6), (-1e3, 1e6)]
    mean, sigma = jnp.asarray(cases, dtype).T
    ends = jnp.asarray([0, 1], dtype)

    @jax.jit
    def clipped(mean, variance):
        return tuple(censored(Moments(mean, variance), low=ends[0], high=ends[1]))

    variance = jnp.square(sigma)
    for m, v, *found in zip(mean, variance, *clipped(mean, variance), strict=True):
        with mp.workdps(120):
            true = of_clipped(exact.number(m), mp.sqrt(exact.number(v)), 0, 1)
        for value, truth in zip(found, true, strict=True):
            assert abs(exact.number(value) - truth) <= 16 * eps(dtype) * truth, (m, v)
    slopes = jax.jit(jax.vmap(jax.jacrev(clipped, (0, 1))))(mean, variance.at[0].set(0))
    assert_finite(slopes)


@pytest.mark.slow
@both_precisions
def test_counts_at_the_ends_of_the_range(dtype):
    ends = jnp.asarray([0, 2**31 - 1, 2**31, 2**32 - 1], jnp.uint32)
    for mean in (0.0, 1e-30, 9.9999, 10.0, 1e6, 1e30, -5.0):
        means = jnp.full(4, mean, dtype)
        counts = _inverse_poisson(ends, means)
        assert counts.dtype == dtype
        assert ((counts >= 0) & jnp.isfinite(counts)).all()
        assert_finite(jax.grad(lambda m: _inverse_poisson(ends, m).sum())(means))
    assert (_inverse_poisson(ends, jnp.zeros(4, dtype)) == 0).all()


@both_precisions
def test_a_pixel_at_full_well_keeps_its_charge(dtype):
    well = jnp.asarray(1000.0, dtype)
    for level in (0.0, 1000.0, 1000.0001, 1e6):
        column = jnp.full((5, 1, 1), level, dtype)
        one = jnp.ones((), dtype)
        got, pull = jax.vjp(bloomed, column, well, one)
        assert (got <= well).all()
        assert_finite((got, pull(got)))


@pytest.mark.slow
@both_precisions
@pytest.mark.parametrize("inefficiency", [0.0, 1e-7, 0.5])
def test_charge_transfer_of_three_thousand_rows_conserves_charge(dtype, inefficiency):
    column = jnp.full((3000, 1, 1), 100.0, dtype)
    transfer = as_dtype(s.ChargeTransfer(inefficiency), dtype)
    read, pull = jax.vjp(transferred, column, transfer)
    assert_finite((read, pull(jnp.ones_like(read))))
    if inefficiency < 0.1:  # each row gains of an even column what its neighbour leaves
        expected = 100 * (1 - inefficiency)
        np.testing.assert_allclose(read[:, 0, 0], expected, rtol=3000 * 4 * eps(dtype))


@pytest.mark.slow
@both_precisions
def test_exposure_of_zero_time_is_dark_and_defined(dtype):
    zero = jnp.zeros((), dtype)
    for shutter in (None, s.RollingShutter(zero), s.RollingShutter(jnp.asarray(1e-3, dtype))):

        def slots(time, shutter=shutter):
            return exposure_slots(shutter, time, rows=4, slots=3)

        (times, weights), pull = jax.vjp(slots, zero)
        assert times.dtype == weights.dtype == dtype
        assert_finite((times, weights, pull((times, weights))))


@pytest.mark.slow
def test_float32_and_float64_draw_the_same_frame():
    """Both precisions use the same random bits, so the pictures differ by rounding, and by one DN
    where rounding decides."""
    sensor = s.Sensor(
        prnu=0.01, shot_noise=s.GaussianShotNoise(), read_noise=5.0, gain=0.5, offset=50.0
    )
    light = jnp.full((50, 60, 1), 300.0)
    wide = raw_image(KEY, sensor, light, die_key=KEY)
    narrow = raw_image(KEY, as_dtype(sensor, jnp.float32), light.astype(jnp.float32), die_key=KEY)
    np.testing.assert_allclose(narrow, wide, rtol=2e-5)


def share_behind(eps, row, lag, trail):
    """Return the share of the packet of a row that is read `lag` rows later."""

    def one(k):
        return comb(row + k, k) * (1 - eps) ** (row + 1) * eps**k

    return one(lag) if lag < trail else 1 - sum(map(one, range(trail)))


@pytest.mark.sweep
@pytest.mark.parametrize("eps", [1e-6, 1e-3])
@both_precisions
def test_transfer_noise_of_small_inefficiencies(dtype, eps, monkeypatch):
    """The variance sum n p (1 - p) agrees with exact fractions; as the difference of two sums of n
    it would have no digit left."""
    monkeypatch.setattr("jaxvision.sensor.ccd.gaussian", lambda key, frame, shape, dtype: 1)
    rows, columns, trail, electrons = 4, 3, 2, 1000
    transfer = as_dtype(s.ChargeTransfer(eps, serial_inefficiency=2 * eps, trail=trail), dtype)
    packets = jnp.full((rows, columns, 1), electrons, dtype)
    got = transfer_noise(KEY, packets, transfer)[..., 0]
    steady = counted_variance(packets, jnp.zeros_like(packets), transfer)[..., 0]
    parallel, serial = (
        Fraction(float(x)) for x in (transfer.inefficiency, transfer.serial_inefficiency)
    )
    for row in range(rows):
        for column in range(columns):
            shares = [
                share_behind(parallel, row - k, k, trail)
                * share_behind(serial, column - m, m, trail)
                for k in range(min(row, trail) + 1)
                for m in range(min(column, trail) + 1)
            ]
            true = float(sum(electrons * p * (1 - p) for p in shares)) ** 0.5
            np.testing.assert_allclose(got[row, column], true, rtol=32 * jnp.finfo(dtype).eps)
            np.testing.assert_allclose(steady[row, column], true**2, rtol=64 * jnp.finfo(dtype).eps)


@both_precisions
def test_a_pixel_far_above_full_well_keeps_the_full_well(dtype):
    column = jnp.asarray([0, 1e9, 0], dtype).reshape(3, 1, 1)
    kept = bloomed(column, jnp.asarray(0.3, dtype), jnp.asarray(0, dtype)).ravel()
    np.testing.assert_array_equal(kept, np.asarray([0, 0.3, 0], dtype))
