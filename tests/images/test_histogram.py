"""Tests histograms against NumPy, thresholds and equalisation against OpenCV and scikit-image, laws
of distributions, gradients, and refusals."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxvision.histogram import (
    Histogram,
    cumulative_distribution,
    equalise,
    equalise_locally,
    exact_histogram,
    match_histogram,
    otsu_threshold,
    quantile,
    soft_histogram,
)

RNG = np.random.default_rng(8)
# Two peaks, one of them narrow, with empty codes between, as in a photograph.
CODES = np.clip(
    np.where(
        RNG.random((64, 48)) < 0.6,
        RNG.normal(60, 6, (64, 48)),
        20 * np.round(RNG.normal(9, 2, (64, 48))),
    ),
    0,
    255,
).astype(np.uint8)
VALUES = RNG.normal(0.5, 0.3, size=(64, 48))
COLOUR = np.stack([CODES, 255 - CODES, np.roll(CODES, 5, axis=0) // 2], axis=-1)


# ------------------------------------------------ counts


@pytest.mark.sweep
@pytest.mark.parametrize(("bins", "value_range"), [(7, (0.0, 1.0)), (100, (0.1, 0.9))])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_floating_counts_are_numpys(bins, value_range, dtype):
    """This includes values exactly on the edges, where the quotient alone may round to either
    side."""
    edges = np.linspace(*value_range, bins + 1).astype(dtype)
    x = np.concatenate([VALUES.ravel().astype(dtype), edges, np.nextafter(edges, dtype(0))])
    ours = exact_histogram(x[None], bins=bins, value_range=value_range)
    counts, expected_edges = np.histogram(x, bins, value_range)
    np.testing.assert_array_equal(ours.counts, counts)
    assert ours.edges.dtype == dtype
    np.testing.assert_array_equal(ours.edges, expected_edges.astype(dtype))


@pytest.mark.sweep("33")
@pytest.mark.parametrize(
    ("bins", "value_range"), [(None, None), (10, None), (33, (10.0, 200.0)), (5, (0.0, 255.0))]
)
def test_codes_are_counted_as_numpy_does(bins, value_range):
    ours = exact_histogram(CODES, bins=bins, value_range=value_range)
    expected, edges = np.histogram(CODES, bins or 256, value_range or (0, 256))
    np.testing.assert_array_equal(ours.counts, expected)
    np.testing.assert_allclose(ours.edges, edges, rtol=1e-15)


def test_sixteen_bits_and_views_in_place():
    wide = RNG.integers(0, 65536, size=(20, 30), dtype=np.uint16)[::2, ::-3]
    counts = exact_histogram(wide).counts
    np.testing.assert_array_equal(counts, np.bincount(wide.ravel(), minlength=65536))


def test_every_band_of_every_image_is_counted_alone():
    batch = np.stack([COLOUR, COLOUR[::-1] // 3])
    counts = exact_histogram(batch).counts
    assert counts.shape == (2, 3, 256)
    for image, of_image in zip(batch, counts, strict=True):
        for band in range(3):
            expected = np.bincount(image[..., band].ravel(), minlength=256)
            np.testing.assert_array_equal(of_image[band], expected)


def test_nan_and_values_outside_the_range_are_not_counted():
    x = jnp.asarray([[jnp.nan, -0.1, 0.0, 1.0, 1.1, jnp.inf]])
    for count in (exact_histogram, soft_histogram):
        with pytest.warns(UserWarning, match=r"4 of 6 values are outside \[0, 1\] or NaN"):
            histogram = count(x, bins=4)
        np.testing.assert_array_equal(histogram.counts, [1, 0, 0, 1])
        count(x, bins=4, value_range=(0, 1))  # with the given range


def test_soft_weights_against_the_loop():
    """The weight is max(0, 1 - |d|) for a distance of d bins from the bin's centre."""
    x, bins = VALUES[:8], 9
    expected = np.zeros(bins)
    for value in x[(x >= 0) & (x <= 1)]:
        centre = (np.arange(-1, bins + 1) + 0.5) / bins
        weight = np.maximum(0, 1 - np.abs(value - centre) * bins)
        weight[1] += weight[0]
        weight[-2] += weight[-1]
        expected += weight[1:-1]
    found = soft_histogram(x, bins=bins, value_range=(0, 1))
    np.testing.assert_allclose(found.counts, expected, rtol=1e-12)


