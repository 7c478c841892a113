"""The CIE 1976 spaces: Lab, Luv and their polar form LCh. L* runs from 0 to 100, the hue of LCh
from 0 to 2 pi rad."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers, warn_caller
from ..core._types import Scalars, is_known, refuse_codes
from ._components import (
    Colours,
    chroma_of,
    divide_or_zero,
    hue_angle,
    parts,
    reciprocal,
    scale_to_unit,
    stack_components,
)

_BREAK = 6 / 29
# range of the median of Y / Y_white that indicates Y in per cent and a white of 1
_BRIGHTEST, _LARGEST = 4.0, 200.0
# The largest Y / Y_white of at least 16 colours below which the white is in per cent
_DARKEST, _COLOURS, _PER_CENT = 0.012, 16, 50.0


def _lightness(t: Scalars) -> tuple[Scalars, Scalars]:
    """Return the CIE's compressive function f(t), minus 4/29, as the sum of two numbers. f is the
    cube root above (6/29)^3 and its tangent line t / (3 (6/29)^2) + 4/29 below (CIE 15:2018,
    8.2.1.1). The caller adds the constants last, so that dark colours and small differences keep
    their precision.
    """
    curved = t > _BREAK**3
    root = jnp.cbrt(jnp.maximum(t, _BREAK**3 / 2))
    return jnp.where(curved, root, t * (1 / (3 * _BREAK**2))), jnp.where(curved, -4 / 29, 0.0)


def _inverse_lightness(above: Scalars) -> Scalars:
    """Return t from f(t) - 4/29, the inverse of `_lightness`."""
    root = above + 4 / 29
    return jnp.where(above > 2 / 29, root * root * root, 3 * _BREAK**2 * above)


def _check_scale(y: Scalars, white: Float[Array, "3"]) -> None:
    """Warn about known Y whose scale differs from that of the white: Y up to 100 with a white of Y
    = 1, or Y up to 1 with a white of Y = 100."""
    if not (is_known(y) and is_known(white)) or not y.size or not white[1] > 0:
        return
    shares = np.asarray(y, float) / float(white[1])
    above = _BRIGHTEST < np.median(shares) <= _LARGEST
    below = shares.size >= _COLOURS and white[1] >= _PER_CENT and shares.max() < _DARKEST
    if above or below:
        warn_caller(
            f"Y goes up to {shares.max() * float(white[1]):.4g} beside a white of Y = "
            f"{float(white[1]):.4g}, as if one of them were in per cent: scale both alike."
        )


@takes_numbers
def xyz_to_lab(xyz: Colours, white: Float[Array, "3"]) -> Colours:
    """Convert XYZ to CIE 1976 L*, a*, b*.

    Args:
        xyz: (..., 3) relative.
        white: (3,) relative XYZ of the white.

    Returns:
        (..., 3) L* from 0 to 100, a* and b*, no unit.

    Raises:
        ValueError: for a last axis other than 3, and for codes such as 0 to 255 in place of
            relative values.

    Source: CIE 15:2018, 8.2.1.
    """
    refuse_codes(xyz)
    each = parts(xyz)
    _check_scale(each[1], white)
    thirds = (_lightness(part / white[i]) for i, part in enumerate(each))
    (fx, x_0), (fy, y_0), (fz, z_0) = thirds
    a, b = (fx - fy) + (x_0 - y_0), (fy - fz) + (y_0 - z_0)
    return stack_components(116 * (fy + y_0), 500 * a, 200 * b)


@takes_numbers
def lab_to_xyz(lab: Colours, white: Float[Array, "3"]) -> Colours:
    """The inverse of `xyz_to_lab`.

    Args:
        lab: (..., 3) L* from 0 to 100, a* and b*, no unit.
        white: (3,) relative XYZ of the white.

    Returns:
        (..., 3) relative XYZ.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.
    """
    lightness, a, b = parts(lab)
    above = lightness / 116
    thirds = (above + a / 500, above, above - b / 200)
    return stack_components(*(white[i] * _inverse_lightness(f) for i, f in enumerate(thirds)))


@takes_numbers
def xyz_to_luv(xyz: Colours, white: Float[Array, "3"]) -> Colours:
    """Convert XYZ to CIE 1976 L*, u*, v*.

    Args:
        xyz: (..., 3) relative; black gives 0, 0, 0.
        white: (3,) relative XYZ of the white.

    Returns:
        (..., 3) L* from 0 to 100, u* and v*, no unit.

    Raises:
        ValueError: for a last axis other than 3, and for codes such as 0 to 255 in place of
            relative values.

    Source: CIE 15:2018, 8.2.2.
    """
    refuse_codes(xyz)
    x, y, z = parts(xyz)
    _check_scale(y, white)
    fy, y_0 = _lightness(y / white[1])
    lightness = 116 * (fy + y_0)
    # u' - u'_n over a common denominator, so that the small difference of a near grey is accurate
    x_n, y_n, z_n = white
    x, y, z = scale_to_unit(x, y, z)
    total, total_n = x + 15 * y + 3 * z, x_n + 15 * y_n + 3 * z_n
    scale = divide_or_zero(13 * lightness, total * total_n)
    xy, xz, yz = x * y_n - x_n * y, x * z_n - x_n * z, y * z_n - y_n * z
    u, v = 12 * (5 * xy + xz), 9 * (3 * yz - xy)  # numerators without the terms in 15 y that cancel
    return stack_components(lightness, scale * u, scale * v)


@takes_numbers
def luv_to_xyz(luv: Colours, white: Float[Array, "3"]) -> Colours:
    """The inverse of `xyz_to_luv`.

    Args:
        luv: (..., 3) L* from 0 to 100, u* and v*, no unit.
        white: (3,) relative XYZ of the white.

    Returns:
        (..., 3) relative XYZ.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.
    """
    lightness = parts(luv)[0]
    x_n, y_n, z_n = white
    y = y_n * _inverse_lightness(lightness / 116)
    unit, u, v = scale_to_unit(*parts(luv))
    share = reciprocal(13 * unit)
    sum_n = x_n + 15 * y_n + 3 * z_n
    u_prime, v_prime = u * share + 4 * x_n / sum_n, v * share + 9 * y_n / sum_n
    scale = y * reciprocal(4 * v_prime)
    return stack_components(9 * u_prime * scale, y, (12 - 3 * u_prime - 20 * v_prime) * scale)


@takes_numbers
def to_lch(lab: Colours) -> Colours:
    """Convert Lab or Luv to its polar form: lightness, chroma and hue.

    Args:
        lab: (..., 3) Lab or Luv, no unit.

    Returns:
        (..., 3) lightness and chroma, no unit, and hue in rad in [0, 2 pi), 0 for greys.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.
    """
    lightness, a, b = parts(lab)
    return stack_components(lightness, chroma_of(a, b), hue_angle(a, b))


@takes_numbers
def from_lch(lch: Colours) -> Colours:
    """The inverse of `to_lch`.

    Args:
        lch: (..., 3) lightness and chroma, no unit, and hue in rad.

    Returns:
        (..., 3) Lab or Luv, no unit.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.
    """
    lightness, chroma, hue = parts(lch)
    return stack_components(lightness, chroma * jnp.cos(hue), chroma * jnp.sin(hue))
