"""Tests `capture` with a tolerance: the same picture with fewer effects, and a smaller program."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from random_sensors import SHAPE, draw
from traced import primitives

import jaxvision as jv
from jaxvision import effects
from jaxvision import scene as s
from jaxvision.effects.sensor import sensor_stage
from jaxvision.effects.stages import Draft, Ends
from jaxvision.rendering import PixelSamples
from jaxvision.sensor import raw_image
from jaxvision.shot import capture

KEY, DIE = jax.random.split(jax.random.key(3))
DOWN = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
FLOOR = s.Surface(s.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0]), jv.Lambert([0.25, 0.2]))
BALL = s.Surface(s.Sphere([0, 0, 0.3], 0.3), jv.Phong([0.2, 0.1], [0.0, 0.0], 20.0))
SCENE = s.Scene(
    [FLOOR, BALL], [jv.PointLight([1.0, 0.5, 4.0], [8.0, 8.0]), jv.PointLight([0, 0, 2], [0, 0])]
)
LENS = s.ThinLens(
    [0, 0, 3],
    DOWN,
    0.05,
    0.002,
    resolution=(8, 8),
    f_number=2.0,
    focus_distance=2.9,
    rim=s.Rim(0.001, 0.2),
    distortion=s.Distortion([0.0]),
)
SENSOR = s.Sensor(
    colour_filter=s.ColourFilter(1e4 * np.ones((1, 2)), pattern=((0,),)),
    exposure_time=0.5,
    shutter=s.RollingShutter(1e-3),
    shot_noise=s.GaussianShotNoise(),
    read_noise=3.0,
    dsnu=1e-4,
    prnu=0.0,
    crosstalk=0.0,
    full_well=1e9,
    gain=1.0,
)
CAMERA = s.Camera(LENS, SENSOR, s.Development(white_balance=s.WhiteBalance([1.0])))
SAMPLES = PixelSamples(KEY, 4)


def rest(scene, view, time):
    return scene, view


def program(scene, camera, **settings):
    return primitives(
        lambda scene, camera: capture(KEY, scene, camera, die_key=DIE, **settings).raw,
        scene,
        camera,
    )


def test_a_tolerance_is_for_known_numbers_only():
    with pytest.raises(ValueError, match="jit"):
        jax.eval_shape(lambda x: capture(KEY, x, CAMERA, tolerance="1DN").raw, SCENE)


@pytest.mark.slow
def test_provably_idle_effects_are_dropped_without_a_tolerance():
    """Idle parts of scene, lens, motion, sensor and development are dropped, and the program only
    shrinks."""
    pruned = effects.prune(SCENE, CAMERA, "0DN", samples=SAMPLES, motion=rest, moments=8)
    gone = {effect.name for effect in pruned.certificate.dropped}
    assert gone >= {
        "view.rim",
        "view.distortion",
        "motion",
        "sensor.shutter",
        "sensor.crosstalk",
        "sensor.prnu",
        "sensor.gain",
        "development.white_balance",
    }
    assert pruned.certificate.total == 0
    assert pruned.moments is None
    full = program(SCENE, CAMERA, samples=SAMPLES, motion=rest, moments=8)
    less = program(pruned.scene, pruned.camera, samples=pruned.samples)
    assert sum(less.values()) < sum(full.values())
    assert full["scan"] > less["scan"]  # no moments
    assert full["while"] > less["while"] == 0  # no distortion


@pytest.mark.slow
def test_a_tolerance_of_zero_does_not_change_the_picture():
    """The pictures agree within 4 ULP of the largest value, because the same keys draw the
    noise."""
    hole = s.Pinhole([0, 0, 3], DOWN, 0.05, 0.002, resolution=(8, 8), f_number=2.0)
    camera = replace(CAMERA, view=hole)
    full = capture(KEY, SCENE, camera, die_key=DIE)
    less = capture(KEY, SCENE, camera, die_key=DIE, tolerance="0DN")
    ulp = np.spacing(np.asarray(full.raw).max())
    assert np.abs(np.asarray(less.raw) - np.asarray(full.raw)).max() <= 4 * ulp
    assert less.certificate.total == 0
    assert full.certificate is None


@pytest.mark.slow
def test_dropped_effects_change_frames_by_at_most_the_bound():
    """The mean and the standard deviation of every pixel are compared over 400 frames, full and
    pruned."""
    camera = replace(
        CAMERA, view=s.Orthographic([0, 0, 3], DOWN, 0.2, resolution=(8, 8), f_number=2.0)
    )
    pruned = effects.prune(SCENE, camera, "0.5DN")
    assert "sensor.dsnu" in {effect.name for effect in pruned.certificate.dropped}
    keys = jax.random.split(KEY, 400)

    def frames(scene, camera):
        return jax.jit(jax.vmap(lambda k: capture(k, scene, camera, die_key=DIE).raw))(keys)

    one, two = (np.asarray(frames(*x)) for x in ((SCENE, camera), (pruned.scene, pruned.camera)))
    error = 5 * one.std(0).max() / 20
    assert np.abs(one.mean(0) - two.mean(0)).max() <= pruned.certificate.total + error
    assert np.abs(one.std(0) - two.std(0)).max() <= pruned.certificate.total + error


def equations(sensor):
    image = jnp.ones((*SHAPE, 1))
    found = primitives(lambda x: raw_image(KEY, x, image, die_key=DIE), sensor)
    return sum(found.values())


@pytest.mark.parametrize("seeds", [range(1), pytest.param(range(40), marks=pytest.mark.slow)])
def test_a_pruned_sensor_is_never_a_larger_program(seeds):
    """Random sensors have fewer equations if anything is dropped, and as many otherwise."""
    for seed in seeds:
        sensor, _, light, rng = draw(seed)
        rows, response = sensor_stage(Ends(sensor, sensor), np.array([light.max()]), shape=SHAPE)
        view = s.Orthographic(np.zeros(3), np.eye(3), 1.0, resolution=SHAPE)
        draft, gone = Draft((), (), frozenset(), None, s.Camera(view, sensor)), frozenset()
        for row in rows:
            proved = row.drop is not None and row.effect.rank != "estimate"
            if not (proved and row.needs <= gone):
                continue
            if row.after(gone) <= rng.choice([0.1, 1.0]) * response.dark:
                draft, gone = row.drop(draft), gone | {row.effect.name}
        less, full = equations(draft.camera.sensor), equations(sensor)
        assert less < full if gone else less == full


@pytest.mark.slow
def test_effects_that_change_nothing_are_left_out_by_default(monkeypatch):
    """In a known scene where a search is cheap, the dark lamp, a factor of 1 and zeros are left
    out."""
    view = replace(jv.Orthographic([0, 0, 3], DOWN, 0.05, resolution=(8, 8)), f_number=2.0)
    camera = replace(CAMERA, view=view)
    whole = capture(KEY, SCENE, camera, die_key=DIE)
    assert whole.certificate is None  # a search would take longer than so few pixels
    monkeypatch.setattr("jaxvision.shot.looking_pays", lambda *_, **__: True)
    less = capture(KEY, SCENE, camera, die_key=DIE)
    gone = {effect.name for effect in less.certificate.dropped}
    assert gone >= {"lights[1]", "sensor.prnu", "sensor.gain"}
    assert less.certificate.total == 0
    for name in ("radiance", "irradiance", "raw"):
        np.testing.assert_array_equal(getattr(less, name), getattr(whole, name))
    assert capture(KEY, SCENE, camera, die_key=DIE, keep_all=True).certificate is None
    traced = jax.jit(lambda scene: capture(KEY, scene, camera, die_key=DIE).raw)(SCENE)
    np.testing.assert_allclose(traced, whole.raw, rtol=1e-6)
