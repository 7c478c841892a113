"""Tests spectra as written by instruments and others: lamps with lines, other units, columns by
name."""

import warnings
from pathlib import Path

import colour
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.constants import c, h, k
from scipy.stats import norm

import jaxvision as jv
from jaxvision.colour_spaces.colour_data import illuminant
from jaxvision.errors import InputError
from jaxvision.files.scenes.bands import Bands, Tabulated, band_values, bands_of
from jaxvision.files.scenes.folder import Folder
from jaxvision.files.scenes.spectrum_tables import read_table
from jaxvision.spectra import (
    band_widths,
    blackbody,
    integrate_spectrum,
    reflectance_to_xyz,
    spectrum_to_camera,
    spectrum_to_xyz,
)

RGB = Bands(3)
TENS = np.arange(400, 701, 10.0)  # nm
IN_TENS = Bands(len(TENS), TENS * 1e-9)
# A compact fluorescent lamp: mercury and phosphor lines in W m^-2 over a weak continuum.
LINES, FLOOR = {435.83: 30.0, 546.07: 60.0, 611.3: 50.0}, 0.01
# The inverse of the matrix of primaries and white defined by IEC 61966-2-1.
TO_SRGB = np.array(
    [
        [3.2404542, -1.5371385, -0.4985314],
        [-0.969266, 1.8760108, 0.041556],
        [0.0556434, -0.2040259, 1.0572252],
    ]
)


def lamp(nm, width=0.1):
    peaks = [
        power * np.exp(-0.5 * ((nm - at) / width) ** 2) / (width * np.sqrt(2 * np.pi))
        for at, power in LINES.items()
    ]
    return FLOOR + sum(peaks)


def written(folder, heads, *columns, start=""):
    rows = [",".join(f"{x:.9g}" for x in row) for row in zip(*columns, strict=True)]
    (folder / "s.csv").write_text(start + "\n".join([heads, *rows]) + "\n", encoding="utf-8")
    return folder / "s.csv"


def seen(folder, bands, quantity, **source):
    table = Tabulated(**(source or {"file": "s.csv"}))
    return band_values(table, bands, Folder(Path(folder) / "scene.toml"), quantity=quantity)


def test_lines_of_a_lamp_are_integrated_in_rgb(tmp_path):
    """Each line is weighted by the observer at its wavelength, whatever the steps of the file."""
    nm = np.arange(380, 780.05, 0.1)
    written(tmp_path, "wavelength,W", nm, lamp(nm))
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    tables = observer.values.T
    xyz = np.array([FLOOR * one.sum() for one in tables])
    for at, power in LINES.items():
        xyz += power * np.array([np.interp(at, observer.wavelengths, one) for one in tables])
    expected = TO_SRGB @ xyz / tables[1].sum()
    np.testing.assert_allclose(seen(tmp_path, RGB, "light"), expected, rtol=1e-3)


@pytest.mark.parametrize("step", [0.1, 1.0])
def test_no_light_of_lines_is_lost_between_bands(tmp_path, step):
    nm = np.arange(390, 710 + step / 2, step)
    width = max(0.1, 2 * step)
    wide = lamp(nm, width=width)  # what an instrument of this step measures
    written(tmp_path, "wavelength,W", nm, wide)
    found = seen(tmp_path, IN_TENS, "light")
    expected = np.full(len(TENS), FLOOR)
    for at, power in LINES.items():
        low, high = (norm.cdf(TENS + half, at, width) for half in (-5, 5))
        expected += power / 10 * (high - low)
    np.testing.assert_allclose(found, expected, rtol=0.01, atol=0.03)
    np.testing.assert_allclose(found.sum() * 10, sum(LINES.values()) + 310 * FLOOR, rtol=1e-4)


def test_light_given_at_the_bands_is_unchanged():
    pairs = [[nm, 1 + (nm % 7)] for nm in TENS]
    found = seen(".", IN_TENS, "light", pairs=pairs)
    np.testing.assert_allclose(found, np.array(pairs)[:, 1], rtol=1e-9)


