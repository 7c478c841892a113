"""NaN-safe primitives, which return finite values and finite gradients at the edges of their
domain.

Where an operation would fail, its argument is replaced by a harmless number and its output is
masked ("double where"). Reverse-mode differentiation then never multiplies zero by infinity.
Compiled code may evaluate the condition twice with different rounding, so the argument may be
replaced although the output is not masked. The result must be right even then. The replacement is
therefore a number at the edge of the domain, or the two conditions differ by far more than
rounding.

Scalar functions work elementwise. Vector functions work over the last axis of (..., 3) arrays or on
`Vec` records. All functions keep the floating dtype.
"""

from collections.abc import Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float

from ._arguments import takes_numbers
from ._types import Scalars
from ._vector import Directions, Vec, Vec3, as_vec, scaled

Tree = TypeVar("Tree")


def smallest_divisor(dtype: DTypeLike) -> float:
    """Return the length below which a divisor counts as zero, tiny ** (1/4): 3e-10 in float32,
    1e-77 in float64. The cube of its inverse, which occurs in gradients, is finite. In float16 this
    would be 0.09, which is no small number, so that it is tiny there, 6e-5."""
    tiny = float(jnp.finfo(dtype).tiny)
    return tiny if jnp.dtype(dtype) == jnp.float16 else tiny**0.25


def log_of_zero(dtype: DTypeLike) -> float:
    """Return the value used for log(0): the logarithm of the smallest normal number of `dtype`."""
    return float(np.log(jnp.finfo(dtype).tiny))


@takes_numbers
def dot(u: Vec3, v: Vec3) -> Scalars:
    """Return the inner product of vectors.

    Args:
        u: (..., 3) or `Vec`, in any unit.
        v: (..., 3) or `Vec`, in any unit.

    Returns:
        (...) in the product of the units.

    Example:
        >>> float(jv.dot(jnp.array([1.0, 2.0, 3.0]), jnp.array([4.0, 5.0, 6.0])))
        32.0
    """
    a, b = as_vec(u), as_vec(v)
    return a.x * b.x + a.y * b.y + a.z * b.z


def exact_cross(u: Vec3, v: Vec3) -> Vec:
    """Return u x v in the product of their units. For nearly parallel vectors, the result is a
    thousand times more accurate than with rounded products. Each number is split into two halves,
    whose products are exact even in compiled code (Dekker, Numerische Mathematik 18 (1971))."""
    a, b = as_vec(u), as_vec(v)
    return Vec(
        difference_of_products(a.y, b.z, a.z, b.y),
        difference_of_products(a.z, b.x, a.x, b.z),
        difference_of_products(a.x, b.y, a.y, b.x),
    )


@jax.custom_jvp
def difference_of_products(a: Scalars, b: Scalars, c: Scalars, d: Scalars) -> Scalars:
    """Return a b - c d, computed from exact products, so that cancellation does not amplify
    rounding errors."""
    (ah, al), (bh, bl), (ch, cl), (dh, dl) = map(_halves, (a, b, c, d))
    middle = (ah * bl - ch * dl) + (al * bh - cl * dh)
    return (ah * bh - ch * dh) + (middle + (al * bl - cl * dl))


@difference_of_products.defjvp
def _difference_of_products_jvp(primals, tangents):
    (a, b, c, d), (da, db, dc, dd) = primals, tangents
    return difference_of_products(a, b, c, d), (da * b + a * db) - (dc * d + c * dd)


def _halves(x: Scalars) -> tuple[Scalars, Scalars]:
    """Split a number into a number with the upper half of its binary digits, and the remainder."""
    bits, low = {2: (jnp.int16, 6), 4: (jnp.int32, 12), 8: (jnp.int64, 27)}[x.dtype.itemsize]
    kept = jax.lax.bitcast_convert_type(x, bits) & -(1 << low)
    upper = jax.lax.bitcast_convert_type(kept, x.dtype)
    return upper, x - upper


