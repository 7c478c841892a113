"""Tests covariances of neighbouring pixels in flats: their sums, and the distinction of the
brighter-fatter effect from compression, with frames drawn in NumPy from the spectrum of Astier et
al. (2019)."""

from dataclasses import replace
from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest

from fitting import noise
from fitting.noise.brighter_fatter import fitted_area_changes, own_area_change
from fitting.noise.calibration import calibrate
from fitting.noise.findings import findings
from fitting.noise.level_sums import SquareSums
from fitting.noise.live_pixels import LARGEST_LAG, LivePixels
from fitting.noise.neighbours import variance_terms
from fitting.noise.section import section
from fitting.noise.sensor import fitted_sensor
from fitting.rig import Camera
from jaxvision.sensor import area_changes, flat_covariances, signal_variance

SIZE, LEVELS, FRAMES = 160, 10, 4
TOP, GAIN, READ, BLACK = 6e4, 0.25, 8.0, 200.0
CHANGES = np.zeros((4, 4))
CHANGES[:3, :3] = np.array([[0, 0.14, 0.1], [0.22, 0.1, 0.02], [0.08, 0.02, 0.0]]) * 1e-6
COPIES = np.outer([1, 2, 2, 2], [1, 2, 2, 2])
CHANGES[0, 0] = -(CHANGES * COPIES).sum()  # -1.64e-6


def spectrum(mu, changes):
    lags = np.arange(-3, 4)
    around = np.zeros((SIZE, SIZE))
    around[np.ix_(lags % SIZE, lags % SIZE)] = changes[np.ix_(abs(lags), abs(lags))]
    x = 2 * np.fft.fft2(around).real * mu
    return mu * np.where(np.abs(x) < 1e-12, 1, np.expm1(x) / np.where(x == 0, 1, x))


def frames(rng, mu, changes, compression, mixing):
    """Return digital numbers, (FRAMES, SIZE, SIZE), of a periodic sensor."""
    white = np.fft.fft2(rng.standard_normal((FRAMES, SIZE, SIZE)))
    charge = mu + np.fft.ifft2(white * np.sqrt(spectrum(mu, changes))).real
    x = GAIN * charge
    x = x * (1 - compression * x / (GAIN * TOP))
    around = sum(np.roll(x, step, axis) for step in (1, -1) for axis in (1, 2))
    x = (1 - 4 * mixing) * x + mixing * around
    read = GAIN * READ * rng.standard_normal(x.shape)
    return np.round(x + BLACK + read).astype(np.uint16)


@cache
def measured(*, repelling=True, compression=0.0, mixing=0.0, seed=5):
    rng, changes = np.random.default_rng(seed), CHANGES * repelling
    electrons = np.linspace(0.06, 1, LEVELS) * TOP
    flats = [list(frames(rng, mu, changes, compression, mixing)) for mu in electrons]
    darks = [list(frames(rng, 0.0, 0 * changes, 0.0, 0.0)) for _ in electrons]
    times = list(np.linspace(1e-3, 2e-2, LEVELS))
    return noise.from_frames(flats, darks, times, list(2 * electrons), camera=Camera(bits=16))


def test_sums_over_frames_equal_plain_loops():
    rng = np.random.default_rng(0)
    stack = rng.standard_normal((5, 7, 9))
    stack -= stack.mean(axis=(1, 2), keepdims=True)
    live = LivePixels(np.ones((7, 9), bool))
    sums = SquareSums(live)
    for frame in stack[1:]:
        sums.add(frame - stack[0])
    products = sums.variance("neighbours", (stack - stack[0]).sum(axis=0), 5)
    got = products / live.neighbours
    away = stack - stack.mean(axis=0)
    for i in range(LARGEST_LAG + 1):
        for j in range(LARGEST_LAG + 1):
            found = [
                (away[:, p, q] * away[:, p + i, q + k]).sum() / 4
                for k in {j, -j}
                for p in range(7 - i)
                for q in range(9)
                if 0 <= q + k < 9
            ]
            assert got[i, j] == pytest.approx(np.mean(found), abs=1e-12), (i, j)


