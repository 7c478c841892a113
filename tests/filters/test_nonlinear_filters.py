"""Tests the median, the bilateral filter and non-local means against NumPy loops of their
definitions, SciPy and OpenCV, and their laws, gradients and refusals."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from jaxvision.filters.bilateral import bilateral_filter, joint_bilateral_filter
from jaxvision.filters.median import _selection_network, median_filter
from jaxvision.filters.nonlocal_means import nonlocal_means_filter

RNG = np.random.default_rng(9)
SCIPY = {"zero": "constant", "clamp": "nearest", "wrap": "wrap", "mirror": "reflect"}
SCIPY["reflect_101"] = "mirror"
NUMPY = {"zero": "constant", "clamp": "edge", "wrap": "wrap", "mirror": "symmetric"}
NUMPY["reflect_101"] = "reflect"
COLOUR = RNG.random((11, 13, 3))
GREY = COLOUR[..., 0].copy()
CODES = RNG.integers(0, 256, size=(11, 13), dtype=np.uint8)
FOOTPRINT = np.array([[0, 1, 1, 0, 1], [1, 1, 0, 1, 1], [0, 0, 1, 0, 0], [1, 0, 0, 0, 1]], bool)


# ------------------------------------------------ median


@pytest.mark.parametrize("n", range(1, 9))
def test_the_network_selects_from_every_order(n):
    """By the 0-1 principle (Knuth 5.3.4) a network that is right for all sequences of zeros and
    ones is right for all sequences."""
    wires = [np.array([code >> i & 1 for code in range(2**n)]) for i in range(n)]
    for rank in range(n):
        moved = list(wires)
        for i, j in _selection_network(n, rank):
            moved[i], moved[j] = np.minimum(moved[i], moved[j]), np.maximum(moved[i], moved[j])
        np.testing.assert_array_equal(moved[rank], np.sort(wires, axis=0)[rank])


@pytest.mark.sweep
@pytest.mark.parametrize("border", SCIPY)
@pytest.mark.parametrize("size", [3, (5, 2)])
def test_median_is_scipys(size, border):
    pair = (size, size) if isinstance(size, int) else size
    # SciPy's even sizes extend one pixel further to the left, like ours
    expected = ndimage.median_filter(COLOUR, size=(*pair, 1), mode=SCIPY[border])
    np.testing.assert_array_equal(median_filter(COLOUR, size=size, border=border), expected)


def test_median_of_a_footprint_and_of_codes():
    """Odd and even numbers of neighbours. For a side of 4 the centre is the third element."""
    for footprint in (FOOTPRINT, FOOTPRINT[:3]):
        expected = ndimage.median_filter(CODES, footprint=footprint, mode="reflect")
        ours = median_filter(CODES, footprint=footprint)
        assert ours.dtype == np.uint8
        np.testing.assert_array_equal(ours, expected)


@pytest.mark.sweep
@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (4, 1)])
def test_median_of_a_window_larger_than_the_image(shape):
    image = RNG.random(shape)
    expected = ndimage.median_filter(image, size=7, mode="reflect")
    np.testing.assert_array_equal(median_filter(image, size=7), expected)


def test_median_removes_impulses_and_keeps_a_step():
    step = np.where(np.arange(16) < 8, 0.2, 0.9) * np.ones((16, 1))
    noisy = step.copy()
    noisy[3, 4], noisy[9, 12] = 1.0, 0.0
    np.testing.assert_array_equal(median_filter(noisy), step)


def test_gradient_of_the_median_goes_to_the_median():
    x = jnp.asarray([[5.0, 1.0, 2.0], [7.0, 3.0, 9.0], [8.0, 4.0, 6.0]])
    centre = jax.grad(lambda x: median_filter(x)[1, 1])(x)
    np.testing.assert_array_equal(centre, np.asarray(x) == 5.0)
    tied = jax.grad(lambda x: median_filter(x)[1, 1])(jnp.ones((3, 3)))
    np.testing.assert_allclose(tied, np.full((3, 3), 1 / 9))


# ------------------------------------------------ weighted neighbours


def neighbours(image, radius, border):
    """Yield (row, column, all neighbours, their offsets, which of them exist)."""
    wide = ((radius, radius), (radius, radius), (0, 0))
    mode = NUMPY.get(border, "constant")
    around = np.pad(image, wide, mode=mode)
    there = np.pad(np.ones(image.shape[:2]), wide[:2])
    side = 2 * radius + 1
    dy, dx = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    for i, j in np.ndindex(image.shape[:2]):
        window = slice(i, i + side), slice(j, j + side)
        exists = there[window] if border == "normalised_zero" else np.ones((side, side))
        yield i, j, around[window], dy**2 + dx**2, exists


@pytest.mark.sweep
@pytest.mark.parametrize("border", ["mirror", "normalised_zero"])
@pytest.mark.parametrize("window", ["square", "disc"])
def test_bilateral_is_the_loop(window, border):
    expected = np.zeros_like(COLOUR)
    for i, j, values, away, exists in neighbours(COLOUR, 3, border):
        unlike = ((values - COLOUR[i, j]) ** 2).sum(axis=-1)
        weight = exists * np.exp(-away / (2 * 1.5**2) - unlike / (2 * 0.3**2))
        if window == "disc":
            weight = weight * (away <= 9)
        expected[i, j] = (weight[..., None] * values).sum(axis=(0, 1)) / weight.sum()
    ours = bilateral_filter(COLOUR, 1.5, 0.3, radius=3, window=window, border=border)
    np.testing.assert_allclose(ours, expected, rtol=1e-12)


def test_joint_bilateral_is_the_loop():
    expected = np.zeros_like(GREY)
    for i, j, values, away, _ in neighbours(np.dstack([GREY, COLOUR]), 2, "mirror"):
        unlike = np.abs(values[..., 1:] - COLOUR[i, j]).sum(axis=-1) ** 2
        weight = np.exp(-away / (2 * 1.5**2) - unlike / (2 * 0.3**2))
        expected[i, j] = (weight * values[..., 0]).sum() / weight.sum()
    ours = joint_bilateral_filter(GREY, COLOUR, 1.5, 0.3, radius=2, difference="sum")
    np.testing.assert_allclose(ours, expected, rtol=1e-12)


def test_bilateral_is_opencvs():
    """OpenCV's table of exp has an error of about 1e-6."""
    import cv2

    single = COLOUR.astype(np.float32)
    theirs = cv2.bilateralFilter(single, 7, 0.2, 1.5, borderType=cv2.BORDER_REPLICATE)
    options = {"radius": 3, "window": "disc", "difference": "sum", "border": "clamp"}
    ours = bilateral_filter(single, 1.5, 0.2, **options)
    assert ours.dtype == np.float32
    np.testing.assert_allclose(ours, theirs, atol=3e-6)


