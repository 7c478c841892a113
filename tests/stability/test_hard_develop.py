"""Development of dark, saturated, flat, steep or out-of-domain input, in both precisions: values
are compared with exact arithmetic or a limit, and gradients are finite.
"""

from fractions import Fraction
from functools import partial
from itertools import pairwise

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from oracles import exact
from precisions import both_precisions, eps

from jaxvision import scene as s
from jaxvision.development import (
    demosaic,
    demosaic_malvar,
    develop,
    fit_colour_matrix,
    grey_world_gains,
    jpeg,
    neutral_gains,
    tone_curve,
    white_balance,
)
from jaxvision.sensor.colour_filters import bayer

RNG = np.random.default_rng(23)


def finite_gradients(f, *cases):
    """Check that the gradients of the sum of f by each argument are finite, and yield them; compile
    once."""
    compiled = jax.jit(jax.grad(lambda arguments: f(*arguments).sum()))
    for case in cases:
        gradients = compiled(case)
        assert all(jnp.isfinite(g).all() for g in jax.tree.leaves(gradients))
        yield gradients


# The filters of Malvar et al. (2004), figure 2, row by row in sixteenths.
MALVAR = {
    "green": "0 0 -2 0 0  0 0 4 0 0  -2 4 8 4 -2  0 0 4 0 0  0 0 -2 0 0",
    "along": "0 0 1 0 0  0 -2 0 -2 0  -2 8 10 8 -2  0 -2 0 -2 0  0 0 1 0 0",
    "opposite": "0 0 -3 0 0  0 4 0 4 0  -3 0 12 0 -3  0 4 0 4 0  0 0 -3 0 0",
}


@both_precisions
@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
def test_malvar_demosaicing_against_exact_fractions(dtype, scale):
    """The result agrees with exact fractions within a few roundings of the largest term, in any
    unit."""
    raw = jnp.asarray(scale * RNG.uniform(0.5, 1.5, size=(6, 6)), dtype)
    picture = np.asarray(demosaic_malvar(raw, bayer("RGGB")))
    numbers = np.vectorize(Fraction)(np.asarray(raw, np.float64))
    kernel = {k: np.array(v.split(), int).reshape(5, 5) for k, v in MALVAR.items()}
    cases = [
        ((2, 2, 1), kernel["green"]),  # green at a red pixel
        ((2, 2, 2), kernel["opposite"]),  # blue at a red pixel
        ((2, 3, 0), kernel["along"]),  # red at a green pixel of a red row
        ((2, 3, 2), kernel["along"].T),  # blue there
    ]
    for (y, x, band), weights in cases:
        window = numbers[y - 2 : y + 3, x - 2 : x + 3]
        truth = sum(
            (int(k) * v for k, v in zip(weights.flat, window.flat, strict=True)), Fraction()
        )
        error = abs(Fraction(float(picture[y, x, band])) - truth / 16)
        assert error <= 8 * Fraction(eps(dtype)) * Fraction(1.5 * scale)


@pytest.mark.sweep
@both_precisions
@pytest.mark.parametrize("method", ["malvar", "menon", "normalised"])
def test_flat_mosaics_stay_flat_with_finite_gradients(dtype, method):
    """In a flat mosaic Menon's decision is a tie at every pixel, and every |difference| is at its
    kink."""
    method = partial(demosaic, pattern=bayer("GBRG"), method=method)
    f = jax.jit(method)
    mosaics = [jnp.full((4, 4), level, dtype) for level in (0.0, 1e-30, 1.0, 1e30)]
    for raw in mosaics:
        picture = f(raw)
        assert picture.dtype == dtype
        np.testing.assert_allclose(picture, raw[0, 0], rtol=8 * eps(dtype))
    for (gradient,) in finite_gradients(method, *((raw,) for raw in mosaics)):
        # each band of a flat picture is the level, so all weights together are 3 a pixel
        np.testing.assert_allclose(gradient.sum(), 48, rtol=100 * eps(dtype))


