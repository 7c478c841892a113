"""Contrast-limited adaptive equalisation (CLAHE; Zuiderveld, Graphics Gems IV, 1994).

Each tile has an equalising curve, computed from its clipped histogram. Each pixel is mapped by a
bilinear blend of the curves of the four nearest tiles. Values are codes (integer images) or
relative. Gradients treat the equalising curves as constants.
"""

from collections.abc import Callable, Sequence
from functools import partial
from numbers import Integral

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Shaped

from ..core._arguments import takes_numbers
from ..core._loops.fusion import materialise
from ..core._types import Scalars, is_known
from ._planes import (
    Binning,
    Pixels,
    Range,
    Stack,
    as_stack,
    bin_of_values,
    binning,
    check_codes_whole,
    count,
    equalising_curves,
    interpolated,
    levels_of,
    plane_numbers,
)

Tiles = tuple[int, int]
# Pixels of a tile; as a clip limit it means "no limit", and is exact in every floating dtype
MOST_PIXELS = 2**30


@takes_numbers
def equalise_locally(
    image: Pixels,
    *,
    tiles: Sequence[int] = (8, 8),
    clip_limit: float | Scalars | None = 2.0,
    bins: int | np.integer | None = None,
    value_range: Range | None = None,
) -> Shaped[Array, "..."]:
    """Equalise each plane tile by tile (CLAHE).

    For uint8 and uint16 the result equals OpenCV's `CLAHE`, which counts in integers and
    redistributes the clipped counts in a fixed order. As in OpenCV, a picture whose size is not a
    multiple of the number of tiles is first extended by `tiles - size % tiles` rows and columns,
    mirrored about the last pixel. If a blend of curves lies half-way between two codes, OpenCV may
    round to the other code. In a test with a picture of noise this occurred in 1 of 1,000 pixels.

    Floating images use equal bins and fractional counts. Values outside the range are clipped to it
    before counting. NaN stays NaN. A tile's values are unchanged if all are in one bin after
    redistribution, or if the tile has none.

    Args:
        image: (h, w) or (..., h, w, bands), uint8, uint16 or floating; codes or relative.
        tiles: rows and columns of tiles, each at least 1.
        clip_limit: () no unit, above 0: the largest count in a bin as a multiple of the mean count
            of a tile's bins. The excess is redistributed evenly, so that 1 leaves the contrast
            unchanged. None for no limit: each tile is fully equalised.
        bins: number of bins of a floating image; None takes 256.
        value_range: (low, high) of a floating image, relative; None takes [0, 1].

    Returns:
        The image's shape, unit and dtype.

    Raises:
        ValueError: for tiles of another form, for a clip_limit of 0 or below, for bins or a range
            with an integer image, and as for `exact_histogram`.

    Example:
        >>> ramp = np.linspace(0.4, 0.6, 64).reshape(8, 8)
        >>> wide = jv.histogram.equalise_locally(ramp, tiles=(1, 1), clip_limit=None)
        >>> print(np.asarray([wide.min(), wide.max()]).round(3))
        [0.006 0.994]
    """
    stack = as_stack(image)
    if np.shape(tiles) != (2,) or not all(isinstance(n, Integral) and n >= 1 for n in tiles):
        raise ValueError(
            f"tiles must be (rows, columns), whole numbers of at least (1, 1), got {tiles}."
        )
    if clip_limit is not None and is_known(clip_limit) and np.any(np.asarray(clip_limit) <= 0):
        raise ValueError(
            f"clip_limit must be above 0, got {np.asarray(clip_limit).min():g}; None is for no "
            "limit, which OpenCV writes as 0."
        )
    check_codes_whole(stack, bins, value_range)
    chosen, parts = binning(stack, bins, value_range), (int(tiles[0]), int(tiles[1]))
    return _equalise(stack, clip_limit, chosen=chosen, tiles=parts).reshape(image.shape)


@partial(jax.jit, static_argnames=("chosen", "tiles"))
def _equalise(
    stack: Stack, clip_limit: float | Scalars | None, *, chosen: Binning, tiles: Tiles
) -> Stack:
    levels = levels_of(stack)
    if levels is None:
        stack = jnp.clip(stack, chosen.low, chosen.high)
    extended = _extend(stack, tiles)
    tile = extended.shape[1] // tiles[0], extended.shape[2] // tiles[1]
    counts = _tile_counts(extended, chosen, tiles, tile)
    area, dtype = tile[0] * tile[1], jnp.result_type(float) if levels else stack.dtype
    share = jnp.asarray(jnp.inf if clip_limit is None else clip_limit, dtype)
    limit = share * (area / chosen.bins)

    if levels is None:

        def to_curves(
            counts: Int[Array, "groups bins"], limit: Scalars
        ) -> Float[Array, "groups edges"]:
            return equalising_curves(_clip(counts.astype(dtype), limit), chosen, dtype)

        curves = materialise(to_curves, counts, limit)
        return _blend(partial(interpolated, curves, x=stack, chosen=chosen), stack, tiles, tile)

    def to_table(counts: Int[Array, "groups levels"], limit: Scalars) -> Float[Array, " entries"]:
        below = jnp.cumsum(_clip_counts(counts, limit), axis=-1).astype(jnp.float32)
        return jnp.clip(jnp.round(below * ((levels - 1) / area)), 0, levels - 1).ravel()

    table, codes = materialise(to_table, counts, limit), stack.astype(jnp.int32)

    def look_up(group: Int[Array, "..."]) -> Float[Array, "..."]:
        return table.at[group * levels + codes].get(mode="promise_in_bounds")

    blended = jnp.round(_blend(look_up, stack, tiles, tile))
    return jnp.clip(blended, 0, levels - 1).astype(stack.dtype)


