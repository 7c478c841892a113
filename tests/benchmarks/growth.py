"""Measure how time and memory grow with picture size, samples, lights, triangles, walkers and
observations, each over three decades. Write a table in Markdown.

    PYTHONPATH=tests python tests/benchmarks/growth.py [--only WORD] [--out FILE]

Each size runs in its own process. Its time is the least of up to three warm calls, and its memory
the largest resident set above the one after imports. The slope is the one of log time between the
last two sizes, where constant costs matter least. Theory says 1, and nearly 0 for triangles."""

import argparse
import json
import math
import resource
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

SIZES = {
    "pixels: direct light with shadows": (64**2, 256**2, 512**2, 2048**2),
    "samples a pixel: paths of the Cornell box, 32 x 32": (4, 40, 400, 4000),
    "lights: points on a ball, 128 x 128 pixels": (1, 10, 100, 1000),
    "triangles: 65,536 rays on a mesh": (1_280, 20_480, 327_680, 1_310_720),
    "walkers: 200 steps of emcee on a line": (20, 200, 2_000, 20_000),
    "observations: a fit of a line": (1_000, 10_000, 100_000, 1_000_000),
}
CALLS = 3
LONG = 10  # s; after a longer call there is no further one


def pixels(count):
    from dataclasses import replace

    import jax
    from bench_direct_light import ours as spheres

    from jaxvision import render

    scene, view = spheres()
    side = math.isqrt(count)
    pitch = view.pixel_pitch * view.resolution[0] / side
    view = replace(view, pixel_pitch=pitch, resolution=(side, side))
    draw = jax.jit(render)
    return lambda: jax.block_until_ready(draw(scene, view))


def samples(count):
    import jax
    from oracles import cornell_box

    from jaxvision.transport import Paths, path_traced

    scene, view = cornell_box.scene(), cornell_box.view(32)
    method = Paths(samples=count, depth=5)
    drawn = jax.jit(lambda key: path_traced(key, scene, view, method=method).radiance)
    return lambda: jax.block_until_ready(drawn(jax.random.key(0)))


def lights(count):
    import jax
    import numpy as np

    import jaxvision as jv

    places = np.random.default_rng(0).normal(size=(count, 3)) + np.array([0, 0, 5])
    ball = jv.Surface(jv.Sphere([0, 0, 0], 1.0), jv.Phong([0.3], [0.4], 30.0))
    scene = jv.Scene([ball], [jv.PointLight(place, [1.0]) for place in places])
    axes = np.diag([1.0, -1.0, -1.0])
    view = jv.Orthographic([0, 0, 9], axes, 2.2 / 128, resolution=(128, 128))
    draw = jax.jit(jv.render)
    return lambda: jax.block_until_ready(draw(scene, view))


def triangles(count):
    import jax
    import jax.numpy as jnp
    from bench_mesh import bumpy_ball, camera_rays

    from jaxvision import TriangleMesh, Vec, as_dtype
    from jaxvision.geometry import Ray, hit_shape, nearest_shape

    mesh = as_dtype(TriangleMesh(*bumpy_ball(round(math.log(count / 20, 4)))), jnp.float32)
    origin, direction = camera_rays()
    rays = Ray(Vec(*jnp.asarray(origin).T), Vec(*jnp.asarray(direction).T))

    def distance(ray):
        return hit_shape(ray, [mesh], nearest_shape(ray, [mesh])).distance

    meet = jax.jit(jax.vmap(distance))
    return lambda: jax.block_until_ready(meet(rays))


def line(count):
    import jax
    import jax.numpy as jnp

    from fitting import Gaussian, Parameter, Problem

    x = jnp.linspace(-1, 1, count)
    free = {"gain": Parameter(lower=0, upper=9), "bias": Parameter(lower=-9, upper=9)}
    return Problem(
        free,
        lambda gain, bias: gain * x + bias,
        Gaussian(sd=0.1),
        2 * x + 0.3 + 0.1 * jax.random.normal(jax.random.key(0), x.shape),
    )


def walkers(count):
    from fitting import Emcee, fit

    options = Emcee(walkers=count, steps=200, block=200, gives_up=False)
    return partial(fit, line(50), posterior=options)


def observations(count):
    from fitting import fit

    return partial(fit, line(count))


def measured(subject, count):
    """Return [seconds, MB] of one size. The function runs in a process of its own."""
    import jaxvision

    jaxvision.keep_memory()  # as the commands do
    call = globals()[subject.partition(" ")[0].rstrip(":")](count)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    call()
    taken = []
    while len(taken) < CALLS and sum(taken) < LONG:
        begin = time.perf_counter()
        call()
        taken.append(time.perf_counter() - begin)
    largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return [min(taken), (largest - before) / 1024]


def row(subject):
    found = []
    for count in SIZES[subject]:
        command = [sys.executable, __file__, "--one", subject, str(count)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            sys.exit(done.stderr)
        found.append(json.loads(done.stdout.splitlines()[-1]))
    sizes, (seconds, memory) = SIZES[subject], zip(*found, strict=True)
    slope = math.log(seconds[-1] / seconds[-2]) / math.log(sizes[-1] / sizes[-2])
    cells = zip(sizes, seconds, memory, strict=True)
    told = " | ".join(f"{count:,}: {took:.3g} s, {size:.0f} MB" for count, took, size in cells)
    return f"| {subject} | {told} | {slope:.2f} |"


def main():
    asks = argparse.ArgumentParser()
    asks.add_argument("--only", default="")
    asks.add_argument("--out", type=Path)
    asks.add_argument("--one", nargs=2)
    asked = asks.parse_args()
    if asked.one:
        print(json.dumps(measured(asked.one[0], int(asked.one[1]))))
        return
    head = ["| what grows | small | | | large | slope |", "| --- | --- | --- | --- | --- | --- |"]
    rows = []
    for subject in (subject for subject in SIZES if asked.only in subject):
        rows.append(row(subject))
        print(rows[-1], flush=True)
    if asked.out:
        asked.out.write_text("\n".join([*head, *rows]) + "\n")


if __name__ == "__main__":
    main()