def hermite(x, inputs, outputs):
    """Return the monotone curve in 50 digits, with the slopes of Fritsch and Butland, for inner
    points only."""
    h = [b - a for a, b in pairwise(inputs)]
    d = [(b - a) / w for (a, b), w in zip(pairwise(outputs), h, strict=True)]

    def slope(k):
        if d[k - 1] * d[k] <= 0:
            return mp.mpf(0)
        before, behind = 2 * h[k] + h[k - 1], h[k] + 2 * h[k - 1]
        return (before + behind) / (before / d[k - 1] + behind / d[k])

    k = max(i for i in range(len(inputs)) if inputs[i] <= x)
    t = (x - inputs[k]) / h[k]
    return (
        outputs[k] * (1 + 2 * t) * (1 - t) ** 2
        + outputs[k + 1] * (3 - 2 * t) * t**2
        + h[k] * t * (1 - t) * (slope(k) * (1 - t) - slope(k + 1) * t)
    )


@both_precisions
def test_tone_curves_with_steep_and_flat_pieces(dtype):
    inputs = jnp.asarray([0, 1e-6, 0.3, 0.3001, 0.9, 1], dtype)
    outputs = jnp.asarray([0, 1e-3, 0.2, 0.8, 0.8, 1], dtype)
    x = jnp.asarray([1e-6, 1e-3, 0.29, 0.30004, 0.5, 0.899], dtype)  # between the inner points
    points = [[exact.number(v) for v in np.asarray(p)] for p in (inputs, outputs)]
    ours = jax.jit(tone_curve)(x, inputs, outputs)
    # x - inputs is exact up to a rounding of x, multiplied by the slope of the curve
    slope = jax.jit(jax.vmap(jax.grad(lambda v: tone_curve(v, inputs, outputs))))(x)
    for got, at, steepness in zip(np.asarray(ours), np.asarray(x), np.asarray(slope), strict=True):
        error = abs(exact.number(got) - hermite(exact.number(at), *points))
        assert error <= 8 * eps(dtype) * (1 + abs(float(steepness)) * float(at))
    everywhere = jnp.asarray([-1e30, -1.0, 0.0, 1e-6, 0.3, 0.9, 1.0, 1e30], dtype)
    flat = jnp.full_like(outputs, 0.5)
    cases = [(everywhere, inputs, outputs), (everywhere, inputs, flat)]
    assert len(list(finite_gradients(tone_curve, *cases))) == 2


@pytest.mark.slow
@both_precisions
def test_gains_of_black_saturated_and_single_channel_pictures(dtype):
    black, burnt = jnp.zeros((4, 4, 3), dtype), jnp.ones((4, 4, 3), dtype)
    red = black.at[..., 0].set(0.5)
    pictures = [(black,), (burnt,), (red,), (-burnt,)]
    shades = partial(grey_world_gains, norm=6.0, saturation=0.9)
    for gains in (neutral_gains, grey_world_gains, shades):
        for (picture,) in pictures:
            np.testing.assert_array_equal(gains(picture), 1)
        assert len(list(finite_gradients(gains, *pictures))) == 4


@both_precisions
@pytest.mark.parametrize("level", [1e-35, 1e-10, 1e10, 1e35])
def test_gains_by_high_norms_neither_overflow_nor_underflow(dtype, level):
    """x^200 would overflow or underflow; the gains do not depend on the unit."""
    shape = np.array([1.0, 0.5, 0.25])
    image = jnp.asarray(level * shape * np.ones((3, 3, 1)), dtype)
    worlds = jax.jit(lambda image: (grey_world_gains(image, norm=200.0), neutral_gains(image)))
    for gains in worlds(image):
        np.testing.assert_allclose(gains, 1 / shape, rtol=8 * eps(dtype))


