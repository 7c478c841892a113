"""Tests intersections against the quadratic formula with 50 digits, and the law of reflection."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import exact

from jaxvision import as_array, as_dtype
from jaxvision.geometry import (
    Encounter,
    Ray,
    hit_shape,
    intersect,
    mirror_direction,
    nearest_shape,
)
from jaxvision.scene import Plane, Sphere

RNG = np.random.default_rng(7)
meet = jax.jit(intersect)


def ray(origin, direction, dtype=jnp.float64):
    direction = np.asarray(direction, float)
    return Ray(
        jnp.asarray(origin, dtype), jnp.asarray(direction / np.linalg.norm(direction), dtype)
    )


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize(("radius", "distance"), [(1, 3), (1, 1000), (1e-3, 10), (100, 101)])
def test_sphere_against_the_quadratic_in_50_digits(dtype, radius, distance):
    """Near the front of a sphere the error of the distance is a few eps of the largest length, like
    that from rounding the ray's direction."""
    eps, count = float(jnp.finfo(dtype).eps), 0
    for _ in range(12):
        way = RNG.normal(size=3)
        origin = distance * way / np.linalg.norm(way)
        target = RNG.normal(size=3) * radius * 0.3
        one = ray(origin, target - origin, dtype)
        sphere = as_dtype(Sphere([0, 0, 0], radius), dtype)
        truth = exact.sphere_distance(
            exact.vector(as_array(one.origin)),
            exact.vector(as_array(one.direction)),
            [exact.number(0)] * 3,
            exact.number(sphere.radius),
        )
        if truth is None:
            continue
        count += 1
        hit = meet(one, sphere)
        assert hit.distance.dtype == dtype
        assert abs(exact.number(hit.distance) - truth) <= 8 * eps * distance
        assert float(jnp.abs(jnp.linalg.norm(as_array(hit.normal)) - 1)) < 20 * eps * (
            distance / radius
        )
    assert count >= 4


def test_a_distant_small_sphere_in_float32():
    """For radius 1 at 4000 m, b^2 - 4 a c cancels completely in float32 (b^2 = 6.4e7, ULP 4), so
    rays within half a metre of the silhouette would be decided by rounding. In closed form the
    distance is sqrt(r^2 - h^2) before the centre plane."""
    sphere = as_dtype(Sphere([0, 0, 4000], 1), jnp.float32)
    for height in (0.0, 0.5, 0.9, 0.99):
        hit = meet(ray([height, 0, 0], [0, 0, 1], jnp.float32), sphere)
        assert abs(float(hit.distance) - (4000 - np.sqrt(1 - height**2))) < 3e-4
        np.testing.assert_allclose(
            as_array(hit.normal), [height, 0, -np.sqrt(1 - height**2)], atol=2e-6
        )
    assert jnp.isinf(meet(ray([1.01, 0, 0], [0, 0, 1], jnp.float32), sphere).distance)


def test_inside_behind_and_tangent():
    sphere = Sphere([0, 0, 0], 2)
    inside = meet(ray([0, 0, 1], [0, 0, 1]), sphere)
    assert float(inside.distance) == 1
    np.testing.assert_array_equal(as_array(inside.normal), [0, 0, 1])
    for miss in (ray([0, 0, 5], [0, 0, 1]), ray([2, 0, -5], [0, 0, 1])):
        hit = meet(miss, sphere)
        assert jnp.isinf(hit.distance)
        assert (as_array(hit.normal) == 0).all()


def test_plane():
    plane = Plane([0, 0, 1], [0, 0, 2])
    hit = meet(ray([0, 0, 4], [0, 3, -4]), plane)
    np.testing.assert_allclose(hit.distance, 3 * 5 / 4, rtol=1e-15)
    np.testing.assert_array_equal(as_array(hit.normal), [0, 0, 1])
    assert jnp.isinf(meet(ray([0, 0, 4], [1, 0, 0]), plane).distance)
    assert jnp.isinf(meet(ray([0, 0, 4], [0, 0, 1]), plane).distance)


def test_nearest_of_several_and_the_first_of_equals():
    shapes = [Plane([0, 0, 0], [0, 0, 1]), Sphere([0, 0, 3], 1), Sphere([0, 0, 3], 1)]
    down = ray([0, 0, 9], [0, 0, -1])
    first = nearest_shape(down, shapes)
    assert int(first.shape) == 1
    assert first.primitive is None
    assert float(hit_shape(down, shapes, first).distance) == 5
    assert float(hit_shape(down, shapes, Encounter(jnp.asarray(0))).distance) == 9
    up = ray([0, 0, 9], [0, 0, 1])
    nothing = nearest_shape(up, shapes)
    assert int(nothing.shape) == -1
    miss = hit_shape(up, shapes, nothing)
    assert jnp.isinf(miss.distance)
    np.testing.assert_array_equal(as_array(miss.point), [0, 0, 9])


def test_gradient_of_the_distance_to_a_sphere():
    """At the pole, moving the centre away by 1 moves the hit by 1, and increasing the radius by 1
    moves it by -1."""
    gradient = jax.grad(lambda sphere: intersect(ray([0, 0, 0], [0, 0, 1]), sphere).distance)
    result = jax.jit(gradient)(Sphere([0, 0, 5], 2))
    np.testing.assert_allclose(result.centre, [0, 0, 1], atol=1e-15)
    np.testing.assert_allclose(result.radius, -1, rtol=1e-15)


def test_mirror_direction_obeys_the_law_of_reflection():
    normal, w = RNG.normal(size=(2, 20, 3))
    normal, w = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (normal, w))
    s = np.asarray(mirror_direction(jnp.asarray(normal), jnp.asarray(w)))
    np.testing.assert_allclose((s * normal).sum(1), (w * normal).sum(1), atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(s, axis=1), 1, atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(np.stack([s, w, normal], axis=1)), 0, atol=1e-14)
    again = mirror_direction(jnp.asarray(normal), jnp.asarray(s))
    np.testing.assert_allclose(again, w, atol=1e-14)
