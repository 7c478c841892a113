"""Tests borders against `numpy.pad` and SciPy, for planes and images, and far outside the
picture."""

import jax
import numpy as np
import pytest
from scipy import signal

from jaxvision import filters
from jaxvision.filters.padding import BORDERS, ghosts, pad

RNG = np.random.default_rng(4)
NUMPY = {
    "zero": {"mode": "constant"},
    "normalised_zero": {"mode": "constant"},
    "constant": {"mode": "constant", "constant_values": 0.7},
    "clamp": {"mode": "edge"},
    "wrap": {"mode": "wrap"},
    "mirror": {"mode": "symmetric"},
    "reflect_101": {"mode": "reflect"},
    "extend": {"mode": "reflect", "reflect_type": "odd"},
}


@pytest.mark.sweep("mirror")
@pytest.mark.parametrize("border", BORDERS)
@pytest.mark.parametrize("size", [(4, 5), (1, 3), (1, 1), (2, 1)])
def test_equal_to_numpy_also_far_beyond_the_picture(border, size):
    plane = RNG.normal(size=size)
    widths = ((3, 9), (11, 0))
    expected = np.pad(plane, widths, **NUMPY[border])
    got = jax.jit(
        lambda plane: pad(plane, widths, border=border, fill=0.7 * (border == "constant"))
    )(plane)
    np.testing.assert_allclose(got, expected, rtol=1e-13, atol=1e-13)


def test_every_border_was_compared():
    assert NUMPY.keys() == BORDERS.keys()


@pytest.mark.slow
def test_extend_is_scipys_odd_extension():
    row = RNG.normal(size=(1, 9))
    expected = signal._arraytools.odd_ext(row, 6)
    np.testing.assert_allclose(pad(row, ((0, 0), (6, 6)), border="extend"), expected, atol=1e-14)


@pytest.mark.sweep
@pytest.mark.parametrize("border", BORDERS)
def test_batch_and_bands_are_planes_of_their_own(border):
    batch = RNG.normal(size=(2, 3, 4, 5, 2)).astype(np.float32)
    fill = np.array([0.25, -3.0], np.float32)
    got = jax.jit(
        lambda batch: pad(
            batch, ((2, 1), (0, 3)), border=border, fill=fill * (border == "constant")
        )
    )(batch)
    got = np.asarray(got)
    assert got.dtype == np.float32
    assert got.shape == (2, 3, 7, 8, 2)
    options = dict(NUMPY[border])
    for i, j, band in np.ndindex(2, 3, 2):
        if border == "constant":
            options["constant_values"] = float(fill[band])
        expected = np.pad(batch[i, j, :, :, band], ((2, 1), (0, 3)), **options)
        np.testing.assert_allclose(got[i, j, :, :, band], expected, rtol=1e-6)


@pytest.mark.sweep
@pytest.mark.parametrize("border", BORDERS)
@pytest.mark.parametrize("n", [1, 2, 5])
def test_ghosts_equal_padding(border, n):
    row = RNG.normal(size=n)
    rule = ghosts(border, n, 7, 12)
    by_rule = rule.own * row[rule.source] + rule.first * row[0] + rule.last * row[-1]
    np.testing.assert_allclose(
        pad(row[None], ((0, 0), (7, 12)), border=border)[0], by_rule, atol=1e-12
    )
    inside = slice(7, 7 + n)
    assert (rule.source[inside] == np.arange(n)).all()
    assert (rule.own[inside] == 1).all()


def test_unknown_border_names_all_of_them_in_three_languages():
    with pytest.raises(ValueError, match="nearest") as error:
        pad(np.ones((2, 2)), ((1, 1), (1, 1)), border="edge")
    words = str(error.value)
    assert all(f'"{name}"' in words for name in BORDERS)
    assert all(name in words for name in ("numpy", "scipy", '"edge"', '"symmetric"', '"reflect"'))
    assert 'numpy "reflect", scipy "mirror"' in words


@pytest.mark.parametrize("shape", [(0,), (0, 4), (2, 3, 0), ()])
def test_no_picture(shape):
    with pytest.raises(ValueError, match="at least one pixel"):
        pad(np.ones(shape), ((1, 1), (1, 1)))


def test_a_one_dimensional_signal_is_refused_with_alternatives():
    """The alternatives named in the message work, and agree."""
    signal = np.arange(20.0) ** 2
    with pytest.raises(ValueError, match=r"signal \(n,\).*correlate.*gaussian_kernel.*\[None\]"):
        filters.gaussian(signal, 2.0)
    own = filters.correlate(signal, filters.gaussian_kernel(2.0, size=9), border="mirror")
    row = filters.gaussian(signal[None], 2.0, size=9)[0]
    np.testing.assert_allclose(own, row, rtol=1e-5)


@pytest.mark.parametrize("widths", [((1, -1), (0, 0)), ((1, 1),), ((1, 1), (1, 1), (1, 1))])
def test_widths_of_another_form(widths):
    with pytest.raises(ValueError, match=r"\(top, bottom\).*>= 0"):
        pad(np.ones((2, 2)), widths)


def test_complex_pictures_are_refused():
    with pytest.raises(ValueError, match="real and the imaginary"):
        pad(np.ones((2, 2)) * 1j, ((1, 1), (1, 1)))
