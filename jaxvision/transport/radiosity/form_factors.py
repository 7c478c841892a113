"""Form factors: the fraction of what a diffuse surface sends out that another one receives.

    F_ij = 1 / A_i integral over A_i and A_j of cos_i cos_j / (pi d^2)

Closed forms for rectangles whose sides are parallel to common axes, the contour integral for a
polygon seen from a point, and quadrature over one of two polygons. Lengths in m, exchange areas
A_i F_ij in m^2, form factors without unit; nothing stands between. Closed forms hold to rounding
and keep reciprocity; each other function states its error. For ONE pair: the caller vmaps.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._arguments import takes_numbers
from ..._numerics import (
    arctan2,
    divide,
    norm,
    normalize,
    or_one,
    safe_log,
    safe_sqrt,
    smallest_divisor,
)
from ..._shown import Shown
from ..._types import Scalar, Scalars, check_count
from ..._vector import Vec, as_vec
from ...lights import gauss_legendre, square_nodes
from ._polygons import Polygon, far_factor, is_far, near_factor, on_polygon

_LARGEST = 1e8  # side over distance: its square is far from overflow in float32


@takes_numbers
def parallel_rectangles(width: Scalar, height: Scalar, gap: Scalar) -> Scalar:
    """F between two equal rectangles that face each other.

    Written as a sum of positive terms, it keeps its digits for any sizes, however tiny.

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
    x, y = (_ratio(side, gap) for side in (width, height))
    area = x * y
    extended = ~(area <= smallest_divisor(area.dtype) ** 1.5)
    return divide(2 * _opposed(x, y), jnp.pi * area, extended)


@takes_numbers
def perpendicular_rectangles(edge: Scalar, width: Scalar, other: Scalar) -> Scalar:
    """F between two rectangles that meet at a right angle in a common edge.

    The terms are arranged so that none cancels another, however unequal the sides; by symmetry
    `width` F = `other` F'.

    Args:
        edge: () m, the common edge; sides beyond 1e8 edges count as 1e8.
        width: () m, the other side of the rectangle that sends.
        other: () m, that of the one that receives.

    Returns:
        () in [0, 0.5], no unit; 0 for a width below 3e-10 edges in float32, 1e-77 in float64.

    Source:
        Howell, A Catalog of Radiation Heat Transfer Configuration Factors, C-14.
    """
    w, h = (_ratio(side, edge) for side in (width, other))
    wide = ~(w <= smallest_divisor(w.dtype))
    return divide(_hinged(w, h), jnp.pi * w, wide & ~(h <= 0))


def _ratio(side: Scalars, unit: Scalars) -> Scalars:
    """side / unit within [0, _LARGEST]; NaN of NaN."""
    fits = ~(side >= _LARGEST * unit)
    return divide(jnp.maximum(side, 0), unit, fits, _LARGEST)


def _opposed(x: Scalars, y: Scalars) -> Scalars:
    """ln[(1 + x^2)(1 + y^2) / (1 + x^2 + y^2)] / 2 + x d(x, y) + y d(y, x), each term >= 0."""
    area = x * y
    return jnp.log1p(area * (area / (1 + x * x + y * y))) / 2 + x * _gain(x, y) + y * _gain(y, x)


_NEAR = 0.3  # below it a series has the digits that the difference of two angles loses
_TERMS = 7, 16  # of it, in float32 and in float64


def _gain(x: Scalars, y: Scalars) -> Scalars:
    """s arctan(x / s) - arctan(x) with s = sqrt(1 + y^2), for x >= 0: the difference of the two
    angles is an angle, and s - 1 a quotient. For a small x it is the sum over j >= 0 of

        x^3 (1 - s^-2) (-x^2)^j (1 + s^-2 + ... + s^-2j) / (2 j + 3).
    """
    square = 1 + y * y
    s = jnp.sqrt(square)
    longer = y * y / (1 + s)
    of_angles = longer * arctan2(x, s) - arctan2(x * longer, s + x * x)
    near = x < _NEAR
    small = jnp.where(near, x, 0)
    power, steps = jnp.ones_like(small), jnp.ones_like(small)
    series = jnp.full_like(small, 1 / 3)
    for j in range(1, _TERMS[x.dtype == jnp.float64]):
        power, steps = power * -(small * small), 1 + steps / square
        series = series + power * steps / (2 * j + 3)
    return jnp.where(near, small * (small * small) * (y * y / square) * series, of_angles)


