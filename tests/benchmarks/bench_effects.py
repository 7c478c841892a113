"""What leaving out saves: each effect as it is, pruned, and where it was never there.

pytest -m benchmark --benchmark-enable -s tests/benchmarks/bench_effects.py
"""

import time
from dataclasses import replace
from functools import partial

import bench_area_light
import bench_direct_light
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles.random_scenes import random_scene
from turns import in_turns

import jaxvision as jv
from jaxvision import effects
from jaxvision.effects.extent import small_light

pytestmark = pytest.mark.benchmark

SIDE, ROUNDS = 256, 11
DOWN = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
VIEW = jv.Pinhole([0, 0, 3], DOWN, 0.05, 0.05 / SIDE, resolution=(SIDE, SIDE))
FLOOR = jv.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0])
GREY = jv.Lambert([0.25] * 3)
POINT = jv.PointLight([0.2, 0, 2], [1.0] * 3)
ROOM = [
    FLOOR,
    jv.Quad([-1, -1, 0], [0, 2, 0], [0, 0, 4]),
    jv.Quad([1, -1, 0], [0, 0, 4], [0, 2, 0]),
    jv.Quad([-1, -1, 0], [0, 0, 4], [2, 0, 0]),
    jv.Quad([-1, 1, 0], [2, 0, 0], [0, 0, 4]),
]


def room(lights, material=GREY):
    return jv.Scene([jv.Surface(shape, material) for shape in ROOM], lights)


def smooth(bands):
    """Three lamps and glossy walls whose spectra are straight lines."""
    w = np.linspace(0, 1, bands)
    walls = [
        jv.Surface(q, jv.Phong(0.1 + 0.1 * k * w, 0.05 + 0 * w, 20.0))
        for k, q in enumerate(ROOM[:3])
    ]
    lamps = [jv.PointLight([x, 0, 2], 1 + 0.5 * w) for x in (-0.5, 0.2, 0.6)]
    return jv.Scene(walls, lamps)


FAR = jv.RectangleLight([-0.5, -0.5, 90], [0, 1, 0], [1, 0, 0], [8000.0] * 3)
DARK = jv.PointLight([0.5, 0, 2], [0.0] * 3)
# name: (the scene, the same where the effect was never there, least share of time that is saved)
CASES = {
    "31 smooth bands": (smooth(31), smooth(3), 8.0),
    "far lamp, order 8": (
        replace(room(FAR), occluders=()),
        replace(room(small_light(FAR)), occluders=()),
        30.0,
    ),
    "shadows in a convex room": (room(POINT), replace(room(POINT), occluders=()), 1.4),
    "lamp without power": (
        replace(room([POINT, DARK]), occluders=()),
        replace(room(POINT), occluders=()),
        1.1,
    ),
    "lobe of weight 0": (
        replace(room(POINT, jv.Phong([0.25] * 3, [0.0] * 3, 9.0)), occluders=()),
        replace(room(POINT), occluders=()),
        1.05,
    ),
}


def drawn(scene, expand=None):
    compiled = jax.jit(jv.render)
    table = None if expand is None else jnp.asarray(expand.T, jnp.float32)
    whole = jv.as_dtype((scene, VIEW), jnp.float32)
    if table is None:
        return lambda: compiled(*whole)
    join = jax.jit(jnp.matmul)
    return lambda: join(compiled(*whole), table)


@pytest.mark.parametrize("name", CASES)
def test_what_is_left_out_is_not_paid_for(name):
    scene, never, least = CASES[name]
    pruned = effects.prune(scene, VIEW, "0.1%", level=float(jv.render(scene, VIEW).max()))
    rivals = {
        "with": drawn(scene),
        "pruned": drawn(pruned.scene),
        "never there": drawn(never),
    }
    if pruned.expand is not None:
        rivals["pruned, all bands"] = drawn(pruned.scene, pruned.expand)
    _, seconds = in_turns(rivals, rounds=ROUNDS)
    counts = [effects.equations(own, VIEW) for own in (scene, pruned.scene, never)]
    for (rival, taken), count in zip(seconds.items(), [*counts, counts[1]], strict=False):
        print(f"{name}: {rival:17} {1e3 * taken:8.2f} ms  {count} equations")
    print(f"{name}: saves x{seconds['with'] / seconds['pruned']:.2f}; {pruned.certificate.total:g}")
    assert seconds["with"] >= least * seconds["pruned"]
    assert counts[1] <= counts[0]


@pytest.mark.parametrize(("surfaces", "allowed"), [(15, 0.5), (300, 1.0)])
def test_inspection_is_quick(surfaces, allowed):
    rng = np.random.default_rng(0)
    balls = [
        jv.Surface(jv.Sphere(c, 0.02), jv.Phong([0.1] * 3, [0.1] * 3, 20.0))
        for c in rng.uniform([-1, -1, 0.1], [1, 1, 1], (surfaces - 5, 3))
    ]
    scene = room([POINT, FAR, DARK])
    scene = replace(scene, surfaces=(*scene.surfaces, *balls))
    effects.inspect(scene, VIEW)
    start = time.process_time()
    effects.inspect(scene, VIEW)
    taken = time.process_time() - start
    print(f"inspect, {surfaces} surfaces, 3 lights: {taken:.3f} s of the processor")
    assert taken <= allowed


def shipped(name):
    source = jv.scene_files.read_scene(name)
    return source.scene, source.view


SCENES = {
    **{name: partial(shipped, name) for name in jv.scene_files.shipped_scenes()},
    "balls on a plane": bench_direct_light.ours,
    "lamp over a floor": lambda: bench_area_light.scene_and_view(jnp.float32),
    **{f"random {seed}": partial(random_scene, seed) for seed in (1, 8, 20, 27)},
}


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("tolerance", ["0%", "1%"])
def test_what_is_pruned_is_never_slower(name, tolerance):
    """By at most 3 %; where nothing may go it is the same program."""
    scene, view = SCENES[name]()
    scale = max(view.resolution) / SIDE
    view = replace(view, resolution=(SIDE, SIDE), pixel_pitch=view.pixel_pitch * scale)
    pruned = effects.prune(scene, view, tolerance)
    counts = [effects.equations(own, view) for own in (scene, pruned.scene)]
    print(f"{name}, {tolerance}: {len(pruned.certificate.dropped)} gone, {counts} equations")
    assert counts[1] <= counts[0]
    if jax.tree.structure(pruned.scene) == jax.tree.structure(scene) and counts[0] == counts[1]:
        return
    compiled = jax.jit(jv.render)
    rivals = {
        "with": lambda: compiled(scene, view),
        "pruned": lambda: compiled(pruned.scene, view),
    }
    _, seconds = in_turns(rivals, rounds=ROUNDS)
    print(f"{name}, {tolerance}: x{seconds['with'] / seconds['pruned']:.3f}")
    assert seconds["pruned"] <= 1.03 * seconds["with"]
