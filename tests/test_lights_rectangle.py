"""The rectangular light: its exact irradiance, its samples, and what lies behind it."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxvision import InputError, MonteCarlo, Quadrature, Ray, RectangleLight, as_dtype, as_vec
from jaxvision.lights import (
    direction_pdf,
    direction_sample,
    incident,
    incident_samples,
    irradiance,
    radiance_from,
    seen,
)
from jaxvision.lights.orders import ORDERS, order_for
from jaxvision.lights.polygon import rectangle_irradiance

quick_jit = partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})
# 1 x 1 m above the origin, shining down
LAMP = RectangleLight([-0.5, 0.5, 0], [1, 0, 0], [0, -1, 0], [1.0, 2.0])
UP = jnp.asarray([0.0, 0, 1])
exact = quick_jit(rectangle_irradiance)


def below(height, x=0.0, y=0.0):
    return jnp.asarray([x, y, -height])


@pytest.mark.parametrize(("a", "b", "h"), [(1.0, 1.0, 1.0), (0.3, 2.0, 0.7), (3.0, 0.1, 0.05)])
def test_under_a_corner_it_is_the_catalogues_form_factor(a, b, h):
    """Howell, A Catalog of Radiation Heat Transfer Configuration Factors, B-4: from a plane element
    to a parallel rectangle, the element's normal through a corner."""
    x, y = a / h, b / h
    factor = (
        x / np.sqrt(1 + x * x) * np.arctan(y / np.sqrt(1 + x * x))
        + y / np.sqrt(1 + y * y) * np.arctan(x / np.sqrt(1 + y * y))
    ) / (2 * np.pi)
    lamp = RectangleLight([0, b, 0], [a, 0, 0], [0, -b, 0], [3.0])
    got = exact(lamp, below(h), UP)
    np.testing.assert_allclose(got, 3 * np.pi * factor, rtol=1e-13)


@pytest.mark.parametrize("normal", [[0, 0, 1.0], [0.6, 0, 0.8], [-0.48, 0.6, -0.64]])
def test_inside_a_luminous_box_any_receiver_gets_pi(normal):
    """Six walls of radiance 1 all round: pi for every place and tilt, horizon cuts included."""
    walls = []
    for axis in range(3):
        u, v, w = (np.roll(np.eye(3), axis, axis=0)[i] for i in range(3))
        size = np.array([2.0, 3.0, 4.0])
        low = RectangleLight(0 * w, size * u, size * v, [1.0])
        high = RectangleLight(size * w + size * v, size * u, -size * v, [1.0])
        walls += [low, high]
    point = jnp.asarray([0.3, 1.9, 2.2])
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *walls)
    each = jax.vmap(lambda wall: exact(wall, point, jnp.asarray(normal)))(stacked)
    np.testing.assert_allclose(each.sum(), np.pi, rtol=1e-13)
    assert (each >= 0).all()


def test_power_through_a_plane_below_is_what_the_light_emits():
    """pi L A, all of it: in z = -1, by r = tan(t) and the trapezium rule around the axis."""
    s, w = np.polynomial.legendre.leggauss(32)
    t, phi = (s + 1) * np.pi / 4, 2 * np.pi * np.arange(32) / 32
    r, weight = np.tan(t), w * np.pi / 4 * np.tan(t) / np.cos(t) ** 2 * 2 * np.pi / 32
    points = jnp.asarray([[i * np.cos(j), i * np.sin(j), -1.0] for i in r for j in phi])
    field = jax.vmap(lambda p: exact(LAMP, p, UP)[0])(points).reshape(32, 32)
    np.testing.assert_allclose(weight @ np.asarray(field).sum(axis=1), np.pi, rtol=1e-9)


@pytest.mark.parametrize(
    ("point", "normal"),
    [([0, 0, 1.0], [0, 0, -1.0]), ([2, 0, 0.0], [-1.0, 0, 0]), ([0.1, 0.2, 0], [0, 0, 1.0])],
    ids=["behind", "in its plane", "on it"],
)
def test_no_light_behind_in_the_plane_or_on_it(point, normal):
    point, normal = jnp.asarray(point), jnp.asarray(normal)
    assert (exact(LAMP, point, normal) == 0).all()
    assert (irradiance(LAMP, point, normal, rule=Quadrature(3)) == 0).all()


@pytest.mark.parametrize("kind", [jnp.asarray, as_vec], ids=["array", "Vec"])
def test_quadrature_and_random_samples_find_the_exact_irradiance(kind):
    point, normal = below(0.6, 0.4, -0.3), jnp.asarray([0.36, 0.48, 0.8])
    truth = exact(LAMP, point, normal)
    by_nodes = irradiance(LAMP, kind(point), kind(normal), rule=Quadrature(12))
    np.testing.assert_allclose(by_nodes, truth, rtol=1e-7)
    drawn = irradiance(LAMP, kind(point), normal, rule=MonteCarlo(jax.random.key(0), 4096))
    np.testing.assert_allclose(drawn, truth, rtol=2e-3)


