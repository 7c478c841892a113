"""Padding: continue pictures beyond their border.

A picture is (h, w), one grey plane, or (..., h, w, bands), where each band of each image is a
separate plane. Values keep their unit. Integers become floating numbers of the same value. Complex
numbers raise a `ValueError`. Every border except "constant" is linear in the picture. Along one
axis

    ghost[i] = own[i] f[source[i]] + first[i] f[0] + last[i] f[n - 1],

where `ghosts` returns the static coefficients for padding of any width, even several times the
picture's size. The names are from Szeliski, Computer Vision, section 3.2. "reflect_101" is OpenCV's
name for its default border.

"normalised_zero" divides by the filtered image of ones, not by a filtered coverage. The exact blur
of a premultiplied layer (light, then alpha), with the layer's colours, is
`compositing.unpremultiply(filters.gaussian(layer, sigma, border="zero"))`.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Shaped

from ..core._arguments import takes_numbers, warn_caller, warn_of_idle_fill
from ..core._types import as_float, print_by_name

Picture = Shaped[Array | np.ndarray, "*picture"]
Filtered = Float[Array, "*filtered"]
Widths = Sequence[Sequence[int]]
print_by_name(globals(), "Picture", "Filtered")

# name: the values beyond (a b c d), then the names in other libraries
BORDERS = {
    "zero": '0 0 | a b c d | 0 0; numpy and scipy "constant" with 0',
    "constant": 'x x | a b c d | x x, x = fill; numpy and scipy "constant"',
    "clamp": 'a a | a b c d | d d; numpy "edge", scipy "nearest"',
    "wrap": 'c d | a b c d | a b; numpy "wrap", scipy "grid-wrap"',
    "mirror": 'b a | a b c d | d c; numpy "symmetric", scipy "reflect"',
    "reflect_101": 'c b | a b c d | c b; OpenCV\'s default, numpy "reflect", scipy "mirror"',
    "extend": (
        '2a-c 2a-b | a b c d | 2d-c 2d-b; numpy "reflect" with reflect_type="odd", '
        'scipy.signal padtype "odd"'
    ),
    "normalised_zero": "zero, and the filter divides by that of a picture of ones; not in numpy",
}

_REFUSALS = {
    "constant": 'needs a fill, which this filter lacks: pad the picture first, or use "zero"',
    "normalised_zero": "divides by the sum of the weights, and these have no sum to divide by",
}


# Numbers of pixels and bands, from which three or four rows are more likely to be channels.
_CHANNELS_FIRST = 32


class Ghosts(NamedTuple):
    """The coefficients of the module's equation for one axis of n samples."""

    # (before + n + after,) whole numbers in [0, n), the sample that each place copies
    source: np.ndarray
    # (before + n + after,) its factor, no unit; 0 for a value from outside
    own: np.ndarray
    first: np.ndarray  # (before + n + after,) the factor of the first sample, no unit
    last: np.ndarray  # (before + n + after,) the factor of the last sample, no unit


def check_border(border: str, *, refused: tuple[str, ...] = ()) -> None:
    """Raise `ValueError` for an unknown border, with a list of all borders and their names in numpy
    and scipy, and for a border that the calling filter does not support.
    """
    if border not in BORDERS:
        known = "; ".join(f'"{name}": {meaning}' for name, meaning in BORDERS.items())
        raise ValueError(f"border must be one of the following, got {border!r}. {known}.")
    if border in refused:
        raise ValueError(f'border "{border}" {_REFUSALS[border]}.')


def check_picture(picture: ArrayLike) -> None:
    """Raise `ValueError` for an array that is not a picture, (h, w) or (..., h, w, bands): fewer
    than two axes, no pixels, or complex.
    """
    shape = jnp.shape(picture)
    if len(shape) == 1 and shape[0]:
        raise ValueError(
            f"a picture must be (h, w) or (..., h, w, bands), got shape {shape}: a signal (n,) is "
            "taken by filters.correlate and convolve, with a kernel (k,) such as "
            "filters.gaussian_kernel(sigma, size=9), or as a picture of one row, signal[None]."
        )
    if len(shape) < 2 or 0 in shape:
        raise ValueError(
            "a picture must be (h, w) or (..., h, w, bands) with at least one pixel, got shape "
            f"{shape}."
        )
    if len(shape) > 2 and shape[-3] in (3, 4) and min(shape[-2:]) >= _CHANNELS_FIRST:
        warn_caller(
            f"a picture is (h, w) or (..., h, w, bands), so shape {shape} is one of {shape[-3]} "
            f"rows and {shape[-1]} bands; if its channels come first, take "
            "np.moveaxis(picture, -3, -1)."
        )
    if jnp.iscomplexobj(picture):
        raise ValueError(
            "a picture holds real numbers, got complex ones: filter the real and the imaginary "
            "part by themselves."
        )


