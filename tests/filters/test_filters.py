"""Tests correlation and convolution against `scipy.ndimage`, OpenCV and NumPy loops, and their
laws."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy import ndimage

from jaxvision import filters
from jaxvision.core._loops import fusion
from jaxvision.filters.convolution import CHOICES
from jaxvision.filters.padding import BORDERS, ghosts

RNG = np.random.default_rng(8)
PLANE, IMAGE = RNG.normal(size=(9, 7)), RNG.normal(size=(9, 7, 3))
SCIPY = {
    "zero": "constant",
    "clamp": "nearest",
    "wrap": "grid-wrap",
    "mirror": "reflect",
    "reflect_101": "mirror",
}
NUMPY = {
    "zero": {"mode": "constant"},
    "normalised_zero": {"mode": "constant"},
    "constant": {"mode": "constant"},
    "clamp": {"mode": "edge"},
    "wrap": {"mode": "wrap"},
    "mirror": {"mode": "symmetric"},
    "reflect_101": {"mode": "reflect"},
    "extend": {"mode": "reflect", "reflect_type": "odd"},
}
KERNELS = {size: RNG.normal(size=size) for size in [(3, 3), (4, 3), (1, 6), (5, 4)]}
SMALL = PLANE[:4, :3]  # smaller than the largest kernel
LINEAR = sorted(set(BORDERS) - {"constant"})
counts_our_primitive = pytest.mark.skipif(fusion.PLAIN, reason="plain JAX has no such primitive")


def by_hand(plane, kernel, anchor, border, fill=0.0):
    """Return the correlation by its definition, one product at a time."""
    (h, w), (kh, kw) = plane.shape, kernel.shape
    reach = (anchor[0], kh - 1 - anchor[0]), (anchor[1], kw - 1 - anchor[1])
    options = NUMPY[border] | ({"constant_values": fill} if border == "constant" else {})
    wide = np.pad(plane, reach, **options)
    present = np.pad(np.ones_like(plane), reach)
    g, share = np.zeros((h, w)), np.zeros((h, w))
    for y, x, i, j in np.ndindex(h, w, kh, kw):
        g[y, x] += kernel[i, j] * wide[y + i, x + j]
        share[y, x] += kernel[i, j] * present[y + i, x + j]
    return g / share if border == "normalised_zero" else g


@pytest.mark.sweep("direct")
@pytest.mark.parametrize("size", KERNELS)
@pytest.mark.parametrize("border", BORDERS)
def test_every_border_by_hand(border, size):
    """Odd and even kernels, also larger than the picture, for every method and both directions."""
    kernel = np.abs(KERNELS[size]) if border == "normalised_zero" else KERNELS[size]
    anchor = size[0] // 2, size[1] // 2
    plane = SMALL if size == (5, 4) else PLANE
    expected = by_hand(plane, kernel, anchor, border, 0.7)
    large = size in ((4, 3), (5, 4))
    for method in ("conv", "direct", "separable", "fft") if large else ("conv", "direct"):
        got = filters.correlate(
            plane, kernel, border=border, fill=0.7 * (border == "constant"), method=method
        )
        np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-12, err_msg=method)


@pytest.mark.parametrize("border", BORDERS)
def test_borders_far_beyond_the_picture_equal_numpys(border):
    """The padding is several times as long as the picture, which kernels seldom need."""
    line = PLANE[0, :4]
    source, own, first, last = ghosts(border, 4, 9, 14)
    padded = own * line[source] + first * line[0] + last * line[-1]
    np.testing.assert_allclose(padded, np.pad(line, (9, 14), **NUMPY[border]), atol=1e-14)


@pytest.mark.sweep
@pytest.mark.parametrize("border", SCIPY)
@pytest.mark.parametrize("size", [(3, 3), (4, 3), (5, 4)])
def test_scipy(border, size):
    kernel, mode = KERNELS[size], SCIPY[border]
    plane = SMALL if size == (5, 4) else PLANE
    for ours, theirs in (
        (filters.correlate, ndimage.correlate),
        (filters.convolve, ndimage.convolve),
    ):
        got = ours(plane, kernel, border=border)
        np.testing.assert_allclose(got, theirs(plane, kernel, mode=mode), atol=1e-12)


def test_opencv():
    import cv2

    for border, code in (("reflect_101", cv2.BORDER_DEFAULT), ("clamp", cv2.BORDER_REPLICATE)):
        for size in ((3, 3), (4, 3)):
            theirs = cv2.filter2D(IMAGE, -1, KERNELS[size], borderType=code)
            ours = filters.correlate(IMAGE, KERNELS[size], border=border)
            np.testing.assert_allclose(ours, theirs, atol=1e-12)


@pytest.mark.parametrize("anchor", [(0, 0), (3, 2), (1, 0)])
def test_anchor(anchor):
    kernel = KERNELS[4, 3]
    got = filters.correlate(PLANE, kernel, anchor=anchor, border="clamp")
    np.testing.assert_allclose(got, by_hand(PLANE, kernel, anchor, "clamp"), atol=1e-12)
    turned = filters.convolve(
        PLANE, kernel[::-1, ::-1], anchor=(3 - anchor[0], 2 - anchor[1]), border="clamp"
    )
    np.testing.assert_allclose(turned, got, atol=1e-12)


@pytest.mark.sweep
@pytest.mark.parametrize("method", CHOICES)
def test_batch_bands_and_a_kernel_for_each_band(method):
    batch = RNG.normal(size=(2, 2, 9, 7, 3))
    kernel = RNG.normal(size=(5, 5, 3))
    got = filters.correlate(batch, kernel, border="constant", fill=np.arange(3.0), method=method)
    for i, j, band in np.ndindex(2, 2, 3):
        expected = by_hand(
            batch[i, j, :, :, band], kernel[:, :, band], (2, 2), "constant", float(band)
        )
        np.testing.assert_allclose(got[i, j, :, :, band], expected, atol=1e-12)


@pytest.mark.sweep
@pytest.mark.parametrize("border", ["mirror", "normalised_zero"])
def test_methods_agree_in_single_precision(border):
    image = jnp.asarray(np.abs(RNG.normal(size=(24, 21, 3))), jnp.float32)
    kernel = np.outer(np.hanning(13)[1:-1], np.hanning(13)[1:-1])
    kernel /= kernel.sum()
    truth = filters.correlate(image.astype(jnp.float64), kernel, border=border, method="conv")
    for method in CHOICES:
        got = filters.correlate(image, kernel, border=border, method=method)
        assert got.dtype == jnp.float32
        np.testing.assert_allclose(got, truth, atol=1e-6, err_msg=method)


@pytest.mark.sweep
@pytest.mark.parametrize("border", BORDERS)
def test_one_pixel(border):
    for shape in ((1, 1), (1, 1, 1), (3, 1, 1, 2)):
        f = np.full(shape, 2.0)
        kernel = np.abs(KERNELS[5, 4])
        got = filters.correlate(f, kernel, border=border, fill=0.5 * (border == "constant"))
        own = kernel[2, 2]
        expected = {
            "zero": 2 * own,
            "constant": 2 * own + 0.5 * (kernel.sum() - own),
            "normalised_zero": 2.0,
        }.get(border, 2 * kernel.sum())
        np.testing.assert_allclose(got, expected, rtol=1e-12)


def test_integers_strides_and_orders_of_memory():
    codes = (65535 * RNG.uniform(size=(18, 14, 3))).astype(np.uint16)
    kernel = KERNELS[3, 3]
    for view in (codes[::2, ::-2], np.asfortranarray(codes), (codes >> 8).astype(np.uint8)):
        got = filters.correlate(view, kernel)
        assert got.dtype == jnp.result_type(float)
        expected = ndimage.correlate(view.astype(float), kernel[:, :, None], mode="reflect")
        np.testing.assert_allclose(got, expected, rtol=1e-11, atol=1e-8)


@pytest.mark.parametrize("method", CHOICES)
def test_nan_reaches_its_windows(method):
    image = np.ones((11, 11, 2))
    image[5, 5, 0] = np.nan
    taps = np.ones(5)
    taps[0] = 0  # a tap of 0 counts like others
    got = np.isnan(filters.correlate(image, np.outer(taps, taps), method=method))
    assert not got[:, :, 1].any()
    window = np.zeros((11, 11), bool)
    window[3:8, 3:8] = True
    np.testing.assert_array_equal(got[:, :, 0], window)


def test_reach_of_nan_under_auto_and_kernels_that_are_not_finite():
    """A NaN reaches its windows, whichever method is chosen for the size of the kernel."""
    f = np.ones((20, 20))
    f[10, 10] = np.nan
    for side, spoilt in ((15, 225), (17, 289)):
        got = filters.correlate(f, np.random.default_rng(3).normal(size=(side, side)))
        assert np.isnan(got).sum() == spoilt
    kernel = np.ones((5, 5))
    kernel[0, 0] = np.nan
    assert np.isnan(filters.correlate(PLANE, kernel)).all()
    with pytest.raises(ValueError, match="finite kernel"):
        filters.correlate(PLANE, kernel, method="separable")


def test_nan_stays_in_its_band_with_a_kernel_for_each():
    image = np.ones((7, 7, 2))
    image[3, 3, 0] = np.nan
    got = np.isnan(filters.correlate(image, np.ones((3, 3, 2)), method="direct"))
    assert (got[:, :, 0].sum(), got[:, :, 1].sum()) == (9, 0)


def test_lists_are_kernels_and_anchors():
    kernel = [[0.0, 1.0], [2.0, -1.0]]
    got = filters.correlate(PLANE, kernel, anchor=[1, 0])
    np.testing.assert_allclose(got, by_hand(PLANE, np.array(kernel), (1, 0), "mirror"), atol=1e-14)
    got = filters.correlate_separable(PLANE, [1.0, 2.0], [1.0])
    np.testing.assert_allclose(got, by_hand(PLANE, np.array([[1.0], [2]]), (1, 0), "mirror"))


# ------------------------------------------------ laws


def test_impulse_response_is_the_kernel():
    for size, kernel in KERNELS.items():
        if size[0] > 9:
            continue
        blur = partial(filters.convolve, kernel=kernel, border="zero")
        seen = np.asarray(filters.impulse_response(jnp.asarray(1.0), operator=blur, shape=(9, 9)))
        top, left = 4 - size[0] // 2, 4 - size[1] // 2
        expected = np.zeros((9, 9))
        expected[top : top + size[0], left : left + size[1]] = kernel
        np.testing.assert_allclose(seen, expected, atol=1e-14)


@pytest.mark.sweep
@pytest.mark.parametrize("border", ["zero", "clamp", "mirror", "reflect_101", "wrap"])
@pytest.mark.parametrize(("taps", "anchor"), [(3, None), (4, None), (4, (0,))])
def test_signals_equal_their_matrices(border, taps, anchor):
    """The references are SciPy's correlation in one dimension, NumPy's convolution inside, and the
    matrix product H f."""
    f, kernel = RNG.normal(size=11), RNG.normal(size=taps)
    origin = 0 if anchor is None else anchor[0] - taps // 2
    expected = ndimage.correlate1d(f, kernel, mode=SCIPY[border], origin=origin)
    options = {"border": border, "anchor": anchor}
    np.testing.assert_allclose(filters.correlate(f, kernel, **options), expected, atol=1e-12)
    form = filters.filter_matrix(kernel, shape=(11,), **options)
    assert form.matrix.shape == (11, 11)
    np.testing.assert_allclose(form.matrix @ f, expected, atol=1e-12)
    spread = filters.convolve(f, kernel, border=border, anchor=anchor)
    first = taps // 2 if anchor is None else anchor[0]
    np.testing.assert_allclose(
        spread[4:-4], np.convolve(f, kernel)[first : first + 11][4:-4], atol=1e-12
    )


def test_impulse_response_transpose_and_refusals_of_signals():
    """Impulse response, transpose and offset are right, and shapes that do not fit are refused."""
    kernel, f = jnp.array([1.0, 2.0, 4.0]), jnp.arange(5.0)
    blur = partial(filters.convolve, kernel=kernel, border="zero")
    seen = filters.impulse_response(jnp.asarray(1.0), operator=blur, shape=(5,))
    np.testing.assert_array_equal(seen, [0, 1, 2, 4, 0])
    np.testing.assert_array_equal(
        filters.adjoint(f, operator=blur), filters.correlate(f, kernel, border="zero")
    )
    form = filters.filter_matrix(kernel, shape=(5,), border="constant", fill=3.0)
    np.testing.assert_array_equal(
        form.matrix @ f + form.offset, filters.correlate(f, kernel, border="constant", fill=3.0)
    )
    with pytest.raises(ValueError, match=r"takes a kernel \(k,\)"):
        filters.correlate(f, jnp.ones((3, 3)))
    with pytest.raises(ValueError, match=r"\(n,\) with \(k,\)"):
        filters.filter_matrix(kernel, shape=(5, 5))


@pytest.mark.parametrize("border", LINEAR)
def test_superposition(border):
    kernel = np.abs(KERNELS[4, 3])
    f, g = PLANE, RNG.normal(size=PLANE.shape)
    h = partial(filters.correlate, kernel=kernel, border=border)
    np.testing.assert_allclose(h(2.5 * f - 3 * g), 2.5 * h(f) - 3 * h(g), atol=1e-11)


def test_only_a_linear_border_superposes():
    h = partial(filters.correlate, kernel=KERNELS[3, 3], border="constant", fill=1.0)
    assert np.abs(h(2 * PLANE) - 2 * h(PLANE)).max() > 0.1


def test_shift_invariance_and_commuting_under_wrap():
    a, b = KERNELS[4, 3], KERNELS[3, 3]
    f = partial(filters.convolve, border="wrap")
    moved = np.roll(PLANE, (2, -3), (0, 1))
    np.testing.assert_allclose(f(moved, a), np.roll(f(PLANE, a), (2, -3), (0, 1)), atol=1e-12)
    np.testing.assert_allclose(f(f(PLANE, a), b), f(f(PLANE, b), a), atol=1e-12)


@pytest.mark.sweep
@pytest.mark.parametrize("method", ["conv", "direct", "fft"])
@pytest.mark.parametrize("border", LINEAR)
def test_gradients_by_hand(border, method):
    """The reference is the change of <y, K f> for a unit change of each pixel and tap."""
    size = 4, 3
    f, y, kernel = RNG.normal(size=size), RNG.normal(size=size), np.abs(RNG.normal(size=size))

    def response(plane, kernel):
        return np.vdot(y, by_hand(plane, kernel, (2, 1), border))

    g = partial(filters.correlate, border=border, method=method)
    pixels, taps = jax.grad(lambda f, k: jnp.vdot(y, g(f, k)), (0, 1))(
        *map(jnp.asarray, (f, kernel))
    )
    units = np.eye(12).reshape(12, *size)
    np.testing.assert_allclose(
        pixels.ravel(), [response(unit, kernel) for unit in units], atol=1e-11
    )
    if border != "normalised_zero":  # it is nonlinear in the kernel
        np.testing.assert_allclose(taps.ravel(), [response(f, unit) for unit in units], atol=1e-11)


@pytest.mark.slow
def test_derivatives_forward_and_reverse_twice():
    f, kernel = jnp.asarray(PLANE[:3, :2]), jnp.asarray(np.abs(KERNELS[4, 3][:2, :2]))
    g = partial(filters.correlate, border="normalised_zero")
    check_grads(g, (f, kernel), order=2, rtol=1e-4, atol=1e-6)


def test_derivative_of_large_kernels_one_for_each_band():
    """These kernels have more taps than are computed as inner products."""
    image, kernel, y = IMAGE, RNG.normal(size=(6, 7, 3)), RNG.normal(size=IMAGE.shape)
    got = jax.grad(lambda k: jnp.vdot(y, filters.correlate(image, k, border="wrap")))(
        jnp.asarray(kernel)
    )
    for i, j in ((0, 0), (3, 3), (5, 6), (1, 4)):
        moved = np.roll(image, (3 - i, 3 - j), (0, 1))
        np.testing.assert_allclose(got[i, j], (y * moved).sum((0, 1)), atol=1e-11)


@pytest.mark.slow
@pytest.mark.sweep
@pytest.mark.parametrize("border", ["zero", "clamp", "wrap", "mirror", "reflect_101", "extend"])
def test_adjoint(border):
    """Checks <H x, y> = <x, H' y>."""
    image = IMAGE[:4, :3]  # smaller than the kernel
    y = RNG.normal(size=image.shape)
    for method in ("conv", "direct", "fft"):
        h = partial(filters.correlate, kernel=KERNELS[5, 4], border=border, method=method)
        left = np.vdot(h(image), y)
        right = np.vdot(image, filters.adjoint(jnp.asarray(y), operator=h))
        np.testing.assert_allclose(left, right, rtol=1e-11)


