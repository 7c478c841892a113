"""Tests the light field: one recorded from a scene shows that scene, and lights the space in front
of it."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvision as jv
from jaxvision.lights import incident_samples, radiance_along
from jaxvision.lights.light_field import light_field_radiance, light_field_ray, refocus
from jaxvision.rendering import render_light_field

# A window of 0.4 x 0.4 m in z = 0 that shines towards the viewer at -z. The scene is behind it,
# with the focal window at z = 1 m.
APERTURE = jv.Window([-0.2, 0.2, 0], [0.4, 0, 0], [0, -0.4, 0])
FOCAL = jv.Window([-0.8, 0.8, 1], [1.6, 0, 0], [0, -1.6, 0])
RNG = np.random.default_rng(2)


@pytest.mark.slow
def test_interpolation_is_linear_in_all_four_coordinates():
    """A radiance that is a product of linear functions is reproduced exactly."""
    sizes = (2, 3, 4, 5)
    s, t, u, v = np.meshgrid(*(np.linspace(0, 1, n) for n in sizes), indexing="ij")

    def truth(s, t, u, v):
        return (1 + s) * (2 - t) * (1 + 3 * u) * (0.5 + v)

    field = jv.LightFieldLight(truth(s, t, u, v)[..., None], APERTURE, FOCAL)
    for place in RNG.uniform(size=(5, 4)):
        ray = light_field_ray(APERTURE, FOCAL, jnp.asarray(place))
        before = jv.Ray(ray.origin - 3.0 * jnp.ones(()) * ray.direction, ray.direction)
        np.testing.assert_allclose(light_field_radiance(field, before), [truth(*place)], rtol=1e-12)
        np.testing.assert_allclose(radiance_along(field, before).distance, 3.0, rtol=1e-12)


MISSES = {
    "beside the aperture": ([0.3, 0, -1], [0, 0, 1]),
    "beside the focal window": ([-0.9, 0, -1], [0.67, 0, 0.74]),
    "from behind": ([0, 0, 1], [0, 0, -1]),
    "looking away": ([0, 0, -1], [0, 0, -1]),
    "along the plane": ([-1, 0, 0], [1, 0, 0]),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", MISSES)
def test_directions_outside_the_windows_are_dark(name):
    field = jv.LightFieldLight(np.ones((2, 2, 2, 2, 1)), APERTURE, FOCAL)
    origin, direction = (jnp.asarray(x, float) for x in MISSES[name])
    ray = jv.Ray(origin, direction / jnp.linalg.norm(direction))
    assert (light_field_radiance(field, ray) == 0).all()
    assert all(
        jnp.isfinite(x).all()
        for x in jax.tree.leaves(jax.grad(lambda r: light_field_radiance(field, r)[0])(ray))
    )


@pytest.mark.slow
def test_a_uniform_light_field_is_a_rectangle_light():
    """Each sample equals that of the uniform rectangle, within the field's angles."""
    wide = jv.Window([-50, 50, 1], [100, 0, 0], [0, -100, 0])
    field = jv.LightFieldLight(np.full((2, 2, 2, 2, 2), 3.0), APERTURE, wide)
    lamp = jv.RectangleLight(APERTURE.corner, APERTURE.edge_u, APERTURE.edge_v, [3.0, 3.0])
    point = jnp.asarray([0.3, -0.1, -0.4])
    got, expected = (incident_samples(light, point, jv.Quadrature(5)) for light in (field, lamp))
    np.testing.assert_array_equal(got.direction, expected.direction)
    np.testing.assert_allclose(got.irradiance, expected.irradiance, rtol=1e-13)
    assert (expected.irradiance > 0).all()


def behind():
    """Return a large ball just beyond the focal window, lit from nearby, which is smooth enough for
    few samples."""
    ball = jv.Surface(jv.Sphere([0.1, 0, 3], 2), jv.Lambert([0.3, 0.1], ambient=[0.1, 0.2]))
    return jv.Scene(
        [ball], [jv.PointLight([0.5, 0.3, 0.5], [1.0, 2.0])], jv.AmbientLight([1.0, 1.0])
    )


@pytest.fixture(scope="module")
def recorded():
    record = partial(render_light_field, resolution=(3, 3, 49, 49))
    return jax.jit(record)(behind(), APERTURE, FOCAL)


def camera(z):
    return jv.Pinhole([0.03, -0.02, z], np.eye(3), 1.0, 0.01, resolution=(12, 14))


