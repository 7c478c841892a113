"""Tests apertures: their points, areas, images and overlaps by brute force, and diffraction by
transforms and published functions."""

from functools import partial
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, special

from jaxvision import as_array, optics
from jaxvision import scene as s

APERTURES = {
    "circle": s.CircularAperture(),
    "ring": s.AnnularAperture(0.4),
    "pentagon": s.PolygonalAperture(5, angle=0.2),
    "square": s.PolygonalAperture(4, angle=np.pi / 4),
    "slit": s.RectangularAperture(0.8, 0.3),
}
each_aperture = pytest.mark.parametrize("aperture", APERTURES.values(), ids=APERTURES)


def a(x):
    return jnp.asarray(x, float)


def inside(aperture, x, y):
    """Return whether points, relative to the radius, are in the aperture, by its definition."""
    match aperture:
        case s.CircularAperture():
            return x * x + y * y <= 1
        case s.AnnularAperture():
            return (x * x + y * y <= 1) & (x * x + y * y >= 0.4**2)
        case s.RectangularAperture():
            return (abs(x) <= 0.8) & (abs(y) <= 0.3)
        case s.PolygonalAperture():
            n = aperture.blades
            normals = float(aperture.angle) + (2 * np.arange(n) + 1) * np.pi / n
            reach = np.cos(np.pi / n)
            return np.all([x * np.cos(t) + y * np.sin(t) <= reach + 1e-12 for t in normals], axis=0)


def squares(n, half):
    """Return (x, y) of the centres of the n x n cells of a square."""
    edge = ((np.arange(n) + 0.5) / n * 2 - 1) * half
    return np.meshgrid(edge, edge)  # x to the right, y down


# ---------------------------------------------------------------- apertures


@pytest.mark.sweep
@each_aperture
def test_points_fill_the_aperture_uniformly(aperture):
    """All points are inside, with the moments of the area. A nonuniform map has other moments."""
    n = 100  # a multiple of the number of blades
    u = jnp.asarray(np.stack(squares(n, 0.5), -1).reshape(-1, 2) + 0.5)
    x, y = (np.asarray(v) for v in jax.vmap(lambda v: optics.aperture_point(aperture, v))(u))
    assert inside(aperture, x, y).all()
    gx, gy = squares(2000, 1)
    keep = inside(aperture, gx, gy)
    gx, gy = gx[keep], gy[keep]
    for power in [(1, 0), (0, 1), (2, 0), (0, 2), (1, 1), (3, 0), (1, 2), (4, 0), (2, 2)]:
        got = (x ** power[0] * y ** power[1]).mean()
        np.testing.assert_allclose(
            got, (gx ** power[0] * gy ** power[1]).mean(), atol=6e-4, err_msg=str(power)
        )
    area = optics.aperture_area(aperture, a(3.0))
    np.testing.assert_allclose(area, keep.mean() * 4 * 1.5**2, rtol=2e-3)


kernel_of = jax.jit(partial(optics.aperture_kernel, size=9))


@pytest.mark.sweep
@each_aperture
@pytest.mark.parametrize("radius", [0.7, 3.3, -3.3])
def test_kernel_is_the_covered_share_of_each_pixel(aperture, radius):
    kernel = np.asarray(kernel_of(aperture, a(radius)))
    fine = 150
    x, y = squares(9 * fine, 4.5)
    covered = inside(aperture, x / radius, y / radius).reshape(9, fine, 9, fine).mean((1, 3))
    np.testing.assert_allclose(kernel, covered / covered.sum(), atol=1 / fine / covered.sum())
    np.testing.assert_allclose(kernel.sum(), 1, rtol=1e-14)


@pytest.mark.slow
@each_aperture
@pytest.mark.parametrize("radius", [0.03, 42.0])
def test_kernel_is_accurate_in_float32(aperture, radius):
    """The aperture's image is much smaller than a pixel, or much larger."""
    size = 2 * int(radius) + 3
    wide = np.asarray(optics.aperture_kernel(aperture, a(np.float32(radius)), size=size))
    narrow = jax.tree.map(lambda x: x.astype(jnp.float32), aperture)
    kernel = np.asarray(optics.aperture_kernel(narrow, jnp.float32(radius), size=size), float)
    assert (kernel >= 0).all()
    # the edge has an error of half a ULP of its radius
    whole = 1 / max(1, float(optics.aperture_area(aperture, a(2 * radius))))
    np.testing.assert_allclose(kernel, wide, atol=max(1, 4 * radius) * 2.5e-7 * whole)


@pytest.mark.slow
def test_kernel_without_blur_is_the_pixel_and_even_sizes_are_refused():
    kernel = optics.aperture_kernel(s.CircularAperture(), a(0.0), size=3)
    np.testing.assert_allclose(kernel, [[0, 0, 0], [0, 1, 0], [0, 0, 0]], atol=1e-14)
    with pytest.raises(ValueError, match="size must be an odd number of at least 1, got 4"):
        optics.aperture_kernel(s.CircularAperture(), a(1.0), size=4)


