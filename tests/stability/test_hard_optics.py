"""Optics where naive formulas fail: z_o at f, inside it, at 0 and at infinity; touching circles;
thin polygons; zeros of the Airy pattern; closed apertures; the fold of a barrel distortion.

Values are compared with 50-digit results for the same floating-point inputs, in units of the last
place where the problem is well conditioned, otherwise with its conditioning written out. Gradients
are finite everywhere, in both precisions.
"""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from oracles import exact
from precisions import assert_finite, both_precisions

from jaxvision import as_dtype, optics
from jaxvision import scene as s

EYE = np.eye(3)


def each(function, *columns):
    """Return (values, gradients by each argument) of a function of scalars over rows of
    arguments."""
    count = tuple(range(len(columns)))
    return jax.jit(jax.vmap(jax.value_and_grad(function, argnums=count)))(*columns)


# ---------------------------------------------------------------- the lens law


@both_precisions
def test_lens_law_at_the_focal_length_at_zero_and_at_infinity(dtype):
    f, inf = jnp.asarray(0.05, dtype), jnp.asarray(jnp.inf, dtype)
    z = jnp.stack([f, jnp.zeros((), dtype), inf])
    fs = jnp.full(3, f)
    image, slopes = each(optics.image_distance, z, fs)
    assert_finite((image, slopes))
    assert image[0] > 1e6
    np.testing.assert_array_equal(image[1:], [0, f])
    np.testing.assert_array_equal(slopes[0][2], 0)
    np.testing.assert_allclose(slopes[1][2], 1, rtol=1e-6)
    vergence, slopes = each(optics.image_vergence, z, fs)
    assert_finite((vergence, slopes))
    assert vergence[0] == 0
    np.testing.assert_allclose(vergence[2], 1 / f, rtol=1e-6)
    size, slopes = each(optics.magnification, z, fs)
    assert_finite((size, slopes))
    np.testing.assert_array_equal(size[1:], [1, 0])


@both_precisions
def test_blur_and_its_gradients_against_fifty_digits(dtype):
    """c = d z_i |1 / z_o - 1 / z_f| keeps all digits, also just beside the focus."""
    beside = jnp.nextafter(jnp.asarray(2.0, dtype), jnp.asarray(3.0, dtype))
    rows = jnp.asarray(
        [
            [1.9, 2, 0.05, 2],
            [1e-3, 2, 0.05, 2],
            [1e9, 2, 0.05, 8],
            [3, 0.0501, 0.05, 2],
            [7, 1e20, 0.05, 2],
        ],
        dtype,
    )
    rows = jnp.concatenate([rows, jnp.stack([beside, *rows[0, 1:]])[None]])
    blur, slopes = each(optics.circle_of_confusion, *rows.T)
    assert_finite((blur, slopes))
    for got, row in zip(blur, rows, strict=True):
        z, focus, f, n = (exact.number(v) for v in row)
        expected = f / n * abs(focus * f / (focus - f)) * abs(1 / z - 1 / focus)
        assert exact.ulps(got, expected) <= 8, row
    inf = jnp.inf
    edges = jnp.asarray(
        [[2, 2, 0.05, 2], [inf, 2, 0.05, 2], [2, inf, 0.05, 2], [inf, inf, 0.05, 2],
         [1, 0.05, 0.05, 2], [1, 2, 0.05, inf], [0, 2, 0.05, 2]], dtype,
    )  # fmt: skip
    blur, slopes = each(optics.circle_of_confusion, *edges.T)
    assert_finite((blur, slopes))
    np.testing.assert_array_equal(blur[jnp.asarray([0, 3, 5])], 0)
    np.testing.assert_array_equal(slopes[0][0], 0)


@both_precisions
def test_depth_of_field_at_its_limits(dtype):
    """The limits are exact for focus at infinity or at the focal length, no blur allowed, and a
    closed aperture."""
    inf = jnp.inf
    rows = jnp.asarray(
        [
            [inf, 0.05, 8, 3e-5],
            [0.05, 0.05, 8, 3e-5],
            [2, 0.05, 8, 0],
            [inf, 0.05, 8, 0],
            [20, 0.05, 8, 3e-5],
        ],
        dtype,
    )
    for end in (0, 1):
        value, slopes = each(lambda *row, end=end: optics.depth_of_field(*row)[end], *rows.T)
        assert not jnp.isnan(value).any()
        assert_finite(slopes)
    far = optics.depth_of_field(*rows.T)[1]
    np.testing.assert_array_equal(jnp.isinf(far), [True, False, False, True, True])
    nothing, slopes = each(optics.hyperfocal_distance, *rows[2:3, 1:].T)
    assert jnp.isinf(nothing).all()
    assert_finite(slopes)


