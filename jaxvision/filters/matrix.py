"""A filter as a matrix: g = H f + offset, with the pixels of one plane row by row in f and g.

The matrix represents every border exactly, and kernels that change from pixel to pixel. The entries
of H are the weights of the filter, without unit. Only the border "constant" has an offset, in the
picture's unit. H has h w rows and columns and about kh kw h w entries. Use the matrix to inspect
filters and to solve sparse systems. To apply the filter, call the filter itself, and for its
transpose `operators.adjoint`.
"""

from collections.abc import Sequence
from typing import cast

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.experimental.sparse import BCOO
from jaxtyping import Array, Float

from ..core._numerics import binary_unit, divide, smallest_divisor
from ..core._shown import Shown
from ..core._types import as_float, as_optional_float, print_by_name
from ._terms import Fill, Settings, filtered
from .convolution import _anchor
from .padding import check_border, ghosts

Kernel = Float[Array | np.ndarray, "kh kw"] | Float[Array | np.ndarray, " k"]
print_by_name(globals(), "Kernel")


class MatrixForm(Shown):
    """A filter as g = matrix @ f + offset, for a plane f of (h w,) pixels.

    Attributes:
        matrix: (h w, h w) sparse, no unit.
        offset: (h w,) in the picture's unit; None where the border adds no constant.
    """

    matrix: BCOO
    offset: Float[Array, " hw"] | None = eqx.field(converter=as_optional_float)


def filter_matrix(
    kernel: Kernel,
    *,
    shape: int | tuple[int, ...],
    anchor: Sequence[int] | None = None,
    border: str = "mirror",
    fill: Fill = 0.0,
) -> MatrixForm:
    """Return the matrix of `correlate` on one plane, or on a signal.

    Every entry is one kernel value times one coefficient of the border. Several entries may have
    the same row and column; `sum_duplicates` adds them.

    Args:
        kernel: (kh, kw), or (k,) for signals, no unit.
        shape: (h, w) of the planes, or n or (n,) of the signals.
        anchor: (row, column), or (entry,), of the kernel entry that lies on the pixel; None for the
            middle.
        border: a key of `padding.BORDERS`.
        fill: () in the picture's unit: the value outside with border "constant".

    Returns:
        The matrix (h w, h w) and, with border "constant", the offset (h w,) in the unit of `fill`.

    Raises:
        ValueError: for an unknown border, an anchor outside the kernel, and a shape whose number of
            axes differs from the kernel's.

    Example:
        >>> form = jv.filters.filter_matrix(jnp.array([1.0, 2.0, 1.0]), shape=(4,), border="zero")
        >>> print(form.matrix.todense())
        [[2. 1. 0. 0.]
         [1. 2. 1. 0.]
         [0. 1. 2. 1.]
         [0. 0. 1. 2.]]
    """
    check_border(border)
    kernel = as_float(kernel)
    sides: tuple[int, ...] = (shape,) if isinstance(shape, int) else shape
    if len(sides) != kernel.ndim or kernel.ndim not in (1, 2):
        raise ValueError(
            f"shape must be (h, w) with a kernel (kh, kw), or (n,) with (k,), got {sides} and "
            f"{kernel.shape}."
        )
    if kernel.ndim == 1:
        row = None if anchor is None else (0, *anchor)
        beside = {"anchor": row, "border": border, "fill": fill}
        return filter_matrix(kernel[None], shape=(1, *sides), **beside)
    h, w = cast(tuple[int, int], sides)
    anchor = _anchor(anchor, (kernel.shape[0], kernel.shape[1]))
    stack = jnp.broadcast_to(kernel[:, :, None, None], (*kernel.shape, h, w))
    outer = "zero" if border in ("constant", "normalised_zero") else border
    form = per_pixel_matrix(stack, anchor=anchor, border=outer)
    if border == "normalised_zero":
        ones = jnp.ones(h * w, kernel.dtype)
        weights = form.matrix.data / binary_unit(kernel)
        magnitudes = jnp.abs(weights), form.matrix.indices
        whole = BCOO(magnitudes, shape=form.matrix.shape) @ ones
        # where the weights cancel, their sum is only the rounding error of the additions
        least = kernel.size * jnp.finfo(kernel.dtype).eps * whole
        sums = BCOO((weights, form.matrix.indices), shape=form.matrix.shape) @ ones
        held = jnp.abs(sums) > jnp.maximum(least, smallest_divisor(kernel.dtype))
        scale = divide(1, sums, held)
        entries = weights * scale[form.matrix.indices[:, 0]]
        return MatrixForm(BCOO((entries, form.matrix.indices), shape=form.matrix.shape), None)
    if border == "constant":
        nothing = jnp.zeros(shape, kernel.dtype)
        offset = filtered(nothing, (kernel,), fill, Settings(anchor, border, "direct"))
        return MatrixForm(form.matrix, offset.ravel())
    return form


def per_pixel_matrix(
    kernels: Float[Array | np.ndarray, "kh kw h w"],
    *,
    anchor: Sequence[int] | None = None,
    border: str = "mirror",
) -> MatrixForm:
    """The matrix of `correlate_per_pixel`.

    Args:
        kernels: (kh, kw, h, w), one kernel a pixel, no unit.
        anchor: (row, column) of the kernel entry that lies on the pixel; None for the middle.
        border: "zero", "clamp", "wrap", "mirror", "reflect_101" or "extend".

    Returns:
        The matrix (h w, h w), without an offset.

    Raises:
        ValueError: for another border or an anchor outside the kernels.
    """
    check_border(border, refused=("constant", "normalised_zero"))
    kernels = as_float(kernels)
    kh, kw, h, w = kernels.shape
    anchor = _anchor(anchor, (kh, kw))
    tap_y, to_y, from_y, own_y = _axis_entries(border, h, kh, anchor[0])
    tap_x, to_x, from_x, own_x = _axis_entries(border, w, kw, anchor[1])
    outer = np.ix_(np.arange(len(tap_y)), np.arange(len(tap_x)))
    y, x = (np.broadcast_to(v, (len(tap_y), len(tap_x))).ravel() for v in outer)
    factor = jnp.asarray(own_y[y] * own_x[x], kernels.dtype)
    entries = kernels[tap_y[y], tap_x[x], to_y[y], to_x[x]] * factor
    places = np.stack([to_y[y] * w + to_x[x], from_y[y] * w + from_x[x]], axis=-1)
    indices = jnp.asarray(places.astype(np.int32))
    return MatrixForm(BCOO((entries, indices), shape=(h * w, h * w)), None)


def _axis_entries(
    border: str, n: int, taps: int, anchor: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return (tap, result, source, coefficient) of every non-zero product along one axis."""
    rule = ghosts(border, n, anchor, taps - 1 - anchor)
    result, tap = (v.ravel() for v in np.mgrid[:n, :taps])
    ghost = result + tap
    parts = [
        (tap, result, rule.source[ghost], rule.own[ghost]),
        (tap, result, np.zeros_like(ghost), rule.first[ghost]),
        (tap, result, np.full_like(ghost, n - 1), rule.last[ghost]),
    ]
    joined = [np.concatenate(column) for column in zip(*parts, strict=True)]
    present = joined[3] != 0
    tap, result, source, coefficient = (column[present] for column in joined)
    return tap, result, source, coefficient
