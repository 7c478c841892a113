"""Tests motions that add, remove or name things: pruned captures against full ones."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxvision as jv
from jaxvision import effects

DOWN = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
FLOOR = jv.Surface(jv.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0]), jv.Phong([0.1], [1e-4], 20.0))
BALL = jv.Surface(jv.Sphere([5, 0, 0.3], 0.2), jv.Lambert([0.3]))
SCENE = jv.Scene([FLOOR, BALL], jv.PointLight([0, 0, 3.0], [10.0]))
VIEW = jv.Orthographic([0, 0, 2.0], DOWN, 0.1, resolution=(4, 4))
CAMERA = jv.Camera(VIEW, jv.Sensor(exposure_time=1.0, gain=100.0))


def on_floor(scene, **parts):
    return replace(scene, surfaces=(replace(scene.surfaces[0], **parts), scene.surfaces[1]))


def gloss(scene, view, time):
    own = scene.surfaces[0].material
    return on_floor(scene, material=replace(own, specular=jnp.asarray([0.5]) * time)), view


def glow(scene, view, time):
    return on_floor(scene, emission=jnp.asarray([0.5]) * time), view


def lend(scene, view, time):
    """Give the ball the floor's material and move it into view. Its k_s then matters although it
    did not before."""
    ball = replace(BALL, material=scene.surfaces[0].material, shape=jv.Sphere([0, 0, 0.3], 0.2))
    return replace(scene, surfaces=(scene.surfaces[0], ball)), view


def slide(scene, view, time):
    return scene, replace(view, position=view.position + jnp.asarray([0.1, 0, 0]) * time)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("motion", "part"), [(gloss, "material"), (glow, "emission"), (lend, "material")]
)
@pytest.mark.parametrize(("allowed", "moments"), [("0DN", 2), ("50DN", 1)])
def test_fields_set_by_a_motion_are_kept(motion, part, allowed, moments):
    asked = {"motion": motion, "moments": moments}
    full = jv.capture(None, SCENE, CAMERA, **asked)
    small = jv.capture(None, SCENE, CAMERA, tolerance=allowed, **asked)
    assert small.certificate is not None
    change = np.abs(np.asarray(full.raw - small.raw)).max()
    assert change <= small.certificate.total + 1e-5 * np.asarray(full.raw).max()
    gone = {effect.name for effect in small.certificate.dropped}
    assert not any(name.startswith(f"surfaces[0].{part}") for name in gone)


def test_a_pure_displacement_can_lose_faint_gloss():
    left = effects.prune(SCENE, CAMERA, "50DN", motion=slide, moments=2)
    assert "surfaces[0].material.specular" in {e.name for e in left.certificate.dropped}


@pytest.mark.parametrize("camera", [VIEW, jv.Camera(VIEW, jv.Sensor())], ids=["view", "sensor"])
def test_a_motion_without_an_exposure_is_refused(camera):
    with pytest.raises(jv.InputError, match="exposure_time"):
        effects.inspect(SCENE, camera, motion=slide)
    with pytest.raises(jv.InputError, match="exposure_time"):
        effects.prune(SCENE, camera, "1%", motion=slide)
