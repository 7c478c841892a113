"""Tests photographs of a ball whose camera, surface or position differs from the rig."""

from dataclasses import replace

import numpy as np
import pytest
from oracles.sphere_photographs import expose, shade, sphere_normals

from fitting import joint, reflectance
from fitting.checks.reflectance import GAIN, RADIUS, SIZE, WHITE, Sphere, directions, photographs
from fitting.inference.estimates import find
from fitting.rig import Camera, SphereGeometry
from jaxvision.errors import InputError

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
def test_a_camera_that_clips_below_full_scale_is_detected(seed):
    """The camera clips at 2000 of 4095 DN. A highlight that ends naturally is not clipped, nor is
    one in 8 bits."""
    images = photographs(Sphere(), seed)
    found = of(np.minimum(images, 2000))
    assert found.clip == 2000
    count = int((np.minimum(images, 2000)[:, found.rows, found.columns] == 2000).sum())
    assert any(f"{count} samples are at 2000 DN and none above" in s for s in found.findings)
    for clear in (images, 60 + np.round((images - 60) / 16)):
        assert of(clear).clip == 4095
    assert of(np.minimum(images, 2000), saturation=3000).clip == 3000


def encoded_ball(curve, seed=0):
    """Return photographs of a glossy ball in 8 bits with a tone curve, sampled at pixel centres."""
    light = shade(sphere_normals(SIZE, RADIUS), directions(12), "phong", 0.4, 0.45, 40)
    noise = 0.003 * np.sqrt(light + 0.01)
    light = light + noise * np.random.default_rng(seed).standard_normal(light.shape)
    return np.clip(np.round(255 * curve(np.maximum(light, 0))), 0, 255)


def of_8_bits(images, **known):
    return joint.from_photographs(
        list(images),
        directions(12),
        camera=Camera(bits=8, black_level=0, **known),
        sphere=BALL,
        intensities=np.full(12, 255.0),
    )


def srgb(x):
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_a_gamma_that_nobody_stated_is_fitted(seed):
    """Read as linear, the diffuse term would be .78 +- .02 instead of .4."""
    images = encoded_ball(lambda x: x ** (1 / 2.2), seed)
    found = reflectance.calibrate(of_8_bits(images), model="phong").section
    assert any("treated as encoded" in s for s in found.findings)
    for name, truth in {"diffuse": 0.4, "specular": 0.45, "exponent": 40.0, "gamma": 2.2}.items():
        low, high = find(found.estimates, name).interval_95
        assert low < truth < high < 1.2 * low
    # pixels are points, which the fit must detect before it judges the curve
    assert_covers(joint.calibrate(of_8_bits(images)).section.estimates, TRUTH | {"gamma": 2.2})
    linear = reflectance.calibrate(of_8_bits(encoded_ball(lambda x: x)), model="phong").section
    assert not any("treated as encoded" in s for s in linear.findings)
    stated = reflectance.calibrate(of_8_bits(images, gamma=1.0), model="phong").section
    assert not any("treated as encoded" in s for s in stated.findings)


TRUTH = {"diffuse": 0.4, "specular": 0.45, "exponent": 40.0}


def assert_covers(estimates, truth):
    for name, value in truth.items():
        low, high = find(estimates, name).interval_95
        assert low - 0.2 * (high - low) < value < high + 0.2 * (high - low) < 1.2 * low


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_pictures_in_srgb_are_decoded(seed):
    observation = of_8_bits(encoded_ball(srgb, seed))
    found = reflectance.calibrate(observation, model="phong").section
    assert_covers(found.estimates, TRUTH)
    assert any("treated as sRGB and were decoded" in s for s in found.findings)
    assert_covers(joint.calibrate(observation).section.estimates, TRUTH)