# ---------------------------------------------------------------- overlaps


@pytest.mark.parametrize(
    ("distance", "first", "second"),
    [
        (0.3, 1.0, 0.9),
        (1.0, 1.0, 1.0),
        (1.7, 1.2, 0.6),
        (0.45, 0.5, 1.0),
        (0.1, 1.0, 0.5),
        (2, 1, 1),
    ],
)
def test_overlap_of_discs_against_integration(distance, first, second):
    """Both discs are cut into chords perpendicular to the line between their centres."""

    def chord(x):
        one, other = first**2 - x**2, second**2 - (x - distance) ** 2
        return 2 * np.sqrt(max(min(one, other), 0))

    crossing = (distance**2 + first**2 - second**2) / (2 * distance)
    ends = sorted({-first, first, distance - second, distance + second, crossing})
    parts = [integrate.quad(chord, lo, hi, epsabs=1e-12)[0] for lo, hi in pairwise(ends)]
    got = optics.overlap_of_discs(a(distance), a(first), a(second))
    np.testing.assert_allclose(got, sum(parts), atol=1e-9)


SIDES = 0.5, 3.0
AT = a([1.0, 1.0 + SIDES[0], 1.0 + SIDES[0], 1.0]), a([2.0, 2.0, 2.0 + SIDES[1], 2.0 + SIDES[1]])


@pytest.mark.parametrize(
    ("centre", "radius", "area"),
    [
        ((300.3, -400.7), 600.0, SIDES[0] * SIDES[1]),
        ((-3.0, 9.0), 1.0, 0.0),
        ((1.25, 3.5), 0.1, np.pi * 0.01),
        ((1.0 - 0.6, 3.5), 0.75, 0.75**2 * (np.arccos(0.8) - 0.8 * 0.6)),
    ],
    ids=["all of the polygon", "nothing", "all of the disc", "a segment"],
)
def test_overlap_is_accurate_in_float32(centre, radius, area):
    arguments = [jnp.asarray(x, jnp.float32) for x in (*centre, radius, *AT)]
    got = jax.jit(optics.overlap_of_disc_and_polygon)(*arguments)
    np.testing.assert_allclose(got, area, rtol=2e-6)


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("centre", "radius"),
    [((0.1, -0.2), 0.5), ((0.1, -0.2), 0.9), ((0.3, 0.2), 3.0), ((0.9, 0.7), 0.6), ((3.0, 0), 0.5)],
)
@pytest.mark.parametrize("name", ["pentagon", "slit"])
def test_overlap_of_disc_and_polygon_against_counting(name, centre, radius):
    aperture = APERTURES[name]
    x, y = squares(1500, 1)
    both = inside(aperture, x, y) & ((x - centre[0]) ** 2 + (y - centre[1]) ** 2 < radius**2)
    corners = optics.aperture_corners(aperture, np.dtype(float))
    overlap = jax.jit(optics.overlap_of_disc_and_polygon)
    got = overlap(a(centre[0]), a(centre[1]), a(radius), *corners)
    np.testing.assert_allclose(got, 4 * both.mean(), atol=2e-3)


@jax.jit
def seen_through_rim(view, row, column, u):
    """Return (where rays of a pixel cross the plane of the rim, share of them that passes it)."""
    rays = jax.vmap(lambda v: optics.lens_ray(view, row, column, v))(u)
    along = view.rim.distance / rays.direction.z
    at = as_array(rays.origin) + as_array(rays.direction) * along[:, None]
    return at, optics.clear_fraction(view, row, column)


@pytest.mark.sweep("0.3-pentagon")
@each_aperture
@pytest.mark.parametrize("focus", [0.3, np.inf])
def test_clear_fraction_is_the_share_of_lens_rays_through_the_rim(aperture, focus):
    """The rays of a pixel are traced to the plane of the rim and counted."""
    rim = s.Rim(0.04, 0.024)
    view = s.ThinLens(
        [0, 0, 0], np.eye(3), 0.05, 1e-3, resolution=(31, 41), f_number=2.0,
        focus_distance=focus, aperture=aperture, rim=rim,
    )  # fmt: skip
    u = jnp.asarray(np.stack(squares(160, 0.5), -1).reshape(-1, 2) + 0.5)
    shares = []
    for row, column in [(15.0, 20.0), (4.0, 25.0), (0.0, 0.0), (30.0, 33.0)]:
        at, got = seen_through_rim(view, a(row), a(column), u)
        through = np.hypot(at[:, 0], at[:, 1]) < 0.012
        np.testing.assert_allclose(got, through.mean(), atol=6e-3)
        shares.append(float(got))
    assert min(shares) < 0.7
    assert max(shares) > shares[1]