def test_cubic_weights_are_the_b_spline():
    from scipy.interpolate import BSpline

    x, bins = np.linspace(0.3, 0.7, 23)[None], 10
    spline = BSpline.basis_element(np.arange(5) - 2.0, extrapolate=False)
    distance = x.ravel()[:, None] * bins - 0.5 - np.arange(bins)
    expected = np.nan_to_num(spline(distance)).sum(axis=0)
    soft = soft_histogram(x, bins=bins, kernel="cubic")
    np.testing.assert_allclose(soft.counts, expected, atol=1e-13)


@pytest.mark.slow
def test_departure_is_the_weight_in_other_bins_and_zero_for_integer_codes():
    exact, soft = exact_histogram(VALUES, bins=20), soft_histogram(VALUES, bins=20)
    moved = np.abs(np.asarray(soft.counts) - np.asarray(exact.counts)).sum() / 2
    np.testing.assert_allclose(soft.departure, moved / np.asarray(exact.counts).sum())
    assert 0.001 < float(soft.departure) < 0.2
    of_codes = soft_histogram(COLOUR)
    np.testing.assert_array_equal(of_codes.departure, [0, 0, 0])
    np.testing.assert_array_equal(of_codes.counts, exact_histogram(COLOUR).counts)


def test_departure_falls_with_the_square_of_the_width_for_smooth_data():
    """The values are quantiles of a normal distribution, so there is no counting noise."""
    from scipy.stats import norm

    x = norm.ppf((np.arange(40000) + 0.5) / 40000, 0.5, 0.08)[None]
    coarse, fine = (float(soft_histogram(x, bins=bins).departure) for bins in (16, 32))
    assert 3.3 < coarse / fine < 4.7


# ------------------------------------------------ distribution, quantiles, threshold


def test_cumulative_distribution_is_the_fraction_below_each_edge():
    histogram = exact_histogram(VALUES, bins=17, value_range=(-2.0, 2.0))
    below = [(edge > VALUES).mean() for edge in np.asarray(histogram.edges)]
    np.testing.assert_allclose(cumulative_distribution(histogram), below, atol=1e-15)
    nothing = exact_histogram(VALUES, bins=3, value_range=(8.0, 9.0))
    np.testing.assert_array_equal(cumulative_distribution(nothing), [0, 0, 0, 0])


@pytest.mark.slow
def test_quantile_is_within_a_bin():
    histogram = exact_histogram(VALUES, bins=400, value_range=(-2.0, 2.0))
    q = np.array([0.0, 0.01, 0.25, 0.5, 0.9, 1.0])
    ours = jax.jit(jax.vmap(lambda q: quantile(histogram, q)))(q)
    exact = np.quantile(VALUES, q, method="inverted_cdf")
    assert np.abs(np.asarray(ours) - exact).max() <= 0.01


def test_quantile_is_linear_within_a_bin():
    """It is the inverse of the cumulative distribution, which is linear within each bin."""
    histogram = exact_histogram(VALUES, bins=12, value_range=(0.1, 0.9))  # no bin is empty
    q = np.array([0.0, 0.013, 0.2, 0.5, 0.777, 1.0])
    below = [((edge > VALUES) & (VALUES >= 0.1)).sum() for edge in np.asarray(histogram.edges)]
    below[-1] = ((VALUES >= 0.1) & (VALUES <= 0.9)).sum()
    wanted = np.interp(q, np.array(below) / below[-1], np.linspace(0.1, 0.9, 13))
    ours = jax.jit(jax.vmap(lambda q: quantile(histogram, q)))(q)
    np.testing.assert_allclose(ours, wanted, atol=1e-12)


@pytest.mark.slow
def test_otsu_is_opencvs_and_scikit_images():
    import cv2
    from skimage import filters

    ours = otsu_threshold(exact_histogram(COLOUR))
    for band in range(3):
        plane = np.ascontiguousarray(COLOUR[..., band])
        assert float(ours[band]) == filters.threshold_otsu(plane) + 1
        assert float(ours[band]) == cv2.threshold(plane, 0, 255, cv2.THRESH_OTSU)[0] + 1


# ------------------------------------------------ equalisation and matching


def levels_apart(ours, theirs):
    return int(np.abs(np.asarray(ours).astype(int) - np.asarray(theirs).astype(int)).max())


