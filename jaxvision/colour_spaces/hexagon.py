"""HSV and HSL, with the hue as the position around the hexagon of R, G and B, in [0, 1); no
unit."""

import jax.numpy as jnp

from ..core._arguments import takes_numbers
from ..core._types import Scalars, refuse_codes
from ._components import (
    Colours,
    divide_or_zero,
    parts,
    reduce_turn,
    scale_to_unit,
    stack_components,
    to_unit_size,
)


@takes_numbers
def rgb_to_hsv(rgb: Colours) -> Colours:
    """Convert RGB, usually encoded, to hue, saturation and value.

    Args:
        rgb: (..., 3) relative.

    Returns:
        (..., 3) hue in turns in [0, 1), 0 for greys; saturation, 0 for black; and value, relative.

    Raises:
        ValueError: for a last axis other than 3, and for codes such as 0 to 255 in place of
            relative values.

    Source: Smith, "Color Gamut Transform Pairs", SIGGRAPH 1978.
    """
    refuse_codes(rgb)
    value = _ends(*parts(rgb))[1]
    unit = scale_to_unit(*parts(rgb))
    least, most = _ends(*unit)
    return stack_components(_hue(*unit), divide_or_zero(most - least, most), value)


@takes_numbers
def hsv_to_rgb(hsv: Colours) -> Colours:
    """The inverse of `rgb_to_hsv`.

    Args:
        hsv: (..., 3) hue in turns, taken modulo 1; saturation and value, relative.

    Returns:
        (..., 3) relative RGB.

    Raises:
        ValueError: for a last axis other than 3, and for codes such as 0 to 255 in place of
            relative values.
    """
    refuse_codes(hsv)
    hue, saturation, value = parts(hsv)
    sextants = 6 * (hue - jnp.floor(hue))

    def channel(n: int) -> Scalars:
        k = reduce_turn(n + sextants, 6.0)
        return value - value * saturation * _trapezium(k, 4 - k, 0)

    return stack_components(channel(5), channel(3), channel(1))


@takes_numbers
def rgb_to_hsl(rgb: Colours) -> Colours:
    """Convert RGB, usually encoded, to hue, saturation and lightness.

    Args:
        rgb: (..., 3) relative.

    Returns:
        (..., 3) hue in turns in [0, 1), 0 for greys; saturation, 0 for black and white; and
        lightness, relative.

    Raises:
        ValueError: for a last axis other than 3, and for codes such as 0 to 255 in place of
            relative values.
    """
    refuse_codes(rgb)
    least, most = _ends(*parts(rgb))
    lightness = most / 2 + least / 2
    one = to_unit_size(*parts(rgb))
    low, high = one * least, one * most
    # 1 - |2 lightness - 1|, which keeps its digits near black
    room = jnp.minimum(high + low, 2 * one - (high + low))
    hue = _hue(*scale_to_unit(*parts(rgb)))
    return stack_components(hue, divide_or_zero(high - low, room), lightness)


@takes_numbers
def hsl_to_rgb(hsl: Colours) -> Colours:
    """The inverse of `rgb_to_hsl`.

    Args:
        hsl: (..., 3) hue in turns, taken modulo 1; saturation and lightness, relative.

    Returns:
        (..., 3) relative RGB.

    Raises:
        ValueError: for a last axis other than 3, and for codes such as 0 to 255 in place of
            relative values.
    """
    refuse_codes(hsl)
    hue, saturation, lightness = parts(hsl)
    reach = saturation * jnp.minimum(lightness, 1 - lightness)
    twelfths = 12 * (hue - jnp.floor(hue))

    def channel(n: int) -> Scalars:
        k = reduce_turn(n + twelfths, 12.0)
        return lightness - reach * _trapezium(k - 3, 9 - k, -1)

    return stack_components(channel(0), channel(8), channel(4))


def _trapezium(rising: Scalars, falling: Scalars, floor: int) -> Scalars:
    """Return max(floor, min(rising, falling, 1))."""
    return jnp.maximum(jnp.minimum(jnp.minimum(rising, falling), 1), floor)


def _ends(r: Scalars, g: Scalars, b: Scalars) -> tuple[Scalars, Scalars]:
    """Return the smallest and the largest component."""
    return jnp.minimum(jnp.minimum(r, g), b), jnp.maximum(jnp.maximum(r, g), b)


def _hue(r: Scalars, g: Scalars, b: Scalars) -> Scalars:
    """Return the hue as a fraction of a full turn in [0, 1), and 0 for greys."""
    least, most = _ends(r, g, b)
    share = divide_or_zero(jnp.ones_like(most), most - least)
    sextant = jnp.where(
        most == r, (g - b) * share, jnp.where(most == g, 2 + (b - r) * share, 4 + (r - g) * share)
    )
    turn = jnp.where(sextant < 0, sextant + 6, sextant) / 6
    return jnp.where(most == least, 0, reduce_turn(turn, 1.0))