def test_nonlinear_operators_have_no_adjoint():
    h = partial(filters.correlate, kernel=np.ones((3, 3)), border="constant", fill=1.0)
    with pytest.raises(ValueError, match="up to 5 of a picture of 0"):
        filters.adjoint(jnp.asarray(PLANE), operator=h)
    with pytest.raises(ValueError, match="picture of 0"):
        filters.scipy_operator(h, PLANE.shape)
    dark = partial(h, fill=0.0)
    as_zero = partial(filters.correlate, kernel=np.ones((3, 3)), border="zero")
    y = jnp.asarray(PLANE)
    np.testing.assert_allclose(
        filters.adjoint(y, operator=dark), filters.adjoint(y, operator=as_zero), atol=1e-13
    )


@pytest.mark.parametrize("mapped", [(0, None), (None, 0), (0, 0), (1, 2)])
def test_vmap_of_pictures_and_of_kernels(mapped):
    stacked = [RNG.normal(size=(4, 9, 7, 3)), RNG.normal(size=(4, 3, 2, 3))]
    chosen = [
        jnp.asarray(s[0] if axis is None else np.moveaxis(s, 0, axis))
        for s, axis in zip(stacked, mapped, strict=True)
    ]
    f = partial(filters.correlate, border="mirror", method="direct")
    got = jax.vmap(f, mapped)(*chosen)
    for i in range(4):
        one = [s[0] if axis is None else s[i] for s, axis in zip(stacked, mapped, strict=True)]
        np.testing.assert_allclose(got[i], f(*map(jnp.asarray, one)), atol=1e-12)


