"""Variable projection against 200 random starts of scipy's least squares; and what a user of
`jaxvision-fit brdf` waits for, of photographs of a ball, in whole processes.

Both sides see the same 4096 samples of a Phong sphere. Timings are interleaved in one process,
after a first call that compiles; compilation is printed apart.
"""

from functools import partial
from tempfile import TemporaryDirectory

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from bench_first_picture import COMMAND, process
from oracles.sphere_photographs import expose, light_directions, shade, sphere_normals, write_rig
from turns import in_turns

from fitting.inference.separable import fit_separable

pytestmark = pytest.mark.benchmark

STARTS, SAMPLES = 200, 4096
TRUTH = np.array([0.4, 0.45, 40.0])
NOISE = 0.004  # of full scale
LOWEST, HIGHEST = np.log(0.5), np.log(2000.0)


def samples(size, lights, count):
    """n.l, log of the mirror cosine and noisy signal of `count` lit pixels."""
    rng = np.random.default_rng(0)
    normals = sphere_normals(size, 0.49 * size).reshape(-1, 3)
    normals = normals[~np.isnan(normals[:, 2])]
    directions = light_directions(lights, widest=80.0)
    n_l = normals @ directions.T
    mirrored = 2 * n_l * normals[:, 2:] - directions[:, 2]
    lit = n_l > 0
    cosine, log_cos = n_l[lit], np.log(np.maximum(mirrored[lit], 1e-6))
    chosen = rng.choice(cosine.size, count, replace=False)
    cosine, log_cos = cosine[chosen], log_cos[chosen]
    signal = TRUTH[0] * cosine + TRUTH[1] * np.exp(TRUTH[2] * log_cos)
    return cosine, log_cos, signal + NOISE * rng.standard_normal(signal.size)


@jax.jit
def lobes(log_cos, log_exponents):
    return jax.lax.map(lambda x: jnp.exp(jnp.exp(x) * log_cos), log_exponents)


@pytest.mark.parametrize("method", ["lm", "trf"])
def test_200_starts_against_variable_projection(method, capsys):
    cosine, log_cos, y = samples(64, 20, SAMPLES)
    rng = np.random.default_rng(1)
    low, high = np.log([0.01, 0.01, 1.0]), np.log([2.0, 5.0, 1000.0])
    starts = rng.uniform(low, high, (STARTS, 3))

    def residuals(q):
        kd, ks, exponent = np.exp(q)
        return kd * cosine + ks * np.exp(exponent * log_cos) - y

    def jacobian(q):
        kd, ks, exponent = np.exp(q)
        highlight = ks * np.exp(exponent * log_cos)
        return np.column_stack([kd * cosine, highlight, highlight * exponent * log_cos])

    def by_scipy():
        with np.errstate(all="ignore"):
            return [
                scipy.optimize.least_squares(
                    residuals, start, jac=jacobian, method=method, max_nfev=400
                )
                for start in starts
            ]

    fixed, values = jnp.asarray(cosine)[None], jnp.asarray(y)[:, None]
    columns, weights = partial(lobes, jnp.asarray(log_cos)), jnp.ones((len(y), 1))

    def by_projection():
        return jax.block_until_ready(
            fit_separable(columns, fixed, values, weights, lower=LOWEST, upper=HIGHEST)
        )

    first, seconds = in_turns({"scipy": by_scipy, "projection": by_projection}, rounds=5)
    found = by_projection()
    ours = np.array([*found.amplitudes[0], np.exp(found.nonlinear)])
    fits = by_scipy()
    best = min(fits, key=lambda fit: fit.cost)
    success = np.mean([fit.cost < 1.001 * best.cost for fit in fits])
    ratio = seconds["scipy"] / seconds["projection"]
    with capsys.disabled():
        print(
            f"\n{STARTS} starts, {SAMPLES} samples: scipy {method} {seconds['scipy']:.2f} s "
            f"(success {success:.2f}), projection {1e3 * seconds['projection']:.1f} ms "
            f"(first call {first['projection']:.1f} s): {ratio:.0f}x"
        )
    # The same optimum, to a small part of its standard error.
    deviation = np.sqrt(np.diagonal(np.linalg.inv(best.jac.T @ best.jac))) * NOISE
    np.testing.assert_allclose((np.log(ours) - best.x) / deviation, 0, atol=0.05)
    assert float(found.cost) <= 2 * best.cost * (1 + 1e-6)
    assert ratio >= 100


def test_the_command_on_photographs(tmp_path):
    """All models under 10 lights; with nothing kept, and with the programs of a first run."""
    size, radius, directions = 160, 78.0, light_directions(10)
    normals, rng = sphere_normals(size, radius), np.random.default_rng(0)
    camera = {"bits": 12, "black_level": 60.0, "gain": 0.25, "read_noise": 6.0}
    channels = []
    for diffuse in (0.4, 0.3, 0.2):
        signal = 3000 * shade(normals, directions, "phong", diffuse, 0.45, 40.0)
        taken = expose(rng, signal, gain=0.25, read_noise=6.0, black=60.0, clip=4095)
        channels.append(taken)
    write_rig(tmp_path, np.stack(channels, -1), directions, [3000.0], radius=radius, camera=camera)
    command = COMMAND.format("fitting"), "brdf", str(tmp_path), "--compare-all"

    def first():
        with TemporaryDirectory() as home:
            process(*command, home=home)

    rivals = {"first": first, "again": partial(process, *command, home=tmp_path)}
    _, seconds = in_turns(rivals, rounds=3, settled=0)
    for name, taken in seconds.items():
        print(f"{name:8s} {taken:6.2f} s")
