"""Equalisation: the tone curve of an image is its cumulative distribution (Szeliski, Computer
Vision, 3.1.4). Values are codes (integer images) or relative.

Gradients treat the equalising curve as constant: a pixel's derivative is the slope of the curve at
the pixel's value. For an exact histogram this slope is the true derivative almost everywhere,
because counts do not change unless a value crosses an edge.
"""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Shaped

from ..core._arguments import takes_numbers, warn_caller
from ..core._loops.fusion import materialise
from ..core._types import Scalars
from ._planes import (
    Binning,
    Pixels,
    Range,
    Stack,
    as_stack,
    bin_counts,
    binning,
    check_codes_whole,
    equalising_curves,
    interpolated,
    levels_of,
    plane_numbers,
)


@takes_numbers
def equalise(
    image: Pixels,
    *,
    amount: float | Scalars = 1.0,
    bins: int | np.integer | None = None,
    value_range: Range | None = None,
    first_to_zero: bool = True,
) -> Shaped[Array, "..."]:
    """Equalise each plane by its own curve.

    For uint8 and uint16 the result equals that of OpenCV's `equalizeHist`: the first occupied code
    c becomes 0, and every code becomes round((N(<= code) - n_c) / (N - n_c) (levels - 1)). Without
    `first_to_zero` the result is the textbook's f(I) = (levels - 1) c(I), rounded, with c(I) = N(<=
    I) / N.

    In floating images the value x becomes low + (high - low) CDF(x), where values are assumed
    uniform within their bin. The lower edge of the darkest bin becomes low, and the upper edge of
    the brightest becomes high. Values outside are clipped to [low, high] before counting. NaN stays
    NaN and is not counted.

    A plane with a single code, with all values in one bin, or without values is unchanged.

    Args:
        image: (h, w) or (..., h, w, bands), uint8, uint16 or floating; codes or relative.
        amount: () no unit, blends the curve with the identity: 0 leaves the values unchanged, 1
            equalises fully.
        bins: number of bins of a floating image; None takes 256.
        value_range: (low, high) of a floating image, relative; None takes [0, 1].
        first_to_zero: whether the first occupied code of an integer image maps to 0, as above;
            static.

    Returns:
        The image's shape, unit and dtype.

    Raises:
        ValueError: for bins or a range with an integer image, and as for `exact_histogram`.

    Example:
        >>> codes = jnp.array([[10, 10, 10, 200]], dtype=jnp.uint8)
        >>> print(jv.histogram.equalise(codes), jv.histogram.equalise(codes, first_to_zero=False))
        [[  0   0   0 255]] [[191 191 191 255]]
    """
    stack = as_stack(image)
    check_codes_whole(stack, bins, value_range)
    chosen = binning(stack, bins, value_range)
    if not first_to_zero and levels_of(stack) is None:
        warn_caller("equalise: first_to_zero has no effect on an image that is not of integers.")
    return _equalise(stack, amount, chosen, first_to_zero).reshape(image.shape)


@partial(jax.jit, static_argnames=("chosen", "first_to_zero"))
def _equalise(stack: Stack, amount: float | Scalars, chosen: Binning, first_to_zero: bool) -> Stack:
    levels = levels_of(stack)
    if levels is not None:
        curve_of = _equalising_codes if first_to_zero else _cumulative_codes
        return _equalise_codes(stack, levels, amount, curve_of)
    clamped = jnp.clip(stack, chosen.low, chosen.high)
    to_curves = partial(equalising_curves, chosen=chosen, dtype=stack.dtype)
    curves = materialise(to_curves, bin_counts(clamped, chosen))
    full = interpolated(curves, plane_numbers(clamped), clamped, chosen)
    return clamped + jnp.asarray(amount, stack.dtype) * (full - clamped)


def _equalising_codes(counts: Int[Array, "groups levels"]) -> Float[Array, "groups levels"]:
    """Return the value to which each code is mapped, before rounding: 0 up to the first occupied
    code, and levels - 1 from the last occupied code on. The mapping is the identity if only one
    code is occupied.
    """
    levels = counts.shape[-1]
    dtype = jnp.result_type(float)
    below = jnp.cumsum(counts, axis=-1)
    first = jnp.take_along_axis(counts, jnp.argmax(counts > 0, axis=-1)[:, None], axis=-1)
    others = below[:, -1:] - first
    curve = jnp.maximum(below - first, 0).astype(dtype) * (
        (levels - 1) / jnp.maximum(others, 1).astype(dtype)
    )
    return jnp.where(others > 0, curve, jnp.arange(levels, dtype=dtype)[None])


def _cumulative_codes(counts: Int[Array, "groups levels"]) -> Float[Array, "groups levels"]:
    """Return the textbook's mapping before rounding: levels - 1 times the cumulative distribution
    c(I) of each code I.
    """
    below = jnp.cumsum(counts, axis=-1).astype(jnp.result_type(float))
    return (counts.shape[-1] - 1) * below / below[:, -1:]


def _equalise_codes(
    stack: Stack, levels: int, amount: float | Scalars, curve_of: Callable[[Array], Array]
) -> Stack:
    def table(
        counts: Int[Array, "planes levels"], amount: Scalars
    ) -> Shaped[Array, "planes levels"]:
        curve = curve_of(counts)
        identity = jnp.arange(levels, dtype=curve.dtype)[None]
        blended = identity + amount.astype(curve.dtype) * (curve - identity)
        return jnp.clip(jnp.round(blended), 0, levels - 1).astype(stack.dtype)

    counts = bin_counts(stack, binning(stack, None, None))
    codes = materialise(table, counts, jnp.asarray(amount))
    entry = plane_numbers(stack) * levels + stack.astype(jnp.int32)
    return codes.ravel().at[entry].get(mode="promise_in_bounds")
