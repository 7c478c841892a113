"""Gaussian and Laplacian image pyramids, with exact reconstruction for any size, and blending by
pyramids (Burt & Adelson, IEEE Trans. Communications 31, 1983; ACM Trans. Graphics 2, 1983).

The kernel is the binomial [1 4 6 4 1] / 16 (their a = 3/8) in rows and columns. Level l + 1 keeps
the even rows and columns of level l: n pixels become ceil(n / 2), as in OpenCV's `pyrDown`. Values
are relative or DN; integer images are computed as floating numbers. NaN spreads to all pixels whose
kernel covers it. The borders are those of `padding`, except "constant", which would need a fill
value.
"""

from collections.abc import Callable
from functools import partial
from itertools import pairwise

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._loops.fusion import materialise
from ..core._types import as_float, check_count
from ._neighbours import AnyPicture, Floats
from .padding import as_planes, check_border, check_picture, pad_axis

ROWS, COLUMNS = 1, 2  # of a stack of images
Stack = Float[Array, "images _ _ bands"]

Pyramid = tuple[Floats, ...]
Size = tuple[int, int]


@takes_numbers
@partial(jax.jit, static_argnames=("border",))
def reduce_by_two(picture: AnyPicture, *, border: str = "mirror") -> Floats:
    """Compute the next level of a Gaussian pyramid: blur, and keep every second row and column.

    Args:
        picture: (h, w) or (..., h, w, bands), relative or DN.
        border: a key of `padding.BORDERS` but "constant".

    Returns:
        (ceil(h / 2), ceil(w / 2)), or with batch and bands, in the picture's unit.

    Raises:
        ValueError: for an array that is no picture and for an unknown border.

    Example:
        >>> print(jv.filters.reduce_by_two(np.ones((4, 4))))
        [[1. 1.]
         [1. 1.]]
    """
    image, restore = as_planes(picture)
    check_border(border, refused=("constant",))
    for axis in ROWS, COLUMNS:
        image = materialise(partial(_normalise, _reduce, axis=axis, border=border), image)
    return restore(image)


