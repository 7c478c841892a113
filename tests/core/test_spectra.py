"""Tests spectra against colour-science, published tables and quadrature with many digits, and the
tables of `colour_data` against the library that they come from."""

import colour
import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest

from jaxvision import InputError, spectra
from jaxvision.colour_spaces import colour_data

NM = np.arange(380, 785, 5.0)
GRID = colour_data.nanometres(NM)
SHAPE = colour.SpectralShape(380, 780, 5)
RNG = np.random.default_rng(4)


def test_grids():
    np.testing.assert_allclose(colour_data.wavelength_grid(), GRID, rtol=1e-14)
    assert colour_data.wavelength_grid(first=4e-7, last=7e-7, step=1e-8).shape == (31,)
    for bad in (3e-9, 0.0, -5e-9):
        with pytest.raises(InputError, match="whole number of steps"):
            colour_data.wavelength_grid(step=bad)


# ------------------------------------------------ conversions


@pytest.mark.slow
def test_patches_to_xyz_as_colour_science():
    """All 24 patches under D65 equal colour-science's `sd_to_XYZ_integration`, which uses the CIE's
    summation."""
    ours = spectra.reflectance_to_xyz(
        colour_data.chart_reflectances(GRID),
        GRID,
        colour_data.observer(GRID),
        colour_data.illuminant("D65", GRID),
    )
    cmfs = colour.MSDS_CMFS[colour_data.OBSERVER].copy().align(SHAPE)
    lamp = colour.SDS_ILLUMINANTS["D65"].copy().align(SHAPE)
    theirs = [
        colour.colorimetry.sd_to_XYZ_integration(patch.copy().align(SHAPE), cmfs, lamp) / 100
        for patch in colour.SDS_COLOURCHECKERS["ColorChecker N Ohta"].values()
    ]
    assert len(theirs) == 24
    np.testing.assert_allclose(ours, theirs, rtol=1e-10)


def test_emission_to_xyz_as_colour_science():
    """Absolute values of a lamp, with K_m = 683 lm / W."""
    radiance = colour_data.illuminant("A", GRID)
    ours = spectra.spectrum_to_xyz(radiance, GRID, colour_data.observer(GRID))
    cmfs = colour.MSDS_CMFS[colour_data.OBSERVER].copy().align(SHAPE)
    lamp = colour.SDS_ILLUMINANTS["A"].copy().align(SHAPE)
    theirs = colour.colorimetry.sd_to_XYZ_integration(lamp, cmfs, k=683) * 1e-9
    np.testing.assert_allclose(ours, theirs, rtol=1e-10)


def test_camera_as_a_loop_of_quadrature():
    """The reference sums each band and channel in a loop, with colour-science's tables."""
    lamp = colour.SDS_ILLUMINANTS["D65"]
    camera = colour.MSDS_CAMERA_SENSITIVITIES["Nikon 5100 (NPL)"]
    nm = np.arange(400, 705, 5.0)
    grid = colour_data.nanometres(nm)
    patches = colour_data.chart_reflectances(grid)
    light = patches * colour_data.illuminant("D65", grid)[None]
    ours = spectra.spectrum_to_camera(
        light, grid, colour_data.camera_sensitivities("Nikon 5100 (NPL)", grid)
    )
    chart = list(colour.SDS_COLOURCHECKERS["ColorChecker N Ohta"].values())
    theirs = np.zeros((24, 3))
    of_chart = [[float(patch[wavelength]) for wavelength in nm] for patch in chart]
    of_lamp = [float(lamp[wavelength]) for wavelength in nm]
    of_camera = [camera[wavelength] for wavelength in nm]
    for p in range(24):
        for c in range(3):
            for i in range(len(nm)):
                theirs[p, c] += of_chart[p][i] * of_lamp[i] * float(of_camera[i][c]) * 5e-9
    np.testing.assert_allclose(ours, theirs, rtol=1e-10)