@takes_numbers
def safe_sqrt(x: Scalars) -> Scalars:
    """Return sqrt(max(x, 0)), with gradient 0 at and below x = 0.

    Args:
        x: (...) in any unit.

    Returns:
        (...) in the square root of the unit.

    Example:
        >>> float(jax.grad(jv.safe_sqrt)(0.0))
        0.0
    """
    zero = x <= 0
    return jnp.where(zero, 0, jnp.sqrt(jnp.where(zero, smallest_divisor(x.dtype) ** 2, x)))


def safe_log(x: Scalars, *, floor: float | None = None) -> Scalars:
    """Return log(max(x, floor)), with gradient 0 at and below `floor` (default: the smallest normal
    number of the dtype)."""
    smallest = jnp.asarray(jnp.finfo(x.dtype).tiny if floor is None else floor, x.dtype)
    return jnp.log(jnp.where(x <= smallest, smallest, x))


def reciprocal(x: Scalars) -> Scalars:
    """Return 1 / x, in the inverse of its unit; value and gradient are 0 at and below x = 0."""
    zero = x <= 0
    return jnp.where(zero, 0, 1 / jnp.where(zero, 1, x))


def or_one(b: Scalars, where: Bool[Array, "..."] | None = None) -> Scalars:
    """Return b, in its unit, if the condition is true (default: b > 0 or NaN). Otherwise return 1
    with gradient 0. The caller can divide by the result and mask the quotient. The condition must
    be true wherever b is not tiny."""
    return jnp.where(~(b <= 0) if where is None else where, b, 1)


def divide(
    a: Scalars | float | int,
    b: Scalars,
    where: Bool[Array, "..."] | None = None,
    otherwise: Scalars | float | int = 0,
) -> Scalars:
    """Return a / b, in the quotient of their units, if the condition is true (default: b > 0 or
    NaN). Otherwise return `otherwise`, with gradient 0 with respect to a and b."""
    safe = ~(b <= 0) if where is None else where
    return jnp.where(safe, a / or_one(b, safe), otherwise)


def magnitude(x: Float[Array, "..."], axis: int | tuple[int, ...] | None = -1) -> Scalars:
    """Return the largest absolute value along the axes. In the result, these axes have length 1. If
    all of x is 0, return 1. The gradient of the result is 0. The squares of x divided by this
    magnitude neither overflow nor underflow."""
    return or_one(jax.lax.stop_gradient(jnp.max(jnp.abs(x), axis=axis, keepdims=True)))


def binary_unit(x: Float[Array, "..."]) -> Scalars:
    """Return the largest power of two up to the largest finite |x|, in its unit, so that division
    by it is exact; 1 if all of x is 0. The gradient of the result is 0."""
    finite = jnp.where(jnp.isfinite(x), jnp.abs(x), 0)
    largest = or_one(jax.lax.stop_gradient(jnp.max(finite)))
    return jnp.ldexp(jnp.ones_like(largest), jnp.frexp(largest)[1] - 1)


def unknown_at_nan(found: Any, given: Any) -> Any:
    """Return a record or number, all of which is NaN if `given` has a number that is NaN."""
    lost = jnp.isnan(sum(jnp.sum(x) for x in jax.tree.leaves(given)))
    return jax.tree.map(lambda x: jnp.where(lost, jnp.nan, x), found)


def running_sum(weights: Float[Array, "... n"]) -> Float[Array, "... n"]:
    """Return cumulative sums of weights >= 0, in their unit, which increase only where a weight is
    above 0. XLA's cumulative sums may decrease by rounding errors."""
    total = jnp.where(weights > 0, jnp.cumsum(weights, axis=-1), 0)
    return jax.lax.cummax(total, axis=total.ndim - 1)


def select(condition: Bool[Array, "..."], a: Tree, b: Tree) -> Tree:
    """Return a tree with the arrays of `a` where the condition is true, and of `b` elsewhere."""
    return jax.tree.map(lambda x, y: jnp.where(condition, x, y), a, b)


