"""Tests pictures in the forms of other libraries, and that the same concept has the same form
everywhere."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage, sparse

import jaxvision as jv

RNG = np.random.default_rng(5)
RGB = RNG.uniform(0.1, 0.9, (6, 8, 3))
GREY = RGB[..., 0]


def test_a_bayer_phase_is_a_pattern_everywhere():
    pattern = jv.bayer("RGGB")
    assert jv.Demosaicing("RGGB").pattern == pattern
    assert jv.ColourFilter(np.eye(3), pattern="rggb").pattern == pattern
    for method in ("bilinear", "malvar", "menon", "normalised"):
        demosaic = getattr(jv.development, f"demosaic_{method}")
        np.testing.assert_array_equal(demosaic(GREY, "RGGB"), demosaic(GREY, pattern))
    masks = zip(
        jv.sensor.colour_filters.sites("RGGB", 4, 4),
        jv.sensor.colour_filters.sites(pattern, 4, 4),
        strict=True,
    )
    assert all((a == b).all() for a, b in masks)


@pytest.mark.parametrize(
    "operator",
    [
        lambda f: jv.point_ops.vignette(f, [-0.2, 0.1]),
        lambda f: jv.point_ops.correct_vignetting(f, [-0.2, 0.1]),
        lambda f: jv.point_ops.graded_filter(f, 0.3, 0.5, 0.0, 0.5),
        lambda f: jv.white_balance(f, [1.5], saturation=0.8),
    ],
)
def test_grey_pictures_are_pictures_of_one_band(operator):
    np.testing.assert_array_equal(operator(GREY), operator(GREY[..., None])[..., 0])


@pytest.mark.parametrize(
    "operator",
    [
        lambda f, m: jv.point_ops.blend(f, f**2, m),
        lambda f, m: jv.gain_bias(f, m, m),
        lambda f, m: jv.point_ops.contrast_brightness(f, m, m, pivot=m),
        lambda f, m: jv.point_ops.exposure(f, m),
        lambda f, m: jv.matting.dissolve(f, m),
    ],
)
def test_a_map_of_pixels_lies_beside_a_picture_of_bands(operator):
    np.testing.assert_array_equal(operator(RGB, GREY), operator(RGB, GREY[..., None]))
    np.testing.assert_array_equal(operator(GREY, GREY), operator(RGB, GREY)[..., 0])


def test_scipy_takes_a_filter_as_its_sparse_matrix():
    kernel = RNG.normal(size=(3, 5))
    matrix = jv.filters.scipy_matrix(jv.filters.filter_matrix(kernel, shape=(6, 8)))
    assert sparse.issparse(matrix)
    truth = ndimage.correlate(GREY, kernel, mode="reflect")
    np.testing.assert_allclose((matrix @ GREY.ravel()).reshape(6, 8), truth, rtol=1e-12)
    form = jv.filters.filter_matrix(kernel, shape=(6, 8), border="constant", fill=2.0)
    with pytest.raises(ValueError, match="offset"):
        jv.filters.scipy_matrix(form)


def test_the_blur_of_a_soft_cutout_has_the_colours_of_the_cutout():
    alpha = np.zeros((20, 20, 1))
    alpha[5:15, 5:15] = RNG.uniform(0.05, 1, (10, 10, 1))
    light = np.array([0.2, 0.5, 0.9])
    layer = np.concatenate([light * alpha, alpha], axis=-1)
    blurred = jv.filters.gaussian(layer, 2.0, border="zero")
    colour = jv.matting.unpremultiply(blurred)
    np.testing.assert_allclose(colour[8, 8], light, rtol=1e-6)
    np.testing.assert_allclose(colour[2, 8], light, rtol=1e-6)


def test_a_shipped_camera_says_what_to_do_with_an_rgb_picture():
    sensor = jv.read_camera("consumer_bayer").sensor
    with pytest.raises(ValueError, match="holds no spectrum: render with the sensor's 31 bands"):
        jv.raw_image(jax.random.key(0), sensor, jnp.asarray(RGB))


def test_channels_first_are_named_and_many_bands_are_not():
    with pytest.warns(UserWarning, match="moveaxis"):
        jv.filters.gaussian(np.ones((3, 64, 64)), 1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        jv.filters.gaussian(np.ones((3, 64, 31)), 1.0)
        jv.filters.gaussian(np.ones((64, 64, 64)), 1.0)


def test_rgb_pictures_are_not_layers():
    with pytest.warns(UserWarning, match="fourth channel"):
        jv.matting.over(RGB, RGB)
    opaque = np.concatenate([RGB[..., :2], np.ones((6, 8, 1))], axis=-1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        jv.matting.over(RGB, opaque)  # two bands over an opaque background


def decoded(picture):
    return jv.gamma_decode(picture, 2.2)


@pytest.mark.parametrize(
    "encode",
    [
        lambda x: jv.gamma_encode(x, 2.2),
        decoded,
        jv.srgb_encode,
        jv.srgb_decode,
        jv.colour_spaces.rgb_to_hsv,
        jv.colour_spaces.rgb_to_hsl,
        jv.colour_spaces.rgb_to_ycbcr,
        jv.colour_spaces.rgb_to_xyz,
        jv.colour_spaces.hsv_to_rgb,
        jv.colour_spaces.hsl_to_rgb,
        lambda x: jv.colour_spaces.xyz_to_lab(x, np.ones(3)),
        lambda x: jv.colour_spaces.xyz_to_luv(x, np.ones(3)),
        jv.point_ops.reinhard,
        jv.point_ops.filmic,
        lambda x: jv.point_ops.log_curve(x, 100.0),
        lambda x: jv.tone_curve(x, [0.0, 0.5, 1.0], [0.0, 0.6, 1.0]),
    ],
)
def test_integer_codes_are_refused_as_colours(encode):
    with pytest.raises(ValueError, match="divide the codes"):
        encode(np.round(255 * RGB))
    light = 1000 * RGB  # scene-linear light above white, which encoded pictures cannot hold
    if encode in (decoded, jv.srgb_decode):
        with pytest.warns(UserWarning, match="where 1 is white"):
            encode(light)
    else:
        encode(light)


def test_a_tone_curve_through_codes_takes_codes():
    codes = np.linspace(0, 255, 16).round()
    seen = jv.tone_curve(codes, [0.0, 255.0], [0.0, 510.0])
    np.testing.assert_allclose(seen, 2 * codes, rtol=1e-6)


SCIPY = {
    "zero": "constant",
    "constant": "constant",
    "clamp": "nearest",
    "wrap": "grid-wrap",
    "mirror": "reflect",
    "reflect_101": "mirror",
}


@pytest.mark.parametrize("border", jv.filters.padding.BORDERS)
@pytest.mark.parametrize("method", ["auto", pytest.param("fft", marks=pytest.mark.slow)])
@pytest.mark.sweep
def test_an_even_kernel_several_times_as_large_as_the_picture(border, method):
    """The references are SciPy's sums, or a loop for borders that SciPy does not have."""
    random = np.random.default_rng(3)
    picture, kernel = random.uniform(size=(3, 2)), random.uniform(0.1, 1, size=(10, 14))
    fill = 0.3 if border == "constant" else 0.0
    got = jv.filters.correlate(picture, kernel, border=border, fill=fill, method=method)
    if border in SCIPY:
        wanted = ndimage.correlate(picture, kernel, mode=SCIPY[border], cval=fill)
    elif border == "normalised_zero":
        sums = (ndimage.correlate(x, kernel, mode="constant") for x in (picture, np.ones((3, 2))))
        wanted = np.divide(*sums)
    else:
        wide = np.pad(picture, ((5, 4), (7, 6)), mode="reflect", reflect_type="odd")
        wanted = ndimage.correlate(wide, kernel, mode="constant")[5:8, 7:9]
    np.testing.assert_allclose(got, wanted, rtol=1e-5)


