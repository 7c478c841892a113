"""Tests named filters against SciPy, OpenCV and closed forms, and their laws."""

from functools import partial
from itertools import pairwise

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from scipy import ndimage

from jaxvision import filters
from jaxvision.filters.kernels import SMOOTHING

RNG = np.random.default_rng(12)
PLANE = RNG.normal(size=(12, 11))
YY, XX = np.mgrid[:31, :31] - 15.0


def value(x):
    return jnp.asarray(float(x))


# ------------------------------------------------ averages


@pytest.mark.parametrize("size", [1, 3, 4, 25])
def test_box_is_scipys(size):
    expected = ndimage.uniform_filter(PLANE, size, mode="reflect")
    np.testing.assert_allclose(filters.box(PLANE, size=size), expected, atol=1e-13)


def test_binomial_is_repeated_pairs():
    np.testing.assert_array_equal(filters.binomial_kernel(5), np.array([1, 4, 6, 4, 1]) / 16)
    pairs = np.ones(1)
    for _ in range(8):
        pairs = np.convolve(pairs, [0.5, 0.5])
    np.testing.assert_allclose(filters.binomial_kernel(9), pairs, rtol=1e-15)
    expected = ndimage.correlate(PLANE, np.outer(pairs, pairs), mode="reflect")
    np.testing.assert_allclose(filters.binomial(PLANE, size=9), expected, atol=1e-13)


def test_binomial_of_any_size():
    """2 ** 1099 exceeds a float, but the weights sum to 1 and have variance (size - 1) / 4."""
    taps = filters.binomial_kernel(1100)
    x = np.arange(1100) - 1099 / 2
    np.testing.assert_allclose((taps.sum(), taps @ x**2), (1, 1099 / 4), rtol=1e-12)


@pytest.mark.parametrize("order", [(0, 0), (1, 0), (0, 1), (2, 1), (0, 3)])
def test_gaussian_is_scipys(order):
    expected = ndimage.gaussian_filter(PLANE, 1.4, order=order, mode="reflect")
    np.testing.assert_allclose(filters.gaussian(PLANE, 1.4, order=order), expected, atol=1e-12)


def test_gaussian_of_two_widths_and_integers():
    codes = (255 * RNG.uniform(size=(12, 11, 2))).astype(np.uint8)
    expected = ndimage.gaussian_filter(codes.astype(float), (0.7, 1.9, 0), radius=(8, 8, 0))
    got = filters.gaussian(codes, jnp.asarray([0.7, 1.9]), size=17)
    np.testing.assert_allclose(got, expected, atol=1e-10)


@pytest.mark.slow
def test_the_error_falls_with_the_truncation():
    """Each further sigma reduces the error by at least a factor of 5, to below 1e-8 at six."""
    truth = filters.gaussian(PLANE, 1.5, truncate=9.0, border="wrap")
    errors = [
        np.abs(filters.gaussian(PLANE, 1.5, truncate=t, border="wrap") - truth).max()
        for t in (2.0, 3.0, 4.0, 6.0)
    ]
    assert all(b < a / 5 for a, b in pairwise(errors))
    assert errors[-1] < 1e-8


@pytest.mark.sweep
@pytest.mark.parametrize("sigma", [0.05, 0.3, 0.7, 1.0, 1.01, 3.0, 40.0])
@pytest.mark.parametrize("order", [0, 1, 2])
@mp.workdps(40)
def test_integrated_kernel_by_quadrature_of_mpmath(sigma, order):
    size = 7
    got = filters.gaussian_kernel(value(sigma), size=size, order=order, sampling="integrated")

    def density(x):
        t = x / mp.mpf(sigma)
        hermite = (1, t, t * t - 1)[order]
        return hermite / mp.mpf(sigma) ** order * mp.exp(-t * t / 2)

    def plain(x):
        return mp.exp(-((x / mp.mpf(sigma)) ** 2) / 2)

    def integral(f, i):
        return mp.quad(f, mp.linspace(i - mp.mpf("0.5"), i + mp.mpf("0.5"), 9))

    whole = sum(integral(plain, i) for i in range(-3, 4))
    expected = np.array([float(integral(density, i) / whole) for i in range(-3, 4)])
    np.testing.assert_allclose(got, expected, rtol=2e-13, atol=1e-13 * np.abs(expected).max())


