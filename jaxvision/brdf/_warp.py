"""Maps of uniform numbers in the unit square to samples of a tabulated density, and their inverse.

The density is tabulated at equally spaced nodes of the square, rows (y) by columns (x), and is
bilinear between the nodes. There is one such table for each node of a direction (phi, theta), and
the density is linear between these directions. Rows are drawn from the marginal density, and
columns from the conditional density. Because each density is piecewise linear, a draw solves a
quadratic equation, and `unwarp` inverts `warp` exactly. Source: Dupuy & Jakob, "An Adaptive
Parameterization for Efficient Material Acquisition and Rendering", 2018, section 4.2.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..core._loops.fusion import one_program
from ..core._numerics import divide, running_sum, safe_sqrt
from ..core._types import Scalar
from ..core.parallel_loops import fori_loop
from ._interpolation import interpolation_weights, place_in_unit

Slices = list[tuple[tuple[Int[Array, ""], Int[Array, ""]], Scalar]]
Square = tuple[Scalar, Scalar]


class Warp(eqx.Module):
    """A density tabulated over the unit square for several directions, with running integrals.

    `phi`: (p,), `theta`: (t,) rad, increasing nodes of the direction, which is clamped to them.
    `density`: (p, t, rows, columns), with integral 1 over the square for each direction.
    `conditional`: (p, t, rows, columns), the integral of the density along x up to each node.
    `marginal`: (p, t, rows), the integral of the density over all x and over y up to each row.
    """

    phi: Float[Array, " p"]
    theta: Float[Array, " t"]
    density: Float[Array, "p t rows columns"]
    conditional: Float[Array, "p t rows columns"]
    marginal: Float[Array, "p t rows"]


def _running_integral(values: Float[Array, "... n"]) -> Float[Array, "... n"]:
    """Return the integrals over [0, x_j] of a piecewise linear function with equally spaced nodes
    x_j on [0, 1]."""
    cells = (values[..., 1:] + values[..., :-1]) / (2 * (values.shape[-1] - 1))
    return jnp.concatenate([jnp.zeros_like(values[..., :1]), running_sum(cells)], axis=-1)


@jax.jit
def tabulated_warp(
    phi: Float[Array, " p"], theta: Float[Array, " t"], density: Float[Array, "p t rows columns"]
) -> Warp:
    """Normalise a tabulated density >= 0 and return the map to its samples. Where the table is 0
    for a direction, the density is uniform."""
    total = _running_integral(_running_integral(density)[..., -1])[..., -1][..., None, None]
    density = divide(density, total, otherwise=1)
    conditional = _running_integral(density)
    return Warp(phi, theta, density, conditional, _running_integral(conditional[..., -1]))


def slices(w: Warp, phi: Scalar, theta: Scalar) -> Slices:
    """Return the tabulated directions next to (phi, theta) and their interpolation weights, which
    sum to 1. There are four such directions, or two if phi or theta has a single node."""
    return [
        ((p, t), wp * wt)
        for p, wp in interpolation_weights(w.phi, phi)
        for t, wt in interpolation_weights(w.theta, theta)
    ]


def interpolate_table(
    table: Float[Array, "..."], at: Slices, *index: Int[Array, ""] | int
) -> Array:
    """Return the entry `index` of a table (p, t, ...), interpolated between directions with weights
    `at`."""
    return sum(
        weight * table.at[(*slot, *index)].get(mode="promise_in_bounds") for slot, weight in at
    )  # pyright: ignore[reportReturnType]


def bilinear(table: Float[Array, "p t rows columns *rest"], at: Slices, position: Square) -> Array:
    """Interpolate a table (p, t, rows, columns, ...) to the direction with weights `at` and to a
    position (x, y) of the unit square. The result has the shape (...)."""
    x, y = place_in_unit(position[0], table.shape[3]), place_in_unit(position[1], table.shape[2])
    return sum(
        wy * wx * interpolate_table(table, at, row, column) for row, wy in y for column, wx in x
    )  # pyright: ignore[reportReturnType]


def _last_below(count: int, cdf: Callable[[Int[Array, ""]], Scalar], target: Scalar) -> Array:
    """Find the largest i in [0, count - 2] with cdf(i) <= target, or 0, by bisection. The bisection
    is a rolled loop: if it were unrolled, XLA would recompute each step in all later ones."""

    def halve(_: Int[Array, ""], bracket: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = bracket
        middle = (low + high) // 2
        below = cdf(middle) <= target
        return jnp.where(below, middle, low), jnp.where(below, high, middle)

    ends = jnp.zeros((), jnp.int32), jnp.full((), count - 1, jnp.int32)
    low, _ = fori_loop(0, (count - 1).bit_length(), halve, ends)
    return low


def _invert_linear(c0: Scalar, c1: Scalar, area: Scalar) -> Scalar:
    """Solve c0 x + (c1 - c0) x^2 / 2 = area for x in [0, 1], without cancellation."""
    denominator = c0 + safe_sqrt(c0 * c0 + 2 * area * (c1 - c0))
    positive = denominator > 0
    return jnp.clip(divide(2 * area, denominator, where=positive), 0, 1)


@one_program
def warp(w: Warp, at: Slices, u: Square) -> tuple[Square, Scalar]:
    """Map uniform numbers in [0, 1]^2 to a position (x, y) of the square. Return the position and
    the density there."""
    ux, uy = u
    rows, columns = w.density.shape[2:]
    row = _last_below(rows, lambda i: interpolate_table(w.marginal, at, i), uy)
    r0 = interpolate_table(w.conditional, at, row, columns - 1)
    r1 = interpolate_table(w.conditional, at, row + 1, columns - 1)
    y = _invert_linear(r0, r1, (uy - interpolate_table(w.marginal, at, row)) * (rows - 1))

    def value_at_column(table: Array, i: Int[Array, ""]) -> Scalar:
        return (1 - y) * interpolate_table(table, at, row, i) + y * interpolate_table(
            table, at, row + 1, i
        )

    target = ux * ((1 - y) * r0 + y * r1)
    column = _last_below(columns, lambda i: value_at_column(w.conditional, i), target)
    c0, c1 = value_at_column(w.density, column), value_at_column(w.density, column + 1)
    x = _invert_linear(c0, c1, (target - value_at_column(w.conditional, column)) * (columns - 1))
    place = ((column.astype(x.dtype) + x) / (columns - 1), (row.astype(y.dtype) + y) / (rows - 1))
    return place, (1 - x) * c0 + x * c1


def unwarp(w: Warp, at: Slices, position: Square) -> tuple[Square, Scalar]:
    """Invert `warp`. Return the uniform numbers that map to a position, and the density there."""
    rows, columns = w.density.shape[2:]
    (column, _), (_, x) = place_in_unit(position[0], columns)
    (row, _), (_, y) = place_in_unit(position[1], rows)

    def value_at_column(table: Array, i: Int[Array, ""]) -> Scalar:
        return (1 - y) * interpolate_table(table, at, row, i) + y * interpolate_table(
            table, at, row + 1, i
        )

    c0, c1 = value_at_column(w.density, column), value_at_column(w.density, column + 1)
    part = value_at_column(w.conditional, column) + x * (c0 + x * (c1 - c0) / 2) / (columns - 1)
    r0 = interpolate_table(w.conditional, at, row, columns - 1)
    r1 = interpolate_table(w.conditional, at, row + 1, columns - 1)
    whole = (1 - y) * r0 + y * r1
    positive = whole > 0
    ux = divide(part, whole, where=positive)
    uy = interpolate_table(w.marginal, at, row) + y * (r0 + y * (r1 - r0) / 2) / (rows - 1)
    return (ux, uy), (1 - x) * c0 + x * c1
