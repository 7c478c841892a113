"""Lights where naive formulas fail: receivers on, beside and behind a light, horizons, poles. In
both precisions, values are compared with 50-digit results, and gradients are finite.
"""

from functools import partial

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from oracles import contour, exact
from precisions import assert_finite, both_precisions, eps

import jaxvision as jv
from jaxvision.lights import direction_pdf, direction_sample, incident, radiance_along
from jaxvision.lights.environment import environment_radiance
from jaxvision.lights.polygon import angle_over_sine, rectangle_irradiance
from jaxvision.lights.window import window_sample
from jaxvision.rendering.hemisphere_integral import lit_radiance
from jaxvision.rendering.shading import outgoing_radiance

# float32 is the harder one, and compiling takes the time, so float64 is among the slow tests.
single_first = pytest.mark.parametrize(
    "dtype", [jnp.float32, pytest.param(jnp.float64, marks=pytest.mark.slow)]
)


# ------------------------------------------------ Lambert's contour


angle_with_gradient = jax.jit(jax.value_and_grad(angle_over_sine, argnums=(0, 1)))


@both_precisions
@pytest.mark.parametrize("ratio", [0.0, 1e-30, 1e-12, 1e-6, 1e-3, 0.0299, 0.0301, 1.0, 1e6])
@pytest.mark.parametrize("sign", [1, -1])
def test_angle_over_sine_and_its_derivatives(dtype, ratio, sign):
    """theta / sin for tan^2 = `ratio` and a cosine of 0.8 of either sign agrees with 50 digits."""
    cosine = jnp.asarray(sign * 0.8, dtype)
    square = jnp.asarray(ratio * 0.64, dtype)
    s2, c = exact.number(square), exact.number(cosine)
    got, pulled = angle_with_gradient(square, cosine)
    assert_finite((got, pulled))
    opposite = sign < 0 and ratio < eps(dtype) ** 2
    if square == 0 or opposite:
        assert abs(float(got) - (1 / 0.8 if sign > 0 else 0)) <= 2 * eps(dtype)
        if sign > 0:
            np.testing.assert_allclose(pulled, [-1 / (3 * 0.8**3), -1 / 0.64], rtol=8 * eps(dtype))
        return
    root = mp.sqrt(s2)
    value = mp.atan2(root, c) / root
    assert exact.ulps(got, value) <= 4
    by_square = (c / (s2 + c * c) - value) / (2 * s2)
    # below the range of the series the difference loses a factor 1 / ratio at most
    lost = 40 if sign > 0 else 8
    assert exact.ulps(pulled[0], by_square) <= lost * 3
    assert exact.ulps(pulled[1], -1 / (s2 + c * c)) <= 4


LAMP = ([-0.5, 0.25, 0.125], [1.0, 0.25, 0.0], [0.125, -0.5, 0.0])
RECEIVERS = {
    "below": ([0.1, 0.2, -1], [0, 0, 1]),
    "a quarter of the side below": ([0.1, 0, -0.125], [0, 0, 1]),
    "a thousandth below": ([0.1, 0, 0.124], [0, 0, 1]),
    "tilted": ([0.1, 0.2, -1], [0.6, 0, 0.8]),
    "cut by the horizon": ([0.1, 0, -0.25], [0.96, 0, 0.28]),
    "cut, only a corner left": ([0.1, 0, -0.25], [0.8, 0, -0.6]),
    "upside down": ([0.1, 0, -0.25], [0, 0, -1]),
    "beside": ([3, 0, -0.25], [-1, 0, 0]),
    "far": ([0.5, 4, -9], [0, 0, 1]),
    "just past the switch to nodes": ([0.5, 4, -12], [0, 0.6, 0.8]),
    "very far": ([100, 300, -4000], [0, 0, 1]),
    "far and cut": ([0, 0, -30], [1, 0, 0.001]),
}


@jax.jit
def irradiance_with_gradient(*arguments):
    def value(corner, u, v, point, normal):
        light = jv.RectangleLight(corner, u, v, jnp.ones(1, corner.dtype))
        return rectangle_irradiance(light, point, normal)[0]

    return jax.value_and_grad(value, argnums=range(5))(*arguments)


