"""Tests sixty simulated cameras with every effect alone and in pairs: the calibrated camera
predicts its own frames, and an effect that its file lacks is named."""

from dataclasses import replace
from itertools import combinations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import binom

import jaxvision as jv
from fitting.noise import (
    Camera,
    FramesOfSetting,
    Setting,
    calibrate,
    calibrate_settings,
    from_frames,
    predict,
    sensor_at,
)
from fitting.noise.across_settings.prediction import predict_settings

PHOTONS, EXPOSURES = np.linspace(240.0, 24_000.0, 12), np.linspace(0.001, 0.02, 12)
CAMERAS, SIZE = 60, 80


def mixing(own):
    side = (1 - own) / 4
    return jv.Mixing([[0, side, 0], [side, own, side], [0, side, 0]])


ABSENT = {  # of one structure, for a single program
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


def plain_sensor(**own):
    return jv.Sensor(
        shot_noise=jv.PoissonShotNoise(),
        quantum_efficiency=0.5,
        gain=0.25,
        offset=64.0,
        bits=12,
        **ABSENT | own,
    )


@jax.jit
def frame(key, sensor, photons, seconds):
    light = photons / seconds * jnp.ones((SIZE, SIZE, 1))
    return jv.raw_image(key, replace(sensor, exposure_time=seconds), light)[..., 0]


def measured(sensor, seed):
    """Return the calibration data: four frames of twelve light levels and of six dark levels with a
    closed shutter."""
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
def test_cameras_of_all_pairs_of_effects_are_predicted_and_missing_ones_named():
    with jax.enable_x64(True):
        plain = plain_sensor()
        alone, pairs = [(one,) for one in PRESENT], list(combinations(PRESENT, 2))
        inside, named = {}, []
        for n, own in enumerate((2 * alone + 2 * pairs)[:CAMERAS]):
            truth = replace(plain, **{name: PRESENT[name] for name in own})
            made = measured(truth, n)
            for quantity, one in predict(truth, made).main_comparison.agreement.items():
                inside.setdefault(quantity, []).append(one.p_value > 0.01)
            lacking = own[n % len(own)]
            found = predict(replace(truth, **{lacking: ABSENT[lacking]}), made)
            key = {"nonlinearity": "compression"}.get(lacking, lacking)
            named.append(key in [one.key for one in found.missing])
    fewest, _ = binom.interval(0.99, CAMERAS, 0.99)
    assert {name: sum(held) for name, held in inside.items() if sum(held) < fewest} == {}
    assert len(inside) == 3
    assert sum(named) >= 0.9 * CAMERAS


@pytest.mark.slow
@pytest.mark.parametrize(
    ("own", "term"),
    [
        (("row_noise", "mixing"), "pixel_mixing"),
        (("column_noise", "mixing"), "pixel_mixing"),
        (("brighter_fatter", "read_noise"), "brighter_fatter"),
    ],
)
def test_noise_shared_by_neighbours_is_found_with_other_noise(own, term):
    """Without the term, the gain is too small by 4 to 8 %, 7 to 27 standard errors."""
    with jax.enable_x64(True):
        truth = plain_sensor(**{name: PRESENT[name] for name in own})
        found = calibrate(measured(truth, 5018))
        assert term in {parameter.name for parameter in found.chosen.space}
        gain = found.estimates["system_gain"]
        off, error = gain.value - 0.25, gain.standard_error
        assert abs(off) < 3 * error < 0.025
        later = predict(found, measured(truth, 9018)).main_comparison.agreement
    assert min(one.p_value for one in later.values()) > 1e-3
    assert len(later) == 3


OVER_SETTINGS = {
    "row_noise": 7.5,
    "column_dsnu": 12.0,
    "frame_noise": 4.0,
    "full_well": 14_000.0,
    "nonlinearity": PRESENT["nonlinearity"],
    "light_offset": 40.0,
    "mixing": PRESENT["mixing"],
    "brighter_fatter": PRESENT["brighter_fatter"],
}
KEYS = {
    "nonlinearity": ("compression",),
    "frame_noise": ("black_scatter",),
    "mixing": ("mixing", "sharing"),
}


@pytest.mark.slow
def test_the_camera_over_settings_has_the_effects_of_each():
    """A column offset and a full well change no mean and no variance below saturation, so only the
    file can name them."""
    die = jax.random.key(3)

    @jax.jit
    def shot(key, sensor, photons, seconds):
        light = photons / seconds * jnp.ones((SIZE, SIZE, 1))
        own = replace(sensor, exposure_time=seconds)
        return jv.raw_image(key, own, light, die_key=die)[..., 0]

    def taken(sensor, seed, photons):
        """Return fourteen light levels, two of which fill the well, and six dark levels."""
        keys = jax.random.split(jax.random.key(seed), (20, 4))
        closed, times = replace(sensor, light_offset=0.0), np.linspace(0.001, 0.024, 14)
        dark = times[::3][:5]
        lit = [
            [np.asarray(shot(key, sensor, *at)) for key in own]
            for own, at in zip(keys, zip(photons, times, strict=True), strict=False)
        ]
        unlit = [
            [np.asarray(shot(key, closed, 0.0, t)) for key in own]
            for own, t in zip(keys[14:], dark, strict=False)
        ]
        at = {"camera": Camera(bits=12), "dark_exposures": list(dark)}
        return from_frames(lit, unlit, list(times), list(photons), **at)

    named, right = [], []
    with jax.enable_x64(True):
        none = {"column_dsnu": 0.0, "frame_noise": 0.0, "full_well": 1e9}
        plain = plain_sensor(**none)
        for n, (name, size) in enumerate(OVER_SETTINGS.items()):
            truth, frames = replace(plain, **{name: size}), []
            for decibel, top in ((0.0, 23_800.0), (6.0, 12_000.0)):
                sensor = replace(truth, gain=0.25 * 10 ** (decibel / 20))
                photons = np.append(np.linspace(0.02, 1, 12), [1.25, 1.35]) * top
                own = Setting(decibel, "dB", 293.0)
                frames.append(FramesOfSetting(own, taken(sensor, 10 * n + int(decibel), photons)))
            camera = calibrate_settings(frames)
            right.append(not any(one.main_comparison.missed for one in predict_settings(camera)))
            best, _ = sensor_at(camera, gain=0.0)
            if name in ("column_dsnu", "full_well"):
                named.append(abs(float(getattr(best, name)) / size - 1) < 0.2)
                continue
            missing = predict(replace(best, **{name: None}), frames[0].frames).missing
            named.append(bool({one.key for one in missing} & {*KEYS.get(name, (name,))}))
    assert sum(named) == len(OVER_SETTINGS)
    assert sum(right) >= len(OVER_SETTINGS) - 1