def _extend(stack: Stack, tiles: Tiles) -> Stack:
    """Extend the pictures by reflection at the bottom and right, until their size is a multiple of
    the number of tiles.
    """
    over = [-size % parts for size, parts in zip(stack.shape[1:3], tiles, strict=True)]
    if not any(over):
        return stack
    rows, columns = (
        parts - size % parts for size, parts in zip(stack.shape[1:3], tiles, strict=True)
    )
    return jnp.pad(stack, ((0, 0), (0, rows), (0, columns), (0, 0)), mode="reflect")


def _tile_counts(
    extended: Stack, chosen: Binning, tiles: Tiles, tile: Tiles
) -> Int[Array, "groups bins"]:
    n, h, w, bands = extended.shape
    rows, columns = (
        jnp.arange(h, dtype=jnp.int32) // tile[0],
        jnp.arange(w, dtype=jnp.int32) // tile[1],
    )
    group = _group(plane_numbers(extended), rows, columns, tiles)
    if levels_of(extended) is None:
        index = bin_of_values(extended, chosen)
    else:
        index = extended.astype(jnp.int32)
    return count(index, group, n * bands * tiles[0] * tiles[1], chosen.bins)


def _group(
    plane: Int[Array, "n 1 1 bands"], row: Int[Array, " h"], column: Int[Array, " w"], tiles: Tiles
) -> Int[Array, "n h w bands"]:
    """Return the index of the tile in that row and column of tiles, for every plane."""
    row, column = row[None, :, None, None], column[None, None, :, None]
    return (plane * tiles[0] + row) * tiles[1] + column


def _clip(counts: Float[Array, "groups bins"], limit: Scalars) -> Float[Array, "groups bins"]:
    """Clip counts at the limit, and distribute the excess evenly over all bins."""
    kept = jnp.minimum(counts, limit)
    return kept + (counts - kept).mean(axis=-1, keepdims=True)


def _clip_counts(counts: Int[Array, "groups bins"], limit: Scalars) -> Int[Array, "groups bins"]:
    """Clip integer counts as OpenCV does. The limit is rounded down, to at least 1. The excess is
    divided equally among the bins, and its remainder r is added one by one to codes 0, s, 2 s, and
    so on, with s = bins // r.
    """
    bins = counts.shape[-1]
    most = jnp.clip(jnp.floor(limit), 1, MOST_PIXELS).astype(counts.dtype)
    kept = jnp.minimum(counts, most)
    excess = (counts - kept).sum(axis=-1, keepdims=True, dtype=counts.dtype)
    each, rest = jnp.divmod(excess, bins)
    step = jnp.maximum(bins // jnp.maximum(rest, 1), 1)
    turn, off = jnp.divmod(jnp.arange(bins, dtype=jnp.int32)[None], step)
    return kept + each + ((off == 0) & (turn < rest)).astype(jnp.int32)


def _blend(
    curve: Callable[[Int[Array, "..."]], Float[Array, "..."]],
    stack: Stack,
    tiles: Tiles,
    tile: Tiles,
) -> Float[Array, "..."]:
    """Map each pixel by the curves of the four tiles around it, blended bilinearly between the
    centres of the tiles.
    """
    plane = plane_numbers(stack)
    (top, bottom, down), (left, right, along) = (
        _neighbours(size, parts, length)
        for size, parts, length in zip(stack.shape[1:3], tiles, tile, strict=True)
    )

    def apply_curve(row: np.ndarray, column: np.ndarray) -> Float[Array, "..."]:
        return curve(_group(plane, jnp.asarray(row), jnp.asarray(column), tiles))

    above_left = apply_curve(top, left)
    dtype = above_left.dtype
    x = jnp.asarray(along, dtype)[None, None, :, None]
    y = jnp.asarray(down, dtype)[None, :, None, None]
    above = above_left + x * (apply_curve(top, right) - above_left)
    below_left = apply_curve(bottom, left)
    below = below_left + x * (apply_curve(bottom, right) - below_left)
    return above + y * (below - above)


def _neighbours(size: int, parts: int, length: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return, for each pixel along an axis, the tiles before and after it, and its position in [0,
    1] between their centres.
    """
    position = np.arange(size) / length - 0.5
    before = np.floor(position).astype(np.int32)
    first, second = (np.clip(before + i, 0, parts - 1) for i in (0, 1))
    return first, second, position - before