@pytest.mark.slow
def test_a_camera_that_looks_through_the_window_sees_the_scene(recorded):
    """Each pixel equals the scene seen without the window."""
    elsewhere = jv.Surface(jv.Plane([0, 5, 0], [0, -1, 0]), jv.Lambert([0.0, 0.0]))
    draw = jax.jit(jv.render)
    through = draw(jv.Scene([elsewhere], [recorded]), camera(-0.6))
    direct = draw(behind(), camera(-0.6))
    assert direct.std() > 0.1 * direct.mean()
    np.testing.assert_allclose(through, direct, rtol=2e-3)


@pytest.mark.slow
def test_the_window_lights_points_in_front_of_it(recorded):
    """At each point the reference looks at the scene itself through the same window."""
    point, rule = jnp.asarray([0.1, 0.05, -1.0]), jv.Quadrature(4)
    arriving = incident_samples(recorded, point, rule)
    lamp = jv.RectangleLight(APERTURE.corner, APERTURE.edge_u, APERTURE.edge_v, [1.0, 1.0])
    even = incident_samples(lamp, point, rule)

    def look(direction):
        return jv.radiance_along(behind(), jv.Ray(point, direction))

    expected = jax.jit(jax.vmap(look))(even.direction) * even.irradiance
    np.testing.assert_allclose(arriving.irradiance, expected, rtol=2e-3)


@pytest.mark.slow
def test_refocusing_keeps_its_plane_sharp_and_blurs_the_others():
    """The focal plane has stripes, which the full aperture resolves at that depth only."""
    u = np.linspace(0, 1, 161)
    stripes = np.broadcast_to((1 + np.sin(2 * np.pi * 20 * u))[:, None, None], (161, 2, 1))
    field = jv.LightFieldLight(np.broadcast_to(stripes, (2, 2, 161, 2, 1)).copy(), APERTURE, FOCAL)
    x = jnp.linspace(-0.1, 0.1, 41)

    def contrast(depth, opening):
        line = jax.vmap(
            lambda x: refocus(
                field, jnp.stack([x, 0 * x, 0 * x + depth]), opening=opening, order=24
            )[0]
        )
        values = jax.jit(line)(x)
        return float((values.max() - values.min()) / 2)

    assert contrast(1.0, 1.0) > 0.97
    assert contrast(0.5, 1.0) < 0.02
    assert contrast(0.5, 1e-3) > 0.9


def test_wrong_shapes_are_named():
    with pytest.raises(ValueError, match=r"must have shape \(s, t, u, v, bands\), got \(2, 2, 3\)"):
        jv.LightFieldLight(np.ones((2, 2, 3)), APERTURE, FOCAL)
    with pytest.raises(ValueError, match=r"Window.edge_u must have shape \(3,\)"):
        jv.Window([0, 0, 0], [1, 0], [0, 1, 0])


@pytest.mark.parametrize(
    ("aperture", "focal", "message"),
    [
        (APERTURE, APERTURE, "behind or before the aperture, got a distance of 0 m"),
        (APERTURE, jv.Window([5, 0, 1e-7], [1, 0, 0], [0, -1, 0]), "behind or before the aperture"),
        (APERTURE, jv.Window([0, 0, 1], [0.6, 0, 0.8], [0, -1, 0]), "parallel .* got 0.927 rad"),
        (
            APERTURE,
            jv.Window([0, 0, 1], [1, 0, 0], [2, 0, 0]),
            "focal must be a window with an area",
        ),
        (
            jv.Window([0, 0, 0], [0, 0, 0], [0, 1, 0]),
            FOCAL,
            "aperture must be a window with an area",
        ),
    ],
)
def test_windows_that_cannot_make_a_light_field_are_named(aperture, focal, message):
    with pytest.raises(ValueError, match=message):
        jv.LightFieldLight(np.ones((2, 2, 2, 2, 1)), aperture, focal)


def test_distant_rotated_and_traced_windows_are_accepted():
    """Two parallel windows are rotated by a matrix that floats cannot represent, a kilometre away,
    in float32. Traced windows are also accepted."""
    axis = np.array([1, 2, 2]) / 3
    turn = 2 * np.outer(axis, axis) - np.eye(3)  # half a turn about the axis
    corners = [turn @ np.array([699.8, 600.2, 400 + z]) for z in (0, 1)]
    edges = [(0.1 * turn[0], 0.3 * turn[1]), (0.7 * turn[0], -0.9 * turn[1])]
    windows = [
        jv.Window(*(np.float32(a) for a in (c, *e))) for c, e in zip(corners, edges, strict=True)
    ]
    jv.LightFieldLight(np.ones((2, 2, 2, 2, 1), np.float32), *windows)
    made = jax.eval_shape(lambda w: jv.LightFieldLight(jnp.ones((2, 2, 2, 2, 1)), w, w), APERTURE)
    assert made.radiance.shape == (2, 2, 2, 2, 1)
