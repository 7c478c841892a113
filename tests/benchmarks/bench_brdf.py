"""Evaluations a second of every BRDF family in float32, beside the same formula in NumPy and beside
what the memory lets through.

    pytest tests/benchmarks/bench_brdf.py -m benchmark --benchmark-enable -s

One evaluation reads two directions and writes one band: 28 bytes in float32. The copy moves as
many bytes, half read and half written; "of memory" is the part of its rate that a family reaches.
"""

import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from turns import in_turns

from jaxvision import brdf
from jaxvision.brdf.blinn import NormalisedBlinn
from jaxvision.brdf.fresnel import Conductor, Dielectric
from jaxvision.brdf.gaussian_lobe import GaussianLobeBRDF
from jaxvision.brdf.lambert import Lambert
from jaxvision.brdf.oren_nayar import OrenNayar
from jaxvision.brdf.phong import NormalisedPhong
from jaxvision.brdf.torrance_sparrow import TorranceSparrow
from jaxvision.core._vector import Vec

COUNT, ROUNDS = 1_000_000, 7
BYTES = 28 * COUNT
KD, KS, N, C, ALPHA = 0.1, 0.5, 30.0, 5.0, 0.2


def numpy_lambert(i, o):
    return np.full_like(i[0], KD)


def numpy_phong(i, o):
    cos = np.maximum(i[2] * o[2] - i[0] * o[0] - i[1] * o[1], 0)
    return KD + KS * (N + 2) / (2 * np.pi) * cos**N


def numpy_gaussian(i, o):
    cos = np.clip(i[2] * o[2] - i[0] * o[0] - i[1] * o[1], -1, 1)
    return KD + KS * np.exp(-np.square(C * np.arccos(cos)))


def halves(i, o):
    h = [a + b for a, b in zip(i, o, strict=True)]
    inverse = 1 / np.sqrt(h[0] ** 2 + h[1] ** 2 + h[2] ** 2)
    return [x * inverse for x in h]


def numpy_blinn(i, o):
    h = halves(i, o)
    return KD + KS * (N + 2) * (N + 4) / (8 * np.pi * (N + 2 ** (-N / 2))) * h[2] ** N


def numpy_ggx(i, o):
    h = halves(i, o)
    d = ALPHA**2 / (np.pi * np.square(h[0] ** 2 + h[1] ** 2 + (ALPHA * h[2]) ** 2))
    roots = [np.sqrt(w[2] ** 2 + ALPHA**2 * (w[0] ** 2 + w[1] ** 2)) for w in (i, o)]
    c = sum(a * b for a, b in zip(h, o, strict=True))
    g = np.sqrt(1.5**2 - 1 + c * c)
    f = ((c - g) / (c + g)) ** 2 + ((2.25 * c - g) / (2.25 * c + g)) ** 2
    return KD + KS * f / 2 * d / (2 * (i[2] * roots[1] + o[2] * roots[0]))


def numpy_beckmann(i, o):
    from scipy.special import erf

    h = halves(i, o)
    squared = h[2] ** 2
    d = np.exp((1 - 1 / squared) / ALPHA**2) / (np.pi * ALPHA**2 * squared**2)
    hidden = 0
    for w in (i, o):
        a = w[2] / (ALPHA * np.sqrt(1 - np.minimum(w[2], 0.9999999) ** 2))
        hidden = hidden + (erf(a) - 1) / 2 + np.exp(-a * a) / (2 * a * np.sqrt(np.pi))
    c = sum(x * y for x, y in zip(h, o, strict=True))
    m = np.complex64(0.2 + 3j)
    t = np.sqrt(1 - (1 - c * c) / m**2)
    f = np.abs((c - m * t) / (c + m * t)) ** 2 + np.abs((m * c - t) / (m * c + t)) ** 2
    return KD + KS * f / 2 * d / (1 + hidden) / (4 * i[2] * o[2])


