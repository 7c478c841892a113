"""Tests distortion against OpenCV, its inverse in round trips, conservation of flux, and pictures
with distortion and lateral chromatic aberration."""

import re
import warnings
from functools import partial

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxvision import as_array, optics
from jaxvision import scene as s
from jaxvision.files import read_scene

EYE = np.eye(3)
BARREL = s.Distortion([-0.28, 0.07], [1e-3, -2e-3])
LENSES = {
    "barrel": BARREL,
    "pincushion": s.Distortion([0.35, 0.1]),
    "moustache": s.Distortion([-0.2, 0.35, -0.02], [-2e-3, 1e-3]),
    "none": s.Distortion([0.0]),
}
each_lens = pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
SLOPES = np.random.default_rng(4).uniform(-0.7, 0.7, size=(400, 2))


def a(x):
    return jnp.asarray(x, float)


def both(function, lens, points):
    there = jax.jit(jax.vmap(lambda p: jnp.stack(function(lens, p[0], p[1]))))
    return np.asarray(there(a(points)))


@each_lens
def test_distort_is_opencvs(lens):
    k = np.zeros(5)
    radial = np.asarray(lens.radial)
    k[[0, 1, 4][: len(radial)]] = radial
    k[2:4] = 0 if lens.tangential is None else lens.tangential
    points = np.concatenate([SLOPES, np.ones((len(SLOPES), 1))], 1)
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), EYE, k)
    np.testing.assert_allclose(both(optics.distort, lens, SLOPES), expected[:, 0], atol=1e-14)


@pytest.mark.sweep
@each_lens
def test_distortion_is_inverted(lens):
    back = both(optics.undistort, lens, both(optics.distort, lens, SLOPES))
    np.testing.assert_allclose(back, SLOPES, atol=1e-12)


def test_derivatives_equal_those_of_the_inverse():
    """The derivative by position is the inverse matrix, and by the coefficients it equals a
    difference quotient."""
    place = a([0.31, -0.44])

    def there(p):
        return jnp.stack(optics.distort(BARREL, p[0], p[1]))

    def back(p):
        return jnp.stack(optics.undistort(BARREL, p[0], p[1]))

    def of_coefficients(k):
        return jnp.stack(optics.undistort(s.Distortion(k[:2], k[2:]), place[0], place[1]))

    @jax.jit
    def derivatives(k):
        ideal = back(place)
        area = optics.distortion_area(BARREL, ideal[0], ideal[1])
        of_places = jax.jacfwd(there)(ideal), jax.jacrev(back)(place)
        return *of_places, area, jax.jacrev(of_coefficients)(k)

    k = jnp.concatenate([BARREL.radial, BARREL.tangential])
    forward, backward, area, got = derivatives(k)
    np.testing.assert_allclose(forward @ backward, np.eye(2), atol=1e-12)
    np.testing.assert_allclose(area, np.linalg.det(forward), rtol=1e-12)
    at = jax.jit(of_coefficients)
    for i, unit in enumerate(np.eye(4)):
        slope = (at(k + 1e-5 * unit) - at(k - 1e-5 * unit)) / 2e-5
        np.testing.assert_allclose(got[:, i], slope, atol=1e-9)


def test_rays_follow_the_distortion():
    plain, bent = (
        s.Pinhole([1, 2, 3], EYE, 0.01, 1e-4, resolution=(60, 80), distortion=d)
        for d in (None, BARREL)
    )
    ray = optics.camera_ray(bent, a(3.0), a(70.0))
    slope = as_array(ray.direction)[:2] / ray.direction.z
    at = np.array(optics.pixel_offset(plain, a(3.0), a(70.0))) / 0.01
    np.testing.assert_allclose(both(optics.distort, BARREL, slope[None])[0], at, rtol=1e-12)


@pytest.mark.parametrize("k", [-0.25, 0.3])
def test_a_stretched_picture_is_darker(k):
    """A ring of the sky with radii r and dr becomes one of radius r (1 + k r^2) and its
    differential."""
    lens = s.Distortion([k])
    view = s.Pinhole([0, 0, 0], EYE, 1.0, 0.1, resolution=(9, 9), f_number=2, distortion=lens)
    r = 0.5
    column = 4 + r * (1 + k * r * r) / 0.1
    found = optics.pixel_irradiance(view, jnp.ones(1), a(4.0), a(column))[0]
    stretched = (1 + k * r * r) * (1 + 3 * k * r * r)
    plain = np.pi / (4 * 2**2) / (1 + r * r) ** 2  # cos^4
    np.testing.assert_allclose(found, plain / stretched, rtol=1e-9)


