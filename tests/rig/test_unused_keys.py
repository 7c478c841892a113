"""Tests that each key of a rig changes what a calibration fits, or is reported as unused."""

import dataclasses

import numpy as np
import pytest

from fitting.joint.model import parameters
from fitting.joint.read import read_joint_measurement
from fitting.noise.read import reduce_rig
from fitting.reflectance.from_images.read import read_reflectance_observation
from fitting.reflectance.from_images.signal import Form
from fitting.report.unused_keys import unused_keys
from fitting.response.read import read_exposure_stack
from fitting.rig import Rig

RNG = np.random.default_rng(0)
IMAGES = {f"{i}.tif": RNG.integers(40, 200, (12, 12)).astype(np.uint8) for i in range(12)}
FILES = list(IMAGES)
CAMERA = {
    "bits": 8,
    "black_level": 20.0,
    "saturation": 250.0,
    "gamma": 2.0,
    "gain": 0.5,
    "read_noise": 3.0,
    "pixel_pitch": 5e-6,
    "wavelength": 5e-7,
    "black_sd": 0.5,
    "gamma_sd": 0.1,
    "gain_sd": 0.02,
    "read_noise_sd": 0.2,
    "prnu_sd": 0.01,
}
LIGHT = {"intensity_sd": 0.01, "direction_sd": 0.02, "exposure_sd": 0.03, "stray_sd": 0.04}
KEYS = [f"camera.{key}" for key in CAMERA if key != "bits"] + [f"light.{key}" for key in LIGHT]
KEYS += ["exposure.exposure_sd", "flat.irradiance"]


def rig_of(key="", *, without=()):
    """Return a rig that states everything, with one key larger by 1 %."""
    section, _, name = key.partition(".")

    def entry(own, **given):
        given = {k: v for k, v in given.items() if f"{own}.{k}" not in without}
        return given | ({name: given[name] * 1.01} if own == section and name in given else {})

    times = (0.1, 0.2, 0.4, 0.8)
    return Rig.model_validate(
        {
            "folder": ".",
            "camera": entry("camera", **CAMERA),
            "flat": [
                entry("flat", files=FILES[2 * i : 2 * i + 2], exposure=t, irradiance=1e-3)
                for i, t in enumerate(times)
            ],
            "dark": [entry("dark", files=FILES[8:10], exposure=0.1)],
            "exposure": [
                entry("exposure", file=name, exposure=t, exposure_sd=0.01)
                for name, t in zip(FILES, times, strict=False)
            ],
            "light": [
                entry("light", file=name, direction=(0.0, 0.6, 0.8), **LIGHT) for name in FILES[:3]
            ],
            "geometry": {"sphere": {"centre": (5.5, 5.5), "radius": 6.0}},
        }
    )


def load(path):
    return IMAGES[path.name]


def flats(rig, *, load):
    """Return the data that a noise calibration fits. Stated values are only compared with its
    results."""
    return dataclasses.replace(reduce_rig(rig, load=load), stated=())


def photographs(rig, *, load):
    """Return the data that a reflectance calibration uses, without the camera's own record."""
    return dataclasses.replace(read_reflectance_observation(rig, load=load), camera=None)


def joint_photographs(rig, *, load):
    measured = read_joint_measurement(rig, load=load)
    start = {} if measured.gamma is None else {"gamma": 2.0}
    told = parameters(measured, 0, Form("phong"), start)
    return dataclasses.replace(measured, camera=None), told


READ = {
    "noise": flats,
    "response": read_exposure_stack,
    "brdf": photographs,
    "joint": joint_photographs,
}


def numbers(x):
    """Return all numbers and names of nested records as text."""
    if dataclasses.is_dataclass(x):
        return [numbers(getattr(x, field.name)) for field in dataclasses.fields(x)]
    if isinstance(x, dict):
        return [(key, numbers(value)) for key, value in x.items()]
    if isinstance(x, tuple | list):
        return [numbers(value) for value in x]
    return str(np.asarray(x).tolist()) if hasattr(x, "shape") else repr(x)  # NaN equals NaN


@pytest.mark.sweep
@pytest.mark.parametrize("kind", READ)
def test_every_key_not_reported_as_unused_changes_the_fit(kind):
    """Each key of the sections that a command reads is changed by 1 %."""
    rig = rig_of()
    told = " ".join(unused_keys(rig, kind))
    read = READ[kind]
    before = numbers(read(rig, load=load))
    own = {"noise": ("flat",), "response": ("exposure",), "brdf": ("light",)}
    for key in KEYS:
        if key.split(".")[0] not in ("camera", *own.get(kind, ("flat", "light"))):
            continue
        changed = numbers(read(rig_of(key), load=load)) != before
        assert changed != (f"{key};" in told or f"{key}," in told or f"{key} and" in told), key


@pytest.mark.parametrize(
    ("kind", "without", "sentence"),
    [
        ("brdf", ("camera.read_noise", "camera.read_noise_sd"), "without both gain and read noise"),
        ("joint", ("camera.black_level", "camera.gamma", "camera.gamma_sd"), "the darks give"),
        (
            "brdf",
            ("camera.prnu_sd",),
            "camera.gain_sd and camera.read_noise_sd; to first order they",
        ),
    ],
)
def test_the_reason_for_an_unused_key_is_given(kind, without, sentence):
    assert sentence in " ".join(unused_keys(rig_of(without=without), kind))


def test_a_fitted_exponent_replaces_the_rigs():
    told = unused_keys(rig_of(), "joint", fit_gamma=True)
    assert told[-1] == (
        "Not used of the rig: camera.gamma and camera.gamma_sd; the encoding exponent was fitted."
    )


def test_a_rig_without_unused_keys_has_no_report():
    left = ("bits", "black_level", "saturation", "gain", "read_noise")
    without = tuple(f"camera.{key}" for key in CAMERA if key not in left)
    rig = rig_of(without=without).model_copy(update={"flat": (), "dark": ()})
    assert unused_keys(rig, "brdf") == ()