@pytest.mark.slow
def test_pictures_of_another_curve_have_no_numbers():
    """The curve is steeper than sRGB in the middle, as in a camera's own pictures."""
    images = encoded_ball(lambda x: srgb(x) * (1 + 0.25 * (srgb(x) - 0.5) * (1 - srgb(x))))
    observation = of_8_bits(images)
    found = reflectance.calibrate(observation, model="phong").section
    assert all(estimate.value is None for estimate in found.estimates)
    assert "neither by a pure gamma nor as sRGB" in find(found.estimates, "diffuse").reason
    with pytest.raises(InputError, match="neither by a pure gamma nor as sRGB"):
        joint.calibrate(observation)


@pytest.mark.slow
def test_stripes_of_a_surface_are_named():
    row = np.arange(SIZE)[:, None]
    striped = np.where(row // 3 % 2 == 0, 1.0, 0.45)
    images = np.round(60 + (photographs(Sphere(), 0) - 60) * striped)
    known = {"gain": GAIN, "read_noise": 6.0}
    told = reflectance.calibrate(of(images, **known), model="phong").section.findings
    plain = reflectance.calibrate(of(photographs(Sphere(), 0), **known), model="phong")
    assert any("varying albedo (texture, stains)" in s for s in told)
    assert not any("varying albedo (texture, stains)" in s for s in plain.section.findings)


@pytest.mark.slow
def test_a_joint_fit_without_standard_errors_is_reported():
    """After a diverged fit the information is NaN, and the report says that the fit failed."""
    found = joint.calibrate(of(photographs(Sphere(lights=6), 0), lights=6, gain=GAIN))
    (fit,) = found.fits
    lost = replace(
        fit, converged=False, information=np.full_like(fit.information, np.nan), unexplained=None
    )
    told = replace(found, fits=(lost,), posteriors={}, robust={}, halves={}).section
    assert "The fit did not converge; do not use its numbers." in told.findings
    assert all(estimate.value is None for estimate in told.estimates)


@pytest.mark.slow
@pytest.mark.parametrize("camera", [{"gain": GAIN, "read_noise": 6.0}, {}])
@pytest.mark.parametrize("wrong", [-40, 10])
def test_a_wrong_black_level_is_estimated_from_the_shadows(wrong, camera):
    """The rig states 60 DN. Without the shadows, k_d was wrong by 34 standard errors, without a
    message if gain and read noise are free."""
    sphere = Sphere(lights=10, black=60.0 + wrong)
    found = joint.calibrate(of(photographs(sphere, 0), lights=10, **camera)).section
    side = "above" if wrong > 0 else "below"
    assert any(f"{side} the black level of 60.0 DN" in s for s in found.findings)
    truths = {"diffuse": 0.4, "specular": 0.45, "exponent": 40.0, "black_level": 60.0 + wrong}
    for name, truth in truths.items():
        estimate = find(found.estimates, name)
        assert abs(estimate.value - truth) < 3 * estimate.standard_error


@pytest.mark.slow
def test_a_right_black_level_is_kept():
    found = joint.calibrate(of(photographs(Sphere(), 0), gain=GAIN, read_noise=6.0)).section
    assert not any("Pixels that face away" in s for s in found.findings)
    assert "black_level" not in [estimate.name for estimate in found.estimates]


@pytest.mark.slow
def test_a_highlight_between_the_samples_has_no_exponent():
    """A polished ball with an exponent of 1e4 is sampled at pixel centres, so only one pixel is
    bright."""
    shaded = shade(sphere_normals(SIZE, RADIUS), directions(10), "phong", 0.4, 3.0, 1e4)
    exposed = {"gain": GAIN, "read_noise": 6.0, "black": 60.0, "clip": 4095.0}
    images = expose(np.random.default_rng(0), WHITE * shaded, **exposed)
    found = reflectance.calibrate(of(images, lights=10, gain=GAIN, read_noise=6.0), model="phong")
    estimates = found.section.estimates
    assert all(find(estimates, name).value is None for name in ("specular", "exponent"))
    clear = reflectance.calibrate(
        of(photographs(Sphere(), 0), gain=GAIN, read_noise=6.0), model="phong"
    )
    assert find(clear.section.estimates, "exponent").value == pytest.approx(40, abs=1)
