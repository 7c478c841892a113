"""Tests the choice of the next photograph: predicted errors against fits with the image in
question."""

from dataclasses import replace

import numpy as np
import pytest
from oracles.sphere_photographs import expose, shade, sphere_normals

from fitting.inference.parameters import names
from fitting.reflectance import Camera, SphereGeometry, from_photographs
from fitting.reflectance.from_images.calibration import calibrate
from fitting.reflectance.from_images.plan import added_information, plan, plan_section
from jaxvision.errors import InputError

SIDE, GAIN, READ_NOISE = 48, 0.5, 5.0
TILTS = np.radians([15, 30, 45, 60, 75, 40, 50, 20])
TURNS = np.radians(np.arange(8) * 137)
LIGHTS = np.stack(
    [np.sin(TILTS) * np.cos(TURNS), np.sin(TILTS) * np.sin(TURNS), np.cos(TILTS)], axis=-1
)


def photographs():
    """Return photographs of a Phong ball, k_d = .3, k_s = .4, n = 25, by NumPy, under eight lights
    with sensor noise."""
    rng = np.random.default_rng(5)
    shaded = shade(sphere_normals(SIDE, SIDE / 2 - 1), LIGHTS, "phong", 0.3, 0.4, 25)
    exposed = {"gain": GAIN, "read_noise": READ_NOISE, "black": 50.0, "clip": 4095.0}
    images = [expose(rng, 4000 * GAIN * one, **exposed).astype(np.uint16) for one in shaded]
    centre = (SIDE - 1) / 2
    return from_photographs(
        images,
        LIGHTS,
        camera=Camera(bits=12, black_level=50, gain=GAIN, read_noise=READ_NOISE),
        sphere=SphereGeometry(centre=(centre, centre), radius=SIDE / 2 - 1),
        intensities=np.full(8, 2000.0),
        held_out=(5, 6),
    )


@pytest.mark.slow
def test_a_planned_image_reduces_the_errors_as_predicted():
    """The information of the fit and one more image equals that of a fit with this image."""
    observation = photographs()
    calibration = calibrate(observation, model="phong")
    before = calibration.chosen_fits[0]
    for light in (5, 6):
        held_out = observation.held_out & (np.arange(8) != light)
        after = calibrate(replace(observation, held_out=held_out), model="phong").chosen_fits[0]
        added = added_information(observation, before, light)
        foretold = np.sqrt(np.diagonal(np.linalg.inv(before.information + added)))
        reached = np.sqrt(np.diagonal(np.linalg.inv(after.information)))
        np.testing.assert_allclose(foretold, reached, rtol=0.1)
    (found,) = plan(calibration, "exponent").values()
    sds = [candidate.sd for candidate in found.candidates]
    assert sds == sorted(sds)
    assert sds[0] < found.sd
    assert names(before.space)[2] == "exponent"
    section = plan_section(calibration, "exponent")
    assert found.best in section.findings[0]
    assert section.tables[0].rows[0][0] == found.best
    with pytest.raises(InputError, match="'exponnt' is no parameter; the nearest is 'exponent'"):
        plan(calibration, "exponnt")
