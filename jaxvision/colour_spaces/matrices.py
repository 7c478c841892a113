"""Linear maps of colours: between RGB and XYZ, to luminance, and by chromatic adaptation. All
colours are relative (1 is white)."""

import numpy as np
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._types import Scalars, refuse_codes
from ._components import (
    Colours,
    check_colours,
    multiply_matrix,
    parts,
    stack_components,
    times_matrix,
)
from .colour_data import cone_matrix, rgb_to_xyz_matrix


@takes_numbers
def apply_matrix(colours: Colours, matrix: Float[Array, "3 3"]) -> Colours:
    """Multiply each colour by a 3 x 3 matrix, such as a camera's colour correction or a change of
    primaries.

    Args:
        colours: (..., 3) relative.
        matrix: (3, 3) no unit.

    Returns:
        (..., 3) relative.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.
    """
    return multiply_matrix(check_colours(colours), matrix)


@takes_numbers
def rgb_to_xyz(rgb: Colours, *, space: str = "sRGB") -> Colours:
    """Convert linear RGB of a working space to XYZ under the white of that space.

    Args:
        rgb: (..., 3) linear, relative.
        space: a name of `colour_data.rgb_to_xyz_matrix`.

    Returns:
        (..., 3) XYZ, relative: Y = 1 is white.

    Raises:
        ValueError: for a last axis other than 3, and for codes such as 0 to 255 in place of
            relative values.

    Example:
        >>> white = jv.colour_spaces.rgb_to_xyz(jnp.ones(3))
        >>> [round(float(x), 2) for x in white]
        [0.95, 1.0, 1.09]
    """
    refuse_codes(rgb)
    return times_matrix(rgb, rgb_to_xyz_matrix(space))


@takes_numbers
def xyz_to_rgb(xyz: Colours, *, space: str = "sRGB") -> Colours:
    """The inverse of `rgb_to_xyz`.

    Args:
        xyz: (..., 3) relative.
        space: a name of `colour_data.rgb_to_xyz_matrix`.

    Returns:
        (..., 3) linear RGB, relative; components outside the gamut are below 0.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.
    """
    return times_matrix(xyz, np.linalg.inv(rgb_to_xyz_matrix(space)))


@takes_numbers
def luminance(rgb: Colours, *, space: str = "sRGB") -> Scalars:
    """Return the luminance Y of linear RGB.

    Args:
        rgb: (..., 3) linear, relative.
        space: a name of `colour_data.rgb_to_xyz_matrix`.

    Returns:
        (...) relative.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.
    """
    red, green, blue = rgb_to_xyz_matrix(space)[1].tolist()
    r, g, b = parts(rgb)
    return red * r + green * g + blue * b


@takes_numbers
def adapt(
    xyz: Colours,
    white: Float[Array, "3"],
    wanted: Float[Array, "3"],
    *,
    method: str = "Bradford",
) -> Colours:
    """Adapt colours to another white: return the colours that look the same under that white.

    The adaptation scales the responses of the cones (von Kries' law).

    Args:
        xyz: (..., 3) relative, seen under `white`.
        white: (3,) relative XYZ, as `colour_data.white_point` gives it.
        wanted: (3,) relative XYZ of the white to adapt to.
        method: a name of `colour_data.cone_matrix`.

    Returns:
        (..., 3) relative XYZ under the white `wanted`.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.
    """
    cones = cone_matrix(method)
    seen, sought = times_matrix(white, cones), times_matrix(wanted, cones)
    scaled = [
        part * (sought[i] / seen[i]) for i, part in enumerate(parts(times_matrix(xyz, cones)))
    ]
    return times_matrix(stack_components(*scaled), np.linalg.inv(cones))


@takes_numbers
def change_rgb_space(
    rgb: Colours, *, source: str, target: str, adaptation: str | None = "Bradford"
) -> Colours:
    """Convert linear RGB of one working space to the primaries of another.

    Args:
        rgb: (..., 3) linear, relative.
        source: the space of `rgb`, a name of `colour_data.rgb_to_xyz_matrix`.
        target: the wanted space, another such name.
        adaptation: a name of `colour_data.cone_matrix`, by which the white of the source becomes
            the white of the target; None keeps the colours themselves.

    Returns:
        (..., 3) linear, relative.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.
    """
    to_xyz, from_xyz = rgb_to_xyz_matrix(source), np.linalg.inv(rgb_to_xyz_matrix(target))
    if adaptation is not None:
        cones = cone_matrix(adaptation)
        whites = [cones @ rgb_to_xyz_matrix(space).sum(axis=1) for space in (source, target)]
        to_xyz = np.linalg.solve(cones, np.diag(whites[1] / whites[0]) @ cones) @ to_xyz
    return times_matrix(rgb, from_xyz @ to_xyz)
