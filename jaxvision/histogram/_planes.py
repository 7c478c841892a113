"""Counting the values of image planes in bins.

All planes are counted by a single scatter into a flat table: bin b of group g is entry g bins + b,
where a group is a plane or a tile of a plane. Bands therefore need no transposition, and a batch
needs no loop.
"""

from collections.abc import Sequence
from numbers import Integral
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int, Shaped

from ..core._numerics import divide
from ..core._types import is_known, print_by_name
from ..core.parallel_loops import scan

Pixels = Shaped[Array, "..."] | Shaped[np.ndarray, "..."]
Stack = Shaped[Array, "n _ _ bands"]
print_by_name(globals(), "Pixels")
Range = Sequence[float]

LEVELS = {np.dtype(np.uint8): 256, np.dtype(np.uint16): 65536}
FLOAT_BINS = 256
CODES_ABOVE = 16.0  # a floating image with values above this contains codes
# Pixels per scatter, whose indices then stay in the cache (10 times as fast for 2048 x 2048).
BLOCK = 2**16
PAIRED = 4  # largest number of 8-bit planes for which pairs of codes are counted


class Binning(NamedTuple):
    """Equal bins of a range as in numpy: half-open [edge, next edge), except that the last bin
    includes its upper edge.
    """

    bins: int
    low: float
    high: float

    @property
    def width(self) -> float:
        return (self.high - self.low) / self.bins

    @property
    def edges(self) -> np.ndarray:
        return np.linspace(self.low, self.high, self.bins + 1)


def as_stack(image: Pixels) -> Stack:
    """Return an image as (n, h, w, bands). Half precision becomes float32, which can also hold the
    counts. Raise `ValueError` for a wrong rank, no pixels or another dtype.
    """
    pixels = jnp.asarray(image)
    if pixels.ndim < 2 or 0 in pixels.shape:
        raise ValueError(
            f"an image is (h, w) or (..., h, w, bands) with at least one pixel, got {pixels.shape}."
        )
    if pixels.dtype not in LEVELS and not jnp.issubdtype(pixels.dtype, jnp.floating):
        raise ValueError(f"an image is uint8, uint16 or floating, got {pixels.dtype}.")
    if pixels.dtype not in LEVELS and pixels.dtype.itemsize < 4:
        pixels = pixels.astype(jnp.float32)
    if pixels.ndim == 2:
        return pixels.reshape(1, *pixels.shape, 1)
    return pixels.reshape(-1, *pixels.shape[-3:])


def reshape_per_plane(table: Shaped[Array, "planes ..."], image: Pixels) -> Shaped[Array, "..."]:
    """Reshape a table with one row per plane to the image's leading axes: (...) for an image (h,
    w), and (..., bands, ...) for (..., h, w, bands).
    """
    shape = jnp.shape(image)
    planes = () if len(shape) == 2 else (*shape[:-3], shape[-1])
    return table.reshape(*planes, *table.shape[1:])


def levels_of(image: Pixels) -> int | None:
    """Return the number of codes of an integer image's dtype, and None for a floating image."""
    return LEVELS.get(np.dtype(image.dtype))


def binning(image: Pixels, bins: int | np.integer | None, value_range: Range | None) -> Binning:
    """Return the requested bins, by default one per code for integer images, or `FLOAT_BINS` over
    [0, 1].
    """
    levels = levels_of(image)
    bins = (levels or FLOAT_BINS) if bins is None else bins
    low, high = (0.0, float(levels or 1)) if value_range is None else value_range
    if not isinstance(bins, Integral) or bins < 1:
        raise ValueError(f"bins must be a whole number, at least 1, got {bins}.")
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        raise ValueError(f"value_range must be finite with low < high, got ({low}, {high}).")
    if levels is None and value_range is None and is_known(image):
        values = np.asarray(image)
        largest = np.max(values, initial=0, where=np.isfinite(values))
        if largest > CODES_ABOVE:
            raise ValueError(
                f"floating images are counted in [0, 1], got values up to {largest:.6g}; divide "
                "codes by the largest one, or name value_range."
            )
    return Binning(int(bins), float(low), float(high))


def check_codes_whole(stack: Stack, bins: Any, value_range: Any) -> None:
    """Raise `ValueError` for bins or a range with integer images, which are always equalised code
    by code.
    """
    if levels_of(stack) is not None and (bins, value_range) != (None, None):
        raise ValueError(
            f"an integer image is equalised code by code, without bins or value_range; got {bins} "
            f"and {value_range}."
        )


def plane_numbers(stack: Stack) -> Int[Array, "n 1 1 bands"]:
    """Number the planes of a stack 0, 1, 2 ..., in the order of `reshape_per_plane`."""
    n, _, _, bands = stack.shape
    return jnp.arange(n * bands, dtype=jnp.int32).reshape(n, 1, 1, bands)


def bin_of_codes(levels: int, chosen: Binning) -> np.ndarray:
    """Return the bin of each code, (levels,). A code outside the range gets the number of bins as
    its index.
    """
    codes, edges = np.arange(levels), chosen.edges
    index = np.searchsorted(edges, codes, side="right") - 1
    index[codes == chosen.high] = chosen.bins - 1
    return np.where((codes >= chosen.low) & (codes <= chosen.high), index, chosen.bins)


