"""Compute powers and exponentials with errors of one or two ULP. To this end, intermediate values
are sums of two floating-point numbers.

Rounding an exponent p such as 1 / 2.4 to float32 changes x^p by |log x| / 2 ULP. Here the exponent
is a sum of two numbers, p = nearest + rest, and

    x^p = x^nearest (1 + rest log x)

so log x is needed to one digit only. This digit is computed from the bits of x, read as an integer.

XLA's exp has an error of one ULP, and its expm1 an error of five ULP. Here y is written as k ln 2 +
r with an integer k. The functions

    exp(-y) = 2^-k (1 + t),    1 - exp(-y) = (1 - 2^-k) - 2^-k t,    t = exp(-r) - 1, |t| < 0.42,

are computed from t, and the rounding error of each sum is stored as a second number. The powers of
two are run-time values, because a compiler would simplify sums with constants.
"""

import math
from fractions import Fraction
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Bool

from ._numerics import difference_of_products, polynomial, power
from ._types import Scalars

_LN_2 = float(np.log(2))
Exponent = tuple[Scalars, Scalars | float]  # the nearest number of the dtype, and the remainder


def exact(value: Scalars | Fraction | float, dtype: DTypeLike) -> Exponent:
    """Split a number, no unit, into a sum of two floating-point numbers of the dtype. For an array,
    the second number is 0."""
    known = _fraction(value)
    if known is None:
        return jnp.asarray(value), 0.0
    nearest = np.asarray(float(known), dtype)
    return jnp.asarray(nearest), float(known - Fraction(float(nearest)))


def is_above(x: Scalars, limit: Fraction) -> Bool[Array, "..."]:
    """Return whether x is above a limit that the dtype of x may not represent exactly."""
    nearest = np.asarray(float(limit), x.dtype)
    return x >= nearest if Fraction(float(nearest)) > limit else x > nearest


def exact_inverse(value: Scalars | float, dtype: DTypeLike) -> Exponent:
    """Return 1 / value as a sum of two floating-point numbers."""
    known = _fraction(value)
    if known:
        return exact(1 / known, dtype)
    value = jnp.asarray(value)
    inverse, one = 1 / value, jnp.ones_like(value)
    missing = difference_of_products(one, one, value, inverse)
    return inverse, jax.lax.stop_gradient(missing * inverse)


def _fraction(value: Scalars | Fraction | float) -> Fraction | None:
    """Return the exact value of a finite Python number; None for anything else."""
    if isinstance(value, int | float | Fraction) and np.isfinite(float(value)):
        return Fraction(value)
    return None


def power_in_parts(base: Scalars, exponent: Exponent) -> tuple[Scalars, Scalars]:
    """Return base^exponent as a sum of two terms: the power to the nearest representable exponent,
    and a finite remainder. A base below 0 is treated as 0."""
    nearest, rest = exponent
    raised = power(base, nearest)
    return raised, _finite(raised) * (rest * _logarithm(base))


def exact_power(base: Scalars, exponent: Exponent) -> Scalars:
    """Return base^exponent, within two ULP; a base below 0 is treated as 0."""
    nearest, rest = exponent
    raised = power(base, nearest)
    known = isinstance(rest, float) and rest == 0
    return raised if known else raised * (1 + rest * _logarithm(base))


def power_of_sum(x: Scalars, shift: Fraction, factor: Fraction, exponent: Fraction) -> Scalars:
    """Return factor (x + shift)^exponent. The power p of the sum s = x + shift is corrected for the
    rounding error e of s:

        (s + e)^p = s^p (1 + p e / s).

    Six operations compute e exactly: Knuth, The Art of Computer Programming 2, section 4.2.2.
    """
    shifted, shift_rest = exact(shift, x.dtype)
    total = x + shifted
    held = total - x
    lost = (x - (total - held)) + (shifted - held) + shift_rest
    lost = jnp.where(jnp.isinf(total), 0, lost)
    (nearest, rest), (scale, scale_rest) = (exact(part, x.dtype) for part in (exponent, factor))
    raised, one = power(total, nearest), jnp.ones_like(x)
    value = scale * raised
    relative = nearest * (lost / jnp.where(total <= 0, 1, total)) + rest * _logarithm(total)
    # the rounding error of the product, twice as many ULP if the correction crosses a power of two
    cut = difference_of_products(scale * one, raised, value, one)
    missing = _finite(value) * jax.lax.stop_gradient(relative + scale_rest / scale)
    return value + (missing + jnp.where(jnp.isinf(value), 0, jax.lax.stop_gradient(cut)))


def _finite(x: Scalars) -> Scalars:
    return jnp.minimum(x, jnp.finfo(x.dtype).max)


def _logarithm(x: Scalars) -> Scalars:
    """Return log x for x > 0 with an error of at most 0.03, and with gradient 0. The exponent
    bits of x are the whole part of its binary logarithm, and the mantissa is nearly the
    fractional part."""
    whole, bias, digits = _format(x)
    bits = jax.lax.bitcast_convert_type(jax.lax.stop_gradient(x), whole).astype(x.dtype)
    return _LN_2 * (bits * 2.0**-digits - (bias - 0.043))


