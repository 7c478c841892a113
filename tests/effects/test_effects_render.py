"""Tests pruned scenes in `render`: the promised error, equality at tolerance 0, and smaller
programs."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from oracles.direct_light import picture
from oracles.random_scenes import random_scene

import jaxvision as jv
from jaxvision import effects
from jaxvision.effects.stages import FAST

GREY = jv.Lambert([0.25])
FLOOR = jv.Surface(jv.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0]), GREY)
DOWN = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
VIEW = jv.Pinhole([0, 0, 3], DOWN, 0.05, 0.05 / 16, resolution=(16, 16))
POINT = jv.PointLight([0, 0, 2], [1.0])


def primitives(scene):
    return str(jax.make_jaxpr(jv.render)(scene, VIEW))


def pruned(scene, tolerance="1%"):
    return effects.prune(scene, VIEW, tolerance, level=1.0)


@pytest.mark.slow
def test_dropped_effects_leave_nothing_in_the_program():
    """There is no search without occluders, no exponential without a lobe, and one band instead of
    equal ones."""
    ramp = np.linspace(0.1, 1, 31)
    glossy = jv.Surface(FLOOR.shape, jv.GaussianLobe(0.1 * ramp, 1e-9 * ramp, 5.0))
    second = jv.Surface(jv.Sphere([0, 0, 9], 0.1), jv.Lambert(0.1 * ramp))
    scene = jv.Scene([glossy, second], jv.PointLight([0, 0, 2], 0 * ramp + 1))
    left = pruned(scene)
    before, after = primitives(scene), primitives(left.scene)
    assert " exp " in before
    assert " exp " not in after
    assert left.scene.occluders == ()
    assert left.scene.lights[0].intensity.shape == (1,)
    assert effects.equations(left.scene, VIEW) < 0.6 * effects.equations(scene, VIEW)


def test_10_the_cost_of_a_loop_is_not_the_flops_of_xla():
    """XLA counts the body of a loop once, however often it runs."""

    def looped(times):
        compiled = jax.jit(lambda x: jax.lax.fori_loop(0, times, lambda _, y: y * y + 1, x))
        return compiled.lower(1.0).compile().cost_analysis()["flops"]

    assert looped(2) == looped(200)
    camera = jv.Camera(VIEW, jv.Sensor(exposure_time=1.0))
    still = effects.prune(
        jv.Scene(FLOOR, POINT), camera, "0DN", motion=lambda s, v, t: (s, v), moments=50
    )
    gone = {effect.name: effect.saves for effect in still.certificate.dropped}
    assert still.moments is None
    assert gone["motion"] >= 0.7
    assert still.certificate.saves >= gone["motion"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20))
def test_random_scenes_through_render(seed):
    scene, view = random_scene(seed)
    full = np.asarray(jax.jit(jv.render)(scene, view))
    if not full.max() > 0:
        return
    left = effects.prune(scene, view, effects.Tolerance(1e-2), level=full.max())
    small = np.asarray(jax.jit(jv.render)(left.scene, left.camera))
    if left.expand is not None:
        small = small @ left.expand.T
    assert np.abs(small - full).max() <= (left.certificate.total + 1e-12) * full.max()
    count, before = (effects.equations(s, view) for s in (left.scene, scene))
    assert count <= before
    if all(
        isinstance(x, jv.PointLight | jv.SmallLight | jv.DirectionalLight) for x in scene.lights
    ):
        drawn = picture(*jax.tree.map(np.asarray, (scene, view)))
        edges = np.abs(drawn - full).max(-1) > 1e-9 * full.max()
        assert edges.mean() <= 0.02  # edge pixels, whose rays differ by rounding


def differing_at_0(seed, options):
    """Return the difference, in ULP of the largest value, after dropping provably idle effects."""
    scene, view = random_scene(seed)
    left = effects.prune(scene, view, effects.Tolerance(0.0, place=0), level=1.0)
    assert all(effect.rank == "exact" for effect in left.certificate.dropped)
    drawn = jax.jit(jv.render, compiler_options=options)
    full, small = np.asarray(drawn(scene, view)), np.asarray(drawn(left.scene, left.camera))
    if left.expand is not None:
        small = small @ left.expand.T
    return np.abs(small - full).max() / np.spacing(full.max())


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20, 30))
def test_tolerance_0_changes_nothing(seed):
    """The programs round every operation separately."""
    assert differing_at_0(seed, FAST) <= 4


def test_hundreds_of_surfaces_are_inspected_at_once():
    rng = np.random.default_rng(0)
    balls = [
        jv.Surface(jv.Sphere(c, 0.02), jv.Phong([0.1], [0.1], 20.0))
        for c in rng.uniform([-1, -1, 0], [1, 1, 1], (150, 3))
    ]
    scene = jv.Scene([FLOOR, *balls], [POINT, replace(POINT, position=[1.0, 1, 3])])
    found = effects.inspect(scene, VIEW)
    assert len(found) == 2 * 2 + 150 + 1


@pytest.mark.slow
def test_a_lobe_is_dropped_unless_its_surface_then_needs_its_own_program():
    """Lambert and Phong together need one program more than Phong alone."""
    dull, shiny = (jv.Phong([0.2], [specular], 20.0) for specular in (0.0, 0.1))
    walls = [jv.Quad([x, -1, 0], [1, 0, 0], [0, 2, 0]) for x in (-1.0, 0.0)]
    left, right = (jv.Surface(wall, dull) for wall in walls)
    for surfaces, gone in (
        ((left, replace(right, material=shiny)), 0),
        ((left, right), 2),
        ((left, replace(right, material=shiny), replace(right, material=GREY)), 1),
    ):
        scene = jv.Scene(surfaces, [POINT])
        found = pruned(scene, "0%")
        assert sum("specular" in one.name for one in found.certificate.dropped) == gone
        assert effects.equations(found.scene, VIEW) <= effects.equations(scene, VIEW)
    parted = pruned(jv.Scene((left, replace(right, material=shiny)), [POINT]), "0%")
    assert any("a program of its own" in one.why for one in parted.certificate.kept)