def numpy_oren_nayar(i, o):
    a = 1 - 0.5 * 0.25 / (0.25 + 0.33)
    b = 0.45 * 0.25 / (0.25 + 0.09)
    toward = np.maximum(i[0] * o[0] + i[1] * o[1], 0) / np.maximum(i[2], o[2])
    return KD * (a + b * toward)


FAMILIES = {
    "lambert": (Lambert([KD]), numpy_lambert),
    "normalised phong": (NormalisedPhong([KD], [KS], N), numpy_phong),
    "gaussian lobe": (GaussianLobeBRDF([KD], [KS], C), numpy_gaussian),
    "normalised blinn": (NormalisedBlinn([KD], [KS], N), numpy_blinn),
    "ggx, glass": (TorranceSparrow([KD], [KS], ALPHA, interface=Dielectric([1.5])), numpy_ggx),
    "beckmann, metal": (
        TorranceSparrow(
            [KD], [KS], ALPHA, interface=Conductor([0.2], [3.0]), distribution="beckmann"
        ),
        numpy_beckmann,
    ),
    "oren-nayar": (OrenNayar([KD], 0.5), numpy_oren_nayar),
}
# Lambert's rival fills an array and looks at no direction; XLA's atan2 on the CPU costs some 50 ns
# where NumPy's arccos, which keeps fewer digits, costs 1; with Blinn both take one power.
SLOWER_THAN_NUMPY = {"lambert", "gaussian lobe", "normalised blinn"}


def directions(rng) -> list[np.ndarray]:
    """Components of unit vectors within 80 degrees of the normal, float32."""
    z, phi = rng.uniform(np.cos(1.4), 1, COUNT), rng.uniform(0, 2 * np.pi, COUNT)
    sine = np.sqrt(1 - z * z)
    return [c.astype(np.float32) for c in (sine * np.cos(phi), sine * np.sin(phi), z)]


@pytest.mark.benchmark
def test_throughput(capsys):
    rng = np.random.default_rng(0)
    plain_i, plain_o = directions(rng), directions(rng)
    wi, wo = (Vec(*map(jnp.asarray, v)) for v in (plain_i, plain_o))
    source = np.ones(BYTES // 8, np.float32)
    target = np.empty_like(source)
    rows = []
    for name, (material, plain) in FAMILIES.items():
        single = jax.tree.map(lambda x: x.astype(jnp.float32), material)
        evaluate = jax.jit(jax.vmap(lambda i, o, m=single: brdf.evaluate(m, i, o)[0]))
        start = time.perf_counter()
        compiled = evaluate.lower(wi, wo).compile()
        compilation = time.perf_counter() - start
        got = np.asarray(compiled(wi, wo))
        assert got.dtype == np.float32
        np.testing.assert_allclose(got, plain(plain_i, plain_o), rtol=5e-3)
        _, seconds = in_turns(
            {
                "ours": lambda run=compiled: jax.block_until_ready(run(wi, wo)),
                "numpy": lambda run=plain: run(plain_i, plain_o),
                "copy": lambda: np.copyto(target, source),
            },
            rounds=ROUNDS,
        )
        rows.append((name, seconds, compilation))
    with capsys.disabled():
        print(f"\n{'family':18s} {'M/s':>7s} {'NumPy':>7s} {'ratio':>6s} {'of memory':>9s} compile")
        for name, seconds, compilation in rows:
            rate, rival = COUNT / seconds["ours"] / 1e6, COUNT / seconds["numpy"] / 1e6
            print(
                f"{name:18s} {rate:7.1f} {rival:7.1f} {rate / rival:6.1f} "
                f"{seconds['copy'] / seconds['ours']:9.2f} {compilation:6.2f} s"
            )
    for name, seconds, _ in rows:
        if name not in SLOWER_THAN_NUMPY:
            assert seconds["ours"] < seconds["numpy"], name
