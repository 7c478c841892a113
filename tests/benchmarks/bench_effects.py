"""Time each optional effect as it is, pruned, and in a scene without it.

pytest -m benchmark --benchmark-enable -s tests/benchmarks/bench_effects.py
"""

import time
from dataclasses import replace
from functools import partial

import bench_direct_light
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import cornell_box
from oracles.random_scenes import random_scene
from turns import in_turns

import jaxvision as jv
from jaxvision import effects
from jaxvision.lights.rectangle import _small_light as small_light

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


FOUR = [jv.PointLight([x, y, 2], [0.3] * 3) for x in (-0.4, 0.4) for y in (-0.4, 0.4)]


def room(lights, material=GREY):
    return jv.Scene([jv.Surface(shape, material) for shape in ROOM], lights)


def smooth(bands):
    """Return a scene of three lamps and glossy walls whose spectra are straight lines."""
    w = np.linspace(0, 1, bands)
    walls = [
        jv.Surface(q, jv.Phong(0.1 + 0.1 * k * w, 0.05 + 0 * w, 20.0))
        for k, q in enumerate(ROOM[:3])
    ]
    lamps = [jv.PointLight([x, 0, 2], 1 + 0.5 * w) for x in (-0.5, 0.2, 0.6)]
    return jv.Scene(walls, lamps)


FAR = jv.RectangleLight([-0.5, -0.5, 90], [0, 1, 0], [1, 0, 0], [8000.0] * 3)
DARK = jv.PointLight([0.5, 0, 2], [0.0] * 3)
FINE = 1024  # a third of a small picture's time passes before its first pixel
# name: (the scene, the same scene without the effect, least share of time that is saved, pixels
# along each side)
CASES = {
    "31 smooth bands": (smooth(31), smooth(3), 8.0, FINE),
    "far lamp, order 8": (
        replace(room(FAR), occluders=()),
        replace(room(small_light(FAR)), occluders=()),
        30.0,
        SIDE,
    ),
    "shadows in a convex room": (room(POINT), replace(room(POINT), occluders=()), 1.4, FINE),
    "lamp without power": (
        replace(room([POINT, DARK]), occluders=()),
        replace(room(POINT), occluders=()),
        1.1,
        FINE,
    ),
    "shadows of four lamps in a convex room": (
        room(FOUR),
        replace(room(FOUR), occluders=()),
        1.4,
        FINE,
    ),
    **{
        f"{name} of 0": (
            replace(room(POINT, material), occluders=()),
            replace(room(POINT), occluders=()),
            1.05,
            FINE,
        )
        for name, material in (
            ("lobe", jv.Phong([0.25] * 3, [0.0] * 3, 9.0)),
            ("facets", jv.TorranceSparrow([0.25] * 3, [0.0] * 3, 0.3)),
            ("roughness", jv.OrenNayar([0.25] * 3, 0.0)),
        )
    },
}


def of_side(view, side):
    """Return a square view of the same scene with `side` pixels along each side."""
    scale = max(view.resolution) / side
    return replace(view, resolution=(side, side), pixel_pitch=view.pixel_pitch * scale)


def drawn(scene, view, expand=None):
    compiled = jax.jit(jv.render)
    table = None if expand is None else jnp.asarray(expand.T, jnp.float32)
    whole = jv.as_dtype((scene, view), jnp.float32)
    if table is None:
        return lambda: compiled(*whole)
    join = jax.jit(jnp.matmul)
    return lambda: join(compiled(*whole), table)


@pytest.mark.parametrize("name", CASES)
def test_pruned_effects_cost_no_time(name):
    scene, never, least, side = CASES[name]
    pruned = effects.prune(scene, VIEW, "0.1%", level=float(jv.render(scene, VIEW).max()))
    view = of_side(VIEW, side)
    rivals = {
        "with": drawn(scene, view),
        "pruned": drawn(pruned.scene, view),
        "never there": drawn(never, view),
    }
    if pruned.expand is not None:
        rivals["pruned, all bands"] = drawn(pruned.scene, view, pruned.expand)
    _, seconds = in_turns(rivals, rounds=ROUNDS)
    counts = [effects.equations(own, VIEW) for own in (scene, pruned.scene, never)]
    for (rival, taken), count in zip(seconds.items(), [*counts, counts[1]], strict=False):
        print(f"{name}: {rival:17} {1e3 * taken:8.2f} ms  {count} equations")
    print(f"{name}: saves x{seconds['with'] / seconds['pruned']:.2f}; {pruned.certificate.total:g}")
    assert seconds["with"] >= least * seconds["pruned"]
    assert counts[1] <= counts[0]


def of_processor(call):
    """Return the processor time of a call in s. The load of a machine can lengthen it, but never
    shortens it."""
    start = time.process_time()
    call()
    return time.process_time() - start


