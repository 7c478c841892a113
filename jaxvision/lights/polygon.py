"""The exact irradiance from a rectangle of uniform radiance L, by Lambert's contour formula.

    E = L / 2 sum_i theta_i n . (v_i+1 x v_i) / |v_i+1 x v_i|

The sum is over the edges of the part of the rectangle above the receiver's horizon. Here n is the
receiver's normal, v_i the vector from the receiver to a corner, and theta_i the angle that an edge
subtends (Lambert, Photometria, 1760; Baum, Rushmeier and Winget, "Improving Radiosity Solutions
Through the Use of Analytically Determined Form-Factors", SIGGRAPH 1989). The functions are for one
receiver; use `jax.vmap` for many.
"""

from collections.abc import Iterator, Sequence
from functools import partial, reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ..core._arguments import takes_numbers
from ..core._loops.fusion import fuse
from ..core._numerics import divide, dot, or_one, polynomial, smallest_divisor
from ..core._types import Colour, Scalar, Scalars
from ..core._vector import Direction, Vec, Vector, as_vec, masked, where
from ..geometry import largest_coordinate
from ..geometry.hemisphere import cross
from ._nodes import square_nodes
from .rectangle import RectangleLight

_SMALL = 0.03  # tan^2 theta; below it, ten terms of a series are more accurate than a difference
_TERMS = 10

# Coefficients of arctan(t) / t in powers of t^2 <= 1, with the smallest relative error (Remez, with
# 60 digits): 2e-8 for float32, 5e-18 for float64.
_ARCTAN_OVER = {
    4: (
        0.9999999848,
        -0.3333307335,
        0.1999261961,
        -0.1420364676,
        0.1064094455,
        -0.07504319007,
        0.04269182126,
        -0.01606881774,
        0.002849936671,
    ),
    8: (
        0.999999999999999996,
        -0.333333333333329328,
        0.199999999999397175,
        -0.142857142821016557,
        0.111111109961304619,
        -0.0909090684271788719,
        0.0769227822239658043,
        -0.0666639233227987918,
        0.058804646725674309,
        -0.0525326023383961125,
        0.047215067346627798,
        -0.0421717269081818671,
        0.0366032559632835458,
        -0.0298455283419508451,
        0.0219162720990527921,
        -0.0138384556540735286,
        0.0071540591166340982,
        -0.0028637575083341018,
        0.000824063012551341305,
        -0.00015062984482473188,
        0.0000130754490415704658,
    ),
}


def _cases(square: Scalars, cosine: Scalars) -> tuple[Bool[Array, "..."], Bool[Array, "..."]]:
    """Return two masks (narrow, wide) for `angle_over_sine`: where the series for narrow angles is
    accurate, and where the quotient is accurate. Both masks are false if the two vectors of an
    angle are opposite within rounding or have no length."""
    smallest = smallest_divisor(square.dtype)
    narrow = (cosine > smallest) & (square < _SMALL * cosine * cosine)
    opposite = (cosine < 0) & (square < (jnp.finfo(square.dtype).eps * cosine) ** 2)
    return narrow, ~narrow & ~opposite & (square > smallest * smallest)


def angle_over_sine(square: Scalars, cosine: Scalars) -> Scalars:
    """Return theta / sqrt(s2) with theta = atan2(sqrt(s2), c) in [0, pi] rad, for `square` s2 >= 0
    and `cosine` c, no units, of vectors with lengths of about 1. Callers multiply the result by
    the cross product of the vectors. If theta is pi within rounding, or a vector is 0, the cross
    product has no direction, and the result is 0.

    With A(t^2) = arctan(t) / t, which needs no root, and s = sqrt(s2), the result is A(s2 / c^2) /
    c up to 45 degrees, then (pi / 2) / s - c A(c^2 / s2) / s2, and pi / s + A(s2 / c^2) / c from
    135 degrees.

    The custom derivatives are d/dc = -1 / (s2 + c^2) and d/ds2 = (c / (s2 + c^2) - value) / (2 s2),
    the second computed by a series if s2 << c^2. These derivatives are finite and exact where
    autodiff divides 0 by 0.
    """
    return _angle_over_sine(square, cosine)


