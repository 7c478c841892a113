"""The median of each pixel's neighbourhood, by a selection network.

Whole images, shifted by the offsets of the neighbourhood, pass through the comparators (minimum,
maximum) of Batcher's odd-even merge sort (Knuth, The Art of Computer Programming 3, 5.2.2,
algorithm M). Only the comparators that affect the median are kept: 24 of 31 for 3 x 3, 113 for 5 x
5. The network has no branches and no indices, so it runs at the speed of vector minima. Values keep
their unit (relative or DN).
"""

from collections.abc import Sequence
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Shaped

from ..core._arguments import takes_numbers
from .kernels import _size_pair
from .padding import Picture, as_planes, check_border, pad

Offsets = tuple[tuple[int, int], ...]
Comparators = tuple[tuple[int, int], ...]


@takes_numbers
def median_filter(
    picture: Picture,
    *,
    size: int | np.integer | Sequence[int] = 3,
    footprint: ArrayLike | None = None,
    border: str = "mirror",
) -> Shaped[Array, "..."]:
    """Replace each pixel by the median over a rectangle or a footprint about it.

    For an even number of neighbours the result is the upper of the two middle values, as in
    `scipy.ndimage`. A NaN in the neighbourhood makes the result NaN. The gradient goes to the
    neighbour that is the median, in equal parts if there are several. The compile time increases
    with the footprint: below 1 s up to 7 x 7, some seconds for 15 x 15.

    Args:
        picture: (h, w) or (..., h, w, bands), uint8, uint16 or floating, any unit; each band is
            filtered separately.
        size: (rows, columns) in pixels, or one number for both.
        footprint: (rows, columns), true for the pixels of the neighbourhood; replaces `size`. Its
            middle, element n // 2 of a side of n, lies on the pixel.
        border: a key of `padding.BORDERS` but "normalised_zero" (for weighted means only) and
            "constant"; "extend" is clipped to the codes of an integer image.

    Returns:
        The picture's shape, unit and dtype.

    Raises:
        ValueError: for an empty footprint, a size of another form, an unknown border, or another
            dtype.

    Example:
        >>> hot = np.ones((3, 3))
        >>> hot[1, 1] = 4095.0  # DN of a hot pixel
        >>> print(jv.filters.median_filter(hot)[1])
        [1. 1. 1.]
    """
    if footprint is None:
        shape = np.ones(_size_pair(size), bool)
    else:
        shape = np.asarray(footprint).astype(bool)
    if shape.ndim != 2 or not shape.any():
        raise ValueError(
            f"a footprint is (rows, columns) with at least one true element, got {shape.shape} "
            f"with {int(shape.sum())}."
        )
    middle = np.array(shape.shape) // 2
    offsets = tuple((int(i), int(j)) for i, j in np.argwhere(shape) - middle)
    check_border(border, refused=("constant", "normalised_zero"))
    dtype = np.dtype(picture.dtype)
    if dtype not in (np.uint8, np.uint16) and not jnp.issubdtype(dtype, jnp.floating):
        raise ValueError(f"a picture is uint8, uint16 or floating here, got {dtype}.")
    return _median(picture, offsets, border)


@partial(jax.jit, static_argnames=("offsets", "border"))
def _median(picture: Picture, offsets: Offsets, border: str) -> Shaped[Array, "..."]:
    values, restore = as_planes(picture)
    n, height, width, bands = values.shape
    above, before = (max(0, -min(offset[side] for offset in offsets)) for side in (0, 1))
    below, after = (max(0, *(offset[side] for offset in offsets)) for side in (0, 1))
    around = pad(values, ((above, below), (before, after)), border=border)
    if jnp.issubdtype(picture.dtype, jnp.integer):
        codes = jnp.iinfo(picture.dtype)
        around = jnp.clip(around, codes.min, codes.max).astype(picture.dtype)
    rows = around.reshape(n, around.shape[1], -1)  # bands side by side: long, plain vectors

    def neighbour(offset: tuple[int, int]) -> Shaped[Array, "n h across"]:
        top, left = above + offset[0], (before + offset[1]) * bands
        return lax.slice(rows, (0, top, left), (n, top + height, left + width * bands))

    median = _middle(tuple(neighbour(offset) for offset in offsets))
    return restore(median.reshape(values.shape))


@jax.custom_jvp
def _middle(neighbours: tuple[Array, ...]) -> Array:
    """Return the element of rank n // 2 of n arrays, pixel by pixel."""
    wires = list(neighbours)
    for i, j in _selection_network(len(wires), len(wires) // 2):
        wires[i], wires[j] = jnp.minimum(wires[i], wires[j]), jnp.maximum(wires[i], wires[j])
    return wires[len(wires) // 2]


@_middle.defjvp
def _(primals: tuple[tuple[Array, ...]], tangents: tuple[tuple[Array, ...]]) -> tuple[Array, Array]:
    (neighbours,), (changes,) = primals, tangents
    median = _middle(neighbours)
    chosen = [(neighbour == median).astype(median.dtype) for neighbour in neighbours]
    shared = sum(is_it * change for is_it, change in zip(chosen, changes, strict=True))
    return median, shared / jnp.maximum(sum(chosen), 1)


@cache
def _selection_network(n: int, rank: int) -> Comparators:
    """Return comparators (i, j) with i < j, in the order of their use. Each puts the smaller of the
    values on wires i and j on i and the larger on j. Together the comparators bring the element of
    rank `rank` (0 the smallest) to wire `rank`.
    """
    needed, kept = {rank}, []
    for i, j in reversed(_merge_sort(n)):
        if i in needed or j in needed:
            needed |= {i, j}
            kept.append((i, j))
    return tuple(reversed(kept))


def _merge_sort(n: int) -> list[tuple[int, int]]:
    """Return the comparators of Batcher's odd-even merge sort of n
    wires.
    """
    pairs, run = [], 1
    while run < n:
        gap = run
        while gap >= 1:
            for start in range(gap % run, n - gap, 2 * gap):
                for i in range(start, start + min(gap, n - start - gap)):
                    if i // (2 * run) == (i + gap) // (2 * run):
                        pairs.append((i, i + gap))
            gap //= 2
        run *= 2
    return pairs
