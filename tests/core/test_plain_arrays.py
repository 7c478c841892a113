"""Tests arrays that carry more than numbers, at every public function: a mask is used or refused,
and units, coordinates and an index are refused in one sentence."""

import datetime
import re
import warnings
from fractions import Fraction
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pandas
import pytest
import xarray
from astropy import units
from astropy.table import Column, MaskedColumn
from astropy.utils.masked import Masked
from examples import ROOMS, examples_of
from fuzz.arguments import at, places, with_at
from public_names import doors
from scipy.sparse import csr_array

import jaxvision as jv
from fitting import Gaussian, Parameter, Problem, fit, fit_map, noise, reflectance, response

LONGEST = 300  # characters in a message
# Tuples of pictures made by another function, whose parts users do not replace.
MADE_BY_OTHERS = {"filters.steerable.oriented_energy", "filters.steerable.steer"}


def masked(x):
    hidden = np.zeros(np.shape(x), bool)
    hidden.flat[0] = True
    return np.ma.array(x, mask=hidden)


def carriers(x):
    yield xarray.DataArray(x)
    yield x * units.nm
    if np.ndim(x) == 1:
        yield pandas.Series(x)


def refusal(call):
    """Return the message with which a call is refused."""
    with pytest.raises(ValueError, match=r"\.$") as caught:
        call()
    return str(caught.value)


@pytest.mark.sweep
@pytest.mark.parametrize("room", ROOMS)
def test_no_public_function_ignores_masks_or_units(room):
    """The test covers each array argument of each function, and each array field of its records."""
    known = doors()
    for name, (arguments, options) in examples_of(room).items():
        private = any(part.startswith("_") for part in name.split("."))
        if name in MADE_BY_OTHERS or name not in known or private:
            continue
        function = partial(known[name], **options)
        for path in places(arguments):
            is_field = len(path) > 1
            if is_field and not hasattr(at(arguments, path[:-1]), "__check_init__"):
                continue
            numbers = np.asarray(at(arguments, path), np.float64)
            place = f"{name} {jax.tree_util.keystr(path)}"
            for value in carriers(numbers):
                said = refusal(partial(put_in, function, arguments, path, value))
                assert "would be lost" in said, (place, said)
                assert len(said) < LONGEST, (place, said)
            if numbers.size and not is_field:
                given = with_at(arguments, path, masked(numbers))
                plain = with_at(arguments, path, masked(numbers).filled(np.nan))
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    shapes = [outline(function, one) for one in (given, plain)]
                assert shapes[0] == shapes[1], place


def put_in(function, arguments, path, value):
    return function(*with_at(arguments, path, value))


def outline(function, arguments):
    """Return the shapes of the result, or the message of the refusal."""
    try:
        return str(jax.eval_shape(lambda: function(*arguments)))
    except ValueError as error:
        return str(error)


def test_a_masked_number_is_nan():
    picture = masked(np.arange(1.0, 10.0).reshape(3, 3, 1))
    blurred = jv.filters.box(picture, size=3, border="zero")
    np.testing.assert_array_equal(np.isnan(blurred[..., 0]), [[1, 1, 0], [1, 1, 0], [0, 0, 0]])
    assert float(jv.filters.box(np.ma.ones((3, 3, 1)), size=3)[1, 1, 0]) == pytest.approx(1)
    lamp = jv.PointLight((0.0, 0.0, 1.0), masked([1.0, 2.0]))
    np.testing.assert_array_equal(np.isnan(lamp.intensity), [True, False])


def test_masked_whole_numbers_are_refused():
    with pytest.raises(ValueError, match=r"1 of its 4 numbers masked"):
        jv.write_image("never.png", masked(np.ones((2, 2), np.uint8)))
    assert not Path("never.png").exists()


def line(slope, inputs):
    return slope * inputs


