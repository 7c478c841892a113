"""Tests a real 12-bit camera against its published EMVA 1288 sheet (reference_results.csv)."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from fitting.inference.estimates import find
from fitting.noise.calibration import calibrate as calibrate_noise
from fitting.noise.emva1288 import ranges
from fitting.noise.levels import linear_levels, saturation_index
from fitting.noise.prediction.predict import predict, predict_own_frames
from fitting.noise.read import read_photon_transfer
from fitting.noise.release_4.section import sections
from fitting.noise.release_4.sheet import release_4_sheet
from fitting.noise.release_4.stacks import read_stacks
from fitting.noise.section import section as noise_section
from jaxvision import read_camera, read_sensor


@pytest.fixture(scope="module")
def published(data_folder):
    with (data_folder / "emva1288" / "reference_results.csv").open() as stream:
        return {row["name"]: float(row["value"]) for row in csv.DictReader(stream)}


@pytest.fixture(scope="module")
def measurement(data_folder):
    return read_photon_transfer(data_folder / "emva1288" / "temporal_ptc.csv")


@pytest.fixture(scope="module")
def calibration(measurement):
    return calibrate_noise(measurement)


def test_pixel_count_depth_and_ranges_are_found(measurement, published):
    assert float(measurement.bright.pixels) == 640 * 480
    assert measurement.full_scale == 2**12 - 1
    assert saturation_index(measurement.bright) == published["index_u_ysat"]
    within = ranges(measurement)
    for mask, name in ((within.sensitivity, "sensitivity"), (within.linearity, "linearity")):
        used = np.flatnonzero(mask)
        assert used[0] == published[f"index_{name}_min"]
        assert used[-1] == published[f"index_{name}_max"]
    assert linear_levels(measurement)[-1] == 34


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        ("system_gain", "K"),
        ("inverse_gain", "inverse_K"),
        ("quantum_efficiency", "QE"),
        ("responsivity", "R"),
        ("temporal_dark_noise", "sigma_y_dark"),
        ("read_noise", "sigma_d"),
        ("saturation_photons", "u_p_sat"),
        ("saturation_electrons", "u_e_sat"),
        ("snr_max", "SNR_max"),
        ("snr_max_bits", "SNR_max_bit"),
        ("threshold_photons", "u_p_min"),
        ("dynamic_range", "DR"),
        ("linearity_error_min", "LE_min"),
        ("linearity_error_max", "LE_max"),
        ("dark_current_mean", "u_I_mean"),
    ],
)
def test_the_standards_sheet_equals_the_published_one(calibration, published, ours, theirs):
    value = float(calibration.standard.values[ours])
    np.testing.assert_allclose(value, published[theirs], rtol=1e-6)
    assert 0 < float(calibration.standard.errors[ours]) < abs(value)


@pytest.mark.slow
def test_release_4_differs_by_its_threshold_and_names_what_a_table_lacks(data_folder, published):
    sheet = release_4_sheet(read_stacks(data_folder / "emva1288" / "temporal_ptc.csv"))
    found = {name: float(value) for name, value in sheet.linear.values.items()}
    same = {"system_gain": "K", "responsivity": "R", "read_noise": "sigma_d", "snr_max": "SNR_max"}
    for ours, theirs in same.items():
        np.testing.assert_allclose(found[ours], published[theirs], rtol=1e-6)
    sigma = published["sigma_y_dark"] / published["K"]
    ratio = (np.sqrt(sigma**2 + 0.25) + 0.5) / (sigma + 0.5)
    np.testing.assert_allclose(found["threshold_photons"], ratio * published["u_p_min"], rtol=1e-6)
    sizes = published["LE_min"], published["LE_max"]
    assert 0 < found["linearity_error"] < max(map(abs, sizes))
    linear, general = sections(sheet)
    assert "pixels" in linear.estimate("prnu_col").reason
    # The bound without a model is the number of electrons that the SNR needs. The standard's K, a
    # line through a curve, gives 2.6 % less.
    bound = general.estimate("efficiency_bound")
    assert bound.value is not None
    np.testing.assert_allclose(bound.value, published["QE"], rtol=0.03)
    assert sheet.general.total is None


@pytest.mark.slow
def test_three_published_values_are_corrected(calibration, published):
    values = calibration.standard.values
    # The sheet's decibels are 20 ln of the ratio instead of 20 log10.
    for ours, theirs in (("snr_max_db", "SNR_max_dB"), ("dynamic_range_db", "DR_dB")):
        np.testing.assert_allclose(values[ours], published[theirs] / np.log(10), rtol=1e-6)
    # Its dark current from the variance is the square root of slope / K^2, which has no unit. Later
    # versions of the reference code dropped the root.
    np.testing.assert_allclose(
        values["dark_current_variance"], published["u_I_var"] ** 2, rtol=1e-5
    )


@pytest.mark.slow
def test_results_that_need_pixels_are_not_given_for_sums(calibration):
    section = noise_section(calibration)
    for name in ("dsnu", "prnu"):
        estimate = find(section.estimates, name)
        assert estimate.value is None
        assert "temporal sums" in estimate.reason


@pytest.mark.slow
def test_the_nonlinearity_is_detected_and_explained(calibration):
    linear, chosen = calibration.linear, calibration.chosen
    assert linear.chi_square / linear.degrees > 30
    assert chosen.chi_square / chosen.degrees < 1.3
    assert chosen.p_value > 0.01
    bend = float(chosen.values["compression"]) / chosen.errors["compression"]
    assert bend > 10
    # From the file: the shot variance over signal falls from 0.288 in the first levels to 0.280 in
    # the last, compared with K of both methods.
    gain = find(calibration.sheet, "system_gain")
    assert 0.287 < gain.value < 0.294
    standard, error = (
        float(x["system_gain"]) for x in (calibration.standard.values, calibration.standard.errors)
    )
    assert gain.value - standard > 4 * np.hypot(gain.standard_error, error)
    assert abs(calibration.likelihood.standard_of_chosen - standard) < 2 * error
    told = " ".join(noise_section(calibration).findings)
    assert "not linear" in told
    assert "the gain falls by" in told
    assert "black level varies" in told


@pytest.mark.slow
def test_dark_current_by_mean_variance_and_likelihood_agree(calibration):
    values, errors = calibration.standard.values, calibration.standard.errors
    spread = np.hypot(errors["dark_current_mean"], errors["dark_current_variance"])
    assert abs(values["dark_current_mean"] - values["dark_current_variance"]) < 3 * spread
    both = find(noise_section(calibration).estimates, "dark_current")
    assert abs(both.value - values["dark_current_mean"]) < 3 * both.standard_error


@pytest.mark.slow
def test_the_written_camera_predicts_its_own_levels(calibration, measurement, tmp_path):
    """Without the compression and the light offset in the file, the means are wrong by up to 65
    DN."""
    prediction = predict_own_frames(calibration)
    kept_out, whole = prediction.comparisons
    assert len(whole.lit.lit) == 35 + 50
    for comparison in (kept_out, whole):
        for name in ("means", "variances"):
            assert comparison.agreement[name].ratio < 1.2, name
    calibration.section.records["sensor"](tmp_path / "sensor.toml")
    written = read_sensor(tmp_path / "sensor.toml")
    straight = predict(replace(written, nonlinearity=None), measurement)
    named = {one.key: one.clause for one in straight.missing}
    assert {"compression", "light_scatter", "variance_scatter"} == {*named}
    assert "the mean is 1.69" in named["compression"]
    assert not any(one.is_missed for one in straight.missing[-1].after.values())


@pytest.mark.slow
def test_the_nonlinearity_that_the_published_sheet_lacks_is_named(measurement):
    """The sheet is of a linear camera, and the measured response is nonlinear by 41 standard
    errors."""
    prediction = predict(read_camera("emva1288").sensor, measurement)
    assert any("a response that is not linear" in one.clause for one in prediction.missing)