def test_the_series_equals_the_sensors():
    nearest = np.zeros((LARGEST_LAG + 1, LARGEST_LAG + 1))
    nearest[0, 0], nearest[0, 1], nearest[1, 0] = 1.0, -0.25, -0.25
    for shape in (nearest, CHANGES / CHANGES[0, 0]):
        a, mu = -1.5e-6 * shape, 1e5
        expected = float(flat_covariances(jnp.asarray(a), jnp.asarray(mu))[0, 0]) / mu
        assert np.polyval(variance_terms(shape), -1.5e-6 * mu) == pytest.approx(expected, rel=1e-12)


def check(calibration, *, compression=0.0):
    """Check that every estimate is within 3.5 standard errors of its true value."""
    chosen = calibration.chosen
    assert chosen.p_value > 1e-3
    gain = float(chosen.values["system_gain"])
    assert abs(gain / GAIN - 1) < 3.5 * chosen.errors["system_gain"]
    own, error = own_area_change(chosen)
    assert error < 0.1 * abs(CHANGES[0, 0])
    assert abs(own - CHANGES[0, 0]) < 3.5 * error
    if compression:
        top = float(chosen.data.top_signal) / (GAIN * TOP)
        found, error = float(chosen.values["compression"]), chosen.errors["compression"]
        # the measured top is compressed itself
        assert abs(found - compression * top) < 3.5 * error + 0.03 * compression
    else:
        assert "compression" not in chosen.values


@pytest.mark.slow
def test_brighter_fatter_effect_and_compression_are_distinguished():
    """Both effects are simulated and found, with the area changes of all neighbours, and the fitted
    sensor predicts them."""
    calibration = calibrate(measured(compression=0.02))
    check(calibration, compression=0.02)
    changes = fitted_area_changes(calibration.measurement, calibration.usable, calibration.chosen)
    z = (changes.values - CHANGES) / changes.errors
    assert np.abs(z).max() < 3.7
    assert 0.5 < z.std() < 1.6
    told = " ".join(findings(calibration))
    assert "brighter-fatter" in told
    assert "Variance and covariances add up" in told
    tables = {table.title: table for table in section(calibration).tables}
    assert len(tables["Change of a pixel's area by one electron"].rows) == 16

    best, draws = fitted_sensor(calibration)
    kernel = best.brighter_fatter.kernel
    assert draws.brighter_fatter.kernel.shape == (1000, *kernel.shape)
    assert float(area_changes(kernel)[0, 0]) == pytest.approx(
        own_area_change(calibration.chosen)[0]
    )
    rate = jnp.full((4, 4, 1), 1.2e5) / best.exposure_time
    predicted = float(signal_variance(replace(best, prnu=None), rate)[1, 1, 0])
    step = GAIN * (1 - 2 * 0.02)  # of one more electron, at the brightest level
    truth = np.mean(spectrum(TOP, CHANGES)) * step**2 + (GAIN * READ) ** 2 + 1 / 12
    assert predicted == pytest.approx(truth, rel=0.02)


@pytest.mark.slow
def test_the_brighter_fatter_effect_alone_needs_no_compression():
    check(calibrate(measured()))


@pytest.mark.slow
def test_a_compression_is_not_taken_for_the_brighter_fatter_effect():
    chosen = calibrate(measured(repelling=False, compression=0.02)).chosen
    assert "compression" in chosen.values
    assert not {"brighter_fatter", "pixel_mixing"} & chosen.values.keys()


@pytest.mark.slow
def test_mixing_is_proportional_to_light_and_not_to_its_square():
    """With weights of .952 and .012, the sum of w^2 = 1 - .093 of the variance remains."""
    calibration = calibrate(measured(repelling=False, mixing=0.012, seed=7))
    chosen = calibration.chosen
    assert "brighter_fatter" not in chosen.values
    found, error = float(chosen.values["pixel_mixing"]), chosen.errors["pixel_mixing"]
    assert abs(found - (1 - 0.952**2 - 4 * 0.012**2)) < 3.5 * error
    assert "that is proportional to light" in " ".join(findings(calibration))


@pytest.mark.slow
def test_without_covariances_only_the_means_distinguish_them():
    """For a table, both effects are still found, and the report says that this depends on the
    means."""
    whole = measured(compression=0.02)
    levels = [replace(of, covariances=None) for of in (whole.bright, whole.dark)]
    calibration = calibrate(replace(whole, bright=levels[0], dark=levels[1]))
    check(calibration, compression=0.02)
    assert "neighbouring pixels would too, but a table" in " ".join(findings(calibration))
    assert fitted_sensor(calibration)[0].brighter_fatter is not None