@takes_numbers
@partial(jax.jit, static_argnames=("size", "border"))
def expand(picture: AnyPicture, size: Size, *, border: str = "mirror") -> Floats:
    """Expand a level of a pyramid to the size of the next finer level.

    The coarse pixels are placed on even rows and columns, and the kernel interpolates between them.
    A constant picture stays constant, except with border "zero".

    Args:
        picture: (ceil(h / 2), ceil(w / 2)), or with batch and bands, relative or DN.
        size: (h, w) of the finer level, in pixels.
        border: a key of `padding.BORDERS` but "constant".

    Returns:
        (h, w), or with batch and bands, in the picture's unit.

    Raises:
        ValueError: for a picture of another size and for an unknown border.
    """
    image, restore = as_planes(picture)
    check_border(border, refused=("constant",))
    coarse = image.shape[ROWS], image.shape[COLUMNS]
    if coarse != tuple(-(-n // 2) for n in size):
        raise ValueError(
            f"{coarse} pixels expand to twice as many a side or one less, got size {size}."
        )
    for axis, n in zip((ROWS, COLUMNS), size, strict=True):
        image = lax.slice_in_dim(_normalise(_expand, image, axis, border), 0, n, axis=axis)
    return restore(image)


@takes_numbers
def gaussian_pyramid(picture: AnyPicture, levels: int, *, border: str = "mirror") -> Pyramid:
    """Return the picture and its successive reductions by two.

    Args:
        picture: (h, w) or (..., h, w, bands), relative or DN.
        levels: number of levels, at least 1.
        border: a key of `padding.BORDERS` but "constant".

    Returns:
        The levels, finest first, in the picture's unit.

    Raises:
        ValueError: for fewer than one level and as for `reduce_by_two`.

    Example:
        >>> print([level.shape for level in jv.filters.gaussian_pyramid(np.ones((8, 6)), 3)])
        [(8, 6), (4, 3), (2, 2)]
    """
    check_count("levels", levels, 1)
    check_picture(picture)
    pyramid = [as_float(picture)]
    for _ in range(levels - 1):
        pyramid.append(reduce_by_two(pyramid[-1], border=border))
    return tuple(pyramid)


@takes_numbers
def laplacian_pyramid(picture: AnyPicture, levels: int, *, border: str = "mirror") -> Pyramid:
    """Return the difference of each level of the Gaussian pyramid from the expanded next level, and
    the coarsest level.

    Args:
        picture: (h, w) or (..., h, w, bands), relative or DN.
        levels: number of levels, at least 1.
        border: a key of `padding.BORDERS` but "constant".

    Returns:
        The levels, finest first, in the picture's unit; the last is the coarsest Gaussian level
        itself.

    Raises:
        ValueError: for fewer than one level and as for `reduce_by_two`.

    Example:
        >>> levels = jv.filters.laplacian_pyramid(np.full((4, 4), 0.5), 2)
        >>> print([float(abs(level).max()) for level in levels])  # no detail, and the mean
        [0.0, 0.5]
    """
    gaussian = gaussian_pyramid(picture, levels, border=border)
    details = (
        fine - expand(coarse, _size(fine), border=border) for fine, coarse in pairwise(gaussian)
    )
    return (*details, gaussian[-1])


def collapse_laplacian(pyramid: Pyramid, *, border: str = "mirror") -> Floats:
    """Reconstruct the picture from a Laplacian pyramid.

    The reconstruction is exact for any size and border, up to the rounding of one subtraction and
    one addition per level.

    Args:
        pyramid: the levels, finest first, relative or DN.
        border: the border that the pyramid was built with.

    Returns:
        (h, w) or (..., h, w, bands), in the pyramid's unit.

    Raises:
        ValueError: for a pyramid without levels and for levels whose sizes do not fit.

    Example:
        >>> picture = jnp.arange(35.0).reshape(5, 7)
        >>> pyramid = jv.filters.laplacian_pyramid(picture, 3)
        >>> print([level.shape for level in pyramid])
        [(5, 7), (3, 4), (2, 2)]
        >>> print(bool(jnp.allclose(jv.filters.collapse_laplacian(pyramid), picture, rtol=1e-12)))
        True
    """
    check_count("the number of levels", len(pyramid), 1)
    image = pyramid[-1]
    for detail in reversed(pyramid[:-1]):
        image = detail + expand(image, _size(detail), border=border)
    return image


@takes_numbers
def blend_by_pyramid(
    first: AnyPicture,
    second: AnyPicture,
    mask: AnyPicture,
    levels: int,
    *,
    border: str = "mirror",
) -> Floats:
    """Blend two pictures as mask first + (1 - mask) second, separately for each band of spatial
    frequencies.

    Coarse structure is blended over a wide strip and fine detail over a narrow one, so that there
    is no visible seam.

    Args:
        first: (h, w) or (..., h, w, bands), relative or DN.
        second: the same shape and unit.
        mask: the same shape, or with one band for all; no unit, in [0, 1]. Values outside this
            range extrapolate.
        levels: levels of the pyramids, at least 1; 1 is the plain blend.
        border: a key of `padding.BORDERS` but "constant".

    Returns:
        The shape and unit of `first`.

    Raises:
        ValueError: for shapes that do not fit and as for `laplacian_pyramid`.
    """
    one, other, weight = as_float(first), as_float(second), as_float(mask)
    shapes = (one.shape, (*one.shape[:-1], 1) if one.ndim > 2 else one.shape)
    if one.shape != other.shape or weight.shape not in shapes:
        raise ValueError(
            "the images must have one shape, and the mask that shape or one band of it, got "
            f"{one.shape}, {other.shape} and {weight.shape}."
        )
    weights = gaussian_pyramid(weight, levels, border=border)
    details = (laplacian_pyramid(image, levels, border=border) for image in (one, other))
    blended = tuple(b + w * (a - b) for w, a, b in zip(weights, *details, strict=True))
    return collapse_laplacian(blended, border=border)


def _size(picture: Floats) -> Size:
    rows, columns = picture.shape if picture.ndim == 2 else picture.shape[-3:-1]
    return rows, columns


def _normalise(
    filtered: Callable[[Stack, int, str], Stack], image: Stack, axis: int, border: str
) -> Stack:
    """For the border "normalised_zero", divide the filtered image by a filtered image of ones."""
    if border != "normalised_zero":
        return filtered(image, axis, border)
    return filtered(image, axis, "zero") / filtered(jnp.ones_like(image), axis, "zero")


def _reduce(image: Stack, axis: int, border: str) -> Stack:
    """Filter one axis with the binomial, at the even samples only."""
    last = 2 * (-(-image.shape[axis] // 2)) - 1
    around = _pad_both_sides(image, axis, 2, border)
    a, b, c, d, e = (lax.slice_in_dim(around, i, i + last, 2, axis) for i in range(5))
    return (a + e + 4 * (b + d) + 6 * c) / 16


def _expand(image: Stack, axis: int, border: str) -> Stack:
    """Interleave the samples of one axis with zeros and filter with twice the binomial, its even
    and odd taps separately.
    """
    count = image.shape[axis]
    around = _pad_both_sides(image, axis, 1, border)
    before, here, after = (lax.slice_in_dim(around, i, i + count, axis=axis) for i in range(3))
    both = jnp.stack([(before + 6 * here + after) / 8, (here + after) / 2], axis=axis + 1)
    return both.reshape(*image.shape[:axis], 2 * count, *image.shape[axis + 1 :])


def _pad_both_sides(image: Stack, axis: int, by: int, border: str) -> Stack:
    return pad_axis(image, axis, by, by, border, jnp.zeros((), image.dtype))
