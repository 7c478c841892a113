"""Tests the rectangular light: its exact irradiance, its samples, and points behind it."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvision as jv
from jaxvision.lights import (
    direction_pdf,
    direction_sample,
    incident,
    incident_samples,
    irradiance,
    radiance_along,
    radiance_from,
)
from jaxvision.lights.adaptive import adaptive_irradiance
from jaxvision.lights.orders import ORDERS, order_for
from jaxvision.lights.polygon import nodes_integral, rectangle_irradiance

# 1 x 1 m above the origin, shining down
LAMP = jv.RectangleLight([-0.5, 0.5, 0], [1, 0, 0], [0, -1, 0], [1.0, 2.0])
UP = jnp.asarray([0.0, 0, 1])
exact = jax.jit(rectangle_irradiance)


def below(height, x=0.0, y=0.0):
    return jnp.asarray([x, y, -height])


@pytest.mark.parametrize(("a", "b", "h"), [(1.0, 1.0, 1.0), (0.3, 2.0, 0.7), (3.0, 0.1, 0.05)])
def test_irradiance_under_a_corner_is_the_catalogues_form_factor(a, b, h):
    """The reference is Howell, A Catalog of Radiation Heat Transfer Configuration Factors, B-4."""
    x, y = a / h, b / h
    factor = (
        x / np.sqrt(1 + x * x) * np.arctan(y / np.sqrt(1 + x * x))
        + y / np.sqrt(1 + y * y) * np.arctan(x / np.sqrt(1 + y * y))
    ) / (2 * np.pi)
    lamp = jv.RectangleLight([0, b, 0], [a, 0, 0], [0, -b, 0], [3.0])
    got = exact(lamp, below(h), UP)
    np.testing.assert_allclose(got, 3 * np.pi * factor, rtol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [jnp.asarray, jv.as_vec], ids=["array", "Vec"])
def test_quadrature_and_random_samples_find_the_exact_irradiance(kind):
    point, normal = below(0.6, 0.4, -0.3), jnp.asarray([0.36, 0.48, 0.8])
    truth = exact(LAMP, point, normal)
    by_nodes = irradiance(LAMP, kind(point), kind(normal), rule=jv.Quadrature(12))
    np.testing.assert_allclose(by_nodes, truth, rtol=1e-7)
    drawn = irradiance(LAMP, kind(point), normal, rule=jv.MonteCarlo(jax.random.key(0), 4096))
    np.testing.assert_allclose(drawn, truth, rtol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("height", [0.1, 0.25, 1.0, 20.0])
@pytest.mark.parametrize("tolerance", [1e-3, 1e-5])
def test_the_order_depends_on_distance_over_size(height, tolerance):
    """The receivers are below the whole light, in float64."""
    points = jnp.asarray([[x, y, -height] for x in (0.0, 0.3, 0.5) for y in (0.0, 0.45)])
    order = order_for(LAMP, points, tolerance=tolerance)
    truth = jax.jit(jax.vmap(lambda p: rectangle_irradiance(LAMP, p, UP)[0]))(points)

    def worst(order):
        rule = jv.Quadrature(order)
        got = jax.jit(jax.vmap(lambda p: irradiance(LAMP, p, UP, rule=rule)[0]))(points)
        return float(jnp.abs(got / truth - 1).max())

    assert worst(order) <= tolerance
    smaller = [o for o in ORDERS if 2 * o < order]
    assert not smaller or worst(smaller[-1]) > tolerance


def test_the_order_of_a_rule_is_an_integer():
    for wrong in (0, -3, True):
        with pytest.raises(ValueError, match=r"Quadrature\.order must be a whole number of at lea"):
            jv.Quadrature(wrong)
    with pytest.raises(ValueError, match=r"MonteCarlo\.samples must be a whole number"):
        jv.MonteCarlo(jax.random.key(0), 0)


def test_a_tolerance_out_of_reach_is_named():
    """The tables of orders end at 32. At 2 mm below, the kernel is nearly singular."""
    assert order_for(LAMP, below(0.002), tolerance=1e-6) == ORDERS[-1]
    with pytest.raises(jv.InputError, match=r"1e-12 needs quadrature of order \d+, above .* 32"):
        order_for(LAMP, below(0.002), tolerance=1e-12)


LONG_LAMP = jv.RectangleLight([-0.5, 0.1, 0], [1, 0, 0], [0, -0.2, 0], [1.0])  # shining down


def receivers(count):
    """Return receivers within 40 lengths of a lamp, near and far, with any tilt that receives
    light."""
    rng = np.random.default_rng(4)
    places, normals = rng.standard_normal((2, count, 3))
    places[:, 2] = -np.abs(places[:, 2])
    places *= np.exp(rng.uniform(np.log(0.05), np.log(40), (count, 1)))
    normals = normals / np.linalg.norm(normals, axis=1)[:, None] + [0, 0, 0.5]
    return places, normals / np.linalg.norm(normals, axis=1)[:, None]


@pytest.mark.slow
@pytest.mark.parametrize("tolerance", [1e-3, 1e-6])
def test_each_receiver_gets_the_nodes_that_it_needs(tolerance):
    """Each receiver alone is within the tolerance of its own irradiance or, at grazing angles, of
    the irradiance that it would have facing the light."""
    places, normals = receivers(4000)

    def alone(point, normal):
        nodes = adaptive_irradiance(LONG_LAMP, point[None], normal[None], tolerance=tolerance)
        return nodes[0, 0], rectangle_irradiance(LONG_LAMP, point, normal)[0]

    got, truth = jax.jit(jax.vmap(alone))(*map(jnp.asarray, (places, normals)))
    lit = truth > 0
    facing = 0.2 * -places[:, 2] / (places**2).sum(axis=1) ** 1.5
    error = np.abs(got - truth)[lit]
    assert 0.1 < (error == 0).mean() < 0.9  # closed form, and nodes
    assert (error <= tolerance * np.maximum(facing, truth)[lit]).all()
    assert np.quantile(error / truth[lit], 0.995) < tolerance


@pytest.mark.slow
def test_receivers_together_use_the_finest_rule_needed():
    """Distant receivers alone use four nodes, with errors before the tenth digit."""
    far = np.array([[x, 0.3, -9.0] for x in (-1.0, 0.0, 2.0)])
    loose = jax.jit(partial(adaptive_irradiance, tolerance=1e-2))

    def error(places, normals):
        places, normals = jnp.asarray(places), jnp.asarray(normals, float)
        lit = jax.vmap(exact, in_axes=(None, 0, 0))(LAMP, places, normals)
        return np.abs(loose(LAMP, places, normals) - lit)[:3]

    up = np.tile([0.0, 0, 1], (4, 1))
    assert (error(far, up[:3]) > 1e-8).all()
    assert (error([*far, [0, 0, -0.1]], up) < 1e-13).all()
    assert (error([*far, [0, 0, -20]], [*up[:3], [1, 0, 0]]) < 1e-13).all()
    behind = loose(LAMP, jnp.asarray([[0.0, 0, 40]]), -UP)
    assert (behind == 0).all()
    with pytest.raises(ValueError, match=r"tolerance must be above 0, got 0"):
        adaptive_irradiance(LAMP, jnp.asarray(far), UP, tolerance=0.0)


def test_the_gradient_of_nodes_equals_numpys_difference():
    """With two nodes on each side, the gradient is by the corner, both edges and the normal."""
    places, weights = np.polynomial.legendre.leggauss(2)
    numbers = np.array([[-0.5, -0.3, 2.0], [0.1, 1.2, 0.2], [0.9, 0.0, 0.1], [0.0, 0.28, 0.96]])

    def by_numpy(numbers):
        corner, u, v, normal = numbers.reshape(4, 3)
        total = 0.0
        for s, a in zip((places + 1) / 2, weights / 2, strict=True):
            for t, b in zip((places + 1) / 2, weights / 2, strict=True):
                way = corner + s * u + t * v
                total += a * b * (normal @ way) * -(np.cross(u, v) @ corner) / (way @ way) ** 2
        return total

    def ours(corner, u, v, normal):
        return nodes_integral(*(jv.as_vec(x) for x in (corner, u, v, normal)), order=2)

    steps = 1e-5 * np.eye(12)
    slopes = [(by_numpy(numbers.ravel() + d) - by_numpy(numbers.ravel() - d)) / 2e-5 for d in steps]
    value, gradients = jax.value_and_grad(ours, argnums=(0, 1, 2, 3))(*jnp.asarray(numbers))
    assert float(value) == pytest.approx(by_numpy(numbers), rel=1e-13)
    np.testing.assert_allclose(np.concatenate(gradients), slopes, rtol=1e-8, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("height", [0.1, 0.5, 30.0])
def test_density_equals_that_of_the_samples(height):
    """Radiance / density is the sample's weight, and the weights integrate the direction over the
    window."""
    point = below(height, 0.3, -0.7)
    u = jax.random.uniform(jax.random.key(1), (256, 2))

    def weigh(u):
        drawn = direction_sample(LAMP, point, u)
        wi = drawn.direction
        return drawn, direction_pdf(LAMP, point, wi), radiance_from(LAMP, point, wi)

    drawn, density, arriving = jax.jit(jax.vmap(weigh))(u)
    np.testing.assert_allclose(arriving / density[:, None], drawn.irradiance, rtol=1e-9)
    np.testing.assert_allclose(drawn.density, density, rtol=1e-9)
    # the integral of wi over the light, which has a closed form, too
    arriving = jax.jit(lambda p: incident_samples(LAMP, p, jv.Quadrature(32)))(point)
    vector = [(exact(LAMP, point, n) - exact(LAMP, point, -n))[0] for n in np.eye(3)]
    moments = (arriving.direction * arriving.irradiance[:, :1]).sum(axis=0)
    np.testing.assert_allclose(moments, vector, rtol=1e-6, atol=1e-9)


def test_a_ray_sees_the_front_only():
    up, down = jnp.asarray([0.0, 0, 1]), jnp.asarray([0.0, 0, -1])
    front = radiance_along(LAMP, jv.Ray(below(2.0, 0.4), up))
    assert front.distance == 2
    np.testing.assert_array_equal(front.radiance, [1, 2])
    for ray in (jv.Ray(-below(2.0), down), jv.Ray(below(2.0, 0.6), up), jv.Ray(below(2.0), down)):
        miss = radiance_along(LAMP, ray)
        assert jnp.isinf(miss.distance)
        assert (miss.radiance == 0).all()


def test_incident_is_refused_for_extended_lights():
    with pytest.raises(ValueError, match=r"light at one place, got RectangleLight"):
        incident(LAMP, UP)
    with pytest.raises(ValueError, match=r"edge_u must have shape \(3,\), got \(2,"):
        jv.RectangleLight([0, 0, 0], [1, 0], [0, 1, 0], [1.0])
    with pytest.raises(ValueError, match=r"Quadrature.order must be a whole number .* got 0"):
        jv.Quadrature(0)


@pytest.mark.slow
def test_a_highlight_of_exponent_1000_has_the_stated_error():
    """The highlight is in the centre of the lamp, near its edge and across it, as far away as the
    lamp is wide."""
    viewers = np.array([[0.1, 0.05, 1], [0.45, 0.1, 1], [0.52, 0, 1]])
    viewers /= np.linalg.norm(viewers, axis=1)[:, None]
    x, weight = (a / 2 for a in np.polynomial.legendre.leggauss(600))
    x, y = np.meshgrid(x, x)
    square = x * x + y * y + 1
    cosine = [(wo[2] - wo[0] * x - wo[1] * y) / np.sqrt(square) for wo in viewers]
    lobe = 0.5 * np.maximum(cosine, 0) ** 1000 / square**1.5
    truth = np.einsum("i,j,kij->k", weight, weight, lobe)
    lamp = jv.RectangleLight([-0.5, 0.5, 1], [1, 0, 0], [0, -1, 0], [1.0])
    material, point = jv.Phong([0.0], [0.5], 1000.0), jnp.zeros(3)

    def shaded(wo, rule):
        return jv.outgoing_radiance(material, [lamp], point, UP, wo, rule=rule)[0]

    for order, error in ((24, 6e-3), (32, 5e-4)):
        by_nodes = jax.vmap(partial(shaded, rule=jv.Quadrature(order)))(jnp.asarray(viewers))
        np.testing.assert_allclose(by_nodes, truth, rtol=error)

    def drawn(key):
        return jax.vmap(lambda wo: shaded(wo, jv.Balanced(key, 32)))(jnp.asarray(viewers))

    draws = np.asarray(jax.jit(jax.vmap(drawn))(jax.random.split(jax.random.key(0), 256)))
    assert (np.abs(draws.mean(axis=0) - truth) < 4 * draws.std(axis=0) / 16).all()


def _form_factor(h):
    """Return the form factor of a square of side 1 from a point below its centre: four times
    Howell's B-4 of a corner."""
    x = 0.5 / h
    return 4 * 2 * x / np.sqrt(1 + x * x) * np.arctan(x / np.sqrt(1 + x * x)) / (2 * np.pi)


