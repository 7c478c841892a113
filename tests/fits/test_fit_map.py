"""Tests fits at every pixel: equality with separate fits, coverage, pixels without data, and
materials."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from decompositions import beside_each_other
from scipy import stats

from fitting import Censored, Gaussian, Parameter, Problem, fit, fit_map
from fitting.inference.pixelwise import fit_side_by_side
from jaxvision.errors import InputError
from jaxvision.files.images import read_image

ANGLES = np.linspace(0.05, 1.2, 12)  # for 12 lights
RNG = np.random.default_rng(5)
LOBE = {
    "diffuse": Parameter(lower=0, upper=2),
    "exponent": Parameter(lower=1, upper=500, transform="log"),
}


def lobe(diffuse, exponent, inputs):
    return diffuse * jnp.cos(inputs) + 0.4 * jnp.cos(inputs) ** exponent


LINE = {"dark": Parameter(unit="DN/s", start=1.0), "offset": Parameter(unit="DN", start=0.0)}
TIMES = np.arange(1.0, 9.0)  # s


def line(dark, offset, inputs):
    return offset + dark * inputs


PIXEL = Problem(LINE, line, Gaussian(sd=0.5), np.zeros(8), inputs=TIMES)
TRUE = {"dark": RNG.uniform(1, 3, (40, 50)), "offset": RNG.uniform(5, 9, (40, 50))}
CLEAN = TRUE["offset"] + TRUE["dark"] * TIMES[:, None, None]


@pytest.fixture(scope="module")
def images():
    """Return frames of 2000 pixels. One pixel is dead, one has two frames left, and one is
    saturated after the first."""
    frames = CLEAN + 0.5 * np.random.default_rng(1).standard_normal(CLEAN.shape)
    frames[:, 3, 4] = np.nan
    frames[2:, 5, 6] = np.nan
    frames[1:, 7, 8] = np.nan
    return frames


@pytest.fixture(scope="module")
def maps(images):
    return fit_map(PIXEL, images, starts=1, chunk=300)


def test_every_pixel_is_weighted_least_squares_and_covers(maps, images):
    """The estimates equal NumPy's lstsq, and intervals of 2000 pixels cover the true value within
    the 99.9 % binomial range."""
    design = np.stack([TIMES, np.ones(8)], axis=1)
    there = ~np.isnan(images).any(axis=0)
    best = np.linalg.lstsq(design, images[:, there], rcond=None)[0]
    sd = 0.5 * np.sqrt(np.diag(np.linalg.inv(design.T @ design)))
    for row, name, error in zip(best, LINE, sd, strict=True):
        np.testing.assert_allclose(maps.estimate[name][there], row, rtol=1e-6)
        np.testing.assert_allclose(maps.sd[name][there], error, rtol=1e-6)
        for level, ends in ((0.68, maps.interval_68), (0.95, maps.interval_95)):
            low, high = ends[name][:, there]
            inside = np.sum((low < TRUE[name][there]) & (TRUE[name][there] < high))
            band = stats.binom.ppf([0.0005, 0.9995], there.sum(), level)
            assert band[0] <= inside <= band[1]
    assert maps.units == {"dark": "DN/s", "offset": "DN"}


def test_pixels_without_data_are_nan_and_counted(maps, images):
    states = [maps.state[place] for place in ((3, 4), (5, 6), (7, 8))]
    assert states == [5, 0, 3]  # no data, two frames (enough for a line), one frame
    for name in LINE:
        assert np.isnan(maps.estimate[name]).sum() == np.isnan(maps.sd[name]).sum() == 2
    assert maps.dof[5, 6] == pytest.approx(0, abs=1e-6)
    misfits = int(np.sum(maps.state == 1))
    assert int(maps.converged.sum()) == 2000 - 2 - misfits
    assert misfits <= stats.binom.ppf(0.9995, 2000, 1e-3)
    assert any("1 of 2000 pixels have no data" in s for s in maps.findings)
    assert any("1 of 2000 pixels do not determine all parameters" in s for s in maps.findings)
    assert not any("fewer data" in s for s in maps.findings)


def test_pixels_never_wait_for_each_others_threads(images):
    """No two decompositions of the pixels' matrices run at the same time (`decompositions`)."""
    flat = np.moveaxis(images.reshape(8, -1), -1, 0)[:3]

    def run(data):
        starts = jnp.zeros((2, 2)), jnp.zeros((2, 2))
        return fit_side_by_side(starts, PIXEL, data, [None], jnp.asarray(5), jnp.zeros(8))

    assert beside_each_other(run, jnp.asarray(flat)) == []


@pytest.mark.slow
def test_pixels_determined_only_by_bounds_are_counted():
    """One datum of 15 DN at 1 s leaves the rate between 0 and 15 DN/s, uniformly."""
    rate = Parameter(lower=0, upper=15)
    problem = Problem(
        {"dark": rate, "offset": rate}, line, Gaussian(sd=0.01), np.zeros(8), inputs=TIMES
    )
    images = line(3.0, 2.0, TIMES)[:, None] + np.zeros(4)
    images[1:, 2] = np.nan
    found = fit_map(problem, images, starts=4)
    assert found.findings[-1] == (
        "1 of 4 pixels have fewer data than unknowns: bounds and priors decide."
    )
    assert found.sd["dark"][2] > 100 * found.sd["dark"][0]