# ---------------------------------------------------------------- openings


def exact_overlap(d, r1, r2):
    d, r1, r2 = (exact.number(v) for v in (d, r1, r2))
    if d >= r1 + r2:
        return mp.mpf(0)
    if d <= abs(r1 - r2):
        return mp.pi * min(r1, r2) ** 2
    first = mp.acos((d * d + r1 * r1 - r2 * r2) / (2 * d * r1))
    second = mp.acos((d * d + r2 * r2 - r1 * r1) / (2 * d * r2))
    return sum(r * r * (t - mp.sin(2 * t) / 2) for r, t in ((r1, first), (r2, second)))


@both_precisions
def test_overlap_of_touching_discs(dtype):
    """The overlap of discs just apart, just touching, just inside and equal agrees with 50
    digits."""
    one = jnp.asarray(1.0, dtype)
    tiny = float(jnp.finfo(dtype).eps)
    rows = jnp.asarray(
        [[2 - 8 * tiny, 1, 1], [1.999, 1, 1], [1, 1, 1], [1e-3, 1, 1], [0.7, 1.3, 0.6000001],
         [1.2, 0.2, 1.1], [1e-6, 2e-6, 1.5e-6], [1e4, 7e3, 6e3]], dtype,
    )  # fmt: skip
    got, slopes = each(optics.overlap_of_discs, *rows.T)
    assert_finite((got, slopes))
    for value, row in zip(got, rows, strict=True):
        expected = exact_overlap(*row)
        d, r1, r2 = (float(v) for v in row)
        gap = min(r1 + r2 - d, d - abs(r1 - r2) if d > abs(r1 - r2) else np.inf)
        allowed = 16 + 3 * (r1 + r2) / gap
        assert exact.ulps(value, expected) <= allowed, row
    edges = jnp.asarray(
        [[0, 1, 1], [0, 1, 0.5], [2, 1, 1], [3, 1, 1], [0.5, 1, 0.5], [0, 0, 0], [1, 0, 2]], dtype
    )
    got, slopes = each(optics.overlap_of_discs, *edges.T)
    assert_finite((got, slopes))
    np.testing.assert_allclose(got, np.pi * np.array([1, 0.25, 0, 0, 0.25, 0, 0]), rtol=1e-6)
    np.testing.assert_allclose(slopes[0][0], -2 * one, rtol=1e-6)  # it loses the whole chord


@both_precisions
@pytest.mark.parametrize("small", [1e-2, 1e-5, 1e-10])
def test_overlap_of_a_small_disc_on_the_rim_of_a_large_one(small, dtype):
    """The overlap of a disc on the rim of a large one keeps its digits at distances from the rim
    given in small radii."""
    one, radius = jnp.asarray(1.0, dtype), jnp.asarray(small, dtype)
    for part in (-2, -0.9, -0.5, 0, 0.3, 0.8):
        distance = one + jnp.asarray(part, dtype) * radius
        expected = exact_overlap(distance, one, radius)
        if expected > 0:
            for pair in ((one, radius), (radius, one)):
                got = optics.overlap_of_discs(distance, *pair)
                assert exact.ulps(got, expected) <= 16, part


@both_precisions
def test_polygon_overlap_at_degenerate_places(dtype):
    """Areas are exact for corners on the circle, a side through the centre, a disc or polygon
    without area."""
    x, y = (jnp.asarray(v, dtype) for v in ([1.0, 0, -1, 0], [0.0, 1, 0, -1]))

    def area(right, down, radius, size):
        return optics.overlap_of_disc_and_polygon(right, down, radius, size * x, size * y)

    rows = jnp.asarray(
        [
            [0, 0, 1, 1],
            [0.5, 0.5, 0.3, 1],
            [1, 0, 0.2, 1],
            [0, 0, 0, 1],
            [0, 0, 1, 0],
            [9, 0, 1, 1],
        ],
        dtype,
    )
    got, slopes = each(area, *rows.T)
    assert_finite((got, slopes))
    expected = [2, np.pi * 0.09 / 2, np.pi * 0.04 / 4, 0, 0, 0]
    np.testing.assert_allclose(got, expected, atol=16 * float(jnp.finfo(dtype).eps))


