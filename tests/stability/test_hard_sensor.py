"""The sensor at its limits, in both precisions: no photon, far too many, wells just full, and
closed forms that cancel. Values against 50 digits; gradients finite everywhere.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from oracles import exact
from oracles.sensors import OF_PHOTONS
from precisions import both_precisions

from jaxvision import as_dtype
from jaxvision import scene as s
from jaxvision.sensor import (
    Moments,
    bloomed,
    censored,
    clipped_moments,
    dark_rate,
    exposure_slots,
    raw_image,
    transferred,
)
from jaxvision.sensor.shot_noise import _inverse_poisson

KEY = jax.random.key(3)
IDLE = replace(  # every effect, most of them of no size
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


def eps(dtype):
    return float(jnp.finfo(dtype).eps)


def assert_finite(tree):
    for leaf in jax.tree.leaves(tree):
        assert jnp.isfinite(leaf).all(), tree


@pytest.mark.slow
@both_precisions
def test_every_effect_from_no_photon_to_far_too_many(dtype):
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


@both_precisions
@pytest.mark.parametrize("distance", [-30.0, -6.0, -1.0, 0.0, 1.0, 6.0, 30.0])
def test_clipped_moments_keep_their_digits(dtype, distance):
    """A Gaussian `distance` deviations inside [0, inf): mean and variance in eps of what they would
    be unclipped, far beyond either side."""
    sigma = jnp.asarray(3.0, dtype)
    mean = jnp.asarray(distance, dtype) * sigma
    got = censored(Moments(mean, sigma**2), low=jnp.zeros((), dtype))
    t = exact.number(mean) / exact.number(sigma)
    phi, below = mp.npdf(t), mp.ncdf(t)
    first = t * below + phi
    second = (t**2 + 1) * below + t * phi - first**2
    sd = exact.number(sigma)
    assert abs(exact.number(got.mean) - sd * first) <= 8 * eps(dtype) * (sd + abs(sd * first))
    assert abs(exact.number(got.variance) - sd**2 * second) <= 16 * eps(dtype) * sd**2


@both_precisions
@pytest.mark.parametrize("temperature", [150.0, 292.999, 293.0, 400.0])
def test_dark_current_laws_in_ulps(dtype, temperature):
    """Conditioned by the exponent: a relative rounding of E / k T moves the rate by as much times
    E / k T."""
    law = as_dtype(s.ArrheniusDarkCurrent(7.0, temperature, 293.0, 1.12), dtype)
    energy = (
        exact.number(law.activation_energy) * mp.mpf("1.602176634e-19") / mp.mpf("1.380649e-23")
    )
    t = exact.number(law.temperature)
    exponent = energy * (1 / mp.mpf(293) - 1 / t)
    truth = 7 * mp.exp(exponent)
    relative = abs(exact.number(dark_rate(law)) / truth - 1)
    assert relative <= eps(dtype) * (4 + 4 * abs(exponent))
    assert_finite(jax.grad(lambda law: dark_rate(law))(law))


@pytest.mark.slow
@both_precisions
def test_counts_at_the_ends_of_their_range(dtype):
    ends = jnp.asarray([0, 2**31 - 1, 2**31, 2**32 - 1], jnp.uint32)
    for mean in (0.0, 1e-30, 9.9999, 10.0, 1e6, 1e30, -5.0):
        means = jnp.full(4, mean, dtype)
        counts = _inverse_poisson(ends, means)
        assert counts.dtype == dtype
        assert ((counts >= 0) & jnp.isfinite(counts)).all()
        assert_finite(jax.grad(lambda m: _inverse_poisson(ends, m).sum())(means))
    assert (_inverse_poisson(ends, jnp.zeros(4, dtype)) == 0).all()


@both_precisions
def test_a_well_filled_to_the_brim_keeps_its_charge(dtype):
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
def test_transfer_of_three_thousand_rows_conserves_charge(dtype, inefficiency):
    column = jnp.full((3000, 1, 1), 100.0, dtype)
    transfer = as_dtype(s.ChargeTransfer(inefficiency), dtype)
    read, pull = jax.vjp(transferred, column, transfer)
    assert_finite((read, pull(jnp.ones_like(read))))
    if inefficiency < 0.1:  # of an even column each row gains what its neighbour leaves
        expected = 100 * (1 - inefficiency)
        np.testing.assert_allclose(read[:, 0, 0], expected, rtol=3000 * 4 * eps(dtype))


@both_precisions
def test_exposure_of_no_time_is_dark_not_undefined(dtype):
    zero = jnp.zeros((), dtype)
    for shutter in (None, s.RollingShutter(zero), s.RollingShutter(jnp.asarray(1e-3, dtype))):

        def slots(time, shutter=shutter):
            return exposure_slots(shutter, time, rows=4, slots=3)

        (times, weights), pull = jax.vjp(slots, zero)
        assert times.dtype == weights.dtype == dtype
        assert_finite((times, weights, pull((times, weights))))


@pytest.mark.slow
def test_float32_and_float64_draw_the_same_frame():
    """The bits are equal, so the pictures differ by rounding, and by one DN where it decides."""
    sensor = s.Sensor(
        prnu=0.01, shot_noise=s.GaussianShotNoise(), read_noise=5.0, gain=0.5, offset=50.0
    )
    light = jnp.full((50, 60, 1), 300.0)
    wide = raw_image(KEY, sensor, light, die_key=KEY)
    narrow = raw_image(KEY, as_dtype(sensor, jnp.float32), light.astype(jnp.float32), die_key=KEY)
    np.testing.assert_allclose(narrow, wide, rtol=2e-5)
