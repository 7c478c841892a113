"""Chromaticity and luminance: xyY. The chromaticity of black is 0."""

import jax.numpy as jnp

from ..core._arguments import takes_numbers
from ._components import (
    Colours,
    divide_or_zero,
    parts,
    reciprocal,
    scale_to_unit,
    stack_components,
    vanishes,
)


@takes_numbers
def xyz_to_xyy(xyz: Colours) -> Colours:
    """Convert XYZ to the chromaticities x and y and the luminance Y.

    Args:
        xyz: (..., 3) relative.

    Returns:
        (..., 3) relative; black, of sum 0, has x = y = 0.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.
    """
    luminance = parts(xyz)[1]
    x, y, z = scale_to_unit(*parts(xyz))
    total = x + y + z
    return stack_components(divide_or_zero(x, total), divide_or_zero(y, total), luminance)


@takes_numbers
def xyy_to_xyz(xyy: Colours) -> Colours:
    """The inverse of `xyz_to_xyy`.

    Args:
        xyy: (..., 3) chromaticities x, y, no unit, and relative Y; y = 0 is black.

    Returns:
        (..., 3) relative XYZ.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.
    """
    x, y, luminance = parts(xyy)
    scale = luminance * reciprocal(y)
    return stack_components(x * scale, jnp.where(vanishes(y), 0, luminance), (1 - x - y) * scale)