def _to_unit_size(v: Vec3) -> tuple[Vec3, Scalars]:
    """Return (v / s, s), where s is the magnitude of the largest component, so that the squares of
    v / s neither overflow nor underflow. s has gradient 0, and is 1 for zero and non-finite
    vectors."""
    a = as_vec(v)
    largest = jnp.maximum(jnp.maximum(jnp.abs(a.x), jnp.abs(a.y)), jnp.abs(a.z))
    usable = (largest > 0) & jnp.isfinite(largest)
    invertible = jnp.minimum(largest, float(1 / jnp.finfo(largest.dtype).tiny))
    scale = jax.lax.stop_gradient(jnp.where(usable, invertible, 1))
    return scaled(v, jnp.where(usable, 1 / scale, 1)), scale


@takes_numbers
def norm(v: Vec3) -> Scalars:
    """Return the Euclidean length of vectors; its gradient at the zero vector is 0.

    Args:
        v: (..., 3) or `Vec`, in any unit.

    Returns:
        (...) in the unit of `v`.

    Example:
        >>> round(float(jv.norm(jnp.array([2.0, 3.0, 6.0]))), 4)
        7.0
    """
    sized, scale = _to_unit_size(v)
    return scale * safe_sqrt(dot(sized, sized))


@takes_numbers
def normalize(v: Vec3) -> Vec3:
    """Scale vectors to unit length, v / |v|; the zero vector stays zero.

    Args:
        v: (..., 3) or `Vec`, in any unit.

    Returns:
        (..., 3) or `Vec`, like `v`; unit length.

    Example:
        >>> [round(float(x), 4) for x in jv.normalize(jnp.array([3.0, 0.0, 4.0]))]
        [0.6, 0.0, 0.8]
    """
    sized, _ = _to_unit_size(v)
    square = dot(sized, sized)
    return scaled(sized, 1 / jnp.sqrt(jnp.where(square == 0, 1, square)))


# Rational approximation of (arctan(t) - t) / t^3 in t^2 for |t| <= 0.66, good to 1e-16: Moshier,
# Cephes Mathematical Library, atan.c.
_ARCTAN_ABOVE = (
    -8.750608600031904122785e-1,
    -1.615753718733365076637e1,
    -7.500855792314704667340e1,
    -1.228866684490136173410e2,
    -6.485021904942025371773e1,
)
_ARCTAN_BELOW = (
    1.0,
    2.485846490142306297962e1,
    1.650270098316988542046e2,
    4.328810604912902668951e2,
    4.853903996359136964868e2,
    1.945506571482613964425e2,
)


def polynomial(coefficients: Sequence[float] | Sequence[Scalars], x: Scalars) -> Scalars:
    """Return c_0 x^n + c_1 x^(n - 1) + ... + c_n, by Horner's rule."""
    value = jnp.full_like(x, coefficients[0])
    for coefficient in coefficients[1:]:
        value = value * x + coefficient
    return value


def chebyshev(coefficients: Sequence[float], t: Scalars) -> Scalars:
    """Return the sum of c_k T_k(t) by Clenshaw's recurrence, where T_k are Chebyshev polynomials
    and t is in [-1, 1]. Trailing coefficients too small for the dtype are dropped."""
    least = float(jnp.finfo(t.dtype).eps) / 16
    used = max(k for k, c in enumerate(coefficients) if abs(c) > least)
    b, after = jnp.zeros_like(t), jnp.zeros_like(t)
    for c in coefficients[used:0:-1]:
        b, after = 2 * t * b - after + c, b
    return t * b - after + coefficients[0]