def test_bilateral_limits():
    """With a wide range weight the result is the Gaussian filter, and with sigmas of 0 the picture
    itself."""
    wide = bilateral_filter(GREY, 1.2, 1e6, radius=4)
    kernel = np.exp(-(np.arange(-4, 5) ** 2) / (2 * 1.2**2))
    expected = GREY
    for axis in (0, 1):
        expected = ndimage.correlate1d(expected, kernel / kernel.sum(), axis, mode="reflect")
    np.testing.assert_allclose(wide, expected, rtol=1e-10)
    for sigmas in ((0.0, 0.3), (1.2, 0.0)):
        np.testing.assert_allclose(bilateral_filter(GREY, *sigmas, radius=4), GREY, rtol=1e-14)


def patch_weights(patch, profile):
    if profile == "uniform":
        return np.full((patch, patch), 1 / patch**2)
    y, x = np.mgrid[:patch, :patch] - patch // 2
    bell = np.exp(-(x**2 + y**2) / (2 * ((patch - 1) / 4) ** 2))
    return bell / bell.sum()


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("profile", "noise", "cutoff"), [("uniform", 0.1, 2.0), ("gaussian", 0.0, None)]
)
def test_nonlocal_means_is_the_loop(profile, noise, cutoff):
    radius, half = 2, 1
    weights = patch_weights(3, profile)[..., None] / 3
    around = np.pad(COLOUR, ((3, 3), (3, 3), (0, 0)), mode="symmetric")
    expected = np.zeros_like(COLOUR)
    for i, j in np.ndindex(GREY.shape):
        here, total = around[i + radius :, j + radius :][:3, :3], 0.0
        for di, dj in np.ndindex(5, 5):
            there = around[i + di :, j + dj :][:3, :3]
            distance = (weights * (there - here) ** 2).sum() - 2 * noise**2
            exponent = max(distance, 0) / 0.3**2
            weight = np.exp(-exponent) * (cutoff is None or exponent <= cutoff)
            expected[i, j] += weight * there[half, half]
            total += weight
        expected[i, j] /= total
    options = {"patch": 3, "radius": radius, "profile": profile, "cutoff": cutoff}
    ours = nonlocal_means_filter(COLOUR, 0.3, noise=noise, **options)
    np.testing.assert_allclose(ours, expected, rtol=1e-12)


