"""Filters where a naive formula fails, in both precisions: vanishing and huge widths, kernels of
sum 0, one pixel, no coverage. Values are compared with 50-digit results; gradients are finite.
"""

from functools import partial

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from oracles import exact
from precisions import assert_finite, both_precisions

from jaxvision import filters
from jaxvision.filters.padding import BORDERS, pad

RNG = np.random.default_rng(5)


@pytest.mark.sweep
@both_precisions
@pytest.mark.parametrize("sigma", [1e-3, 0.05, 0.3, 1.0, 1.5, 7.0, 300.0])
@pytest.mark.parametrize("sampling", ["sampled", "integrated"])
def test_gaussian_weights_against_fifty_digits(dtype, sigma, sampling):
    """For the stored sigma, e^-t has an error of t ulps by its argument, and a tail loses no more
    than that."""
    size = 9
    s = jnp.asarray(sigma, dtype)
    got = filters.gaussian_kernel(s, size=size, sampling=sampling)
    assert got.dtype == dtype
    with mp.workdps(50):
        width = mp.mpf(max(float(s), 0.01))
        if sampling == "sampled":
            weights = [mp.exp(-((i / width) ** 2) / 2) for i in range(-4, 5)]
        else:
            root = width * mp.sqrt(2)
            half = mp.mpf("0.5")
            weights = [
                mp.erfc((abs(i) - half) / root) - mp.erfc((abs(i) + half) / root)
                for i in range(-4, 5)
            ]
        truth = [w / mp.fsum(weights) for w in weights]
        for i, (value, true) in enumerate(zip(got, truth, strict=True)):
            if true < float(jnp.finfo(dtype).tiny):
                assert value <= jnp.finfo(dtype).tiny
                continue
            exponent = float((max(abs(i - 4) - 0.5, 0) / width) ** 2) / 2
            assert exact.ulps(value, true) <= 16 + 4 * exponent


@pytest.mark.slow
@both_precisions
@pytest.mark.parametrize("sigma", [0.0, 1e6])
def test_gaussian_filter_of_vanishing_to_huge_width(dtype, sigma):
    """Value and gradient are finite for every order and sampling; a vanishing width changes
    nothing."""
    f = jnp.asarray(RNG.uniform(size=(6, 5)), dtype)
    s = jnp.asarray(sigma, dtype)
    for order, sampling in (((2, 1), "sampled"), ((0, 1), "integrated")):
        blur = partial(filters.gaussian, size=5, order=order, sampling=sampling)
        g, gradient = blur(f, s), jax.grad(lambda f, s, b=blur: b(f, s).sum(), (0, 1))(f, s)
        assert g.dtype == dtype
        assert_finite((g, gradient))
    if sigma < 1:
        np.testing.assert_array_equal(filters.gaussian(f, s, size=5), f)


@both_precisions
def test_normalising_a_kernel_of_sum_zero(dtype):
    """Where filter(1) is 0, the result and its gradient are 0."""
    f = jnp.asarray(RNG.uniform(size=(6, 5)), dtype)
    slope = jnp.asarray([[-1.0, 0.0, 1.0]], dtype)

    def g(f):
        return filters.correlate(f, slope, border="normalised_zero")

    assert (g(f)[:, 1:-1] == 0).all()
    assert_finite((g(f), jax.grad(lambda f: g(f).sum())(f)))


@pytest.mark.slow
@both_precisions
@pytest.mark.parametrize("border", BORDERS)
def test_one_pixel_under_a_large_kernel(dtype, border):
    f, kernel = jnp.ones((1, 1), dtype), jnp.full((17, 18), 1 / 306, dtype)
    fill = 1.0 if border == "constant" else 0.0
    for method in ("direct", "fft"):
        got = filters.correlate(f, kernel, border=border, fill=fill, method=method)
        expected = 1 / 306 if border == "zero" else 1.0
        np.testing.assert_allclose(got, expected, rtol=100 * jnp.finfo(dtype).eps)


@both_precisions
def test_constant_border_with_a_huge_fill_keeps_a_flat_picture(dtype):
    """The fill value is added separately: inside the picture, 1e6 is never added and subtracted."""
    f = jnp.full((12, 12), 0.1, dtype)
    kernel = jnp.full((3, 3), 1 / 9, dtype)
    got = filters.correlate(f, kernel, border="constant", fill=1e6)
    np.testing.assert_allclose(got[1:-1, 1:-1], 0.1, rtol=4 * jnp.finfo(dtype).eps)


@both_precisions
def test_extend_border_of_a_ramp_far_outside(dtype):
    ramp = jnp.arange(3, dtype=dtype)[None]
    got = pad(ramp, ((0, 0), (100, 100)), border="extend")
    np.testing.assert_array_equal(got[0], np.arange(-100, 103))


@pytest.mark.slow
@both_precisions
def test_filters_without_coverage_or_weight(dtype):
    layer = jnp.zeros((5, 5, 2), dtype).at[..., 0].set(1)

    def straight(layer):
        return filters.blur_straight(layer, blur=lambda f: filters.box(f, size=3))

    assert (straight(layer) == 0).all()
    f, width = jnp.asarray(RNG.uniform(size=(5, 5)), dtype), jnp.zeros((5, 5), dtype)

    def disk(f, width):
        return filters.radial_blur(f, width - 1, profile=filters.disk_profile, radius=2)

    np.testing.assert_array_equal(disk(f, width), f)
    assert_finite(jax.grad(lambda x: straight(x).sum())(layer))
    assert_finite(jax.grad(lambda *x: disk(*x).sum(), (0, 1))(f, width))


def test_fft_filter_of_half_precision():
    """A filter of bfloat16 by FFT passes through float32 and returns bfloat16."""
    f = jnp.ones((8, 8), jnp.bfloat16)
    got = filters.correlate(f, np.full((5, 5), 0.04), method="fft")
    assert got.dtype == jnp.bfloat16
    np.testing.assert_allclose(got.astype(jnp.float32), 1, rtol=0.01)
