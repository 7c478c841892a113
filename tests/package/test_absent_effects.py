"""Tests that an effect that is None leaves nothing in the traced program, by counting primitives,
for effects of sensor, lens, shadows, motion and development."""

from collections import Counter
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles.sensors import EVERY_EFFECT
from traced import primitives

import jaxvision as jv
from jaxvision import optics
from jaxvision import scene as s
from jaxvision.development import develop
from jaxvision.rendering import render
from jaxvision.sensor import raw_image
from jaxvision.shot import capture

KEY, DIE = jax.random.split(jax.random.key(8))
LIGHT = np.full((6, 8, 3), 1e-3)
# Primitives that only the program of this effect contains.
SIGNATURES = {
    "smear": "reduce_sum",
    "blooming": "scan",
    "charge_transfer": "expm1",
    "banding": "sin",
    "bits": "round",
}
DRAWN = {
    "prnu",
    "dead_pixels",
    "hot_pixels",
    "shot_noise",
    "conversion_prnu",
    "dsnu",
    "column_dsnu",
    "row_dsnu",
    "reset_noise",
    "read_noise",
    "telegraph_noise",
    "row_noise",
    "banding",
    "column_prnu",
}
LENS = s.ThinLens(
    [0, 0, 0],
    np.eye(3),
    0.05,
    1e-5,
    resolution=(6, 8),
    f_number=4.0,
    focus_distance=2.0,
    rim=s.Rim(0.03, 0.02),
    distortion=s.Distortion([-0.1], [0.01, 0.02]),
    diffraction=s.Diffraction([6e-7, 5e-7, 4e-7], size=5),
)


def shot(sensor):
    return primitives(
        lambda sensor, light: raw_image(KEY, sensor, light, die_key=DIE), sensor, LIGHT
    )


def test_a_sensor_without_effects_is_an_empty_program():
    assert shot(s.Sensor()) == Counter()


@pytest.fixture(scope="module")
def with_all():
    return shot(EVERY_EFFECT)


EFFECTS = [name for name, value in vars(EVERY_EFFECT).items() if value is not None]


@pytest.mark.sweep
@pytest.mark.parametrize("effect", [name for name in EFFECTS if name != "full_well"])
def test_removing_a_source_removes_its_primitives(effect, with_all):
    """One of all effects is removed: nothing is added, and fewer primitives remain."""
    without = shot(replace(EVERY_EFFECT, **{effect: None}))
    cut = Counter(["min"]) if effect == "blooming" else Counter()  # a well without blooming clips
    assert without - cut <= with_all
    assert without != with_all
    if effect in SIGNATURES:
        rest = 1 if effect == "blooming" else 0  # the loop of the brighter-fatter effect
        assert with_all[SIGNATURES[effect]] > without[SIGNATURES[effect]] == rest
    needed = {"full_well": EVERY_EFFECT.full_well} if effect == "blooming" else {}
    alone = shot(s.Sensor(**{effect: getattr(EVERY_EFFECT, effect)}, **needed))
    assert alone
    assert (alone["xor"] > 0) == (effect in DRAWN)  # of the random number hash


@pytest.mark.slow
def test_absent_parts_of_a_lens_are_not_traced():
    def light(view):
        return primitives(optics.sensor_irradiance, view, jnp.ones((6, 8, 3)))

    whole = light(LENS)
    bare = light(replace(LENS, rim=None, distortion=None, diffraction=None))
    for part in ("rim", "distortion", "diffraction"):
        without = light(replace(LENS, **{part: None}))
        assert without <= whole
        assert without != whole
        alone = light(
            replace(LENS, **{p: None for p in ("rim", "distortion", "diffraction") if p != part})
        )
        assert bare <= alone
        assert bare != alone
    # only the formula: no iteration, no transform, no convolution
    assert not set(bare) & {"while", "scan", "fft", "conv_general_dilated", "cos", "sin"}


DOWN = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
VIEW = s.Orthographic([0, 0, 3], DOWN, 0.2, resolution=(4, 4))
FLOOR = s.Surface(s.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0]), jv.Lambert([0.25]))
# more than are unrolled, so that a search among them is a loop
BALLS = [s.Surface(s.Sphere([0.1 * i, 0, 0.3], 0.05), jv.Lambert([0.2])) for i in range(20)]
SCENE = s.Scene([FLOOR, *BALLS], jv.PointLight([1, 0.5, 4.0], [8.0]))


def test_without_occluders_there_is_no_shadow_search():
    """There is one loop fewer over the shapes: the remaining one searches for what a ray hits."""
    shaded = primitives(render, SCENE, VIEW)
    without = primitives(render, replace(SCENE, occluders=()), VIEW)
    assert shaded["scan"] == without["scan"] + 1
    assert without <= shaded


def test_without_lobes_there_is_no_power():
    """Lambert's law needs no exponential, but a lobe does."""
    assert not set(primitives(render, SCENE, VIEW)) & {"exp", "exp2", "log", "log2", "pow"}


@pytest.mark.slow
def test_without_motion_there_is_no_loop_over_moments():
    """A shutter without motion has no effect, and a motion has one loop over its moments."""
    sensor = s.Sensor(exposure_time=0.01, shutter=s.RollingShutter(1e-4))
    few = replace(SCENE, surfaces=(FLOOR,))

    def raw(sensor, **moving):
        camera = s.Camera(VIEW, sensor)
        return primitives(lambda x: capture(None, x, camera, **moving).raw, few)

    still = raw(sensor)
    assert still == raw(replace(sensor, shutter=None))
    assert raw(sensor, motion=lambda x, view, time: (x, view))["scan"] == still["scan"] + 1


STEPS = s.Development(
    black_level=60.0,
    white_level=1000.0,
    white_balance=s.WhiteBalance([2.0, 1.0, 1.5]),
    saturation=1.0,
    denoising=s.Bilateral(1.0, 0.1, radius=1),
    colour_matrix=np.eye(3) + 0.1,
    tone_map=s.Reinhard(),
    tone=s.SRGB(),
    sharpening=s.UnsharpMask(1.0, 0.8, size=3),
    compression=s.JPEG(90.0),
)


@pytest.mark.slow
def test_removing_a_step_of_development_removes_its_primitives():
    image = jnp.ones((8, 8, 3))
    whole = primitives(lambda x: develop(x, STEPS), image)
    for name in vars(STEPS):
        if getattr(STEPS, name) is None:
            continue
        absent = {name: None} | ({"saturation": None} if name == "white_balance" else {})
        without = primitives(partial(develop, development=replace(STEPS, **absent)), image)
        assert without <= whole, name
        assert sum(without.values()) < sum(whole.values()), name
    assert primitives(lambda x: develop(x, s.Development()), image) == Counter()