@pytest.mark.slow
@both_precisions
@pytest.mark.parametrize("name", RECEIVERS)
def test_rectangle_irradiance_and_gradient_against_fifty_digits(dtype, name):
    """The error is within some eps times the size over the distance, the size of the cancelling
    terms."""
    point, normal = RECEIVERS[name]
    light = jv.as_dtype(jv.RectangleLight(*LAMP, [1.0]), dtype)
    point, normal = jnp.asarray(point, dtype), jnp.asarray(normal, dtype)

    arguments = light.corner, light.edge_u, light.edge_v, point, normal
    got, pulled = irradiance_with_gradient(*arguments)
    numbers = [exact.vector(x) for x in arguments]
    truth = contour.irradiance(*numbers)
    offset = np.asarray(light.corner + 0.5 * (light.edge_u + light.edge_v) - point, float)
    distance, size = np.linalg.norm(offset), 1.0
    scale = min(1.0, size / distance)
    assert abs(float(exact.number(got) - truth)) <= 8 * eps(dtype) * max(scale, float(truth))
    slopes = np.array([float(x) for x in contour.gradient(*numbers)])
    nearest = max(abs(0.125 - float(point[2])), 1e-3) if distance < 2 else distance
    error = np.abs(np.concatenate([np.asarray(g, float) for g in pulled]) - slopes)
    assert error.max() <= 60 * eps(dtype) * max(1.0, 1 / nearest) * max(1.0, np.abs(slopes).max())


@jax.jit
def everything(light, point, normal):
    """Return the closed form, nodes, a sample and its density at one place, and the gradients of
    their sum."""

    def values(light, point, normal):
        dtype = point.dtype
        drawn = direction_sample(light, point, jnp.asarray([0.3, 0.6], dtype))
        material = jv.as_dtype(jv.Phong([0.2], [0.3], 50.0), dtype)
        wo = jnp.asarray([0.6, 0, 0.8], dtype)
        return (
            rectangle_irradiance(light, point, normal)[0],
            outgoing_radiance(material, [light], point, normal, wo, rule=jv.Quadrature(3))[0],
            drawn.irradiance[0],
            direction_pdf(light, point, drawn.direction),
        )

    found, pull = jax.vjp(values, light, point, normal)
    return found, pull(tuple(jnp.ones_like(x) for x in found))


@pytest.mark.slow
@single_first
@pytest.mark.parametrize(
    "where",
    {
        "on it": [0.0, 0.0, 0.125],
        "on its corner": [-0.5, 0.25, 0.125],
        "on its rim": [0.0, 0.375, 0.125],
        "in its plane": [5.0, 0.0, 0.125],
        "a hair below": [0.0, 0.0, 0.1249999],
        "behind": [0.0, 0.0, 1.0],
        "at a million": [1e6, 1e6, -1e6],
    }.items(),
    ids=lambda item: item[0],
)
def test_rectangle_lights_at_degenerate_places_are_finite(dtype, where):
    """Closed form, nodes, density and samples, from one program, are finite with their
    gradients."""
    light = jv.as_dtype(jv.RectangleLight(*LAMP, [1.0]), dtype)
    point, up = jnp.asarray(where[1], dtype), jnp.asarray([0, 0, 1], dtype)
    values, gradients = everything(light, point, up)
    assert_finite((values, gradients))
    assert all(x.dtype == dtype for x in values)
    if where[0] in ("on it", "on its corner", "on its rim", "in its plane", "behind"):
        assert values[0] == 0
    if where[0] == "a hair below":
        np.testing.assert_allclose(values[0], np.pi, rtol=1e-4)


def test_samples_of_a_distant_window():
    """The samples are uniform over a window that is much smaller than its distance."""
    far = jv.as_dtype(jv.Window([3e3, 5e3, 7e3], [0, 0.25, 0], [0.5, 0, 0]), jnp.float32)
    u = jnp.asarray([0.3, 0.6], jnp.float32)
    _, _, solid_angle, place = window_sample(far, jnp.zeros(3, jnp.float32), u)
    np.testing.assert_allclose(place, u, rtol=1e-4)
    middle = np.asarray([3e3 + 0.25, 5e3 + 0.125, 7e3])
    seen_at = 0.125 * middle[2] / np.linalg.norm(middle) ** 3
    np.testing.assert_allclose(solid_angle, seen_at, rtol=1e-4)


@jax.jit
def look_up(light, point):
    return radiance_along(light, jv.Ray(point, jnp.asarray([0, 0, 1], point.dtype)))


@pytest.mark.slow
@both_precisions
def test_degenerate_rectangles_emit_nothing(dtype):
    up = jnp.asarray([0, 0, 1], dtype)
    for u, v in ([[1, 0, 0], [0, 0, 0]], [[0, 0, 0], [0, 0, 0]], [[1, 0, 0], [2, 0, 0]]):
        light = jv.as_dtype(jv.RectangleLight([0, 0, 1], u, v, [1.0]), dtype)
        point = jnp.zeros(3, dtype)
        values, gradients = everything(light, point, up)
        assert all(value == 0 for value in values)
        assert_finite(gradients)
        assert (look_up(light, point).radiance == 0).all()


# ------------------------------------------------ environments and light fields


