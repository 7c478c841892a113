"""Photographs of a ball whose camera, surface or place is not as the rig says."""

from dataclasses import replace

import numpy as np
import pytest

from fitting import joint, reflectance
from fitting.checks.reflectance import GAIN, RADIUS, SIZE, WHITE, Sphere, directions, photographs
from fitting.rig import Camera, SphereGeometry

BALL = SphereGeometry(centre=((SIZE - 1) / 2, (SIZE - 1) / 2), radius=RADIUS)


def of(images, *, lights=12, **known):
    return joint.from_photographs(
        list(images),
        directions(lights),
        camera=Camera(bits=12, black_level=60, **known),
        sphere=BALL,
        intensities=np.full(lights, WHITE),
    )


@pytest.mark.parametrize("seed", [0, 1])
def test_a_camera_that_clips_below_full_scale_is_noticed(seed):
    """At 2000 of 4095 DN; a highlight that ends by itself is none, nor one of 8 bits."""
    images = photographs(Sphere(), seed)
    found = of(np.minimum(images, 2000))
    assert found.clip == 2000
    count = int((np.minimum(images, 2000)[:, found.rows, found.columns] == 2000).sum())
    assert any(f"{count} samples are at 2000 DN and none above" in s for s in found.findings)
    for clear in (images, 60 + np.round((images - 60) / 16)):
        assert of(clear).clip == 4095
    assert of(np.minimum(images, 2000), saturation=3000).clip == 3000


@pytest.mark.slow
def test_stripes_of_a_surface_are_told():
    row = np.arange(SIZE)[:, None]
    striped = np.where(row // 3 % 2 == 0, 1.0, 0.45)
    images = np.round(60 + (photographs(Sphere(), 0) - 60) * striped)
    known = {"gain": GAIN, "read_noise": 6.0}
    told = reflectance.calibrate(of(images, **known), model="phong").section.findings
    plain = reflectance.calibrate(of(photographs(Sphere(), 0), **known), model="phong")
    assert any("varying albedo (texture, stains)" in s for s in told)
    assert not any("varying albedo (texture, stains)" in s for s in plain.section.findings)


@pytest.mark.slow
def test_a_joint_fit_without_errors_is_reported():
    """Of a fit that ran away the information is no number; the report says that it did."""
    found = joint.calibrate(of(photographs(Sphere(lights=6), 0), lights=6, gain=GAIN))
    (fit,) = found.fits
    lost = replace(
        fit, converged=False, information=np.full_like(fit.information, np.nan), unexplained=None
    )
    told = replace(found, fits=(lost,), posteriors={}, robust={}, halves={}).section
    assert "The fit did not converge; do not use its numbers." in told.findings
    assert all(estimate.value is None for estimate in told.estimates)