def test_nonlocal_means_is_scikit_images():
    """scikit-image's exp is approximate (weights within 4 %), so the changes agree within 4 %."""
    from skimage import restoration

    image = RNG.random((20, 20)) * 0.2 + np.linspace(0, 1, 20)
    theirs = restoration.denoise_nl_means(image, 5, 3, 0.2, fast_mode=False)
    options = {"patch": 5, "radius": 3, "profile": "gaussian", "cutoff": 5.0}
    ours = np.asarray(nonlocal_means_filter(image, 0.2, **options))
    inside = np.s_[5:-5, 5:-5]
    change = np.abs(theirs - image)[inside].max()
    assert np.abs(ours - theirs)[inside].max() < 0.04 * change


FILTERS = {
    "median": median_filter,
    "bilateral": partial(bilateral_filter, sigma_space=1.0, sigma_range=0.2, radius=1),
    "nonlocal": partial(nonlocal_means_filter, strength=0.2, patch=3, radius=1),
}


@pytest.mark.sweep
@pytest.mark.parametrize("name", FILTERS)
def test_batch_dtype_nan_and_views(name):
    filtered = FILTERS[name]
    batch = np.stack([COLOUR, COLOUR[::-1]]).astype(np.float32)
    result = filtered(batch)
    assert result.dtype == np.float32
    # each image alone, from a view with its own strides
    np.testing.assert_allclose(
        result[1], filtered(batch[1].transpose(1, 0, 2)).transpose(1, 0, 2), rtol=2e-6
    )
    holed = COLOUR.copy()
    holed[5, 6, 0] = np.nan
    reach = np.isnan(np.asarray(filtered(holed))).any(axis=-1)
    assert reach[4:7, 5:8].all()
    assert reach.sum() < reach.size / 2


@pytest.mark.slow
def test_gradients_of_flat_pictures_are_finite():
    flat = jnp.full((6, 7), 0.4)
    for filtered in FILTERS.values():
        assert jnp.isfinite(jax.jit(jax.grad(lambda x, f=filtered: f(x)[2, 3]))(flat)).all()
    by_sigma = jax.grad(lambda s: bilateral_filter(flat, s, s, radius=1).sum())
    sigmas = jnp.asarray([0.0, 1e-300, 1e-3, 1e300])
    assert jnp.isfinite(jax.jit(jax.vmap(by_sigma))(sigmas)).all()


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: median_filter(GREY, size=0), "at least 1, got 0"),
        (lambda: median_filter(GREY, footprint=np.zeros((3, 3))), "true element"),
        (lambda: median_filter(GREY, footprint=np.ones(3)), r"\(3,\)"),
        (lambda: median_filter(GREY, border="normalised_zero"), "no sum"),
        (lambda: median_filter(GREY, border="constant"), "needs a fill"),
        (lambda: median_filter(np.full((3, 3), 2**24 + 1, np.int32)), "got int32"),
        (lambda: median_filter(GREY > 0.5), "got bool"),
        (lambda: bilateral_filter(GREY, 1.0, 1.0, radius=1, border="constant"), "needs a fill"),
        (lambda: nonlocal_means_filter(GREY, 1.0, border="constant"), "needs a fill"),
        (lambda: median_filter(GREY, border="reflect"), "border must be"),
        (lambda: median_filter(np.zeros((0, 4))), "at least one pixel"),
        (lambda: bilateral_filter(GREY, 1.0, 1.0, radius=-1), "got -1"),
        (lambda: bilateral_filter(GREY, 1.0, 1.0, radius=1, window="hexagon"), "hexagon"),
        (lambda: joint_bilateral_filter(GREY, COLOUR[1:], 1.0, 1.0, radius=1), "but for their"),
        (
            lambda: nonlocal_means_filter(GREY, 1.0, patch=4),
            "patch must be an odd number of at least 1, got 4",
        ),
        (lambda: nonlocal_means_filter(GREY, 1.0, profile="box"), "box"),
        (lambda: nonlocal_means_filter(np.zeros(4), 1.0), r"\(4,\)"),
    ],
)
def test_bad_input_is_one_sentence(call, words):
    with pytest.raises(ValueError, match=words) as caught:
        call()
    assert "\n" not in str(caught.value)


@pytest.mark.sweep
@pytest.mark.parametrize("dtype", [jnp.float16, jnp.bfloat16], ids=["float16", "bfloat16"])
def test_half_precision_sums_a_window_accurately(dtype):
    """The mean is over 169 or 441 equal numbers, whose sum in half precision overflows or
    stagnates."""
    flat = jnp.full((24, 24), 30000, dtype)
    for found in (
        bilateral_filter(flat, 100.0, 100.0, radius=10),
        nonlocal_means_filter(flat, 1.0, radius=6),
    ):
        assert found.dtype == dtype
        np.testing.assert_array_equal(found, flat)