@counts_our_primitive
def test_transpose_of_a_separable_blur_is_separable():
    """Besides the two correlations there is no gather, scatter or sum over taps."""
    k = jnp.ones(9)
    f = jax.grad(lambda x: filters.correlate_separable(x, k, k, border="zero").sum())
    text = str(jax.make_jaxpr(f)(jnp.asarray(PLANE)))
    assert text.count("jaxvision_correlate[") == 4
    assert "gather" not in text
    assert "scatter" not in text


# ------------------------------------------------ low rank


@pytest.mark.slow
def test_separable_is_its_outer_product():
    column, row = RNG.normal(size=4), RNG.normal(size=5)
    for border in ("mirror", "normalised_zero"):
        positive = [np.abs(v) for v in (column, row)]
        expected = filters.correlate(PLANE, np.outer(*positive), border=border)
        for method in CHOICES:
            got = filters.correlate_separable(PLANE, *positive, border=border, method=method)
            np.testing.assert_allclose(got, expected, atol=1e-12)


@pytest.mark.slow
def test_low_rank_states_its_error():
    kernel = RNG.normal(size=(6, 5))
    image = np.clip(IMAGE, -1, 1)
    exact = filters.correlate(image, kernel)
    before = np.inf
    for rank in range(1, 6):
        factors = filters.low_rank(jnp.asarray(kernel), rank=rank)
        whole = np.einsum("ri,rj->ij", factors.columns, factors.rows)
        np.testing.assert_allclose(np.linalg.norm(whole - kernel), factors.error, atol=1e-12)
        off = np.abs(filters.correlate_low_rank(image, factors) - exact).max()
        assert off <= np.sqrt(30) * factors.error + 1e-12
        assert factors.error < before
        before = factors.error
    assert before < 1e-12