def bin_of_values(x: Float[Array, "..."], chosen: Binning) -> Int[Array, "..."]:
    """Return the bin of each value, corrected by a comparison with the edges as in numpy. NaN and
    values outside the range get the number of bins as their index.
    """
    bins, low, high = chosen
    edges = jnp.asarray(chosen.edges, x.dtype)
    inside = (x >= low) & (x <= high)
    near = jnp.floor((jnp.where(inside, x, low) - low) / chosen.width)
    index = jnp.clip(near.astype(jnp.int32), 0, bins - 1)
    index -= (x < edges[index]).astype(jnp.int32)
    index += ((x >= edges[index + 1]) & (index < bins - 1)).astype(jnp.int32)
    return jnp.where(inside, index, bins)


def count(
    index: Int[Array, "..."], group: Int[Array, "..."], groups: int, bins: int
) -> Int[Array, "groups bins"]:
    """Count how often each index in [0, bins) occurs in each group. Other indices are ignored."""
    nowhere = groups * bins
    small = jnp.uint16 if nowhere < 2**16 else jnp.int32
    entry = jnp.where(index < bins, group * bins + index, nowhere).astype(small).ravel()
    whole = entry.size // BLOCK * BLOCK

    def add(table: Array, block: Array) -> tuple[Array, None]:
        return table.at[block.astype(jnp.int32)].add(1, mode="drop"), None

    table = jnp.zeros(nowhere, jnp.int32)
    if whole:
        table, _ = scan(add, table, entry[:whole].reshape(-1, BLOCK))
    if whole < entry.size:
        table, _ = add(table, entry[whole:])
    return table.reshape(groups, bins)


def _pair_counts(stack: Stack) -> Int[Array, "planes 256"]:
    """Count the codes of 8-bit images. Two neighbours are counted together, as one of 65536 pairs,
    which halves the number of steps. The two halves of a large picture are counted at the same
    time.
    """
    n, h, w, bands = stack.shape
    planes, even = jnp.moveaxis(stack, -1, 1).reshape(n * bands, h * w), h * w // 2 * 2
    tables = []
    for codes in planes:
        pairs = codes[:even].reshape(-1, 2).astype(jnp.int32)
        pairs = 256 * pairs[:, 0] + pairs[:, 1]
        parts = [
            jnp.zeros(2**16, jnp.int32).at[part].add(1, mode="promise_in_bounds")
            for part in jnp.array_split(pairs, 2 if even >= 4 * BLOCK else 1)
        ]
        both = parts[0] if len(parts) == 1 else parts[0] + parts[1]
        table = both.reshape(256, 256)
        tables.append(table.sum(0) + table.sum(1))
    counts = jnp.stack(tables)
    if even < h * w:
        counts = counts.at[jnp.arange(n * bands), planes[:, -1].astype(jnp.int32)].add(1)
    return counts


def bin_counts(stack: Stack, chosen: Binning) -> Int[Array, "planes bins"]:
    """Return the exact counts of every plane."""
    group, planes = plane_numbers(stack), stack.shape[0] * stack.shape[-1]
    levels = levels_of(stack)
    if levels is None:
        return count(bin_of_values(stack, chosen), group, planes, chosen.bins)
    if levels == 256 and planes <= PAIRED and stack.shape[1] * stack.shape[2] >= BLOCK // 2:
        by_code = _pair_counts(stack)
    else:
        by_code = count(stack.astype(jnp.int32), group, planes, levels)
    if chosen == Binning(levels, 0.0, float(levels)):
        return by_code
    table = jnp.zeros((planes, chosen.bins), jnp.int32)
    return table.at[:, bin_of_codes(levels, chosen)].add(by_code, mode="drop")


def cumulative_fractions(
    counts: Shaped[Array, "*planes bins"], dtype: DTypeLike
) -> Float[Array, "*planes edges"]:
    """Return the fraction of all counts below each edge, 0 at every edge if there are no counts."""
    below = jnp.cumsum(counts, axis=-1).astype(dtype)
    total = below[..., -1:]
    fractions = divide(below, total, total != 0)
    return jnp.concatenate([jnp.zeros_like(total), fractions], axis=-1)


def equalising_curves(
    counts: Shaped[Array, "groups bins"], chosen: Binning, dtype: DTypeLike
) -> Float[Array, "groups edges"]:
    """Return the value to which equalisation maps each edge: low + (high - low) CDF. The mapping is
    the identity if fewer than two bins are occupied, since there is no contrast to spread.
    """
    curves = chosen.low + (chosen.high - chosen.low) * cumulative_fractions(counts, dtype)
    several = (counts > 0).sum(-1, keepdims=True) > 1
    return jnp.where(several, curves, jnp.asarray(chosen.edges, dtype)[None])


def interpolated(
    tables: Float[Array, "groups edges"],
    group: Int[Array, "..."],
    x: Float[Array, "..."],
    chosen: Binning,
) -> Float[Array, "..."]:
    """Map each value by its group's piecewise linear curve, which is given at the edges and
    constant outside.
    """
    bins, low, _ = chosen
    position = jnp.clip((x - low) / chosen.width, 0, bins)
    index = jnp.clip(position.astype(jnp.int32), 0, bins - 1)
    start = group * (bins + 1) + index
    flat = tables.ravel()
    below, above = (flat.at[start + i].get(mode="promise_in_bounds") for i in (0, 1))
    return below + (position - index.astype(x.dtype)) * (above - below)
