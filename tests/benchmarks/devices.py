"""Compare programs on a processor and on an accelerator: compilation time, warm time and results.

    python tests/benchmarks/devices.py [--only EXPRESSION] [--rounds 9] [--out FILE]

The script writes a table in Markdown, with one column of times if JAX finds no accelerator. Each
call waits for its result, and inputs are on the device already. Random numbers are the same on both
devices, so pictures of paths can be compared. A shadow ray that passes an edge on the other side
changes its pixel, so the median difference is given besides the largest."""

import argparse
import re
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from bench_direct_light import ours as spheres
from bench_mesh import bumpy_ball, camera_rays
from oracles import cornell_box
from oracles.sensors import OF_PHOTONS
from oracles.sphere_photographs import light_directions, sphere_normals

from fitting.inference.posterior import walkers_at_a_time
from fitting.reflectance.from_images.fit import Adjusted, adjusted_log_density
from fitting.reflectance.from_images.samples import Samples, total_log_likelihood
from fitting.reflectance.from_images.signal import Form, local_geometry
from jaxvision import Vec, as_dtype, filters, histogram, render
from jaxvision.accuracy.scene_settings import machine
from jaxvision.development import demosaic
from jaxvision.geometry import Ray, hit_shape, nearest_shape
from jaxvision.scene import TriangleMesh
from jaxvision.sensor import raw_image
from jaxvision.transport import Paths, path_traced
from jaxvision.transport.radiosity import plan_patches, radiosity

KEY, DIE = jax.random.split(jax.random.key(0))
TRUTH, WHITE = np.log([0.4, 0.45, 40.0]), 3000.0  # of the reflectance posterior
ALL = replace(
    OF_PHOTONS,
    exposure_time=0.01,
    crosstalk=None,
    smear=None,
    blooming=None,
    charge_transfer=None,
    gain=0.4,
    bits=12,
)


def lit_pixels() -> tuple:
    """Return n.l, digital numbers and geometry of the lit pixels of a Phong sphere under ten
    lights."""
    normals = sphere_normals(64, 31.0).reshape(-1, 3)
    normals = normals[~np.isnan(normals[:, 2])]
    directions = light_directions(10)
    n_l = directions @ normals.T
    mirrored = 2 * n_l * normals[:, 2] - directions[:, 2:]
    lit = n_l > 0
    cosine, cos_mirror = n_l[lit], np.clip(mirrored[lit], 1e-6, 1)
    signal = WHITE * (0.4 * cosine + 0.45 * cos_mirror**40)
    dn = signal + 20 * np.random.default_rng(0).standard_normal(signal.size)
    light, pixel = np.nonzero(lit)
    return (
        cosine,
        dn,
        local_geometry(normals[pixel], directions[light], np.full_like(cosine, WHITE)),
    )


def reflectance_posterior() -> Adjusted:
    cosine, dn, seen = lit_pixels()
    one = jnp.ones(())
    samples = Samples(
        form=Form("phong"),
        geometry=seen,
        dn=jnp.asarray(dn),
        deviation=jnp.full_like(cosine, 20.0),
        saturated=None,
        black=0 * one,
        white=4095 * one,
        clip=4095 * one,
        gamma=None,
    )
    parts = (samples, None), jnp.asarray(TRUTH), jnp.eye(3), jnp.zeros(3)
    return Adjusted(total_log_likelihood, *parts)


Program = tuple[Callable, tuple]


def direct_light(side: int) -> Program:
    scene, view = spheres()
    pitch = view.pixel_pitch * view.resolution[0] / side
    view = replace(view, pixel_pitch=pitch, resolution=(side, side))
    return render, (scene, view)


def box() -> tuple:
    return as_dtype(cornell_box.scene(emissive_surface=True), jnp.float32)


def paths(side: int) -> Program:
    method, view = Paths(64, 6), as_dtype(cornell_box.view(side), jnp.float32)
    return partial(path_traced, method=method), (KEY, box(), view)


def radiosities(size: float) -> Program:
    """Return the program that computes form factors and solves for radiosity."""
    scene = box()
    plan = plan_patches(scene, size=size, split=1)
    return partial(radiosity, plan=plan, method="iterative"), (scene,)


def walkers() -> Program:
    """Return the reflectance posterior of 27,000 pixels at the positions of an ensemble's
    walkers."""
    posterior = reflectance_posterior()
    start = TRUTH + 1e-3 * np.random.default_rng(1).standard_normal((128, 3))

    def densities(vectors):
        def one(vector):
            return adjusted_log_density(vector, posterior)

        return jax.lax.map(one, vectors, batch_size=walkers_at_a_time())

    return densities, (jnp.asarray(start, jnp.result_type(float)),)


def picture(side: int, bands: tuple = (3,)) -> jax.Array:
    numbers = np.random.default_rng(side).uniform(size=(side, side, *bands))
    return jnp.asarray(numbers, jnp.float32)


def filtered(side: int, taps: int, method: str) -> Program:
    kernel = np.random.default_rng(1).uniform(size=(taps, taps)).astype(np.float32)
    kernel /= kernel.sum()
    return partial(filters.correlate, kernel=kernel, method=method), (picture(side),)