@pytest.mark.slow
def test_maps_are_written(maps, tmp_path):
    import xarray

    files = {file.name for file in maps.write(tmp_path)}
    assert files == {
        *("maps.nc", "maps.png"),
        *("dark.exr", "dark_sd.exr", "offset.exr", "offset_sd.exr"),
    }
    with xarray.open_dataset(tmp_path / "maps.nc") as read:
        np.testing.assert_array_equal(read["dark"], maps.estimate["dark"])
        np.testing.assert_array_equal(read["offset_interval_95"], maps.interval_95["offset"])
        assert read["dark"].dims == ("y", "x")
        assert read["dark"].units == "DN/s"
    picture = read_image(tmp_path / "offset_sd.exr")
    np.testing.assert_allclose(picture, maps.sd["offset"], rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("likelihood", "pixels"), [(Gaussian(0.001), 20), (Censored(0.001, high=0.9), 3)]
)
def test_a_pixel_is_fitted_as_if_it_were_alone(likelihood, pixels):
    """They agree within 1e-6 and the tolerance of `fit`: 1e-7 in log density, or 4.5e-4 standard
    errors."""
    problem = Problem(LOBE, lobe, likelihood, np.zeros(12), inputs=ANGLES)
    diffuse, exponent = RNG.uniform(0.2, 0.8, pixels), RNG.uniform(8, 60, pixels)
    data = np.asarray(lobe(diffuse[None], exponent[None], ANGLES[:, None]))
    data = np.minimum(data + 0.001 * RNG.standard_normal(data.shape), 0.9)
    if likelihood.least_squares:
        data = np.where(data == 0.9, np.nan, data)
    maps = fit_map(problem, data)
    for i in range(pixels):
        alone = fit(problem.with_data(data[:, i]), starts=4)
        for one in alone.estimates:
            tolerance = 1e-6 * abs(one.value) + 4.5e-4 * one.standard_error
            assert abs(maps.estimate[one.name][i] - one.value) < tolerance
            assert maps.sd[one.name][i] == pytest.approx(one.standard_error, rel=1e-4)
        assert maps.chi_square[i] == pytest.approx(alone.misfit.chi_square, rel=1e-6)


@pytest.mark.sweep
@pytest.mark.parametrize("bounds", [{"start": 1.0}, {"lower": 0.0}, {"lower": 0.0, "upper": 20.0}])
def test_float32_ends_where_float64_does(bounds):
    """The optima agree within a ten-thousandth of the standard error of 0.5."""

    def fitted():
        pixel = Problem(
            {"level": Parameter(**{"start": 1.0} | bounds)},
            lambda level: level * jnp.ones(1),
            Gaussian(0.5),
            np.zeros(1),
        )
        return fit_map(pixel, np.full((1, 2), 9.0)).estimate["level"]

    with jax.enable_x64(False):
        found = fitted()
    np.testing.assert_allclose(found, fitted(), atol=5e-5)


@pytest.mark.slow
def test_materials_share_their_parameters():
    """The reference is least squares over all pixels of a label, with inputs for every pixel."""
    angles = ANGLES[:, None, None] * RNG.uniform(0.8, 1.1, (6, 10))
    labels = np.repeat([0, 1, 2, -1], 15).reshape(6, 10)
    slope, offset = np.array([1.0, 2.0, 3.0, 0.0])[labels], 4.0
    data = offset + slope * angles + 0.5 * RNG.standard_normal(angles.shape)
    data[:, labels == 2] = np.nan
    problem = Problem(LINE, line, Gaussian(sd=0.5 * np.ones(12)), np.zeros(12), inputs=ANGLES)
    maps = fit_map(problem, data, inputs=angles, labels=labels, starts=2, chunk=32)
    for label in (0, 1):
        inside = labels == label
        design = np.stack([angles[:, inside].ravel(), np.ones(12 * 15)], axis=1)
        best = np.linalg.lstsq(design, data[:, inside].ravel(), rcond=None)[0]
        for name, value in zip(LINE, best, strict=True):
            np.testing.assert_allclose(maps.estimate[name][inside], value, rtol=1e-5)
        assert maps.fits[label].misfit.count == 12 * 15
    assert np.isnan(maps.estimate["dark"][labels == 2]).all()
    assert np.isnan(maps.estimate["dark"][labels < 0]).all()
    assert set(maps.fits) == {0, 1}


@pytest.mark.slow
def test_excess_noise_widens_the_interval_of_a_pixel():
    frames = CLEAN[:, :1] + 1.5 * RNG.standard_normal((8, 1, 50))
    stated = fit_map(PIXEL, frames, starts=2, chunk=64)
    widened = fit_map(PIXEL, frames, starts=2, chunk=64, misfit="inflate")
    factor = np.sqrt(np.maximum(stated.chi_square / stated.dof, 1))
    np.testing.assert_allclose(widened.sd["dark"], factor * stated.sd["dark"], rtol=1e-6)
    assert widened.converged.all()
    assert not stated.converged.all()


@pytest.mark.parametrize(
    ("data", "options", "expected"),
    [
        (np.zeros((7, 4, 4)), {}, "do not fit"),
        (np.zeros(8), {}, "do not fit"),
        (np.zeros((8, 0)), {}, "do not fit"),
        (np.zeros((8, 4)), {"inputs": np.zeros((8, 5))}, "neither"),
        (np.zeros((8, 4)), {"labels": np.zeros(4)}, "whole numbers"),
        (np.zeros((8, 4)), {"misfit": "ignore"}, "'fail' or 'inflate'"),
        (np.zeros((8, 4)), {"chunk": 7.5}, "number of pixels"),
        (np.zeros((8, 4)), {"starts": 0}, "number of searches"),
    ],
)
def test_mismatched_shapes_of_maps_are_refused(data, options, expected):
    with pytest.raises(InputError, match=expected):
        fit_map(PIXEL, data, **options)