@both_precisions
def test_airy_amplitude_against_fifty_digits(dtype):
    """The amplitude is right at the centre, where the two expansions meet, at the zeros, and far
    out."""
    from jaxvision.optics._bessel import jinc

    x = jnp.asarray([0, 1e-4, 1, 3.8317059702075125, 7.999, 8.001, 13.3, 97.1, 1.2e3], dtype)
    got, slopes = each(jinc, x * x)
    assert_finite((got, slopes))
    eps = float(jnp.finfo(dtype).eps)
    for value, square in zip(got, x * x, strict=True):
        r = mp.sqrt(exact.number(square))
        expected = 2 * mp.besselj(1, r) / r if r else mp.mpf(1)
        envelope = min(1, 1.6 * float(max(r, 1)) ** -1.5)
        assert abs(exact.number(value) - expected) <= eps * envelope * (4 + float(r)), float(r)
    np.testing.assert_allclose(slopes[0][0], -1 / 8, rtol=8 * eps)


@pytest.mark.sweep
@both_precisions
@pytest.mark.parametrize(
    "aperture",
    [
        s.CircularAperture(),
        s.AnnularAperture(0.3),
        s.PolygonalAperture(6),
        s.RectangularAperture(1, 0.4),
    ],
    ids=["circle", "ring", "hexagon", "slit"],
)
def test_aperture_samples_at_the_corners_of_the_unit_square(dtype, aperture):
    aperture = as_dtype(aperture, dtype)
    u = jnp.asarray([[0, 0], [1, 1], [0.5, 0.5], [0, 1], [1, 0], [1 / 3, 0]], dtype)

    def point(v):
        return jnp.stack(optics.aperture_point(aperture, v))

    points, slopes = jax.jit(jax.vmap(lambda v: (point(v), jax.jacrev(point)(v))))(u)
    assert points.dtype == dtype
    assert_finite((points, slopes))
    assert (jnp.hypot(*points.T) <= 1.08).all()  # a slit of full width has its corners outside

    def middle(radius):
        return optics.aperture_kernel(aperture, radius, size=5)[2, 1]

    values, slopes = each(middle, jnp.asarray([0, 1e-9, 0.5, 1.5, 2.5, -1.5, 1e3], dtype))
    assert values.dtype == dtype
    assert_finite((values, slopes))


# ---------------------------------------------------------------- views


def hard_views(dtype):
    """Return views with a closed aperture, focused at infinity, at the focal length and inside it,
    a rim at the focus, a fold."""
    common = {"resolution": (3, 5), "f_number": 2.0}
    lens = s.ThinLens([0, 0, 0], EYE, 0.05, 0.01, focus_distance=2.0, **common)
    rim = s.ThinLens([0, 0, 0], EYE, 0.05, 0.01, focus_distance=0.2, rim=s.Rim(0.2, 0.03), **common)
    folded = s.ThinLens(
        [0, 0, 0], EYE, 0.05, 0.05, distortion=s.Distortion([-1 / 3], [0, 0]), **common
    )
    with_numbers = [
        jax.tree.map(lambda x: x, lens),
        s.ThinLens([0, 0, 0], EYE, 0.05, 0.01, resolution=(3, 5), f_number=np.inf),
        s.ThinLens([0, 0, 0], EYE, 0.05, 0.01, focus_distance=np.inf, **common),
        rim,
        folded,
    ]
    views = [as_dtype(view, dtype) for view in with_numbers]
    # a focus that no sensor distance serves raises an error if known; traced, it has defined
    # results
    at = [
        jax.tree.unflatten(
            jax.tree.structure(views[0]),
            [jnp.asarray(z, dtype) if leaf is views[0].focus_distance else leaf
             for leaf in jax.tree.leaves(views[0])],
        )
        for z in (0.05, 0.02)
    ]  # fmt: skip
    return views + at


