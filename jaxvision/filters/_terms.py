"""The implementation that all linear filters share. A kernel is stored
as a sum of terms. Each term is a full (rows, columns) kernel or a column times a row. A rule for
the border gives the values outside the picture.

One program is compiled for each shape and dtype of picture and each `Settings`. The kernel's
numbers and the fill are traced.
"""

from functools import partial, reduce
from operator import add, mul
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Shaped

from ..core._arguments import warn_of_idle_fill
from ..core._numerics import binary_unit, divide, smallest_divisor
from ..core._types import print_by_name
from ..programs import targets_cpu
from ._bilinear import correlate_stack
from ._methods import Anchor, Kernel, Stack
from .padding import Filtered, Picture, as_planes, ghosts

Fill = Float[Array | np.ndarray, "..."] | float  # () or (bands,)
AnyKernel = Shaped[Array | np.ndarray, "..."]  # (kh, kw) or (kh, kw, bands)
AnyTaps = Shaped[Array | np.ndarray, "..."]  # (taps,) or (taps, bands)
print_by_name(globals(), "Fill", "AnyKernel", "AnyTaps")


class Separable(NamedTuple):
    """The kernel column[i] row[j]."""

    column: AnyTaps
    row: AnyTaps


Terms = tuple[AnyKernel | Separable, ...]


class Settings(NamedTuple):
    """The static settings of a filter. Each combination compiles one program. `method`: a key of
    `_methods.METHODS` for the product of a term's passes, or "separable" for sequential passes.
    """

    anchor: Anchor
    border: str
    method: str


def filtered(picture: Picture, terms: Terms, fill: Fill, settings: Settings) -> Filtered:
    """Correlate the picture with the sum of the terms, including the contribution of the border."""
    warn_of_idle_fill(fill, settings.border)
    return _apply_terms(picture, terms, fill, settings)


@partial(jax.jit, static_argnames="settings")
def _apply_terms(picture: Picture, terms: Terms, fill: Fill, settings: Settings) -> Filtered:
    anchor, border, method = settings
    image, restore = as_planes(picture)
    passes = tuple(_passes(term, image.dtype) for term in terms)
    kernels = tuple(reduce(mul, kernels) for kernels in passes)
    if method == "separable":
        method = "direct" if targets_cpu() else "conv"
    else:
        passes = tuple((kernel,) for kernel in kernels)
    outer = Settings(
        anchor, "zero" if border in ("constant", "normalised_zero") else border, method
    )
    total = reduce(add, (_correlate_in_turn(image, kernels, outer) for kernels in passes))
    if border == outer.border:
        return restore(total)
    kernel = reduce(add, kernels)
    inside, outside = _shares(kernel, image.shape[1:3], anchor)
    if border == "constant":
        return restore(total + jnp.asarray(fill, image.dtype).reshape(1, 1, 1, -1) * outside)
    # where the weights cancel, their sum is only the rounding error of the additions
    rounding = kernel.shape[0] * kernel.shape[1] * jnp.finfo(image.dtype).eps
    least = rounding * _shares(jnp.abs(kernel), image.shape[1:3], anchor)[0]
    unit = binary_unit(kernel)
    inside, least = inside / unit, least / unit
    held = ~(jnp.abs(inside) <= jnp.maximum(least, smallest_divisor(image.dtype)))
    return restore(divide(total / unit, inside, held))


def _passes(term: AnyKernel | Separable, dtype: np.dtype) -> tuple[Kernel, ...]:
    """Return the kernels that are applied in sequence for one term, (kh, kw, bands) or (kh, kw, 1)
    each.
    """
    if isinstance(term, Separable):
        column, row = (jnp.asarray(taps, dtype) for taps in term)
        return column.reshape(len(column), 1, -1), row.reshape(1, len(row), -1)
    return (jnp.asarray(term, dtype).reshape(*term.shape[:2], -1),)


def _correlate_in_turn(image: Stack, kernels: tuple[Kernel, ...], settings: Settings) -> Stack:
    """Correlate the image with the kernels of a term, one after the other."""
    (row, column), border, method = settings
    for kernel in kernels:
        own = (row * (kernel.shape[0] > 1), column * (kernel.shape[1] > 1))
        image = correlate_stack(image, kernel, anchor=own, border=border, method=method)
    return image


def _shares(
    kernel: Kernel, size: tuple[int, ...], anchor: Anchor
) -> tuple[Float[Array, "1 h w _"], Float[Array, "1 h w _"]]:
    """Return the sums of the weights inside and outside the picture, for each of its pixels.
    Separate sums avoid cancellation."""

    def reach(axis: int) -> np.ndarray:
        n, taps = size[axis], kernel.shape[axis]
        inside = ghosts("zero", n, anchor[axis], taps - 1 - anchor[axis]).own
        return inside[np.arange(n)[:, None] + np.arange(taps)]

    def share(rows: np.ndarray, columns: np.ndarray) -> Float[Array, "h w _"]:
        r, c = jnp.asarray(rows, kernel.dtype), jnp.asarray(columns, kernel.dtype)
        return jnp.einsum("yi,ijb,xj->yxb", r, kernel, c, precision=lax.Precision.HIGHEST)

    rows, columns = reach(0), reach(1)
    beside = share(1 - rows, np.ones_like(columns)) + share(rows, 1 - columns)
    return share(rows, columns)[None], beside[None]