def test_a_problem_takes_masked_data_as_missing():
    x = np.linspace(1, 4, 7)
    data = 2 * x
    data[0] = 1e6
    free = {"slope": Parameter(start=1.0)}
    found = fit(Problem(free, line, Gaussian(sd=0.1), np.ma.masked_greater(data, 100), inputs=x))
    assert float(found.values["slope"]) == pytest.approx(2, abs=1e-6)
    for named in (xarray.DataArray(data), pandas.Series(data), data * units.m):
        said = refusal(lambda v=named: Problem(free, line, Gaussian(sd=0.1), v, inputs=x))
        assert said.startswith("data is a")
        said = refusal(lambda v=named: Problem(free, line, Gaussian(sd=0.1), x, inputs=v))
        assert said.startswith("inputs is a")
        said = refusal(lambda v=named: Gaussian(sd=v))
        assert said.startswith("Gaussian: sd is a")
        said = refusal(lambda v=named: Problem(free, line, Gaussian(0.1), v, inputs=x, chunk=3))
        assert said.startswith("data is a")
    problem = Problem(free, line, Gaussian(sd=0.1), 2 * x, inputs=x)
    said = refusal(lambda: fit_map(problem, xarray.DataArray(np.ones((7, 2)))))
    assert said.startswith("data is a DataArray")


def test_a_parameter_has_no_unit_of_its_own():
    with pytest.raises(ValueError, match="a Quantity with a unit"):
        Parameter(lower=1 * units.nm)


@pytest.mark.parametrize("kind", [masked, xarray.DataArray, lambda x: x * units.adu])
def test_calibrations_refuse_what_they_would_ignore(kind):
    frames = np.random.default_rng(0).poisson(100.0, (2, 8, 8))
    odd = [kind(frame) for frame in frames]
    said = refusal(
        lambda: noise.from_frames(
            [odd] * 4, [frames], [0.01] * 4, None, camera=noise.Camera(bits=8), dark_exposures=[0.1]
        )
    )
    assert said.startswith("flats[0][0] is a")
    said = refusal(lambda: response.from_stack(odd, [1, 2], camera=response.Camera(bits=8)))
    assert said.startswith("images[0] is a")
    lights = np.array([[0, 0, 1.0], [0.6, 0, 0.8]])
    at_hand = {
        "camera": reflectance.Camera(bits=8),
        "sphere": reflectance.SphereGeometry(centre=(4, 4), radius=3),
    }
    said = refusal(lambda: reflectance.from_photographs(odd, lights, **at_hand))
    assert said.startswith("images[0] is a")
    if kind is not masked:
        said = refusal(lambda: reflectance.photometric_stereo(kind(frames * 1.0), lights))
        assert said.startswith("images is a")


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (MaskedColumn([1.0, 2.0], mask=[0, 1], unit="nm"), "MaskedColumn with a unit"),
        (Masked([1.0, 2.0] * units.nm, mask=[0, 1]), "MaskedQuantity with a unit"),
        (np.array([1 * units.nm, 2 * units.nm], object), "Quantity with a unit"),
        ([1 * units.nm, 2 * units.nm], "Quantity with a unit"),
        (np.array([300], "m8[us]"), r"unit \(timedelta64\[us\]\)"),
        ([datetime.timedelta(seconds=1)], r"unit \(timedelta\)"),
    ],
)
def test_a_unit_below_a_mask_or_in_a_list_is_refused(value, words):
    assert re.search(words, refusal(lambda: jv.core.plain_arrays.plain_array("x", value)))
    refusal(lambda: jv.as_float(value))


@pytest.mark.parametrize(
    "value",
    [MaskedColumn([1.0, 2.0], mask=[0, 1]), Masked(np.array([1.0, 2.0]), mask=[0, 1])],
)
def test_a_mask_of_astropy_without_a_unit_is_nan(value):
    np.testing.assert_array_equal(jv.as_float(value), [1, np.nan])
    np.testing.assert_array_equal(jv.as_float(Column([1.0, 2.0])), [1, 2])