@pytest.mark.slow
def test_variance_of_a_narrow_gaussian():
    """A sampled Gaussian is too narrow, and an integrated one has the pixel's variance of 1/12 in
    addition."""
    x = np.arange(-4, 5.0)

    def excess(sigma, sampling):
        kernel = filters.gaussian_kernel(value(sigma), size=9, sampling=sampling)
        return float(kernel @ x**2) - sigma**2

    np.testing.assert_allclose(excess(1.0, "integrated"), 1 / 12, atol=2e-4)
    np.testing.assert_allclose(excess(0.5, "integrated"), 1 / 12, atol=0.01)
    np.testing.assert_allclose(excess(0.5, "sampled"), -0.035, atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sigma", "sampled", "integrated"), [(0.3, 0.085, 0.663), (0.5, 0.860, 0.986), (0.7, 0.998, 1)]
)
def test_errors_of_narrow_derivatives(sigma, sampled, integrated):
    """The slope of a unit ramp is the documented one. Differences of the blurred picture are
    exact."""
    for sampling, expected in (("sampled", sampled), ("integrated", integrated)):
        options = {"size": 9, "order": (0, 1), "sampling": sampling}
        slope = filters.gaussian(XX, value(sigma), **options)
        np.testing.assert_allclose(slope[15, 15], expected, atol=6e-4)
        flat = filters.laplacian_of_gaussian(
            np.ones((9, 9)), value(sigma), size=15, sampling=sampling
        )
        if sampling == "integrated":
            np.testing.assert_allclose(flat, 0, atol=1e-12)
        elif sigma == 0.5:
            np.testing.assert_allclose(flat, -1.12, atol=1e-3)
    blurred = filters.gaussian(XX, value(sigma), size=9)
    np.testing.assert_allclose(filters.derivative(blurred).x[15, 15], 1, atol=1e-12)


# ------------------------------------------------ derivatives


@pytest.mark.parametrize("scheme", SMOOTHING)
def test_slopes_of_a_parabola_are_exact(scheme):
    f = 3 + 2 * XX - 0.7 * YY + 0.1 * XX**2 + 0.3 * YY**2 + 0.05 * XX * YY
    slope = filters.derivative(f, scheme=scheme)
    inner = (slice(1, -1), slice(1, -1))
    np.testing.assert_allclose(slope.x[inner], (2 + 0.2 * XX + 0.05 * YY)[inner], atol=1e-12)
    np.testing.assert_allclose(slope.y[inner], (-0.7 + 0.6 * YY + 0.05 * XX)[inner], atol=1e-12)


def test_sobel_and_scharr_are_opencvs():
    import cv2

    for scheme, function, scale in (("sobel", cv2.Sobel, 8), ("scharr", cv2.Scharr, 32)):
        slope = filters.derivative(PLANE, scheme=scheme, border="clamp")
        for got, which in ((slope.x, (1, 0)), (slope.y, (0, 1))):
            theirs = function(PLANE, cv2.CV_64F, *which, borderType=cv2.BORDER_REPLICATE)
            np.testing.assert_allclose(got, theirs / scale, atol=1e-13)


def test_laplacians():
    expected = ndimage.laplace(PLANE, mode="reflect")
    np.testing.assert_allclose(filters.laplacian(PLANE), expected, atol=1e-13)
    f = XX**2 + 3 * YY**2
    np.testing.assert_allclose(filters.laplacian(f, isotropic=True)[1:-1, 1:-1], 8, atol=1e-11)
    expected = ndimage.gaussian_laplace(PLANE, 1.3, mode="nearest")
    got = filters.laplacian_of_gaussian(PLANE, 1.3, border="clamp")
    np.testing.assert_allclose(got, expected, atol=1e-12)


def test_isotropic_laplacian_is_isotropic():
    """For waves of one length in two directions, the five-point stencil gives different values."""

    def spread(isotropic):
        k, d = 0.8, 0.8 / np.sqrt(2)
        waves = np.cos(k * XX), np.cos(d * XX + d * YY)
        return abs(
            float(filters.laplacian(waves[0], isotropic=isotropic)[15, 15])
            - float(filters.laplacian(waves[1], isotropic=isotropic)[15, 15])
        )

    assert spread(True) < spread(False) / 10


def test_unsharp_mask():
    got = filters.unsharp_mask(PLANE, 1.5, 0.8)
    expected = PLANE + 0.8 * (PLANE - ndimage.gaussian_filter(PLANE, 1.5, mode="reflect"))
    np.testing.assert_allclose(got, expected, atol=1e-12)


# ------------------------------------------------ steerable