@counts_our_primitive
def test_auto_chooses_by_rank_and_size():
    def primitive(kernel):
        text = str(jax.make_jaxpr(lambda f: filters.correlate(f, kernel))(jnp.asarray(PLANE)))
        return text.count("jaxvision_correlate["), "method=fft" in text

    assert primitive(np.ones((9, 9))) == (2, False)
    assert primitive(RNG.normal(size=(9, 9))) == (1, False)
    assert primitive(RNG.normal(size=(21, 21))) == (1, True)
    assert primitive(np.ones((3, 3))) == (1, False)


@pytest.mark.slow
def test_a_sum_of_zero_up_to_rounding_is_not_normalised():
    """The weights sum to 0 exactly, but not in float32."""
    bell = np.exp(-(np.arange(-7, 8.0) ** 2) / 8)
    kernel = np.outer(bell / bell.sum(), bell)
    kernel -= kernel.mean()
    kernel = (100 * kernel).astype(np.float32)
    assert kernel.sum() != 0
    f = RNG.uniform(size=(21, 20)).astype(np.float32)
    got = np.asarray(filters.correlate(f, kernel, border="normalised_zero", method="conv"))
    np.testing.assert_array_equal(got[7:-7, 7:-7], 0)
    form = filters.filter_matrix(kernel, shape=f.shape, border="normalised_zero")
    whole = np.asarray(form.matrix @ f.ravel()).reshape(f.shape)
    np.testing.assert_array_equal(whole[7:-7, 7:-7], 0)


