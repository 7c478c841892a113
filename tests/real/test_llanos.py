"""Tests Llanos' linear camera, whose gamma is 1 within the errors of its shutter and linearity."""

import numpy as np
import pytest
from exposure_rigs import write_bandpass_rig

from fitting.response.calibration import calibrate as calibrate_response
from fitting.response.read import read_exposure_stack
from fitting.response.section import section as response_section
from fitting.response.shape import largest_departure
from fitting.rig import load_rig

LINEARITY = 0.01  # RMS, of this camera; published as .1 to 4 %
DARKEST = 8.0  # DN, below which few pixels count


@pytest.mark.slow
def test_linear_camera_has_gamma_one(data_folder, tmp_path):
    """Each band, 500 and 600 nm, is read in the sites that see it. The published linearity is .1 to
    4 %."""
    folder = write_bandpass_rig(data_folder, tmp_path, bands=("500nm", "600nm"))
    stack = read_exposure_stack(load_rig(folder))
    assert stack.planes[0].black < 0.01  # the dark frames
    calibration = calibrate_response(stack)
    bright = [
        channel
        for channel in calibration.channels
        if channel.plane.label
        in ("500nm green 1", "500nm green 2", "600nm red", "600nm green 1", "600nm green 2")
    ]
    assert len(bright) == 5
    for channel in bright:
        gamma = channel.gamma.gamma
        assert abs(gamma.value - 1) < 2.5 * gamma.standard_error
        assert gamma.standard_error < 0.008  # earlier .005
        assert largest_departure(channel.curve, channel.gamma.departure)[0] < 0.04
    # The true value has an error itself: 1 % between two codes changes the exponent by this much.
    of_truth = LINEARITY / np.log(255 / DARKEST)
    for channel in bright:
        own = np.diff(channel.gamma.gamma.interval_95)[0] / 2
        assert abs(channel.gamma.gamma.value - 1) < np.hypot(own, 1.96 * of_truth)
    # Shutter and lamp have errors, too, and the report says so.
    assert any("disagree on their exposure" in s for s in response_section(calibration).findings)


@pytest.mark.slow
def test_no_curve_is_based_on_a_few_pixels(data_folder, tmp_path):
    """In an earlier version, the images of one green site agreed with 57 of 30,000 pixels only."""
    folder = write_bandpass_rig(data_folder, tmp_path, bands=("650nm",))
    calibration = calibrate_response(read_exposure_stack(load_rig(folder)))
    for channel in calibration.channels:
        assert channel.curve.statistics.pixels > 10_000
        assert channel.curve.held_out is not None
        assert channel.curve.held_out.mean < 5
        assert abs(channel.gamma.gamma.value - 1) < 0.04  # earlier .56 and .62 in dim sites