def test_first_order_steers_a_ramp():
    for angle in (0.0, 0.6, np.pi / 2, 2.5, -1.0):
        f = np.cos(0.6) * XX - np.sin(0.6) * YY  # rises towards 0.6, up is against the rows
        slope = filters.directional_derivative(f, 1.2, value(angle), truncate=8.0)
        np.testing.assert_allclose(slope[15, 15], np.cos(angle - 0.6), atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.3, -0.7, 2.9])
def test_the_steered_quadrature_pair_is_the_rotated_filter(angle):
    """G2 and H2, sampled on rotated axes, equal the sum of the basis."""
    width = 2.0
    along = (np.cos(angle) * XX - np.sin(angle) * YY) / width
    bell = np.exp(-(XX**2 + YY**2) / width**2) / width
    even = 0.9213 * (2 * along**2 - 1) * bell
    odd = 0.9780 * (along**3 - 2.254 * along) * bell
    image = RNG.normal(size=(31, 31))
    basis = filters.quadrature_basis(image, value(width), size=31)
    got = filters.steer(basis, value(angle))
    # the paper's H2 is a fit to the Hilbert transform, with 1 % less energy
    np.testing.assert_allclose([(even**2).sum(), (odd**2).sum()], [1, 0.9905], atol=1e-4)
    for seen, kernel in zip(got, (even, odd), strict=True):
        expected = ndimage.correlate(image, kernel, mode="reflect")
        np.testing.assert_allclose(seen, expected, atol=2e-3 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("width", "angle", "even", "odd"),
    [(1.0, 0.0, 1.41, 0.53), (1.0, np.pi / 4, 1.18, 0.81), (2.0, 0.3, 1.0, 0.9905)],
)
def test_energy_of_the_pair_by_its_width(width, angle, even, odd):
    """The sum of squares of the impulse response is 1 and 0.99 only for widths of 2 and more."""
    impulse = (XX == 0) & (YY == 0)
    pair = filters.steer(
        filters.quadrature_basis(impulse.astype(float), width, size=21), value(angle)
    )
    got = [float((response**2).sum()) for response in pair]
    np.testing.assert_allclose(got, (even, odd), atol=5e-3 if width < 2 else 1e-4)


def test_energy_depends_on_the_direction_of_a_wave_and_not_its_phase():
    # The transforms of G2 and H2 are equal at 2.65 / width, where 0.9213 u / 2 = 0.978 (0.377 + u^2
    # / 8). An octave below they differ by 7 %, within the error of the paper's fit.
    frequency, angle = 2.65 / 3, 0.5
    energies, angles = [], []
    for phase in np.linspace(0, np.pi, 7):
        wave = np.cos(frequency * (np.cos(angle) * XX - np.sin(angle) * YY) + phase)
        basis = filters.quadrature_basis(wave, value(3.0), size=21)
        energies.append(float(filters.oriented_energy(basis, value(angle))[15, 15]))
        found, strength = filters.dominant_orientation(basis)
        angles.append(float(found[15, 15]))
        assert strength[15, 15] > 0
    assert np.ptp(energies) < 0.02 * np.mean(energies)
    np.testing.assert_allclose(angles, angle, atol=0.01)


def test_orientation_is_the_lowest_harmonic_of_the_energy():
    responses = RNG.normal(size=(7, 5, 4))
    basis = filters.QuadratureBasis(tuple(responses[:3]), tuple(responses[3:]))
    angles = np.arange(7) * np.pi / 7  # enough for a polynomial of degree 6
    energy = np.stack([filters.oriented_energy(basis, value(angle)) for angle in angles])
    harmonic = 2 / 7 * np.tensordot(np.exp(2j * angles), energy, 1)
    angle, strength = filters.dominant_orientation(basis)
    np.testing.assert_allclose(
        np.asarray(strength) * np.exp(2j * np.asarray(angle)), harmonic, atol=1e-13
    )


def test_orientation_if_one_response_is_zero():
    """By table XI the square of the middle response of G2 does not contribute to C_2."""
    none, large, small = (jnp.asarray(x, jnp.float32) for x in (0, 1, 0.01))
    basis = filters.QuadratureBasis((none, large, none), (none, none, none, small))
    angle, strength = filters.dominant_orientation(basis)
    np.testing.assert_allclose(angle, np.pi / 2, rtol=1e-6)
    np.testing.assert_allclose(strength, 0.46875e-4, rtol=1e-6)