@jax.custom_jvp
def _angle_over_sine(square: Scalars, cosine: Scalars) -> Scalars:
    narrow, wide = _cases(square, cosine)
    defined = narrow | wide
    adjacent = cosine * cosine
    steep = square > adjacent
    inverse = 1 / or_one(jnp.maximum(square, adjacent), defined)
    ratio = jnp.where(defined, jnp.minimum(square, adjacent), 0) * inverse
    coefficients = _ARCTAN_OVER[8 if square.dtype == jnp.float64 else 4]
    arctan = polynomial(coefficients[::-1], ratio)
    quarters = jnp.where(steep, jnp.pi / 2, jnp.where(cosine < 0, jnp.pi, 0))
    turned = quarters * jax.lax.rsqrt(or_one(square, wide))
    angle = turned + jnp.where(steep, -cosine, cosine) * inverse * arctan
    return jnp.where(defined, angle, jnp.where(jnp.isnan(square), square, 0))


def _slopes(square: Scalars, cosine: Scalars, value: Scalars) -> tuple[Scalars, Scalars]:
    """Return the derivatives of `angle_over_sine` with respect to both arguments, given its
    `value`."""
    narrow, wide = _cases(square, cosine)
    length = square + cosine * cosine
    inverse = divide(1, length, where=narrow | wide)
    adjacent = jnp.maximum(cosine, smallest_divisor(cosine.dtype))
    x = jnp.minimum(square / (adjacent * adjacent), 2 * _SMALL)
    series = jnp.zeros_like(x)  # sum over k >= 1 of (-1)^k x^(k - 1) k / (2 k + 1), Horner
    for k in range(_TERMS, 0, -1):
        series = (-1) ** k * k / (2 * k + 1) + x * series
    direct = (cosine * inverse - value) / (2 * or_one(square, wide))
    return jnp.where(narrow, series / adjacent**3, jnp.where(wide, direct, 0)), -inverse


@_angle_over_sine.defjvp
def _angle_over_sine_jvp(primals, tangents):
    (square, cosine), (d_square, d_cosine) = primals, tangents
    value = _angle_over_sine(square, cosine)
    by_square, by_cosine = _slopes(square, cosine, value)
    return value, by_square * d_square + by_cosine * d_cosine


@takes_numbers
def rectangle_irradiance(light: RectangleLight, point: Vector, normal: Direction) -> Colour:
    """Compute the exact irradiance of a rectangle on a receiver.

    The part of the light below the receiver's horizon adds nothing. The irradiance is 0 at a point
    behind the light or in its plane. For many receivers, `adaptive.adaptive_irradiance` takes a
    quarter of the time.

    At a large distance d from a light of size s, the terms of the contour integral cancel. If d / s
    exceeds (3e-4 / eps)^(1/10), where eps is the machine epsilon, quadrature with 4 x 4
    Gauss-Legendre nodes replaces the contour integral. The limit on d / s is 2.2 in float32 and 16
    in float64. If receiver and light face each other, the relative rounding error is 10 eps (300
    eps in float64 at the limit); if the horizon cuts the light, the error is d / s times as large.
    The error is larger for a slanted receiver or light, for example 1e-4 in float32 if the product
    of both cosines is .01.

    Args:
        light: the rectangle.
        point: (3,) m.
        normal: (3,) unit normal of the receiver.

    Returns:
        The irradiance, (bands,) W m^-2.

    Example:
        A square of 2 m side is 1 m above: four times the form factor of one quarter, 0.1385.

        >>> lamp = jv.RectangleLight([-1, -1, 1], [0, 2, 0], [2, 0, 0], [1 / np.pi])
        >>> up = jnp.array([0.0, 0.0, 1.0])
        >>> round(float(jv.rectangle_irradiance(lamp, jnp.zeros(3), up)[0]), 4)
        0.5541
    """
    u, v = as_vec(light.edge_u), as_vec(light.edge_v)
    first = as_vec(light.corner - as_vec(point))
    corners = [first, first + u, first + u + v, first + v]
    scale = 1 / largest_coordinate(corners)
    u, v, corners = u * scale, v * scale, [corner * scale for corner in corners]
    receiver = as_vec(normal)
    above = [dot(receiver, corner) >= 0 for corner in corners]
    twice = corners[0] + corners[2]
    reach = 2 * (3e-4 / jnp.finfo(scale.dtype).eps) ** (1 / 10)
    size = jnp.maximum(dot(u, u), dot(v, v))
    far = (dot(twice, twice) > reach * reach * size) & reduce(jnp.logical_and, above)
    lit = jnp.where(
        far,
        nodes_integral(corners[0], u, v, receiver, order=4),
        contour_integral(corners, receiver),
    )
    front = -dot(cross(u, v), corners[0])
    behind = jnp.where(front <= 0, 0, front)  # or NaN
    return light.radiance * jnp.where(front > 0, jnp.maximum(lit, 0), behind)