@pytest.mark.slow
def test_distortion_conserves_the_flux():
    """Under a uniform sky all light within a cone, L A sin^2 pi / z_i^2, arrives on the sensor,
    wherever distortion puts it."""
    edge = 0.6
    for lens in (s.Distortion([-0.25, 0.05]), s.Distortion([0.3])):
        view = s.Pinhole(
            [0, 0, 0], EYE, 1.0, 0.004, resolution=(351, 351), f_number=1, distortion=lens
        )
        light = jax.jit(optics.sensor_irradiance)(view, jnp.ones((351, 351, 1)))[..., 0]
        offset = (np.arange(351) - 175) * 0.004
        rim = float(optics.distort(lens, a(edge), a(0.0))[0])
        inside = np.hypot(offset[:, None], offset[None, :]) < rim
        flux = np.asarray(light)[inside].sum() * 0.004**2
        expected = np.pi / 4 * np.pi * edge**2 / (1 + edge**2)
        np.testing.assert_allclose(flux, expected, rtol=2e-3)


# ---------------------------------------------------------------- pictures


def smooth(rows, columns):
    return jnp.stack(
        [jnp.sin(rows / 6 + 1) * jnp.cos(columns / 7), jnp.cos((rows + columns) / 9)], -1
    )


GRID = np.meshgrid(np.arange(60.0), np.arange(80.0), indexing="ij")
VIEW = s.Pinhole([0, 0, 0], EYE, 0.01, 1e-4, resolution=(60, 80), distortion=BARREL)


@pytest.mark.slow
def test_pictures_are_distorted_like_rays():
    """The picture of a function of the slope is that function along the distorted rays."""

    def shown(view, row, column):
        x, y = optics.chief_slope(view, row, column)
        return smooth(y * 100 + 30, x * 100 + 40)

    over = jax.jit(jax.vmap(jax.vmap(shown, in_axes=(None, 0, 0)), in_axes=(None, 0, 0)))
    ideal = over(s.Pinhole([0, 0, 0], EYE, 0.01, 1e-4, resolution=(60, 80)), *GRID)
    bent = over(VIEW, *GRID)
    inner = (slice(8, -8), slice(8, -8))
    got = jax.jit(optics.undistort_image)(VIEW, bent)
    np.testing.assert_allclose(got[inner], ideal[inner], atol=2e-3)
    middle = (slice(20, -20), slice(25, -25))  # a barrel shows more than the ideal picture
    again = jax.jit(optics.distort_image)(VIEW, ideal)
    np.testing.assert_allclose(again[middle], bent[middle], atol=2e-3)
    linear = jax.jit(partial(optics.distort_image, interpolation="linear"))(VIEW, ideal)
    assert jnp.abs(linear - bent)[middle].max() > jnp.abs(again - bent)[middle].max()


@pytest.mark.slow
def test_cubic_interpolation_preserves_parabolas_and_linear_ramps():
    rows, columns = GRID
    r, c = a(np.random.default_rng(1).uniform(3, 50, size=(2, 5, 7)))
    parabola = ((rows - 9) * (columns + rows / 3))[..., None]
    got = optics.sample_image(parabola, r, c)[..., 0]
    np.testing.assert_allclose(got, (r - 9) * (c + r / 3), rtol=1e-12)
    ramp = (2 * rows - 3 * columns)[..., None]
    got = optics.sample_image(ramp, r, c, interpolation="linear")[..., 0]
    np.testing.assert_allclose(got, 2 * r - 3 * c, rtol=1e-11)
    outside = optics.sample_image(ramp, r - 900, c)[..., 0]
    np.testing.assert_allclose(outside, optics.sample_image(ramp, 0 * r, c)[..., 0], rtol=1e-12)


