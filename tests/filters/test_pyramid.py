"""Tests pyramids against the zero-stuffed convolution of their definition and OpenCV, with exact
reconstruction, laws of blending, and refusals."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from jaxvision.filters.pyramid import (
    blend_by_pyramid,
    collapse_laplacian,
    expand,
    gaussian_pyramid,
    laplacian_pyramid,
    reduce_by_two,
)

RNG = np.random.default_rng(10)
SHAPES = [(13, 18, 2), (16, 16), (1, 7), (2, 5, 6, 3)]
SCIPY = {"zero": "constant", "clamp": "nearest", "wrap": "wrap", "mirror": "reflect"}
TAPS = np.array([1, 4, 6, 4, 1]) / 16
GREY = RNG.random((13, 18))


@pytest.mark.parametrize("border", SCIPY)
def test_reduction_is_the_blur_at_even_pixels(border):
    blurred = GREY
    for axis in (0, 1):
        blurred = ndimage.correlate1d(blurred, TAPS, axis, mode=SCIPY[border])
    np.testing.assert_allclose(reduce_by_two(GREY, border=border), blurred[::2, ::2], rtol=1e-13)


@pytest.mark.parametrize("size", [(26, 36), (25, 35), (26, 35)])
def test_expansion_is_the_blur_of_zero_stuffed_pixels(size):
    """The reference has twice the kernel on each side, on coarse pixels with zeros between them."""
    around = np.pad(GREY, 2, mode="symmetric")
    apart = np.zeros((2 * around.shape[0], 2 * around.shape[1]))
    apart[::2, ::2] = around
    for axis in (0, 1):
        apart = ndimage.correlate1d(apart, 2 * TAPS, axis)
    expected = apart[4 : 4 + size[0], 4 : 4 + size[1]]
    np.testing.assert_allclose(expand(GREY, size), expected, rtol=1e-13)


def test_levels_are_opencvs():
    import cv2

    theirs = cv2.pyrDown(GREY, borderType=cv2.BORDER_REFLECT)
    np.testing.assert_allclose(reduce_by_two(GREY), theirs, rtol=1e-13)
    theirs = cv2.pyrUp(GREY)  # which has another border
    np.testing.assert_allclose(expand(GREY, (26, 36))[2:-2, 2:-2], theirs[2:-2, 2:-2], rtol=1e-13)


@pytest.mark.sweep
@pytest.mark.parametrize("shape", SHAPES)
def test_reconstruction_is_exact(shape):
    image = RNG.random(shape)
    pyramid = laplacian_pyramid(image, 4)
    assert [level.ndim for level in pyramid] == [len(shape)] * 4
    np.testing.assert_allclose(collapse_laplacian(pyramid), image, atol=4 * np.finfo(float).eps)


def test_reconstruction_holds_for_every_border_and_size():
    for border in ("zero", "wrap", "extend", "normalised_zero"):
        pyramid = laplacian_pyramid(GREY, 2, border=border)
        rebuilt = collapse_laplacian(pyramid, border=border)
        np.testing.assert_allclose(rebuilt, GREY, atol=1e-15)


@pytest.mark.slow
def test_constants_stay_constant_but_for_the_border_zero():
    flat = np.full((9, 10), 0.7)
    for border in ("clamp", "mirror", "wrap", "extend", "normalised_zero"):
        for level in gaussian_pyramid(flat, 3, border=border):
            np.testing.assert_allclose(level, 0.7, rtol=1e-14)
    darker = reduce_by_two(flat, border="zero")
    assert float(darker[0, 0]) < 0.5 < 0.69 < float(darker[2, 2])


@pytest.mark.slow
def test_blending():
    """One level is the plain blend, a mask of ones returns the first image, and a sharp mask leaves
    no step."""
    one, other = np.full((32, 32), 0.2), np.full((32, 32), 0.8)
    mask = (np.arange(32) < 16) * np.ones((32, 1))
    np.testing.assert_allclose(blend_by_pyramid(one, other, mask, 1), 0.8 - 0.6 * mask, rtol=1e-14)
    first, second = RNG.random((2, 32, 32, 3))
    ones = np.ones((32, 32, 1))
    np.testing.assert_allclose(blend_by_pyramid(first, second, ones, 2), first, atol=1e-15)
    smooth = np.asarray(blend_by_pyramid(one, other, mask, 4))[16]
    assert np.diff(smooth).min() >= 0
    assert np.diff(smooth).max() < 0.1  # the step of a plain blend is 0.6
    assert smooth[0] < 0.22
    assert smooth[-1] > 0.78


def test_gradient_is_the_transpose():
    """Checks <R x, y> = <x, R' y> for the linear reduction R and its reverse-mode gradient R'."""
    y = RNG.random((7, 9))
    back = jax.grad(lambda x: jnp.vdot(reduce_by_two(x), y))(jnp.asarray(GREY))
    ahead = np.vdot(reduce_by_two(GREY[::-1].copy()), y)
    np.testing.assert_allclose(np.vdot(GREY[::-1], back), ahead, rtol=1e-13)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: reduce_by_two(GREY, border="constant"), "needs a fill"),
        (lambda: gaussian_pyramid(np.zeros(4), 1), r"\(4,\)"),
        (lambda: gaussian_pyramid(GREY, 0), "at least 1, got 0"),
        (lambda: laplacian_pyramid(GREY, -1), "got -1"),
        (lambda: collapse_laplacian(()), "at least 1, got 0"),
        (lambda: expand(GREY, (13, 18)), r"got size \(13, 18\)"),
        (lambda: reduce_by_two(np.zeros(4)), r"\(4,\)"),
        (lambda: reduce_by_two(GREY, border="reflect"), "border must be"),
        (lambda: blend_by_pyramid(GREY, GREY[1:], GREY, 2), "one shape"),
    ],
)
def test_bad_input_is_one_sentence(call, words):
    with pytest.raises(ValueError, match=words) as caught:
        call()
    assert "\n" not in str(caught.value)
