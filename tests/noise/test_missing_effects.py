"""Sixty simulated cameras with every effect alone and in pairs: the camera predicts its own frames,
and the effect that its file lacks is named."""

from dataclasses import replace
from itertools import combinations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import binom

import jaxvision as jv
from fitting.noise import Camera, from_frames, predict

PHOTONS, EXPOSURES = np.linspace(240.0, 24_000.0, 12), np.linspace(0.001, 0.02, 12)
CAMERAS, SIZE = 60, 80


def mixing(own):
    side = (1 - own) / 4
    return jv.Mixing([[0, side, 0], [side, own, side], [0, side, 0]])


ABSENT = {  # of one structure, for one compiled program
    "row_noise": 0.0,
    "column_noise": 0.0,
    "nonlinearity": jv.Compression(0.0, electrons=12_000.0),
    "light_offset": 0.0,
    "mixing": mixing(1.0),
    "brighter_fatter": jv.BrighterFatter([[0.0]]),
    "dark_current": 100.0,
    "read_noise": 5.0,
}
PRESENT = {
    "row_noise": 4.0,
    "column_noise": 4.0,
    "nonlinearity": jv.Compression(0.02, electrons=12_000.0),
    "light_offset": 40.0,
    "mixing": mixing(0.96),
    "brighter_fatter": jv.BrighterFatter([[1.5e-6]]),
    "dark_current": 400.0,
    "read_noise": 5.6,
}


@jax.jit
def frame(key, sensor, photons, seconds):
    light = photons / seconds * jnp.ones((SIZE, SIZE, 1))
    return jv.raw_image(key, replace(sensor, exposure_time=seconds), light)[..., 0]


def measured(sensor, seed):
    """Four frames of twelve levels of light and of six of dark, behind a closed shutter."""
    keys = jax.random.split(jax.random.key(seed), (18, 4))
    closed, dark = replace(sensor, light_offset=0.0), EXPOSURES[::2]

    def level(one, keys, photons, seconds):
        return [np.asarray(frame(key, one, photons, seconds)) for key in keys]

    lights = zip(keys, PHOTONS, EXPOSURES, strict=False)
    flats = [level(sensor, own, light, seconds) for own, light, seconds in lights]
    darks = [level(closed, own, 0.0, t) for own, t in zip(keys[12:], dark, strict=True)]
    at = {"camera": Camera(bits=12), "dark_exposures": list(dark)}
    return from_frames(flats, darks, list(EXPOSURES), list(PHOTONS), **at)


@pytest.mark.slow
def test_cameras_of_all_pairs_of_effects_are_predicted_and_what_they_lack_is_named():
    with jax.enable_x64(True):
        plain = jv.Sensor(
            shot_noise=jv.PoissonShotNoise(),
            quantum_efficiency=0.5,
            gain=0.25,
            offset=64.0,
            bits=12,
            **ABSENT,
        )
        alone, pairs = [(one,) for one in PRESENT], list(combinations(PRESENT, 2))
        inside, named = {}, []
        for n, own in enumerate((2 * alone + 2 * pairs)[:CAMERAS]):
            truth = replace(plain, **{name: PRESENT[name] for name in own})
            made = measured(truth, n)
            for quantity, one in predict(truth, made).judged.agreement.items():
                inside.setdefault(quantity, []).append(one.p_value > 0.01)
            lacking = own[n % len(own)]
            found = predict(replace(truth, **{lacking: ABSENT[lacking]}), made)
            key = {"nonlinearity": "compression"}.get(lacking, lacking)
            named.append(key in [one.key for one in found.missing])
    fewest, _ = binom.interval(0.99, CAMERAS, 0.99)
    assert {name: sum(held) for name, held in inside.items() if sum(held) < fewest} == {}
    assert len(inside) == 3
    assert sum(named) >= 0.9 * CAMERAS