look = jax.jit(jax.value_and_grad(lambda s, d: environment_radiance(s, d)[0], (0, 1)))


@pytest.mark.slow
@both_precisions
@pytest.mark.parametrize(
    "direction", [[0, 0, 1], [0, 0, -1], [-1, 0, 0], [1, 0, 0], [1e-20, 0, 1], [0, 0, 0]]
)
def test_environment_radiance_at_the_poles_and_the_seam(dtype, direction):
    sky = jv.as_dtype(jv.environment_map(np.arange(1.0, 25).reshape(4, 6, 1)), dtype)
    d = jnp.asarray(direction, dtype)
    value, gradient = look(sky, d)
    assert_finite((value, gradient))
    assert 1 <= value <= 24


@jax.jit
def draw(sky, point, u):
    drawn = direction_sample(sky, point, u)
    gradient = jax.grad(lambda s: direction_sample(s, point, u).irradiance[0])(sky)
    return drawn, direction_pdf(sky, point, drawn.direction), gradient


@pytest.mark.slow
@both_precisions
@pytest.mark.parametrize("u", [[0.0, 0.0], [1 - 2**-24, 1 - 2**-24], [0.5, 0.0]])
def test_environment_sampling_at_the_ends_of_the_unit_square(dtype, u):
    """Draws from a sun of one pixel among black rows have a finite density and gradient at the ends
    of the unit square."""
    picture = np.zeros((8, 16, 1))
    picture[2, 3] = 1e6
    sky = jv.as_dtype(jv.environment_map(picture), dtype)
    point = jnp.zeros(3, dtype)
    drawn, density, gradient = draw(sky, point, jnp.asarray(u, dtype))
    assert_finite((drawn, gradient))
    assert density >= 0


@pytest.mark.slow
@both_precisions
def test_all_lights_at_once_on_a_surface_seen_edge_on(dtype):
    field = jv.LightFieldLight(
        np.ones((1, 2, 1, 2, 1)),
        jv.Window([-1, 1, 1], [2, 0, 0], [0, -2, 0]),
        jv.Window([-9, 9, 2], [18, 0, 0], [0, -18, 0]),
    )
    lights = [
        jv.RectangleLight(*LAMP, [1.0]),
        jv.environment_map(np.ones((2, 4, 1))),
        field,
    ]
    lights, material = jv.as_dtype((lights, jv.Lambert([0.3])), dtype)
    point, up = jnp.zeros(3, dtype), jnp.asarray([0, 0, 1], dtype)
    grazing = jnp.asarray([1, 0, 1e-12], dtype)

    def total(lights, point, rule):
        summed = outgoing_radiance(material, lights, point, up, grazing, rule=rule)[0]
        mixed = lit_radiance(
            jax.random.key(0), material, lights[0], point, up, grazing, samples=4
        ).value[0]
        return summed + mixed

    for rule in (jv.Quadrature(2), jv.MonteCarlo(jax.random.key(1), 4)):
        value, gradient = jax.jit(jax.value_and_grad(partial(total, rule=rule), argnums=(0, 1)))(
            lights, point
        )
        assert value.dtype == dtype
        assert value > 0.3 * np.pi / 2
        assert_finite((value, gradient))


# ------------------------------------------------ a small flat light


@jax.jit
def from_small(light, point):
    def value(light, point):
        return incident(light, point).irradiance[0]

    return jax.value_and_grad(value, argnums=(0, 1))(light, point)


@both_precisions
@pytest.mark.parametrize(
    "point",
    [[0, 0, 2], [0, 0, 5], [3, 0, 2], [3, 0, 1.9999], [3e4, 1e4, 1.5], [1e-6, 0, 2 - 1e-6]],
    ids=["on it", "behind", "in its plane", "grazing", "grazing from afar", "a micrometre below"],
)
def test_small_light_against_fifty_digits(dtype, point):
    """E = I cos(theta) / d^2 is right within a few ulps beyond the rounding of the cosine."""
    light = jv.as_dtype(jv.SmallLight([0, 0, 2], [0, 0, -3], [2.0]), dtype)
    at = jnp.asarray(point, dtype)
    got, slopes = from_small(light, at)
    assert_finite((got, slopes))
    away = [b - a for a, b in zip(exact.vector(at), exact.vector(light.position), strict=True)]
    square = sum(x * x for x in away)
    truth = max(2 * away[2] / mp.sqrt(square) / square, 0) if square else mp.mpf(0)
    assert abs(float(exact.number(got) - truth)) <= 8 * eps(dtype) * float(truth)
    dark = jv.as_dtype(jv.SmallLight([0, 0, 2], [0, 0, 0], [2.0]), dtype)
    nothing, slopes = from_small(dark, at)
    assert nothing == 0
    assert_finite(slopes)
