"""Tests fixed patterns determined by few rows or columns: intervals, misfit, and findings."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from noise_findings import told
from oracles.frames import level_of, shared_variance
from scipy import stats

from fitting import noise
from fitting.noise.calibration import calibrate
from fitting.noise.findings import findings
from fitting.noise.levels import Levels, PhotonTransfer
from fitting.noise.pattern import PatternVariance, Spread, fitted_pattern
from fitting.noise.quantities import QUANTITIES
from fitting.noise.regressions import Part, deviation_quantiles, sampling_variance
from fitting.noise.section import _pattern_estimates
from fitting.rig import Camera

ENDS = np.array([0.025, 0.16, 0.5, 0.84, 0.975])


def test_a_single_component_has_the_interval_of_chi_square():
    for degrees in (1.0, 7.0, 15.0, 1e7):
        found = deviation_quantiles(4.0, 0.0, [Part(4.0, degrees)])
        exact = np.sqrt(4.0 * degrees / stats.chi2.isf(ENDS, degrees))
        exact[2] = 2.0  # the estimate itself
        np.testing.assert_allclose(found, exact, rtol=1e-6)


def test_noise_alone_is_gaussian_and_a_divisor_is_on_a_log_scale():
    z = stats.norm.ppf(ENDS)
    np.testing.assert_allclose(deviation_quantiles(4.0, 1.0, ()), np.sqrt(4 + z), rtol=1e-9)
    assert deviation_quantiles(1.0, 1.0, ())[0] == 0
    found = deviation_quantiles(4.0, 0.0, (), relative=0.1)
    np.testing.assert_allclose(found, 2 * np.exp(0.1 * z), rtol=1e-9)


def test_a_sum_of_components_is_covered():
    rng, count, error = np.random.default_rng(0), 3000, 0.4
    true = [Part(2.0, 7.0), Part(1.0, 400.0)]
    parts = [part.variance * rng.chisquare(part.degrees, count) / part.degrees for part in true]
    total = parts[0] + parts[1] + error * rng.standard_normal(count)
    spread = np.sqrt(sampling_variance(true) + error**2)
    assert total.std() == pytest.approx(spread, rel=0.07)  # known to 2 %
    misses = np.zeros(2)
    for own, other, seen in zip(*parts, total, strict=True):
        found = [Part(own, true[0].degrees), Part(other, true[1].degrees)]
        low, *_, high = deviation_quantiles(seen, error, found)
        misses += low > np.sqrt(3.0), high < np.sqrt(3.0)
    # 75 of each are expected; four standard deviations of a binomial are 34.
    assert np.all(np.abs(misses - 75) < 34)


def measured(rng, size, *, dark_columns=0.0, gain_columns=0.0, wander=0.0, frames=4, darks=2):
    """Return six levels up to 2500 DN, with pixels of 0.5 DN and 0.5 %, and unequal columns."""
    offsets = 0.5 * rng.standard_normal(size) + dark_columns * rng.standard_normal(size[1])
    gains = 1 + 0.005 * rng.standard_normal(size) + gain_columns * rng.standard_normal(size[1])

    def levels(signals):
        rows = []
        for signal in signals:
            mean = 64 + offsets + signal * gains
            noisy = mean + np.sqrt(2.25 + 0.25 * signal) * rng.standard_normal((frames, *size))
            taken = noisy + wander * rng.standard_normal((frames, 1, 1))
            average, variance, lines = level_of(taken)
            rows.append((average.mean(), variance, average.var(ddof=1), *lines))
        mean, variance, spatial, *lines = np.array(rows).T
        one = np.ones(len(signals))
        return Levels(
            light=jnp.asarray(signals),
            exposure=jnp.asarray(0.01 * one),
            mean=jnp.asarray(mean),
            variance=jnp.asarray(variance),
            frames=jnp.asarray(frames * one),
            pixels=jnp.asarray(float(np.prod(size))),
            spatial_variance=jnp.asarray(spatial),
            shared=shared_variance(np.array(lines), size),
        )

    bright = levels(np.linspace(125.0, 2500.0, 6))
    dark = levels(np.zeros(darks))
    nearest = jnp.zeros(6, int)
    return PhotonTransfer(bright=bright, dark=dark, dark_of=nearest, light_step=jnp.asarray(0.0))


def estimates_of(measurement):
    """Return DSNU and PRNU by the fit, for an exact gain of 1."""
    pattern = fitted_pattern(measurement, np.arange(6))
    known = SimpleNamespace(name="system_gain", value=1.0, standard_error=0.0)
    standard = SimpleNamespace(values={"system_gain": 1.0}, errors={"system_gain": 0.0})
    shown = {"system_gain": known}
    given = SimpleNamespace(patterns=(pattern, pattern), standard=standard, shown=shown, gain=1.0)
    lines = {quantity.name: quantity for quantity in QUANTITIES}
    return [_pattern_estimates(given, lines[name])[1] for name in ("dsnu", "prnu")]  # pyright: ignore[reportArgumentType]


@pytest.mark.slow
@pytest.mark.sweep
@pytest.mark.parametrize("columns", [8, 16])
def test_intervals_from_few_columns_cover(columns):
    rng, count = np.random.default_rng(columns), 240
    true = np.array([np.hypot(0.5, 1.0), 100 * np.hypot(0.005, 0.01)])
    values, above, below = [], np.zeros(2), np.zeros(2)
    for _ in range(count):
        camera = measured(rng, (30, columns), dark_columns=1.0, gain_columns=0.01)
        found = estimates_of(camera)
        values.append([one.value for one in found])
        low, high = np.array([one.interval_95 for one in found]).T
        above, below = above + (true > high), below + (true < low)
    # 6 of each are expected, and 99.9 % of binomial draws are below 15.
    assert np.all(above < 15)
    assert np.all(below < 15)
    ratio = np.mean(np.square(values), axis=0) / true**2
    # Columns contribute 0.8 of the variance; the limit is four standard errors of the average.
    assert np.all(np.abs(ratio - 1) < 4 * 0.8 * np.sqrt(2 / (columns - 1) / count))


def test_a_pattern_of_few_columns_is_not_called_hidden_by_noise():
    found = Spread(1.0, 0.01, (Part(0.1, 500.0), Part(0.0, 99.0), Part(0.9, 5.0)))
    assert found.error > 0.5  # because there are few columns
    assert found.significant


@pytest.mark.slow
def test_independent_offsets_and_gains_of_columns_are_not_a_misfit():
    """The sample covariance of 16 columns bends s^2 from level to level by chance."""
    rng, columns = np.random.default_rng(3), {"dark_columns": 1.0, "gain_columns": 0.01}
    cameras = [measured(rng, (40, 16), frames=12, **columns) for _ in range(80)]
    found = [fitted_pattern(camera, np.arange(6)) for camera in cameras]
    # Six degrees of freedom each; the limit is four standard errors of the average.
    ratios = np.array([one.chi_square_per_dof for one in found])
    assert abs(ratios.mean() - 1) < 4 * np.sqrt(2 / 6 / 80)
    assert stats.kstest([one.p_value for one in found], "uniform").pvalue > 1e-3


@pytest.mark.parametrize(("p_value", "named"), [(0.02, False), (1e-5, True)])
def test_an_insignificant_pattern_is_no_finding(p_value, named):
    spread = Spread(1.0, 0.1, (Part(1.0, 500.0),))
    fitted = PatternVariance(spread, spread, chi_square_per_dof=2.3, p_value=p_value)
    standard = PatternVariance(spread, spread, level=0)
    camera = measured(np.random.default_rng(4), (20, 20))
    given = SimpleNamespace(patterns=(standard, fitted), measurement=camera, usable=np.arange(6))
    said = " ".join(told(given, "PRNU", "unequal gains", "misfit of the pattern"))
    assert ("explain how the pattern grows with signal" in said) == named


def test_drift_is_reported_with_an_interval_that_covers():
    """The drift is 2 DN between 16 dark frames."""
    rng, covered = np.random.default_rng(5), 0
    for _ in range(100):
        camera = measured(rng, (12, 16), wander=2.0, frames=16, darks=1)
        (said,) = told(SimpleNamespace(measurement=camera), "drift of black")
        low, high = said.split("95 %: ")[1].split(")")[0].split(" to ")
        covered += float(low) < 2.0 < float(high)
    assert covered > 86  # 95 expected; 99.9 % of draws are above


@pytest.mark.slow
def test_the_gain_of_flickering_flats_is_that_of_their_pixels():
    """Rows share 25 e- in flats and 5 e- in darks, which is not taken for curvature, capacitance or
    an offset."""
    rng, photons, size = np.random.default_rng(6), np.linspace(200, 20_000, 8), (48, 64)

    def frames(mean):
        electrons = rng.poisson(0.5 * mean, (4, *size)) + 6 * rng.standard_normal((4, *size))
        electrons += (25 if mean else 5) * rng.standard_normal((4, size[0], 1))
        return list(np.round(64 + 0.25 * electrons))

    measurement = noise.from_frames(
        [frames(p) for p in photons],
        [frames(0.0) for _ in photons],
        list(np.linspace(0.001, 0.01, 8)),
        list(photons),
        camera=Camera(bits=14),
    )
    calibration = calibrate(measurement)
    told = findings(calibration)
    assert told[0].startswith("The rows of a flat share noise of ")
    assert calibration.chosen is calibration.linear
    gain = calibration.estimates["system_gain"]
    assert abs(gain.value - 0.25) < 3 * gain.standard_error
    said = " ".join(told[1:])
    assert "a dark frame share noise" in said
    for words in ("not linear", "Neighbouring pixels", "repel"):
        assert words not in said