@pytest.mark.parametrize(
    "codes", [CODES, CODES // 16 + 100, np.full((64, 48), 7, np.uint8)], ids=["hills", "few", "one"]
)
def test_equalisation_is_opencvs(codes):
    import cv2

    assert levels_apart(equalise(codes), cv2.equalizeHist(codes)) <= 1


def test_without_the_first_code_at_zero_equalisation_is_the_textbook_formula():
    """The curve is 255 c(I), which is 153 for 60 % black pixels."""
    black = np.where(np.arange(100) < 60, 0, 200).astype(np.uint8).reshape(10, 10)
    assert np.unique(equalise(black, first_to_zero=False)).tolist() == [153, 255]
    c = np.cumsum(np.bincount(CODES.ravel(), minlength=256)) / CODES.size
    np.testing.assert_array_equal(
        equalise(CODES, first_to_zero=False), np.round(255 * c).astype(np.uint8)[CODES]
    )


@pytest.mark.parametrize("value", [0.0, 0.5, 0.501, 1.0])
def test_a_picture_of_one_value_is_unchanged(value):
    flat = np.full((8, 9), value)
    np.testing.assert_array_equal(equalise(flat), flat)
    np.testing.assert_array_equal(equalise_locally(flat, tiles=(2, 2), clip_limit=None), flat)


def test_values_outside_are_counted_at_the_ends():
    """A quarter of the values is below and a quarter above. The curve is that of the clamped
    picture."""
    x = np.linspace(-0.5, 1.5, 4000)[None]
    got = np.asarray(equalise(x, bins=4))
    # the four bins have 3/8, 1/8, 1/8 and 3/8 of the values
    corners, heights = [0, 0.25, 0.5, 0.75, 1], [0, 3 / 8, 1 / 2, 5 / 8, 1]
    np.testing.assert_allclose(got, np.interp(np.clip(x, 0, 1), corners, heights), atol=1e-12)
    bright = np.full((4, 4), 2.0)
    bright[0, 0] = 7.0
    np.testing.assert_array_equal(equalise(bright), 1)
    nothing = equalise(np.full((4, 4), np.nan))
    assert np.isnan(nothing).all()


def test_lists_and_numbers_of_numpy():
    ours = exact_histogram(VALUES, bins=np.int64(5), value_range=[0.0, 1.0])
    np.testing.assert_array_equal(ours.counts, np.histogram(VALUES, 5, (0, 1))[0])
    np.testing.assert_array_equal(
        equalise_locally(CODES, tiles=[4, 3]), equalise_locally(CODES, tiles=(4, 3))
    )


def test_equalised_values_are_uniform():
    """The distribution of the result is uniform, the purpose stated in the textbook."""
    flat = equalise(np.clip(VALUES, 0, 1), bins=500)
    counts = exact_histogram(flat, bins=10).counts
    inside = ((VALUES > 0) & (VALUES < 1)).mean()
    assert np.abs(np.asarray(counts)[1:-1] / VALUES.size - 0.1).max() < 0.02 / inside


def test_partial_equalisation_blends_with_the_identity():
    full, half = equalise(CODES), equalise(CODES, amount=0.5)
    blend = (CODES.astype(float) + np.asarray(full).astype(float)) / 2
    assert np.abs(np.asarray(half) - blend).max() <= 0.75  # two roundings
    np.testing.assert_array_equal(equalise(CODES, amount=0.0), CODES)
    x = np.clip(VALUES, 0, 1)
    expected = 0.7 * x + 0.3 * np.asarray(equalise(x))
    np.testing.assert_allclose(equalise(x, amount=0.3), expected, rtol=1e-12)


@pytest.mark.slow
def test_gradient_of_equalisation_is_the_slope_of_the_fixed_curve():
    """The slope is the density in each value's bin: its count over n and the bin's width."""
    x = jnp.asarray(RNG.uniform(size=(20, 30)))
    slope = jax.grad(lambda x: equalise(x, bins=8).sum())(x)
    counts = exact_histogram(x, bins=8).counts
    np.testing.assert_allclose(slope, np.asarray(counts)[(x * 8).astype(int)] * 8 / 600, rtol=1e-12)


@pytest.mark.parametrize(
    ("tiles", "clip_limit"),
    [((8, 8), 2.0), ((8, 8), 40.0), ((8, 8), 0.5), ((5, 7), 3.0), ((4, 3), None)],
)
def test_clahe_is_opencvs(tiles, clip_limit):
    """The picture's size is divisible by the tiles, or not."""
    import cv2

    peer = cv2.createCLAHE(0.0 if clip_limit is None else clip_limit, tiles[::-1])
    ours = equalise_locally(CODES, tiles=tiles, clip_limit=clip_limit)
    assert levels_apart(ours, peer.apply(CODES)) <= 1


def test_a_clip_limit_of_0_is_refused_as_opencv_means_none_by_it():
    for limit in (0, 0.0, -1.0):
        with pytest.raises(ValueError, match="None is for no limit, which OpenCV writes as 0"):
            equalise_locally(CODES, clip_limit=limit)


def test_clahe_of_sixteen_bits_is_opencvs():
    import cv2

    wide = (CODES.astype(np.uint16) * 200 + RNG.integers(0, 200, CODES.shape)).astype(np.uint16)
    ours = equalise_locally(wide, tiles=(4, 4), clip_limit=3.0)
    assert levels_apart(ours, cv2.createCLAHE(3.0, (4, 4)).apply(wide)) <= 1


def test_clahe_of_one_tile_without_limit_is_equalisation():
    x = np.clip(VALUES, 0, 1)
    np.testing.assert_allclose(
        equalise_locally(x, tiles=(1, 1), clip_limit=None, bins=50),
        equalise(x, bins=50),
        rtol=1e-12,
    )


def test_clahe_with_a_limit_of_one_keeps_the_values():
    """Every clipped bin has at most the mean count, so redistribution makes the histogram
    uniform."""
    even = np.tile(np.linspace(0.01, 0.99, 50), (50, 1))
    ours = equalise_locally(even, tiles=(1, 1), clip_limit=1.0, bins=50)
    np.testing.assert_allclose(ours, even, atol=0.02)


def test_matching_is_scikit_images():
    from skimage import exposure

    reference = COLOUR[::-1, :30] // 2 + 60
    theirs = exposure.match_histograms(COLOUR, reference, channel_axis=-1)
    assert levels_apart(match_histogram(COLOUR, reference), theirs) <= 1
    x, y = VALUES.round(2)[..., None], RNG.random((20, 30, 1)).round(2) ** 2
    theirs = exposure.match_histograms(x, y, channel_axis=-1)
    np.testing.assert_allclose(match_histogram(x, y), theirs, atol=1e-14)


def test_matching_with_oneself_changes_nothing():
    np.testing.assert_array_equal(match_histogram(CODES, CODES), CODES)
    np.testing.assert_allclose(match_histogram(VALUES, VALUES), VALUES, atol=1e-14)


# ------------------------------------------------ policy


def test_nan_stays_in_its_pixel():
    x = np.clip(VALUES, 0, 1)
    x[3, 4] = np.nan
    others = np.isfinite(x)
    for result in (equalise(x), equalise_locally(x), match_histogram(x, VALUES)):
        assert np.isnan(result[3, 4])
        assert np.isfinite(np.asarray(result)[others]).all()
    reference = np.stack([VALUES, VALUES], axis=-1)
    reference[0, 5, 1] = np.nan
    known = np.isfinite(match_histogram(reference[::-1], reference))
    assert known[..., 0].all()
    assert not known[..., 1].any()


@pytest.mark.parametrize("counts", [[0.0, 0.0, 0.0], [1.0, np.nan, 2.0], [np.nan, 1.0, 2.0]])
def test_empty_and_unknown_counts_have_no_quantile_and_no_threshold(counts):
    histogram = Histogram(jnp.asarray([counts, [1.0, 2.0, 1.0]]), jnp.arange(4.0))
    for found in (quantile(histogram, 0.5), otsu_threshold(histogram)):
        np.testing.assert_array_equal(np.isnan(found), [True, False])


@pytest.mark.sweep
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_dtype_and_shape_stay(dtype):
    image = COLOUR if dtype is np.uint8 else (COLOUR / 255).astype(dtype)
    for result in (equalise(image), equalise_locally(image), match_histogram(image, image)):
        assert (result.dtype, result.shape) == (dtype, image.shape)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: exact_histogram(CODES, bins=0), "at least 1, got 0"),
        (lambda: equalise_locally(CODES, tiles=(8,)), r"\(rows, columns\).*got \(8,\)"),
        (lambda: soft_histogram(VALUES, bins=-3), "at least 1, got -3"),
        (lambda: exact_histogram(VALUES, value_range=(1.0, 1.0)), "low < high"),
        (lambda: exact_histogram(VALUES, value_range=(0.0, np.inf)), "finite"),
        (lambda: soft_histogram(VALUES, kernel="box"), "linear"),
        (lambda: exact_histogram(np.zeros((0, 3))), r"at least one pixel, got \(0, 3\)"),
        (lambda: equalise(np.zeros(5)), r"got \(5,\)"),
        (lambda: equalise(CODES.astype(np.int32)), "int32"),
        (lambda: equalise(CODES, bins=10), "code by code"),
        (lambda: equalise_locally(CODES, tiles=(0, 3)), r"got \(0, 3\)"),
        (lambda: match_histogram(CODES, VALUES), "one dtype"),
        (lambda: match_histogram(COLOUR, CODES), "but for h and w"),
        (lambda: otsu_threshold(exact_histogram(CODES, bins=1)), "at least 2 bins"),
    ],
)
def test_bad_input_is_one_sentence(call, words):
    with pytest.raises(ValueError, match=words) as caught:
        call()
    assert "\n" not in str(caught.value)