@pytest.mark.slow
@both_precisions
def test_rays_irradiance_and_blur_of_degenerate_views(dtype):
    u = jnp.asarray([0.5, 0.5], dtype)
    depth = jnp.asarray([0, 0.05, 2, jnp.inf], dtype)
    row, column = jnp.asarray(1.0, dtype), jnp.asarray(4.0, dtype)

    def everything(view, u, depth):
        ray = optics.view_ray(view, row, column, u=u)
        light = optics.pixel_irradiance(view, jnp.ones(1, dtype), row, column)
        blur = optics.defocus_radius(view, depth)
        return ray, light, optics.clear_fraction(view, row, column), blur

    def total(*arguments):
        return sum(leaf.sum() for leaf in jax.tree.leaves(everything(*arguments)))

    every, slopes = jax.jit(everything), jax.jit(jax.grad(total, argnums=(0, 1, 2)))
    for view in hard_views(dtype):
        result = every(view, u, depth[1:])
        assert all(leaf.dtype == dtype for leaf in jax.tree.leaves(result))
        assert_finite(result)
        assert_finite(slopes(view, u, depth[2:]))
        assert 0 <= result[2] <= 1 + 1e-6


@pytest.mark.slow
@both_precisions
def test_diffraction_of_degenerate_views(dtype):
    """Through a closed aperture the picture is black, and with a sensor at or beyond infinity it is
    finite, also without light."""

    def spread(view, diffraction, irradiance):
        return optics.diffracted(view, diffraction, irradiance)

    def total(*arguments):
        return spread(*arguments)[1, 2].sum()

    every, slopes = jax.jit(spread), jax.jit(jax.grad(total, argnums=(0, 1, 2)))
    diffraction = as_dtype(s.Diffraction([4e-7, 7e-7], size=3), dtype)
    light = jnp.zeros((3, 5, 2), dtype).at[1, 2].set(1e3)
    views = [view for view in hard_views(dtype) if view.rim is None and view.distortion is None]
    for view in views:
        result = every(view, diffraction, light)
        assert result.dtype == dtype
        assert_finite((result, slopes(view, diffraction, light)))
        assert (result >= 0).all()
        eps = float(jnp.finfo(dtype).eps)
        np.testing.assert_allclose(result.sum((0, 1)), 1e3, rtol=20 * eps)
        assert (every(view, diffraction, 0 * light) == 0).all()


@pytest.mark.slow
@both_precisions
def test_undistortion_inverts_distortion_near_the_fold(dtype):
    """The round trip is right up to a tenth from the fold of r (1 - r^2 / 3) at 1; beyond it,
    undistortion is finite with gradient 0."""
    lens = as_dtype(s.Distortion([-1 / 3]), dtype)
    x = jnp.asarray([0, 1e-12, 1e-3, 0.3, 0.6, 0.9], dtype)
    there = x * (1 - x * x / 3)
    back = jax.vmap(lambda t: optics.undistort(lens, t, jnp.zeros((), dtype))[0])(there)
    eps = float(jnp.finfo(dtype).eps)
    np.testing.assert_allclose(back, x, rtol=16 * eps / 0.19)
    beyond = jnp.asarray([0.667, 0.7, 5, 1e6], dtype)
    values, slopes = each(lambda t: optics.undistort(lens, t, t / 2)[0], beyond)
    assert_finite((values, slopes))
    np.testing.assert_array_equal(slopes[0], 0)


@both_precisions
def test_nan_and_huge_discs(dtype):
    """A NaN gives a NaN area and contrast; a disc of any size covers the whole square."""
    nan, one = np.array(np.nan, dtype), np.ones((), dtype)
    discs, contrast = jax.jit(optics.overlap_of_discs), jax.jit(optics.diffraction_mtf)
    for arguments in ((nan, one, one), (one, nan, one), (one, one, nan)):
        assert np.isnan(discs(*arguments))
        assert np.isnan(contrast(*arguments))
    x, y = jnp.asarray([[1, -1, -1, 1], [1, 1, -1, -1]], dtype)
    zero, huge = jnp.zeros((), dtype), jnp.asarray(1e30, dtype)
    area = jax.jit(jax.value_and_grad(optics.overlap_of_disc_and_polygon, argnums=2))
    assert area(zero, zero, huge, x, y) == (4, 0)
