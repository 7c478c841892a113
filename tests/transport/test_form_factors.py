"""Form factors against published numbers, conservation laws and brute-force quadrature."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mpmath import mp

from jaxvision.core._vector import Vec
from jaxvision.transport.radiosity import (
    parallel_exchange,
    parallel_rectangles,
    perpendicular_exchange,
    perpendicular_rectangles,
    point_to_polygon,
    polygon_to_polygon,
)

UNIT_SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
CEILING = UNIT_SQUARE[::-1] + np.array([0, 0, 1])
WALL = np.array([[0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]], float)


def scalars(*numbers):
    return [jnp.asarray(float(x)) for x in numbers]


def polygon(corners):
    return tuple(Vec(*jnp.asarray(corner)) for corner in corners)


def nodes(interval, count=24):
    x, w = np.polynomial.legendre.leggauss(count)
    low, high = interval
    return (low + high) / 2 + x * (high - low) / 2, w * (high - low) / 2


def by_quadrature(first, second, kernel):
    """Return the integral over four lengths by 24^4 Gauss-Legendre nodes."""
    (a, wa), (b, wb), (c, wc), (d, wd) = (nodes(side) for side in (*first, *second))
    values = kernel(*np.meshgrid(a, b, c, d, indexing="ij"))
    return np.einsum("abcd,a,b,c,d->", values, wa, wb, wc, wd)


def test_form_factors_of_the_unit_cube():
    """The form factors are those of Howell's catalogue, C-11 and C-14 at equal sides, to its eight
    digits."""
    opposite = parallel_rectangles(*scalars(1, 1, 1))
    adjoining = perpendicular_rectangles(*scalars(1, 1, 1))
    assert f"{float(opposite):.8f}" == "0.19982490"
    assert f"{float(adjoining):.8f}" == "0.20004378"
    assert abs(float(opposite + 4 * adjoining) - 1) <= 4 * np.finfo(float).eps


@pytest.mark.parametrize("sides", [(1, 1, 1), (0.3, 2, 5), (40, 1, 0.1), (1e-3, 1, 1)])
def test_form_factors_of_a_box_sum_to_one(sides):
    """The factors from the floor of any box to its lid and four walls sum to 1, to rounding."""
    width, depth, height = scalars(*sides)
    total = (
        parallel_rectangles(width, depth, height)
        + 2 * perpendicular_rectangles(width, depth, height)
        + 2 * perpendicular_rectangles(depth, width, height)
    )
    assert abs(float(total) - 1) <= 16 * np.finfo(float).eps


@pytest.mark.parametrize("sides", [(1, 2, 3), (1, 1e-4, 1e3), (0.1, 50, 0.2)])
def test_perpendicular_rectangles_are_reciprocal(sides):
    edge, width, other = scalars(*sides)
    there = width * perpendicular_rectangles(edge, width, other)
    back = other * perpendicular_rectangles(edge, other, width)
    np.testing.assert_allclose(there, back, rtol=4 * np.finfo(float).eps)


RECTANGLES = {
    "overlapping": ([[0, 1], [0, 1]], [[0.5, 2], [0.25, 0.75]], 1.0),
    "beside": ([[0, 0.2], [0, 0.1]], [[0.5, 0.7], [0.6, 0.7]], 0.5),
    "far": ([[0, 0.1], [0, 0.1]], [[3, 3.1], [0.2, 0.3]], 2.0),
}
exchanges = jax.jit(
    lambda a, b, gap: (parallel_exchange(a, b, gap), perpendicular_exchange(a, b + 0.3))
)


@pytest.mark.slow
@pytest.mark.parametrize("case", RECTANGLES)
def test_rectangles_at_any_place_against_quadrature(case):
    first, second, gap = RECTANGLES[case]
    a, b = np.array(first, float), np.array(second, float)

    def facing(x, y, u, v):
        return gap**2 / ((x - u) ** 2 + (y - v) ** 2 + gap**2) ** 2 / np.pi

    def standing(x, y, u, v):
        return y * v / ((x - u) ** 2 + y**2 + v**2) ** 2 / np.pi

    parallel, perpendicular = exchanges(jnp.asarray(a), jnp.asarray(b), jnp.asarray(gap))
    np.testing.assert_allclose(parallel, by_quadrature(a, b, facing), rtol=1e-11)
    np.testing.assert_allclose(perpendicular, by_quadrature(a, b + 0.3, standing), rtol=1e-11)
    swapped = exchanges(jnp.asarray(b), jnp.asarray(a), jnp.asarray(gap))[0]
    np.testing.assert_allclose(parallel, swapped, rtol=1e-13)


to_polygon = jax.jit(point_to_polygon)


def test_factors_from_a_point_in_a_closed_room_sum_to_one():
    """The factors from a point of the floor to lid and walls sum to 1."""
    floor_up, point = Vec(*scalars(0, 0, 1)), Vec(*scalars(0.3, 0.6, 0))
    walls = [CEILING, WALL]
    for _ in range(3):  # turned about the middle of the floor by 90 degrees each
        x, y, z = (walls[-1] - [0.5, 0.5, 0]).T
        walls.append(np.stack([-y, x, z], axis=-1) + np.array([0.5, 0.5, 0]))
    total = sum(float(to_polygon(point, floor_up, polygon(wall))) for wall in walls)
    assert abs(total - 1) < 1e-14
    assert float(to_polygon(point, floor_up, polygon(CEILING[::-1]))) == 0  # from behind


@pytest.mark.parametrize("height", [1.0, 4.9, 5.3, 50.0])
def test_a_point_below_a_corner_of_a_square(height):
    """The factor is that of Howell, B-4: an element parallel to a rectangle, below one of its
    corners."""
    up, origin = Vec(*scalars(0, 0, 1)), Vec(*scalars(0, 0, 0))
    x = 1 / height
    s = np.sqrt(1 + x * x)
    exact = 2 * x / s * np.arctan(x / s) / (2 * np.pi)
    got = to_polygon(origin, up, polygon(CEILING + np.array([0, 0, height - 1])))
    tolerance = 1e-13 if height < 5 else 0.3 / height**4
    np.testing.assert_allclose(got, exact, rtol=tolerance)


@cache
def quadrature(order):
    return jax.jit(partial(polygon_to_polygon, order=order))


@pytest.mark.slow
@pytest.mark.parametrize("other", ["lid", "wall"])
def test_quadrature_over_one_polygon_states_its_error(other):
    second = polygon(CEILING if other == "lid" else WALL)
    form = parallel_rectangles if other == "lid" else perpendicular_rectangles
    exact = form(*scalars(1, 1, 1))
    errors = []
    for order in (2, 4):
        got = quadrature(order)(polygon(UNIT_SQUARE), second)
        errors.append(abs(float(got.value - exact)))
        assert errors[-1] <= float(got.error)
    assert errors[1] < 1e-5
    assert errors[1] < errors[0] / 100


def test_quadrature_needs_two_nodes():
    with pytest.raises(ValueError, match="order must be a whole number of at least 2, got 1"):
        polygon_to_polygon(polygon(UNIT_SQUARE), polygon(CEILING), order=1)


@pytest.mark.parametrize("sides", [(1.0, 1.0, 1.0), (0.3, 2.0, 0.7), (3.0, 0.5, 0.2)])
def test_gradients_of_facing_rectangles_match_the_catalogue_formula(sides):
    """The gradients by each length agree with the formula in 30 digits."""

    def catalogue(width, height, gap):
        x, y = width / gap, height / gap
        r, s = mp.sqrt(1 + x * x), mp.sqrt(1 + y * y)
        logs = mp.log(r * s / mp.sqrt(1 + x * x + y * y))
        arcs = x * s * mp.atan(x / s) + y * r * mp.atan(y / r) - x * mp.atan(x) - y * mp.atan(y)
        return 2 * (logs + arcs) / (mp.pi * x * y)

    slopes = jax.grad(parallel_rectangles, (0, 1, 2))(*scalars(*sides))
    with mp.workdps(30):
        for order, slope in zip(np.eye(3, dtype=int).tolist(), slopes, strict=True):
            expected = float(mp.diff(catalogue, [mp.mpf(x) for x in sides], tuple(order)))
            np.testing.assert_allclose(slope, expected, rtol=1e-12)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("gap", [1e-4, 1e-6, 1e-8, 1e-12])
def test_gradients_of_nearly_touching_rectangles(gap, dtype):
    """For unit squares F = 1 - 2 g - (g^2 ln(g) ...), so the derivative by the gap tends to -2."""
    one, gap = jnp.asarray(1, dtype), jnp.asarray(gap, dtype)
    slopes = jax.grad(parallel_rectangles, (0, 1, 2))(one, one, gap)
    near = 5 * gap * (1 - jnp.log(gap))
    np.testing.assert_allclose(slopes[2], -2, atol=1e-5 + near)
    np.testing.assert_allclose(slopes[:2], gap, rtol=1e-5 + near)