def mesh(subdivisions: int) -> Program:
    shape = as_dtype(TriangleMesh(*bumpy_ball(subdivisions)), jnp.float32)
    origin, direction = camera_rays()
    ray = Ray(Vec(*jnp.asarray(origin).T), Vec(*jnp.asarray(direction).T))

    def distance(ray, shape):
        def one(ray):
            return hit_shape(ray, [shape], nearest_shape(ray, [shape])).distance

        return jax.vmap(one)(ray)

    return distance, (ray, shape)


def frame() -> Program:
    light = jnp.full((3000, 4000, 1), 3e5, jnp.float32)
    sensor = as_dtype(ALL, jnp.float32)

    def exposed(key, sensor, light, die):
        return raw_image(key, sensor, light, die_key=die)

    return exposed, (KEY, sensor, light, DIE)


def with_codes(function: Callable) -> Program:
    return function, ((255 * picture(2048, ())).astype(jnp.uint8),)


def rows() -> dict[str, Callable[[], Program]]:
    found: dict[str, Callable[[], Program]] = {}
    for side in (512, 2048):
        found[f"direct light, {side} x {side}, 9 surfaces, 3 lights"] = partial(direct_light, side)
    for side in (256, 1024):
        found[f"Cornell box, {side} x {side}, 64 paths of 6"] = partial(paths, side)
    for size in (0.05, 0.025):
        found[f"radiosity of the box, patches of {size} m"] = partial(radiosities, size)
    found["posterior of 27,000 pixels, 128 walkers"] = walkers
    for subdivisions in (3, 6):
        about = f"65,536 rays on {20 * 4**subdivisions:,} triangles"
        found[about] = partial(mesh, subdivisions)
    found["raw frame, 12 MP, every source of noise"] = frame
    for side in (512, 2048):
        for taps in (3, 7, 11, 15, 31):
            for method in ("direct", "fft", "conv"):
                about = f"filter {taps} x {taps}, {side} x {side} x 3, {method}"
                found[about] = partial(filtered, side, taps, method)
    of_pictures = {
        "histogram": histogram.exact_histogram,
        "equalise": histogram.equalise,
        "CLAHE": histogram.equalise_locally,
        "demosaic": partial(demosaic, pattern="RGGB"),
    }
    for name, function in of_pictures.items():
        found[f"{name}, 2048 x 2048"] = partial(with_codes, function)
    return found


def timed(device: jax.Device, program: Program, rounds: int) -> tuple[float, float, list]:
    """Return the seconds of compilation, the median seconds of warm calls, and the leaves of the
    result."""
    function, arguments = program
    arguments = jax.device_put(arguments, device)
    with jax.default_device(device):
        begin = time.perf_counter()
        compiled = jax.jit(function).lower(*arguments).compile()
        seconds = time.perf_counter() - begin
        result = jax.block_until_ready(compiled(*arguments))
        taken = []
        for _ in range(rounds):
            begin = time.perf_counter()
            jax.block_until_ready(compiled(*arguments))
            taken.append(time.perf_counter() - begin)
            if sum(taken) > 10:
                break
    return seconds, float(np.median(taken)), [np.asarray(leaf) for leaf in jax.tree.leaves(result)]


def apart(one: list, other: list) -> str:
    """Return the median and the largest difference of two results, relative to the largest number
    in them."""
    pairs = [(a, b) for a, b in zip(one, other, strict=True) if a.dtype.kind in "fui" and a.size]
    a, b = (np.concatenate([np.ravel(p[k]).astype(np.float64) for p in pairs]) for k in (0, 1))
    if not np.array_equal(np.isfinite(a), np.isfinite(b)):
        return "not finite alike"
    finite = np.isfinite(a)
    difference = np.abs(a[finite] - b[finite]) / max(np.abs(b[finite]).max(initial=0), 1e-30)
    return f"{np.median(difference):.1g}, {difference.max():.1g}"


def milliseconds(seconds: float) -> str:
    return f"{1e3 * seconds:.3g}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", default="", help="rows in which this regular expression is found")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--alone", action="store_true", help="the accelerator alone")
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    processor, device = jax.devices("cpu")[0], jax.devices()[0]
    processor = device if given.alone else processor
    names = ["processor"] + [device.device_kind] * (device != processor)
    head = ["what", *(f"{name}, ms (s to compile)" for name in names)]
    head += ["times as fast", "apart: median, largest"] * (device != processor)
    lines = [f"| {' | '.join(head)} |", f"| {' | '.join(['---'] * len(head))} |"]
    for about, build in rows().items():
        if not re.search(given.only, about):
            continue
        program = build()
        found = [timed(each, program, given.rounds) for each in dict.fromkeys((processor, device))]
        cells = [about, *(f"{milliseconds(warm)} ({first:.2g})" for first, warm, _ in found)]
        if len(found) == 2:
            cells += [f"{found[0][1] / found[1][1]:.2g}", apart(found[1][2], found[0][2])]
        lines.append(f"| {' | '.join(cells)} |")
        print(lines[-1], flush=True)
    if given.out:
        given.out.write_text("\n".join([*lines, "", machine(), ""]))


if __name__ == "__main__":
    main()
