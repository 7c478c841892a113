"""Tests integral images against NumPy sums and OpenCV, their accuracy, gradients and refusals."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxvision.filters.integral import IntegralImage, box_sum, integral_image, window_sum

RNG = np.random.default_rng(11)
COLOUR = RNG.random((7, 9, 3))
CODES = RNG.integers(0, 256, size=(12, 10), dtype=np.uint8)


def test_entries_are_exclusive_sums_as_in_opencv():
    import cv2

    ours = integral_image(CODES)
    np.testing.assert_array_equal(ours.high, cv2.integral(CODES))
    np.testing.assert_array_equal(ours.low, np.zeros((13, 11)))
    inclusive = np.cumsum(np.cumsum(COLOUR, axis=0), axis=1)
    np.testing.assert_allclose(integral_image(COLOUR).high[1:, 1:], inclusive, rtol=1e-14)


def test_every_box():
    integral = integral_image(COLOUR)
    corners = np.array(list(np.ndindex(8, 10)))
    pairs = corners[RNG.integers(0, len(corners), size=(200, 2))]
    sums = jax.vmap(lambda a, b: box_sum(integral, a[0], a[1], b[0], b[1]))(
        jnp.asarray(pairs[:, 0]), jnp.asarray(pairs[:, 1])
    )
    for (a, b), ours in zip(pairs, sums, strict=True):
        expected = COLOUR[a[0] : b[0], a[1] : b[1]].sum(axis=(0, 1))
        np.testing.assert_allclose(ours, expected, atol=1e-14)


def test_bounds_beyond_the_image_are_moved_to_its_edge():
    whole = box_sum(integral_image(COLOUR), *(jnp.asarray(i) for i in (-5, -5, 99, 99)))
    np.testing.assert_allclose(whole, COLOUR.sum(axis=(0, 1)), rtol=1e-15)


@pytest.mark.parametrize("size", [(1, 1), (3, 4), (7, 9)])
def test_sliding_windows(size):
    batch = np.stack([COLOUR, COLOUR[::-1]])
    windows = np.lib.stride_tricks.sliding_window_view(batch, size, axis=(1, 2))
    ours = window_sum(integral_image(batch), size)
    np.testing.assert_allclose(ours, windows.sum(axis=(-2, -1)), rtol=1e-13)


@pytest.mark.sweep
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_small_boxes_far_from_the_origin_keep_their_digits(dtype):
    """A dark corner is below a bright sky, whose sum is 10^9 times the box's."""
    image = np.full((400, 300), 1e4)
    image[-3:, -3:] = RNG.random((3, 3))
    image = image.astype(dtype)
    last = window_sum(integral_image(image), (3, 3))[-1, -1]
    expected = image[-3:, -3:].astype(float).sum()
    # the error is 2^-46 (2^-104) relative to the whole, as the module says, and half a ULP of the
    # box
    bound = image.astype(float).sum() * 2.0 ** (-46 if dtype == np.float32 else -104)
    assert last.dtype == dtype
    assert abs(float(last) - expected) <= bound + np.finfo(dtype).eps * expected
    single = np.cumsum(np.cumsum(image, axis=0), axis=1)
    corner = single[-1, -1] - single[-4, -1] - single[-1, -4] + single[-4, -4]
    assert abs(float(corner) - expected) > 1e3 * abs(float(last) - expected)


def test_gradient_of_a_box_is_its_indicator():
    image = jnp.asarray(COLOUR)
    box = [jnp.asarray(i) for i in (2, 3, 5, 8)]
    slope = jax.grad(lambda x: box_sum(integral_image(x), *box)[1])(image)
    expected = np.zeros_like(COLOUR)
    expected[2:5, 3:8, 1] = 1
    np.testing.assert_allclose(slope, expected, atol=1e-15)


def test_nan_spreads_below_and_right_only():
    image = COLOUR[..., 0].copy()
    image[3, 4] = np.nan
    entries = np.isnan(integral_image(image).high)
    expected = np.zeros_like(entries)
    expected[4:, 5:] = True
    np.testing.assert_array_equal(entries, expected)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: integral_image(np.zeros(3)), r"got shape .3,.: a signal .* signal.None."),
        (lambda: integral_image(np.zeros((0, 3))), "at least one pixel"),
        (lambda: integral_image(np.ones((2, 3)) * 1j), "complex"),
        (lambda: window_sum(integral_image(CODES), (13, 2)), r"\(13, 2\)"),
        (lambda: window_sum(integral_image(CODES), (0, 2)), r"\(0, 2\)"),
        (lambda: window_sum(IntegralImage(jnp.zeros(3), jnp.zeros(3)), (1, 1)), "rank 1"),
    ],
)
def test_bad_input_is_one_sentence(call, words):
    with pytest.raises(ValueError, match=words) as caught:
        call()
    assert "\n" not in str(caught.value)