def test_white_point_of_d65():
    """The perfect diffuser under D65 has x = 0.31272 and y = 0.32903 (CIE 15:2018, table 3)."""
    white = spectra.reflectance_to_xyz(
        jnp.ones_like(GRID), GRID, colour_data.observer(GRID), colour_data.illuminant("D65", GRID)
    )
    np.testing.assert_allclose(white[:2] / white.sum(), [0.31272, 0.32903], atol=6e-6)
    np.testing.assert_allclose(white[1], 1, rtol=1e-14)
    # the published chromaticity has four decimals, which is 5e-5 / 0.329 for a Z of 1.09
    np.testing.assert_allclose(white, colour_data.white_point("D65"), atol=5e-4)


def test_three_bands_are_a_spectrum():
    """The same functions work for RGB, as three bands of unit width."""
    grid = jnp.asarray([1.0, 2.0, 3.0])
    matrix = jnp.asarray(RNG.uniform(size=(3, 3)))
    rgb = jnp.asarray(RNG.uniform(size=(4, 5, 3)))
    np.testing.assert_allclose(
        spectra.spectrum_to_camera(rgb, grid, matrix), np.asarray(rgb) @ np.asarray(matrix)
    )


@pytest.mark.slow
def test_widths_and_integral():
    grid = jnp.asarray([1.0, 2.0, 4.0, 5.0])
    np.testing.assert_array_equal(spectra.band_widths(grid), [1, 1.5, 1.5, 1])
    np.testing.assert_allclose(spectra.integrate_spectrum(jnp.ones(4), grid), 5.0)
    # for a smooth curve that is zero at both ends the sum converges to the integral
    fine = jnp.linspace(0.0, 1.0, 401)
    hump = jnp.sin(jnp.pi * fine) ** 2
    np.testing.assert_allclose(spectra.integrate_spectrum(hump, fine), 0.5, rtol=1e-12)
    with pytest.raises(ValueError, match="at least two values, got 1"):
        spectra.band_widths(jnp.ones(1))


# ------------------------------------------------ interpolation


@pytest.mark.slow
def test_sprague_as_colour_science():
    nm, wanted = np.arange(400.0, 481.0, 10.0), np.linspace(400.0, 480.0, 97)
    values = RNG.uniform(size=(2, len(nm)))
    ours = spectra.interpolate_spectrum(
        jnp.asarray(values),
        colour_data.nanometres(nm),
        colour_data.nanometres(wanted),
        method="sprague",
    )
    theirs = [colour.SpragueInterpolator(nm, row)(wanted) for row in values]
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-11)


@pytest.mark.slow
def test_linear_as_numpy_and_both_ends():
    known = jnp.asarray([4.0, 4.7, 5.1, 6.0]) * 1e-7
    wanted = jnp.asarray([3.5, 4.0, 4.3, 5.1, 5.7, 6.0, 6.5]) * 1e-7
    values = jnp.asarray(RNG.uniform(0.1, 1, size=(3, 4)))
    clamped = [np.interp(wanted, known, row) for row in np.asarray(values)]
    ended = [np.interp(wanted, known, row, left=0, right=0) for row in np.asarray(values)]
    np.testing.assert_allclose(spectra.interpolate_spectrum(values, known, wanted), clamped)
    np.testing.assert_allclose(
        spectra.interpolate_spectrum(values, known, wanted, outside="zero"), ended
    )


