"""The change of a picture by JPEG compression, without writing a file: baseline ITU-T T.81 as
libjpeg implements it.

The steps are conversion to luma and chroma, chroma at half size, 8 x 8 cosine transforms, division
by a table and rounding, and their inverses. Pictures are (..., h, w, bands) with one band or
R'G'B', encoded and relative. 1 is code 255, and values outside [0, 1] are clipped, like bytes. NaN
spreads over its 8 x 8 block, and to the pixels whose chroma is computed together with that of the
NaN.

`rounding` is the method of rounding. "straight_through" rounds every code and coefficient to the
same integer as libjpeg with its accurate integer transform and its chroma filters. Gradients ignore
that rounding. "cubic" rounds only the coefficients, by the differentiable round(x) + (x -
round(x))^3 (Shin and Song, "JPEG-resistant adversarial images", NIPS workshop 2017).

The quality, 1 to 100, is libjpeg's (Independent JPEG Group), and scales the quantisation tables of
T.81, annex K.
"""

from functools import partial, reduce
from operator import add

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Shaped

from ..core._arguments import takes_numbers, warn_caller
from ..core._loops.fusion import materialise
from ..core._numerics import replace_gradient
from ..core._types import (
    Image,
    Scalar,
    as_float,
    as_relative,
    check_choice,
    is_known,
    refuse_codes,
)
from ..filters.padding import Picture
from ..scene.developments import ROUNDINGS, SUBSAMPLINGS

Plane = Float[Array, "h w"]
Other = Float[Array, "_ _"]
Table = Float[Array, "8 8"]

_LUMA_TABLE = np.array(
    [
        [16, 11, 10, 16, 24, 40, 51, 61],
        [12, 12, 14, 19, 26, 58, 60, 55],
        [14, 13, 16, 24, 40, 57, 69, 56],
        [14, 17, 22, 29, 51, 87, 80, 62],
        [18, 22, 37, 56, 68, 109, 103, 77],
        [24, 35, 55, 64, 81, 104, 113, 92],
        [49, 64, 78, 87, 103, 121, 120, 101],
        [72, 92, 95, 98, 112, 100, 103, 99],
    ],
    float,
)
_CHROMA_TABLE = np.full((8, 8), 99.0)
_CHROMA_TABLE[:4, :4] = [[17, 18, 24, 47], [18, 21, 26, 66], [24, 26, 56, 99], [47, 66, 99, 99]]

# sqrt(8) times the orthonormal cosines, in units of 2^-13, as sums of libjpeg's thirteen-bit
# constants (jfdctint.c, after Loeffler, Ligtenberg and Moschytz, ICASSP 1989). The inverse is the
# transpose.
_COSINES = np.array(
    [
        [8192, 8192, 8192, 8192, 8192, 8192, 8192, 8192],
        [11363, 9633, 6437, 2260, -2260, -6437, -9633, -11363],
        [10703, 4433, -4433, -10703, -10703, -4433, 4433, 10703],
        [9633, -2259, -11362, -6436, 6436, 11362, 2259, -9633],
        [8192, -8192, -8192, 8192, 8192, -8192, -8192, 8192],
        [6437, -11362, 2261, 9633, -9633, -2261, 11362, -6437],
        [4433, -10704, 10704, -4433, -4433, 10704, -10704, 4433],
        [2260, -6436, 9633, -11363, 11363, -9633, 6436, -2260],
    ],
    np.int32,
)


def quantisation_tables(
    quality: Scalar | float, *, rounding: str = "straight_through"
) -> tuple[Table, Table]:
    """Return the divisors of the cosine coefficients, for luma and for chroma.

    Args:
        quality: () no unit, clipped to [1, 100], with a warning unless it is traced.
        rounding: "straight_through" rounds to whole numbers, "cubic" keeps the scaled tables.

    Returns:
        Two tables (8, 8) from 1 to 255, no unit.

    Raises:
        ValueError: for another rounding.

    Example:
        >>> luma, chroma = jv.development.quantisation_tables(90)
        >>> print(luma[0].astype(int))
        [ 3  2  2  3  5  8 10 12]
    """
    _warn_of_quality(quality)
    return _tables(quality, _is_whole(rounding))


def _warn_of_quality(quality: Scalar | float) -> None:
    if is_known(quality) and not 1 <= np.asarray(quality) <= 100:
        warn_caller(f"quality is a number from 1 to 100, got {quality:g}; the nearest is taken.")


def _tables(quality: Scalar | float, whole: bool) -> tuple[Table, Table]:
    """Return the divisors of `quantisation_tables`, rounded or not."""
    quality = jnp.clip(as_float(quality), 1, 100)
    low = quality < 50
    divisor = jnp.where(low, quality, 1)
    enlarged = _part(jnp.full_like(divisor, 5000), _NO_TIE, divisor, whole)
    percent = jnp.where(low, enlarged, 200 - 2 * quality)

    def scale_table(table: np.ndarray) -> Table:
        hundredfold = jnp.asarray(table, percent.dtype) * percent
        return jnp.clip(_part(hundredfold, 50 + _NO_TIE, 100, whole), 1, 255)

    return scale_table(_LUMA_TABLE), scale_table(_CHROMA_TABLE)


