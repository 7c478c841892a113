"""Tests numbers from other programs as the data of a fit: byte order, text, complex numbers,
gaps."""

import datetime
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvision as jv
from fitting import Gaussian, Parameter, Problem, fit, fit_map, noise, reflectance, response
from jaxvision.errors import InputError

TIME = np.linspace(0.0, 5.0, 8)
TRUTH = 1.0 + 2.0 * TIME


def line(data=TRUTH, inputs=TIME, sd=0.3, **more):
    free = {name: Parameter(lower=-100, upper=100) for name in ("slope", "offset")}
    return Problem(
        free | more,
        lambda slope, offset, inputs: offset + slope * jnp.asarray(inputs, slope.dtype),
        Gaussian(sd=sd),
        data,
        inputs=inputs,
    )


def test_the_other_byte_order_is_read():
    """Data are as from a FITS table by astropy. The slope, (sum of x y) / (sum of x^2) of centred
    numbers, is 2."""
    times = (1000 * TIME).round().astype(">i2")
    centred = times - times.mean()
    slope = centred @ TRUTH / (centred @ centred)
    other = line(TRUTH.astype(">f8"), times, np.full(8, 0.3, ">f4"))
    np.testing.assert_allclose(fit(other).values["slope"], slope, rtol=1e-4)
    assert jv.as_float(np.array([1.5, 2.0], ">f4")).tolist() == [1.5, 2.0]
    pixel = line(np.zeros(8))
    own = np.stack([TIME, 2 * TIME], -1).astype(">f8")
    found = fit_map(pixel, np.stack([TRUTH, TRUTH], -1).astype(">f4"), inputs=own)
    np.testing.assert_allclose(found.estimate["slope"], [2, 1], rtol=1e-4)


@pytest.mark.parametrize(
    ("held", "words"),
    [
        (["1,5"] * 8, "holds '1,5'"),
        (np.array(["1.5"] * 8), "holds text"),
        (np.array([b"1.5"] * 8), "holds text"),
        ([b"1.5"] * 8, "holds b'1.5'"),
        ([datetime.datetime(2020, 1, 1)] * 8, "holds datetime"),
    ],
)
def test_inputs_that_are_not_numbers_are_refused_by_argument(held, words):
    frames = np.zeros((4, 2, 8, 8)).astype(str)
    camera = noise.Camera(bits=8)
    lights = np.array([[0, 0, 1.0]] * 8)
    calls = {
        "data": lambda: line(held),
        "data ": lambda: fit_map(line(), held),
        "inputs": lambda: line(inputs=held),
        "fixed": lambda: line(fixed=held),
        "flats[0][0]": lambda: noise.from_frames(frames, frames, [1] * 4, camera=camera),
        "images[0]": lambda: response.from_stack(frames[:, 0], [1] * 4, camera=camera),
        "images": lambda: reflectance.photometric_stereo(held, lights),
    }
    for name, call in calls.items():
        with pytest.raises(InputError) as told:
            call()
        assert str(told.value).startswith(f"{name.strip()} holds")
        assert "[0]" in name or words in str(told.value)


def test_no_imaginary_part_is_dropped():
    odd = TRUTH + 1e-3j
    lights = np.array([[0, 0, 1.0]] * 8)
    camera = noise.Camera(bits=8)
    frames = np.zeros((4, 2, 8, 8)) + 0j
    for call in (
        lambda: line(odd),
        lambda: line(list(odd)),
        lambda: line(np.array(odd, object)),
        lambda: line(jnp.asarray(odd)),
        lambda: line(sd=0.3 + 0j),
        lambda: line(fixed=1j),
        lambda: Parameter(start=1j),
        lambda: fit_map(line(), odd),
        lambda: reflectance.photometric_stereo(odd[:, None, None], lights),
        lambda: response.from_stack(frames[:, 0], [1] * 4, camera=camera),
    ):
        with pytest.raises(InputError, match="holds complex numbers"):
            call()
    inputs = TIME + 1j  # which `predict` may use
    problem = Problem(
        {"slope": Parameter(lower=-100, upper=100)},
        lambda slope, inputs: slope * inputs.real + inputs.imag,
        Gaussian(sd=0.3),
        TRUTH,
        inputs=inputs,
    )
    np.testing.assert_allclose(fit(problem).values["slope"], 2, rtol=1e-4)


def test_a_gap_in_the_inputs_is_named_with_its_place():
    gap = np.where(np.arange(8) == 6, np.nan, TIME)
    with pytest.raises(InputError, match=r"inputs\[6\] is NaN; leave that row out"):
        fit(line(inputs=gap))
    with pytest.raises(InputError, match=r"offset is NaN; give a number"):
        fit(line(offset=np.nan))
    both = fit(line(np.where(np.isnan(gap), np.nan, TRUTH), gap))  # equal to a missing row
    np.testing.assert_allclose(both.values["slope"], 2, rtol=1e-4)