@pytest.mark.slow
def test_lateral_colour_magnifies_each_band_about_the_centre():
    blob = jnp.exp(-((GRID[0] - 40) ** 2 + (GRID[1] - 59.5) ** 2) / 18)[..., None].repeat(
        2, axis=-1
    )
    aberration = jax.jit(optics.lateral_aberration)
    got = np.asarray(aberration(blob, a([1.0, 1.05])))
    np.testing.assert_allclose(got[..., 0], blob[..., 0], atol=1e-15)
    rows, columns = GRID
    centre = [(got[..., 1] * g).sum() / got[..., 1].sum() for g in (rows, columns)]
    expected = [29.5 + 1.05 * 10.5, 39.5 + 1.05 * 20]
    np.testing.assert_allclose(centre, expected, atol=1e-3)
    back = aberration(a(got), 1 / a([1.0, 1.05]))
    np.testing.assert_allclose(back, blob, atol=0.01)


def test_pictures_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match=r"magnification must be \(2,\), one per band, got \(3,\)"):
        optics.lateral_aberration(jnp.ones((4, 5, 2)), jnp.ones(3))
    with pytest.raises(ValueError, match=r"at least one pixel, got shape \(0, 4, 3\)"):
        optics.sample_image(np.zeros((0, 4, 3)), np.zeros((1, 1)), np.zeros((1, 1)))
    with pytest.raises(ValueError, match="interpolation must be one of linear, cubic, got 'best'"):
        optics.sample_image(
            jnp.ones((4, 5, 2)), jnp.ones((2, 2)), jnp.ones((2, 2)), interpolation="best"
        )
    with pytest.raises(ValueError, match=r"the picture must be \(60, 80\), as the view is"):
        optics.distort_image(VIEW, jnp.ones((4, 5, 2)))


@pytest.mark.parametrize(
    "coefficients", [(), (-0.2, 0.05, 0.003, -0.002), (0.1, -0.05, 0, 0, 0.02)]
)
def test_an_opencv_camera_projects_points_like_opencv(coefficients):
    """fx and fy differ, (cx, cy) is off centre, and the pose is arbitrary."""
    rng = np.random.default_rng(0)
    matrix = np.array([[800.0, 0.0, 250.5], [0.0, 840.0, 290.25], [0.0, 0.0, 1.0]])
    turn, moved = np.array([0.2, -0.3, 0.1]), np.array([0.1, -0.2, 0.4])
    points = rng.uniform([-0.8, -0.6, 2.0], [0.8, 0.6, 4.0], (50, 3))
    known = np.asarray(coefficients) if coefficients else None
    wanted = cv2.projectPoints(points, turn, moved, matrix, known)[0][:, 0]
    view = optics.opencv_view(
        matrix,
        coefficients=coefficients,
        resolution=(480, 640),
        rotation=turn,
        translation=moved,
    )
    seen = jax.vmap(lambda point: optics.project(view, point))(jnp.asarray(points))
    np.testing.assert_allclose(np.stack([seen.column, seen.row], -1), wanted, atol=1e-6)
    rays = jax.vmap(lambda row, column: optics.camera_ray(view, row, column))(seen.row, seen.column)
    along = points - np.asarray(view.position)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    np.testing.assert_allclose(np.asarray(as_array(rays.direction)), along, atol=1e-8)
    step = 1e-4  # of slope: area by finite differences of cv2's
    corners = np.array([[0.3, 0.2, 1], [0.3 + step, 0.2, 1], [0.3, 0.2 + step, 1]])
    zero = np.zeros(3)
    a, b, c = cv2.projectPoints(corners, zero, zero, matrix, known)[0][:, 0] / 800 / step
    area = optics.distortion_area(view.distortion, jnp.asarray(0.3), jnp.asarray(0.2))
    assert float(area) == pytest.approx(np.linalg.det([b - a, c - a]), rel=1e-3)


def test_what_opencv_calibrates_beyond_the_model_is_refused():
    matrix = np.array([[800.0, 0.0, 250.5], [0.0, 840.0, 290.25], [0.0, 0.0, 1.0]])
    with pytest.raises(ValueError, match="rational"):
        optics.opencv_view(matrix, coefficients=[0, 0, 0, 0, 0, 0.1, 0, 0], resolution=(48, 64))
    skew = matrix.copy()
    skew[0, 1] = 2.0
    with pytest.raises(ValueError, match="no skew"):
        optics.opencv_view(skew, resolution=(48, 64))
    with pytest.raises(ValueError, match="matrix must be"):
        optics.opencv_view(matrix.T, resolution=(48, 64))