@takes_numbers
def jpeg(
    picture: Picture,
    quality: Scalar | float,
    *,
    subsampling: str = "4:2:0",
    rounding: str = "straight_through",
) -> Image:
    """Return the picture as it would be read back from a JPEG file.

    Args:
        picture: (..., h, w, 1) or (..., h, w, 3) encoded, relative; half precision passes through
            float32.
        quality: () no unit, clipped to [1, 100], with a warning unless it is traced.
        subsampling: "4:4:4" keeps the resolution of chroma; "4:2:0" halves it along both axes (and
            upsamples with libjpeg's triangle filter).
        rounding: "straight_through" or "cubic".

    Returns:
        The picture's shape, relative.

    Raises:
        ValueError: for another choice, other than one or three bands, and codes such as 0 to 255 in
            place of relative values.

    Example:
        >>> row = jnp.linspace(0.0, 1.0, 8)
        >>> ramp = jnp.stack([row] * 8)[..., None]
        >>> off = [float(abs(jv.jpeg(ramp, quality) - ramp).max()) for quality in (95.0, 5.0)]
        >>> off[0] < 0.02, off[1] > 0.05
        (True, True)
    """
    picture = as_relative(picture)
    if picture.ndim < 3 or picture.shape[-1] not in (1, 3) or not picture.size:
        raise ValueError(
            f"picture must be (..., h, w, 1) or (..., h, w, 3) with at least one pixel, got shape "
            f"{picture.shape}."
        )
    refuse_codes(picture)
    check_choice("subsampling", subsampling, SUBSAMPLINGS)
    _warn_of_quality(quality)
    return _jpeg(picture, quality, subsampling, _is_whole(rounding))


@partial(jax.jit, static_argnames=("subsampling", "whole"))
def _jpeg(picture: Image, quality: Scalar | float, subsampling: str, whole: bool) -> Image:
    dtype = picture.dtype
    if dtype.itemsize < 4:
        picture = picture.astype(jnp.float32)
    luma_table, chroma_table = (table.astype(picture.dtype) for table in _tables(quality, whole))
    coded_chroma = _code if subsampling == "4:4:4" else _code_at_half_size

    def code_image(image: Float[Array, "h w bands"]) -> Float[Array, "h w bands"]:
        codes = _part(255 * jnp.clip(image, 0, 1), 0.5, 1, whole)
        if image.shape[-1] == 1:
            return _code(codes[..., 0], luma_table, whole)[..., None] / 255
        luma, chroma = _to_ycbcr(codes, whole)
        luma = _code(luma, luma_table, whole)
        chroma = jax.vmap(lambda plane: coded_chroma(plane, chroma_table, whole))(chroma)
        return _to_rgb(luma, chroma, whole) / 255

    for _ in range(picture.ndim - 3):
        code_image = jax.vmap(code_image)
    return code_image(picture).astype(dtype)


# ---------------------------------------------------------------- whole numbers

# This is added to a whole number before it is divided by another and rounded down. It changes no
# result, but guards against compilers that replace the quotient by a product with the reciprocal,
# which may be just below a whole number.
_NO_TIE = 0.5


def _is_whole(rounding: str) -> bool:
    check_choice("rounding", rounding, ROUNDINGS)
    return rounding == "straight_through"


def _part(total: Array, bias: Array | float | int, of: Array | int, whole: bool) -> Array:
    """Return floor((total + bias) / of) if `whole`, an integer division in which `bias` sets the
    rounding, else total / of.
    """
    exact = total / of
    return replace_gradient(jnp.floor((total + bias) / of), exact) if whole else exact


# ---------------------------------------------------------------- colour

# JFIF's coefficients, from ITU-R BT.601, as 16-bit fractions rounded as in libjpeg (jccolor.c,
# jdcolor.c). Their products with codes stay below 2^24, where float32 is exact.
_ONE = 1 << 16


def _fraction(x: float) -> int:
    return int(x * _ONE + 0.5)


def _to_ycbcr(codes: Float[Array, "h w 3"], whole: bool) -> tuple[Plane, Float[Array, "2 h w"]]:
    """Convert to luma and to two chromas centred at 128, in codes."""
    r, g, b = (codes[..., i] for i in range(3))
    half, f = _ONE // 2, _fraction
    luma = f(0.29900) * r + f(0.58700) * g + f(0.11400) * b
    blue = f(0.50000) * b - f(0.16874) * r - f(0.33126) * g
    red = f(0.50000) * r - f(0.41869) * g - f(0.08131) * b
    chroma = jnp.stack([blue, red]) + 128 * _ONE
    return _part(luma, half, _ONE, whole), _part(chroma, half - 1, _ONE, whole)