def test_a_fluorescent_lamp_of_the_cie_keeps_its_lines():
    """FL2 has lines at 405, 435, 545 and 580 nm, between the bands of 10 nm."""
    table = colour.SDS_ILLUMINANTS["FL2"]
    found = seen(".", IN_TENS, "light", illuminant="FL2")
    fine = np.linspace(395, 705, 310_001)
    power = np.interp(fine, table.wavelengths, table.values)
    total = np.sum((power[1:] + power[:-1]) / 2) * 1e-3
    np.testing.assert_allclose(found.sum() * 10, total, rtol=1e-4)
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    each = np.stack([np.interp(fine, observer.wavelengths, one) for one in observer.values.T])
    power = np.interp(fine, table.wavelengths, table.values)
    expected = TO_SRGB @ (each @ power * 1e-3) / observer.values[:, 1].sum()
    np.testing.assert_allclose(seen(".", RGB, "light", illuminant="fl2"), expected, rtol=2e-3)
    with pytest.raises(InputError, match="350 to 690 nm, and RGB takes"):
        seen(".", RGB, "light", illuminant="ISO 7589 Photographic Daylight")


def test_names_of_illuminants_in_any_case():
    at = np.array([450e-9, 790e-9])
    np.testing.assert_array_equal(illuminant("d65", at), illuminant("D65", at))
    lower, upper = (seen(".", RGB, "light", illuminant=name) for name in ("d65", "D65"))
    np.testing.assert_array_equal(lower, upper)


NM = np.arange(380, 781, 5.0)
STEP = 0.1 + 0.8 * (NM > 580)


@pytest.mark.parametrize(
    ("head", "along", "values"),
    [
        ("Wavelength_um", NM / 1e3, STEP),
        ("wavelength (µm)", NM / 1e3, STEP),
        ("wavelength [m]", NM * 1e-9, STEP),
        ("angstrom", NM * 10, STEP),
        ("lambda_nm", NM, STEP),
        ("wavenumber_cm-1", 1e7 / NM[::-1], STEP[::-1]),
    ],
)
def test_a_unit_in_the_header_is_used(tmp_path, head, along, values):
    file = written(tmp_path, f"{head},reflectance", along, values)
    metres, found = read_table(file, None, "reflectance")
    np.testing.assert_allclose(metres, NM * 1e-9, rtol=1e-7)
    np.testing.assert_array_equal(found, STEP)


@pytest.mark.parametrize("factor", [1e-3, 1e-9, 10.0])
@pytest.mark.parametrize("quantity", ["reflectance", "light"])
@pytest.mark.parametrize("bands", [RGB, IN_TENS])
def test_a_table_beyond_all_bands_is_refused(tmp_path, factor, quantity, bands):
    written(tmp_path, "wavelength,value", NM * factor, STEP)
    with pytest.raises(InputError, match="covers none of the wavelengths"):
        seen(tmp_path, bands, quantity)
    pairs = [[nm * factor, value] for nm, value in zip(NM, STEP, strict=True)]
    with pytest.raises(InputError, match="in nm"):
        seen(tmp_path, bands, quantity, pairs=pairs)


def test_light_by_wavenumber_or_energy_is_refused(tmp_path):
    for head in ("wavenumber_cm-1", "energy (eV)"):
        file = written(tmp_path, f"{head},irradiance", 1e7 / NM[::-1], STEP)
        with pytest.raises(InputError, match="is no wavelength"):
            read_table(file, None, "light")


def test_wavelengths_of_a_scene_in_um_are_refused():
    with pytest.raises(InputError, match=r"are in nm, got 0\.7"):
        bands_of(None, (0.4, 0.5, 0.7))


