"""Form factors: the fraction of the light from a diffuse surface that another surface receives.

    F_ij = 1 / A_i integral over A_i and A_j of cos_i cos_j / (pi d^2)

A is an area, d the distance between two points of the surfaces, and cos_i and cos_j are the cosines
at these points. Rectangles with sides parallel to common axes have closed forms. The form factor
from a point to a polygon is a contour integral, and that between two polygons is a quadrature over
one of them. Lengths are in m, exchange areas A_i F_ij in m^2, and form factors have no unit.
Occlusion is ignored. Closed forms are reciprocal, and exact up to rounding. Every other function
states its error. All functions are for one pair; use `jax.vmap` for many.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...core._arguments import takes_numbers
from ...core._numerics import (
    arctan2,
    divide,
    dot,
    log1p,
    norm,
    normalize,
    or_one,
    safe_log,
    safe_sqrt,
    smallest_divisor,
)
from ...core._shown import Shown
from ...core._types import Scalar, Scalars, check_count
from ...core._vector import Vec, as_vec
from ...lights import square_nodes
from ._polygons import Polygon, contour_form_factor, far_factor, is_far, polygon_point

_LARGEST = 1e8  # largest ratio of side to distance, whose square does not overflow in float32


@takes_numbers
def parallel_rectangles(width: Scalar, height: Scalar, gap: Scalar) -> Scalar:
    """Return the form factor F between two equal rectangles that face each other.

    The form factor is computed as a sum of positive terms, with full precision down to the sizes
    below.

    Args:
        width, height: () m each, of both rectangles; sides beyond 1e8 gaps count as 1e8.
        gap: () m between them.

    Returns:
        () in [0, 1], no unit; 0 for an area of less than 6e-15 gap^2 in float32, 1e-115 in float64.

    Source:
        Howell, A Catalog of Radiation Heat Transfer Configuration Factors, C-11.

    Example:
        >>> from jaxvision.transport.radiosity import parallel_rectangles
        >>> print(parallel_rectangles(jnp.array(1.0), jnp.array(1.0), jnp.array(1.0)).round(4))
        0.1998
    """
    return _facing(*jnp.broadcast_arrays(width, height, gap))


@jax.custom_jvp
def _facing(width: Scalar, height: Scalar, gap: Scalar) -> Scalar:
    x, y = (_ratio(side, gap) for side in (width, height))
    area = x * y
    extended = ~(area <= smallest_divisor(area.dtype) ** 1.5)
    return divide(2 * _parallel_sum(x, y), jnp.pi * area, extended)


@_facing.defjvp
def _facing_jvp(primals, tangents):
    """Differentiate `_facing` in terms of t = x dF / d ln x, which is bounded and has no
    cancellation, unlike the derivative of the quotient."""
    (width, height, gap), (d_width, d_height, d_gap) = primals, tangents
    x, y = (_ratio(side, gap) for side in (width, height))
    of_width, of_height = _steepness(x, y), _steepness(y, x)
    by_width, by_height = divide(of_width, width), divide(of_height, height)
    slope = by_width * divide(gap, width) * d_width + by_height * divide(gap, height) * d_height
    return _facing(*primals), slope - (by_width + by_height) * d_gap


def _steepness(x: Scalars, y: Scalars) -> Scalars:
    """Return x^2 dF / dx for the form factor F of `parallel_rectangles`. With x and y the sides
    divided by the gap and s^2 = 1 + x^2, it is 2 / pi (arctan(y) - arctan(y / s) / s - ln[(1 +
    x^2)(1 + y^2) / (1 + x^2 + y^2)] / 2 y)"""
    square = x * x
    s = jnp.sqrt(1 + square)
    longer = square / (1 + s)  # s - 1
    angle = arctan2(y * longer, s + y * y) + longer / s * arctan2(y, s)
    logs = log1p(square * (y * y / (1 + square + y * y))) / 2
    return 2 / jnp.pi * (angle - divide(logs, y))


@takes_numbers
def perpendicular_rectangles(edge: Scalar, width: Scalar, other: Scalar) -> Scalar:
    """Return the form factor F between two rectangles that meet at a right angle in a common edge.

    The terms are arranged so that they do not cancel for any ratio of the sides. By reciprocity,
    `width` F = `other` F', where F' is the form factor in the opposite direction.

    Args:
        edge: () m, the common edge; sides beyond 1e8 edges count as 1e8.
        width: () m, the other side of the emitting rectangle.
        other: () m, the other side of the receiving rectangle.

    Returns:
        () in [0, 0.5], no unit; 0 for a width below 3e-10 edges in float32, 1e-77 in float64.

    Source:
        Howell, A Catalog of Radiation Heat Transfer Configuration Factors, C-14.
    """
    return _meeting(*jnp.broadcast_arrays(edge, width, other))


@jax.custom_jvp
def _meeting(edge: Scalar, width: Scalar, other: Scalar) -> Scalar:
    w, h = (_ratio(side, edge) for side in (width, other))
    wide = ~(w <= smallest_divisor(w.dtype))
    return divide(_perpendicular_sum(w, h), jnp.pi * w, wide & ~(h <= 0))


@_meeting.defjvp
def _meeting_jvp(primals, tangents):
    """Differentiate `_meeting`. The derivative with respect to ln h is computed from `_rise`, and
    the derivative with respect to the logarithm of the edge from the logarithms in
    `_perpendicular_sum`. The derivative with respect to ln w is minus the sum of these two, because
    F depends only on ratios. All terms of a sum have the same sign, so nothing cancels."""
    (edge, width, other), (d_edge, d_width, d_other) = primals, tangents
    w, h = (_ratio(side, edge) for side in (width, other))
    w2, h2 = w * w, h * h
    by_edge = (
        log1p(w2 * (h2 / (1 + w2 + h2))) - w2 * _log_of_side(w, h) - h2 * _log_of_side(h, w)
    ) / 4
    by_other = h * _rise(h, w)
    change = by_edge * divide(d_edge, edge) + by_other * divide(d_other, other)
    change = change - (by_edge + by_other) * divide(d_width, width)
    return _meeting(*primals), divide(change, jnp.pi * w)


def _rise(h: Scalars, w: Scalars) -> Scalars:
    """Return the derivative of `_perpendicular_sum` with respect to h, acot(h) - h acot(S) / S + h
    ln(1 - c) / 2, with S and c as in `_perpendicular_sum`."""
    s = safe_sqrt(w * w + h * h)
    longer = w * divide(w, s + h, s > 0)  # S - h
    angle = arctan2(jnp.ones_like(s), s)
    angles = arctan2(longer, 1 + h * s) + divide(longer, s, s > 0) * angle
    return angles + h * _log_of_side(h, w) / 2


def _ratio(side: Scalars, unit: Scalars) -> Scalars:
    """Return the ratio side / unit, clipped to [0, _LARGEST]; NaN if either is NaN."""
    fits = ~(side >= _LARGEST * unit)
    return divide(jnp.maximum(side, 0), unit, fits, _LARGEST)


def _parallel_sum(x: Scalars, y: Scalars) -> Scalars:
    """Return the sum in the form factor of parallel rectangles, ln[(1 + x^2)(1 + y^2) / (1 + x^2 +
    y^2)] / 2 + x g(x, y) + y g(y, x), where g is `_gain`. Each term is >= 0."""
    area = x * y
    return log1p(area * (area / (1 + x * x + y * y))) / 2 + x * _gain(x, y) + y * _gain(y, x)


_NEAR = 0.3  # below it, a series replaces the difference of two angles, which loses digits
_TERMS = 7, 16  # terms of the series in float32 and in float64


def _gain(x: Scalars, y: Scalars) -> Scalars:
    """Return s arctan(x / s) - arctan(x) with s = sqrt(1 + y^2), for x >= 0. To avoid cancellation,
    the difference of the two angles is computed as one angle, and s - 1 as a quotient. For a small
    x the result is computed as the sum over j >= 0 of

        x^3 (1 - s^-2) (-x^2)^j (1 + s^-2 + ... + s^-2j) / (2 j + 3).
    """
    square = 1 + y * y
    s = jnp.sqrt(square)
    longer = y * y / (1 + s)
    of_angles = longer * arctan2(x, s) - arctan2(x * longer, s + x * x)
    near = x < _NEAR
    small = jnp.minimum(x, 2 * _NEAR)
    power, steps = jnp.ones_like(small), jnp.ones_like(small)
    series = jnp.full_like(small, 1 / 3)
    for j in range(1, _TERMS[x.dtype == jnp.float64]):
        power, steps = power * -(small * small), 1 + steps / square
        series = series + power * steps / (2 * j + 3)
    return jnp.where(near, small * (small * small) * (y * y / square) * series, of_angles)


def _perpendicular_sum(w: Scalars, h: Scalars) -> Scalars:
    """Return pi w F for the form factor F of Howell's C-14, which is symmetric in w and h. With w
    the shorter side, S^2 = w^2 + h^2, a = w^2 h^2 / (1 + S^2), b = h^2 / (S^2 (1 + w^2)) and c =
    w^2 / (S^2 (1 + h^2)), it is

    w acot(w) + h acot(h) - S acot(S)
        + [ln(1 + a) + w^2 ln(1 - b) + h^2 ln(1 - c)] / 4.
    """
    w, h = jnp.minimum(w, h), jnp.maximum(w, h)
    w2, h2 = w * w, h * h
    s = safe_sqrt(w2 + h2)
    longer = w * divide(w, s + h, s > 0)  # S - h
    angles = w * arctan2(jnp.ones_like(w), w) + (
        h * arctan2(longer, 1 + h * s) - longer * arctan2(jnp.ones_like(w), s)
    )
    logs = log1p(w2 * (h2 / (1 + w2 + h2)))
    return angles + (logs + w2 * _log_of_side(w, h) + h2 * _log_of_side(h, w)) / 4


def _log_of_side(w: Scalars, h: Scalars) -> Scalars:
    """Return ln(1 - b) with b = h^2 / (S^2 (1 + w^2)) and S^2 = w^2 + h^2, a term of
    `_perpendicular_sum`."""
    w2, h2 = w * w, h * h
    square = or_one(w2 + h2, w2 + h2 > 0)
    return _log_remaining(h2 / square / (1 + w2), (w2 / (1 + w2)) * ((1 + w2 + h2) / square))


def _log_remaining(lost: Scalars, remaining: Scalars) -> Scalars:
    """Return log(1 - lost) = log(remaining), computed from the argument that gives the more precise
    result."""
    small = lost < 0.5
    return jnp.where(small, log1p(-jnp.minimum(lost, 0.75)), safe_log(remaining))


@takes_numbers
def parallel_exchange(
    first: Float[Array, "2 2"], second: Float[Array, "2 2"], gap: Scalar
) -> Scalar:
    """Return A_1 F_12 = A_2 F_21 between rectangles in parallel planes that face each other, with
    sides along the axes x and y.

    The result is a sum of second differences of the function in Howell's C-11. These differences
    lose precision if a rectangle is small compared with the other or with the distance. In that
    case Gauss-Legendre nodes on the smaller rectangle are used, with the contour integral of the
    other rectangle or with nodes on it. Errors were measured for 400 random pairs of rectangles, at
    most ten times as long as wide, and one up to 1000 times as large as the other. Form factors
    above 1e-3 had relative errors of at most 4e-4 in float32 and 2e-10 in float64; nine in ten had
    at most 3e-6 and 1e-12. Strips 1000 times as long as wide have larger errors.

    Args:
        first, second: (2, 2) m, rows x and y, columns start and end of the side.
        gap: () m between the planes.

    Returns:
        () m^2.

    Source:
        Howell, A Catalog of Radiation Heat Transfer Configuration Factors, C-13.
    """
    scale = or_one(gap)
    x, y = (jnp.abs(_differences(first[i], second[i])) / scale for i in range(2))
    signs = jnp.asarray(np.outer(_SIGNS, _SIGNS), scale.dtype)
    terms = signs * _parallel_sum(*_pairs(x, y))
    level = jnp.zeros_like(gap)
    facing = _corners(first, level, upward=True), _corners(second, gap, upward=False)
    return _surest(gap * gap / (2 * jnp.pi) * terms, first, second, facing)


@takes_numbers
def perpendicular_exchange(first: Float[Array, "2 2"], second: Float[Array, "2 2"]) -> Scalar:
    """Return A_1 F_12 = A_2 F_21 between rectangles in planes that meet at a right angle, with
    sides along the line in which the planes meet and across it.

    The result is a sum of differences of the function in Howell's C-14, or is computed by
    Gauss-Legendre nodes. The result is as accurate as that of `parallel_exchange`.

    Args:
        first, second: (2, 2) m, rows along the common line and away from it, columns start and end
            of the side; the part behind the other plane (away < 0) is ignored.

    Returns:
        () m^2.

    Source:
        Howell, A Catalog of Radiation Heat Transfer Configuration Factors, C-15.
    """
    first, second = (jnp.stack([side[0], jnp.maximum(side[1], 0)]) for side in (first, second))
    along = jnp.maximum(jnp.abs(_differences(first[0], second[0])), smallest_divisor(first.dtype))
    away, up = (_ratio(side[1][:, None], along[None, :]) for side in (first, second))
    rises = _perpendicular_sum(*jnp.broadcast_arrays(away[:, None], up[None, :]))
    signs = jnp.asarray(np.multiply.outer(np.outer([-1, 1], [-1, 1]), _SIGNS), along.dtype)
    terms = signs * (along * along)[None, None] * rises / (2 * jnp.pi)
    level = jnp.zeros_like(first[0, 0])
    floor = _corners(first, level, upward=True)
    # corners of the wall: those of a floor, rotated about the common line
    a, b, c, d = (Vec(p.x, p.z, p.y) for p in _corners(second, level, upward=False))
    return _surest(terms, first, second, (floor, (a, b, c, d)))


_SIGNS = np.array(
    [-1.0, 1.0, 1.0, -1.0]
)  # of the second difference, in the order of `_differences`


def _differences(first: Float[Array, "2"], second: Float[Array, "2"]) -> Float[Array, "4"]:
    return (first[:, None] - second[None, :]).reshape(-1)


def _pairs(x: Float[Array, " m"], y: Float[Array, " n"]) -> tuple[Array, Array]:
    shape = (len(x), len(y))
    return jnp.broadcast_to(x[:, None], shape), jnp.broadcast_to(y[None, :], shape)


def _area(sides: Float[Array, "2 2"]) -> Scalar:
    return (sides[0, 1] - sides[0, 0]) * (sides[1, 1] - sides[1, 0])


def _corners(sides: Float[Array, "2 2"], z: Scalar, *, upward: bool) -> Polygon:
    """Return the corners of a rectangle, counterclockwise as seen from its front."""
    (x, right), (y, top) = sides
    a, b, c, d = Vec(x, y, z), Vec(right, y, z), Vec(right, top, z), Vec(x, top, z)
    return (a, b, c, d) if upward else (d, c, b, a)


def _surest(terms: Array, first: Array, second: Array, corners: tuple[Polygon, Polygon]) -> Scalar:
    """Return the exchange area, m^2, by the method with the smallest estimated error. The three
    methods are the sum of `terms`, which has rounding errors; the contour integral of the larger
    rectangle, evaluated at nodes of the smaller one; and nodes on both rectangles, whose
    contributions are positive. Nodes are not used if their spacing is larger than the distance
    between the rectangles."""
    smaller = _area(first) <= _area(second)
    small, large = (
        jax.tree.map(partial(jnp.where, which), *corners) for which in (smaller, ~smaller)
    )
    apart = _clearance(small, large)
    area, eps = jnp.minimum(_area(first), _area(second)), jnp.finfo(terms.dtype).eps
    seen = polygon_to_polygon(small, large)
    coarse, finer, nodes = (_gauss_exchange(small, large, order) for order in (2, 3, 4))
    of_nodes = _extrapolate(jnp.abs(finer - coarse), jnp.abs(nodes - finer))
    values = jnp.stack([jnp.maximum(terms.sum(), 0), area * seen.value, nodes])
    errors = jnp.stack(
        [
            eps * jnp.abs(terms).sum(),
            jnp.where(apart > _longest(small) / 2, area * (seen.error + eps), jnp.inf),
            jnp.where(apart > jnp.maximum(_longest(small), _longest(large)) / 2, of_nodes, jnp.inf),
        ]
    )
    return values[jnp.argmin(jax.lax.stop_gradient(errors))]


def _longest(corners: Polygon) -> Scalar:
    """Return the longer side of a rectangle, m."""
    a, b, _, d = corners
    return jnp.maximum(norm(b - a), norm(d - a))


def _clearance(first: Polygon, second: Polygon) -> Scalar:
    """Return the distance, m, between the bounding boxes of two polygons."""
    gaps = []
    for axis in ("x", "y", "z"):
        one, other = (jnp.stack([getattr(p, axis) for p in c]) for c in (first, second))
        gap = jnp.maximum(one.min() - other.max(), other.min() - one.max())
        gaps.append(jnp.maximum(gap, 0))
    return norm(Vec(*gaps))


def _extrapolate(before: Scalar, last: Scalar) -> Scalar:
    """Return an estimate of the next step of a converging sequence after the steps `before` and
    `last`, extrapolated as a geometric series; at most `last`."""
    return last * jnp.minimum(divide(last, before, before > 0), 1)


def _gauss_exchange(first: Polygon, second: Polygon, order: int) -> Scalar:
    """Return the exchange area A_1 F_12, m^2, by `order`^2 Gauss-Legendre nodes on each
    rectangle."""
    nodes, weights = square_nodes(order)
    s, t = jnp.asarray(nodes, first[0].x.dtype).T
    (place, patch), (other, facing) = (
        jax.vmap(partial(polygon_point, corners))(s, t) for corners in (first, second)
    )
    place, patch = jax.tree.map(lambda x: x[:, None], (place, patch))
    other, facing = jax.tree.map(lambda x: x[None], (other, facing))
    toward = other - place
    square = dot(toward, toward)
    sent = jnp.maximum(dot(patch, toward), 0) * jnp.maximum(-dot(facing, toward), 0)
    kernel = divide(sent, square * square, square != 0)
    return (jnp.asarray(np.outer(weights, weights), kernel.dtype) * kernel).sum() / jnp.pi


class Exchange(Shown):
    """A form factor, and an estimate of its error.

    Attributes:
        value: () form factor, no unit.
        error: () estimated error, no unit.
    """

    value: Scalar
    error: Scalar


def point_to_polygon(point: Vec, normal: Vec, corners: Polygon) -> Scalar:
    """Return the form factor F from a surface element to a polygon.

    The form factor is Lambert's contour integral, which is exact for flat convex polygons. The
    relative rounding error of the integral is about 15 eps (d / s)^2, where s is the size of the
    polygon, d its distance and eps the machine epsilon. Beyond d / s = 5 in float32 and 144 in
    float64, the 2 x 2 Gauss-Legendre nodes of `far_factor` are more accurate and are used instead;
    their error is about .03 (s / d)^4. The largest relative error is 1e-4 in float32 and 1e-10 in
    float64.

    Args:
        point: (3,) m, the element.
        normal: (3,) unit length; the part of the polygon below the horizon is ignored.
        corners: four `Vec`, m, counterclockwise seen from the front of the polygon; a triangle
            repeats one.

    Returns:
        () in [0, 1], no unit; 0 from behind the polygon.
    """
    contour = contour_form_factor(point, normal, corners)
    reach = float(2e-3 / jnp.finfo(contour.dtype).eps) ** (1 / 6)
    far = is_far(point, corners, reach=reach)
    return jnp.where(far, far_factor(point, normal, corners), contour)


def polygon_to_polygon(first: Polygon, second: Polygon, *, order: int = 4) -> Exchange:
    """Return the form factor F from one flat convex polygon to another.

    The contour integral over the second polygon is evaluated at `order`^2 Gauss-Legendre nodes of
    the first.

    Args:
        first, second: corners as in `point_to_polygon`, m.
        order: static, >= 2.

    Returns:
        The factor, no unit. The error is the difference from the result of the next lower order.
        This difference is far above the true error for distant polygons, and close to the true
        error where polygons touch.

    Raises:
        ValueError: for an order below 2.
    """
    check_count("order", order, 2)
    dtype = first[0].x.dtype

    def integrate(order: int) -> Scalar:
        nodes, weights = square_nodes(order)

        def integrand(s: Scalar, t: Scalar, weight: Scalar) -> tuple[Scalar, Scalar]:
            place, patch = polygon_point(first, s, t)
            size = weight * norm(patch)
            return size * point_to_polygon(place, as_vec(normalize(patch)), second), size

        # All nodes in one call of a program whose size does not grow with their number.
        s, t = jnp.asarray(nodes, dtype).T
        seen, sizes = jax.vmap(integrand)(s, t, jnp.asarray(weights, dtype))
        return seen.sum() / or_one(sizes.sum())

    value = integrate(order)
    return Exchange(value, jnp.abs(value - integrate(order - 1)))