def _to_rgb(luma: Plane, chroma: Float[Array, "2 h w"], whole: bool) -> Float[Array, "h w 3"]:
    f = _fraction
    blue, red = chroma[0] - 128, chroma[1] - 128
    above_luma = (f(1.40200) * red, -f(0.34414) * blue - f(0.71414) * red, f(1.77200) * blue)
    parts = [luma + _part(above, _ONE // 2, _ONE, whole) for above in above_luma]
    return jnp.clip(jnp.stack(parts, axis=-1), 0, 255)


# ---------------------------------------------------------------- chroma at half size


def _code_at_half_size(plane: Plane, table: Table, whole: bool) -> Plane:
    height, width = plane.shape
    small = _code(_halve(plane, whole), table, whole)
    seen = small[: (height + 1) // 2, : (width + 1) // 2]
    return _double(seen, whole)[:height, :width]


def _halve(plane: Plane, whole: bool) -> Other:
    """Return the means of 2 x 2 codes, with halves rounded alternately down and up (jcsample.c)."""
    height, width = plane.shape
    # blocks are completed by repeated codes: to the right at full size, downwards at half size
    even = jnp.pad(plane, ((0, height % 2), (0, -width % 16)), mode="edge")
    total = even[::2, ::2] + even[::2, 1::2] + even[1::2, ::2] + even[1::2, 1::2]
    bias = jnp.asarray(1 + np.arange(total.shape[1]) % 2, plane.dtype)[None]
    return _part(total, bias, 4, whole)


def _double(plane: Plane, whole: bool) -> Other:
    """Double the size: each code is 9/16, 3/16, 3/16 and 1/16 of the four nearest codes, or is
    repeated if there are at most two columns (jdsample.c).
    """
    if plane.shape[1] <= 2:
        return jnp.repeat(jnp.repeat(plane, 2, axis=0), 2, axis=1)
    wide = jnp.pad(plane, 1, mode="edge")
    height, width = plane.shape
    rows = [3 * wide[1:-1] + wide[:-2], 3 * wide[1:-1] + wide[2:]]
    tall = jnp.stack(rows, axis=1).reshape(2 * height, width + 2)
    columns = [
        _part(3 * tall[:, 1:-1] + tall[:, :-2], 8, 16, whole),
        _part(3 * tall[:, 1:-1] + tall[:, 2:], 7, 16, whole),
    ]
    return jnp.stack(columns, axis=2).reshape(2 * height, 2 * width)


# ---------------------------------------------------------------- blocks


def _code(plane: Plane, table: Table, whole: bool) -> Plane:
    """Transform a plane, quantise its coefficients and transform them back to codes, with libjpeg's
    intermediate integers (jfdctint.c, jcdctmgr.c, jidctint.c).
    """
    height, width = plane.shape
    full = jnp.pad(plane - 128, ((0, -height % 8), (0, -width % 8)), mode="edge")
    along = materialise(lambda x: _pass(x.T, _COSINES, 11, whole), full)
    eighths = materialise(lambda x: _pass(x.T, _COSINES, 15, whole), along)
    divisor = jnp.tile(table, (full.shape[0] // 8, full.shape[1] // 8))
    levels = eighths / (8 * divisor)
    if whole:
        away = jnp.floor((jnp.abs(eighths) + 4 * divisor + _NO_TIE) / (8 * divisor))
        levels = replace_gradient(jnp.sign(eighths) * away, levels)
    else:
        nearest = jax.lax.stop_gradient(jnp.round(levels))
        levels = nearest + (levels - nearest) ** 3
    down = materialise(lambda x: _pass(x, _COSINES.T, 11, whole), levels * divisor)
    back = materialise(lambda x: _pass(x.T, _COSINES.T, 18, whole), down).T
    return jnp.clip(back + 128, 0, 255)[:height, :width]


def _pass(
    plane: Plane, matrix: Int[np.ndarray, "8 8"], bits: int, whole: bool
) -> Float[Array, "h w"]:
    """Multiply every eight rows by the 8 x 8 matrix, and divide by 2^bits."""

    def product(rows: Shaped[Array, "blocks 8 w"]) -> Shaped[Array, "blocks 8 w"]:
        columns = jnp.asarray(matrix, rows.dtype)[None]
        return reduce(add, (columns[:, :, j : j + 1] * rows[:, j : j + 1] for j in range(8)))

    rows = plane.reshape(-1, 8, plane.shape[1])
    smooth = product(rows) / 2**bits
    if whole:
        exact = (product(rows.astype(jnp.int32)) + 2 ** (bits - 1)) >> bits
        # an integer cannot be NaN
        value = jnp.where(jnp.isnan(smooth), smooth, exact.astype(plane.dtype))
        smooth = replace_gradient(value, smooth)
    return smooth.reshape(plane.shape)
