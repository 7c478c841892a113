"""exp(-y) and 1 - exp(-y), each as a number of the dtype and the little that it lacks.

XLA's exp is off by one unit in the last place, its expm1 by five. Here y = k ln 2 + r, and

    exp(-y) = 2^-k (1 + t),    1 - exp(-y) = (1 - 2^-k) - 2^-k t,    t = exp(-r) - 1, |t| < 0.42,

from which both follow with what each sum loses. The powers of two are variables of the program,
not constants, beside which a compiler would simplify the sums.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from ._numerics import polynomial
from ._types import Scalars

# By the bytes of a number: integers of its size, the bias of its exponent, the binary digits of its
# mantissa, the terms of the series of t, ln 2 to 15 or 32 digits, and its rest.
_FORMAT = {
    4: (jnp.int32, 127, 23, 8, 22713 / 2**15, 1.4286068203094172321e-6),
    8: (jnp.int64, 1023, 52, 15, 2977044471 / 2**32, 1.9082149292705877161e-10),
}


class Decay(NamedTuple):
    """exp(-y) = (left + left_rest) scale further, and 1 - exp(-y) = lost + lost_rest, no units.

    Attributes:
        left: (...) between 0.7 and 1.5.
        left_rest: (...)
        scale: (...) a power of two.
        further: (...) another one, so that the product may leave the range of the dtype.
        lost: (...)
        lost_rest: (...)
    """

    left: Scalars
    left_rest: Scalars
    scale: Scalars
    further: Scalars
    lost: Scalars
    lost_rest: Scalars


def decay(x: Scalars, rest: Scalars) -> Decay:
    """The parts of the exponential of -(x + rest), x >= 0 and rest far smaller, no units, to 1e-9
    of a float32 and 1e-17 of a float64; `left` is 0 where exp(-x) is below the smallest number to
    the power 3/2."""
    whole, bias, digits, terms, ln_2, ln_2_rest = _FORMAT[x.dtype.itemsize]
    half = bias // 2  # below the half of the range even the rests keep their digits
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
