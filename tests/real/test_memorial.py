"""Tests Debevec & Malik's memorial church: the merged map against the authors' own."""

import numpy as np
import pytest
from exposure_rigs import write_memorial_rig
from oracles.splits import split_tests

from fitting.response.calibration import calibrate as calibrate_response
from fitting.response.calibration import radiance_images
from fitting.response.read import read_exposure_stack
from fitting.rig import load_rig
from jaxvision.files.images import read_image

# Results of OpenCV 5's createCalibrateRobertson and createMergeRobertson on this stack: log10 RMS
# over the same pixels, each channel at its own scale (Debevec: .102, .166, .145).
ROBERTSON = (0.0311, 0.0460, 0.0427)


@pytest.mark.slow
def test_map_agrees_with_the_authors_map(data_folder, tmp_path):
    """Pixels of the registration border (pure blue) in any exposure, and pixels that are 0 in the
    published map, are left out."""
    stack = read_exposure_stack(load_rig(write_memorial_rig(data_folder, tmp_path)))
    published = read_image(data_folder / "hdr_memorial" / "memorial.hdr")
    red, green, blue = (plane.codes for plane in stack.planes)
    border = ((red == 0) & (green == 0) & (blue == 255)).any(axis=0)
    merged = radiance_images(calibrate_response(stack))[""]
    apart = np.log10(merged) - np.log10(np.maximum(published, 1e-9))
    trusted = ~border & (published > 0).all(axis=-1)
    assert trusted.mean() > 0.9
    for channel, rival in enumerate(ROBERTSON):
        own = apart[..., channel][trusted]
        assert np.sqrt(np.mean((own - np.median(own)) ** 2)) < rival


@pytest.mark.slow
def test_parts_of_the_stack_agree_within_their_errors(data_folder, tmp_path):
    """The curves are from halves, checkerboards and every other exposure."""
    stack = read_exposure_stack(load_rig(write_memorial_rig(data_folder, tmp_path)))
    scores, inside = zip(
        *[
            split_tests(
                plane.codes, plane.mask, plane.exposures, black=plane.black, clip=plane.clip
            )
            for plane in stack.planes
        ],
        strict=True,
    )
    assert np.sqrt(np.mean(np.square(scores))) < 1.2
    assert np.mean(inside) > 0.9