@jax.custom_jvp
def contour_integral(corners: Sequence[Vec], normal: Vec) -> Scalar:
    """Return the integral of the cosine of incidence over the solid angle of a polygon above a
    receiver's horizon, () sr. The receiver is at the origin and has the unit normal `normal`.

    `corners` are the four corners, in m, of a flat convex polygon, clockwise as seen from the
    receiver. If the corners are counter-clockwise, the result is negative. The fourth power of a
    length must not overflow or underflow. If the horizon cuts the polygon, an additional edge along
    the horizon closes it. The cross product v_i+1 x v_i of a partly visible edge is multiplied by
    the visible fraction of the edge.

    The derivatives are computed as a sum over the same edges, in a tenth of the time of autodiff.
    """
    total = jnp.zeros_like(normal.x)
    for edge in _visible_edges(corners, normal):
        sine_over_angle = _angle_over_sine(dot(edge.area, edge.area), edge.cosine)
        total = total + dot(normal, edge.area) * sine_over_angle
    return total / 2


class _Edge(NamedTuple):
    """The visible part of one edge of a polygon, from point a to point b. `area` is b x a. `cosine`
    is a . b, or 1 if no part of the edge is visible. `of_start` and `of_end` are the weights of the
    polygon's corners in a and b.
    """

    start: Vec
    end: Vec
    area: Vec
    cosine: Scalar
    of_start: dict[int, Scalar]
    of_end: dict[int, Scalar]


def _visible_edges(corners: Sequence[Vec], normal: Vec) -> list[_Edge]:
    """Return the visible parts of the four edges of a polygon, and the edge that closes the visible
    part along the horizon."""
    # materialised, because several loops could round a height near 0 differently and disagree on
    # the cut
    heights = fuse([dot(normal, corner) for corner in corners])
    zero = jnp.zeros_like(normal.x)
    leaving = entering = Vec(zero, zero, zero)
    of_leaving, of_entering = dict.fromkeys(range(4), zero), dict.fromkeys(range(4), zero)
    edges = []
    for i in range(4):
        after = (i + 1) % 4
        a, b = corners[i], corners[after]
        a_above, b_above = heights[i] >= 0, heights[after] >= 0
        seen, cut = a_above | b_above, a_above != b_above
        place = divide(heights[i], heights[i] - heights[after], where=cut)
        crossing = a + place * (b - a)
        start, end = where(a_above, a, crossing), where(b_above, b, crossing)
        first, last = jnp.where(a_above, 0, place), jnp.where(b_above, 1, place)
        area = jnp.where(seen, last - first, 0) * cross(b - a, a)
        cosine = jnp.where(seen, dot(start, end), 1)
        of_start, of_end = {i: 1 - first, after: first}, {i: 1 - last, after: last}
        edges.append(_Edge(start, end, area, cosine, of_start, of_end))
        leaving = leaving + masked(cut & a_above, crossing)
        entering = entering + masked(cut & b_above, crossing)
        for here, parts in ((cut & a_above, of_leaving), (cut & b_above, of_entering)):
            parts[i] = parts[i] + jnp.where(here, 1 - place, 0)
            parts[after] = parts[after] + jnp.where(here, place, 0)
    area, cosine = cross(entering, leaving), dot(leaving, entering)
    return [*edges, _Edge(leaving, entering, area, cosine, of_leaving, of_entering)]