@pytest.mark.parametrize("function", ["correlate", "resize", "gaussian", "box", "convolve"])
def test_channels_first_are_named_once_at_the_line_of_the_call(function):
    settings = {
        "correlate": {"kernel": np.ones((3, 3))},
        "convolve": {"kernel": np.ones((3, 3))},
        "resize": {"size": (30, 31)},
        "gaussian": {"sigma": 2.0},
        "box": {"size": 3},
    }[function]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        getattr(jv.filters, function)(np.ones((3, 37, 38)), **settings)
    assert len(caught) == 1
    assert "shape (3, 37, 38)" in str(caught[0].message)
    assert caught[0].filename == __file__


def test_a_gaussian_far_wider_than_its_picture():
    """The reference is SciPy. The program must not grow with the kernel, whose 2401 taps took 27
    s."""
    picture = np.random.default_rng(7).uniform(size=(6, 7))
    wanted = ndimage.gaussian_filter(picture, 300)
    np.testing.assert_allclose(jv.filters.gaussian(picture, 300.0), wanted, rtol=2e-6)


@pytest.mark.slow
@pytest.mark.parametrize("border", ["mirror", "zero", "wrap", "reflect_101"])
def test_gradients_and_nan_of_a_long_kernel(border):
    """The kernel has 351 taps. The gradient is the transposed filter, and NaN is only in its own
    windows."""
    random = np.random.default_rng(7)
    picture, other = random.uniform(size=(2, 60, 7))
    kernel = random.uniform(size=(27, 13))

    def filtered(x):
        return jv.filters.correlate(x, kernel, border=border, method="direct")

    wanted = ndimage.correlate(picture, kernel, mode=SCIPY[border])
    np.testing.assert_allclose(filtered(picture), wanted, rtol=2e-6)
    slope = jax.grad(lambda x: (other * filtered(x)).sum())(jnp.asarray(picture))
    change = random.uniform(size=picture.shape)
    np.testing.assert_allclose((slope * change).sum(), (other * filtered(change)).sum(), rtol=1e-5)
    gap = np.isnan(filtered(np.where(np.arange(60)[:, None] == 30, np.nan, picture)))
    np.testing.assert_array_equal(gap.all(axis=1), abs(np.arange(60) - 30) <= 13)
    np.testing.assert_array_equal(gap.any(axis=1), abs(np.arange(60) - 30) <= 13)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [jnp.float16, jnp.bfloat16])
