"""A million evaluations, densities and draws of measured BRDFs, float32: against Mitsuba 3's
`measured` (llvm) on an RGL file, and a NumPy lookup of a MERL table.

    pytest tests/benchmarks/bench_measured.py -m benchmark -s
"""

import time
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxvision import Vec, as_dtype, brdf
from jaxvision.brdf.half_difference import HalfDifferenceTable
from jaxvision.brdf.measured import AnisotropicTable, IsotropicTable, tabulate_sampler
from jaxvision.files import measured as files

COUNT, ROUNDS = 1_000_000, 5


def directions(seed: int) -> np.ndarray:
    """(3, COUNT) unit, above the surface, float32."""
    v = np.random.default_rng(seed).normal(size=(3, COUNT)).astype(np.float32)
    v[2] = np.abs(v[2])
    return v / np.linalg.norm(v, axis=0)


def timed(rivals: dict[str, Callable[[], object]]) -> dict[str, float]:
    """Median seconds of each, warmed up, the rounds taking turns; compilation printed apart."""
    for name, run in rivals.items():
        start = time.perf_counter()
        run()
        print(f"{name:34s} first call {time.perf_counter() - start:6.2f} s")
    seconds: dict[str, list[float]] = {name: [] for name in rivals}
    for _ in range(ROUNDS):
        for name, run in rivals.items():
            start = time.perf_counter()
            run()
            seconds[name].append(time.perf_counter() - start)
    return {name: float(np.median(taken)) for name, taken in seconds.items()}


def table(seconds: dict[str, float]) -> None:
    for name, taken in seconds.items():
        print(f"{name:34s} {1e3 * taken:8.1f} ms  {COUNT / taken / 1e6:7.1f} M/s")


def runner(function, *arguments) -> Callable[[], object]:
    compiled = jax.jit(jax.vmap(function, (None, *(0 for _ in arguments[1:]))))
    return lambda: jax.block_until_ready(compiled(*arguments))


@pytest.mark.benchmark
def test_rgl_against_mitsuba(data_folder):
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("llvm_ad_rgb")
    import drjit

    path = data_folder / "brdf_rgl" / "satin_rosaline_rgb.bsdf"
    material = as_dtype(files.read_rgl(path), jnp.float32)
    i, o = directions(0), directions(1)
    wi, wo = Vec(*jnp.asarray(i)), Vec(*jnp.asarray(o))
    u = jnp.asarray(np.random.default_rng(2).random((COUNT, 3)), jnp.float32)
    bsdf = mitsuba.load_dict({"type": "measured", "filename": str(path)})
    context = mitsuba.BSDFContext()
    their_wi, their_wo = mitsuba.Vector3f(i), mitsuba.Vector3f(o)
    their_u = mitsuba.Point2f(np.asarray(u)[:, :2].T)
    at = drjit.zeros(mitsuba.SurfaceInteraction3f, COUNT)
    at.wi = their_wo

    def theirs(call):
        made = call()
        drjit.eval(made)
        drjit.sync_thread()
        return made

    rivals = {
        "evaluate, jaxvision": runner(brdf.shading, material, wi, wo),
        "evaluate, Mitsuba": partial(theirs, lambda: bsdf.eval(context, at, their_wi)),
        "pdf, jaxvision": runner(brdf.pdf, material, wi, wo),
        "pdf, Mitsuba": partial(theirs, lambda: bsdf.pdf(context, at, their_wi)),
        "sample, jaxvision": runner(brdf.sample, material, wo, u),
        "sample, Mitsuba": partial(theirs, lambda: bsdf.sample(context, at, 0.5, their_u)),
    }
    seconds = timed(rivals)
    table(seconds)
    ours = np.asarray(rivals["evaluate, jaxvision"]())
    other = np.array(rivals["evaluate, Mitsuba"]()).T
    np.testing.assert_allclose(ours, np.maximum(other, 0), rtol=1e-3, atol=1e-5)


def numpy_lookup(values: np.ndarray, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """Nearest bin, all pairs at once."""
    h = wi + wo
    h /= np.linalg.norm(h, axis=0)
    theta_h = np.arctan2(np.hypot(h[0], h[1]), h[2])
    phi_h = np.arctan2(h[1], h[0])
    x, y, z = wi
    x, y = np.cos(phi_h) * x + np.sin(phi_h) * y, np.cos(phi_h) * y - np.sin(phi_h) * x
    x, z = np.cos(theta_h) * x - np.sin(theta_h) * z, np.sin(theta_h) * x + np.cos(theta_h) * z
    n_h, n_d, n_p, _ = values.shape
    i = np.minimum(np.sqrt(theta_h * 2 / np.pi) * n_h, n_h - 1).astype(int)
    j = np.minimum(np.arctan2(np.hypot(x, y), z) * 2 / np.pi * n_d, n_d - 1).astype(int)
    k = np.minimum(np.arctan2(y, x) / np.pi % 1 * n_p, n_p - 1).astype(int)
    return values[i, j, k]


@pytest.mark.benchmark
def test_tables_against_numpy():
    rng = np.random.default_rng(3)
    values = rng.random((90, 90, 180, 3)).astype(np.float32)
    i, o = directions(0), directions(1)
    wi, wo = Vec(*jnp.asarray(i)), Vec(*jnp.asarray(o))
    u = jnp.asarray(rng.random((COUNT, 3)), jnp.float32)
    nodes = np.linspace(0, 1.5, 18, dtype=np.float32)
    turn = np.linspace(-3, 3, 12, dtype=np.float32)
    linear = HalfDifferenceTable(values)
    nearest = HalfDifferenceTable(values, interpolation="nearest")
    isotropic = IsotropicTable(nodes, nodes, 2 * nodes, values[:18, :18, :18])
    anisotropic = AnisotropicTable(
        nodes[:9],
        turn,
        nodes[:9],
        turn,
        values.reshape(-1, 3)[: 9 * 12 * 9 * 12].reshape(9, 12, 9, 12, 3),
    )
    sampled = tabulate_sampler(isotropic)
    rivals = {
        "MERL nearest, NumPy": lambda: numpy_lookup(values, i, o),
        "MERL nearest, jaxvision": runner(brdf.evaluate, nearest, wi, wo),
        "MERL linear, jaxvision": runner(brdf.evaluate, linear, wi, wo),
        "isotropic table": runner(brdf.evaluate, isotropic, wi, wo),
        "anisotropic table": runner(brdf.evaluate, anisotropic, wi, wo),
        "tabulated sampler, sample": runner(brdf.sample, sampled, wo, u),
        "tabulated sampler, pdf": runner(brdf.pdf, sampled, wi, wo),
    }
    seconds = timed(rivals)
    table(seconds)
    same = np.asarray(rivals["MERL nearest, jaxvision"]()) == rivals["MERL nearest, NumPy"]()
    assert same.mean() > 0.999  # a pair on the edge of a bin may round to the other side
