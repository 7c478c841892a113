"""Pixel rays by hand, and the camera equation against the integral that it approximates."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxvision import as_array, as_dtype
from jaxvision.optics import (
    camera_ray,
    cos_to_axis,
    look_at,
    pixel_irradiance,
    project,
    sensor_irradiance,
)
from jaxvision.scene import Distortion, Orthographic, Pinhole, ThinLens

EYE = np.eye(3)
TILTED = np.array([[0.6, 0.0, -0.8], [0.0, 1.0, 0.0], [0.8, 0.0, 0.6]])
PINHOLE = Pinhole([1, 2, 3], EYE, 0.05, 0.01, resolution=(2, 4), f_number=8)


def test_look_at_is_a_rotation_with_its_axes_where_they_belong():
    position, target = jnp.asarray([3.0, 0, 1]), jnp.asarray([0.0, 0, 1])
    rotation = np.asarray(look_at(position, target, jnp.asarray([0.0, 0, 1])))
    np.testing.assert_allclose(rotation, [[0, 1, 0], [0, 0, -1], [-1, 0, 0]], atol=1e-15)
    tilted = np.asarray(look_at(position, target + 1, jnp.asarray([0.2, 0.3, 1])))
    np.testing.assert_allclose(tilted @ tilted.T, EYE, atol=1e-15)
    np.testing.assert_allclose(np.linalg.det(tilted), 1, rtol=1e-14)


def test_pinhole_rays_by_hand():
    corner = camera_ray(PINHOLE, jnp.asarray(0.0), jnp.asarray(3.0))
    np.testing.assert_array_equal(as_array(corner.origin), [1, 2, 3])
    way = np.array([0.015, -0.005, 0.05])
    np.testing.assert_allclose(as_array(corner.direction), way / np.linalg.norm(way), rtol=1e-15)
    middle = camera_ray(PINHOLE, jnp.asarray(0.5), jnp.asarray(1.5))
    np.testing.assert_array_equal(as_array(middle.direction), [0, 0, 1])


def test_orthographic_rays_are_parallel_and_one_pitch_apart():
    view = Orthographic([0, 0, 0], EYE, 0.5, resolution=(2, 2))
    rays = [
        camera_ray(view, jnp.asarray(r), jnp.asarray(c)) for r in (0.0, 1.0) for c in (0.0, 1.0)
    ]
    origins = np.stack([as_array(one.origin) for one in rays])
    np.testing.assert_array_equal(
        origins, [[-0.25, -0.25, 0], [0.25, -0.25, 0], [-0.25, 0.25, 0], [0.25, 0.25, 0]]
    )
    assert all((as_array(one.direction) == jnp.asarray([0.0, 0, 1])).all() for one in rays)


def test_camera_equation_is_the_integral_over_the_hole():
    """E = integral of L cos cos' / d^2 over the hole, by quadrature over a disc of diameter f/N at
    distance f, for a pixel far off the axis."""
    f, n, radiance = 0.05, 40.0, 3.0
    view = Pinhole([0, 0, 0], EYE, f, 0.03, resolution=(1, 3), f_number=n)
    radius = f / n / 2
    r, weight = np.polynomial.legendre.leggauss(20)
    r, weight = radius * (r + 1) / 2, radius * weight / 2
    phi = np.arange(64) * 2 * np.pi / 64
    x, y = 0.03 - np.outer(r, np.cos(phi)), -np.outer(r, np.sin(phi))
    squared = x**2 + y**2 + f**2
    integrand = radiance * (f / np.sqrt(squared)) ** 2 / squared
    expected = ((integrand.mean(axis=1) * 2 * np.pi * r) * weight).sum()
    got = pixel_irradiance(view, jnp.asarray([radiance]), jnp.asarray(0.0), jnp.asarray(2.0))
    # the hole is small, not a point: the next term is of order (1 / 2N)^2
    np.testing.assert_allclose(got, [expected], rtol=1 / (2 * n) ** 2 * 4)


def test_without_f_number_radiance_is_handed_on():
    view = Pinhole([0, 0, 0], EYE, 0.05, 0.01, resolution=(2, 4))
    radiance = jnp.arange(24.0).reshape(2, 4, 3)
    np.testing.assert_array_equal(sensor_irradiance(view, radiance), radiance)


@pytest.mark.slow
def test_whole_picture_is_its_pixels_and_symmetric():
    flat = jnp.ones((2, 4, 1))
    picture = np.asarray(sensor_irradiance(PINHOLE, flat))
    one = pixel_irradiance(PINHOLE, flat[0, 0], jnp.asarray(1.0), jnp.asarray(0.0))
    np.testing.assert_allclose(picture[1, 0], one, rtol=1e-15)
    np.testing.assert_allclose(picture, picture[::-1, ::-1], rtol=1e-15)
    parallel = Orthographic([0, 0, 0], EYE, 0.5, resolution=(2, 4), f_number=8)
    np.testing.assert_allclose(sensor_irradiance(parallel, flat), np.pi / 256, rtol=1e-15)


@pytest.mark.sweep
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_dtype_is_kept_and_gradients_are_finite(dtype):
    view, pixel = as_dtype(PINHOLE, dtype), jnp.asarray(0.5, dtype)
    assert camera_ray(view, pixel, pixel).direction.x.dtype == dtype
    assert sensor_irradiance(view, jnp.ones((2, 4, 1), dtype)).dtype == dtype
    gradient = jax.grad(lambda v: cos_to_axis(v, pixel, pixel + 1))(view)
    assert all(jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))


@pytest.mark.parametrize(
    "view",
    [
        Pinhole([1, 2, 3], TILTED, 0.05, 1e-3, resolution=(4, 6)),
        Pinhole(
            [1, 2, 3], TILTED, 0.05, 5e-3, resolution=(4, 6), distortion=Distortion([-0.1, 0.02])
        ),
        ThinLens(
            [1, 2, 3], TILTED, 0.05, 1e-3, resolution=(4, 6), f_number=2.0, focus_distance=0.7
        ),
        Orthographic([1, 2, 3], TILTED, 0.1, resolution=(4, 6)),
    ],
)
def test_a_point_on_a_pixels_ray_is_projected_to_the_pixel(view):
    ray = camera_ray(view, jnp.asarray(0.75), jnp.asarray(4.25))
    origin, direction = (np.asarray(as_array(v)) for v in (ray.origin, ray.direction))
    row, column, depth = project(view, origin + 5 * direction)
    np.testing.assert_allclose([row, column], [0.75, 4.25], rtol=1e-9)
    forward = np.asarray(view.rotation)[2]
    np.testing.assert_allclose(depth, 5 * direction @ forward, rtol=1e-12)
    behind = project(view, origin - 5 * direction)
    assert np.isnan(behind.row) == np.isnan(behind.column) == (not isinstance(view, Orthographic))
    assert behind.depth < 0