@pytest.mark.slow
def test_zero_border_darkens_and_normalisation_corrects_it():
    """The example of the textbook, a uniform picture after a blur."""
    grey = np.full((20, 30), 0.5)
    blurred = {b: np.asarray(filters.box(grey, size=9, border=b)) for b in BORDERS}
    assert blurred["zero"][0, 0] == pytest.approx(0.5 * 25 / 81)
    assert blurred["zero"][0, 15] == pytest.approx(0.5 * 5 / 9)
    for border in ("normalised_zero", "clamp", "mirror", "reflect_101", "wrap", "extend"):
        np.testing.assert_allclose(blurred[border], 0.5, rtol=1e-12)


# ------------------------------------------------ bad input


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"kernel": np.ones(3)}, r"\(kh, kw\)"),
        ({"kernel": np.ones((0, 3))}, r"\(kh, kw\)"),
        ({"kernel": np.ones((3, 3, 2))}, "3 bands, got 2"),
        ({"picture": np.ones(4)}, r"\(h, w\)"),
        ({"picture": np.ones((0, 4))}, "at least one pixel"),
        ({"anchor": (3, 0)}, "anchor"),
        ({"anchor": (1,)}, "anchor"),
        ({"picture": 1j * np.ones((4, 4))}, "complex"),
        ({"border": "nearest"}, 'scipy "nearest"'),
        ({"method": "winograd"}, "separable, conv, direct, fft"),
    ],
)
def test_bad_input_is_named(options, words):
    arguments = {"picture": IMAGE, "kernel": np.ones((3, 3))} | options
    for function in (filters.correlate, filters.convolve):
        with pytest.raises(ValueError, match=words):
            function(**arguments)


def test_separable_needs_a_concrete_kernel():
    with pytest.raises(ValueError, match="low_rank"):
        jax.jit(partial(filters.correlate, method="separable"))(PLANE, KERNELS[3, 3])
    with pytest.raises(ValueError, match="bands"):
        filters.correlate_separable(IMAGE, np.ones((3, 2)), np.ones(3))
    with pytest.raises(ValueError, match=r"\(n,\)"):
        filters.correlate_separable(IMAGE, np.ones((3, 2, 2)), np.ones(3))