def test_bad_interpolation_is_named():
    grid, values = jnp.linspace(4e-7, 7e-7, 5), jnp.ones(5)
    with pytest.raises(ValueError, match=r"method must be one of linear, sprague, got 'cubic'"):
        spectra.interpolate_spectrum(values, grid, grid, method="cubic")
    with pytest.raises(ValueError, match="sprague interpolation needs at least 6 bands, got 5"):
        spectra.interpolate_spectrum(values, grid, grid, method="sprague")
    gap = jnp.asarray([1e-9 * nm for nm in (*range(400, 500, 10), *range(600, 701, 10))])
    with pytest.raises(ValueError, match=r"evenly spaced known .* steps from 10 to 110 nm"):
        spectra.interpolate_spectrum(jnp.ones(21), gap, grid, method="sprague")
    with pytest.raises(ValueError, match=r"each of the 5 known wavelengths .* shape \(3,\)"):
        spectra.interpolate_spectrum(values[:3], grid, grid)
    with pytest.raises(ValueError, match="wanted is in metres, got 600; 550 nm are 550e-9"):
        spectra.interpolate_spectrum(values, grid, jnp.array([500.0, 600.0]))


# ------------------------------------------------ laws of light


@pytest.mark.sweep("float32")
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("temperature", [300.0, 2856.0, 6504.0, 1e5])
def test_planck_in_many_digits(dtype, temperature):
    grid = jnp.asarray([3e-7, 5.55e-7, 7.8e-7, 1e-5], dtype)
    ours = spectra.blackbody(grid, jnp.asarray(temperature, dtype))
    assert ours.dtype == dtype
    h, c, k = mp.mpf("6.62607015e-34"), mp.mpf(299792458), mp.mpf("1.380649e-23")
    for wavelength, value in zip(np.asarray(grid, np.float64), ours, strict=True):
        x = h * c / (mp.mpf(wavelength) * k * mp.mpf(temperature))
        truth = 2 * h * c**2 / mp.mpf(wavelength) ** 5 / mp.expm1(x)
        if truth > 1e-30:  # the exponential magnifies the rounding error of its argument
            tolerance = float(8 * (1 + x) * float(jnp.finfo(dtype).eps))
            assert abs(float(value) / float(truth) - 1) < tolerance
        else:
            assert 0 <= float(value) < 1e-29


@pytest.mark.slow
def test_planck_as_colour_science():
    """Both use the constants of the ITS-90."""
    ours = spectra.blackbody(GRID, jnp.asarray(5000.0))
    theirs = colour.colorimetry.planck_law(
        np.asarray(GRID), 5000, c1=3.741771852e-16, c2=1.438776877e-2
    )
    np.testing.assert_allclose(ours, theirs, rtol=1e-8)


@pytest.mark.slow
def test_blackbody_without_warmth():
    for temperature in (0.0, -5.0, 1e-3):
        value, slope = jax.value_and_grad(lambda t: spectra.blackbody(GRID, t).sum())(
            jnp.asarray(temperature)
        )
        assert value == 0
        assert jnp.isfinite(slope)


@pytest.mark.parametrize("temperature", [4000.0, 5003.0, 6504.0, 7000.5, 25000.0])
def test_daylight_as_colour_science(temperature):
    basis = colour_data.daylight_basis(GRID)
    xy = colour.temperature.CCT_to_xy_CIE_D(temperature)
    theirs = colour.colorimetry.sd_CIE_illuminant_D_series(xy, M1_M2_rounding=False)
    ours = spectra.daylight(basis, jnp.asarray(temperature))
    np.testing.assert_allclose(ours, theirs[NM], rtol=1e-10)


def test_daylight_is_the_tabulated_d65():
    """The CIE's table was computed with M_1 and M_2 rounded to three decimals, at 6504 K."""
    ours = spectra.daylight(colour_data.daylight_basis(GRID), jnp.asarray(6500 * 1.4388 / 1.4380))
    np.testing.assert_allclose(ours, colour_data.illuminant("D65", GRID), rtol=1e-3)
    limit = spectra.daylight(colour_data.daylight_basis(GRID), jnp.asarray(4e3))
    with pytest.warns(UserWarning, match="from 4000 to 25000 K, got 3000 K"):
        below = spectra.daylight(colour_data.daylight_basis(GRID), jnp.asarray(3e3))
    np.testing.assert_array_equal(below, limit)


# ------------------------------------------------ tables


