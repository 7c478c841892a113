"""Numbers as other programs hand them to a fit: byte order, text, complex numbers, gaps."""

import datetime

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
    """As astropy gives a FITS table: (sum of x y) / (sum of x^2) of centred numbers is 2."""
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
def test_what_is_no_number_is_refused_by_the_name_of_its_argument(held, words):
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
    inputs = TIME + 1j  # which predict may ask for
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
    both = fit(line(np.where(np.isnan(gap), np.nan, TRUTH), gap))  # a row that is not there
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