CHEAP = np.array([[43.0, 0, 20.0], [0, 43.0, 19.9], [0, 0, 1]])


def said_of_folds(make):
    """Return the view, and the shares in % that are named while it is made."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        view = make()
    found = [re.search(r": ([\d.]+) % of the pixels", str(w.message)) for w in said]
    return view, [float(share[1]) for share in found]


@pytest.mark.parametrize(
    ("k1", "p1", "share"),
    [(-0.2, 0, 0), (-0.525, 0, 0.0725), (-1.2, 0, 0.5575), (0, 0.3, 0.2475), (-0.1, 1e-3, 0)],
)
def test_pixels_beyond_a_fold_of_the_distortion_are_counted(k1, p1, share):
    """The reference counts pixels for which no slope is found. They occur with bad calibrations,
    and with k3 in the place of p1."""
    coefficients = [k1, 0, p1, 0]
    view, named = said_of_folds(
        lambda: optics.opencv_view(CHEAP, coefficients=coefficients, resolution=(40, 40))
    )
    right, down = np.meshgrid((np.arange(40) - 19.5) / 43, (np.arange(40) - 19.5) / 43)

    def back(x, y):
        return jnp.stack(optics.distort(view.distortion, *optics.undistort(view.distortion, x, y)))

    met = jax.vmap(back)(a(right.ravel()), a(down.ravel())).T
    off = np.hypot(*(np.asarray(met) - [right.ravel(), down.ravel()])) > 1e-3
    np.testing.assert_allclose(off.mean(), share, atol=0.02)
    np.testing.assert_allclose(named, [100 * off.mean()] if share else [], atol=1)


def test_a_fold_is_named_wherever_a_view_is_made(tmp_path):
    sizes, folded = ([0, 0, 0], np.eye(3), 0.043, 1e-3), s.Distortion([-0.525])
    for make in (
        lambda: s.Pinhole(*sizes, resolution=(40, 40), distortion=folded),
        lambda: s.ThinLens(*sizes, f_number=4.0, resolution=(40, 40), distortion=folded),
    ):
        np.testing.assert_allclose(said_of_folds(make)[1], [7.25], atol=1)
    near = {"f_number": 4.0, "focus_distance": 0.086, "resolution": (40, 40)}  # sensor at 2 f
    assert said_of_folds(lambda: s.ThinLens(*sizes, **near, distortion=folded))[1] == []
    text = """
    [camera]
    kind = "thin_lens"
    position = [0.0, 0.0, 0.0]
    target = [0.0, 0.0, 1.0]
    up = [0.0, 1.0, 0.0]
    resolution = [40, 40]
    focal_length = 0.043
    pixel_pitch = 1e-3
    f_number = 4.0
    distortion = { radial = [-0.525] }
    [material.grey]
    family = "lambert"
    albedo = [0.5, 0.5, 0.5]
    [[surface]]
    shape = "sphere"
    centre = [0.0, 0.0, 3.0]
    radius = 1.0
    material = "grey"
    [[light]]
    kind = "point"
    position = [0.0, 0.0, 0.0]
    intensity = [1.0, 1.0, 1.0]
    """
    (tmp_path / "scene.toml").write_text(text)
    with pytest.warns(UserWarning, match=r"scene.toml: .*ThinLens.distortion: [678].* % of the"):
        read_scene(tmp_path / "scene.toml")


def test_undistorting_a_picture_beyond_a_fold_is_named():
    with pytest.warns(UserWarning, match="where no light falls"):
        folded = optics.opencv_view(CHEAP, coefficients=[-1.2, 0, 0, 0], resolution=(40, 40))
    plain = optics.opencv_view(CHEAP, coefficients=[-0.3, 0, 0, 0], resolution=(40, 40))
    picture = jnp.ones((40, 40, 1))
    with pytest.warns(UserWarning, match=r"8\.5 % of the pixels lie beyond the fold"):
        optics.undistort_image(folded, picture)
    with pytest.warns(UserWarning, match="% of the pixels lie beyond the fold"):
        optics.distort_image(folded, picture)
    optics.undistort_image(plain, picture)
    with pytest.warns(UserWarning, match="of the pixels lie beyond the fold"):
        jax.jit(lambda p: optics.undistort_image(folded, p))(picture)
