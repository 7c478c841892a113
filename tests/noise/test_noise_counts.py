"""Tests calibration from tables of codes, below one electron of read noise, against simulated
cameras."""

import numpy as np
import pytest
from scipy import stats

from fitting.inference.precision import double_precision
from fitting.noise import Camera, calibrate, from_frames
from fitting.noise.counted import dim_levels, fitted_tables
from fitting.noise.findings import findings
from fitting.noise.sensor import fitted_sensor

LIGHT = (0.5, 1.0, 2.0, 4.0, 8.0, 100.0, 300.0, 1000.0)  # e-
GAIN = 8.0


def measured(read_noise=0.3, dsnu=0.0, gain=GAIN, prnu=0.0, darks=8, seed=0, shape=(40, 40)):
    """Return two frames at each light: Poisson electrons, the black level of each pixel,
    rounding."""
    rng = np.random.default_rng(seed)
    black = 300 + gain * dsnu * rng.standard_normal(shape)
    own = 1 + prnu * rng.standard_normal(shape)

    def frames(light, count):
        electrons = rng.poisson(light * own, (count, *shape))
        return list(
            np.round(black + gain * (electrons + read_noise * rng.normal(size=(count, *shape))))
        )

    return from_frames(
        [frames(light, 2) for light in LIGHT],
        [frames(0.0, darks)],
        [1.0] * len(LIGHT),
        [2 * light for light in LIGHT],
        dark_exposures=[1.0],
        camera=Camera(bits=16),
    )


@pytest.mark.parametrize("dsnu", [0.3, 3.0])
def test_tables_count_codes_above_each_pixels_own_black(dsnu):
    """Their shares are those of a plain sum, with the noise of eight dark frames added to that of
    the flat, by chi-square over cells of 10 and more, for any offsets."""
    tables = measured(dsnu=dsnu, shape=(100, 100)).tables
    noise = np.hypot(GAIN * 0.3, np.sqrt(float(tables.known[0])))
    n = np.arange(40)[:, None]
    for k, light in enumerate(LIGHT[:5]):
        counts = np.asarray(tables.counts[k])
        codes = float(tables.first[k]) + np.arange(counts.size)
        counts, codes = counts[np.isfinite(counts)], codes[np.isfinite(counts)]
        law = stats.norm(float(tables.place[k]) + GAIN * n, noise)
        share = stats.poisson.pmf(n[:, 0], light) @ (law.cdf(codes + 0.5) - law.cdf(codes - 0.5))
        expected = counts.sum() * share
        assert counts.sum() > 0.9999 * 20_000
        seen = expected > 10
        chi_square = np.sum((counts - expected)[seen] ** 2 / expected[seen])
        assert stats.chi2.sf(chi_square, seen.sum()) > 1e-4


def test_codes_are_counted_only_if_they_are_more_informative_than_moments():
    assert measured(read_noise=3.0).tables is None
    assert not len(dim_levels(measured(read_noise=3.0)))
    coarse = measured(gain=0.8)
    assert coarse.tables is None
    assert any("steps between codes are too wide" in one for one in coarse.remarks)
    uneven = measured(prnu=0.2)  # 20 % exceeds 0.3 e- from 0.3 electrons on
    assert uneven.tables is None or np.asarray(uneven.tables.level).max() == 0
    fine = measured()
    np.testing.assert_array_equal(np.unique(fine.tables.level), np.arange(5))


@pytest.mark.slow
def test_a_camera_below_an_electron_is_calibrated_by_its_histograms():
    """The DSNU is ten times the read noise. The standard gives the gain within 4 %, and the
    histogram within .1 %."""
    found = calibrate(measured(dsnu=3.0))
    gain, read = found.estimates["system_gain"], found.estimates["read_noise"]
    assert gain.standard_error < 0.002 * GAIN
    assert float(found.standard.errors["system_gain"]) > 0.02 * GAIN
    assert abs(gain.value - GAIN) < 4 * gain.standard_error
    assert abs(read.value - 0.3) < 4 * read.standard_error < 0.02
    assert any("Below 1.5 e⁻ the histogram of codes" in one for one in findings(found))
    best, draws = fitted_sensor(found)
    np.testing.assert_allclose(best.gain, gain.value, rtol=1e-6)
    np.testing.assert_allclose(np.std(draws.gain), gain.standard_error, rtol=0.1)
    np.testing.assert_allclose(best.dsnu, 3.0, rtol=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("read_noise", "dsnu", "darks"), [(0.3, 0.3, 8), (0.3, 3.0, 4), (1.0, 3.0, 8)]
)
def test_errors_of_the_histogram_are_right_for_any_offsets(read_noise, dsnu, darks):
    """Over 40 cameras, z of gain, read noise and light has mean 0 and a standard deviation of at
    most 1, within four errors. Frames that share a dark make the stated errors slightly too
    large."""
    fitted, z = double_precision(fitted_tables), []
    for seed in range(40):
        one = fitted(measured(read_noise, dsnu, darks=darks, seed=seed))
        assert not one.failures
        truth = np.log([GAIN, read_noise, *np.asarray(LIGHT)[one.levels]])
        own = (one.logs - truth) / np.sqrt(np.diagonal(one.covariance))
        z.append(np.pad(own, (0, 7 - len(own)), constant_values=np.nan))
    count = np.sum(np.isfinite(z), axis=0)
    assert (abs(np.nanmean(z, axis=0)) < 4 / np.sqrt(count)).all()
    assert (np.nanmean(np.square(z), axis=0) < 1 + 4 * np.sqrt(2 / count)).all()
    assert np.nanmean(np.square(z)) > 0.5
