"""Tests balls of Phong's model seen by a nearby camera, in plain NumPy."""

import numpy as np
import pytest

from fitting import joint, reflectance
from fitting.joint.findings import findings as joint_findings
from fitting.reflectance.from_images.findings import findings
from fitting.reflectance.from_images.perspective import camera_nearness
from fitting.rig import Camera

SIDE, BLACK = 32, 64.0
ROWS, COLUMNS = np.mgrid[:SIDE, :SIDE]
MIDDLE = (SIDE - 1) / 2
X, Y = (COLUMNS - MIDDLE) / (SIDE / 2), (MIDDLE - ROWS) / (SIDE / 2)
NORMALS = np.stack([X, Y, np.sqrt(np.maximum(1 - X**2 - Y**2, 0))], axis=-1)
NORMALS *= (np.hypot(X, Y) < 0.93)[..., None]


def lights():
    tilt = np.radians(np.repeat([15, 35, 55], [3, 5, 6]))
    turn = 2.4 * np.arange(14)
    return np.stack(
        [np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)], axis=1
    )


def photographs(inverse):
    """Return 12-bit photographs by a camera at a distance of 1 / `inverse` half sides of the
    frame."""
    view = np.stack([-inverse * X, -inverse * Y, np.ones_like(X)], axis=-1)
    view /= np.linalg.norm(view, axis=-1, keepdims=True)
    cosine = np.einsum("hwc,lc->lhw", NORMALS, lights())
    mirrored = 2 * cosine[..., None] * NORMALS - lights()[:, None, None]
    lobe = np.maximum((mirrored * view).sum(axis=-1), 0) ** 30
    light = 900 * np.where(cosine > 0, 0.3 * cosine + 0.4 * lobe, 0)
    rng = np.random.default_rng(0)
    dn = BLACK + rng.poisson(4 * light) / 4 + rng.normal(0, 1.5, light.shape)
    return list(np.clip(np.round(dn), 0, 4095))


def calibrated(inverse):
    observation = reflectance.from_photographs(
        photographs(inverse), lights(), camera=Camera(bits=12, black_level=BLACK), normals=NORMALS
    )
    return reflectance.calibrate(observation, model="phong")


def estimate(calibration):
    (fit,) = calibration.chosen_fits
    return camera_nearness(calibration.observation, fit.vector, fit.samples, calibration.fitted)


def is_named(calibration):
    return any("as if the directions to the camera" in one for one in findings(calibration))


@pytest.mark.slow
def test_the_distance_of_a_nearby_camera_is_estimated_and_named():
    calibration = calibrated(0.1)
    found = estimate(calibration)
    assert found.inverse == pytest.approx(0.1, rel=0.05)
    assert np.degrees(found.angle) == pytest.approx(5.3, rel=0.05)
    assert found.explained > 0.2
    assert is_named(calibration)


def test_a_camera_far_away_is_not_named():
    calibration = calibrated(0.0)
    found = estimate(calibration)
    assert abs(found.inverse) < 4 * found.error < 0.02
    assert found.explained < 0.01
    assert not is_named(calibration)


@pytest.mark.slow
@pytest.mark.parametrize("inverse", [0.0, 0.1])
def test_a_joint_fit_names_it_too(inverse):
    images, camera = photographs(inverse), Camera(bits=12, black_level=BLACK)
    seen = joint.from_photographs(images, lights(), camera=camera, normals=NORMALS)
    named = [one for one in joint_findings(joint.calibrate(seen)) if "directions to the" in one]
    assert len(named) == (inverse > 0)
