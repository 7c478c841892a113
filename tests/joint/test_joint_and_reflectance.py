"""Tests that both calibrations give the same verdict and equal intervals for photographs of a
sphere with a known camera."""

from dataclasses import replace

import numpy as np
import pytest

from fitting import joint, reflectance
from fitting.checks.reflectance import GAIN, RADIUS, SIZE, WHITE, Sphere, directions, photographs
from fitting.inference.estimates import find
from fitting.reflectance.from_images.read import UniformLevels
from fitting.rig import Camera, SphereGeometry

BALL = SphereGeometry(centre=((SIZE - 1) / 2, (SIZE - 1) / 2), radius=RADIUS)


def seen(sphere, seed):
    camera = Camera(bits=12, black_level=sphere.black, gain=GAIN, read_noise=sphere.read_noise)
    found = joint.from_photographs(
        list(photographs(sphere, seed)),
        directions(sphere.lights),
        camera=camera,
        sphere=BALL,
        intensities=np.full(sphere.lights, WHITE),
    )
    return replace(found, held_out=np.zeros(sphere.lights, bool))


def both(sphere, seed):
    taken = seen(sphere, seed)
    return joint.calibrate(taken), reflectance.calibrate(taken, model="phong")


@pytest.mark.slow
def test_light_errors_as_large_as_pixel_errors_widen_both_intervals():
    """The light errors of .1 % are not detectable in 12 images. From pixels alone, k_d would have
    60 % of its error."""
    together, alone = both(Sphere(light_sd=0.001), 0)
    for name in ("diffuse", "specular", "exponent"):
        one, other = (find(c.section.estimates, name) for c in (together, alone))
        np.testing.assert_allclose(one.interval_95, other.interval_95, rtol=2e-4)


@pytest.mark.slow
def test_the_reflectance_calibration_says_that_it_uses_no_flats():
    taken = seen(Sphere(), 0)
    flat = UniformLevels(*np.array([[900.0], [360.0], [500.0], [0.1]]), dark=np.array([False]))
    for levels, told in ((None, 0), ((flat,), 1)):
        found = reflectance.calibrate(replace(taken, levels=levels), model="lambert")
        assert sum("Flats and darks are not used" in s for s in found.section.findings) == told


@pytest.mark.slow
@pytest.mark.parametrize("light_sd", [0.0, 0.01])
def test_both_agree_whether_images_disagree(light_sd):
    together, alone = both(Sphere(light_sd=light_sd), 1)
    (fit,) = alone.chosen_fits
    assert (fit.design_effect > 1) == (together.robust["grey"].design_effect > 1) == (light_sd > 0)


@pytest.mark.slow
@pytest.mark.parametrize("lights", [6, 12])
def test_intervals_cover_with_light_errors_as_large_as_pixel_errors(lights):
    """From pixels alone, 78 % of the 95 % intervals of k_d would cover. Here there are 60 fits."""
    sphere, held = Sphere(lights=lights, light_sd=0.001), 0
    for seed in range(60):
        found = find(joint.calibrate(seen(sphere, seed)).section.estimates, "diffuse")
        held += found.interval_95[0] < sphere.truth[0] < found.interval_95[1]
    assert held >= 52  # fails with a chance of 1 %
