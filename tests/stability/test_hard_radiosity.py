"""Form factors where the textbook's expressions lose every digit: tiny, huge and unequal sides; in
both precisions, against 50 digits, with finite gradients.
"""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from oracles import exact
from precisions import both_precisions

from jaxvision import as_vec
from jaxvision.transport.radiosity import (
    parallel_exchange,
    parallel_rectangles,
    perpendicular_exchange,
    perpendicular_rectangles,
    point_to_polygon,
)


@pytest.mark.sweep
@both_precisions
@pytest.mark.parametrize("form", [parallel_rectangles, perpendicular_rectangles])
@pytest.mark.parametrize("sizes", [(0, 1, 1), (1, 0, 1), (1, 1, 0), (0, 0, 0), (1e30, 1, 1e-30)])
def test_form_factors_without_area_or_gap(form, sizes, dtype):
    arguments = [jnp.asarray(size, dtype) for size in sizes]
    value, pulled = jax.jit(jax.value_and_grad(form, argnums=(0, 1, 2)))(*arguments)
    assert 0 <= value <= 1
    assert all(jnp.isfinite(gradient) for gradient in pulled)


def corner_sum(first, second, corner):
    """Return the sum over sixteen signed corners, with enough digits for the cancellation."""
    total = mp.mpf(0)
    for i in range(2):
        for j in range(2):
            for k in range(2):
                for m in range(2):
                    term = corner(first[0][i] - second[0][k], first[1][j], second[1][m])
                    total += (-1) ** (i + j + k + m) * term
    return total


def parallel_truth(first, second, gap):
    """Return the exchange area of two parallel rectangles by C-13, m^2."""
    c = exact.number(gap)

    def corner(u, y, v):
        v = y - v
        p, q = mp.sqrt(u * u + c * c), mp.sqrt(v * v + c * c)
        angles = v * p * mp.atan(v / p) + u * q * mp.atan(u / q)
        return (angles - c * c / 2 * mp.log(u * u + v * v + c * c)) / (2 * mp.pi)

    return corner_sum(*digits_of(first, second), corner)


def perpendicular_truth(first, second):
    """Return the exchange area of two perpendicular rectangles by C-15, m^2."""

    def corner(u, y, z):
        r, square = mp.sqrt(y * y + z * z), u * u + y * y + z * z
        return (u * r * mp.atan(u / r) + (u * u - r * r) / 4 * mp.log(square)) / (2 * mp.pi)

    return corner_sum(*digits_of(first, second), corner)


def digits_of(*rectangles):
    return [[[exact.number(x) for x in row] for row in np.asarray(r)] for r in rectangles]


UNEQUAL = {
    "a small one over a wide one": ([[0.3, 0.301], [0.5, 0.502]], [[0, 1], [0.1, 1.1]], 0.05),
    "a small one beside a wide one": ([[2.0, 2.01], [0.5, 0.51]], [[0, 1], [0.1, 1.1]], 0.3),
    "almost in one plane": ([[0.43, 0.46], [0.02, 0.05]], [[0, 0.1], [0.1, 0.2]], 0.01),
    "a strip beside a speck": ([[0.1, 0.11], [0.1, 1.5]], [[0.6, 0.601], [0.2, 0.201]], 0.2),
}


@pytest.mark.slow
@pytest.mark.sweep
@both_precisions
@pytest.mark.parametrize("case", UNEQUAL)
def test_form_factors_of_rectangles_of_unequal_size(case, dtype):
    """The form factors are right in float32; plain differences of the corner terms err by up to
    nine times the value."""
    first, second, gap = UNEQUAL[case]
    first, second = (jnp.asarray(r, dtype) for r in (first, second))
    gap = jnp.asarray(gap, dtype)
    standing = jnp.asarray([second[0], second[1] + gap])
    close = 1e-3 if dtype == jnp.float32 else 1e-9
    for value, truth in (
        (jax.jit(parallel_exchange)(first, second, gap), parallel_truth(first, second, gap)),
        (
            jax.jit(perpendicular_exchange)(first, standing),
            perpendicular_truth(first, standing),
        ),
    ):
        assert value.dtype == dtype
        assert abs(exact.number(value) / truth - 1) < close


@pytest.mark.slow
@pytest.mark.sweep
@both_precisions
@pytest.mark.parametrize("apart", [0.0, 0.5, 1.9, 2.6, 8.0, 13.0, 1000.0])
def test_form_factors_of_patches_at_any_distance(apart, dtype):
    """Two patches of 0.1 m, shifted by `apart` of their size in planes 0.1 m apart, have the
    50-digit form factor."""
    first = jnp.asarray([[0.0, 0.1], [0.0, 0.1]], dtype)
    second = first + jnp.asarray([[0.1 * apart], [0.0]], dtype)
    gap = jnp.asarray(0.1, dtype)
    value, pulled = jax.jit(jax.value_and_grad(parallel_exchange, argnums=(0, 1, 2)))(
        first, second, gap
    )
    assert all(jnp.isfinite(gradient).all() for gradient in pulled)
    truth = parallel_truth(first, second, gap)
    assert abs(exact.number(value) / truth - 1) < (1e-4 if dtype == jnp.float32 else 1e-9)


@pytest.mark.slow
@both_precisions
def test_perpendicular_patches_that_touch_or_lie_below_the_plane(dtype):
    floor = jnp.asarray([[0.0, 1.0], [0.0, 1.0]], dtype)
    exchange = jax.jit(jax.value_and_grad(perpendicular_exchange))
    for wall in ([[0.0, 1.0], [-1.0, 1.0]], [[1.0, 2.0], [0.0, 1.0]], [[0.0, 1.0], [-1.0, -0.5]]):
        value, gradient = exchange(floor, jnp.asarray(wall, dtype))
        assert jnp.isfinite(value) & jnp.isfinite(gradient).all()
    assert value == 0  # all of it below the floor
    behind, _ = exchange(floor, jnp.asarray([[0.0, 1.0], [-1.0, 1.0]], dtype))
    np.testing.assert_allclose(behind, exchange(floor, floor)[0], rtol=1e-6)


@pytest.mark.slow
@both_precisions
@pytest.mark.parametrize("height", [0.0, 1e-6, 1e-3, 1.0, 1e4])
def test_degenerate_triangle_seen_from_near_and_far(height, dtype):
    """For a triangle with a repeated corner, and a point above it, on it and far away, the form
    factor is finite and within [0, 1]."""
    corners = [[0, 0, 0], [0, 1, 0], [1, 0, 0], [1, 0, 0]]
    triangle = tuple(as_vec(jnp.asarray(corner, dtype)) for corner in corners)
    point, up = (as_vec(jnp.asarray(v, dtype)) for v in ([0.0, 0.0, -height], [0.0, 0.0, 1.0]))
    value, pulled = jax.jit(jax.value_and_grad(point_to_polygon, argnums=(0, 1, 2)))(
        point, up, triangle
    )
    assert 0 <= value <= 1
    assert all(jnp.isfinite(leaf) for leaf in jax.tree.leaves(pulled))
