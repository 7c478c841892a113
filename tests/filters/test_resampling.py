"""Tests resizing against Pillow, and warping against SciPy and block means."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from jaxvision.filters import resize, warp

PICTURE = np.random.default_rng(0).uniform(size=(23, 31)).astype(np.float32)
OF_PILLOW = {
    "linear": Image.Resampling.BILINEAR,
    "cubic": Image.Resampling.BICUBIC,
    "lanczos3": Image.Resampling.LANCZOS,
}


@pytest.mark.sweep("size2", "size0-lanczos3")
@pytest.mark.parametrize("method", OF_PILLOW)
@pytest.mark.parametrize("size", [(7, 9), (50, 64), (11, 40)])
def test_resized_as_pillow_does(method, size):
    theirs = np.asarray(Image.fromarray(PICTURE).resize(size[::-1], OF_PILLOW[method]))
    np.testing.assert_allclose(resize(PICTURE, size, method=method), theirs, atol=2e-6)


def test_batches_bands_and_constants():
    stack = np.stack([PICTURE, 2 * PICTURE], axis=-1)[None]
    both = resize(stack, (5, 6))
    assert both.shape == (1, 5, 6, 2)
    np.testing.assert_allclose(both[0, ..., 1], 2 * resize(PICTURE, (5, 6)), rtol=1e-5)
    np.testing.assert_allclose(resize(np.full((9, 9), 3.0), (4, 13)), 3.0, rtol=1e-6)


@pytest.mark.sweep("nan", "size2-linear")
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("method", ["nearest", "linear", "cubic", "lanczos3", "lanczos5"])
@pytest.mark.parametrize("size", [(7, 9), (50, 64), (23, 40)])
def test_a_dead_pixel_affects_only_the_reach_of_the_kernel(value, method, size):
    """The weights are found from a picture with one row and one with one column. A NaN or infinity
    affects only pixels with a weight."""
    place = (11, 17)
    row, column = np.zeros((2, *PICTURE.shape), np.float32)
    row[place[0]], column[:, place[1]] = 1, 1
    of_row = np.asarray(resize(row, size, method=method))[:, 0]
    of_column = np.asarray(resize(column, size, method=method))[0]
    weight = np.outer(*(np.where(np.abs(own) > 1e-6, own, 0) for own in (of_row, of_column)))
    dead = PICTURE.copy()
    dead[place] = 0
    truth = np.asarray(resize(dead, size, method=method))
    with np.errstate(invalid="ignore"):
        truth = np.where(weight != 0, weight * np.float32(value), truth)
    dead[place] = value
    np.testing.assert_allclose(resize(dead, size, method=method), truth, rtol=1e-5, atol=1e-6)
    assert (weight == 0).mean() > 0.2


def test_slopes_beside_a_dead_pixel():
    dead = PICTURE.copy()
    dead[11, 17] = np.nan
    slopes = [jax.grad(lambda f: jnp.nansum(resize(f, (7, 9))))(f) for f in (dead, PICTURE)]
    assert np.isfinite(slopes[0]).all()
    np.testing.assert_allclose(slopes[0][:3], slopes[1][:3], rtol=1e-5)
    assert slopes[0][11, 17] == 0


@pytest.mark.parametrize(
    ("border", "theirs"),
    [
        ("clamp", "nearest"),
        ("constant", "grid-constant"),
        ("mirror", "reflect"),
        ("reflect_101", "mirror"),
    ],
)
def test_warped_as_scipy_does(border, theirs):
    rng = np.random.default_rng(1)
    rows, columns = rng.uniform(-4, 27, (6, 8)), rng.uniform(-4, 35, (6, 8))
    picture = PICTURE.astype(np.float64)
    expected = ndimage.map_coordinates(picture, [rows, columns], order=1, mode=theirs, cval=0.3)
    found = warp(picture, rows, columns, border=border, fill=0.3 * (border == "constant"))
    np.testing.assert_allclose(found, expected, rtol=1e-9)


@pytest.mark.parametrize("factor", [2, 3])
def test_a_shrunk_picture_is_the_mean_of_its_blocks(factor):
    picture = PICTURE[:18, :30].astype(np.float64)
    rows, columns = (factor * (np.arange(side // factor) + 0.5) - 0.5 for side in picture.shape)
    rows, columns = np.meshgrid(rows, columns, indexing="ij")
    blocks = picture.reshape(18 // factor, factor, 30 // factor, factor).mean(axis=(1, 3))
    np.testing.assert_allclose(warp(picture, rows, columns, samples=factor), blocks, rtol=1e-12)
    checks = np.indices((12, 12)).sum(axis=0) % 2.0  # the finest pattern, whose mean is grey
    rows, columns = np.meshgrid(np.arange(1, 12, 2) - 0.5, np.arange(1, 12, 2) - 0.5)
    np.testing.assert_allclose(warp(checks, rows.T, columns.T, samples=2), 0.5)


def test_derivatives_with_respect_to_coordinates():
    """A warped ramp changes by its slope."""
    ramp = jnp.outer(jnp.ones(8), jnp.arange(8.0)) * 0.25
    rows, columns = jnp.mgrid[2.4:5, 2.4:6]
    slope = jax.grad(lambda c: warp(ramp, rows, c).sum())(columns)
    np.testing.assert_allclose(slope, 0.25, rtol=1e-6)


def test_invalid_resampling_is_refused():
    with pytest.raises(ValueError, match="method must be one of nearest, linear"):
        resize(PICTURE, (4, 4), method="area")
    with pytest.raises(ValueError, match="size must be a whole number"):
        resize(PICTURE, (0, 4))
    with pytest.raises(ValueError, match=r"size must be rows and columns, such as .*, got 8"):
        resize(PICTURE, 8)
    with pytest.raises(ValueError, match="border must be one of clamp"):
        warp(PICTURE, np.zeros((2, 2)), np.zeros((2, 2)), border="wrap")
    with pytest.raises(ValueError, match="columns must have shape"):
        warp(PICTURE, np.zeros((2, 2)), np.zeros((2, 3)))


@pytest.mark.sweep
@pytest.mark.parametrize("method", ["linear", "cubic", "lanczos3", "lanczos5"])
def test_a_bright_pixel_does_not_change_pixels_beyond_its_reach(method):
    """Each pixel equals the sum over its own window in NumPy."""
    rng = np.random.default_rng(0)
    picture = rng.uniform(0.01, 1, (9, 11)).astype(np.float32)
    picture[4, 5] = 1e8
    np.testing.assert_allclose(resize(picture, (27, 33), method=method)[1::3, 1::3], picture, 1e-6)

    def kernel(x):
        reach = {"linear": 1, "cubic": 2}.get(method) or int(method[-1])
        values = {
            "linear": 1 - x,
            "cubic": np.where(
                x < 1, 1.5 * x**3 - 2.5 * x**2 + 1, -0.5 * x**3 + 2.5 * x**2 - 4 * x + 2
            ),
        }.get(method, np.sinc(x) * np.sinc(x / reach))
        return np.where((x < reach) & (np.abs(values) > 1e-12), values, 0)

    sides = []
    for side, count in ((9, 7), (11, 30)):
        at = (np.arange(count) + 0.5) * side / count - 0.5
        weights = kernel(np.abs(at[:, None] - np.arange(side)) / max(side / count, 1))
        sides.append(weights / weights.sum(1, keepdims=True))
    rows, columns = sides
    truth = rows @ picture.astype(float) @ columns.T
    size = np.abs(rows) @ picture.astype(float) @ np.abs(columns).T
    got = np.asarray(resize(picture, (7, 30), method=method), float)
    assert (np.abs(got - truth) <= 1e-6 * size).all()
