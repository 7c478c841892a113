"""Tests pixel rays by hand, and the camera equation against the integral that it approximates."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxvision import as_array
from jaxvision.optics import (
    camera_ray,
    look_at,
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


def test_without_an_f_number_radiance_is_unchanged():
    view = Pinhole([0, 0, 0], EYE, 0.05, 0.01, resolution=(2, 4))
    radiance = jnp.arange(24.0).reshape(2, 4, 3)
    np.testing.assert_array_equal(sensor_irradiance(view, radiance), radiance)


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
