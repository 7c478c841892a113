"""Lobes fitted to measured reflectance, against scipy's least squares from several starts.

Both fit Torrance-Sparrow's amplitudes of 8 bands and their common roughness to the same 1440
samples, to all and with each of eight incidences left out. scipy has the library's lobe, compiled,
and its derivatives, exact in the amplitudes. Interleaved in one process after a first call that
compiles, which is printed apart.
"""

import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

from fitting.reflectance.from_files.fit import fit_model
from fitting.reflectance.from_files.read import from_samples
from fitting.reflectance.models import unit_brdf
from fitting.reflectance.names import INDEX
from jaxvision.brdf.measured import BRDFSamples

pytestmark = pytest.mark.benchmark

MODEL, ROUGHNESS, BANDS = "torrance-sparrow-beckmann", 0.15, 8
STARTS = (0.02, 0.1, 0.5)


def simulated():
    rng = np.random.default_rng(0)
    theta_i = np.repeat(np.radians(np.arange(10, 90, 10)), 180)
    theta_o, phi_o = rng.uniform(0, 1.35, 1440), rng.uniform(-np.pi, np.pi, 1440)
    near = rng.random(1440) < 0.3
    theta_o[near] = np.clip(theta_i[near] + 0.2 * rng.standard_normal(near.sum()), 0, 1.35)
    phi_o[near] = np.pi + 0.3 * rng.standard_normal(near.sum())
    angles = [jnp.asarray(a) for a in (theta_i, 0 * theta_i, theta_o, phi_o)]
    blank = BRDFSamples(*angles, jnp.ones((1440, BANDS)))
    directions = from_samples("blank", blank, weights=np.ones(1440))
    unit = np.asarray(unit_brdf(MODEL, jnp.asarray(ROUGHNESS), directions.wi, directions.wo, INDEX))
    diffuse, specular = np.linspace(0.01, 0.1, BANDS), np.linspace(0.7, 1, BANDS)
    values = diffuse + specular * unit[:, None]
    values = values * np.exp(0.1 * rng.standard_normal(values.shape))
    return from_samples(
        "simulated", BRDFSamples(*angles, jnp.asarray(values)), weights=np.ones(1440)
    )


def test_nine_fits_against_nine_of_scipy(capsys):
    measured = simulated()
    cosine = measured.cosine[:, None]
    lobe = jax.jit(lambda log: unit_brdf(MODEL, jnp.exp(log), measured.wi, measured.wo, INDEX))

    def by_scipy_once(kept, start):
        y, c = measured.values[kept], cosine[kept]

        def residuals(p):
            unit = np.asarray(lobe(p[-1]))[kept, None]
            return (c * (p[:BANDS] + p[BANDS:-1] * unit - y)).ravel()

        def jacobian(p):
            unit, ahead = (np.asarray(lobe(x))[kept, None] for x in (p[-1], p[-1] + 1e-6))
            count = len(y)
            slopes = np.zeros((count, BANDS, 2 * BANDS + 1))
            bands = np.arange(BANDS)
            slopes[:, bands, bands] = c
            slopes[:, bands, BANDS + bands] = c * unit
            slopes[:, :, -1] = c * p[BANDS:-1] * (ahead - unit) / 1e-6
            return slopes.reshape(count * BANDS, -1)

        first = np.concatenate([np.full(BANDS, 0.05), np.full(BANDS, 0.5), [np.log(start)]])
        return scipy.optimize.least_squares(residuals, first, jac=jacobian, method="lm")

    everything = np.ones(len(cosine), bool)
    subsets = [everything, *(measured.incidence != i for i in range(len(measured.incidences)))]

    def by_scipy():
        return [
            min((by_scipy_once(kept, start) for start in STARTS), key=lambda fit: fit.cost)
            for kept in subsets
        ]

    def by_projection():
        return fit_model(measured, MODEL, index=INDEX)

    begin = time.perf_counter()
    found = by_projection()
    first = time.perf_counter() - begin
    rounds = {"projection": [], "scipy": []}
    for _ in range(3):
        for name, call in (("projection", by_projection), ("scipy", by_scipy)):
            begin = time.perf_counter()
            result = call()
            rounds[name].append(time.perf_counter() - begin)
    reference = result
    seconds = {name: float(np.median(times)) for name, times in rounds.items()}
    for ours, theirs in zip((found.whole, *found.without), reference, strict=True):
        np.testing.assert_allclose(ours.shape, np.exp(theirs.x[-1]), rtol=1e-3)
        np.testing.assert_allclose(ours.diffuse, theirs.x[:BANDS], atol=1e-4)
    with capsys.disabled():
        print(
            f"\n9 fits of 1440 x {BANDS}: scipy, {len(STARTS)} starts {seconds['scipy']:.1f} s, "
            f"projection {seconds['projection']:.2f} s (first call {first:.1f} s): "
            f"{seconds['scipy'] / seconds['projection']:.0f}x"
        )
    assert seconds["scipy"] > 5 * seconds["projection"]
