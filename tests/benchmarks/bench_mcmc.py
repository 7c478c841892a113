"""emcee on the reflectance posterior of some 20 000 pixels, 128 walkers: the library's density,
vectorised JAX on cells, against a NumPy density of the pixels.

Cost of a step, and effective draws a second of the moves that the library uses against emcee's
default stretch move. That both sides sample the same posterior is a test of its own. Run it with
OPENBLAS_NUM_THREADS=1: on busy cores the threads of the tiny products in emcee's KDE move cost more
than everything else.
"""

import time

import emcee
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles.sphere_photographs import light_directions, sphere_normals

from fitting.reflectance.from_images.fit import Adjusted, adjusted_log_density
from fitting.reflectance.from_images.samples import (
    Samples,
    average,
    group,
    predict,
    total_log_likelihood,
)
from fitting.reflectance.from_images.signal import Form, local_geometry

pytestmark = pytest.mark.benchmark

LIGHTS, WALKERS, BATCH = 10, 128, 8
TRUTH = np.log([0.4, 0.45, 40.0])
WHITE, DEVIATION = 3000.0, 20.0
KDE = "cells in JAX, KDE moves"
NUMPY, PIXELS, CELLS = "pixels in NumPy", "pixels in JAX", "cells in JAX"


def data():
    """Light index, n.l, mirror cosine, digital numbers and geometry of all lit pixels."""
    normals = sphere_normals(64, 31.0).reshape(-1, 3)
    normals = normals[~np.isnan(normals[:, 2])]
    directions = light_directions(LIGHTS)
    n_l = directions @ normals.T
    mirrored = 2 * n_l * normals[:, 2] - directions[:, 2:]
    lit = n_l > 0
    cosine, cos_mirror = n_l[lit], np.clip(mirrored[lit], 1e-6, 1)
    signal = WHITE * (0.4 * cosine + 0.45 * cos_mirror**40)
    dn = signal + DEVIATION * np.random.default_rng(0).standard_normal(signal.size)
    light, pixel = np.nonzero(lit)
    seen = local_geometry(normals[pixel], directions[light], np.full_like(cosine, WHITE))
    return light, cosine, cos_mirror, dn, seen


def numpy_log_density(q, cosine, log_cos, dn):
    kd, ks, exponent = np.exp(q)
    z = (WHITE * (kd * cosine + ks * np.exp(exponent * log_cos)) - dn) / DEVIATION
    return -np.sum(z * z) / 2


def numpy_args():
    _, cosine, cos_mirror, dn, _ = data()
    return cosine, np.log(cos_mirror), dn


def posterior_of(*, cells):
    light, cosine, cos_mirror, dn, seen = data()
    one = jnp.ones(())
    samples = Samples(
        form=Form("phong"),
        geometry=seen,
        dn=jnp.asarray(dn),
        deviation=jnp.full_like(cosine, DEVIATION),
        saturated=None,
        black=0 * one,
        white=4095 * one,
        clip=4095 * one,
        gamma=None,
    )
    mode = jnp.asarray(TRUTH)
    if cells:
        grouping = group(light, cosine, np.arccos(cos_mirror))
        samples = average(samples, grouping, exact_at=predict(TRUTH, samples))
    return Adjusted(total_log_likelihood, (samples, None), mode, jnp.eye(3), jnp.zeros(3))


def jax_log_density(*, cells):
    posterior = posterior_of(cells=cells)

    @jax.jit
    def evaluate(vectors, posterior):
        return jax.lax.map(
            lambda vector: adjusted_log_density(vector, posterior), vectors, batch_size=BATCH
        )

    return lambda vectors: np.asarray(evaluate(jnp.asarray(vectors), posterior))


def walkers():
    return TRUTH + 1e-3 * np.random.default_rng(1).standard_normal((WALKERS, 3))


def sampler(log_density, *, vectorize, moves=None, args=()):
    made = emcee.EnsembleSampler(
        WALKERS, 3, log_density, vectorize=vectorize, moves=moves, args=args
    )
    made.run_mcmc(walkers(), 10)
    return made


def test_the_densities_agree():
    """Exactly on pixels; on cells to a part of the 0.5 by which one standard deviation counts."""
    deviations = np.array([1.6e-4, 1.5e-3, 2.3e-3])
    vectors = TRUTH + np.random.default_rng(2).standard_normal((16, 3)) * deviations
    reference = np.array([numpy_log_density(q, *numpy_args()) for q in vectors])
    for cells, tolerance in ((False, 1e-6), (True, 0.2)):
        found = jax_log_density(cells=cells)(vectors)
        difference = (found - found[0]) - (reference - reference[0])
        np.testing.assert_allclose(difference, 0, atol=tolerance)


def test_a_step_and_the_effective_draws(capsys):
    moves = [(emcee.moves.KDEMove(), 0.6), (emcee.moves.DEMove(), 0.4)]
    on_cells = jax_log_density(cells=True)
    rivals = {
        NUMPY: sampler(numpy_log_density, vectorize=False, args=numpy_args()),
        PIXELS: sampler(jax_log_density(cells=False), vectorize=True),
        CELLS: sampler(on_cells, vectorize=True),
        KDE: sampler(on_cells, vectorize=True, moves=moves),
    }
    steps, times = 10, {name: [] for name in rivals}
    for _ in range(7):
        for name, rival in rivals.items():
            begin = time.perf_counter()
            rival.run_mcmc(None, steps)
            times[name].append((time.perf_counter() - begin) / steps)
    cost = {name: float(np.median(own)) for name, own in times.items()}
    tau = {}
    for name in (CELLS, KDE):
        rivals[name].run_mcmc(None, 3000)
        chain = rivals[name].get_chain(discard=300)
        tau[name] = float(emcee.autocorr.integrated_time(chain, tol=0, quiet=True).max())
        assert len(chain) > 50 * tau[name]
    worth = {name: WALKERS / cost[name] / tau.get(name, tau[CELLS]) for name in rivals}
    with capsys.disabled():
        print()
        for name in rivals:
            print(
                f"{name}: {1e3 * cost[name]:.2f} ms a step ({cost[NUMPY] / cost[name]:.1f}x), tau "
                f"{tau.get(name, tau[CELLS]):.1f}, {worth[name]:.0f} effective draws a second "
                f"({worth[name] / worth[NUMPY]:.0f}x)"
            )
    assert cost[NUMPY] / cost[CELLS] >= 6
    assert worth[KDE] / worth[NUMPY] >= 30
