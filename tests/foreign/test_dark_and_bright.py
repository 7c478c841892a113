"""Tests pictures with values over eight decades, with dead pixels, and in any unit of light: star
fields, a lamp at night, mattes of a dim scene."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view

import jaxvision as jv
from jaxvision import filters

Y, X = np.mgrid[-10:11, -10:11]
STAR = (abs(X * Y) < 20) / (1.0 + X**2 + Y**2)
STAR = (STAR / STAR.sum()).astype(np.float32)


def night(lamp: float) -> np.ndarray:
    picture = np.random.default_rng(0).uniform(0.01, 0.02, (120, 110)).astype(np.float32)
    picture[50, 60] = lamp
    return picture


def stars(background: float) -> np.ndarray:
    picture = np.full((120, 110), background, np.float32)
    rng = np.random.default_rng(1)
    picture.ravel()[rng.choice(picture.size, 60, replace=False)] = 10 ** rng.uniform(0, 8, 60)
    return picture


def by_windows(picture: np.ndarray, kernel: np.ndarray, mode: str = "symmetric") -> np.ndarray:
    """Return the correlation by sums over windows, in float64."""
    kh, kw = kernel.shape
    reach = [(kh // 2, kh - 1 - kh // 2), (kw // 2, kw - 1 - kw // 2)]
    wide = np.pad(picture.astype(float), reach, mode=mode)
    return np.einsum("yxij,ij->yx", sliding_window_view(wide, (kh, kw)), kernel.astype(float))


@pytest.mark.parametrize("method", ["auto", "fft"])
@pytest.mark.parametrize("picture", [night(1e4), night(1e8), night(1e30), stars(0), stars(0.01)])
def test_every_pixel_of_eight_decades_is_right(picture, method):
    truth = by_windows(picture, STAR)
    got = np.asarray(filters.correlate(picture, STAR, method=method))
    np.testing.assert_allclose(got, truth, rtol=1e-4)  # where the true value is 0, so is the sum
    assert (got >= 0).all()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_dead_pixel_spoils_its_window_only(value):
    picture = night(value)
    fft, direct = (filters.correlate(picture, STAR, method=m) for m in ("fft", "direct"))
    np.testing.assert_allclose(fft, direct, rtol=1e-5)


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("method", ["auto", "fft"])
def test_a_kernel_that_is_not_finite_makes_all_pixels_nan(method, value):
    """The windows of all pixels, continued beyond the border, contain all taps."""
    kernel = STAR.copy()
    kernel[3, 3] = value
    assert np.isnan(filters.correlate(night(1e7), kernel, method=method)).all()


@pytest.mark.slow
def test_gradients_by_fft_equal_those_of_the_sum():
    picture, kernel = jnp.asarray(stars(0.01)), jnp.asarray(STAR)

    def loss(f, k, method):
        return jnp.log(filters.correlate(f, k, method=method)).sum()

    fft, direct = (jax.grad(loss, (0, 1))(picture, kernel, m) for m in ("fft", "direct"))
    for one, other in zip(fft, direct, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-6 * np.abs(other).max())
    forward = partial(filters.correlate, method="fft")
    _, slope = jax.jvp(lambda f: forward(f, kernel), (picture,), (jnp.ones_like(picture),))
    np.testing.assert_allclose(slope, forward(jnp.ones_like(picture), kernel), rtol=1e-5)
    twice = jax.hessian(lambda t: jnp.sum(forward(t * picture[:30, :30], t * kernel) ** 2))(1.0)
    once = float(jnp.sum(filters.correlate(picture[:30, :30], kernel, method="direct") ** 2))
    np.testing.assert_allclose(twice, 12 * once, rtol=1e-4)


@pytest.mark.slow
def test_diffraction_of_a_lamp_at_night():
    lens = jv.ThinLens(
        [0, 0, 0], np.eye(3), 0.05, 4e-6, resolution=(120, 110), f_number=16.0, focus_distance=1e9
    )
    effect = jv.Diffraction([550e-9], size=33)
    picture = night(1e8)
    got = jv.optics.diffracted(lens, effect, jnp.asarray(picture)[..., None])[..., 0]
    working = 16.0 / (1 - 0.05 / 1e9)
    kernel = jv.optics.airy_kernel(550e-9, working, 4e-6, size=33)
    np.testing.assert_allclose(got, by_windows(picture, np.asarray(kernel), "edge"), rtol=1e-4)


@pytest.mark.parametrize("method", ["auto", "separable", "direct", "conv"])
def test_a_lamp_does_not_change_pixels_beyond_the_reach_of_a_disc(method):
    """A disc has rank 4 or more, and the separable passes cancel in its corners."""
    disc = (np.hypot(*np.mgrid[-6:7, -6:7]) <= 6.2).astype(np.float32)
    disc /= disc.sum()
    for picture in (night(1e8), stars(0)):
        got = filters.correlate(picture, disc, method=method)
        np.testing.assert_allclose(got, by_windows(picture, disc), rtol=1e-4)


@pytest.mark.sweep
@pytest.mark.parametrize("unit", [1e-30, 1e-12, 1e-4, 1e12, 1e30])
def test_mattes_do_not_depend_on_the_unit_of_light(unit):
    rng, unit = np.random.default_rng(4), np.float32(unit)
    alpha = rng.uniform(0.05, 0.95, (5, 6, 1)).astype(np.float32)
    behind, beside, front = rng.random((3, 5, 6, 3)).astype(np.float32) * unit
    seen = [alpha * front + (1 - alpha) * light for light in (behind, beside)]
    matting = jv.matting
    layer = matting.triangulation_matte(seen[0], behind, seen[1], beside)
    np.testing.assert_allclose(layer[..., 3:], alpha, atol=1e-5)
    np.testing.assert_allclose(matting.projected_matte(seen[0], front, behind), alpha, atol=1e-5)
    grey, screen = unit * np.full(3, 0.4, np.float32), unit * np.array([0, 0.1, 0.8], np.float32)
    keyed = matting.blue_screen_matte(alpha * grey + (1 - alpha) * screen, screen)
    np.testing.assert_allclose(keyed, alpha, atol=1e-5)
    apart = np.linalg.norm((behind / unit).astype(float) - beside / unit, axis=-1, keepdims=True)
    differs = matting.difference_matte(behind, beside, 0.1 * unit, 0.9 * unit)
    np.testing.assert_allclose(differs, np.clip((apart - 0.1) / 0.8, 0, 1), atol=1e-5)
    same = np.stack([behind] * 3)  # the mean is rounded
    assert (matting.least_squares_matte(same, same)[..., 3] == 1).all()


@pytest.mark.sweep
@pytest.mark.parametrize("unit", [1e-15, 1e-10, 1e18])
def test_body_colours_and_gains_do_not_depend_on_the_unit_of_light(unit):
    rng, body = np.random.default_rng(2), np.array([0.8, 0.3, 0.1])
    matt, gloss = rng.random((2, 20, 20, 1))
    light = (matt * body + 0.3 * gloss * (gloss > 0.7)).astype(np.float32) * np.float32(unit)
    found = jv.separate(light, np.float32(unit) * np.ones(3, np.float32))
    np.testing.assert_allclose(found.body_colour, body / np.linalg.norm(body), atol=0.005)
    halved = jv.point_ops.set_luminance(light, light[..., 0], light[..., 0] / 2)
    np.testing.assert_allclose(halved, light / 2, rtol=1e-6)


@pytest.mark.sweep
@pytest.mark.parametrize("exponent", [-80, -50, 60])
def test_neighbours_and_keys_do_not_depend_on_the_unit_of_light(exponent):
    """Powers of two scale without rounding, so only the unit differs."""
    picture = np.random.default_rng(3).uniform(0.1, 0.9, (9, 8, 3)).astype(np.float32)
    picture[2, 3] = np.inf  # does not affect the unit
    unit = np.float32(2.0**exponent)

    def bilateral(x, unit):
        return filters.bilateral_filter(x, 1.5, 0.2 * unit, radius=2) / unit

    def nonlocal_means(x, unit):
        return (
            filters.nonlocal_means_filter(x, 0.2 * unit, noise=0.02 * unit, patch=3, radius=2)
            / unit
        )

    def key(x, unit):
        del unit
        return jv.point_ops.scaled_to_key(x[..., 0])

    for function in (bilateral, nonlocal_means, key):
        np.testing.assert_allclose(
            function(picture * unit, unit), function(picture, np.float32(1)), rtol=1e-5
        )
    black = jax.grad(lambda x: jv.point_ops.scaled_to_key(x).sum())(jnp.zeros((2, 2)))
    assert np.isfinite(black).all()


@pytest.mark.sweep
@pytest.mark.parametrize("exponent", [-60, 60])
def test_weights_and_curves_do_not_depend_on_their_unit(exponent):
    """A normalised kernel may have any sum, and a curve any unit on both axes."""
    picture = np.random.default_rng(4).uniform(0.1, 0.9, (9, 8)).astype(np.float32)
    kernel = np.outer([1, 2, 1], [1, 3, 2]).astype(np.float32)
    unit, border = np.float32(2.0**exponent), "normalised_zero"
    np.testing.assert_array_equal(
        filters.correlate(picture, unit * kernel, border=border),
        filters.correlate(picture, kernel, border=border),
    )
    by_matrix, plain = (
        filters.filter_matrix(k, shape=(9, 8), border=border).matrix.todense()
        for k in (jnp.asarray(unit * kernel), jnp.asarray(kernel))
    )
    np.testing.assert_array_equal(by_matrix, plain)
    inputs = np.array([0, 0.2, 0.5, 1], np.float32)
    outputs = np.array([0, 0.1, 0.7, 1], np.float32)
    curve = jv.tone_curve(picture, inputs, outputs)
    np.testing.assert_array_equal(jv.tone_curve(picture, inputs, unit * outputs), unit * curve)
    np.testing.assert_array_equal(jv.tone_curve(unit * picture, unit * inputs, outputs), curve)


def bilateral_by_definition(picture, sigma_space, sigma_range, radius):
    """Return each window's mean, in float64, where pixels of infinite difference have no weight."""
    rows, columns = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    space = np.exp(-(rows**2 + columns**2) / (2 * sigma_space**2))
    around = sliding_window_view(
        np.pad(picture.astype(float), radius, mode="symmetric"), space.shape
    )
    means = np.empty(picture.shape)
    for place in np.ndindex(picture.shape):
        value, here = around[place], float(picture[place])
        alike = value == here
        change = np.where(alike, 0, value - np.where(alike, 0, here))
        weight = space * np.exp(-(change**2) / (2 * sigma_range**2))
        means[place] = (weight * np.where(weight > 0, value, 0)).sum() / weight.sum()
    return means