@pytest.mark.parametrize(
    ("heads", "columns"),
    [
        ("wavelength,uncertainty,reflectance", [NM, 0 * NM + 0.002, STEP]),
        (",wavelength,reflectance", [np.arange(len(NM)), NM, STEP]),
        ("wavelength,R,R_std", [NM, STEP, 0 * NM + 0.002]),
        ("index,R,wl", [np.arange(len(NM)), STEP, NM]),
        ('"wavelength","R, measured"', [NM, STEP]),
        ("wavelength,%R", [NM, 100 * STEP]),
        ("wavelength,temperature,reflectance", [NM, 0 * NM + 300, STEP]),
    ],
)
def test_columns_are_chosen_by_name(tmp_path, heads, columns):
    start = "# instrument X\n" if "R_std" in heads else ""
    metres, found = read_table(written(tmp_path, heads, *columns, start=start), None, "reflectance")
    np.testing.assert_allclose(metres, NM * 1e-9)
    np.testing.assert_allclose(found, STEP)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("380,0.1\n385,0.2\n390,0.3\n", "holds numbers and no heads"),
        ("wavelength,before,after\n400,1,2\n500,1,2\n", "'before', 'after' holds the spectrum"),
        (",R\n0,.1\n1,.2\n", "none of its columns '', 'R' is named as wavelengths"),
        ("wavelength;R\n400,5;0,1\n", "separate them by commas"),
        ("wavelength,R_std\n400,.1\n500,.1\n", "name it"),
    ],
)
def test_ambiguous_headers_are_refused(tmp_path, text, sentence):
    (tmp_path / "s.csv").write_text(text)
    with pytest.raises(InputError, match=sentence):
        read_table(tmp_path / "s.csv", None, "reflectance")


def test_a_saturated_reflectance_is_clipped_to_srgb(tmp_path):
    """The reflectance is a filter with 0.1 and 0.9, a physical one, whose red is outside the gamut
    of sRGB."""
    written(tmp_path, "wavelength,R", NM, STEP)
    with pytest.warns(UserWarning, match=r"\(1\.04, 0\.11.*cut; give the scene wavelengths"):
        found = seen(tmp_path, RGB, "reflectance")
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    fine = observer.wavelengths
    weight = observer.values * np.interp(fine, *_d65())[:, None]
    xyz = np.interp(fine, NM, STEP) @ weight / weight[:, 1].sum()
    expected = TO_SRGB @ xyz
    assert expected[0] > 1.03
    np.testing.assert_allclose(found, [1, *expected[1:]], atol=2e-3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        np.testing.assert_allclose(
            seen(".", RGB, "reflectance", pairs=[[400, 1.0], [700, 1.0]]), 1, atol=1e-3
        )


def _d65():
    table = colour.SDS_ILLUMINANTS["D65"]
    return table.wavelengths, table.values


def test_a_table_in_metres_is_read():
    observer = np.ones((3, 3))
    for of in (
        lambda wl: integrate_spectrum(np.ones(3), wl),
        lambda wl: spectrum_to_xyz(np.ones(3), wl, observer),
        lambda wl: reflectance_to_xyz(np.ones(3), wl, observer, np.ones(3)),
    ):
        for wl in ([400.0, 500, 600], [0.4, 0.5, 0.6], [4000.0, 5000, 6000]):
            with pytest.raises(ValueError, match="metres"):
                of(np.array(wl))
    with pytest.raises(ValueError, match="in metres, got 500"):
        band_widths(np.array([400.0, 500, 600]))
    with pytest.raises(ValueError, match="in metres, got 500"):
        spectrum_to_camera(np.ones(3), np.array([400.0, 500, 600]), observer)
    with pytest.raises(ValueError, match="an observer sees"):
        spectrum_to_xyz(np.ones(3), np.array([400e-6, 500e-6, 600e-6]), observer)


@pytest.mark.slow
def test_radio_waves_have_a_black_body():
    with pytest.warns(UserWarning, match="in metres, got 0.9, a radio wave"):
        found = blackbody(np.array([0.9]), 3.0)
    planck = 2 * h * c**2 / 0.9**5 / np.expm1(h * c / (0.9 * k * 3))
    np.testing.assert_allclose(found, planck, rtol=1e-6)
    long = np.geomspace(1e-7, 0.1, 4000)
    with pytest.warns(UserWarning, match="a radio wave"):
        total = integrate_spectrum(blackbody(long, 300.0), long)
    np.testing.assert_allclose(total * np.pi, 5.670374e-8 * 300**4, rtol=1e-3)


def test_a_reflectance_in_per_cent_is_named():
    grid = jv.colour_spaces.wavelength_grid(step=20e-9)
    light, eye = jv.colour_spaces.illuminant("D65", grid), jv.colour_spaces.observer(grid)
    with pytest.warns(UserWarning, match="up to 50, where 1 is white: divide per cent by 100"):
        jv.spectra.reflectance_to_xyz(jnp.full(grid.shape, 50.0), grid, eye, light)
    jv.spectra.reflectance_to_xyz(jnp.full(grid.shape, 1.5), grid, eye, light)