@both_precisions
def test_highlights_at_the_clipping_level(dtype):
    image = jnp.asarray([[[0.0, 1.0, 1.0], [np.inf, 1.0, np.nan], [0.2, 0.5, 3.0]]], dtype)
    balanced = white_balance(image, jnp.asarray([2.0, 1.0, 1.5], dtype), saturation=1.0)
    np.testing.assert_array_equal(
        balanced, jnp.asarray([[[0.0, 1, 1], [1, 1, np.nan], [0.4, 0.5, 1]]], dtype)
    )
    known = jnp.where(jnp.isfinite(image), image, 1.0)
    cut = partial(white_balance, saturation=1.0)
    assert list(finite_gradients(cut, (known, jnp.ones(3, dtype))))


@pytest.mark.slow
@both_precisions
@pytest.mark.parametrize("spread", [1.0, 1e-1, 1e-2])
def test_colour_matrices_of_nearly_grey_patches(dtype, spread):
    """A least-squares fit by QR loses the digits of the condition number once, the normal equations
    would lose them twice."""
    true = np.array([[1.6, -0.4, -0.2], [-0.3, 1.5, -0.2], [0.1, -0.6, 1.5]])
    camera = 0.5 + spread * RNG.uniform(-0.4, 0.4, size=(24, 3))
    camera = np.asarray(jnp.asarray(camera, dtype), np.float64)
    condition = np.linalg.cond(camera)
    wanted = jnp.asarray(camera @ true.T, dtype)
    ours = fit_colour_matrix(jnp.asarray(camera, dtype), wanted)
    assert np.abs(np.asarray(ours) - true).max() <= 10 * condition * eps(dtype)
    kept = fit_colour_matrix(
        jnp.asarray(camera, dtype),
        wanted,
        white=(jnp.ones(3, dtype), jnp.asarray(true.sum(1), dtype)),
    )
    assert np.abs(np.asarray(kept) - true).max() <= 10 * condition * eps(dtype)
    assert list(finite_gradients(fit_colour_matrix, (jnp.asarray(camera, dtype), wanted)))


@pytest.mark.slow
@both_precisions
@pytest.mark.parametrize("rounding", ["straight_through", "cubic"])
def test_jpeg_at_the_ends_of_the_quality_scale(dtype, rounding):
    picture = jnp.asarray(RNG.uniform(-0.5, 1.5, size=(8, 8, 3)), dtype)
    codec = partial(jpeg, rounding=rounding)
    f = jax.jit(codec)
    cases = [(picture, jnp.asarray(q, dtype)) for q in (-5.0, 1.0, 50.0, 100.0, 1e9)]
    for x, quality in cases:
        compressed = f(x, quality)
        assert compressed.dtype == dtype
        assert ((compressed >= 0) & (compressed <= 1)).all()
        np.testing.assert_array_equal(compressed, f(x, jnp.clip(quality, 1, 100)))
    assert len(list(finite_gradients(codec, *cases))) == 5


@pytest.mark.slow
@both_precisions
def test_development_of_black_and_overexposed_pictures(dtype):
    development = s.Development(
        black_level=64.0,
        white_level=1064.0,
        demosaicing=s.Demosaicing(bayer("RGGB")),
        white_balance=s.GreyWorld(6.0),
        saturation=1.0,
        colour_matrix=np.eye(3),
        tone_map=s.Filmic(),
        tone=s.SRGB(),
        compression=s.JPEG(90.0),
    )
    development = jax.tree.map(lambda leaf: leaf.astype(dtype), development)
    f = jax.jit(develop)
    for level in (0.0, 64.0, 65.0, 1064.0, 1e6):
        picture = f(jnp.full((16, 16), level, dtype), development)
        assert picture.dtype == dtype
        assert ((picture >= 0) & (picture <= 1)).all()
        np.testing.assert_allclose(picture, picture[0, 0, 0])
    cases = [(jnp.full((16, 16), level, dtype), development) for level in (0.0, 64.0, 1064.0)]
    assert len(list(finite_gradients(develop, *cases))) == 3
