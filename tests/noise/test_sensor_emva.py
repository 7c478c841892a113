"""The circle closed: a simulated camera, measured like a real one, yields its own parameters."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_emva1288 import measurement_of
from test_noise import both_methods

from fitting.inference.estimates import find
from fitting.noise.calibration import calibrate as calibrate_noise
from fitting.noise.section import section as noise_section
from jaxvision.files.cameras import read_camera
from jaxvision.scene import FastPoissonShotNoise
from jaxvision.sensor import raw_image, sensitivity

# Counted by the fast sampler: its variance is right to 3e-4 above ten electrons.
SENSOR = replace(read_camera("emva1288").sensor, shot_noise=FastPoissonShotNoise())
KEY, DIE = jax.random.split(jax.random.key(1288))


@partial(jax.jit, static_argnames=("frames", "shape"))
def levels(key, die, photons, exposures, *, frames, shape):
    """Mean, temporal and spatial variance (levels, 3) of frames at each level of light."""

    def one(key, photons, exposure):
        sensor = replace(SENSOR, exposure_time=exposure)
        light = jnp.full(shape, 1.0) * (photons / exposure)
        stack = jax.vmap(lambda k: raw_image(k, sensor, light, die_key=die))(
            jax.random.split(key, frames)
        )
        temporal = stack.var(axis=0, ddof=1).mean()
        return jnp.stack([stack.mean(), temporal, stack.mean(axis=0).var(ddof=1)])

    keys = jax.random.split(key, len(photons))
    return jax.lax.map(lambda level: one(*level), (keys, photons, exposures))


def afternoon(key, die, photons, exposures, *, frames, shape):
    """Rows of a bright and of a dark sweep, and the mean response of the measured die's pixels."""
    bright, dark = jax.random.split(key)
    options = {"frames": frames, "shape": shape}
    response = sensitivity(die, SENSOR, shape=shape, dtype=photons.dtype).mean()
    return (
        levels(bright, die, photons, exposures, **options),
        levels(dark, die, 0 * photons, exposures, **options),
        response,
    )


def truth(response):
    """The parameters of a camera with that mean response of its pixels, relative to the data
    sheet's.
    """
    gain, noise = float(SENSOR.gain), float(SENSOR.read_noise)
    efficiency = response * float(SENSOR.quantum_efficiency)
    dark = np.sqrt((gain * noise) ** 2 + 1 / 12)
    saturation = (4095 - float(SENSOR.offset)) / gain
    return {
        "system_gain": gain,
        "quantum_efficiency": 100 * efficiency,
        "responsivity": gain * efficiency,
        "read_noise": noise,
        "temporal_dark_noise": dark,
        "threshold_photons": (dark / gain + 0.5) / efficiency,
        "dsnu": float(SENSOR.dsnu),
        "prnu": 100 * float(SENSOR.prnu),
        "dark_current": float(SENSOR.dark_current),
        "saturation_electrons": saturation,
    }


@pytest.mark.slow
def test_every_figure_of_the_sheet_returns_within_its_error():
    photons = jnp.linspace(2000.0, 36_000.0, 18)
    exposures = jnp.linspace(1e-3, 0.4, 18)
    shape = (120, 160, 1)
    *rows, response = afternoon(KEY, DIE, photons, exposures, frames=16, shape=shape)
    true_figures = truth(float(response))
    measured = measurement_of(
        np.asarray(photons),
        np.asarray(exposures),
        *map(np.asarray, rows),
        pixels=shape[0] * shape[1],
        frames=16,
        full_scale=4095.0,
    )
    section = noise_section(calibrate_noise(measured))
    known_to, seen = {"dark_current": 0.5, "dsnu": 0.2}, 0
    for name, true in true_figures.items():
        if name == "saturation_electrons":
            continue
        for method in ("EMVA 1288", "likelihood"):
            found = [e for e in section.estimates if e.name == name and e.method == method]
            for estimate in found:
                assert estimate.value is not None, (name, estimate.reason)
                assert abs(estimate.value - true) < 3.5 * estimate.standard_error, name
                assert estimate.standard_error < known_to.get(name, 0.05) * true, name
                seen += 1
    assert seen >= 14
    # the ADC ends before the well: largest variance within a level of where it begins to clip
    saturation = find(section.estimates, "saturation_electrons", method="EMVA 1288").value
    step = 34_000 / 17 * float(SENSOR.quantum_efficiency)
    assert abs(saturation - true_figures["saturation_electrons"]) < 1.5 * step


@pytest.mark.slow
def test_intervals_cover_over_two_thousand_simulated_cameras():
    photons, exposures = jnp.linspace(500.0, 20_000.0, 12), jnp.linspace(1e-3, 0.05, 12)
    shape = (50, 60, 1)
    take = jax.jit(partial(afternoon, frames=2, shape=shape))
    measurements, responses = [], []
    for key in jax.random.split(KEY, 2000):
        *rows, response = take(key, jax.random.fold_in(key, 1), photons, exposures)
        rows = [np.asarray(row)[:, :2] for row in rows]
        responses.append(float(response))
        measurements.append(
            measurement_of(np.asarray(photons), np.asarray(exposures), *rows, pixels=3000, frames=2)
        )
    standard, likelihood, solution = both_methods(measurements)
    assert np.all(solution.converged)
    for name in ("system_gain", "quantum_efficiency", "responsivity", "read_noise"):
        true = truth(np.array(responses))[name]
        for values, errors in (standard, likelihood):
            value, error = np.asarray(values[name]), np.asarray(errors[name])
            covered = np.abs(np.log(value / true)) < 1.96 * error / value
            assert abs(covered.mean() - 0.95) <= 0.015, name
            assert abs((value - true).mean()) < 4 * (value - true).std() / np.sqrt(2000), name
