"""Tests bounds of lamps and of the sun in random scenes against a NumPy oracle."""

from dataclasses import replace

import numpy as np
import pytest
from oracles.direct_light import bands_of
from oracles.random_scenes import random_scene
from test_effects import ROUNDING, drawn, only

import jaxvision as jv
from jaxvision import effects
from jaxvision.effects.radiance import scene_stage
from jaxvision.effects.stages import Draft, Ends

SOME = [range(3), *(pytest.param(range(k, k + 10), marks=pytest.mark.slow) for k in (3, 13, 23))]


def lamp_scene(seed):
    """Return a random scene lit by two spots and two goniometric lamps, some of them dim."""
    scene, view = random_scene(seed)
    rng = np.random.default_rng(seed)
    lamps = []
    for kind in ("smoothstep", "linear", "measured", "measured"):
        place = rng.uniform([-0.9, -0.95, -2.5], [0.9, -0.5, -0.5])
        power = 10 ** rng.uniform(-3, 0.5) * rng.uniform(0.2, 1, bands_of(scene))
        if kind != "measured":
            inner, outer = np.sort(rng.uniform(0.05, 1.2, 2))
            axis = rng.normal([0, 1, 1], 0.5)
            lamps.append(jv.SpotLight(place, axis, power, inner, outer, falloff=kind))
            continue
        gamma = np.linspace(0, rng.choice([np.pi / 2, np.pi]), 5)
        planes = np.linspace(0, 2 * np.pi, 7)
        table = rng.uniform(0, 1, (5, 7)) * (rng.random((5, 7)) > 0.3)
        table[:, -1] = table[:, 0]
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        turn *= np.sign(np.linalg.det(turn))
        lamps.append(jv.GoniometricLight(place, power, table, gamma, planes, turn))
    return replace(scene, lights=tuple(lamps)), view


def sun_scene(seed):
    """A random scene under two suns of 0.3 to 17 degrees and two lamps with luminous openings."""
    scene, view = random_scene(seed)
    rng = np.random.default_rng(seed)
    bands, lights = bands_of(scene), []
    for _ in range(2):
        toward, radius = rng.normal([0, -1, -0.5], 0.6), 10 ** rng.uniform(-2.3, -0.5)
        irradiance = 10 ** rng.uniform(-3, 0.5) * rng.uniform(0.2, 1, bands)
        lights.append(jv.SunDisc(toward, irradiance, radius))
    for _ in range(2):
        corner = rng.uniform([-0.9, -0.95, -2.5], [0.9, -0.5, -0.5])
        turn, sides = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.uniform(0.05, 0.5, 2)
        turn[1] *= np.sign(np.cross(turn[0], turn[1]) @ [0, 1, 0.5])  # downward
        table = np.append(rng.uniform(0, 1, (4, 1)), [[0]], axis=0)
        power = 10 ** rng.uniform(-3, 0.5) * rng.uniform(0.2, 1, bands)
        edges = sides[0] * turn[0], sides[1] * turn[1]
        nodes = table, np.linspace(0, np.pi / 2, 5), [0.0]
        lights.append(jv.GoniometricAreaLight(corner, *edges, power, *nodes))
    return replace(scene, lights=tuple(lights)), view


@pytest.mark.slow
@pytest.mark.parametrize("make", [lamp_scene, sun_scene])
@pytest.mark.parametrize("seeds", SOME)
def test_each_lamp_alone_and_a_pruned_scene_keep_their_bounds(make, seeds):
    changed = 0
    for seed in seeds:
        scene, view = make(seed)
        full, ends = drawn(scene, view), (Ends(scene, scene), Ends(view, view))
        camera = jv.Camera(view, jv.Sensor())
        draft = Draft(scene.surfaces, scene.lights, frozenset(), scene.ambient, camera)
        for row in scene_stage(*ends)[0]:
            if row.drop is None or not row.effect.present or row.together == "shadows":
                continue
            change = np.abs(drawn(only(scene, draft, row), view) - full).max()
            assert change <= row.effect.bound * (1 + 1e-9) + ROUNDING * full.max(), row.effect.name
            changed += change > 0
        if full.max() > 0:
            pruned = effects.prune(scene, view, effects.Tolerance(0.02), level=full.max())
            error = np.abs(drawn(pruned.scene, pruned.camera, pruned.expand) - full).max()
            promised = pruned.certificate.total * full.max()
            assert error <= promised * (1 + 1e-9) + ROUNDING * full.max(), f"seed {seed}"
    assert changed >= len(seeds)


@pytest.mark.slow
@pytest.mark.parametrize("make", [lamp_scene, sun_scene])
@pytest.mark.parametrize("seed", range(3))
def test_the_oracle_draws_what_the_library_renders(make, seed):
    """A wrong oracle might satisfy any bound."""
    scene, view = make(seed)
    wanted = drawn(scene, view)
    off = np.abs(np.asarray(jv.render(scene, view)) - wanted)
    # except outlines of shadows, and the nodes of suns and openings, which differ
    assert np.quantile(off, 0.98) <= (1e-4 if make is lamp_scene else 0.02) * wanted.max()
    assert np.median(off) <= 1e-3 * wanted.max()
