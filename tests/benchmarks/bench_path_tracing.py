"""The Cornell box by path tracing against Mitsuba 3 (`llvm_ad_rgb`, `path`): 256 x 256 pixels, 64
samples, up to 6 pieces, no roulette, float32. Both against a reference of 4096 samples by Mitsuba,
so that speed is compared at the error that each has; and the compile times of the picture and of
a gradient in all albedos.

    pytest tests/benchmarks/bench_path_tracing.py -m benchmark -s

Mitsuba needs `DRJIT_LIBLLVM_PATH`, see its documentation.
"""

import time
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import cornell_box
from scipy.ndimage import binary_dilation
from turns import in_turns

from jaxvision import as_dtype
from jaxvision.transport import Paths, path_traced

SIDE, SAMPLES, DEPTH, ROUNDS = 256, 64, 6, 7


def mitsuba_scene(mi):
    """The same parallelograms, colours, lamp and camera."""
    to_world = mi.ScalarTransform4f
    fov = float(np.degrees(2 * np.arctan(cornell_box.FILM / 2 / cornell_box.FOCAL_LENGTH)))
    description = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": DEPTH, "rr_depth": 1000},
        "sensor": {
            "type": "perspective",
            "fov": fov,
            "to_world": to_world().look_at(cornell_box.EYE, cornell_box.TARGET, cornell_box.UP),
            "sampler": {"type": "independent", "sample_count": SAMPLES},
            "film": {
                "type": "hdrfilm",
                "width": SIDE,
                "height": SIDE,
                "rfilter": {"type": "box"},
                "pixel_format": "rgb",
                "component_format": "float32",
            },
        },
    }
    faces = [*cornell_box.FACES, cornell_box.LAMP]
    for i, ((corner, u, v), colour) in enumerate(
        zip(faces, [*cornell_box.ALBEDOS, (0, 0, 0)], strict=True)
    ):
        matrix = np.eye(4)
        normal = np.cross(u, v)
        matrix[:3] = np.stack(
            [u / 2, v / 2, normal / np.linalg.norm(normal), corner + u / 2 + v / 2], axis=1
        )
        reflectance = {"type": "rgb", "value": [float(c) for c in colour]}
        face = {
            "type": "rectangle",
            "to_world": to_world(matrix.tolist()),
            "bsdf": {"type": "diffuse", "reflectance": reflectance},
        }
        if i == len(faces) - 1:
            radiance = {"type": "rgb", "value": list(cornell_box.RADIANCE)}
            face["emitter"] = {"type": "area", "radiance": radiance}
        description[f"face{i}"] = face
    return mi.load_dict(description)


def compiled(strategy, scene, view):
    """The picture as a function of a key, and the seconds of tracing and compiling."""
    method = Paths(SAMPLES, DEPTH, strategy=strategy)
    start = time.perf_counter()
    call = (
        jax.jit(partial(path_traced, method=method)).lower(jax.random.key(0), scene, view).compile()
    )
    return (lambda key: call(key, scene, view).radiance), time.perf_counter() - start


def gradient_seconds(scene, view):
    """Tracing and compiling the gradient of a mean picture in all materials."""
    method = Paths(4, DEPTH, strategy="lights")

    def mean(scene):
        return path_traced(jax.random.key(0), scene, view, method=method).radiance.mean()

    start = time.perf_counter()
    call = jax.jit(jax.grad(mean)).lower(scene).compile()
    seconds = time.perf_counter() - start
    gradient = call(scene)
    assert all(jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))
    return seconds


@pytest.mark.benchmark
def test_cornell_box():
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    peer = mitsuba_scene(mi)
    scene = as_dtype(cornell_box.scene(emissive_surface=True), jnp.float32)
    view = as_dtype(cornell_box.view(SIDE), jnp.float32)
    seeds = iter(range(1, 100000))

    def mitsuba(samples=SAMPLES):
        return np.asarray(mi.render(peer, spp=samples, seed=next(seeds)))

    reference = np.mean([mitsuba(512) for _ in range(8)], axis=0)
    # all but the lamp and its edge, whose pixels differ by where a sample falls, hundredfold
    unlit = ~binary_dilation(reference.max(axis=-1) > 2, iterations=2)

    def error(picture):
        apart = (np.asarray(picture) - reference)[unlit]
        return np.sqrt(np.mean(apart**2)) / reference[unlit].mean()

    rivals, compile_seconds = {"Mitsuba path": mitsuba}, {}
    for strategy in ("lights", "balance"):
        picture, compile_seconds[strategy] = compiled(strategy, scene, view)
        rivals[f"ours, {strategy}"] = lambda run=picture: run(jax.random.key(next(seeds)))
    errors = {}
    for name, run in rivals.items():
        mean = np.mean([np.asarray(run())[unlit].mean(axis=0) for _ in range(4)], axis=0)
        np.testing.assert_allclose(mean, reference[unlit].mean(axis=0), rtol=5e-3, err_msg=name)
        errors[name] = np.mean([error(run()) for _ in range(4)])
    _, seconds = in_turns(rivals, rounds=ROUNDS)
    best = "Mitsuba path"
    print(f"\n{'':16s}{'s':>8s}{'rel. RMSE':>12s}{'times faster':>14s}{'at equal error':>16s}")
    for name, taken in seconds.items():
        faster = seconds[best] / taken
        equal = faster * (errors[best] / errors[name]) ** 2
        print(f"{name:16s}{taken:8.2f}{errors[name]:12.4f}{faster:14.2f}{equal:16.2f}")
    for strategy, taken in compile_seconds.items():
        print(f"compiled {strategy}: {taken:.2f} s")
    print(f"compiled gradient: {gradient_seconds(scene, view):.2f} s")
