"""Histograms, equalisation, integral images and neighbourhood filters where naive formulas fail, in
both precisions: millions of equal values, values on edges, a single value, huge and tiny scales.

Values are compared with 50-digit results for the same floating-point inputs; gradients are
finite."""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from precisions import both_precisions, eps

from jaxvision.filters.bilateral import bilateral_filter
from jaxvision.filters.integral import integral_image
from jaxvision.filters.nonlocal_means import nonlocal_means_filter
from jaxvision.histogram import (
    cumulative_distribution,
    equalise,
    equalise_locally,
    exact_histogram,
    match_histogram,
    otsu_threshold,
    quantile,
    soft_histogram,
)

RNG = np.random.default_rng(13)
mp.mp.dps = 50


@both_precisions
def test_histogram_of_millions_of_equal_values(dtype):
    """A running float32 sum of equal weights stops growing at 2^24 and errs by 10^-2 well before. A
    weight 1 - f has the error of the position, bins eps."""
    value = jnp.asarray(0.337, dtype)
    image = jnp.broadcast_to(value, (2048, 2048))
    counts = np.asarray(soft_histogram(image, bins=10).counts, float)
    position = mp.mpf(float(value)) * 10 - mp.mpf(1) / 2
    upper = position - mp.floor(position)
    expected = np.zeros(10)
    expected[2:4] = float((1 - upper) * 2**22), float(upper * 2**22)
    # 2048 additions a row and 2048 rows, each rounding by at most eps / 2
    bound = 2**22 * (10 + 2048) * eps(dtype)
    np.testing.assert_allclose(counts, expected, atol=bound)
    np.testing.assert_array_equal(counts[expected == 0], 0)


@both_precisions
def test_values_on_edges_fall_into_the_bin_on_their_right(dtype):
    """With 97 bins only the two end edges are binary fractions."""
    edges = np.linspace(0, 1, 98).astype(dtype)
    counts = exact_histogram(jnp.asarray(edges)[None], bins=97).counts
    np.testing.assert_array_equal(counts, [1] * 96 + [2])
    just_below = np.nextafter(edges[1:], dtype(0))
    np.testing.assert_array_equal(exact_histogram(just_below[None], bins=97).counts, [1] * 97)


@both_precisions
def test_cumulative_distribution_against_exact_sums(dtype):
    counts = RNG.integers(0, 1000, size=300)
    image = jnp.asarray(np.repeat((np.arange(300) + 0.5) / 300, counts), dtype)[None]
    ours = cumulative_distribution(exact_histogram(image, bins=300))
    below = np.concatenate([[0], np.cumsum(counts)])
    exact = np.array([float(mp.mpf(int(n)) / int(below[-1])) for n in below])
    assert np.max(np.abs(np.asarray(ours, float) - exact)) <= eps(dtype)


@pytest.mark.slow
@both_precisions
@pytest.mark.parametrize("value", [0.0, 0.25, -5.0, 1e-30, jnp.inf])
def test_histograms_of_pictures_of_one_value(value, dtype):
    image = jnp.full((8, 9), value, dtype)
    for operator in (equalise, equalise_locally):
        result, slope = jax.jit(
            jax.value_and_grad(lambda x, f=operator: f(x, bins=4).sum() / x.size)
        )(image)
        assert 0 <= float(result) <= 1 + eps(dtype)
        assert jnp.isfinite(slope).all()
    if np.isfinite(value):
        matched = jax.jit(match_histogram)(image, jnp.full((3, 3), 0.5, dtype))
        np.testing.assert_array_equal(matched, 0.5)
    histogram = exact_histogram(image, bins=4)
    for q in (0.0, 0.5, 1.0):
        assert 0 <= float(quantile(histogram, jnp.asarray(q, dtype))) <= 1
    assert 0 < float(otsu_threshold(histogram)) < 1


@both_precisions
def test_gradients_of_the_soft_histogram_at_edges_and_centres(dtype):
    image = jnp.asarray([[0.0, 0.125, 0.25, 0.5, 1.0, 1.5, -1.0, jnp.nan, jnp.inf, 1e-40]], dtype)
    for kernel in ("linear", "cubic"):
        of = jax.jit(jax.jacobian(lambda x, k=kernel: soft_histogram(x, bins=4, kernel=k).counts))
        assert jnp.isfinite(of(image)).all()


@pytest.mark.slow
@both_precisions
def test_integral_image_keeps_all_digits_of_its_pair(dtype):
    """high + low agrees with exact sums to 2^-46 (2^-104 in float64) after some thousand
    additions."""
    image = jnp.asarray(10.0 ** RNG.uniform(-6, 6, size=(60, 70)), dtype)
    ours = integral_image(image)
    exact = mp.matrix(61, 71)
    for i, j in np.ndindex(60, 70):
        pixel = mp.mpf(float(image[i, j]))
        exact[i + 1, j + 1] = pixel + exact[i, j + 1] + exact[i + 1, j] - exact[i, j]
    high, low = np.asarray(ours.high, float), np.asarray(ours.low, float)
    for i, j in RNG.integers(1, 61, size=(50, 2)):
        error = mp.mpf(high[i, j]) + mp.mpf(low[i, j]) - exact[int(i), int(j)]
        assert abs(error) <= exact[int(i), int(j)] * mp.mpf(2) ** (
            -46 if dtype == jnp.float32 else -104
        )


@pytest.mark.slow
@both_precisions
@pytest.mark.parametrize("scale", [1e-12, 1e12])
def test_neighbourhood_filters_do_not_depend_on_the_unit(scale, dtype):
    """If image, sigma and strength are given in another unit, the result is in that unit."""
    image = jnp.asarray(RNG.random((6, 7)), dtype)
    sigma = jnp.asarray(0.2, dtype)
    factor = jnp.asarray(scale, dtype)
    for filtered in (
        lambda x, s: bilateral_filter(x, 1.0, s, radius=1),
        lambda x, s: nonlocal_means_filter(x, s, patch=3, radius=1),
    ):
        once = jax.jit(filtered)
        expected = once(image, sigma)
        # a relative error eps of the exponent, at most about 25 here, gives the error of the weight
        np.testing.assert_allclose(
            once(image * factor, sigma * factor) / factor, expected, rtol=100 * eps(dtype)
        )
        slope = jax.jit(jax.grad(lambda x, s, f=filtered: f(x, s).sum(), argnums=(0, 1)))
        assert all(jnp.isfinite(g).all() for g in slope(image * factor, sigma * factor))
