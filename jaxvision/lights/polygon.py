"""The exact irradiance from a uniform rectangle: Lambert's contour formula.

    E = L / 2 sum_i theta_i n . (v_i+1 x v_i) / |v_i+1 x v_i|

over the edges of what lies above the receiver's horizon, v_i from the receiver to the corners and
theta_i the angle each edge subtends (Lambert, Photometria, 1760; Baum, Rushmeier and Winget,
"Improving Radiosity Solutions Through the Use of Analytically Determined Form-Factors", SIGGRAPH
1989). For ONE receiver; the caller vmaps.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from .._numerics import arctan2, dot, norm, smallest_divisor
from .._types import Colour, Scalar, Scalars
from .._vector import Vec, Vector, as_vec, masked
from ..hemisphere import cross
from ._nodes import square_nodes
from .rectangle import RectangleLight

_SMALL = 0.03  # tan^2 theta below which ten terms of a series beat a difference, in float64 too
_TERMS = 10


def _cases(square: Scalars, cosine: Scalars) -> tuple[Bool[Array, "..."], Bool[Array, "..."]]:
    """(narrow, wide): where the series holds, and where the quotient does. Neither is where the
    vectors are opposite to rounding or of no length."""
    smallest = smallest_divisor(square.dtype)
    narrow = (cosine > smallest) & (square < _SMALL * cosine * cosine)
    opposite = (cosine < 0) & (square < (jnp.finfo(square.dtype).eps * cosine) ** 2)
    return narrow, ~narrow & ~opposite & (square > smallest * smallest)


@jax.custom_jvp
def angle_over_sine(square: Scalars, cosine: Scalars) -> Scalars:
    """theta / sqrt(s2) with theta = atan2(sqrt(s2), c) in [0, pi] rad, for `square` s2 >= 0 and
    `cosine` c, no units, of vectors of length about 1; 0 where theta is pi to rounding or both are
    nothing, since no plane holds the angle.

    Its own derivatives, d/dc = -1 / (s2 + c^2) and d/ds2 = (c / (s2 + c^2) - value) / (2 s2), the
    second by its series where s2 << c^2, are finite and exact where autodiff divides 0 by 0.
    """
    narrow, wide = _cases(square, cosine)
    sine = jnp.sqrt(jnp.where((narrow | wide) & (square > 0), square, 1))
    limit = jnp.where(narrow, 1 / jnp.where(narrow, cosine, 1), 0)
    angle = arctan2(sine, jnp.where(narrow | wide, cosine, 1))
    return jnp.where((narrow & (square > 0)) | wide, angle / sine, limit)


@angle_over_sine.defjvp
def _angle_over_sine_jvp(primals, tangents):
    (square, cosine), (d_square, d_cosine) = primals, tangents
    value = angle_over_sine(square, cosine)
    narrow, wide = _cases(square, cosine)
    length = square + cosine * cosine
    inverse = jnp.where(narrow | wide, 1 / jnp.where(narrow | wide, length, 1), 0)
    adjacent = jnp.where(narrow, cosine, 1)
    x = jnp.where(narrow, square, 0) / (adjacent * adjacent)
    series = jnp.zeros_like(x)  # sum over k >= 1 of (-1)^k x^(k - 1) k / (2 k + 1), Horner
    for k in range(_TERMS, 0, -1):
        series = (-1) ** k * k / (2 * k + 1) + x * series
    quotient = (cosine * inverse - value) / (2 * jnp.where(wide, square, 1))
    by_square = jnp.where(narrow, series / adjacent**3, jnp.where(wide, quotient, 0))
    return value, by_square * d_square - inverse * d_cosine


def rectangle_irradiance(light: RectangleLight, point: Vector, normal: Vector) -> Colour:
    """Irradiance on a receiver at `point` that faces `normal`: (bands,) in W m^-2, exact.

    `point`: (3,) m. `normal`: (3,) unit. The part of the light below the receiver's horizon does
    not count; a point behind the light or in its plane gets 0. At distance d of a light of size s
    the contour's terms cancel: some 15 eps (d / s)^2 is lost, relative, where all of the light is
    seen, and about eps d / s of what a facing receiver would get where the horizon cuts it. Beyond
    d / s = (1000 eps)^(-1/8), 3 in float32 and 38 in float64, 3 x 3 Gauss-Legendre nodes, which
    miss about .015 (s / d)^6, are the better half and replace it: at worst 2e-5 and 5e-12.
    """
    u, v = as_vec(light.edge_u), as_vec(light.edge_v)
    first = as_vec(light.corner - as_vec(point))
    corners = [first, first + u, first + u + v, first + v]
    scale = 1 / jax.lax.stop_gradient(_largest(corners))
    u, v, corners = u * scale, v * scale, [corner * scale for corner in corners]
    receiver = as_vec(normal)
    area = cross(u, v)
    above = [dot(receiver, corner) >= 0 for corner in corners]
    distance = norm(corners[0] + corners[2]) / 2
    size = jnp.maximum(norm(u), norm(v))
    far = (distance > size * (1000 * jnp.finfo(distance.dtype).eps) ** (-1 / 8)) & (
        above[0] & above[1] & above[2] & above[3]
    )
    lit = jnp.where(
        far, _by_nodes(corners[0], u, v, area, receiver), contour_integral(corners, receiver)
    )
    front = -dot(area, corners[0]) > 0
    return light.radiance * jnp.where(front, jnp.maximum(lit, 0), 0)


def _largest(corners: list[Vec]) -> Scalar:
    """The largest component of any corner in magnitude, 1 if all are 0."""
    components = [jnp.abs(c) for corner in corners for c in (corner.x, corner.y, corner.z)]
    largest = jnp.max(jnp.stack(components))
    return jnp.where(largest > 0, largest, 1)


def contour_integral(corners: Sequence[Vec], normal: Vec) -> Scalar:
    """The integral of the cosine over what four corners, m, cover above the horizon of a receiver
    at the origin that faces `normal`, unit: () sr.

    `corners`: of a flat convex polygon, clockwise where the receiver looks at them, else the
    result is negative; not so large or small that the fourth power of a length overflows. A cut
    polygon leaves and enters the horizon once each; the edge between both places closes it.
    """
    above = [dot(normal, corner) >= 0 for corner in corners]
    zero = jnp.zeros_like(normal.x)
    leaving = entering = Vec(zero, zero, zero)
    total = zero
    for i in range(4):
        a, b = corners[i], corners[(i + 1) % 4]
        a_above, b_above = above[i], above[(i + 1) % 4]
        cut = a_above != b_above
        height_a, height_b = dot(normal, a), dot(normal, b)
        share = height_a / jnp.where(cut, height_a - height_b, 1)
        crossing = a + share * (b - a)
        start, end = _choose(a_above, a, crossing), _choose(b_above, b, crossing)
        total = total + jnp.where(a_above | b_above, _edge(start, end, normal), 0)
        leaving = leaving + masked(a_above & cut, crossing)
        entering = entering + masked(b_above & cut, crossing)
    return (total + _edge(leaving, entering, normal)) / 2


def _choose(first: Bool[Array, ""], a: Vec, b: Vec) -> Vec:
    return jax.tree.map(lambda x, y: jnp.where(first, x, y), a, b)


def _edge(a: Vec, b: Vec, normal: Vec) -> Scalar:
    """theta n . (b x a) / |b x a|."""
    area = cross(b, a)
    return dot(normal, area) * angle_over_sine(dot(area, area), dot(a, b))


def _by_nodes(corner: Vec, u: Vec, v: Vec, area: Vec, normal: Vec) -> Scalar:
    """Integral of cos+ cos' / d^2 by 3 x 3 Gauss-Legendre nodes."""
    dtype = normal.x.dtype
    total = jnp.zeros_like(normal.x)
    for (s, t), weight in zip(*(jnp.asarray(x, dtype) for x in square_nodes(3)), strict=True):
        toward = corner + s * u + t * v
        square = dot(toward, toward)
        safe = jnp.where(square > 0, square, 1)
        cosines = jnp.maximum(dot(normal, toward), 0) * -dot(area, toward)
        total = total + weight * cosines / (safe * safe)
    return total
