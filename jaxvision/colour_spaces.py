"""Colour spaces: conversions on arrays whose last axis holds the three components.

RGB is linear and relative (1 is white) unless a name says otherwise. XYZ has Y = 1 at the white. L*
of Lab and Luv runs from 0 to 100. The hue of LCh is in rad in [0, 2 pi), that of HSV and HSL in
turns in [0, 1). Nothing is clipped. Colours outside a gamut convert there and back, except these
colours outside [0, 1]: by HSV those with a largest component of 0, and by HSL those of lightness 0
or 1.

Values and gradients are finite at black, white and every grey, and however near to them; there the
undefined hue is 0 with gradient 0. A divisor below `smallest_divisor` (3e-10 in float32) counts as
0: so dark a colour has no chromaticity and no saturation, and so grey a colour has no hue in HSV
and HSL. A last axis other than 3 and integer codes are a `ValueError`. Matrices come from
`colour_data` by name, a static option. They are never applied by `@`, which is slow over an axis of
three.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ._numerics import arctan2, divide, norm, safe_sqrt, smallest_divisor
from ._types import Scalars, as_relative, check_choice, check_count, print_by_name
from ._vector import Vec
from .colour_data import cone_matrix, luma_weights, rgb_to_xyz_matrix

Colours = Float[Array, "... 3"]
print_by_name(globals(), "Colours")

# ---------------------------------------------------------------- linear maps


def apply_matrix(colours: Colours, matrix: Float[Array, "3 3"]) -> Colours:
    """A 3 x 3 matrix times each colour: a camera's colour correction, or any change of primaries.

    Args:
        colours: (..., 3) relative.
        matrix: (3, 3) no unit.

    Returns:
        (..., 3) relative.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.
    """
    colours = _checked(colours)
    over_pixels = (1,) * (colours.ndim - 1) + (3,)
    # a sum of columns: on a CPU 25 times faster than `@`, and 3 times than three rows stacked
    columns = (matrix[:, i].reshape(over_pixels) for i in range(3))
    first, second, third = (colours[..., i : i + 1] * col for i, col in enumerate(columns))
    return first + second + third


def _by_constant(colours: Colours, matrix: np.ndarray) -> Colours:
    """`apply_matrix` with a matrix known while tracing, in the dtype of the colours."""
    colours = _checked(colours)
    return apply_matrix(colours, jnp.asarray(matrix, colours.dtype))


def _checked(colours: Colours) -> Colours:
    colours = as_relative(colours)
    if colours.shape[-1:] != (3,):
        raise ValueError(f"colours must have a last axis of 3, got shape {colours.shape}.")
    return colours


def _parts(colours: Colours) -> tuple[Scalars, Scalars, Scalars]:
    colours = _checked(colours)
    return colours[..., 0], colours[..., 1], colours[..., 2]


def _joined(*parts: Scalars) -> Colours:
    return jnp.stack(parts, axis=-1)


def rgb_to_xyz(rgb: Colours, *, space: str = "sRGB") -> Colours:
    """Linear RGB of a working space to XYZ under the white of that space.

    Args:
        rgb: (..., 3) linear, relative.
        space: a name of `colour_data.rgb_to_xyz_matrix`.

    Returns:
        (..., 3) XYZ, relative: Y = 1 is white.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.

    Example:
        >>> white = jv.colour_spaces.rgb_to_xyz(jnp.ones(3))
        >>> [round(float(x), 2) for x in white]
        [0.95, 1.0, 1.09]
    """
    return _by_constant(rgb, rgb_to_xyz_matrix(space))


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
    return _by_constant(xyz, np.linalg.inv(rgb_to_xyz_matrix(space)))


def luminance(rgb: Colours, *, space: str = "sRGB") -> Scalars:
    """Y of linear RGB.

    Args:
        rgb: (..., 3) linear, relative.
        space: a name of `colour_data.rgb_to_xyz_matrix`.

    Returns:
        (...) relative.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.
    """
    red, green, blue = rgb_to_xyz_matrix(space)[1].tolist()
    r, g, b = _parts(rgb)
    return red * r + green * g + blue * b


def adapt(
    xyz: Colours,
    white: Float[Array, "3"],
    wanted: Float[Array, "3"],
    *,
    method: str = "Bradford",
) -> Colours:
    """Chromatic adaptation: the colours that look the same under another white.

    The responses of the cones are scaled (von Kries' law).

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
    seen, sought = _by_constant(white, cones), _by_constant(wanted, cones)
    scaled = [
        part * (sought[i] / seen[i]) for i, part in enumerate(_parts(_by_constant(xyz, cones)))
    ]
    return _by_constant(_joined(*scaled), np.linalg.inv(cones))


def change_rgb_space(
    rgb: Colours, *, source: str, target: str, adaptation: str | None = "Bradford"
) -> Colours:
    """Linear RGB of one working space in the primaries of another.

    Args:
        rgb: (..., 3) linear, relative.
        source: the space of `rgb`, a name of `colour_data.rgb_to_xyz_matrix`.
        target: the wanted space, likewise.
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
    return _by_constant(rgb, from_xyz @ to_xyz)


# ---------------------------------------------------------------- chromaticity


def xyz_to_xyy(xyz: Colours) -> Colours:
    """Chromaticities and luminance (x, y, Y).

    Args:
        xyz: (..., 3) relative.

    Returns:
        (..., 3) relative; black has x = y = 0.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.
    """
    x, y, z = _parts(xyz)
    share = _reciprocal(x + y + z)
    return _joined(x * share, y * share, y)


def xyy_to_xyz(xyy: Colours) -> Colours:
    """The inverse of `xyz_to_xyy`.

    Args:
        xyy: (..., 3) chromaticities x, y, no unit, and relative Y; y = 0 is black.

    Returns:
        (..., 3) relative XYZ.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.
    """
    x, y, luminance = _parts(xyy)
    scale = luminance * _reciprocal(y)
    return _joined(x * scale, jnp.where(_vanishes(y), 0, luminance), (1 - x - y) * scale)


def _vanishes(x: Scalars) -> Bool[Array, "..."]:
    """Whether a divisor counts as 0; NaN does not."""
    return jnp.abs(x) < smallest_divisor(x.dtype)


def _reciprocal(x: Scalars) -> Scalars:
    """1 / x, with 0 where x vanishes."""
    return divide(1, x, ~_vanishes(x))


# ---------------------------------------------------------------- CIE 1976

_BREAK = 6 / 29


def _lightness(t: Scalars) -> Scalars:
    """CIE 15:2018, 8.2.1.1: the cube root above (6/29)^3, its tangent line below."""
    curved = t > _BREAK**3
    return jnp.where(curved, jnp.cbrt(jnp.where(curved, t, 1)), t * (1 / (3 * _BREAK**2)) + 4 / 29)


def _from_lightness(f: Scalars) -> Scalars:
    return jnp.where(f > _BREAK, f * f * f, 3 * _BREAK**2 * (f - 4 / 29))


def xyz_to_lab(xyz: Colours, white: Float[Array, "3"]) -> Colours:
    """CIE 1976 L*, a*, b*.

    Args:
        xyz: (..., 3) relative.
        white: (3,) relative XYZ of the white.

    Returns:
        (..., 3) L* from 0 to 100, a* and b*, no unit.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.

    Source: CIE 15:2018, 8.2.1.
    """
    fx, fy, fz = (_lightness(part / white[i]) for i, part in enumerate(_parts(xyz)))
    return _joined(116 * fy - 16, 500 * (fx - fy), 200 * (fy - fz))


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
    lightness, a, b = _parts(lab)
    fy = (lightness + 16) / 116
    parts = (fy + a / 500, fy, fy - b / 200)
    return _joined(*(white[i] * _from_lightness(f) for i, f in enumerate(parts)))


def xyz_to_luv(xyz: Colours, white: Float[Array, "3"]) -> Colours:
    """CIE 1976 L*, u*, v*.

    Args:
        xyz: (..., 3) relative; black gives 0, 0, 0.
        white: (3,) relative XYZ of the white.

    Returns:
        (..., 3) L* from 0 to 100, u* and v*, no unit.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.

    Source: CIE 15:2018, 8.2.2.
    """
    x, y, z = _parts(xyz)
    lightness = 116 * _lightness(y / white[1]) - 16
    # u' - u'_n over one common denominator: a near grey keeps the digits of its small difference
    x_n, y_n, z_n = white
    total, total_n = x + 15 * y + 3 * z, x_n + 15 * y_n + 3 * z_n
    scale = 13 * lightness * _reciprocal(total * total_n)
    u, v = 4 * (x * total_n - x_n * total), 9 * (y * total_n - y_n * total)
    return _joined(lightness, scale * u, scale * v)


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
    lightness, u, v = _parts(luv)
    share = _reciprocal(13 * lightness)
    x_n, y_n, z_n = white
    sum_n = x_n + 15 * y_n + 3 * z_n
    u_prime, v_prime = u * share + 4 * x_n / sum_n, v * share + 9 * y_n / sum_n
    y = y_n * _from_lightness((lightness + 16) / 116)
    scale = y * _reciprocal(4 * v_prime)
    return _joined(9 * u_prime * scale, y, (12 - 3 * u_prime - 20 * v_prime) * scale)


def to_lch(lab: Colours) -> Colours:
    """Lab or Luv in polar form: lightness, chroma, hue.

    Args:
        lab: (..., 3) Lab or Luv, no unit.

    Returns:
        (..., 3) lightness and chroma, no unit, and hue in rad in [0, 2 pi), 0 for greys.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.
    """
    lightness, a, b = _parts(lab)
    return _joined(lightness, _chroma(a, b), _hue_angle(a, b))


def from_lch(lch: Colours) -> Colours:
    """The inverse of `to_lch`.

    Args:
        lch: (..., 3) lightness and chroma, no unit, and hue in rad.

    Returns:
        (..., 3) Lab or Luv, no unit.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.
    """
    lightness, chroma, hue = _parts(lch)
    return _joined(lightness, chroma * jnp.cos(hue), chroma * jnp.sin(hue))


def _chroma(a: Scalars, b: Scalars) -> Scalars:
    return norm(Vec(a, b, jnp.zeros_like(a)))


def _hue_angle(a: Scalars, b: Scalars) -> Scalars:
    below = b < 0
    angle = arctan2(jnp.where(below, -b, b), a)
    return _within(jnp.where(below, 2 * jnp.pi - angle, angle), 2 * jnp.pi)


def _within(hue: Scalars, turn: float) -> Scalars:
    """`hue`, with a full turn, which rounding makes of values just below it, back at 0."""
    return hue - jnp.where(hue >= turn, turn, 0)


# ---------------------------------------------------------------- colour difference


def delta_e_76(lab: Colours, other: Colours) -> Scalars:
    """Euclidean distance in Lab, CIE 1976; the gradient is 0 between equal colours.

    Args:
        lab: (..., 3) Lab, no unit.
        other: (..., 3) Lab.

    Returns:
        (...) no unit.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.
    """
    return norm(Vec(*_parts(lab - other)))


def delta_e_2000(lab: Colours, other: Colours) -> Scalars:
    """The CIEDE2000 colour difference; the gradient is 0 between equal colours.

    Discontinuous, as published, between colours of opposite hue.

    Args:
        lab: (..., 3) Lab, no unit.
        other: (..., 3) Lab.

    Returns:
        (...) no unit.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.

    Source: Sharma, Wu, Dalal, "The CIEDE2000 Color-Difference Formula", Color Research and
    Application 30 (2005), equations 2-22.

    Example:
        >>> first = jnp.array([50.0, 2.6772, -79.7751])  # the paper's first pair
        >>> print(f"{jv.colour_spaces.delta_e_2000(first, jnp.array([50.0, 0.0, -82.7485])):.4f}")
        2.0425
    """
    l1, a1, b1 = _parts(lab)
    l2, a2, b2 = _parts(other)
    mean_chroma = (_chroma(a1, b1) + _chroma(a2, b2)) / 2
    g = (1 - _chroma_weight(mean_chroma)) / 2
    a1, a2 = (1 + g) * a1, (1 + g) * a2
    c1, c2 = _chroma(a1, b1), _chroma(a2, b2)
    h1, h2 = _hue_angle(a1, b1), _hue_angle(a2, b2)
    hued = (c1 > 0) & (c2 > 0)

    turn = h2 - h1
    turn = turn - jnp.where(jnp.abs(turn) > jnp.pi, 2 * jnp.pi * jnp.sign(turn), 0)
    d_l, d_c = l2 - l1, c2 - c1
    d_h = 2 * safe_sqrt(c1) * safe_sqrt(c2) * jnp.sin(jnp.where(hued, turn, 0) / 2)

    mean_l, mean_c, mean_h = (l1 + l2) / 2, (c1 + c2) / 2, (h1 + h2) / 2
    apart = jnp.abs(h1 - h2) > jnp.pi
    mean_h = mean_h + jnp.where(apart, jnp.where(mean_h < jnp.pi, jnp.pi, -jnp.pi), 0)
    mean_h = jnp.where(hued, mean_h, h1 + h2)
    t = (
        1
        - 0.17 * jnp.cos(mean_h - jnp.pi / 6)
        + 0.24 * jnp.cos(2 * mean_h)
        + 0.32 * jnp.cos(3 * mean_h + jnp.pi / 30)
        - 0.20 * jnp.cos(4 * mean_h - 63 * jnp.pi / 180)
    )
    s_l = 1 + 0.015 * (mean_l - 50) ** 2 / jnp.sqrt(20 + (mean_l - 50) ** 2)
    s_c, s_h = 1 + 0.045 * mean_c, 1 + 0.015 * mean_c * t
    # in degrees, as published: 30 exp(-((h - 275) / 25)^2)
    d_theta = jnp.pi / 6 * jnp.exp(-(((jnp.rad2deg(mean_h) - 275) / 25) ** 2))
    r_t = -2 * _chroma_weight(mean_c) * jnp.sin(2 * d_theta)
    lightness, chroma, hue = d_l / s_l, d_c / s_c, d_h / s_h
    # sqrt(lightness^2 + chroma^2 + hue^2 + r_t chroma hue), r_t^2 < 4, as a sum of three squares,
    # so that the root neither underflows nor loses its gradient
    return norm(Vec(lightness, chroma + r_t / 2 * hue, safe_sqrt(1 - r_t * r_t / 4) * hue))


def _chroma_weight(chroma: Scalars) -> Scalars:
    """sqrt(C^7 / (C^7 + 25^7)); written so that neither power overflows, nor its gradient at 0."""
    low = jnp.minimum(chroma / 25, 1)
    high = 25 / jnp.maximum(chroma, 25)
    colourful = chroma > 25
    ratio7 = jnp.where(colourful, 1 / (1 + high**7), low**7 / (1 + low**7))
    return safe_sqrt(ratio7)


# ---------------------------------------------------------------- HSV, HSL, Y'CbCr


def rgb_to_hsv(rgb: Colours) -> Colours:
    """Hue, saturation and value of RGB, usually encoded.

    Args:
        rgb: (..., 3) relative.

    Returns:
        (..., 3) hue in turns in [0, 1), 0 for greys; saturation, 0 for black, and value, relative.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.

    Source: Smith, "Color Gamut Transform Pairs", SIGGRAPH 1978.
    """
    hue, least, most = _hexagon(rgb)
    return _joined(hue, (most - least) * _reciprocal(most), most)


def hsv_to_rgb(hsv: Colours) -> Colours:
    """The inverse of `rgb_to_hsv`.

    Args:
        hsv: (..., 3) hue in turns, taken modulo 1; saturation and value, relative.

    Returns:
        (..., 3) relative RGB.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.
    """
    hue, saturation, value = _parts(hsv)

    def channel(n: int) -> Scalars:
        k = jnp.mod(n + 6 * hue, 6)
        return value - value * saturation * _trapezium(k, 4 - k, 0)

    return _joined(channel(5), channel(3), channel(1))


def rgb_to_hsl(rgb: Colours) -> Colours:
    """Hue, saturation and lightness of RGB, usually encoded.

    Args:
        rgb: (..., 3) relative.

    Returns:
        (..., 3) hue in turns in [0, 1), 0 for greys; saturation, 0 for black and white, and
        lightness, relative.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.
    """
    hue, least, most = _hexagon(rgb)
    # 1 - |2 lightness - 1|, which keeps its digits near black
    room = jnp.minimum(most + least, 2 - (most + least))
    return _joined(hue, (most - least) * _reciprocal(room), (most + least) / 2)


def hsl_to_rgb(hsl: Colours) -> Colours:
    """The inverse of `rgb_to_hsl`.

    Args:
        hsl: (..., 3) hue in turns, taken modulo 1; saturation and lightness, relative.

    Returns:
        (..., 3) relative RGB.

    Raises:
        ValueError: for a last axis other than 3, and for integer codes.
    """
    hue, saturation, lightness = _parts(hsl)
    reach = saturation * jnp.minimum(lightness, 1 - lightness)

    def channel(n: int) -> Scalars:
        k = jnp.mod(n + 12 * hue, 12)
        return lightness - reach * _trapezium(k - 3, 9 - k, -1)

    return _joined(channel(0), channel(8), channel(4))


def _trapezium(rising: Scalars, falling: Scalars, floor: int) -> Scalars:
    """max(floor, min(rising, falling, 1))"""
    return jnp.maximum(jnp.minimum(jnp.minimum(rising, falling), 1), floor)


def _hexagon(rgb: Colours) -> tuple[Scalars, Scalars, Scalars]:
    """(hue in turns, smallest, largest component)."""
    r, g, b = _parts(rgb)
    most, least = jnp.maximum(jnp.maximum(r, g), b), jnp.minimum(jnp.minimum(r, g), b)
    share = _reciprocal(most - least)
    sextant = jnp.where(
        most == r, (g - b) * share, jnp.where(most == g, 2 + (b - r) * share, 4 + (r - g) * share)
    )
    turn = jnp.where(sextant < 0, sextant + 6, sextant) / 6
    return jnp.where(_vanishes(most - least), 0, _within(turn, 1.0)), least, most


def rgb_to_ycbcr(
    rgb: Colours, *, standard: str = "ITU-R BT.709", levels: str = "full", bits: int = 8
) -> Colours:
    """Luma and colour differences Y', Cb, Cr of encoded R'G'B'.

    Args:
        rgb: (..., 3) encoded, relative.
        standard: "ITU-R BT.601", "ITU-R BT.709" or "ITU-R BT.2020" (non-constant luminance).
        levels: "full" gives Y' in [0, 1] and Cb, Cr in [-0.5, 0.5]. "legal" gives the studio codes
            over the largest code: at 8 bits Y' in [16, 235] / 255 and Cb, Cr in [16, 240] / 255.
        bits: of the studio codes, at least 8.

    Returns:
        (..., 3) relative.

    Raises:
        ValueError: for other levels, fewer than 8 bits, a last axis other than 3, and integer
            codes.
    """
    matrix, zero = _ycbcr(standard, levels, bits)
    centred = _by_constant(rgb, matrix)
    return centred + jnp.broadcast_to(jnp.asarray(zero, centred.dtype), centred.shape)


def ycbcr_to_rgb(
    ycbcr: Colours, *, standard: str = "ITU-R BT.709", levels: str = "full", bits: int = 8
) -> Colours:
    """The inverse of `rgb_to_ycbcr`.

    Args:
        ycbcr: (..., 3) relative.
        standard: as for `rgb_to_ycbcr`.
        levels: "full" or "legal".
        bits: of the studio codes, at least 8.

    Returns:
        (..., 3) encoded R'G'B', relative.

    Raises:
        ValueError: for other levels, fewer than 8 bits, a last axis other than 3, and integer
            codes.
    """
    matrix, zero = _ycbcr(standard, levels, bits)
    ycbcr = _checked(ycbcr)
    centred = ycbcr - jnp.broadcast_to(jnp.asarray(zero, ycbcr.dtype), ycbcr.shape)
    return _by_constant(centred, np.linalg.inv(matrix))


def _ycbcr(standard: str, levels: str, bits: int) -> tuple[np.ndarray, np.ndarray]:
    """The matrix from R'G'B' and the offset added to its result."""
    check_choice("levels", levels, ("full", "legal"))
    check_count("bits", bits, 8)
    luma = np.asarray(luma_weights(standard))
    red, _, blue = np.eye(3)
    rows = [luma, (blue - luma) / (2 - 2 * luma[2]), (red - luma) / (2 - 2 * luma[0])]
    if levels == "full":
        return np.stack(rows), np.zeros(3)
    step = 2 ** (bits - 8) / (2**bits - 1)
    scale = np.array([219, 224, 224]) * step
    return scale[:, None] * np.stack(rows), np.array([16, 128, 128]) * step
