"""Encoding curves (gamma and sRGB) and clipping, for relative values."""

from fractions import Fraction

import jax.numpy as jnp

from ..core._arguments import takes_numbers, takes_range
from ..core._numerics import smallest_divisor
from ..core._powers import (
    Exponent,
    exact,
    exact_inverse,
    exact_power,
    is_above,
    power_in_parts,
    power_of_sum,
)
from ..core._types import (
    DIVISOR,
    Scalars,
    as_relative,
    check_choice,
    name_above,
    refuse_codes,
)

# largest encoded value without a warning: 130 times white by sRGB's curve
MOST_ENCODED, _DIVIDE = 8.0, "divide codes by the largest one, such as 255"


@takes_numbers
@takes_range(gamma=DIVISOR)
def gamma_encode(linear: Scalars, gamma: Scalars | float, *, method: str = "power") -> Scalars:
    """Encode linear values by linear^(1 / gamma). Values below 0 count as 0, with gradient 0.

    Textbooks call this gamma correction: the encoding compensates the power law of a display. Some
    textbooks (Szeliski, Computer Vision, section 3.1.1) give the same formula for inverting a
    gamma.

    Args:
        linear: (...) relative.
        gamma: no unit, above 0.
        method: "power" or "exp2", as for `gamma_decode`.

    Returns:
        (...) relative, encoded.

    Raises:
        ValueError: for a gamma of 0 or less, an unknown method, and codes such as 0 to 255 in place
            of relative values.

    Example:
        >>> round(float(jv.gamma_encode(jnp.array(0.5), 2.2)), 4)
        0.7297
    """
    refuse_codes(linear := as_relative(linear))
    return _raise_to_power(linear, exact_inverse(gamma, linear.dtype), method)


@takes_numbers
@takes_range(gamma=DIVISOR)
def gamma_decode(encoded: Scalars, gamma: Scalars | float, *, method: str = "power") -> Scalars:
    """Decode values by encoded^gamma, the inverse of `gamma_encode`. Values below 0 count as 0.

    Args:
        encoded: (...) relative.
        gamma: no unit, above 0.
        method: "power" has an error of one or two ULP. "exp2", exp2(gamma log2 x), takes a third of
            the time on a CPU, and has an error of up to 20 gamma ULP on [1e-5, 1].

    Returns:
        (...) relative, linear.

    Raises:
        ValueError: for a gamma of 0 or less, an unknown method, and codes such as 0 to 255 in place
            of relative values.

    Example:
        >>> round(float(jv.gamma_decode(jnp.array(0.5), 2.2)), 4)
        0.2176
    """
    refuse_codes(encoded := as_relative(encoded))
    name_above("the encoded picture", encoded, MOST_ENCODED, _DIVIDE)
    return _raise_to_power(encoded, exact(gamma, encoded.dtype), method)


@takes_numbers
def srgb_encode(linear: Scalars, *, method: str = "power") -> Scalars:
    """Encode linear values by the sRGB curve: 12.92 x up to 0.0031308 (also below 0), else 1.055
    x^(1/2.4) - 0.055.

    Args:
        linear: (...) relative.
        method: "power" or "exp2", as for `gamma_decode`.

    Returns:
        (...) relative, encoded.

    Raises:
        ValueError: for an unknown method.

    Source: IEC 61966-2-1.

    Example:
        >>> print(jv.srgb_encode(jnp.array([0.0, 0.18, 1.0])).round(4))
        [0.     0.4614 1.    ]
    """
    refuse_codes(linear := as_relative(linear))
    curved = is_above(linear, Fraction("0.0031308"))
    base, exponent = jnp.where(linear < 0.0015, 1, linear), exact(Fraction(10, 24), linear.dtype)
    if method == "power":
        root, rest = power_in_parts(base, exponent)
        encoded = _round_once(root, 1.055 * rest)
    else:
        encoded = 1.055 * _raise_to_power(base, exponent, method) - 0.055
    return jnp.where(curved, encoded, 12.92 * linear)


def _round_once(root: Scalars, rest: Scalars) -> Scalars:
    """Return 1.055 root - 0.055 + rest, rounding only the root and the last sum (Knuth, The Art of
    Computer Programming 2, section 4.2.2)."""
    offset, offset_rest = exact(Fraction(55, 1000), root.dtype)
    share = offset * root
    more = share - offset
    held = more - share
    lost = (share - (more - held)) - (offset + held)
    total = root + more
    lost = lost + (more - (total - root)) + (offset_rest * (root - 1) + rest)
    return total + jnp.where(jnp.isfinite(lost), lost, 0)


@takes_numbers
def srgb_decode(encoded: Scalars, *, method: str = "power") -> Scalars:
    """The inverse of `srgb_encode`.

    The decoded value is x / 12.92 up to 0.04045 (also below 0), else ((x + 0.055) / 1.055)^2.4.

    Args:
        encoded: (...) relative.
        method: "power" or "exp2", as for `gamma_decode`.

    Returns:
        (...) relative, linear.

    Raises:
        ValueError: for an unknown method.

    Source: IEC 61966-2-1.

    Example:
        >>> round(float(jv.srgb_decode(jnp.array(0.5))), 4)  # ((0.5 + 0.055) / 1.055)^2.4
        0.214
    """
    refuse_codes(encoded := as_relative(encoded))
    name_above("the encoded picture", encoded, MOST_ENCODED, _DIVIDE)
    curved = is_above(encoded, Fraction("0.04045"))
    base = jnp.where(encoded < 0.02, 1, encoded)
    if method == "power":
        linear = power_of_sum(base, Fraction(55, 1000), _SRGB_SCALE, Fraction(24, 10))
    else:
        exponent = exact(Fraction(24, 10), encoded.dtype)
        linear = _raise_to_power((base + 0.055) / 1.055, exponent, method)
    return jnp.where(curved, linear, encoded / 12.92)


_SRGB_SCALE = Fraction("0.8794154614021299193")  # 1.055^-2.4


def _raise_to_power(base: Scalars, exponent: Exponent, method: str) -> Scalars:
    check_choice("method", method, ("power", "exp2"))
    if method == "power":
        return exact_power(base, exponent)
    zero, least = base <= 0, smallest_divisor(base.dtype) ** 2
    return jnp.where(zero, 0, jnp.exp2(exponent[0] * jnp.log2(jnp.where(zero, least, base))))


@takes_numbers
def clip(x: Scalars, low: Scalars | float, high: Scalars | float) -> Scalars:
    """Clip x to [low, high]. Outside, the gradient with respect to x is 0, and the gradient with
    respect to the nearer limit is 1.

    Args:
        x: (...) relative.
        low: relative.
        high: relative.

    Returns:
        (...) relative.
    """
    x = as_relative(x)
    raised = jnp.where(x < low, low, jnp.where(x >= low, x, x + low))  # the sum is NaN
    return jnp.where(raised > high, high, jnp.where(raised <= high, raised, raised + high))