@jax.custom_jvp
def arctan2(y: Scalars, x: Scalars) -> Scalars:
    """Return the angle of (x, y), y >= 0, in [0, pi] rad, within two ULP; 0, with gradient 0, at
    the origin. Unlike XLA's arctan2, this function uses the vector units of a CPU."""
    ahead = jnp.abs(x)
    low, high = jnp.minimum(ahead, y), jnp.maximum(ahead, y)
    wide = low > 0.66 * high  # arctan(r) = pi / 4 + arctan((r - 1) / (r + 1))
    divisor = jnp.where(wide, low + high, high)
    t = jnp.where(wide, low - high, low) / jnp.where(divisor > 0, divisor, 1)
    z = t * t
    angle = t + t * z * (polynomial(_ARCTAN_ABOVE, z) / polynomial(_ARCTAN_BELOW, z))
    angle = jnp.where(wide, np.pi / 4 + angle, angle)
    angle = jnp.where(y > ahead, np.pi / 2 - angle, angle)
    return jnp.where(x < 0, np.pi - angle, angle)


@arctan2.defjvp
def _arctan2_jvp(primals, tangents):
    (y, x), (dy, dx) = primals, tangents
    _, scale = _to_unit_size(Vec(x, y, jnp.zeros_like(x)))
    sine, cosine = y / scale, x / scale
    square = sine * sine + cosine * cosine
    inverse = reciprocal(square) / scale
    return arctan2(y, x), (cosine * dy - sine * dx) * inverse


# sin(x) = x + x^3 S(x^2) and cos(x) = 1 - x^2 / 2 + x^4 C(x^2) for |x| <= pi / 4: Moshier, Cephes
# Mathematical Library, sinf.c and sin.c. (S, C) by the size of the number in bytes.
_SINE_COSINE = {
    4: (
        (-1.9515295891e-4, 8.3321608736e-3, -1.6666654611e-1),
        (2.443315711809948e-5, -1.388731625493765e-3, 4.166664568298827e-2),
    ),
    8: (
        (
            1.58962301576546568060e-10,
            -2.50507477628578072866e-8,
            2.75573136213857245213e-6,
            -1.98412698295895385996e-4,
            8.33333333332211858878e-3,
            -1.66666666666666307295e-1,
        ),
        (
            -1.13585365213876817300e-11,
            2.08757008419747316778e-9,
            -2.75573141792967388112e-7,
            2.48015872888517045348e-5,
            -1.38888888888730564116e-3,
            4.16666666666665929218e-2,
        ),
    ),
}


@jax.custom_jvp
def sine_cosine(turns: Scalars) -> tuple[Scalars, Scalars]:
    """Return (sin, cos) of an angle given in turns of 2 pi rad. The result is exact at quarter
    turns and elsewhere within two ULP. Unlike XLA's sine and cosine, this function uses the vector
    units of a CPU."""
    quarters = jnp.round(4 * turns)
    x = (turns - quarters / 4) * (2 * np.pi)
    square = x * x
    of_sine, of_cosine = _SINE_COSINE[8 if turns.dtype == jnp.float64 else 4]
    s = x + x * square * polynomial(of_sine, square)
    c = 1 - square / 2 + square * square * polynomial(of_cosine, square)
    turn = quarters - 4 * jnp.floor(quarters / 4)  # 0, 1, 2, 3
    odd, behind, below = (turn == 1) | (turn == 3), (turn == 1) | (turn == 2), turn >= 2
    sine, cosine = jnp.where(odd, c, s), jnp.where(odd, s, c)
    return jnp.where(below, -sine, sine), jnp.where(behind, -cosine, cosine)


@sine_cosine.defjvp
def _sine_cosine_jvp(primals, tangents):
    sine, cosine = sine_cosine(*primals)
    rate = (2 * np.pi) * tangents[0]
    return (sine, cosine), (cosine * rate, -sine * rate)