@contour_integral.defjvp
def _contour_integral_jvp(primals, tangents):
    """Differentiate theta n . w / |w| = f n . w with respect to a, b and n of each edge a to b,
    where w = b x a and f is the angle divided by its sine. f' and f_c are the derivatives of f with
    respect to the square w . w and to the cosine a . b. The derivatives with respect to a and b are

    (f n + 2 f' (n . w) w) x b + f_c (n . w) b,   a x (f n + 2 f' (n . w) w) + f_c (n . w) a

    and the derivative with respect to n is f w. Where the horizon cuts an edge, the position of the
    cut adds nothing to the derivative, because the cosine of incidence is 0 along the horizon.
    """
    (corners, normal), (moves, tilt) = primals, tangents
    value = contour_integral(corners, normal)
    zero = jnp.zeros_like(normal.x)
    by_corner = [Vec(zero, zero, zero)] * 4
    by_normal = by_corner[0]
    edges = fuse(_visible_edges(corners, normal))
    factors = []
    for edge in edges:
        square, along = dot(edge.area, edge.area), dot(normal, edge.area)
        angle = _angle_over_sine(square, edge.cosine)
        by_square, by_cosine = _slopes(square, edge.cosine, angle)
        factors.append((angle, 2 * along * by_square, along * by_cosine))
    for edge, (angle, twist, pull) in zip(edges, fuse(factors), strict=True):
        turn = angle * normal + twist * edge.area
        by_start = cross(turn, edge.end) + pull * edge.end
        by_end = cross(edge.start, turn) + pull * edge.start
        by_normal = by_normal + angle * edge.area
        for slope, parts in ((by_start, edge.of_start), (by_end, edge.of_end)):
            for i, part in parts.items():
                by_corner[i] = by_corner[i] + part * slope
    by_corner, by_normal = fuse((by_corner, by_normal))
    change = dot(by_normal, tilt)
    for slope, move in zip(by_corner, moves, strict=True):
        change = change + dot(slope, move)
    return value, change / 2


@partial(jax.custom_jvp, nondiff_argnums=(4,))
def _nodes_integral(corner: Vec, u: Vec, v: Vec, normal: Vec, order: int) -> Scalars:
    total = jnp.zeros_like(dot(normal, corner))
    for weight, _, _, toward, inverse in _node_places(corner, u, v, order):
        total = total + weight * jnp.maximum(dot(normal, toward), 0) * (inverse * inverse)
    return total * jnp.maximum(-dot(cross(u, v), corner), 0)


@_nodes_integral.defjvp
def _nodes_integral_jvp(order, primals, tangents):
    """Differentiate `_nodes_integral`. Above the horizon, the derivative of a node's term w [n.t]+
    / |t|^4 with respect to the vector t to the node is w n / |t|^4 - 4 w [n.t]+ t / |t|^6, where
    [x]+ = max(x, 0). The derivatives of the factor -(u x v) . c with respect to c, u and v are -u x
    v, c x v and u x c."""
    corner, u, v, normal = primals
    value = _nodes_integral(*primals, order)
    area = cross(u, v)
    front = jnp.maximum(-dot(area, corner), 0)
    shines = front > 0
    zero = jnp.zeros_like(front)
    total, nothing = zero, Vec(zero, zero, zero)
    by_corner = by_u = by_v = by_normal = nothing
    for weight, s, t, toward, inverse in _node_places(corner, u, v, order):
        height = dot(normal, toward)
        share = jnp.where(height > 0, weight * (inverse * inverse), 0)
        slope = share * normal - (4 * share * height * inverse) * toward
        total = total + share * height
        by_corner, by_u, by_v = by_corner + slope, by_u + s * slope, by_v + t * slope
        by_normal = by_normal + share * toward
    total = jnp.where(shines, total, 0)
    slopes = [
        front * by_corner - total * area,
        front * by_u + total * cross(corner, v),
        front * by_v + total * cross(u, corner),
        front * by_normal,
    ]
    slopes = fuse(slopes)
    change = zero
    for slope, move in zip(slopes, tangents, strict=True):
        change = change + dot(slope, move)
    return value, change


def _node_places(corner: Vec, u: Vec, v: Vec, order: int) -> Iterator[tuple]:
    """Yield for each Gauss-Legendre node of a parallelogram its weight, its positions along u and
    v, the vector to the node in m, and the inverse of the vector's squared length."""
    nodes, weights = (jnp.asarray(x, corner.x.dtype) for x in square_nodes(order))
    for (s, t), weight in zip(nodes, weights, strict=True):
        toward = corner + (s * u + t * v)
        square = dot(toward, toward)
        yield weight, s, t, toward, 1 / or_one(square)


def nodes_integral(corner: Vec, u: Vec, v: Vec, normal: Vec, *, order: int) -> Scalars:
    """Return the integral of the cosine of incidence over the solid angle of a parallelogram, sr,
    by `order` Gauss-Legendre nodes per side. `corner`, in m, is relative to the receiver. Arrays of
    receivers broadcast. The result is 0 for a receiver behind the parallelogram."""
    return _nodes_integral(corner, u, v, normal, order)
