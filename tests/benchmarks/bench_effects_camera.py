"""Time camera effects of zero size: always on, pruned, and in a camera without them.

The examples are the effects of a lens at a megapixel, a motion of zero speed at 256 x 256 pixels,
and a raw frame of a megapixel with one source of noise. Programs are timed in alternation. Ratios
are always on / pruned.

    pytest tests/benchmarks/bench_effects_camera.py -m benchmark -s
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from turns import in_turns

import jaxvision as jv
from jaxvision import effects
from jaxvision import scene as s
from jaxvision.optics import sensor_irradiance
from jaxvision.sensor import raw_image
from jaxvision.shot import capture

ROUNDS = 9
SIZE = (256, 256)
KEY, DIE = jax.random.split(jax.random.key(0))
DOWN = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
FLOOR = s.Surface(s.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0]), jv.Lambert([0.25]))
SCENE = s.Scene([FLOOR], [jv.PointLight([1.0, 0.5, 4.0], [8.0])])
FINE = (1024, 1024)
IDLE_LENS = {  # effects that are proved negligible, and effects that stay within the tolerance
    "rim": (s.Rim(0.001, 0.2), "0DN"),
    "distortion": (s.Distortion([0.0]), "0DN"),
    "diffraction": (s.Diffraction(5.5e-7), "0.01DN"),
}
IDLE_SENSOR = {
    "read_noise": 0.0,
    "dsnu": 0.0,
    "prnu": 0.0,
    "conversion_prnu": 0.0,
    "telegraph_noise": s.TelegraphNoise(0.1, 0.0),
    "crosstalk": 0.0,
    "smear": 0.0,
    "charge_transfer": s.ChargeTransfer(0.0),
    "full_well": np.inf,
}
LENS_AIM = 10.0


def lens(**parts):
    return s.ThinLens([0, 0, 3], DOWN, 0.05, 2.5e-5, resolution=FINE, f_number=4.0, **parts)


def timed(rivals):
    _, seconds = in_turns(rivals, rounds=ROUNDS)
    return seconds["always on"] / seconds["pruned"], seconds


@pytest.mark.benchmark
@pytest.mark.parametrize("part", IDLE_LENS)
def test_idle_parts_of_a_lens(part):
    record, tolerance = IDLE_LENS[part]
    camera = s.Camera(lens(**{part: record}), s.Sensor())
    pruned = effects.prune(SCENE, camera, tolerance)
    assert f"view.{part}" in {effect.name for effect in pruned.certificate.dropped}
    light, bare = jnp.ones((*FINE, 1)), lens()
    stage = jax.jit(sensor_irradiance)
    ratio, seconds = timed(
        {
            "always on": lambda: stage(camera.view, light),
            "pruned": lambda: stage(pruned.camera.view, light),
            "never there": lambda: stage(bare, light),
        }
    )
    print(f"view.{part}: {ratio:.1f} x ({seconds})")
    assert ratio >= LENS_AIM


@pytest.mark.benchmark
@pytest.mark.parametrize("name", IDLE_SENSOR)
def test_idle_sources_of_a_sensor(name):
    sensor, never = (
        s.Sensor(gain=0.5, offset=10.0, bits=12, **own) for own in ({name: IDLE_SENSOR[name]}, {})
    )
    view = s.Orthographic([0, 0, 3], DOWN, 0.01, resolution=SIZE)
    pruned = effects.prune(SCENE, s.Camera(view, sensor), "0DN")
    assert f"sensor.{name}" in {effect.name for effect in pruned.certificate.dropped}
    light = jnp.full((1024, 1024, 1), 100.0)
    frame = jax.jit(lambda sensor, light: raw_image(KEY, sensor, light, die_key=DIE))
    ratio, seconds = timed(
        {
            "always on": lambda: frame(sensor, light),
            "pruned": lambda: frame(pruned.camera.sensor, light),
            "never there": lambda: frame(never, light),
        }
    )
    print(f"sensor.{name}: {ratio:.1f} x ({seconds})")
    assert ratio >= 0.97


@pytest.mark.benchmark
def test_a_motion_that_does_not_move():
    def rest(scene, view, time):
        still = replace(FLOOR.shape, corner=FLOOR.shape.corner + time * np.zeros(3))
        return replace(scene, surfaces=(replace(FLOOR, shape=still),)), view

    view = s.Orthographic([0, 0, 3], DOWN, 0.01, resolution=SIZE)
    camera = s.Camera(view, s.Sensor(exposure_time=0.01))
    pruned = effects.prune(SCENE, camera, "0DN", motion=rest)
    assert pruned.moments is None
    full = jax.jit(lambda scene: capture(None, scene, camera, motion=rest).raw)
    less = jax.jit(lambda scene: capture(None, scene, pruned.camera).raw)
    ratio, seconds = timed(
        {
            "always on": lambda: full(SCENE),
            "pruned": lambda: less(pruned.scene),
            "never there": lambda: less(SCENE),
        }
    )
    print(f"motion: {ratio:.1f} x ({seconds})")
    assert ratio >= 3