@pytest.mark.slow
def test_a_gap_in_the_inputs_is_named_by_its_row_of_all_chunks():
    problem = Problem(
        {"slope": Parameter(start=1.0)},
        lambda slope, inputs: slope * inputs["t"],
        Gaussian(sd=0.3),
        TRUTH,
        inputs={"t": np.where(np.arange(8) == 6, np.nan, TIME)},
        chunk=4,
    )
    with pytest.raises(InputError, match=r"inputs\['t'\]\[6\] is NaN"):
        fit(problem)


def test_numbers_of_80_bits_and_records_are_read_or_refused_by_name():
    picture = np.linspace(0.1, 1, 64).reshape(8, 8)
    wide = jv.filters.gaussian(picture.astype(np.longdouble), np.longdouble(1))
    np.testing.assert_array_equal(wide, jv.filters.gaussian(picture, 1.0))
    assert jv.PointLight(np.ones(3, np.longdouble), [1.0]).position.tolist() == [1, 1, 1]
    fields = np.rec.fromarrays([picture, picture], names="red,green")
    for held in (fields, np.ma.array(fields)):
        with pytest.raises(ValueError, match=r"picture holds fields by name .* give numbers\.$"):
            jv.filters.gaussian(held, 1.0)
    whole = np.zeros(1, [("a", "i4"), ("b", "i4"), ("c", "i4")])
    with pytest.raises(ValueError, match=r"TriangleMesh\.faces holds fields by name"):
        jv.TriangleMesh(np.eye(3), whole)
    swapped = np.array([[0, 1, 2]], ">i4")
    np.testing.assert_array_equal(jv.TriangleMesh(np.eye(3), swapped).faces, swapped)


@pytest.mark.slow
def test_an_invalid_random_key_is_refused():
    grey = jv.Surface(jv.Sphere([0, 0, 0], 1), jv.Lambert([0.1]), [0.5], two_sided=True)
    scene, ray = jv.Scene(grey, []), jv.Ray([0, 0, 0], [0, 0, 1])

    def traced(key):
        return jv.path_radiance(key, scene, ray, method=jv.Paths(2, 2)).radiance

    for key in (jax.random.key(5), np.asarray(jax.random.PRNGKey(5))):
        np.testing.assert_array_equal(traced(key), traced(jax.random.PRNGKey(5)))
    of_others = jax.random.PRNGKey(0, impl="rbg")  # four words
    for wrong in (of_others, np.array([0, 1]), np.array([0.0, 1.0]), 5, None):
        with pytest.raises(ValueError, match=r"path_radiance: key must be a random key, got .*\)"):
            traced(wrong)
    for several in (jax.random.split(jax.random.key(0), 3), np.zeros((3, 2), np.uint32)):
        with pytest.raises(ValueError, match=r"one random key, got an array \(3,\) of keys"):
            traced(several)
        assert jv.MonteCarlo(several, 4).key.shape[0] == 3


def test_a_picture_for_a_histogram_is_refused_by_name():
    for function in (jv.histogram.otsu_threshold, jv.histogram.cumulative_distribution):
        with pytest.raises(ValueError, match=": histogram must be a record, Histogram, got an arr"):
            function(np.ones((4, 4)))
    with pytest.raises(ValueError, match="quantile: histogram must be a record, Histogram, got an"):
        jv.histogram.quantile(np.ones((4, 4)), 0.5)


@pytest.mark.parametrize(
    ("size", "words"), [(1e-42, "becomes 0 or loses its digits"), (1e39, "becomes infinite")]
)
def test_numbers_beyond_32_bits_are_named(size, words):
    picture, intensity = np.full((8, 8), size), [size, 0.0]
    with jax.enable_x64(False), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "overflow encountered", RuntimeWarning)
        with pytest.warns(UserWarning, match=f"gaussian: picture .* {words} in float32; mul") as w:
            jv.filters.gaussian(picture, 1.0)
        assert [one.filename for one in w if one.category is UserWarning] == [__file__]
        with pytest.warns(UserWarning, match=f"PointLight.intensity .* {words}"):
            jv.PointLight([0.0, 0, 1], intensity)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert jv.filters.gaussian(picture, 1.0).max() == pytest.approx(size)
        with jax.enable_x64(False):
            tails = np.exp(-(np.arange(20.0) ** 2))  # whose single weights are tiny
            jv.filters.correlate(np.ones((32, 32)), np.outer(tails, tails)[:9, :9])


def test_a_wavelength_in_half_precision_is_named():
    """Of 550 nm float16 keeps three binary digits."""
    with pytest.warns(
        UserWarning, match="wavelength holds numbers up to 5.364e-07, of which float16"
    ):
        jv.optics.airy_radius(jnp.float16(5.5e-7), jnp.float16(8))