@pytest.mark.sweep
@pytest.mark.parametrize("height", [0.01, 1e-6])
def test_a_light_much_wider_than_its_distance_is_named(height):
    lamp = jv.RectangleLight([-0.5, 0.5, 0], [1, 0, 0], [0, -1, 0], [1 / np.pi])
    with pytest.warns(UserWarning, match=f"lights.0. at {height:g} m from it, where its") as said:
        found = irradiance(lamp, below(height), UP, rule=jv.Quadrature(8))
    true = _form_factor(height)
    assert abs(float(found[0]) / true - 1) > 0.1
    words = next(str(one.message) for one in said if "irradiance is" in str(one.message))
    assert float(words.split("irradiance is ")[1].split()[0]) == pytest.approx(true, rel=5e-3)
    assert float(words.split("finds ")[1].split(",")[0]) == pytest.approx(float(found[0]), rel=5e-3)
    exact_one = float(rectangle_irradiance(lamp, below(height), UP)[0])  # the advised value
    assert exact_one == pytest.approx(true, rel=1e-12)


@pytest.mark.parametrize(
    ("height", "order"), [(0.05, 8), pytest.param(0.01, 32, marks=pytest.mark.slow)]
)
def test_a_light_with_an_accurate_quadrature_is_not_named(height, order):
    lamp = jv.RectangleLight([-0.5, 0.5, 0], [1, 0, 0], [0, -1, 0], [1 / np.pi])
    found = irradiance(lamp, below(height), UP, rule=jv.Quadrature(order))
    assert float(found[0]) == pytest.approx(_form_factor(height), rel=0.02)