def test_irradiance_includes_the_rims_share():
    open_lens, cut = (
        s.ThinLens([0, 0, 0], np.eye(3), 0.05, 1e-3, resolution=(31, 41), f_number=2.0, rim=rim)
        for rim in (None, s.Rim(0.04, 0.024))
    )
    one, other = (
        optics.pixel_irradiance(view, a([1.0]), a(0.0), a(3.0)) for view in (cut, open_lens)
    )
    share = optics.clear_fraction(cut, a(0.0), a(3.0))
    assert 0 < share < 0.9
    np.testing.assert_allclose(one, other * share, rtol=1e-14)
    assert optics.clear_fraction(open_lens, a(0.0), a(3.0)) == 1


# ---------------------------------------------------------------- diffraction

WAVELENGTH, F_NUMBER = 5.5e-7, 8.0


@pytest.mark.sweep
@pytest.mark.parametrize("pitch", [1.5e-6, 4e-6, 8e-6])
def test_airy_kernel_against_integration(pitch):
    """Each weight, before rescaling, is a double integral. Ratios of weights are compared."""
    kernel = np.asarray(optics.airy_kernel(a(WAVELENGTH), a(F_NUMBER), a(pitch), size=5))

    def pattern(y, x):
        v = max(np.pi * np.hypot(x, y) / (WAVELENGTH * F_NUMBER) * pitch, 1e-12)
        return (2 * special.j1(v) / v) ** 2

    def pixel(row, column):
        return integrate.dblquad(
            pattern, column - 0.5, column + 0.5, row - 0.5, row + 0.5, epsabs=1e-9
        )[0]

    for at in [(0, 1), (1, 1), (2, 0)]:
        expected = pixel(*at) / pixel(0, 0)
        np.testing.assert_allclose(kernel[2 + at[0], 2 + at[1]] / kernel[2, 2], expected, rtol=1e-6)
    np.testing.assert_allclose(kernel.sum(), 1, rtol=1e-14)


@pytest.mark.parametrize("rings", [2, 2.95, 3.05, 6, 8, 11, 20, 47])
def test_pixels_of_many_rings_have_the_right_share(rings):
    """The pixels measure this many lambda N. The reference sums the pattern at 12 or more positions
    per ring."""
    unit, size = WAVELENGTH * F_NUMBER, 5
    kernel = np.asarray(optics.airy_kernel(a(WAVELENGTH), a(F_NUMBER), a(rings * unit), size=size))
    nodes, weights = np.polynomial.legendre.leggauss(max(24, int(6 * rings)))
    places = (np.arange(size)[:, None] - size // 2 + nodes / 2).ravel() * np.pi * rings
    x = np.maximum(np.hypot(places[:, None], places), 1e-12)
    across = np.tile(weights, size)
    light = (2 * special.j1(x) / x) ** 2 * across[:, None] * across
    shares = light.reshape(size, len(nodes), size, len(nodes)).sum(axis=(1, 3))
    np.testing.assert_allclose(kernel, shares / shares.sum(), atol=2e-5)


@pytest.mark.slow
def test_airy_kernel_for_each_band_and_its_limits():
    both = optics.airy_kernel(a([4.5e-7, 6.5e-7]), a(F_NUMBER), a(3e-6), size=5)
    red = optics.airy_kernel(a(6.5e-7), a(F_NUMBER), a(3e-6), size=5)
    assert both.shape == (5, 5, 2)
    np.testing.assert_allclose(both[..., 1], red, rtol=1e-14)
    for no_waves in ((a([0.0, 5e-7]), a(8.0)), (a([5e-7, 5e-7]), a(0.0))):
        point = optics.airy_kernel(*no_waves, a(3e-6), size=3)[..., 0]
        np.testing.assert_array_equal(point, np.outer([0, 1, 0], [0, 1, 0]))
    for wrong in ({"size": 4}, {"size": 5, "order": 0}):
        with pytest.raises(ValueError, match=r"must be an? (odd|whole) number of at least 1, got"):
            optics.airy_kernel(a(5e-7), a(8.0), a(3e-6), **wrong)


@pytest.mark.slow
def test_mtf_of_a_ring_is_its_pupils_autocorrelation():
    n = 1024
    x, y = squares(n, 2)
    pupil = inside(s.AnnularAperture(0.4), x, y).astype(float)
    spectrum = np.abs(np.fft.fft2(pupil)) ** 2
    overlap = np.fft.ifft2(spectrum).real[0, : n // 2]
    shift = np.arange(n // 2) * 4 / n
    got = optics.diffraction_mtf(a(shift / 2 * 1e6), a(1e-6), a(1.0), obstruction=a(0.4))
    np.testing.assert_allclose(got, overlap / overlap[0], atol=4e-3)
