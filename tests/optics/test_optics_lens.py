"""Tests the thin lens: its law by hand and by ray transfer matrices, its rays by refraction, its
blur."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxvision import as_array, optics
from jaxvision import scene as s

EYE = np.eye(3)
F, N, FOCUS = 0.05, 2.0, 2.0
LENS = s.ThinLens(
    [0.1, -0.2, 0.3], EYE, F, 1e-4, resolution=(8, 10), f_number=N, focus_distance=FOCUS
)
SENSOR = 1 / (1 / F - 1 / FOCUS)
GRID = np.stack(np.meshgrid(*2 * [(np.arange(7) + 0.5) / 7], indexing="ij"), -1).reshape(-1, 2)


def a(x):
    return jnp.asarray(x, float)


# ---------------------------------------------------------------- the law


def test_lensmaker_against_ray_transfer_matrices():
    """f = -1 / C of the matrix product refraction, propagation, refraction (Hecht, section 6.2)."""
    for c1, c2, n, t in [(10.0, -10.0, 1.5, 0.01), (5.0, 8.0, 1.7, 0.03), (-4.0, 6.0, 1.3, 0.02)]:
        enter, travel, leave = (
            np.array([[1, 0], [-c1 * (n - 1) / n, 1 / n]]),
            np.array([[1, t], [0, 1]]),
            np.array([[1, 0], [c2 * (n - 1), n]]),
        )
        power = -(leave @ travel @ enter)[1, 0]
        got = optics.lens_power(a(c1), a(c2), a(n), thickness=a(t))
        np.testing.assert_allclose(got, power, rtol=1e-13)
        focal = optics.lens_focal_length(a(c1), a(c2), a(n), thickness=a(t))
        np.testing.assert_allclose(focal, 1 / power, rtol=1e-13)
    np.testing.assert_allclose(optics.lens_focal_length(a(10), a(-10), a(1.5)), 0.1, rtol=1e-15)
    assert jnp.isfinite(optics.lens_focal_length(a(0), a(0), a(1.5)))  # a window pane


def test_working_f_number_includes_the_image_distance():
    got = optics.working_f_number(a(N), a([0.1, 1.0, np.inf]), a(F))
    np.testing.assert_allclose(got, [2 * N, N * (1 + 0.05 / 0.95), N], rtol=1e-14)


# ---------------------------------------------------------------- depth of field


def test_depth_of_field_ends_at_the_allowed_blur():
    blur = a(3e-5)
    near, far = optics.depth_of_field(a(FOCUS), a(F), a(8.0), blur)
    ends = optics.circle_of_confusion(jnp.stack([near, far]), a(FOCUS), a(F), a(8.0))
    np.testing.assert_allclose(ends, 3e-5, rtol=1e-12)
    h = F + F * F / (8.0 * 3e-5)
    np.testing.assert_allclose(optics.hyperfocal_distance(a(F), a(8.0), blur), h, rtol=1e-15)
    # the published form, for example in Ray, Applied Photographic Optics, section 22
    np.testing.assert_allclose(near, FOCUS * (h - F) / (h + FOCUS - 2 * F), rtol=1e-13)
    np.testing.assert_allclose(far, FOCUS * (h - F) / (h - FOCUS), rtol=1e-13)
    near, far = optics.depth_of_field(a([h * 1.001, np.inf]), a(F), a(8.0), blur)
    np.testing.assert_allclose(near, [h / 2, h - F], rtol=1e-3)
    assert (far == jnp.inf).all()


# ---------------------------------------------------------------- rays


rays_of = jax.jit(jax.vmap(optics.lens_ray, in_axes=(None, None, None, 0)))


def test_lens_rays_are_refracted_by_the_thin_lens():
    """Rays go from the sensor, upside down at -z_i, to a point of the lens, where they are
    deflected by -a / f."""
    row, column = 2.3, 7.9
    x, y = (column - 4.5) * 1e-4, (row - 3.5) * 1e-4
    rays = rays_of(LENS, a(row), a(column), a(GRID))
    origins, directions = np.asarray(as_array(rays.origin)), np.asarray(as_array(rays.direction))
    for origin, direction in zip(origins, directions, strict=True):
        lens = origin - np.asarray(LENS.position)
        assert lens[2] == 0
        assert np.hypot(*lens[:2]) <= F / N / 2
        slope = (lens[:2] + np.array([x, y])) / SENSOR - lens[:2] / F
        way = np.append(slope, 1)
        np.testing.assert_allclose(direction, way / np.linalg.norm(way), rtol=1e-12, atol=1e-15)


def test_rays_of_a_pixel_meet_in_the_plane_in_focus():
    rays = rays_of(LENS, a(1.0), a(9.0), a(GRID))
    meet = as_array(rays.origin) + FOCUS * as_array(rays.direction) / rays.direction.z[:, None]
    np.testing.assert_allclose(meet, np.broadcast_to(meet[0], meet.shape), atol=1e-14)
    chief = optics.camera_ray(LENS, a(1.0), a(9.0))
    through = as_array(chief.origin) + FOCUS * as_array(chief.direction) / chief.direction.z
    np.testing.assert_allclose(meet[0], through, atol=1e-14)


def test_infinity_none_and_a_closed_aperture():
    far, none = (
        s.ThinLens([0, 0, 0], EYE, F, 1e-4, resolution=(8, 10), f_number=N, focus_distance=z)
        for z in (np.inf, None)
    )
    u = a([0.2, 0.9])
    one, other = (optics.lens_ray(view, a(2.0), a(3.0), u) for view in (far, none))
    jax.tree.map(np.testing.assert_array_equal, one, other)
    chief = optics.camera_ray(far, a(2.0), a(3.0))
    np.testing.assert_allclose(as_array(one.direction), as_array(chief.direction), rtol=1e-15)
    closed = s.ThinLens([0, 0, 0], EYE, F, 1e-4, resolution=(8, 10), f_number=np.inf)
    shut = optics.lens_ray(closed, a(2.0), a(3.0), u)
    jax.tree.map(np.testing.assert_array_equal, shut, optics.camera_ray(closed, a(2.0), a(3.0)))
    assert optics.pixel_irradiance(closed, a([1.0]), a(2.0), a(3.0)) == 0


def test_view_ray_of_each_view():
    u = a([0.2, 0.9])
    hole = s.Pinhole([0, 0, 0], EYE, F, 1e-4, resolution=(8, 10))
    for view in (hole, s.Orthographic([0, 0, 0], EYE, 0.1, resolution=(8, 10))):
        chief = optics.camera_ray(view, a(1.0), a(2.0))
        same = optics.view_ray(view, a(1.0), a(2.0), u=u)
        jax.tree.map(np.testing.assert_array_equal, same, chief)
    sampled = optics.view_ray(LENS, a(1.0), a(2.0), u=u)
    jax.tree.map(np.testing.assert_array_equal, sampled, optics.lens_ray(LENS, a(1.0), a(2.0), u))


@pytest.mark.sweep
@pytest.mark.parametrize("distance", [0.8, 1.6, 3.0, np.inf])
def test_sampled_edge_is_as_wide_as_the_circle_of_confusion(distance):
    """A bright half-plane at a known depth, sampled by rays through the lens, is the integral of a
    disc of the circle's radius: 1/2 + (t sqrt(1 - t^2) + arcsin t) / pi."""
    view = s.ThinLens([0, 0, 0], EYE, F, 1e-5, resolution=(1, 161), f_number=N, focus_distance=2.0)
    n = 64
    grid = (jnp.arange(float(n)) + 0.5) / n
    u = jnp.stack(jnp.meshgrid(grid, grid, indexing="ij"), -1).reshape(-1, 2)

    @jax.jit
    @partial(jax.vmap, in_axes=(0, None))
    def bright(column, distance):
        def one(u):
            ray = optics.lens_ray(view, a(0.0), column, u)
            slope = ray.direction.x / ray.direction.z
            return (ray.origin.x / distance + slope > 0).astype(float)

        return jax.vmap(one)(u).mean()

    edge = bright(jnp.arange(161.0), a(distance))
    radius = optics.circle_of_confusion(a(distance), a(2.0), a(F), a(N)) / 2 / 1e-5
    t = np.clip((np.arange(161) - 80) / float(radius), -1, 1)
    expected = 0.5 + (t * np.sqrt(1 - t * t) + np.arcsin(t)) / np.pi
    assert 6 < radius < 200
    np.testing.assert_allclose(edge, expected, atol=8e-3)
    assert abs(float(jnp.abs(edge - expected).mean())) < 2e-3