def test_tables_end_or_continue():
    wide = colour_data.nanometres([200.0, 555.0, 1200.0])
    observer = colour_data.observer(wide)
    np.testing.assert_array_equal(observer[0], 0)
    np.testing.assert_array_equal(observer[2], 0)
    np.testing.assert_allclose(observer[1, 1], 1.0, rtol=1e-6)  # y peaks at 555 nm
    chart = colour_data.chart_reflectances(wide)
    native = list(colour.SDS_COLOURCHECKERS["ColorChecker N Ohta"].values())
    np.testing.assert_allclose(chart[:, 0], [patch.values[0] for patch in native])


def test_daylight_goes_on_beyond_its_table():
    """CIE D65 at 780, 810 and 830 nm is 63.3828, 51.9565 and 60.3125 (ISO 11664-2, 300 to 830
    nm)."""
    d65 = colour_data.illuminant("D65", colour_data.nanometres([780.0, 810.0, 830.0]))
    np.testing.assert_allclose(d65, [63.3828, 51.9565, 60.3125], rtol=2e-4)
    whole = colour.SDS_ILLUMINANTS["D60"]  # the only table that extends to 830 nm
    ours = spectra.daylight(
        colour_data.daylight_basis(colour_data.nanometres(whole.wavelengths)),
        jnp.asarray(6000 * 1.4388 / 1.4380),
    )
    np.testing.assert_allclose(ours, whole.values, rtol=1e-3)


def test_illuminants_beyond_their_tables():
    """Illuminant A is Planck's law at 2848 K (CIE 15:2018, c_2 = 1.435e-2 m K)."""
    wanted = np.array([250.0, 300.0, 560.0, 780.0, 781.0, 1000.0, 1100.0])
    planck = 1 / (wanted**5 * np.expm1(1.435e7 / 2848 / wanted))
    found = colour_data.illuminant("A", colour_data.nanometres(wanted))
    np.testing.assert_allclose(found, 100 * planck / planck[2], rtol=1e-5)
    np.testing.assert_allclose(found[5], 290.4, atol=0.05)
    for name, known, one in (
        ("FL2", "Illuminant 'FL2' is known from 380 to 780", 781),
        ("C", "Illuminant 'C' is known from 300 to 780", 900),
        ("D65", "CIE daylight is known from 300 to 830", 299),
        ("D65", "CIE daylight is known from 300 to 830", 831),
    ):
        with pytest.raises(InputError, match=f"{known} nm, and {one} nm is asked for"):
            colour_data.illuminant(name, colour_data.nanometres([500.0, one]))
    even = colour_data.illuminant("E", colour_data.nanometres([250.0, 2e3]))
    np.testing.assert_allclose(even, 100)


def test_unknown_names_list_the_known():
    with pytest.raises(InputError, match=r"No illuminant 'D66'; the nearest is 'D65'\."):
        colour_data.illuminant("D66", GRID)
    with pytest.raises(InputError, match=r"No camera 'x'.*Nikon 5100"):
        colour_data.camera_sensitivities("x", GRID)
    with pytest.raises(InputError, match=r"No observer 'x'.*CIE 1931"):
        colour_data.observer(GRID, name="x")
    with pytest.raises(InputError, match=r"No chart 'x'.*ColorChecker N Ohta"):
        colour_data.chart_reflectances(GRID, name="x")
    with pytest.raises(InputError, match=r"No illuminant 'x'.*D65"):
        colour_data.white_point("x")


def test_planck_in_half_precision():
    wavelengths, kelvin = jnp.asarray([5e-6, 1e-5], jnp.bfloat16), jnp.asarray(3000.0, jnp.bfloat16)
    found = spectra.blackbody(wavelengths, kelvin)
    wanted = spectra.blackbody(wavelengths.astype(jnp.float32), kelvin.astype(jnp.float32))
    assert found.dtype == jnp.bfloat16
    np.testing.assert_allclose(found.astype(jnp.float32), wanted, rtol=4e-3)