@pytest.mark.slow
@pytest.mark.parametrize("bands", [0, 2])
def test_infinite_pixels_do_not_enter_the_means_of_others(bands):
    """A saturated or broken pixel of an EXR stays, and the others equal the definition."""
    picture = np.random.default_rng(0).random((9, 11)).astype(np.float32)
    picture[4, 5], picture[4, 6], picture[2, 2] = np.inf, -np.inf, np.inf
    true = bilateral_by_definition(picture, 1.5, 0.2, 2)
    assert np.isfinite(true).sum() == picture.size - 3
    given = np.repeat(picture[..., None], bands, -1) if bands else picture
    sigma = 0.2 * max(bands, 1) ** 0.5  # squares of equal bands add up

    def smooth(given):
        return filters.bilateral_filter(given, 1.5, sigma, radius=2)

    got = np.asarray(smooth(given))
    np.testing.assert_allclose(got[..., -1] if bands else got, true, rtol=2e-5)
    slopes = jax.grad(lambda x: jnp.where(jnp.isfinite(given), smooth(x), 0).sum())(given)
    assert np.isfinite(slopes).all()
    patches = np.asarray(filters.nonlocal_means_filter(given, 0.2, radius=2, patch=3))
    assert np.isfinite(patches).sum() == given.size - 3 * max(bands, 1)
    usual = patches[np.isfinite(patches)]
    assert given[np.isfinite(given)].min() <= usual.min()
    assert usual.max() <= 1
