"""The Cornell box by radiosity beside Mitsuba 3 path tracing (llvm_ad_rgb), to equal error.

    DRJIT_LIBLLVM_PATH=... pytest -m benchmark --benchmark-enable -s \
        tests/benchmarks/bench_radiosity.py

Error: RMSE of 4 x 4 pixel blocks over their mean, lamp and its rim apart, against Mitsuba's own
path tracer at 4096 samples a pixel; both sides are compared to it after its own noise is taken
off. The lamp is a surface, as it is in Mitsuba: a `RectangleLight` lets what bounces through to the
ceiling behind it, which is .8 % of the light. Times: form factors, solution and picture apart, so
that what a new albedo costs is seen.
"""

import time
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mitsuba_scenes import mitsuba, mitsuba_cornell_box
from oracles import cornell_box
from turns import in_turns

from jaxvision import MonteCarlo, as_dtype
from jaxvision.rendering import PixelSamples
from jaxvision.transport.radiosity import (
    form_factor_table,
    plan_patches,
    radiosity,
    radiosity_image,
)

pytestmark = pytest.mark.benchmark

SIDE, BLOCK, ROUNDS = 256, 4, 5
SETTINGS = {  # size of patches in m, split, light samples, rays a pixel
    "coarse": (0.1, 2, 4, 4),
    "middle": (0.05, 1, 4, 4),
    "fine": (0.025, 1, 4, 8),
}


def blocks(image):
    shape = SIDE // BLOCK, BLOCK, SIDE // BLOCK, BLOCK, -1
    return np.asarray(image, float).reshape(shape).mean(axis=(1, 3))


def mitsuba_render():
    """render(samples a pixel, seed) -> image."""
    mi = mitsuba()
    path = {"type": "path", "max_depth": -1, "rr_depth": 50}
    scene = mitsuba_cornell_box(mi, side=SIDE, integrator=path)
    return lambda samples, seed: np.asarray(mi.render(scene, spp=samples, seed=seed))


def compiled(name, function, *arguments):
    """The call, compiled ahead; the time of that is printed apart."""
    start = time.perf_counter()
    call = jax.jit(function).lower(*arguments).compile()
    print(f"    {name}: traced and compiled in {time.perf_counter() - start:.2f} s")
    return lambda: jax.block_until_ready(call(*arguments))


def test_cornell_box():
    render = mitsuba_render()
    halves = [np.mean([render(256, seed + 8 * i) for seed in range(8)], axis=0) for i in range(2)]
    reference = blocks(np.mean(halves, axis=0))
    lamp = blocks(np.mean(halves, axis=0) > 4).max(axis=-1) > 0
    near = np.pad(lamp, 1)
    rim = np.any([np.roll(near, s, (0, 1)) for s in np.ndindex(3, 3)], axis=0)[2:, 2:]
    kept = ~rim
    own = np.mean((blocks(halves[0]) - blocks(halves[1]))[kept] ** 2) / 4

    def error(image):
        square = np.mean((blocks(image) - reference)[kept] ** 2) - own
        return np.sqrt(max(square, 0)) / reference[kept].mean()

    scene, view = as_dtype(
        (cornell_box.scene(emissive_surface=True), cornell_box.view(SIDE)), jnp.float32
    )
    rows, rivals = [], {}
    for name, (size, split, light, rays) in SETTINGS.items():
        plan = plan_patches(scene, size=size, split=split)
        rule = MonteCarlo(jax.random.key(0), light)
        factors = compiled(f"{name}, form factors", partial(form_factor_table, plan=plan), scene)
        table = factors()
        solve = compiled(
            f"{name}, solution",
            lambda s, t, p=plan: radiosity(s, p, table=t, method="iterative"),
            scene,
            table,
        )
        draw = compiled(
            f"{name}, picture",
            lambda s, x, v, p=plan, r=rule, n=rays: radiosity_image(
                s, p, x, v, rule=r, samples=PixelSamples(jax.random.key(0), n)
            ),
            scene,
            solve(),
            view,
        )
        rivals |= {f"{name}, form factors": factors, f"{name}, solution": solve}
        rivals[f"{name}, picture"] = draw
        rows.append((name, table.shape, error(draw())))
    for samples in (16, 64):
        rivals[f"mitsuba, {samples} samples"] = partial(render, samples, 1)
        print(f"  mitsuba, {samples} samples: block RMSE {error(render(samples, 1)):.4f}")
    _, seconds = in_turns(rivals, rounds=ROUNDS)
    per_sample = seconds["mitsuba, 64 samples"] / 64
    noise = error(render(64, 2)) * 8  # of one sample a pixel: falls with the root of their number
    for name, shape, off in rows:
        parts = [seconds[f"{name}, {part}"] for part in ("form factors", "solution", "picture")]
        rival = per_sample * (noise / off) ** 2
        print(
            f"  {name}: {shape[1]} patches, {shape[0]} elements, block RMSE {off:.4f}; form "
            f"factors, solution, picture {1e3 * np.array(parts).round(4)} ms; "
            f"Mitsuba to that error {1e3 * rival:.0f} ms: {rival / sum(parts):.1f} times longer"
        )
    off = {name: value for name, _, value in rows}
    assert off["middle"] < 0.023
    assert off["fine"] < 0.0105
