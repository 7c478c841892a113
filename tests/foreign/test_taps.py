"""Tests `brdf` and `joint` on photographs through several amplifiers, with the parameters of
each."""

import numpy as np
import pytest
from oracles.sphere_photographs import shade_areas

from fitting import folders, joint
from fitting.inference.posterior import estimates
from fitting.observation import unequal_sites
from fitting.reflectance import Camera, SphereGeometry, from_photographs
from fitting.reflectance.from_images.calibration import calibrate
from fitting.reflectance.from_images.section import section
from jaxvision.files.images import write_image

SIDE, READ = 48, 5.0
GAIN, BLACK = np.array([0.5, 0.6]), np.array([50.0, 58.0])
TRUTH = {"diffuse": 0.3, "specular": 0.4, "exponent": 25.0}
TILTS, TURNS = np.radians([15, 30, 45, 60, 75, 40, 50, 20]), np.radians(np.arange(8) * 137)
LIGHTS = np.stack(
    [np.sin(TILTS) * np.cos(TURNS), np.sin(TILTS) * np.sin(TURNS), np.cos(TILTS)], axis=-1
)
CAMERAS = {
    "columns": ((1, 2), np.arange(SIDE)[None] % 2 + np.zeros((SIDE, 1), int)),
    "halves": ("top and bottom", (np.arange(SIDE)[:, None] >= 24) + np.zeros((1, SIDE), int)),
}


def photographs(tap):
    """Return photographs of a Phong ball by NumPy, where even and odd columns, or halves, have
    different gains and black levels."""
    rng = np.random.default_rng(1)
    images = []
    for shaded in shade_areas(SIDE, SIDE / 2 - 1, LIGHTS, "phong", *TRUTH.values()):
        noisy = rng.poisson(4000 * shaded) + READ * rng.standard_normal(shaded.shape)
        images.append(np.clip(np.round(GAIN[tap] * noisy + BLACK[tap]), 0, 4095).astype(np.uint16))
    return images


@pytest.mark.slow
@pytest.mark.parametrize("kind", CAMERAS)
def test_a_ball_through_two_amplifiers_has_the_right_reflectance(kind):
    taps, tap = CAMERAS[kind]
    known = {"gain": GAIN.tolist(), "black_level": BLACK.tolist(), "read_noise": READ}
    given = {
        "camera": Camera(bits=12, taps=taps, **known),
        "sphere": SphereGeometry(centre=((SIDE - 1) / 2,) * 2, radius=SIDE / 2 - 1),
        "intensities": np.full(8, 4000 * GAIN.mean()),
        "held_out": (5, 6),
    }
    images = photographs(tap)
    of_brdf = section(calibrate(from_photographs(images, LIGHTS, **given), model="phong"))
    together = joint.calibrate(joint.from_photographs(images, LIGHTS, **given), model="phong")
    for found in (of_brdf.estimates, estimates(together.posteriors["grey"])):
        by_name = {one.name: one for one in found}
        for name, true in TRUTH.items():
            assert abs(by_name[name].value - true) < 3.5 * by_name[name].standard_error
    assert "misfit" not in {one.name for one in estimates(together.posteriors["grey"])}


@pytest.mark.parametrize(
    ("cell", "key"),
    [
        ([[1.0, 1.06], [1.0, 1.06]], "camera.taps = [1, 2]"),
        ([[1.0, 1.0], [1.06, 1.06]], "camera.taps = [2, 1]"),
        ([[1.0, 1.2], [1.2, 0.7]], "camera.pattern"),
        ([[1.2, 0.7], [1.0, 1.2]], "camera.pattern"),
        ([[1.0, 1.0], [1.0, 1.0]], ""),
    ],
)
def test_rows_and_columns_of_two_amplifiers_are_no_mosaic(cell, key):
    """The amplifiers are also found in light that rises by 5 % a pixel."""
    light = np.random.default_rng(2).normal(1000, 10, (40, 40)) * 1.05 ** np.arange(40)
    clause, found = unequal_sites(light * np.tile(cell, (20, 20)))
    assert found == key
    assert ("differ by 6 %, as with two amplifiers" in clause) == ("taps" in key)


@pytest.mark.parametrize("kind", [*CAMERAS, ""])
def test_init_states_amplifiers_that_differ(tmp_path, kind):
    """The folder has flats and darks. The last camera has one amplifier."""
    _, tap = CAMERAS.get(kind, (None, np.zeros((SIDE, SIDE), int)))
    rng = np.random.default_rng(3)
    for name, time, light in (("dark", 1, 0), *(("flat", t, 900 * t) for t in (1, 2, 3, 4, 5))):
        for i in range(2):
            electrons = rng.poisson(light, tap.shape) + READ * rng.standard_normal(tap.shape)
            numbers = np.round(GAIN[tap] * electrons + BLACK[tap]).astype(np.uint16)
            write_image(tmp_path / f"{name}_{time}ms_{i}.tif", numbers)
    _, found = folders.init(tmp_path)
    stated = {"columns": "taps = [1, 2]", "halves": 'taps = "top and bottom"', "": ""}[kind]
    written = (tmp_path / "rig.toml").read_text()
    assert stated in written
    assert ("taps" in written) == bool(stated)
    assert any("amplifiers differ" in sentence for sentence in found.missing) == bool(stated)
