"""Overlap of two apertures in projection: areas in closed form.

Areas are in the square of the unit of the lengths, such as m^2 for m. The derivative of an area is
the length of an arc or a chord, which also has a closed form. This length is finite even where the
derivative of the formula for the area is infinite.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._numerics import arctan2, or_one, safe_sqrt, smallest_divisor
from ..core._types import Scalar, Scalars


@takes_numbers
def overlap_of_discs(distance: Scalars, first_radius: Scalars, second_radius: Scalars) -> Scalars:
    """Return the area that two discs share, elementwise.

    The area is the sum of two circular segments, r^2 (alpha - sin alpha cos alpha), with alpha half
    the angle of the arc. The half-angle formula gives alpha from the sides of the triangle of both
    centres and an intersection of the circles. That formula is accurate even if the circles just
    touch.

    Args:
        distance: (...) m between the centres, >= 0.
        first_radius: (...) m, >= 0.
        second_radius: (...) m, >= 0.

    Returns:
        (...) m^2.

    Example:
        >>> one = jnp.array(1.0)
        >>> round(float(jv.optics.overlap_of_discs(one, one, one)), 4)  # 2 pi / 3 - sqrt(3) / 2
        1.2284
    """
    return _overlap(distance, first_radius, second_radius)


@jax.custom_jvp
def _overlap(distance: Scalars, first_radius: Scalars, second_radius: Scalars) -> Scalars:
    first, second = _half_angles(distance, first_radius, second_radius)
    smaller = jnp.minimum(first_radius, second_radius)
    larger = jnp.maximum(first_radius, second_radius)
    segments = first_radius * first_radius * _segment(first) + (
        second_radius * second_radius * _segment(second)
    )
    inside = distance - larger <= -smaller
    return jnp.where(inside, jnp.pi * smaller * smaller, segments)


@_overlap.defjvp
def _overlap_jvp(primals, tangents):
    """Differentiate `_overlap`. The derivative with respect to the distance is minus the common
    chord, and with respect to each radius it is the arc of that circle."""
    distance, r1, r2 = primals
    along, d1, d2 = tangents
    first, second = _half_angles(distance, r1, r2)
    chord = 2 * jnp.minimum(r1 * jnp.sin(first), r2 * jnp.sin(second))
    change = 2 * r1 * first * d1 + 2 * r2 * second * d2 - chord * along
    return _overlap(distance, r1, r2), change


@takes_numbers
def overlap_of_disc_and_polygon(
    right: Scalar,
    down: Scalar,
    radius: Scalar,
    corner_right: Float[Array, " corners"],
    corner_down: Float[Array, " corners"],
) -> Scalar:
    """Return the area that a disc shares with a polygon.

    The sides inside the disc and the arcs between them bound the area. The area is summed in the
    polygon's coordinates, so it is as precise as the corners for any size of the disc.

    Args:
        right: () m, of the disc's centre.
        down: () m, of the disc's centre.
        radius: () m.
        corner_right: (corners,) m; the corners run from right towards down.
        corner_down: (corners,) m.

    Returns:
        () m^2.
    """
    x, y = corner_right - right, corner_down - down
    # a disc that contains all corners shares the whole polygon; its squared radius may overflow
    radius = jnp.minimum(radius, 2 * jnp.maximum(jnp.abs(x), jnp.abs(y)).max())
    return _overlap_with_polygon(right, down, radius, corner_right, corner_down)


@jax.custom_jvp
def _overlap_with_polygon(
    right: Scalar, down: Scalar, radius: Scalar, x: Scalars, y: Scalars
) -> Scalar:
    area, arcs, enters, leaves = _sides(right, down, radius, x, y)
    # if no side crosses the disc, the polygon contains the whole disc or no part of it
    apart = jnp.pi * radius * radius * jnp.round(arcs.sum() / (2 * jnp.pi))
    return jnp.where((leaves > enters).any(), area.sum(), apart)


@_overlap_with_polygon.defjvp
def _overlap_with_polygon_jvp(primals, tangents):
    """Differentiate the shared area. The derivative with respect to the radius is the length of the
    arcs. The derivative with respect to a corner is the area that the chords of its two sides sweep
    per unit of motion. A point of a side moves in proportion to its distance from the side's other,
    fixed end.
    """
    radius, x, y = primals[2:]
    to_right, to_down, wider, x_by, y_by = tangents
    _, arcs, enters, leaves = _sides(*primals)
    of_next = (leaves * leaves - enters * enters) / 2
    of_own = (leaves - enters) - of_next
    chord_x, chord_y = (
        of_own * move + of_next * jnp.roll(move, -1) for move in (x_by - to_right, y_by - to_down)
    )
    swept = chord_x * (jnp.roll(y, -1) - y) - chord_y * (jnp.roll(x, -1) - x)
    return _overlap_with_polygon(*primals), radius * arcs.sum() * wider + swept.sum()


def _sides(
    right: Scalar, down: Scalar, radius: Scalar, x: Scalars, y: Scalars
) -> tuple[Scalars, Scalars, Scalars, Scalars]:
    sides = jax.vmap(_side, in_axes=(None, None, None, 0, 0, 0, 0))
    return sides(right, down, radius, x, y, jnp.roll(x, -1), jnp.roll(y, -1))


def _half_angles(d: Scalars, r1: Scalars, r2: Scalars) -> tuple[Scalars, Scalars]:
    """Return half the angle of each circle's arc inside the other disc. The angles are pi and 0 if
    one disc contains the other, and pi / 2 if both coincide."""
    # the perimeter, and the perimeter minus twice each side; if one is negative, the sides form no
    # triangle. `gap`, the distance of the smaller disc's centre from the larger rim, is precise
    # near this rim.
    larger, smaller = jnp.maximum(r1, r2), jnp.minimum(r1, r2)
    gap = d - larger
    whole, beyond = larger + smaller + d, jnp.maximum(smaller - gap, 0)
    less_larger, less_smaller = jnp.maximum(gap + smaller, 0), jnp.maximum(d + larger - smaller, 0)
    less_first = jnp.where(r1 >= r2, less_larger, less_smaller)
    less_second = jnp.where(r1 >= r2, less_smaller, less_larger)
    same = (less_first == 0) & (less_second == 0)
    less_first, less_second = jnp.where(same, 1, less_first), jnp.where(same, 1, less_second)
    first = 2 * arctan2(safe_sqrt(beyond * less_first), safe_sqrt(whole * less_second))
    second = 2 * arctan2(safe_sqrt(beyond * less_second), safe_sqrt(whole * less_first))
    return first, second


def _segment(alpha: Scalars) -> Scalars:
    """Return alpha - sin alpha cos alpha = (t - sin t) / 2 with t = 2 alpha. If the terms nearly
    cancel, t - sin t is computed by the series t^3 / 3! (1 - t^2 / (4 5) (1 - t^2 / (6 7) (...))).
    """
    t = 2 * alpha
    small = t < 2
    square = jnp.square(jnp.minimum(t, 2.25))
    series = jnp.ones_like(square)
    for k in range(28 if t.dtype == jnp.float64 else 18, 2, -2):
        series = 1 - square / (k * (k + 1)) * series
    return jnp.where(small, t * square / 6 * series, t - jnp.sin(t)) / 2


def _side(
    right: Scalar, down: Scalar, radius: Scalar, x0: Scalar, y0: Scalar, x1: Scalar, y1: Scalar
) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """Return, for one side, its contribution to the area, the angle of its arcs, and the positions
    in [0, 1] where it enters and leaves the disc. Parts of the side outside the disc are projected
    radially onto the rim."""
    along_x, along_y = x1 - x0, y1 - y0
    square = along_x * along_x + along_y * along_y
    some = ~(square <= smallest_divisor(square.dtype) ** 2)
    scale = or_one(square, some)
    from_x, from_y = x0 - right, y0 - down
    nearest = -(from_x * along_x + from_y * along_y) / scale
    beside = (from_x * along_y - from_y * along_x) / scale
    half = jnp.where(some, safe_sqrt(radius * radius / scale - beside * beside), 0)
    enters, leaves = jnp.clip(nearest - half, 0, 1), jnp.clip(nearest + half, 0, 1)

    def move_inside(x: Scalar, y: Scalar) -> tuple[Scalar, Scalar]:
        away_x, away_y = x - right, y - down
        square = away_x * away_x + away_y * away_y
        outside = square > radius * radius
        # XLA may compute the square twice, with and without fused multiply-adds, so that a point on
        # the rim may count as outside and as inside. The factor must be right in both cases.
        reach = jnp.maximum(square, radius * radius)
        shrunk = radius * jax.lax.rsqrt(or_one(reach, reach > 0))
        return (
            jnp.where(outside, right + away_x * shrunk, x),
            jnp.where(outside, down + away_y * shrunk, y),
        )

    places = (
        move_inside(x0, y0),
        move_inside(x0 + enters * along_x, y0 + enters * along_y),
        move_inside(x0 + leaves * along_x, y0 + leaves * along_y),
        move_inside(x1, y1),
    )
    start, first, last, end = places
    twice = (
        _twice_triangle(start, first) + _twice_triangle(first, last) + _twice_triangle(last, end)
    )
    arcs = (
        _turn(start[0] - right, start[1] - down, first[0] - right, first[1] - down),
        _turn(last[0] - right, last[1] - down, end[0] - right, end[1] - down),
    )
    segments = sum(jnp.where(arc < 0, -1, 1) * _segment(jnp.abs(arc) / 2) for arc in arcs)
    area = twice / 2 + radius * radius * segments
    return jnp.where(some, area, 0), jnp.where(some, sum(arcs), 0), enters, leaves


def _twice_triangle(a: tuple[Scalar, Scalar], b: tuple[Scalar, Scalar]) -> Scalar:
    """Return twice the signed area of the triangle of two points and the origin."""
    return a[0] * (b[1] - a[1]) - a[1] * (b[0] - a[0])


def _turn(x0: Scalar, y0: Scalar, x1: Scalar, y1: Scalar) -> Scalar:
    """Return the angle from one direction to another, in (-pi, pi]; 0 for equal directions."""
    across, along = x0 * y1 - y0 * x1, x0 * x1 + y0 * y1
    return jnp.where(across < 0, -1, 1) * arctan2(jnp.abs(across), along)