@pytest.mark.parametrize(
    ("surfaces", "depth", "allowed"), [(15, None, 0.5), (300, None, 1.0), (1000, 6, 4.0)]
)
def test_inspection_is_quick(surfaces, depth, allowed):
    rng = np.random.default_rng(0)
    balls = [
        jv.Surface(jv.Sphere(c, 0.02), jv.Phong([0.1] * 3, [0.1] * 3, 20.0))
        for c in rng.uniform([-1, -1, 0.1], [1, 1, 1], (surfaces - 5, 3))
    ]
    scene = room([POINT, FAR, DARK])
    scene = replace(scene, surfaces=(*scene.surfaces, *balls))
    effects.inspect(scene, VIEW, depth=depth)
    taken = min(of_processor(lambda: effects.inspect(scene, VIEW, depth=depth)) for _ in range(3))
    print(f"inspect, {surfaces} surfaces, 3 lights: {taken:.3f} s of the processor")
    assert taken <= allowed


def shipped(name):
    source = jv.files.scenes.read_scene(name)
    return source.scene, source.view


def lamp_over_a_floor():
    rotation = jv.look_at(jnp.array([0.0, 3.0, 5.0]), jnp.zeros(3), jnp.array([0.0, 1, 0]))
    pitch = 2 * np.tan(np.radians(40.0) / 2) / 512
    view = jv.Pinhole([0, 3.0, 5.0], rotation, 1.0, pitch, resolution=(512, 512))
    lamp = jv.RectangleLight([-0.6, 1.5, -0.4], [1.2, 0, 0], [0, 0, 0.8], [10.0])
    floor = jv.Surface(jv.Plane([0, 0, 0], [0, 1, 0]), jv.Lambert([0.5 / np.pi]))
    return jv.as_dtype((jv.Scene([floor], [lamp]), view), jnp.float32)


SCENES = {
    **{name: partial(shipped, name) for name in jv.files.scenes.shipped_scenes()},
    "cornell box whose lamp emits": lambda: (
        jv.as_dtype(cornell_box.scene(emissive_surface=True), jnp.float32),
        shipped("cornell_box")[1],
    ),
    "balls on a plane": bench_direct_light.ours,
    "lamp over a floor": lamp_over_a_floor,
    **{f"random {seed}": partial(random_scene, seed) for seed in (1, 8, 20, 27)},
}


def program_of(scene, view):
    """Return the program's text before XLA compiles it, which identifies it."""
    return jax.jit(jv.render).lower(scene, view).as_text()


def all_bands(compiled, pruned, view):
    """Return a call that renders the pruned scene in the bands of the whole scene."""
    if pruned.expand is None:
        return partial(compiled, pruned.scene, view)
    dtype = jax.eval_shape(compiled, pruned.scene, view).dtype
    join, table = jax.jit(jnp.matmul), jnp.asarray(pruned.expand.T, dtype)
    return lambda: join(compiled(pruned.scene, view), table)


@pytest.mark.parametrize("name", SCENES)
def test_pruned_effects_are_never_slower(name):
    """Pruning makes a picture at most 3 % slower. Where nothing traced can be pruned, the program
    is the same."""
    scene, view = SCENES[name]()
    view, compiled = of_side(view, SIDE), jax.jit(jv.render)
    known, rivals = {program_of(scene, view)}, {"with": partial(compiled, scene, view)}
    whole = effects.equations(scene, view)
    for tolerance, level in (("0%", 1.0), ("1%", None)):
        pruned = effects.prune(scene, view, tolerance, level=level)
        count = effects.equations(pruned.scene, view)
        print(f"{name}, {tolerance}: {len(pruned.certificate.dropped)} gone, {whole} {count}")
        assert count <= whole
        program = program_of(pruned.scene, view)
        if program not in known:
            known.add(program)
            rivals[tolerance] = all_bands(compiled, pruned, view)
    if len(rivals) == 1:
        return
    _, seconds = in_turns(rivals, rounds=3 * ROUNDS)  # 11 rounds cannot resolve 3 %
    for tolerance in (rival for rival in rivals if rival != "with"):
        print(f"{name}, {tolerance}: x{seconds['with'] / seconds[tolerance]:.3f}")
        assert seconds[tolerance] <= 1.03 * seconds["with"]


@pytest.mark.parametrize("name", jv.files.scenes.shipped_scenes())
def test_paths_of_a_shipped_scene_are_followed_by_the_same_program(name):
    """The shipped scene's own settings allow nothing to be pruned at 1 %, so the program must be
    the same."""
    source = jv.files.scenes.read_scene(name)
    depth = source.render.depth
    pruned = effects.prune(source.scene, source.view, "1%", level=1.0, depth=depth)
    assert pruned.depth == depth
    assert jax.tree.structure(pruned.scene) == jax.tree.structure(source.scene)
    for left, whole in zip(
        jax.tree.leaves(pruned.scene), jax.tree.leaves(source.scene), strict=True
    ):
        np.testing.assert_array_equal(left, whole)
