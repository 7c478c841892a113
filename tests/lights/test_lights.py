"""Tests point, directional and small lights: the inverse-square law, constancy, and the light at
its own position."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate

import jaxvision as jv
from jaxvision import as_array, as_dtype
from jaxvision.lights import (
    Balanced,
    DirectionalLight,
    MonteCarlo,
    PointLight,
    Quadrature,
    SmallLight,
    emitted,
    incident,
    rule_for,
)


def test_point_light_falls_with_the_square_of_the_distance():
    light = PointLight([1, 2, 5], [9.0, 18.0])
    here = incident(light, jnp.asarray([1.0, 2.0, 2.0]))
    np.testing.assert_allclose(here.irradiance, [1, 2], rtol=1e-15)
    np.testing.assert_allclose(here.direction, [0, 0, 1], atol=1e-15)
    farther = incident(light, jnp.asarray([1.0, 2.0, -4.0]))
    np.testing.assert_allclose(farther.irradiance, [1 / 9, 2 / 9], rtol=1e-15)


def test_directional_light_is_the_same_everywhere_whatever_its_length():
    light = DirectionalLight([0, 3, 4], [1.0, 2.0, 3.0])
    for point in ([0.0, 0.0, 0.0], [5.0, -1.0, 100.0]):
        arriving = incident(light, jnp.asarray(point))
        np.testing.assert_allclose(arriving.direction, [0, 0.6, 0.8], rtol=1e-15)
        np.testing.assert_array_equal(arriving.irradiance, [1, 2, 3])


def test_small_light_falls_with_its_cosine_and_the_square_of_the_distance():
    """The reference is plain NumPy at many points. Points behind the light are dark, and its normal
    may have any length."""
    position, normal = np.array([0.3, -0.2, 2.0]), np.array([0.5, 1.0, -2.0])
    points = np.random.default_rng(4).uniform(-3, 3, (200, 3))
    light = SmallLight(position, normal, [4.0, 8.0])
    arriving = jax.jit(jax.vmap(lambda p: incident(light, p)))(jnp.asarray(points))
    away = position - points
    distance = np.sqrt((away**2).sum(1))
    cosine = np.maximum(-(away @ normal) / (distance * np.sqrt(normal @ normal)), 0)
    assert 0.1 < (cosine == 0).mean() < 0.9  # behind the light
    expected = (cosine / distance**2)[:, None] * np.array([4.0, 8.0])
    np.testing.assert_allclose(arriving.irradiance, expected, rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(arriving.direction, away / distance[:, None], rtol=1e-13)
    np.testing.assert_allclose(arriving.distance, distance, rtol=1e-14)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize(
    "kind", [PointLight, lambda at, of: SmallLight(at, [0, 0, -1], of)], ids=["point", "small"]
)
def test_at_the_light_itself_everything_is_zero(dtype, kind):
    light = as_dtype(kind([1, 2, 3], [1.0]), dtype)
    point = jnp.asarray([1, 2, 3], dtype)
    arriving = jax.jit(incident)(light, point)
    assert not np.any(arriving.direction)
    assert not np.any(arriving.irradiance)
    gradient = jax.jit(jax.grad(lambda p: incident(light, p).irradiance.sum()))
    assert not np.any(gradient(point))
    assert np.isfinite(gradient(np.asarray(point) + np.array([1e-6, 0, 0], dtype))).all()


def test_each_pixel_draws_its_own_samples_by_the_same_rule():
    """A pixel's key is the render's key folded with the pixel's number, and the type of rule is
    unchanged."""
    key = jax.random.key(3)
    for kind in (MonteCarlo, Balanced):
        first, second = (rule_for(kind(key, 4), jnp.asarray(i)) for i in (0, 1))
        assert type(first) is type(second) is kind
        assert first.samples == second.samples == 4
        keys = [jax.random.key_data(x) for x in (key, first.key, second.key)]
        assert len({tuple(np.asarray(x)) for x in keys}) == 3
    assert rule_for(Quadrature(3), jnp.asarray(1)) == Quadrature(3)
    with pytest.raises(ValueError, match=r"Balanced.samples must be a whole number .* got 0"):
        Balanced(key, 0)


def test_rays_of_a_small_light_carry_its_flux():
    """The flux is the integral of I cos(theta) over the half space, in total and within 45 degrees,
    by quadrature. The rays are distributed uniformly."""
    normal = np.array([0.6, 0.0, -0.8])
    lamp = SmallLight([0.2, 0, 1.0], 2 * normal, [3.0, 1.5])
    k = (np.arange(8) + 0.5) / 8
    u = np.stack(np.meshgrid([0.5], [0.5], k, k, indexing="ij"), -1).reshape(-1, 4)
    rays = jax.vmap(lambda u: emitted(lamp, u, around=None))(jnp.asarray(u))
    flux, direction = np.asarray(rays.flux), np.asarray(as_array(rays.ray.direction))

    def within(end):
        return integrate.quad(lambda t: np.cos(t) * 2 * np.pi * np.sin(t), 0, end)[0]

    np.testing.assert_allclose(flux.mean(axis=0), [3 * within(np.pi / 2), 1.5 * within(np.pi / 2)])
    near = direction @ normal > np.sqrt(0.5)
    np.testing.assert_allclose((flux[:, 0] * near).mean(), 3 * within(np.pi / 4))


@pytest.mark.slow
def test_any_number_of_lamps_of_one_type_is_one_program():
    """The nearest of many lamps equals that of a plain loop, and a scene of 60 lamps has as many
    computing operations as one of 20. Only the stacking of their parameters grows."""
    rng = np.random.default_rng(0)

    def lamps(count):
        corners = rng.uniform(-1, 1, (count, 3)) + np.array([0.0, 0, 3])
        return [
            jv.RectangleLight(corner, [0.0, 0.4, 0], [0.4, 0.0, 0], [float(i + 1)])
            for i, corner in enumerate(corners)
        ]

    many = [*lamps(20), jv.environment_map(np.full((2, 4, 1), 0.5))]
    ways = rng.uniform(-0.3, 0.3, (12, 3)) + np.array([0.0, 0, 1])
    rays = [jv.Ray(np.zeros(3), way / np.linalg.norm(way)) for way in ways]
    nearest, alone = jax.jit(jv.lights.nearest_seen), jax.jit(jv.lights.radiance_along)
    met = 0
    for ray in rays:
        each = [alone(light, ray) for light in many]
        first = min(float(seen.distance) for seen in each)  # lights at infinity add up
        radiance = sum(float(seen.radiance[0]) for seen in each if float(seen.distance) == first)
        found = nearest(many, ray)
        np.testing.assert_allclose(found.distance, first)
        np.testing.assert_allclose(found.radiance, [radiance])
        met += bool(np.isfinite(first))
    assert met > 2

    floor = jv.Surface(jv.Quad([-2.0, -2, 0], [4.0, 0, 0], [0.0, 4, 0]), jv.Lambert([0.2]))
    ball = jv.Surface(jv.Sphere([0.0, 0, 1], 0.2), jv.Lambert([0.2]))
    view = jv.Orthographic([0, 0, 2], np.diag([1.0, -1, -1]), 0.1, resolution=(2, 2))
    moving = {"broadcast_in_dim", "concatenate", "slice", "squeeze", "reshape", "gather", "copy"}

    def operations(count):
        text = str(jax.make_jaxpr(jv.render)(jv.Scene([floor, ball], lamps(count)), view))
        names = re.findall(r"= ([a-z_0-9]+)[\[ ]", text)
        return sum(name not in moving for name in names)

    assert operations(60) < 1.05 * operations(20)


@pytest.mark.slow
def test_what_a_ray_at_nan_sees_is_unknown():
    """Not darkness: of a lamp, of several, of a table of intensities and of a light field."""
    lamp = jv.RectangleLight([-1, -1, 3], [0, 2, 0], [2, 0, 0], [5.0])
    table = jv.GoniometricLight([0, 0, 2], [8.0], [[1.0], [0.0]], [0, np.pi / 2], [0.0])
    near, far = (jv.Window([0, 0, z], [1, 0, 0], [0, 1, 0]) for z in (0, -1))
    field = jv.LightFieldLight(jnp.array([0.0, 4.0]).reshape(1, 1, 2, 1, 1), near, far)

    @jax.jit
    def seen(x):
        place, up = jnp.array([0, x, 0]), jnp.array([0, 0, 1.0])
        ray = jv.Ray(place, up)
        one, several = jv.lights.radiance_along(lamp, ray), jv.lights.nearest_seen([lamp], ray)
        return jnp.stack(
            [
                *(one.distance, one.radiance[0], several.distance, several.radiance[0]),
                jv.lights.radiance_from(lamp, place, up)[0],
                jv.lights.direction_pdf(lamp, place, up),
                jv.lights.relative_intensity(table, jnp.array([0, x, -1])),
                jv.refocus(field, jnp.array([0.25, x, -1.0]))[0],
            ]
        )

    assert np.isfinite(seen(0.1)).all()
    assert np.isnan(seen(np.nan)).all()