def _hinged(w: Scalars, h: Scalars) -> Scalars:
    """pi W F of C-14, symmetric in its arguments. With S = sqrt(w^2 + h^2), the shorter side w,

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
    rest = 1 + w2 + h2
    square = or_one(s * s, s > 0)
    of_width = _log_remaining(h2 / square / (1 + w2), (w2 / (1 + w2)) * (rest / square))
    of_height = _log_remaining(w2 / square / (1 + h2), (h2 / (1 + h2)) * (rest / square))
    logs = jnp.log1p(w2 * (h2 / rest)) + w2 * of_width + h2 * of_height
    return angles + logs / 4


def _log_remaining(lost: Scalars, remaining: Scalars) -> Scalars:
    """log(1 - lost), where 1 - lost = remaining; each is used where it has the more digits. XLA's
    log1p loses six bits near -0.4 in float64."""
    small = lost < 0.25
    return jnp.where(small, jnp.log1p(-jnp.where(small, lost, 0)), safe_log(remaining))


@takes_numbers
def parallel_exchange(
    first: Float[Array, "2 2"], second: Float[Array, "2 2"], gap: Scalar
) -> Scalar:
    """A_1 F_12 = A_2 F_21 between rectangles in parallel planes, front to front, with sides along
    the axes x and y.

    Second differences of the function that C-11 is made of. They lose about 10 eps (d / s)^4 for
    rectangles of size s at distance d: beyond d / s = 2.4 in float32 and 11 in float64, 4^4
    Gauss-Legendre nodes replace them. Off by 1e-4 and 1e-9 at worst, relative.

    Args:
        first, second: (2, 2) m, rows x and y, columns where the side starts and ends.
        gap: () m between the planes.

    Returns:
        () m^2.

    Source:
        Howell, A Catalog of Radiation Heat Transfer Configuration Factors, C-13.
    """
    scale = or_one(gap)
    x, y = (jnp.abs(_differences(first[i], second[i])) / scale for i in range(2))
    signs = jnp.asarray(np.outer(_SIGNS, _SIGNS), gap.dtype)
    exact = gap * gap / (2 * jnp.pi) * (signs * _opposed(*_pairs(x, y))).sum()
    u, v = _pairs(*(_node_differences(first[i], second[i]) for i in range(2)))
    kernel = gap / (u * u + v * v + scale * scale)
    weights = jnp.asarray(np.outer(_WEIGHTS, _WEIGHTS), gap.dtype)
    by_nodes = _area(first) * _area(second) / jnp.pi * (weights * kernel * kernel).sum()
    apart = jnp.stack([first[0].mean() - second[0].mean(), first[1].mean() - second[1].mean(), gap])
    return jnp.where(_far(apart, first, second), by_nodes, jnp.maximum(exact, 0))


@takes_numbers
def perpendicular_exchange(first: Float[Array, "2 2"], second: Float[Array, "2 2"]) -> Scalar:
    """A_1 F_12 = A_2 F_21 between rectangles in planes that meet at a right angle, with sides along
    the line in which the planes meet and across it.

    Differences of the function that C-14 is made of; far away by nodes, and as exact as
    `parallel_exchange`.

    Args:
        first, second: (2, 2) m, rows along the line and away from it, columns where the side starts
            and ends; what lies behind the other plane (away < 0) does not count.

    Returns:
        () m^2.

    Source:
        Howell, A Catalog of Radiation Heat Transfer Configuration Factors, C-15.
    """
    first, second = (jnp.stack([side[0], jnp.maximum(side[1], 0)]) for side in (first, second))
    along = jnp.maximum(jnp.abs(_differences(first[0], second[0])), smallest_divisor(first.dtype))
    away, up = (_ratio(side[1][:, None], along[None, :]) for side in (first, second))
    rises = _hinged(*jnp.broadcast_arrays(away[:, None], up[None, :]))
    corners = rises[1, 1] - rises[0, 1] - rises[1, 0] + rises[0, 0]
    exact = (jnp.asarray(_SIGNS, along.dtype) * along * along * corners).sum() / (2 * jnp.pi)
    nodes = jnp.asarray(_NODES, first.dtype)
    x, z = _pairs(*(side[1, 0] + nodes * (side[1, 1] - side[1, 0]) for side in (first, second)))
    x, z, v = jnp.broadcast_arrays(
        x[None], z[None], _node_differences(first[0], second[0])[:, None, None]
    )
    square = v * v + x * x + z * z
    kernel = divide(x * z, square * square, square != 0)
    weights = jnp.asarray(
        _WEIGHTS[:, None, None] * _NODE_WEIGHTS[:, None] * _NODE_WEIGHTS, first.dtype
    )
    by_nodes = _area(first) * _area(second) / jnp.pi * (weights * kernel).sum()
    apart = jnp.stack([first[0].mean() - second[0].mean(), first[1].mean(), second[1].mean()])
    return jnp.where(_far(apart, first, second), by_nodes, jnp.maximum(exact, 0))


_ORDER = 4
_NODES, _NODE_WEIGHTS = gauss_legendre(_ORDER)
_WEIGHTS = np.outer(_NODE_WEIGHTS, _NODE_WEIGHTS).reshape(-1)
_SIGNS = np.array(
    [-1.0, 1.0, 1.0, -1.0]
)  # of the second difference, in the order of `_differences`


def _differences(first: Float[Array, "2"], second: Float[Array, "2"]) -> Float[Array, "4"]:
    return (first[:, None] - second[None, :]).reshape(-1)


def _node_differences(first: Float[Array, "2"], second: Float[Array, "2"]) -> Float[Array, " n"]:
    nodes = jnp.asarray(_NODES, first.dtype)
    x, y = (side[0] + nodes * (side[1] - side[0]) for side in (first, second))
    return (x[:, None] - y[None, :]).reshape(-1)


def _pairs(x: Float[Array, " m"], y: Float[Array, " n"]) -> tuple[Array, Array]:
    shape = (len(x), len(y))
    return jnp.broadcast_to(x[:, None], shape), jnp.broadcast_to(y[None, :], shape)


def _area(sides: Float[Array, "2 2"]) -> Scalar:
    return (sides[0, 1] - sides[0, 0]) * (sides[1, 1] - sides[1, 0])


def _far(apart: Float[Array, "3"], first: Array, second: Array) -> Array:
    size = jnp.maximum(jnp.max(first[:, 1] - first[:, 0]), jnp.max(second[:, 1] - second[:, 0]))
    reach = float(2e-3 / jnp.finfo(apart.dtype).eps) ** (1 / 12)
    return norm(apart) > reach * size


class Exchange(Shown):
    """A form factor and its error.

    Attributes:
        value: () form factor, no unit.
        error: () by which it may be off, no unit.
    """

    value: Scalar
    error: Scalar


def point_to_polygon(point: Vec, normal: Vec, corners: Polygon) -> Scalar:
    """F from a surface element to a polygon.

    Lambert's contour integral, exact where the polygon is flat and convex. In rounding it loses
    some 15 eps (d / s)^2 for a polygon of size s at distance d, relative: where the 2 x 2
    Gauss-Legendre nodes of `far_factor`, which are off by about .03 (s / d)^4, lose less, beyond 5
    sizes in float32 and 144 in float64, they replace it. Off by 1e-4 and 1e-10 at worst.

    Args:
        point: (3,) m, the element.
        normal: (3,) unit length; what lies below its horizon does not count.
        corners: four `Vec`, m, counterclockwise seen from the front of the polygon; a triangle
            repeats one.

    Returns:
        () in [0, 1], no unit; 0 from behind the polygon.
    """
    contour = near_factor(point, normal, corners)
    reach = float(2e-3 / jnp.finfo(contour.dtype).eps) ** (1 / 6)
    far = is_far(point, corners, reach=reach)
    return jnp.where(far, far_factor(point, normal, corners), contour)


def polygon_to_polygon(first: Polygon, second: Polygon, *, order: int = 4) -> Exchange:
    """F from one flat convex polygon to another.

    The contour integral over the second at `order`^2 Gauss-Legendre nodes of the first.

    Args:
        first, second: corners as in `point_to_polygon`, m.
        order: static, >= 2.

    Returns:
        The factor, no unit, and as its error the difference to one order less: far above the true
        error for polygons apart, about it where they touch.

    Raises:
        ValueError: for an order below 2.
    """
    check_count("order", order, 2)
    dtype = first[0].x.dtype

    def at(order: int) -> Scalar:
        nodes, weights = square_nodes(order)

        def one(s: Scalar, t: Scalar, weight: Scalar) -> tuple[Scalar, Scalar]:
            place, patch = on_polygon(first, s, t)
            size = weight * norm(patch)
            return size * point_to_polygon(place, as_vec(normalize(patch)), second), size

        # All nodes in one call of a program whose size does not grow with their number.
        s, t = jnp.asarray(nodes, dtype).T
        seen, sizes = jax.vmap(one)(s, t, jnp.asarray(weights, dtype))
        return seen.sum() / or_one(sizes.sum())

    value = at(order)
    return Exchange(value, jnp.abs(value - at(order - 1)))