@pytest.mark.parametrize(
    "times",
    [
        pandas.Series([0.1, 0.2, 0.3, 0.4], index=[3, 2, 1, 0]),
        xarray.DataArray([0.1, 0.2, 0.3, 0.4]),
        [0.1, 0.2, 0.3, 0.4] * units.ms,
        np.array([100, 200, 300, 400], "m8[us]"),
        np.array(["2020", "2021", "2022", "2023"], "M8[s]"),
        0.1,
        [0.1, "b", 0.3, 0.4],
    ],
)
def test_exposures_and_photons_are_numbers_in_their_order(times):
    frames = np.random.default_rng(0).poisson(100.0, (4, 2, 8, 8))
    numbers, camera = [0.1, 0.2, 0.3, 0.4], noise.Camera(bits=8)
    read = partial(noise.from_frames, frames, frames, camera=camera)
    calls = {
        "exposures": [
            lambda: read(times),
            lambda: noise.darks_from_frames(frames, times, camera=camera),
            lambda: response.from_stack(frames[:, 0], times, camera=camera),
        ],
        "photons": [lambda: read(numbers, times)],
        "dark_exposures": [lambda: read(numbers, dark_exposures=times)],
    }
    for name, every in calls.items():
        for call in every:
            said = refusal(call)
            assert said.startswith(f"{name} ")
            assert len(said) < LONGEST


@pytest.mark.parametrize("kind", [int, float])
def test_masked_images_are_refused_with_the_way_to_leave_pixels_out(kind):
    odd = masked(np.random.default_rng(0).poisson(100.0, (8, 8)).astype(kind))
    said = refusal(lambda: response.from_stack([odd, odd], [1, 2], camera=response.Camera(bits=8)))
    assert "1 of its 64 numbers masked" in said
    assert "the argument mask" in said
    assert "nan" not in said


def test_a_camera_names_the_field_with_a_unit_or_an_index():
    for value in (1 * units.adu, pandas.Series([1.0, 2.0])):
        with pytest.raises(ValueError, match=r"gain\n.*this is a \w+ with an? (unit|index)"):
            noise.Camera(bits=8, taps=(1, 2), gain=value)


@pytest.mark.parametrize("value", [1 * units.m, xarray.DataArray(1.0), pandas.Series([1.0]), "one"])
def test_a_record_names_the_field_that_refuses(value):
    for make, field in (
        (lambda: jv.Sphere([0, 0, 0], value), "Sphere.radius"),
        (lambda: jv.Sphere([0, 0, value], 1.0), "Sphere.centre"),
        (lambda: jv.Phong([0.1], value, 9.0), "Phong.specular"),  # a field of its base class
        (lambda: jv.Phong([0.1], [0.1], 9.0, ambient=value), "Phong.ambient"),
        (lambda: jv.Ray([0, 0, 0], value), "Ray.direction"),
    ):
        said = refusal(make)
        assert said.startswith(field)
        assert len(said) < 300
    assert "." not in refusal(lambda: jv.as_float(value)).split()[0]


def test_plots_draw_no_masked_number():
    x = np.arange(3.0)
    axes = jv.plots.curve(x, masked([1e9, 1.0, 2.0]))
    np.testing.assert_array_equal(np.isnan(axes.lines[0].get_ydata()), [True, False, False])
    with pytest.raises(ValueError, match="would be lost"):
        jv.plots.picture(xarray.DataArray(np.ones((2, 2))))


def test_plain_numbers_pass_as_they_are():
    numbers = [1.0, 2.0]
    for value in (numbers, np.ones(2), jnp.ones(2), 1, None, "one", np.float32(1)):
        assert jv.core.plain_arrays.plain_array("x", value) is value


LARGE = 3_000_000_000  # beyond 32 bits


@pytest.fixture
def as_users_start():
    """Use JAX's default integers, of 32 bits."""
    with jax.enable_x64(False):
        yield


