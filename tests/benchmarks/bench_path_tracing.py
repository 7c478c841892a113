"""Compare path tracing of the Cornell box with Mitsuba 3 (`llvm_ad_rgb`, `path`).

    pytest tests/benchmarks/bench_path_tracing.py -m benchmark -s

Both render 256 x 256 pixels with 64 samples of up to 6 segments, without roulette, in float32.
Times are compared at equal error, measured against a reference of 2048 samples by Mitsuba. Mitsuba
needs `DRJIT_LIBLLVM_PATH`, see its documentation."""

import time
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mitsuba_scenes import mitsuba, mitsuba_cornell_box
from oracles import cornell_box
from scipy.ndimage import binary_dilation
from turns import in_turns

from jaxvision import as_dtype
from jaxvision.transport import Paths, path_traced

SIDE, SAMPLES, DEPTH, ROUNDS = 256, 64, 6, 7


def compiled(strategy, scene, view):
    """Return the picture as a function of a key, and the seconds of tracing and compiling."""
    method = Paths(SAMPLES, DEPTH, strategy=strategy)
    start = time.perf_counter()
    call = (
        jax.jit(partial(path_traced, method=method)).lower(jax.random.key(0), scene, view).compile()
    )
    return (lambda key: call(key, scene, view).radiance), time.perf_counter() - start


@pytest.mark.benchmark
def test_cornell_box():
    mi = mitsuba()
    path = {"type": "path", "max_depth": DEPTH, "rr_depth": 1000}
    peer = mitsuba_cornell_box(mi, side=SIDE, integrator=path)
    scene = as_dtype(cornell_box.scene(emissive_surface=True), jnp.float32)
    view = as_dtype(cornell_box.view(SIDE), jnp.float32)
    seeds = iter(range(1, 100000))

    def theirs(samples=SAMPLES):
        return np.asarray(mi.render(peer, spp=samples, seed=next(seeds)))

    reference = np.mean([theirs(512) for _ in range(4)], axis=0)
    # all but the lamp and its edge, whose pixels vary a hundredfold with the positions of samples
    unlit = np.logical_not(binary_dilation(reference.max(axis=-1) > 2, iterations=2))

    def with_next_key(picture):
        return picture(jax.random.key(next(seeds)))

    def error(picture):
        apart = (np.asarray(picture) - reference)[unlit]
        return np.sqrt(np.mean(apart**2)) / reference[unlit].mean()

    rivals: dict[str, Callable[[], object]] = {"Mitsuba path": theirs}
    compile_seconds = {}
    for strategy in ("lights", "balance"):
        picture, compile_seconds[strategy] = compiled(strategy, scene, view)
        rivals[f"ours, {strategy}"] = partial(with_next_key, picture)
    errors = {}
    for name, run in rivals.items():
        pictures = [np.asarray(run()) for _ in range(4)]
        mean = np.mean([picture[unlit].mean(axis=0) for picture in pictures], axis=0)
        np.testing.assert_allclose(mean, reference[unlit].mean(axis=0), rtol=5e-3, err_msg=name)
        errors[name] = float(np.mean([error(picture) for picture in pictures]))
    _, seconds = in_turns(rivals, rounds=ROUNDS, errors=errors, settled=0)
    best = "Mitsuba path"
    print(f"\n{'':16s}{'s':>8s}{'rel. RMSE':>12s}{'times faster':>14s}{'at equal error':>16s}")
    for name, taken in seconds.items():
        faster = seconds[best] / taken
        equal = faster * (errors[best] / errors[name]) ** 2
        print(f"{name:16s}{taken:8.2f}{errors[name]:12.4f}{faster:14.2f}{equal:16.2f}")
    for strategy, taken in compile_seconds.items():
        print(f"compiled {strategy}: {taken:.2f} s")