def test_random_samples_are_unbiased():
    point = below(0.3, 0.2)
    rules = jax.vmap(lambda key: irradiance(LAMP, point, UP, rule=MonteCarlo(key, 8))[0])
    means = quick_jit(rules)(jax.random.split(jax.random.key(3), 2000))
    error = means.std() / np.sqrt(2000)
    assert abs(means.mean() - exact(LAMP, point, UP)[0]) < 4 * error
    assert error < 2e-3 * means.mean()


@pytest.mark.parametrize("height", [0.1, 0.25, 1.0, 20.0])
@pytest.mark.parametrize("tolerance", [1e-3, 1e-5])
def test_the_order_follows_distance_over_size(height, tolerance):
    """Receivers under the whole light, float64: the order asked for is enough, and no more than
    twice a side what is needed."""
    points = jnp.asarray([[x, y, -height] for x in (0.0, 0.3, 0.5) for y in (0.0, 0.45)])
    order = order_for(LAMP, points, tolerance=tolerance)
    truth = quick_jit(jax.vmap(lambda p: rectangle_irradiance(LAMP, p, UP)[0]))(points)

    def worst(order):
        rule = Quadrature(order)
        got = quick_jit(jax.vmap(lambda p: irradiance(LAMP, p, UP, rule=rule)[0]))(points)
        return float(jnp.abs(got / truth - 1).max())

    assert worst(order) <= tolerance
    smaller = [o for o in ORDERS if 2 * o < order]
    assert not smaller or worst(smaller[-1]) > tolerance


def test_a_tolerance_out_of_reach_is_named():
    """Where the tables of orders end: 2 mm below, the kernel is near singular."""
    assert order_for(LAMP, below(0.002), tolerance=1e-6) == ORDERS[-1]
    with pytest.raises(InputError, match=r"1e-12 needs quadrature of order \d+, above .* 32"):
        order_for(LAMP, below(0.002), tolerance=1e-12)


@pytest.mark.parametrize("height", [0.1, 0.5, 30.0])
def test_density_is_that_of_the_samples(height):
    """Radiance / density is the sample's weight, and the weights integrate the direction itself
    over the window."""
    point = below(height, 0.3, -0.7)
    u = jax.random.uniform(jax.random.key(1), (256, 2))

    def weigh(u):
        drawn = direction_sample(LAMP, point, u)
        wi = drawn.direction
        return drawn, direction_pdf(LAMP, point, wi), radiance_from(LAMP, point, wi)

    drawn, density, arriving = quick_jit(jax.vmap(weigh))(u)
    np.testing.assert_allclose(arriving / density[:, None], drawn.irradiance, rtol=1e-9)
    # the integral of wi over the light, which has a closed form too
    arriving = incident_samples(LAMP, point, Quadrature(32))
    vector = [(exact(LAMP, point, n) - exact(LAMP, point, -n))[0] for n in jnp.eye(3)]
    moments = (arriving.direction * arriving.irradiance[:, :1]).sum(axis=0)
    np.testing.assert_allclose(moments, vector, rtol=1e-6, atol=1e-9)


def test_a_ray_sees_the_front_only():
    up, down = jnp.asarray([0.0, 0, 1]), jnp.asarray([0.0, 0, -1])
    front = seen(LAMP, Ray(below(2.0, 0.4), up))
    assert front.distance == 2
    np.testing.assert_array_equal(front.radiance, [1, 2])
    for ray in (Ray(-below(2.0), down), Ray(below(2.0, 0.6), up), Ray(below(2.0), down)):
        miss = seen(LAMP, ray)
        assert jnp.isinf(miss.distance)
        assert (miss.radiance == 0).all()


def test_one_place_only_is_asked_of_lights_at_one_place():
    with pytest.raises(ValueError, match=r"light at one place, got RectangleLight"):
        incident(LAMP, UP)
    with pytest.raises(ValueError, match=r"edge_u must have shape \(3\), got \(2,"):
        RectangleLight([0, 0, 0], [1, 0], [0, 1, 0], [1.0])
    with pytest.raises(ValueError, match=r"Quadrature.order must be at least 1, got 0"):
        Quadrature(0)


def test_near_light_in_float32():
    """A quarter of its side away: 1e-4 is the aim."""
    lamp = as_dtype(LAMP, jnp.float32)
    points = jnp.asarray(
        [[x, y, -0.25] for x in np.linspace(-1, 1, 9) for y in (0.0, 0.5)], jnp.float32
    )
    up = UP.astype(jnp.float32)
    truth = jax.vmap(exact, in_axes=(None, 0, None))(LAMP, points.astype(jnp.float64), UP)
    closed = jax.vmap(exact, in_axes=(None, 0, None))(lamp, points, up)
    nodes = quick_jit(jax.vmap(lambda p: irradiance(lamp, p, up, rule=Quadrature(8))))(points)
    assert closed.dtype == nodes.dtype == jnp.float32
    np.testing.assert_allclose(closed, truth, rtol=1e-6)
    np.testing.assert_allclose(nodes, truth, rtol=1e-4)
