"""Integral images (Crow 1984; Viola & Jones 2001): the sum over any box from four entries.

The sums are exclusive, as in OpenCV's `integral`: entry (i, j) is the sum over rows < i and columns
< j. The integral image has one more row and one more column than the picture, and its first row and
column are 0. scikit-image's `integral_image` has no such row and column: its entry (i, j) is our (i
+ 1, j + 1).

Sums are in the unit of the image (relative values or DN). Each sum is stored as an unevaluated pair
high + low (Dekker 1971), so that a small box in a large float32 image is accurate. Besides the
rounding of the box's sum, its error is about 2^-46 (float64: 2^-104) of the sum over everything
above and to the left of it. With a single float32 number the error would be 2^-24 of that sum. NaN
and infinity turn every box that ends below and to the right of them into NaN.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..core._arguments import takes_numbers
from ..core._shown import Shown
from ..core._types import as_float
from ..core.parallel_loops import scan
from .padding import Picture, check_picture

Pair = tuple[Array, Array]


class IntegralImage(Shown):
    """The sums over all boxes that begin at the first pixel, as pairs high + low.

    Attributes:
        high: (h + 1, w + 1) or (..., h + 1, w + 1, bands), the rounded sums, in the image's unit.
        low: the same shape and unit, the rounding error of `high`.
    """

    high: Float[Array, "..."]
    low: Float[Array, "..."]


@takes_numbers
@jax.jit
def integral_image(image: Picture) -> IntegralImage:
    """Compute the integral image, the sums over all boxes that begin at the first pixel.

    Args:
        image: (h, w) or (..., h, w, bands), any unit. Integers are summed in floating point,
            exactly up to the precision of the pair (2^48 in float32).

    Returns:
        Sums over all boxes from the first pixel, in the image's unit.

    Raises:
        ValueError: for an image with fewer than two axes, without pixels, or complex.

    Example:
        >>> sums = jv.filters.integral_image(jnp.ones((4, 5)))
        >>> print(float(jv.filters.box_sum(sums, *map(jnp.asarray, (1, 1, 3, 4)))))
        6.0
    """
    check_picture(image)
    pixels = as_float(image)
    if pixels.dtype.itemsize < 4:  # half precision is too small for the sums
        pixels = pixels.astype(jnp.float32)
    rows = _row_axis(pixels.ndim, "an image")
    margin = [(int(axis in (rows, rows + 1)), 0) for axis in range(pixels.ndim)]
    return IntegralImage(*(jnp.pad(part, margin) for part in _sum_along(pixels, rows)))


def box_sum(
    integral: IntegralImage,
    top: Int[Array, ""],
    left: Int[Array, ""],
    bottom: Int[Array, ""],
    right: Int[Array, ""],
) -> Float[Array, "..."]:
    """Return the sum over rows top <= i < bottom and columns left <= j < right.

    This function sums one box; use `vmap` for many. Bounds of the box outside the image are moved
    to the image's edge. A box with bottom < top or right < left is empty, with sum 0.

    Args:
        integral: the integral image.
        top: () first row, whole number of pixels.
        left: () first column.
        bottom: () first row after the box.
        right: () first column after the box.

    Returns:
        () or (..., bands), in the image's unit.
    """
    rows = _row_axis(integral.high.ndim, "an integral image")
    height, width = (size - 1 for size in integral.high.shape[rows : rows + 2])
    top, left = jnp.clip(top, 0, height), jnp.clip(left, 0, width)
    bottom, right = jnp.clip(bottom, top, height), jnp.clip(right, left, width)

    def entry(i: Int[Array, ""], j: Int[Array, ""]) -> Pair:
        high, low = (
            jnp.take(jnp.take(part, i, axis=rows), j, axis=rows)
            for part in (integral.high, integral.low)
        )
        return high, low

    return _corners(entry(bottom, right), entry(top, right), entry(bottom, left), entry(top, left))


def window_sum(integral: IntegralImage, size: tuple[int, int]) -> Float[Array, "..."]:
    """Return the sums over all windows of one size, at a cost independent of the size.

    Args:
        integral: the integral image.
        size: (rows, columns) of the window, in pixels.

    Returns:
        (h - rows + 1, w - columns + 1), or with batch and bands, in the image's unit.

    Raises:
        ValueError: for a window that is empty or larger than the image.

    Example:
        >>> whole = jv.filters.integral_image(np.ones((4, 4)))
        >>> print(jv.filters.window_sum(whole, (3, 3)))
        [[9. 9.]
         [9. 9.]]
    """
    axis = _row_axis(integral.high.ndim, "an integral image")
    shape = tuple(n - 1 for n in integral.high.shape[axis : axis + 2])
    if not all(1 <= side <= n for side, n in zip(size, shape, strict=True)):
        raise ValueError(f"a window must lie inside the image of {shape} pixels, got {size}.")
    rows, columns = size

    def corner(i: int, j: int) -> Pair:
        cut = [slice(None)] * integral.high.ndim
        cut[axis] = slice(i, i + shape[0] - rows + 1)
        cut[axis + 1] = slice(j, j + shape[1] - columns + 1)
        return integral.high[tuple(cut)], integral.low[tuple(cut)]

    return _corners(corner(rows, columns), corner(0, columns), corner(rows, 0), corner(0, 0))


def _row_axis(rank: int, what: str) -> int:
    if rank < 2:
        raise ValueError(f"{what} is (h, w) or (..., h, w, bands), got rank {rank}.")
    return 0 if rank == 2 else rank - 3


def _corners(inside: Pair, above: Pair, before: Pair, both: Pair) -> Array:
    """Return inside - above - before + both, with a single rounding."""
    high, low = _plus(_plus(inside, _minus(above)), _plus(both, _minus(before)))
    return high + low


def _minus(a: Pair) -> Pair:
    return -a[0], -a[1]


def _plus(a: Pair, b: Pair) -> Pair:
    """Add two pairs: Knuth's error-free sum of the high parts, plus the low parts, renormalised."""
    total = a[0] + b[0]
    virtual = total - a[0]
    error = (a[0] - (total - virtual)) + (b[0] - virtual) + a[1] + b[1]
    high = total + error
    return high, error - (high - total)


def _running(pair: Pair, axis: int) -> Pair:
    """Return cumulative sums of pairs along an axis, line by line."""
    lines = jnp.moveaxis(pair[0], axis, 0), jnp.moveaxis(pair[1], axis, 0)

    def step(total: Pair, line: Pair) -> tuple[Pair, Pair]:
        total = _plus(total, line)
        return total, total

    zero = jnp.zeros_like(lines[0][0])
    _, (high, low) = scan(step, (zero, zero), lines)
    return jnp.moveaxis(high, 0, axis), jnp.moveaxis(low, 0, axis)


@partial(jax.custom_jvp, nondiff_argnums=(1,))
def _sum_along(pixels: Array, rows: int) -> Pair:
    return _running(_running((pixels, jnp.zeros_like(pixels)), rows), rows + 1)


@_sum_along.defjvp
def _(rows: int, primals: tuple[Array], tangents: tuple[Array]) -> tuple[Pair, Pair]:
    """Return the derivative of the linear sum: the cumulative sum of the tangents, with a low part
    of 0.
    """
    change = jnp.cumsum(jnp.cumsum(tangents[0], axis=rows), axis=rows + 1)
    return _sum_along(primals[0], rows), (change, jnp.zeros_like(change))