@pytest.mark.usefixtures("as_users_start")
@pytest.mark.parametrize("kind", [np.int64, np.uint64])
def test_whole_numbers_beyond_32_bits_keep_their_value(kind):
    picture = np.full((8, 8), 1_500_000_000, kind)
    picture[3, 4] = 2**40
    given = picture.astype(np.float64)
    for of in (
        lambda x: jv.filters.box(x, size=3),
        lambda x: jv.filters.integral_image(x),
        lambda x: jv.filters.resize(x, (4, 4)),
        lambda x: jv.demosaic(x, "RGGB"),
        lambda x: jv.expected_signal(jv.Sensor(gain=0.5), x[..., None]),
        lambda x: jv.environment_map(x[:4, :, None]).radiance,
    ):
        np.testing.assert_array_equal(of(picture), of(given))
    total = jv.filters.window_sum(jv.filters.integral_image(picture), (8, 8))
    np.testing.assert_allclose(total[4, 4], sum(map(int, picture.ravel())), rtol=1e-6)
    power = (2.0**40) ** (1 / 2.4)
    encoded = jv.srgb_encode(np.array([2**40, 3], np.int64))
    np.testing.assert_allclose(encoded[0], 1.055 * power - 0.055, rtol=1e-6)


@pytest.mark.usefixtures("as_users_start")
def test_plain_whole_numbers_beyond_32_bits_keep_their_value():
    for five in (5_000_000_000, np.int64(5_000_000_000)):
        assert jv.Sensor(full_well=five).full_well == np.float32(5e9)
        np.testing.assert_allclose(jv.gain_bias([0.5], five, 0), [2.5e9])
        place = jv.PointLight((0, 0, five), [LARGE]).position
        np.testing.assert_array_equal(place, np.float32([0, 0, 5e9]))
    corner = [[0, 0, 0], [4_000_000_000, 0, 0], [0, LARGE, 0]]
    mesh = jv.TriangleMesh(np.array(corner), [[0, 1, 2]])
    np.testing.assert_array_equal(mesh.vertices, np.float32(corner))
    np.testing.assert_allclose(jv.srgb_decode([LARGE]), ((3e9 + 0.055) / 1.055) ** 2.4, rtol=1e-5)


@pytest.mark.usefixtures("as_users_start")
def test_corners_of_triangles_beyond_32_bits_are_refused():
    with pytest.raises(ValueError, match="whole numbers"):
        jv.TriangleMesh(np.eye(3), np.array([[0, 1, 2**32 + 2]]))


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (np.zeros((5, 5), "M8[s]"), r"holds dates \(datetime64\[s\]\)"),
        (np.zeros((5, 5), [("r", "f4")]), "holds fields by name"),
        (np.array([[1, None], [2, 3]], object), "holds None, which is no number"),
        (csr_array(np.eye(5)), r"zeros that are not stored, which would be lost.*\.toarray\(\)"),
    ],
)
@pytest.mark.parametrize("entrance", [partial(jv.filters.gaussian, sigma=1.0), jv.srgb_encode])
def test_arrays_that_hold_no_numbers_are_refused_in_one_sentence(entrance, value, said):
    assert re.search(said, refusal(partial(entrance, value)))


def test_arrays_of_python_numbers_are_numbers():
    halves = np.array([Fraction(1, 2), 0.5, 1], object)
    np.testing.assert_allclose(jv.srgb_encode(halves), jv.srgb_encode([0.5, 0.5, 1.0]))


@pytest.mark.usefixtures("as_users_start")
def test_inputs_of_a_fit_beyond_32_bits_keep_their_value():
    x = np.array([1, 2, 3, 4], np.int64) * 1_000_000_000
    found = fit(
        Problem(
            {"a": Parameter(start=2.0)},
            lambda a, inputs: a * (inputs * 1e-9),
            Gaussian(sd=0.1),
            2.5e-9 * x.astype(float),
            inputs=x,
        )
    )
    np.testing.assert_allclose(found.posterior.mode, [2.5], rtol=1e-4)