# ---------------------------------------------------------------- irradiance


def test_irradiance_is_the_integral_over_the_lens_at_the_image_distance():
    """E is the integral of L cos cos' / r^2 over a disc of diameter f / N at the distance z_i, far
    off axis in a close-up, where z_i is 1.5 f."""
    f, n, focus, radiance = 0.05, 40.0, 0.15, 3.0
    view = s.ThinLens([0, 0, 0], EYE, f, 0.03, resolution=(1, 3), f_number=n, focus_distance=focus)
    z = 1 / (1 / f - 1 / focus)
    r, weight = np.polynomial.legendre.leggauss(20)
    radius = f / n / 2
    r, weight = radius * (r + 1) / 2, radius * weight / 2
    phi = np.arange(64) * 2 * np.pi / 64
    x, y = 0.03 - np.outer(r, np.cos(phi)), -np.outer(r, np.sin(phi))
    squared = x**2 + y**2 + z**2
    integrand = radiance * (z / np.sqrt(squared)) ** 2 / squared
    expected = ((integrand.mean(axis=1) * 2 * np.pi * r) * weight).sum()
    got = optics.pixel_irradiance(view, a([radiance]), a(0.0), a(2.0))
    np.testing.assert_allclose(got, [expected], rtol=1 / (2 * n) ** 2 * 4)
    at_infinity = s.ThinLens([0, 0, 0], EYE, f, 0.03, resolution=(1, 3), f_number=n)
    middle = [optics.pixel_irradiance(v, a([1.0]), a(0.0), a(1.0)) for v in (view, at_infinity)]
    np.testing.assert_allclose(middle[0] / middle[1], (f / z) ** 2, rtol=1e-13)


