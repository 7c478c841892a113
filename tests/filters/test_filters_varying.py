"""Tests kernels that vary from pixel to pixel, and filters as matrices."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxvision import filters
from jaxvision.filters.padding import BORDERS

RNG = np.random.default_rng(21)
H, W = 7, 6
PLANE, IMAGE = RNG.normal(size=(H, W)), RNG.normal(size=(2, H, W, 3))
STACK = np.abs(RNG.normal(size=(4, 3, H, W)))
KERNEL = np.abs(RNG.normal(size=(4, 3)))
LINEAR = ("zero", "clamp", "wrap", "mirror", "reflect_101", "extend")
NUMPY = {
    "zero": {"mode": "constant"},
    "clamp": {"mode": "edge"},
    "wrap": {"mode": "wrap"},
    "mirror": {"mode": "symmetric"},
    "reflect_101": {"mode": "reflect"},
    "extend": {"mode": "reflect", "reflect_type": "odd"},
}


def by_hand(plane, stack, anchor, border):
    kh, kw, h, w = stack.shape
    reach = (anchor[0], kh - 1 - anchor[0]), (anchor[1], kw - 1 - anchor[1])
    wide, g = np.pad(plane, reach, **NUMPY[border]), np.zeros((h, w))
    for i, j, y, x in np.ndindex(kh, kw, h, w):
        g[y, x] += stack[i, j, y, x] * wide[y + i, x + j]
    return g


# ------------------------------------------------ a kernel for each pixel


@pytest.mark.sweep
@pytest.mark.parametrize("border", LINEAR)
def test_per_pixel_by_hand(border):
    got = filters.correlate_per_pixel(PLANE, jnp.asarray(STACK), border=border)
    np.testing.assert_allclose(got, by_hand(PLANE, STACK, (2, 1), border), atol=1e-12)
    got = filters.correlate_per_pixel(IMAGE, jnp.asarray(STACK), anchor=(0, 2), border=border)
    expected = by_hand(IMAGE[1, :, :, 2], STACK, (0, 2), border)
    np.testing.assert_allclose(got[1, :, :, 2], expected, atol=1e-12)


@pytest.mark.parametrize("anchor", [None, (0, 2)])
def test_convolution_per_pixel_mirrors_each_kernel(anchor):
    """The reference computes one product at a time, with the pixel mirrored at the anchor, for the
    border "wrap"."""
    kh, kw = STACK.shape[:2]
    top, left = (kh // 2, kw // 2) if anchor is None else anchor
    expected = np.zeros((H, W))
    for y, x, i, j in np.ndindex(H, W, kh, kw):
        expected[y, x] += STACK[i, j, y, x] * PLANE[(y - i + top) % H, (x - j + left) % W]
    got = filters.convolve_per_pixel(PLANE, STACK, anchor=anchor, border="wrap")
    np.testing.assert_allclose(got, expected, atol=1e-12)


def test_one_kernel_everywhere_is_correlation():
    stack = jnp.broadcast_to(jnp.asarray(KERNEL)[:, :, None, None], (4, 3, H, W))
    got = filters.correlate_per_pixel(IMAGE, stack)
    np.testing.assert_allclose(got, filters.correlate(IMAGE, KERNEL), atol=1e-12)


def varying_gaussian(plane, sigma, radius):
    """Return the blur by loops, with the weights of each pixel normalised to a sum of 1."""
    wide, g = np.pad(plane, radius, mode="symmetric"), np.zeros_like(plane)
    yy, xx = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    inside = yy**2 + xx**2 <= radius**2
    for y, x in np.ndindex(plane.shape):
        k = inside * np.exp(-(yy**2 + xx**2) / (2 * sigma[y, x] ** 2))
        g[y, x] = (k * wide[y : y + 2 * radius + 1, x : x + 2 * radius + 1]).sum() / k.sum()
    return g


def test_radial_blur_by_hand():
    sigma = RNG.uniform(0.3, 2, size=(H, W))
    got = filters.radial_blur(IMAGE, jnp.asarray(sigma), radius=5)
    expected = varying_gaussian(IMAGE[1, :, :, 0], sigma, 5)
    np.testing.assert_allclose(got[1, :, :, 0], expected, atol=1e-12)


@pytest.mark.sweep
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_radial_blur_of_zero_width(dtype):
    """A scale of 0 or below leaves the picture unchanged. The gradient is finite, and by the
    picture it is the identity."""
    f, scale = jnp.asarray(PLANE, dtype), jnp.asarray([0.0, -1, 1e-30] * 14, dtype).reshape(H, W)

    def blur(f, scale):
        return filters.radial_blur(f, scale, radius=2)

    np.testing.assert_allclose(blur(f, scale), f, rtol=4 * jnp.finfo(dtype).eps)
    by_f, by_scale = jax.grad(lambda *x: (blur(*x) * f).sum(), (0, 1))(f, scale)
    np.testing.assert_allclose(by_f, f, rtol=1e-6)
    np.testing.assert_array_equal(by_scale, 0)


def test_disk_of_defocus():
    """The result is sharp where the radius is 0, and the mean over the disc elsewhere. A uniform
    picture is unchanged."""
    radius = jnp.asarray(np.where(np.arange(W) < 3, 0.0, 2.5)[None] * np.ones((H, 1)))
    blur = partial(filters.radial_blur, profile=filters.disk_profile, radius=4)
    got = blur(PLANE, radius)
    np.testing.assert_allclose(got[:, :3], PLANE[:, :3], atol=1e-13)
    np.testing.assert_allclose(blur(np.ones((H, W)), radius), 1, atol=1e-13)
    np.testing.assert_array_equal(blur(PLANE, radius - 9), PLANE)  # all weights are 0


def test_bank_is_linear_between_its_members():
    bank = RNG.normal(size=(3, 3, 3))
    position = np.array([-1.0, 0, 0.25, 1, 1.5, 9])[None] * np.ones((H, 1))
    got = filters.correlate_bank(IMAGE, jnp.asarray(bank), jnp.asarray(position))
    a, b, c = (np.asarray(filters.correlate(IMAGE, k)) for k in bank)
    expected = (a, a, 0.75 * a + 0.25 * b, b, 0.5 * b + 0.5 * c, c)
    for x, image in enumerate(expected):
        np.testing.assert_allclose(got[:, :, x], image[:, :, x], atol=1e-12)


@pytest.mark.slow
def test_banks_take_a_fill():
    """A uniform picture with its own value as the fill stays uniform."""
    f, options = np.full((H, W), 0.7), {"border": "constant", "fill": 0.7}
    position = jnp.full((H, W), 0.4)
    got = filters.correlate_bank(f, np.full((2, 3, 3), 1 / 9), position, **options)
    np.testing.assert_allclose(got, 0.7, rtol=1e-14)
    got = filters.gaussian_varying(f, position, sigmas=[0.2, 1.0], **options)
    np.testing.assert_allclose(got, 0.7, rtol=1e-14)


@pytest.mark.slow
def test_the_error_falls_with_the_members_of_a_gaussian_bank():
    plane = RNG.normal(size=(8, 40))
    sigma = np.linspace(0.8, 1.6, 40)[None] * np.ones((8, 1))
    truth = varying_gaussian(plane, sigma, 8)
    errors = []
    for members in (2, 4, 8):
        sigmas = filters.blur_sigmas(0.8, 1.6, members=members)
        got = filters.gaussian_varying(plane, jnp.asarray(sigma), sigmas=sigmas, truncate=5.0)
        errors.append(np.abs(got - truth).max())
    assert errors[1] < errors[0] / 3
    assert errors[2] < min(errors[1] / 3, 0.02)


@pytest.mark.slow
def test_a_bank_interpolates_the_variance_between_its_sigmas():
    """The impulse response is measured at a pixel between two members."""
    sigma = jnp.full((31, 31), 1.7)
    impulse = np.zeros((31, 31))
    impulse[15, 15] = 1
    got = np.asarray(filters.gaussian_varying(impulse, sigma, sigmas=(1.0, 2.5), truncate=6.0))
    yy, xx = np.mgrid[:31, :31] - 15
    np.testing.assert_allclose((got * xx**2).sum(), 1.7**2, rtol=1e-5)
    np.testing.assert_allclose((got * yy**2).sum(), 1.7**2, rtol=1e-5)


# ------------------------------------------------ matrices


@pytest.mark.sweep
@pytest.mark.parametrize("border", BORDERS)
@pytest.mark.parametrize("size", [(4, 3), (1, 1), (9, 15)])
def test_matrix_is_the_filter(border, size):
    kernel = jnp.asarray(np.abs(RNG.normal(size=size)))
    form = filters.filter_matrix(
        kernel, shape=(H, W), border=border, fill=0.7 * (border == "constant")
    )
    expected = filters.correlate(
        PLANE, kernel, border=border, fill=0.7 * (border == "constant"), method="conv"
    )
    g = form.matrix @ PLANE.ravel()
    assert (form.offset is None) == (border != "constant")
    g = g if form.offset is None else g + form.offset
    np.testing.assert_allclose(g, expected.ravel(), atol=1e-12)
    theirs = filters.scipy_matrix(form.matrix)
    np.testing.assert_allclose(theirs @ PLANE.ravel(), form.matrix @ PLANE.ravel(), atol=1e-12)


@pytest.mark.sweep
@pytest.mark.parametrize("border", LINEAR)
def test_matrix_of_a_kernel_for_each_pixel_and_its_transpose(border):
    form = filters.per_pixel_matrix(jnp.asarray(STACK), border=border)
    dense = np.asarray(form.matrix.todense())
    h = partial(filters.correlate_per_pixel, kernels=jnp.asarray(STACK), border=border)
    np.testing.assert_allclose(dense @ PLANE.ravel(), h(PLANE).ravel(), atol=1e-12)
    y = RNG.normal(size=(H, W))
    back = filters.adjoint(jnp.asarray(y), operator=h)
    np.testing.assert_allclose(dense.T @ y.ravel(), back.ravel(), atol=1e-12)


def test_matrix_is_traced_and_differentiated_by_its_kernel():
    y = RNG.normal(size=H * W)

    def by_matrix(kernel):
        form = filters.filter_matrix(kernel, shape=(H, W), border="normalised_zero")
        return jnp.vdot(y, form.matrix @ PLANE.ravel())

    def by_filter(kernel):
        g = filters.correlate(PLANE, kernel, border="normalised_zero")
        return jnp.vdot(y, g.ravel())

    got = jax.jit(jax.grad(by_matrix))(jnp.asarray(KERNEL))
    np.testing.assert_allclose(got, jax.grad(by_filter)(jnp.asarray(KERNEL)), rtol=1e-10)


@pytest.mark.slow
def test_scipy_solves_with_the_operator():
    """Conjugate gradients deblur with the operator and its transpose, without a matrix."""
    from scipy.sparse.linalg import lsqr

    kernel = np.array([[0.0, 1, 0], [1, 6, 1], [0, 1, 0]]) / 10
    h = partial(filters.correlate, kernel=kernel, border="mirror")
    operator = filters.scipy_operator(h, (H, W, 2))
    f = RNG.normal(size=(H, W, 2))
    found = lsqr(operator, np.asarray(h(f)).ravel(), atol=1e-13, btol=1e-13)[0]
    np.testing.assert_allclose(found, f.ravel(), atol=1e-9)
    matrix = filters.scipy_matrix(
        filters.filter_matrix(jnp.asarray(kernel), shape=(H, W), border="mirror").matrix
    )
    assert matrix.nnz < 9 * H * W  # padding is added to the pixels it copies
    np.testing.assert_allclose(matrix @ f[..., 0].ravel(), np.asarray(h(f))[..., 0].ravel())


# ------------------------------------------------ bad input


def test_bad_input_is_named():
    stack = jnp.asarray(STACK)
    with pytest.raises(ValueError, match=r"\(kh, kw, 7, 6\)"):
        filters.correlate_per_pixel(PLANE, stack[:, :, :-1])
    with pytest.raises(ValueError, match='"constant" needs a fill'):
        filters.correlate_per_pixel(PLANE, stack, border="constant")
    with pytest.raises(ValueError, match="members, kh, kw"):
        filters.correlate_bank(PLANE, jnp.ones((3, 3)), jnp.ones((H, W)))
    with pytest.raises(ValueError, match=r"\(7, 6\)"):
        filters.radial_blur(PLANE, jnp.ones((2, 2)), radius=1)
    with pytest.raises(ValueError, match=r"position must be \(7, 6\)"):
        filters.correlate_bank(PLANE, jnp.ones((2, 3, 3)), jnp.ones((H, 1)))
    with pytest.raises(ValueError, match=r"sigma must be \(7, 6\)"):
        filters.gaussian_varying(PLANE, jnp.ones((W, H)), sigmas=(1.0, 2.0))
    for call in (
        partial(filters.correlate_per_pixel, PLANE, stack),
        partial(filters.per_pixel_matrix, stack),
        partial(filters.filter_matrix, KERNEL, shape=(H, W)),
        partial(filters.correlate_low_rank, PLANE, filters.low_rank(KERNEL, rank=1)),
    ):
        for anchor in ((4, 0), (0, -1), (1,)):
            with pytest.raises(ValueError, match="anchor must lie in the kernel"):
                call(anchor=anchor)
    with pytest.raises(ValueError, match="needs a fill"):
        filters.per_pixel_matrix(stack, border="constant")
    with pytest.raises(ValueError, match="increasing"):
        filters.gaussian_varying(PLANE, jnp.ones((H, W)), sigmas=(1.0, 1.0))
    with pytest.raises(ValueError, match="low < high"):
        filters.blur_sigmas(2.0, 1.0, members=3)
    with pytest.raises(ValueError, match="border must be"):
        filters.filter_matrix(jnp.ones((3, 3)), shape=(H, W), border="edge")