@takes_numbers
def angle_between(u: Directions, v: Directions) -> Float[Array, "..."]:
    """Return the angle between unit vectors, with full relative accuracy near 0 and pi.

    The angle is 2 atan2(|u - v|, |u + v|). The arccos of the inner product would lose all digits
    near 0 and pi.

    Args:
        u: (..., 3) or `Vec`, unit length.
        v: (..., 3) or `Vec`, unit length.

    Returns:
        (...) rad, in [0, pi]; 0 between two zero vectors.

    Source:
        Kahan, "How Futile are Mindless Assessments of Roundoff in Floating-Point Computation?",
        2006.

    Example:
        >>> u, v = jnp.array([1.0, 0.0, 0.0]), jnp.array([1.0, 1e-12, 0.0])
        >>> round(float(jv.angle_between(u, v)) * 1e12, 9)
        1.0
    """
    apart, together = norm(u - v), norm(u + v)
    zero = jnp.maximum(apart, together) <= smallest_divisor(apart.dtype)
    return 2 * arctan2(jnp.where(zero, 0, apart), jnp.where(zero, 1, together))


@takes_numbers
def log_cos_between(u: Directions, v: Directions) -> Float[Array, "..."]:
    """Return the logarithm of the cosine between unit vectors, accurate also near 0 and 90 degrees.

    Below 60 degrees, the cosine is computed as 1 - |u - v|^2 / 2, which is accurate at small
    angles. At larger angles, the cosine is the inner product, which is accurate near a right angle.

    Args:
        u: (..., 3) or `Vec`, unit length.
        v: (..., 3) or `Vec`, unit length.

    Returns:
        (...) no unit, at most 0; the logarithm of the smallest normal number, with gradient 0, at a
        right angle and beyond.

    Example:
        >>> u, v = jnp.array([0.0, 0.0, 1.0]), jnp.array([0.6, 0.0, 0.8])
        >>> round(float(jv.log_cos_between(u, v)), 4)  # ln 0.8
        -0.2231
    """
    chord, cosine = u - v, dot(u, v)
    deficit = dot(chord, chord) / 2
    near, behind = deficit < 0.5, cosine <= 0
    less = jnp.where(near, -deficit, 0)
    # XLA may compute `behind` twice with different rounding. If the two disagree, `least` replaces
    # a cosine that is 0 within rounding.
    least = smallest_divisor(deficit.dtype)
    ahead = jnp.where(near, 1 - deficit, jnp.where(behind, least, cosine))
    logarithm = _log_of_sum(ahead, less)
    return jnp.where(behind, log_of_zero(deficit.dtype), logarithm)


def log1p(x: Scalars) -> Scalars:
    """Return log(1 + x), no unit, within 2.5 ULP. XLA's log1p has errors of 128 ULP in float64
    between -0.414 and -0.29."""
    if x.dtype != jnp.float64:
        return jnp.log1p(x)
    low = x < -0.25
    return jnp.where(low, jnp.log(1 + x), jnp.log1p(jnp.where(x < -0.5, 0, x)))


@jax.custom_jvp
def _log_of_sum(rounded: Scalars, less: Scalars) -> Scalars:
    """Return log(1 + less), no unit, where `rounded` is the sum 1 + less after rounding. The
    logarithm of `rounded` is corrected for its rounding error (Kahan). XLA's log1p costs twice as
    much."""
    kept = rounded - 1
    lost = kept == 0
    corrected = jnp.where(less == 0, 1, less / jnp.where(lost, 1, kept))
    return jnp.where(lost & (less != 0), less, jnp.log(rounded) * corrected)


@_log_of_sum.defjvp
def _log_of_sum_jvp(primals, tangents):
    (rounded, less), (change, _) = primals, tangents
    return _log_of_sum(rounded, less), change / rounded


def power(base: Scalars, exponent: Scalars) -> Scalars:
    """Return base ** exponent with finite gradients in both; 0 ** positive = 0, and a negative base
    is treated as 0."""
    zero = base <= 0
    least = smallest_divisor(base.dtype) ** 2
    return jnp.where(zero, 0, jnp.power(jnp.where(zero, least, base), exponent))


@jax.custom_jvp
def replace_gradient(value: Scalars, smooth: Scalars) -> Scalars:
    """Return `value`, but with the gradient of `smooth`."""
    del smooth
    return value


replace_gradient.defjvps(None, lambda tangent, result, value, smooth: tangent)