# ---------------------------------------------------------------- invalid values


@pytest.mark.parametrize(
    ("field", "value", "allowed"),
    [
        ("focal_length", 0.0, "above 0"),
        ("focal_length", -0.05, "above 0"),
        ("focal_length", np.nan, "above 0"),
        ("pixel_pitch", 0.0, "above 0"),
        ("f_number", -2.0, "above 0"),
        ("focus_distance", 0.05, "above 0.05"),
        ("position", [0.0, np.nan, 0.0], "finite"),
        ("rotation", np.zeros((3, 3)), "a rotation, .*"),
        ("rotation", 2 * EYE, "a rotation, .*"),
        ("rotation", np.diag([1.0, 1.0, -1.0]), "a rotation, .*"),
        ("rotation", np.full((3, 3), np.nan), "a rotation, .*"),
    ],
)
def test_bad_values_are_refused_by_name(field, value, allowed):
    good = {"position": np.zeros(3), "rotation": EYE, "focal_length": 0.05, "pixel_pitch": 1e-5}
    good |= {"f_number": 2.0, "focus_distance": 1.0}
    with pytest.raises(ValueError, match=rf"ThinLens\.{field} must be (finite, )?{allowed}, got"):
        s.ThinLens(resolution=(2, 2), **(good | {field: value}))


def test_bad_records_are_refused():
    with pytest.raises(ValueError, match=r"Pinhole\.focal_length must be finite, above 0, got -1"):
        s.Pinhole([0, 0, 0], EYE, -1.0, 1e-5, resolution=(2, 2))
    with pytest.raises(ValueError, match="blades must be a whole number of at least 3, got 2"):
        s.PolygonalAperture(2)
    with pytest.raises(
        ValueError, match=r"obstruction must be finite, at least 0 and at most 0.999999, got 1"
    ):
        s.AnnularAperture(1.0)
    with pytest.raises(ValueError, match=r"width must be finite, above 0"):
        s.RectangularAperture(0.0, 1.0)
    with pytest.raises(ValueError, match=r"Rim\.diameter must be finite, above 0"):
        s.Rim(0.1, 0.0)
    with pytest.raises(
        ValueError, match=r"Distortion\.tangential must have shape \(2,\), got \(1,\)"
    ):
        s.Distortion([0.1], [0.1])
    with pytest.raises(ValueError, match=r"Distortion\.radial must be finite, got nan"):
        s.Distortion([0.1, np.nan])
    with pytest.raises(ValueError, match=r"resolution must be a whole number of at least 1, got 0"):
        s.Pinhole([0, 0, 0], EYE, 0.01, 1e-5, resolution=(0, 2))
    with pytest.raises(ValueError, match=r"radiance must be \(8, 10\) and bands, .* \(9, 10, 1\)"):
        optics.sensor_irradiance(LENS, jnp.ones((9, 10, 1)))


def test_views_are_made_inside_transformations():
    """Traced values are unknown, and therefore accepted."""

    def sharpness(focal_length):
        view = s.ThinLens(
            jnp.zeros(3), jnp.eye(3), focal_length, a(1e-5), resolution=(2, 2), f_number=a(2.0),
            focus_distance=a(1.0),
        )  # fmt: skip
        return optics.sensor_vergence(view)

    np.testing.assert_allclose(jax.jit(jax.grad(sharpness))(a(F)), -1 / F**2, rtol=1e-12)


def test_a_focal_length_in_mm_with_a_blur_in_m_is_a_sentence():
    for f, blur in ((50.0, 30e-6), (a([0.05, 50.0]), a(1e-5))):
        with pytest.raises(ValueError, match=r"hyperfocal_distance: .* in m \(50 mm are 0.05\)"):
            optics.hyperfocal_distance(f, 8.0, blur)
        with pytest.raises(ValueError, match="depth_of_field: "):
            optics.depth_of_field(3.0, f, 8.0, blur)
    assert np.isfinite(optics.hyperfocal_distance(50.0, 8.0, 0.03))  # all in mm
    assert np.isinf(optics.hyperfocal_distance(0.05, 8.0, 0.0))