def ghosts(border: str, n: int, before: int, after: int) -> Ghosts:
    """Return the coefficients, each of length before + n + after, no unit, with which one axis of n
    samples is padded. "constant" and "normalised_zero" have the same coefficients as "zero".
    """
    i = np.arange(-before, n + after)
    inside = (i >= 0) & (i < n)
    own, first, last = np.ones(len(i)), np.zeros(len(i)), np.zeros(len(i))
    if border == "wrap":
        source = i % n
    elif border == "mirror":
        source = i % (2 * n)
        source = np.minimum(source, 2 * n - 1 - source)
    elif border == "reflect_101" and n > 1:
        source = i % (2 * n - 2)
        source = np.minimum(source, 2 * n - 2 - source)
    elif border == "extend" and n > 1:
        # f rises by f[n-1] - f[0] every n - 1 samples; every second stretch is reversed
        stretch, offset = np.divmod(i, n - 1)
        turned = stretch % 2 == 1
        source = np.where(inside, i, np.where(turned, n - 1 - offset, offset))
        own = np.where(turned & ~inside, -1.0, 1.0)
        first = np.where(inside, 0.0, np.where(turned, 1 - stretch, -stretch))
        last = np.where(inside, 0.0, np.where(turned, 1 + stretch, stretch))
    else:
        source = np.clip(i, 0, n - 1)
        if border not in ("clamp", "extend", "reflect_101"):
            own = inside.astype(float)
    return Ghosts(source, own, first, last)


@takes_numbers
def pad(
    picture: Picture,
    widths: Widths,
    *,
    border: str = "mirror",
    fill: Float[Array | np.ndarray, "..."] | float = 0.0,
) -> Filtered:
    """Pad a picture beyond its border.

    Args:
        picture: (h, w) or (..., h, w, bands), any unit.
        widths: ((top, bottom), (left, right)) in pixels, each at least 0.
        border: a key of `BORDERS`. "normalised_zero" pads with 0; the division is part of the
            filter.
        fill: () or (bands,) in the picture's unit: the value outside with border "constant".

    Returns:
        (top + h + bottom, left + w + right), or with batch and bands, in the picture's unit.

    Raises:
        ValueError: for an array that is no picture (see `check_picture`), an unknown border, and
            widths of another form or below 0.

    Example:
        >>> row = jnp.arange(4.0)[None]
        >>> print(jv.filters.pad(row, ((0, 0), (2, 2)), border="mirror")[0])
        [1. 0. 0. 1. 2. 3. 3. 2.]
        >>> print(jv.filters.pad(row, ((0, 0), (2, 2)), border="extend")[0])
        [-2. -1.  0.  1.  2.  3.  4.  5.]
    """
    image, restore = as_planes(picture)
    check_border(border)
    if np.shape(widths) != (2, 2) or np.min(widths) < 0:
        raise ValueError(f"widths must be ((top, bottom), (left, right)), each >= 0, got {widths}.")
    warn_of_idle_fill(fill, border)
    outside = jnp.asarray(fill, image.dtype) if border == "constant" else jnp.zeros((), image.dtype)
    for axis, (before, after) in zip((1, 2), widths, strict=True):
        image = pad_axis(image, axis, before, after, border, outside)
    return restore(image)


@takes_numbers
def pad_axis(
    image: Float[Array, "images h w bands"],
    axis: int,
    before: int,
    after: int,
    border: str,
    outside: Float[Array, "..."],
) -> Float[Array, "images _ _ bands"]:
    """Pad a stack of images along one axis. Only the two new strips are gathered.

    Args:
        image: (images, h, w, bands), any unit.
        axis: 1 for rows, 2 for columns.
        before: number of pixels to add before the first.
        after: number of pixels to add after the last.
        border: a key of `BORDERS`; "normalised_zero" pads with 0.
        outside: () or (bands,) in the image's unit: the value outside with "constant" (0 for
            "zero").

    Returns:
        (images, rows, columns, bands), `before` + `after` longer along the axis.
    """
    check_picture(image)
    n = image.shape[axis]
    rule = ghosts(border, n, before, after)
    first_sample, last_sample = (lax.slice_in_dim(image, k, k + 1, axis=axis) for k in (0, n - 1))

    def strip(chosen: slice) -> Float[Array, "images rows columns bands"]:
        source, own, first, last = (values[chosen] for values in rule)
        line = (1, -1, 1, 1) if axis == 1 else (1, 1, -1, 1)
        values = jnp.take(image, source, axis=axis)
        if not own.all():
            return jnp.broadcast_to(outside.astype(image.dtype), values.shape)
        if (own != 1).any() or first.any() or last.any():
            a, b, c = (jnp.asarray(v.reshape(line), image.dtype) for v in (own, first, last))
            values = a * values + b * first_sample + c * last_sample
        return values

    parts = [image]
    if before:
        parts = [strip(slice(0, before)), *parts]
    if after:
        parts = [*parts, strip(slice(n + before, None))]
    if len(parts) == 1:
        return image
    # joined as whole rows of numbers: copies of a few bands at a time are slow
    joined = jnp.concatenate([p.reshape(*p.shape[:2], -1) for p in parts], axis=axis)
    rows = image.shape[1] + (before + after) * (axis == 1)
    return joined.reshape(image.shape[0], rows, -1, image.shape[-1])


def as_planes(
    picture: Picture,
) -> tuple[Float[Array, "images h w bands"], Callable[[Filtered], Filtered]]:
    """Return a picture, (h, w) or (..., h, w, bands), as floating (images, h, w, bands) in its
    unit, and the function that restores the picture's axes.
    """
    check_picture(picture)
    image, shape = as_float(picture), jnp.shape(picture)
    if len(shape) == 2:
        return image[None, :, :, None], lambda stack: stack[0, :, :, 0]
    batch = shape[:-3]
    return image.reshape(-1, *shape[-3:]), lambda stack: stack.reshape(*batch, *stack.shape[1:])
