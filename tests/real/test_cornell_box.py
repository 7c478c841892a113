"""Tests the Cornell box from its measured spectra, converted to colours, and rendered band by
band."""

import jax
import numpy as np
import pytest
from oracles import cornell_box

from jaxvision.files.scenes import read_scene
from jaxvision.files.scenes.bands import Bands, reduction
from jaxvision.rendering import render

TABLE = "reflectance_and_light.csv"
SURFACES = ("white", "green", "red")


@pytest.fixture(scope="module")
def table(data_folder):
    """Return the columns by name, with nm in the first."""
    return np.genfromtxt(data_folder / "cornell_box" / TABLE, delimiter=",", names=True)


def scene_text(folder):
    """Return the box's back wall, green wall and red wall under its lamp, all with measured
    spectra."""

    def spectrum(column):
        return f'{{file = "{folder / "cornell_box" / TABLE}", column = "{column}"}}'

    materials = "".join(
        f'[material.{name}]\nfamily = "lambert"\nalbedo = {spectrum(name)}\n' for name in SURFACES
    )
    walls = zip(("white", "green", "red"), (2, 3, 4), strict=True)
    surfaces = "".join(
        f'[[surface]]\nname = "{name}"\nshape = "quad"\nmaterial = "{name}"\n'
        + "".join(
            f"{key} = {[float(x) for x in value]}\n"
            for key, value in zip(("corner", "edge_u", "edge_v"), cornell_box.FACES[i], strict=True)
        )
        for name, i in walls
    )
    return f"""
wavelengths = {{first = 400, last = 700, step = 10}}
[camera]
kind = "pinhole"
position = [0.278, 0.273, -0.8]
target = [0.278, 0.273, 0.0]
up = [0, 1, 0]
resolution = [24, 24]
focal_length = 0.035
pixel_pitch = 1.0416667e-3
{materials}{surfaces}
[[light]]
name = "lamp"
kind = "point"
position = [0.278, 0.4, 0.2]
intensity = {spectrum("light_linear_interp")}
"""


@pytest.fixture(scope="module")
def spectral(tmp_path_factory, data_folder):
    """Return the scene at 31 wavelengths, and its picture."""
    file = tmp_path_factory.mktemp("cornell") / "box.toml"
    file.write_text(scene_text(data_folder))
    source = read_scene(file)
    return source, np.asarray(jax.jit(render)(source.scene, source.view))


@pytest.mark.slow
def test_bands_interpolate_the_table(spectral, table):
    source, _ = spectral
    nm = np.arange(400, 701, 10)
    for surface, name in zip(source.scene.surfaces, SURFACES, strict=True):
        expected = np.interp(nm, table["wavelength_nm"], table[name]) / np.pi
        np.testing.assert_allclose(surface.material.diffuse, expected, rtol=1e-5)
    known, power = table["wavelength_nm"], table["light_linear_interp"]
    expected = []  # light is the mean over the covered part of each band
    for low in nm - 5:
        fine = np.linspace(max(low, known.min()), min(low + 10, known.max()), 20_001)
        expected.append(np.interp((fine[1:] + fine[:-1]) / 2, known, power).mean())
    np.testing.assert_allclose(source.scene.lights[0].intensity, expected, rtol=1e-5, atol=1e-6)


def test_every_band_of_the_picture_is_geometry_times_spectra(spectral, table):
    """With a single reflection each pixel is (paint x lamp)(lambda) times a number that is equal in
    all bands."""
    _, picture = spectral
    nm = np.arange(400, 701, 10)
    lamp = np.interp(nm, table["wavelength_nm"], table["light_linear_interp"])
    pixels = picture.reshape(-1, len(nm))
    spectra = [np.interp(nm, table["wavelength_nm"], table[name]) * lamp for name in SURFACES]
    directions = np.stack([s / np.linalg.norm(s) for s in spectra])
    lit = np.linalg.norm(pixels, axis=1) > 0
    cosines = pixels[lit] @ directions.T / np.linalg.norm(pixels[lit], axis=1, keepdims=True)
    np.testing.assert_allclose(cosines.max(axis=1), 1, atol=1e-5)
    assert set(cosines.argmax(axis=1)) == {0, 1, 2}  # all three walls are visible


@pytest.mark.slow
def test_the_published_rgb_colours_follow_from_these_spectra(table):
    """Mitsuba's RGB values of the box are from the same measurements."""
    matrix = reduction(table["wavelength_nm"] * 1e-9, Bands(3), quantity="light")
    published = (cornell_box.WHITE, cornell_box.GREEN, cornell_box.RED)
    for name, rgb in zip(SURFACES, published, strict=True):
        np.testing.assert_allclose(table[name] @ matrix, rgb, atol=7e-4)


def test_colours_are_integrals_over_all_rows(spectral, table):
    """x and y of each wall, from the picture at 31 wavelengths, equal the sum of paint times lamp
    times observer over the 76 rows of the table, except for the steps of 10 nm."""
    import colour

    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    _, picture = spectral
    pixels = picture[picture.sum(axis=-1) > 0]
    seen = chromaticity(pixels @ observer[np.arange(400.0, 701.0, 10.0)])
    paints = np.stack([table[name] * table["light_linear_interp"] for name in SURFACES])
    expected = chromaticity(paints @ observer[table["wavelength_nm"]])
    distances = np.linalg.norm(seen[:, None] - expected, axis=-1)
    assert distances.min(axis=1).max() < 2e-3
    assert set(distances.argmin(axis=1)) == {0, 1, 2}


def chromaticity(xyz):
    return xyz[:, :2] / xyz.sum(axis=-1, keepdims=True)
