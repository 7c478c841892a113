"""Tests the standard's data sheet: exact on noise-free curves, and errors equal to the scatter of
repeated simulations."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles.cameras import CameraTruth, make_die, sweep
from scipy import stats as scipy_stats

from fitting.noise.emva1288 import evaluate, linearity_errors, ranges, sheet, statistics
from fitting.noise.levels import Levels, PhotonTransfer
from fitting.noise.pattern import fitted_pattern, standard_pattern
from fitting.noise.regressions import least_squares, surprise


def measurement_of(light, exposure, bright, dark, *, pixels=10_000, frames=2, **options):
    """Return a measurement from arrays of (mean, variance[, spatial variance]) rows."""
    count = len(exposure)

    def levels(amount, rows):
        rows = np.asarray(rows, float)
        spatial = jnp.asarray(rows[:, 2]) if rows.shape[1] > 2 else None
        return Levels(
            light=jnp.asarray(amount),
            exposure=jnp.asarray(exposure),
            mean=jnp.asarray(rows[:, 0]),
            variance=jnp.asarray(rows[:, 1]),
            frames=jnp.full(count, float(frames)),
            pixels=jnp.asarray(float(pixels)),
            spatial_variance=spatial,
        )

    return PhotonTransfer(
        bright=levels(light, bright),
        dark=levels(np.zeros(count), dark),
        dark_of=jnp.arange(count),
        light_step=jnp.asarray(0.0),
        **options,
    )


def noise_free(camera, light, exposure, **options):
    electrons = camera.efficiency * light
    dark = camera.dark_current * exposure
    base = (camera.gain * camera.read_noise) ** 2 + 1 / 12
    k = camera.gain
    bright = np.stack(
        [camera.offset + k * (electrons + dark), k**2 * (electrons + dark) + base], axis=1
    )
    darks = np.stack([camera.offset + k * dark, k**2 * dark + base], axis=1)
    return measurement_of(light, exposure, bright, darks, **options), bright, darks


LIGHT = np.linspace(500, 12_000, 24)
EXPOSURE = np.linspace(1e-3, 3e-2, 24)


@pytest.mark.slow
def test_a_noise_free_linear_camera_is_recovered():
    camera = CameraTruth()
    measured, _, _ = noise_free(camera, LIGHT, EXPOSURE)
    within = ranges(measured)
    found = sheet(statistics(measured, None), measured, within)
    sigma = np.sqrt((camera.gain * camera.read_noise) ** 2 + 1 / 12)
    threshold = sigma / camera.gain + 0.5
    expected = {
        "system_gain": camera.gain,
        "inverse_gain": 1 / camera.gain,
        "quantum_efficiency": 100 * camera.efficiency,
        "responsivity": camera.gain * camera.efficiency,
        "temporal_dark_noise": sigma,
        "read_noise": camera.read_noise,
        "dark_current_mean": camera.dark_current,
        "dark_current_variance": camera.dark_current,
        "threshold_electrons": threshold,
        "threshold_photons": threshold / camera.efficiency,
        "linearity_error_min": 0,
        "linearity_error_max": 0,
    }
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, rtol=1e-9, atol=1e-9, err_msg=name)


@pytest.mark.slow
def test_saturation_gives_capacity_snr_and_dynamic_range():
    camera = CameraTruth()
    measured, bright, _ = noise_free(camera, LIGHT, EXPOSURE)
    clipped = np.array(bright)
    clipped[20:, 1] = 0.5
    measured = eqx.tree_at(lambda m: m.bright.variance, measured, jnp.asarray(clipped[:, 1]))
    within = ranges(measured)
    evaluated = jax.jit(lambda measured: evaluate(measured, within))(measured)
    found = evaluated.values
    electrons = camera.efficiency * LIGHT[19]
    threshold = np.sqrt(camera.read_noise**2 + 1 / 12 / camera.gain**2) + 0.5
    np.testing.assert_allclose(found["saturation_photons"], LIGHT[19])
    np.testing.assert_allclose(found["snr_max"], np.sqrt(electrons))
    np.testing.assert_allclose(found["snr_max_db"], 10 * np.log10(electrons))
    np.testing.assert_allclose(found["dynamic_range"], electrons / threshold)
    np.testing.assert_allclose(found["usable_bits"], np.log(electrons / threshold) / np.log(2))
    # 70 % of the saturation signal, and 5 to 95 % of it, as fractions of level 19's light.
    np.testing.assert_array_equal(within.sensitivity, 0.7 * LIGHT[19] >= LIGHT)
    inside = (0.05 * LIGHT[19] <= LIGHT) & (0.95 * LIGHT[19] >= LIGHT)
    np.testing.assert_array_equal(within.linearity, inside)
    # The true peak is anywhere between the neighbours; this is the s.d. of a triangle of that base.
    error = evaluated.errors["saturation_photons"]
    np.testing.assert_allclose(error, (LIGHT[20] - LIGHT[18]) / np.sqrt(24))


def test_linearity_errors_equal_numpys_weighted_line():
    signal = 0.13 * LIGHT * (1 - 0.03 * LIGHT / LIGHT[-1]) + 3
    inside = (LIGHT > 1000) & (LIGHT < 11_000)
    # polyfit weights residuals, not their squares, so 1 / signal gives 1 / signal^2.
    fit = np.polyfit(LIGHT[inside], signal[inside], 1, w=1 / signal[inside])
    expected = np.polyval(fit, LIGHT[inside])
    deviation = 100 * (signal[inside] - expected) / expected
    low, high = linearity_errors(jnp.asarray(LIGHT), jnp.asarray(signal), jnp.asarray(inside))
    np.testing.assert_allclose([low, high], [deviation.min(), deviation.max()], rtol=1e-8)


def test_a_fine_read_noise_meets_the_standards_floor():
    camera = CameraTruth(gain=0.1, read_noise=2.0)
    measured, _, _ = noise_free(camera, LIGHT, EXPOSURE)
    found = sheet(statistics(measured, None), measured, ranges(measured))
    np.testing.assert_allclose(found["temporal_dark_noise"], np.sqrt(0.24))


def test_the_p_value_is_the_chi_square_tail():
    for value, degrees in ((3.2, 5.0), (60.0, 30.0), (0.0, 4.0)):
        np.testing.assert_allclose(
            surprise(jnp.asarray(value), jnp.asarray(degrees)),
            scipy_stats.chi2.sf(value, degrees),
            rtol=1e-6,
        )


@pytest.fixture(scope="module")
def repeated():
    """Return 150 simulated measurements of one camera, and the evaluation of each."""
    rng, camera, pixels = np.random.default_rng(11), CameraTruth(), 2000
    light, exposure = np.linspace(200, 6000, 12), np.linspace(1e-3, 2e-2, 12)
    cameras = []
    for _ in range(150):
        rows = sweep(rng, camera, light, exposure, (2, pixels))
        cameras.append(measurement_of(light, exposure, *rows, pixels=pixels))
    within = ranges(cameras[0])
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *cameras)
    return eqx.filter_jit(eqx.filter_vmap(lambda m: evaluate(m, within)))(stacked)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "system_gain",
        "quantum_efficiency",
        "responsivity",
        "read_noise",
        "dark_current_mean",
        "dark_current_variance",
        "threshold_photons",
    ],
)
def test_standard_errors_are_the_scatter_of_repetitions(repeated, name):
    spread = np.std(np.asarray(repeated.values[name]), ddof=1)
    claimed = np.median(np.asarray(repeated.errors[name]))
    # The scatter of 150 values has a relative error of 5.8 %; the limit is four of them.
    assert abs(claimed / spread - 1) < 0.23


@pytest.mark.slow
def test_insignificant_scatter_beyond_pixel_noise_is_rarely_fitted(repeated):
    found = np.asarray(repeated.factors) > 1
    # Of 600 tests at 1 %, 6 are expected, and 99.9 % of binomial draws are below 15.
    assert found.sum() < 15


@pytest.mark.slow
def test_a_wandering_black_level_widens_the_errors():
    rng = np.random.default_rng(3)
    camera, light, exposure = CameraTruth(), np.linspace(200, 6000, 24), EXPOSURE
    errors = []
    for wander in (0.0, 1.0):
        moved = CameraTruth(black_scatter=wander)
        rows = sweep(rng, moved, light, exposure, (2, 5000))
        measured = measurement_of(light, exposure, *rows, pixels=5000)
        errors.append(float(evaluate(measured, ranges(measured)).errors["dark_current_mean"]))
    # One DN of drift over 24 exposures: the textbook error of a slope, over the gain.
    slope_error = 1.0 / np.sqrt(np.sum((exposure - exposure.mean()) ** 2)) / camera.gain
    assert 0.6 < errors[1] / slope_error < 1.5
    assert errors[0] < errors[1] / 10


def test_fixed_pattern_is_recovered_within_its_errors():
    rng = np.random.default_rng(8)
    camera = CameraTruth(dsnu=4.0, prnu=0.01)
    light, exposure, shape = np.linspace(1000, 12_000, 12), np.full(12, 0.01), (8, 20_000)
    die = make_die(rng, camera, shape[1])
    rows = sweep(rng, camera, light, exposure, shape, die=die)
    measured = measurement_of(light, exposure, *rows, pixels=shape[1], frames=shape[0])
    within = ranges(measured)
    for found in (standard_pattern(measured, within), fitted_pattern(measured, np.arange(12))):
        dsnu_square, prnu_square = (camera.gain * camera.dsnu) ** 2, camera.prnu**2
        assert abs(found.dark.variance - dsnu_square) < 3 * found.dark.error
        assert abs(found.response.variance - prnu_square) < 3 * found.response.error
        assert found.dark.error < 0.03 * dsnu_square
        assert found.response.error < 0.1 * prnu_square
    assert found.chi_square_per_dof < 2


@pytest.mark.parametrize("scatter", [0.1, 5.0])
def test_least_squares_are_those_of_polyfit(scatter):
    rng = np.random.default_rng(0)
    x, errors = 1e4 * rng.uniform(1, 2, 12), rng.uniform(1, 2, 12)
    y = 3 + x + 1e-5 * x**2 + scatter * errors * rng.standard_normal(12)
    found = least_squares((1.0, x, x**2), y, errors=errors)
    values, covariance = np.polyfit(x, y, 2, w=1 / errors, cov="unscaled")
    misfit = np.sum(((y - np.polyval(values, x)) / errors) ** 2) / 9
    np.testing.assert_allclose(found.values, values[::-1], rtol=1e-9)
    np.testing.assert_allclose(found.covariance, covariance[::-1, ::-1], rtol=1e-9)
    np.testing.assert_allclose(found.misfit, misfit, rtol=1e-9)
    wider = np.sqrt(np.diagonal(covariance)[::-1] * max(misfit, 1))
    np.testing.assert_allclose(found.errors, wider, rtol=1e-9)