def _format(x: Scalars) -> tuple[DTypeLike, int, int]:
    """Return three properties of a floating dtype: the integer dtype of the same size, the bias of
    the exponent, and the number of binary digits of the mantissa."""
    limits = jnp.finfo(x.dtype)
    whole = {2: jnp.int16, 4: jnp.int32, 8: jnp.int64}[x.dtype.itemsize]
    return whole, int(limits.maxexp) - 1, int(limits.nmant)


def power_of_two_in(x: Scalars) -> Scalars:
    """Return the largest power of two that is at most x and whose inverse is a normal number. The
    gradient of the result is 0. The result is 1 if x is 0, infinite or NaN."""
    whole, _, digits = _format(x)
    bits = jax.lax.bitcast_convert_type(jax.lax.stop_gradient(x), whole)
    power = jax.lax.bitcast_convert_type(bits >> digits << digits, x.dtype)
    usable = (x >= jnp.finfo(x.dtype).tiny) & (x < jnp.inf)
    return jnp.where(usable, jnp.minimum(power, 2.0 ** (_format(x)[1] - 1)), 1)


def exp2(x: Scalars) -> Scalars:
    """Return 2^x within one ULP."""
    return times_exp2(jnp.ones_like(x), x)


@jax.custom_jvp
def times_exp2(value: Scalars, x: Scalars) -> Scalars:
    """Return value 2^x, with 2^x within one ULP (XLA's own exp2 has an error of |x| / 2 ULP). The
    result is infinite above the range of the dtype, and 0 below it."""
    whole, bias, digits = _format(x)
    limited = jnp.clip(x, -3 * (bias - 1), 3 * (bias - 1))
    steps = jnp.round(limited)
    # three factors, all above 1 or all below 1, so that only the last product may leave the range
    # of the dtype
    first = jnp.round(steps / 3)
    second = jnp.round((steps - first) / 2)
    product = value * jnp.exp2(limited - steps)
    for step in (first, second, steps - first - second):
        bits = (step.astype(whole) + bias) << digits
        product = product * jax.lax.bitcast_convert_type(bits, x.dtype)
    return product


@times_exp2.defjvp
def _times_exp2_jvp(primals, tangents):
    (value, x), (change, dx) = primals, tangents
    product = times_exp2(value, x)
    return product, times_exp2(change, x) + _LN_2 * product * dx


# For float32 and float64 (by their bytes): the integer dtype of the same size, the bias of the
# exponent, the binary digits of the mantissa, the number of terms of the series of t, ln 2 to 15 or
# 32 binary digits, and the remainder of ln 2.
_FORMAT = {
    4: (jnp.int32, 127, 23, 8, 22713 / 2**15, 1.4286068203094172321e-6),
    8: (jnp.int64, 1023, 52, 15, 2977044471 / 2**32, 1.9082149292705877161e-10),
}


class Decay(NamedTuple):
    """The factors and terms of exp(-y) = (left + left_rest) * scale * further and of 1 - exp(-y) =
    lost + lost_rest, no units."""

    left: Scalars  # (...) between 0.7 and 1.5
    left_rest: Scalars  # (...)
    scale: Scalars  # (...) a power of two
    further: Scalars  # (...) another power of two, for products outside the range of the dtype
    lost: Scalars  # (...)
    lost_rest: Scalars  # (...)


def decay(x: Scalars, rest: Scalars) -> Decay:
    """Return the parts of exp(-(x + rest)), with x >= 0 and rest far smaller, no units, to 1e-9 in
    float32 and 1e-17 in float64. `left` is 0 if the result is below the 3/2 power of the smallest
    number."""
    whole, bias, digits, terms, ln_2, ln_2_rest = _FORMAT[x.dtype.itemsize]
    half = bias // 2  # with at most half of the exponent range, the remainders keep their digits
    most = half + bias - 1
    faint = x > most * math.log(2)
    near = jnp.where(faint, 0, x)

    def power_of_two(steps: Scalars) -> Scalars:
        bits = (bias - steps.astype(whole)) << digits
        return jax.lax.bitcast_convert_type(bits, x.dtype)

    k = jnp.round(near / math.log(2))
    r = (near - k * ln_2) - k * ln_2_rest
    series = [(-1) ** n / math.factorial(n) for n in range(terms, 1, -1)]
    curved = r * r * polynomial(series, r)
    small = curved - rest * (1 + (curved - r))
    t = small - r
    t_rest = small - (t + r)

    first = jnp.minimum(k, half)
    scale, upwards = power_of_two(first), power_of_two(-first)
    t, t_rest = t * scale, t_rest * scale
    total, rest_of_one = scale + t, 1 - scale
    lost = rest_of_one - t
    return Decay(
        jnp.where(faint, 0, total * upwards),
        jnp.where(faint, 0, ((t - (total - scale)) + t_rest) * upwards),
        scale,
        power_of_two(k - first),
        jnp.where(faint, 1, lost),
        jnp.where(faint, 0, ((rest_of_one - lost) - t) - t_rest),
    )
