"""Demosaicing: convert a mosaic with one band per pixel to a picture with every band at every
pixel.

Mosaics are (..., h, w) in DN or relative, at least as large as one tile of the pattern. Integers
become floating numbers of the same value. Pictures are (..., h, w, bands) in the same unit.
Measured values are unchanged in the picture, except that Menon's method refines green. NaN spreads
to all pixels whose window contains it. Patterns are defined as in `colour_filters`. Three of the
four methods are for Bayer tiles: two greens on a diagonal and two other bands, in any order and
phase.

`border` defines the values outside. "in_phase" reflects the mosaic without repeating the edge, c b
| a b c d | c b, which continues the colours of a Bayer tile. Any key of `padding.BORDERS` is
allowed, too. A padded value is then assigned to the colour that the pattern has at that pixel.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Shaped

from ..core._arguments import takes_numbers
from ..core._loops.fusion import materialise
from ..core._types import as_float, check_choice, print_by_name
from ..filters import correlate_separable
from ..filters.padding import pad
from ..scene.developments import DEMOSAICINGS
from ..sensor.colour_filters import Pattern, as_pattern, check_pattern, sites

Mosaic = Shaped[Array | np.ndarray, "*mosaic"]
Picture = Float[Array, "*batch h w bands"]
Plane = Float[Array, "h w"]
Mask = Bool[Array, "h w"]
print_by_name(globals(), "Mosaic", "Picture")


@takes_numbers
def demosaic(
    raw: Mosaic, pattern: Pattern | str, *, method: str = "malvar", border: str = "in_phase"
) -> Picture:
    """Compute the picture of a mosaic by the chosen method.

    Args:
        raw: (..., h, w), or (..., h, w, 1) as a sensor returns it, DN or relative.
        pattern: rows of band numbers, as `colour_filters.bayer` returns them, or the phase of a
            Bayer mosaic, such as "RGGB".
        method: "bilinear": means of the nearest pixels; "malvar": these means, corrected by the
            gradient of the measured band; "menon": interpolation along the better of two
            directions, the sharpest and slowest; "normalised": weighted means, the only method for
            patterns other than Bayer's.
        border: "in_phase" or a key of `padding.BORDERS`; "menon" and "normalised" have their own
            border and accept "in_phase" only.

    Returns:
        (..., h, w, bands) in the mosaic's unit.

    Raises:
        ValueError: for an unknown method, a border or a pattern that the method does not accept, or
            a picture of three bands.

    Example:
        >>> raw = jnp.full((4, 4), 5.0)
        >>> print(jv.demosaic(raw, "RGGB")[1, 2])
        [5. 5. 5.]
    """
    check_choice("method", method, DEMOSAICINGS)
    pattern = as_pattern(pattern)
    # a last axis of length one or three contains bands, because a mosaic is wider
    if raw.ndim > 2 and raw.shape[-1] == 1:
        raw = raw[..., 0]
    elif raw.ndim > 2 and raw.shape[-1] == 3:
        raise ValueError(
            f"raw of shape {raw.shape} has three bands a pixel; a mosaic has one, (..., h, w)."
        )
    if method in ("bilinear", "malvar"):
        return METHODS[method](raw, pattern, border=border)
    if border != "in_phase":
        raise ValueError(f'method "{method}" has a border of its own, got border {border!r}.')
    return METHODS[method](raw, pattern)


@takes_numbers
@partial(jax.jit, static_argnames=("pattern", "border"))
def demosaic_bilinear(raw: Mosaic, pattern: Pattern | str, *, border: str = "in_phase") -> Picture:
    """Estimate each missing band by the mean of the two or four nearest pixels that measured it.

    Args:
        raw: (..., h, w) DN or relative.
        pattern: a Bayer pattern, or its phase, such as "RGGB".
        border: "in_phase" or a key of `padding.BORDERS`.

    Returns:
        (..., h, w, 3) in the mosaic's unit.

    Raises:
        ValueError: for another pattern or an unknown border.

    Example:
        >>> raw = np.tile([[100.0, 200.0], [200.0, 400.0]], (3, 3))  # DN of one colour
        >>> print(jv.development.demosaic_bilinear(raw, jv.bayer("RGGB"))[2, 3])
        [100. 200. 400.]
    """
    pattern = as_pattern(pattern)
    layout = _layout(pattern)

    def demosaic_plane(plane: Plane) -> Float[Array, "h w 3"]:
        at = _Shifted(materialise(lambda f: _extend_in_phase(f, 1, border), plane), 1)
        beside, above = at(0, -1) + at(0, 1), at(-1, 0) + at(1, 0)
        diagonal = at(-1, -1) + at(-1, 1) + at(1, -1) + at(1, 1)
        return _select_bands(
            layout, at(0, 0), (beside + above) / 4, beside / 2, above / 2, diagonal / 4
        )

    return _demosaic_images(demosaic_plane, raw, pattern)


@takes_numbers
@partial(jax.jit, static_argnames=("pattern", "border"))
def demosaic_malvar(raw: Mosaic, pattern: Pattern | str, *, border: str = "in_phase") -> Picture:
    """Add a share of the measured band's Laplacian to the bilinear means, by four 5 x 5 filters.

    (colour-demosaicing uses border "mirror".)

    Args:
        raw: (..., h, w) DN or relative.
        pattern: a Bayer pattern, or its phase, such as "RGGB".
        border: "in_phase" or a key of `padding.BORDERS`.

    Returns:
        (..., h, w, 3) in the mosaic's unit.

    Raises:
        ValueError: for another pattern or an unknown border.

    Source: Malvar, He, Cutler, "High-quality linear interpolation for demosaicing of
    Bayer-patterned color images", ICASSP 2004, figure 2.

    Example:
        >>> raw = np.tile([[100.0, 200.0], [200.0, 400.0]], (4, 4))  # DN of one colour
        >>> print(jv.development.demosaic_malvar(raw, jv.bayer("RGGB"))[3, 4])
        [100. 200. 400.]
    """
    pattern = as_pattern(pattern)
    layout = _layout(pattern)

    def demosaic_plane(plane: Plane) -> Float[Array, "h w 3"]:
        at = _Shifted(materialise(lambda f: _extend_in_phase(f, 2, border), plane), 2)
        own = at(0, 0)
        beside, above = at(0, -1) + at(0, 1), at(-1, 0) + at(1, 0)
        diagonal = at(-1, -1) + at(-1, 1) + at(1, -1) + at(1, 1)
        far_beside, far_above = at(0, -2) + at(0, 2), at(-2, 0) + at(2, 0)
        return _select_bands(
            layout,
            own,
            green=(4 * own + 2 * (beside + above) - (far_beside + far_above)) / 8,
            along=(5 * own + 4 * beside - diagonal - far_beside + far_above / 2) / 8,
            across=(5 * own + 4 * above - diagonal - far_above + far_beside / 2) / 8,
            opposite=(6 * own + 2 * diagonal - 1.5 * (far_beside + far_above)) / 8,
        )

    return _demosaic_images(demosaic_plane, raw, pattern)


@takes_numbers
@partial(jax.jit, static_argnames=("pattern", "refine"))
def demosaic_menon(raw: Mosaic, pattern: Pattern | str, *, refine: bool = True) -> Picture:
    """Demosaic by directional filtering and a posteriori decision (Menon et al.).

    Green is interpolated along the rows or the columns, whichever has the smoother colour
    differences nearby. For the other bands, their difference from green is interpolated. The mosaic
    is padded by the border "in_phase"; colour differences beyond the border are ignored. Gradients
    ignore the choice between rows and columns.

    Args:
        raw: (..., h, w) DN or relative.
        pattern: a Bayer pattern, or its phase, such as "RGGB".
        refine: whether to repeat the interpolation once with the bands estimated so far.

    Returns:
        (..., h, w, 3) in the mosaic's unit.

    Raises:
        ValueError: for another pattern.

    Source: Menon, Andriani, Calvagno, "Demosaicing with directional filtering and a posteriori
    decision", IEEE Transactions on Image Processing 16 (2007), equations 1 to 12.

    Example:
        >>> raw = np.tile([[100.0, 200.0], [200.0, 400.0]], (4, 4))  # DN of one colour
        >>> print(jv.development.demosaic_menon(raw, jv.bayer("RGGB"))[3, 4])
        [100. 200. 400.]
    """
    pattern = as_pattern(pattern)
    layout = _layout(pattern)

    def demosaic_plane(plane: Plane) -> Float[Array, "h w 3"]:
        is_green, first_rows = layout.masks(*plane.shape)
        is_first = first_rows & ~is_green
        green, lead = materialise(lambda f: _directed_green(f, is_green), plane)

        def directed_mean(difference: Plane, near: Callable[[Plane, int], Plane]) -> Plane:
            return _choose_direction(lead, near(difference, 1), near(difference, 0))

        def differences_at_green(from_green: Plane) -> tuple[Plane, Plane]:
            """Interpolate the differences of the other two bands from green at the green pixels."""
            rows, columns = _mean_of_two(from_green, 1), _mean_of_two(from_green, 0)
            return jnp.where(first_rows, rows, columns), jnp.where(first_rows, columns, rows)

        def interpolate_others(raw: Plane, green: Plane) -> tuple[Plane, Plane]:
            first, second = differences_at_green(jnp.where(is_green, 0, raw - green))
            apart = directed_mean(first - second, _mean_of_two)
            return (
                jnp.where(is_green, green + first, jnp.where(is_first, raw, raw + apart)),
                jnp.where(is_green, green + second, jnp.where(is_first, raw - apart, raw)),
            )

        def refine_bands(
            raw: Plane, green: Plane, first: Plane, second: Plane
        ) -> tuple[Plane, Plane, Plane]:
            seen = (
                directed_mean(first - green, _mean_of_three),
                directed_mean(second - green, _mean_of_three),
            )
            green = jnp.where(is_green, green, raw - jnp.where(is_first, *seen))
            above_green = differences_at_green(jnp.where(is_green, 0, raw - green))
            first = jnp.where(is_green, green + above_green[0], first)
            second = jnp.where(is_green, green + above_green[1], second)
            apart = directed_mean(first - second, _mean_of_three)
            return (
                green,
                jnp.where(is_green | is_first, first, raw + apart),
                jnp.where(is_green | ~is_first, second, raw - apart),
            )

        first, second = materialise(interpolate_others, plane, green)
        if refine:
            green, first, second = materialise(refine_bands, plane, green, first, second)
        return _join(layout, green, first, second)

    return _demosaic_images(demosaic_plane, raw, pattern)


@takes_numbers
@partial(jax.jit, static_argnames="pattern")
def demosaic_normalised(raw: Mosaic, pattern: Pattern | str) -> Picture:
    """Estimate each missing band by a weighted mean of the nearby pixels that measured it.

    The weights are triangular and as wide as the tile.

    The method works for any pattern. Pixels outside the picture are ignored. For a Bayer pattern
    the result equals `demosaic_bilinear`, except for green at the outermost pixels.

    Args:
        raw: (..., h, w) DN or relative.
        pattern: rows of band numbers, or the phase of a Bayer mosaic, such as "RGGB".

    Returns:
        (..., h, w, bands) in the mosaic's unit.

    Raises:
        ValueError: for a malformed pattern, or a mosaic smaller than one tile.

    Source: Knutsson and Westin, "Normalized and differential convolution", CVPR 1993.

    Example:
        >>> raw = np.tile([[100.0, 200.0], [200.0, 400.0]], (3, 3))  # DN of one colour
        >>> print(jv.development.demosaic_normalised(raw, jv.bayer("RGGB"))[0, 0])
        [100. 200. 400.]
    """
    pattern = as_pattern(pattern)
    rows, columns = len(pattern), len(pattern[0])
    tents = (_tent(rows), _tent(columns))

    def demosaic_plane(plane: Plane) -> Float[Array, "h w bands"]:
        seen = jnp.stack(sites(pattern, *plane.shape), axis=-1)
        weights = seen.astype(plane.dtype)
        values = jnp.where(seen, plane[..., None], 0)
        light = correlate_separable(values, *tents, border="zero")
        return jnp.where(
            seen, plane[..., None], light / correlate_separable(weights, *tents, border="zero")
        )

    return _demosaic_images(demosaic_plane, raw, pattern)


METHODS: dict[str, Callable[..., Picture]] = {
    "bilinear": demosaic_bilinear,
    "malvar": demosaic_malvar,
    "menon": demosaic_menon,
    "normalised": demosaic_normalised,
}


# ---------------------------------------------------------------- the tiles of Bayer


class _Layout(NamedTuple):
    """The layout of a Bayer tile: the number of the green band, the bands next to green in the
    first and in the second row, and whether the first pixel is green.
    """

    green: int
    first: int
    second: int
    green_corner: bool

    def masks(self, height: int, width: int) -> tuple[Mask, Mask]:
        """Return two masks of pixels: those that are green, and those in rows that contain the
        first band.
        """
        row = jnp.asarray(np.arange(height)[:, None] % 2 == 0)
        column = jnp.asarray(np.arange(width)[None] % 2 == 0)
        is_green = (row == column) if self.green_corner else (row != column)
        return is_green, jnp.broadcast_to(row, is_green.shape)


def _layout(pattern: Pattern) -> _Layout:
    check_pattern(pattern)
    tile = np.asarray(pattern)
    if tile.shape == (2, 2) and tile.max() == 2:
        (a, b), (c, d) = tile.tolist()
        if a == d:
            return _Layout(a, b, c, True)
        if b == c:
            return _Layout(b, a, d, False)
    raise ValueError(
        "this method is for a 2 x 2 pattern of three bands, one of them twice on a diagonal, got "
        f'{pattern}: take method "normalised".'
    )


def _select_bands(
    layout: _Layout, own: Plane, green: Plane, along: Plane, across: Plane, opposite: Plane
) -> Float[Array, "h w 3"]:
    """Select each pixel's three bands: its measured value `own`, and for the other bands estimates
    from their pixels in its row (`along`), its column (`across`) or its diagonals (`opposite`).
    """
    is_green, first_rows = layout.masks(*own.shape)
    in_rows = jnp.where(is_green, along, own)
    in_others = jnp.where(is_green, across, opposite)
    return _join(
        layout,
        jnp.where(is_green, own, green),
        jnp.where(first_rows, in_rows, in_others),
        jnp.where(first_rows, in_others, in_rows),
    )


def _join(layout: _Layout, green: Plane, first: Plane, second: Plane) -> Float[Array, "h w 3"]:
    """Return the planes along a last axis, in the order of the bands. Selection by band number uses
    vector instructions, whereas stacking along a last axis of three would copy each number
    separately.
    """
    planes = dict(zip(layout[:3], (green, first, second), strict=True))
    shape = (*green.shape, 3)
    band = jax.lax.broadcasted_iota(jnp.int32, shape, 2)
    wide = [jnp.broadcast_to(planes[i][..., None], shape) for i in range(3)]
    return jnp.where(band == 0, wide[0], jnp.where(band == 1, wide[1], wide[2]))


# ---------------------------------------------------------------- planes


def _demosaic_images(
    demosaic_plane: Callable[[Plane], Float[Array, "h w bands"]], raw: Mosaic, pattern: Pattern
) -> Picture:
    check_pattern(pattern)
    planes, tile = as_float(raw), (len(pattern), len(pattern[0]))
    size = planes.shape[-2:]
    if planes.ndim < 2 or size[0] < tile[0] or size[1] < tile[1]:
        raise ValueError(
            f"raw must be (..., h, w) with at least a tile of {tile} pixels, got shape "
            f"{planes.shape}."
        )
    if 0 in planes.shape:
        return jnp.zeros((*planes.shape, 1 + max(map(max, pattern))), planes.dtype)
    if planes.dtype.itemsize < 4:  # half precision is too small for sums of codes
        return _demosaic_images(demosaic_plane, planes.astype(jnp.float32), pattern).astype(
            planes.dtype
        )
    for _ in range(planes.ndim - 2):
        demosaic_plane = jax.vmap(demosaic_plane)
    return demosaic_plane(planes)


def _extend_in_phase(plane: Plane, reach: int, border: str) -> Float[Array, "_ _"]:
    as_is = "reflect_101" if border == "in_phase" else border
    return pad(plane, ((reach, reach), (reach, reach)), border=as_is)


class _Shifted(NamedTuple):
    """A plane padded by `reach` on all sides; calling it returns the plane shifted by an offset."""

    wide: Float[Array, "_ _"]
    reach: int

    def __call__(self, down: int, right: int) -> Plane:
        top, left = self.reach + down, self.reach + right
        height, width = (size - 2 * self.reach for size in self.wide.shape)
        return self.wide[top : top + height, left : left + width]


def _neighbours(plane: Plane, axis: int, distance: int) -> tuple[Plane, Plane]:
    """Return, for each pixel, the pixels `distance` before and behind it along an axis, with
    reflection at the ends.
    """
    n = plane.shape[axis]
    reach = [(0, 0), (0, 0)]
    reach[axis] = (distance, distance)
    wide = jnp.pad(plane, reach, mode="reflect")
    before = jax.lax.slice_in_dim(wide, 0, n, axis=axis)
    return before, jax.lax.slice_in_dim(wide, 2 * distance, 2 * distance + n, axis=axis)


def _mean_of_two(plane: Plane, axis: int) -> Plane:
    before, behind = _neighbours(plane, axis, 1)
    return (before + behind) / 2


def _mean_of_three(plane: Plane, axis: int) -> Plane:
    before, behind = _neighbours(plane, axis, 1)
    return (before + plane + behind) / 3


def _directed_green(raw: Plane, is_green: Mask) -> tuple[Plane, Plane]:
    """Return Menon's estimate of green, and the amount by which colour differences are rougher
    along columns than along rows (equations 1 to 6).
    """
    greens, roughness = [], []
    for axis in (1, 0):
        far_before, far_behind = _neighbours(raw, axis, 2)
        curvature = raw - (far_before + far_behind) / 2
        green = jnp.where(is_green, raw, _mean_of_two(raw, axis) + curvature / 2)
        difference = jnp.where(is_green, 0, raw - green)
        change = jnp.abs(difference - _neighbours(difference, axis, 2)[1])
        greens.append(green)
        roughness.append(_sum_changes(change, axis))
    lead = jax.lax.stop_gradient(roughness[1] - roughness[0])
    return jnp.where(is_green, raw, _choose_direction(lead, *greens)), lead


def _choose_direction(lead: Plane, by_rows: Plane, by_columns: Plane) -> Plane:
    """Select the estimate along rows where `lead` >= 0, else along columns, and NaN where `lead` is
    NaN.
    """
    return jnp.where(lead >= 0, by_rows, jnp.where(lead < 0, by_columns, lead))


def _sum_changes(change: Plane, axis: int) -> Plane:
    """Sum the changes between pixels two apart around each pixel. Changes that include the pixel
    itself have weight 3.
    """
    at = _Shifted(jnp.pad(change if axis == 1 else change.T, 2), 2)
    own = at(0, -2) + at(0, 0)
    beside = at(-2, -2) + at(-2, 0) + at(2, -2) + at(2, 0) + at(-1, -1) + at(1, -1)
    total = 3 * own + beside
    return total if axis == 1 else total.T


def _tent(tile: int) -> np.ndarray:
    """Return weights that decrease linearly to 0 at one tile's distance, so that some pixel of each
    band is always included.
    """
    return tile - np.abs(np.arange(1 - tile, tile), dtype=float)