@pytest.mark.slow
def test_orientation_without_contrast():
    basis = filters.quadrature_basis(np.zeros((9, 9, 2)), value(1.0), size=7)
    angle, strength = filters.dominant_orientation(basis)
    assert (angle == 0).all()
    assert (strength == 0).all()
    gradient = jax.grad(
        lambda f: filters.dominant_orientation(filters.quadrature_basis(f, value(1.0), size=7))[
            1
        ].sum()
    )(jnp.zeros((9, 9)))
    assert jnp.isfinite(gradient).all()


def test_an_angle_for_each_pixel():
    image = RNG.normal(size=(2, 6, 5, 3))
    angles = RNG.uniform(-2, 2, size=(6, 5))
    basis = filters.quadrature_basis(image, value(1.0), size=7)
    whole = filters.oriented_energy(basis, jnp.asarray(angles))
    for y, x in ((0, 0), (5, 4), (2, 3)):
        one = filters.oriented_energy(basis, value(angles[y, x]))
        np.testing.assert_allclose(whole[:, y, x], one[:, y, x], atol=1e-12)


# ------------------------------------------------ transparency


@pytest.mark.slow
def test_hidden_colour_is_never_visible():
    """A red disc is on hidden green. Filtering without premultiplication would mix them."""
    disk = (XX**2 + YY**2 < 50).astype(float)
    light = np.stack([disk, 1 - disk], axis=-1)
    layer = jnp.asarray(np.concatenate([light, disk[..., None]], axis=-1))

    def blur(picture):
        return filters.gaussian(picture, 2.0, border="zero")

    got = np.asarray(filters.blur_straight(layer, blur=blur))
    seen = got[..., 2] > 1e-6
    np.testing.assert_allclose(got[seen][:, 0], 1, atol=1e-9)
    np.testing.assert_allclose(got[seen][:, 1], 0, atol=1e-9)
    np.testing.assert_allclose(got[..., 2], blur(jnp.asarray(disk)), atol=1e-14)
    assert np.asarray(blur(layer))[..., 1].max() > 0.5  # without premultiplication
    gradient = jax.grad(lambda f: filters.blur_straight(f, blur=blur).sum())(layer)
    assert jnp.isfinite(gradient).all()


# ------------------------------------------------ bad input


def test_bad_input_is_named():
    with pytest.raises(ValueError, match="size=gaussian_size"):
        jax.jit(lambda s: filters.gaussian(PLANE, s))(1.0)
    with pytest.raises(ValueError, match="sampled, integrated"):
        filters.gaussian(PLANE, 1.0, sampling="averaged")
    with pytest.raises(ValueError, match=">= 0 pixels"):
        filters.gaussian_size(-1.0)
    with pytest.raises(ValueError, match=">= 0 pixels"):
        filters.gaussian(PLANE, np.nan)
    with pytest.raises(ValueError, match="at least one entry"):
        filters.binomial(PLANE, size=0)
    for size in (0, (3, 3, 3), (3, -1)):
        with pytest.raises(ValueError, match=r"n or \(down, across\)"):
            filters.box(PLANE, size=size)
    with pytest.raises(ValueError, match="sobel"):
        filters.derivative(PLANE, scheme="roberts")
    with pytest.raises(ValueError, match="odd"):
        filters.quadrature_basis(PLANE, value(1.0), size=6)
    with pytest.raises(ValueError, match=r"\[1, 2\]"):
        filters.low_rank(jnp.ones((2, 3)), rank=3)
    with pytest.raises(ValueError, match="at least 1"):
        filters.gaussian_kernel(value(1.0), size=0)


@pytest.mark.parametrize(
    "call",
    [
        filters.derivative,
        filters.laplacian,
        partial(filters.laplacian_of_gaussian, sigma=1.0),
        partial(filters.gaussian, sigma=1.0, order=(1, 0)),
        partial(filters.directional_derivative, sigma=1.0, angle=value(0.0)),
        partial(filters.quadrature_basis, width=1.0, size=5),
    ],
)
def test_weights_with_a_sum_of_zero_are_not_normalised(call):
    with pytest.raises(ValueError, match="sum of the weights, which is 0"):
        call(PLANE, border="normalised_zero")


def test_numbers_of_python_and_numpy():
    np.testing.assert_array_equal(
        filters.box(PLANE, size=np.int64(3)), filters.box(PLANE, size=[3, 3])
    )
    whole = filters.impulse_response(2.0, operator=lambda f: f, shape=(3, 3))
    np.testing.assert_array_equal(whole, 2 * (np.arange(9) == 4).reshape(3, 3))