def test_half_precision_is_computed_in_float32(dtype):
    """Products and sums that overflow float16, or lose its digits, are computed in float32."""
    rng = np.random.default_rng(3)
    lab = jnp.asarray(rng.uniform(-150, 150, (2, 50, 3)), dtype)
    light = jnp.asarray(rng.uniform(0.01, 1, (6, 7)), dtype)
    for function, given in (
        (lambda x: jv.colour_spaces.delta_e_2000(*x), lab),
        (jv.point_ops.scaled_to_key, light),
    ):
        got, wide = function(given), function(given.astype(jnp.float32))
        assert got.dtype == dtype
        np.testing.assert_array_equal(got, wide.astype(dtype))


@pytest.mark.slow
def test_a_matte_in_half_precision_equals_float32():
    light = np.random.default_rng(3).uniform(0.01, 1, (6, 7, 3)).astype(np.float16)
    trimap = np.broadcast_to([0, 0, 0.5, 0.5, 0.5, 1, 1], (6, 7))
    half, wide = (jv.matting.closed_form_matte(x, trimap) for x in (light, np.float32(light)))
    np.testing.assert_array_equal(half.alpha, wide.alpha.astype(np.float16))


def test_a_table_of_codes_refuses_relative_values():
    with pytest.raises(ValueError, match="codes must be integers, got float"):
        jv.point_ops.lookup_codes(np.array([0.2, 0.4]), np.linspace(0, 1, 256))
    np.testing.assert_allclose(
        jv.point_ops.lookup_codes(np.array([0, 255]), np.arange(256.0)), [0, 255]
    )


def test_a_dead_pixel_does_not_change_the_grey_world():
    picture = np.random.default_rng(5).uniform(0.1, 1, (6, 7, 3))
    dead = picture.copy()
    dead[2, 3, 1] = np.nan
    rest = np.delete(picture.reshape(-1, 3), 2 * 7 + 3, axis=0)[None]
    for options in ({}, {"norm": 6.0}, {"saturation": 0.9}):
        gains = jv.development.grey_world_gains(dead, **options)
        np.testing.assert_allclose(
            gains, jv.development.grey_world_gains(rest, **options), rtol=1e-6
        )
    assert np.isnan(jv.development.grey_world_gains(np.full((2, 2, 3), np.nan))).all()


def test_impossible_gains_and_indices_are_refused():
    with pytest.raises(ValueError, match="white_balance: gains must be at least 0"):
        jv.development.white_balance(np.ones((2, 2, 3)), np.array([-1.0, 1, 1]))
    with pytest.raises(ValueError, match=r"Glass\.index must be .*above 0"):
        jv.Glass(0.0)
