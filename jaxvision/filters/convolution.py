"""Correlation and convolution with any kernel, at any border.

Pictures are (h, w), one grey plane, or (..., h, w, bands), where each band of each image is a
separate plane; the result has the picture's shape, unit and floating dtype. Integers (uint8,
uint16) become floating numbers of the same value and are never scaled. Kernels are (kh, kw), or
(kh, kw, bands) with one kernel per band; they may be larger than the picture. `anchor` is the entry
of the kernel that lies on the pixel of the result: by default (kh // 2, kw // 2), the middle of an
odd kernel and the second of the two middle entries of an even one, as in scipy and OpenCV.
`correlate` and `convolve` also take a signal (n,) with a kernel (k,) and an anchor (entry,).

`border` is a key of `padding.BORDERS`. "constant" puts `fill` outside. "normalised_zero" is
filter(f) / filter(1), both with border "zero". For kernels without negative entries the result is a
weighted mean of the pixels inside the picture. Where |filter(1)| is at most its rounding error,
(number of taps) eps times filter(1) of |kernel|, the result is 0. "normalised_zero" ignores
coverage: to blur a premultiplied layer use border "zero", and divide by its blurred alpha with
`compositing.unpremultiply`.

`method` chooses how the sum is computed, not its value: "conv" by `lax.conv_general_dilated`,
"direct" by shifted pictures, "fft" by Fourier transforms, "separable" by passes over columns and
rows, as many as the kernel's rank. "auto" takes the method that was measured to be fastest for the
size. On a GPU "auto" takes "conv" up to 9 x 9 taps and "fft" beyond. On a CPU "auto" takes
"separable" for kernels of low rank (if the kernel is finite and not traced), else "direct" up to 15
x 15 and "fft" beyond.

"fft" is about as accurate as the other methods. In a picture with a range of eight decades the
relative error of a pixel is at most 1e-4. Sums of non-negative numbers are not negative, and a
window of zeros gives exactly 0. If some windows are 100 times darker than the picture's root mean
square, as in a picture with bright spots, the sums are computed in float64 and tile by tile, which
takes two to three times as long. For numbers of either sign the error is relative to the largest
value in the window.

A pixel becomes NaN or infinite if its window contains such a value, even under a weight of 0. With
"conv" and one kernel per band, a NaN in one band may spread to all bands, depending on the code
that XLA generates.

For a kernel without negative entries, such as a disc, the sum of separable passes may lose accuracy
by cancellation. Then "separable" is replaced by the method that "auto" would choose.

Derivatives with respect to picture and kernel are again correlations, and exist to any order, in
forward and reverse mode.
"""

from collections.abc import Sequence
from operator import index
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from ..core._arguments import takes_numbers
from ..core._types import check_choice
from ..programs import targets_cpu
from ._methods import METHODS, Anchor
from ._terms import AnyKernel, AnyTaps, Fill, Separable, Settings, Terms, filtered
from .padding import Filtered, Picture, check_border, check_picture

Numbers = Sequence[Any]

CHOICES = ("auto", "separable", *METHODS)

# The cost of a transform and of a pair of passes on a CPU, in taps of a direct sum.
_TRANSFORM, _PAIR = 240, 8
_LONGEST_SUM = 81  # number of taps on a GPU up to which "conv" is faster than "fft"
_MOST_LOST = 8  # largest ratio of the products that passes add to the resulting entry
# A smaller kernel is not worth a singular value decomposition.
_FEWEST_TAPS = 25


@takes_numbers
def correlate(
    picture: Picture,
    kernel: AnyKernel | Numbers,
    *,
    anchor: Sequence[int] | None = None,
    border: str = "mirror",
    fill: Fill = 0.0,
    method: str = "auto",
) -> Filtered:
    """Correlate with a kernel: g[p] = sum over i of kernel[i] f[p + i - anchor].

    The kernel is not rotated. Without an anchor the kernel's entry (kh // 2, kw // 2) lies on the
    pixel: the second of the two middle rows or columns of an even kernel. A kernel may be larger
    than the picture. Pixels are then read as far beyond the border as the kernel
    extends: "wrap", "mirror" and "reflect_101" repeat the picture periodically, and "extend"
    continues its straight line.

    Args:
        picture: (h, w) or (..., h, w, bands), or a signal (n,), any unit.
        kernel: (kh, kw), or (kh, kw, bands) with one kernel per band, or (k,) for a signal; any
            unit or none.
        anchor: (row, column), or (entry,), of the kernel entry that lies on the pixel; None for the
            middle.
        border: a key of `padding.BORDERS`. The default, "mirror", is OpenCV's BORDER_REFLECT;
            OpenCV's own default, BORDER_REFLECT_101, is "reflect_101".
        fill: () or (bands,) in the picture's unit: the value outside with border "constant".
        method: "auto", "separable", "conv", "direct" or "fft".

    Returns:
        The picture's shape; its unit times the kernel's.

    Raises:
        ValueError: for a kernel of another rank, without entries, or with another number of bands
            than the picture; for an anchor outside the kernel; for an unknown border or method; and
            for method "separable" with a kernel whose rank is not known, because it is traced
            (factor it by `low_rank`) or not finite.

    Example:
        >>> print(jv.filters.correlate(jnp.arange(5.0), [-0.5, 0.0, 0.5], border="extend"))
        [1. 1. 1. 1. 1.]
    """
    picture, weights = _as_array(picture), _as_array(kernel)
    if _is_signal(picture, weights):
        row = None if anchor is None else (0, *anchor)
        beside = {"anchor": row, "border": border, "fill": fill, "method": method}
        return correlate(picture[None], weights[None], **beside)[0]
    check_picture(picture)
    terms, settings = summed(weights, picture, anchor=anchor, border=border, method=method)
    return filtered(picture, terms, fill, settings)


@takes_numbers
def convolve(
    picture: Picture,
    kernel: AnyKernel | Numbers,
    *,
    anchor: Sequence[int] | None = None,
    border: str = "mirror",
    fill: Fill = 0.0,
    method: str = "auto",
) -> Filtered:
    """Convolve with a kernel: g[p] = sum over i of kernel[i] f[p - i + anchor].

    Each pixel spreads into a copy of the kernel, so the kernel is the impulse response.

    Args:
        picture: (h, w) or (..., h, w, bands), or a signal (n,), any unit.
        kernel: (kh, kw), or (kh, kw, bands) with one kernel per band, or (k,) for a signal; any
            unit or none.
        anchor: (row, column), or (entry,), of the kernel entry that lies on the pixel; None for the
            middle.
        border: a key of `padding.BORDERS`.
        fill: () or (bands,) in the picture's unit: the value outside with border "constant".
        method: as for `correlate`.

    Returns:
        The picture's shape; its unit times the kernel's.

    Raises:
        ValueError: as for `correlate`.

    Example:
        >>> print(jv.filters.convolve([0.0, 0, 1, 0, 0], [1.0, 2.0, 3.0]))
        [0. 1. 2. 3. 0.]
    """
    picture, weights = _as_array(picture), _as_array(kernel)
    if _is_signal(picture, weights):
        row = None if anchor is None else (0, *anchor)
        beside = {"anchor": row, "border": border, "fill": fill, "method": method}
        return convolve(picture[None], weights[None], **beside)[0]
    kh, kw = _size(weights)
    top, left = _anchor(anchor, (kh, kw))
    turned = (kh - 1 - top, kw - 1 - left)
    return correlate(
        picture, weights[::-1, ::-1], anchor=turned, border=border, fill=fill, method=method
    )


@takes_numbers
def correlate_separable(
    picture: Picture,
    column: AnyTaps | Numbers,
    row: AnyTaps | Numbers,
    *,
    anchor: Sequence[int] | None = None,
    border: str = "mirror",
    fill: Fill = 0.0,
    method: str = "auto",
) -> Filtered:
    """Correlate with the kernel column[i] row[j]: first down the columns, then along the rows. The
    two passes take kh + kw products per pixel instead of kh kw.

    Args:
        picture: (h, w) or (..., h, w, bands), any unit.
        column: (kh,), or (kh, bands) with one column per band; no unit, or any.
        row: (kw,), or (kw, bands).
        anchor: (row, column) of the kernel entry that lies on the pixel; None for the middle.
        border: a key of `padding.BORDERS`.
        fill: () or (bands,) in the picture's unit: the value outside with border "constant".
        method: "auto" and "separable" take two passes; "conv", "direct" and "fft" apply the product
            kernel as a whole.

    Returns:
        The picture's shape; its unit times those of column and row.

    Raises:
        ValueError: for taps of another rank, without entries, or with another number of bands than
            the picture; for an anchor outside the kernel; and for an unknown border or method.

    Example:
        >>> print(jv.filters.correlate_separable(np.eye(3), [1.0], [0.25, 0.5, 0.25]))
        [[0.75 0.25 0.  ]
         [0.25 0.5  0.25]
         [0.   0.25 0.75]]
    """
    picture, down, along = map(_as_array, (picture, column, row))
    check_picture(picture)
    for taps in (down, along):
        if taps.ndim not in (1, 2) or 0 in taps.shape:
            raise ValueError(f"taps must be (n,) or (n, bands), got shape {taps.shape}.")
        if taps.ndim == 2:
            _check_bands(taps.shape[1], picture)
    check_border(border)
    check_choice("method", method, CHOICES)
    anchor = _anchor(anchor, (len(down), len(along)))
    settings = Settings(anchor, border, "separable" if method == "auto" else method)
    return filtered(picture, (Separable(down, along),), fill, settings)


# ---------------------------------------------------------------- choices


def summed(
    kernel: AnyKernel,
    picture: Picture,
    *,
    anchor: Sequence[int] | None = None,
    border: str = "mirror",
    method: str = "auto",
) -> tuple[Terms, Settings]:
    """Return the terms and settings with which `filtered` applies a kernel. The method is chosen
    from the kernel's numbers if they are known. Raise `ValueError` as `correlate` does.
    """
    size = _size(kernel)
    if kernel.ndim == 3:
        _check_bands(kernel.shape[2], picture)
    check_border(border)
    method = _method(method, kernel, picture)
    terms = _separate(kernel, picture) if method == "separable" else (kernel,)
    return terms, Settings(_anchor(anchor, size), border, method)


def _method(method: str, kernel: AnyKernel, picture: Picture) -> str:
    """Return the method to use for `method`. Raise `ValueError` where "separable" is impossible."""
    check_choice("method", method, CHOICES)
    traced = isinstance(kernel, Tracer)
    if method == "separable" and traced:
        raise ValueError(
            'method "separable" must see the numbers of the kernel, got a traced one; factor it '
            "with low_rank."
        )
    finite = traced or bool(np.isfinite(np.asarray(kernel)).all())
    if method == "separable" and not finite:
        raise ValueError('method "separable" needs a finite kernel, got NaN or infinity in it.')
    kh, kw = kernel.shape[:2]
    if method == "separable" and _keeps_digits(kernel, *_singular(kernel, picture)):
        return method
    if method not in ("auto", "separable"):
        return method
    if not targets_cpu():
        return "conv" if kh * kw <= _LONGEST_SUM else "fft"
    whole = min(kh * kw, _TRANSFORM)
    if not traced and finite and min(kh, kw) > 1 and kh * kw >= _FEWEST_TAPS:
        u, s, v = _singular(kernel, picture)
        if s.shape[1] * (kh + kw + _PAIR) < whole and _keeps_digits(kernel, u, s, v):
            return "separable"
    return "direct" if kh * kw < _TRANSFORM else "fft"


def _keeps_digits(kernel: AnyKernel, u: np.ndarray, s: np.ndarray, v: np.ndarray) -> bool:
    """Return whether the sum of separable passes gives every entry of a non-negative kernel without
    losing digits to cancellation; True for other kernels. If the passes cancel to an entry of 0, a
    bright pixel at this entry would leave a rounding error."""
    k = np.asarray(kernel, np.float64)
    k = k[None] if k.ndim == 2 else np.moveaxis(k, -1, 0)
    if s.shape[1] == 1 or k.min() < 0:
        return True
    added = (np.abs(u) * s[:, None]) @ np.abs(v)
    return bool((added <= _MOST_LOST * k).all())


def _singular(kernel: AnyKernel, picture: Picture) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the singular value decomposition of each band's kernel: u (bands, kh, rank), s (bands,
    rank) and v (bands, rank, kw). Singular values below the rounding error of the picture's dtype
    are dropped.
    """
    planes = np.asarray(kernel, np.float64)
    planes = planes[None] if planes.ndim == 2 else np.moveaxis(planes, -1, 0)
    u, s, v = np.linalg.svd(planes, full_matrices=False)
    dtype = jnp.result_type(float) if picture.dtype.kind in "iub" else picture.dtype
    rank = max(1, int((s > jnp.finfo(dtype).eps * s[:, :1]).any(0).sum()))
    return u[:, :, :rank], s[:, :rank], v[:, :rank]


def _separate(kernel: AnyKernel, picture: Picture) -> Terms:
    u, s, v = _singular(kernel, picture)
    down, along = u * np.sqrt(s)[:, None], v * np.sqrt(s)[:, :, None]
    return tuple(Separable(down[:, :, k].T, along[:, k].T) for k in range(s.shape[1]))


def _is_signal(picture: Picture, kernel: AnyKernel) -> bool:
    """Return whether picture and kernel are signals of one axis. Raise `ValueError` if the picture
    has one axis and the kernel has more.
    """
    if picture.ndim == 1 and kernel.ndim != 1:
        raise ValueError(
            "a picture is (h, w) or (..., h, w, bands), and a signal (n,) takes a kernel (k,), got "
            f"{picture.shape} and {kernel.shape}."
        )
    return picture.ndim == 1


def _size(kernel: AnyKernel) -> tuple[int, int]:
    shape = jnp.shape(kernel)
    if len(shape) not in (2, 3) or 0 in shape:
        raise ValueError(f"a kernel must be (kh, kw) or (kh, kw, bands), got shape {shape}.")
    return shape[0], shape[1]


def _check_bands(given: int, picture: Picture) -> None:
    bands = 1 if picture.ndim == 2 else picture.shape[-1]
    if given != bands:
        raise ValueError(f"one kernel a band needs the picture's {bands} bands, got {given}.")


def _anchor(anchor: Sequence[int] | None, size: tuple[int, int]) -> Anchor:
    """Return the anchor of a kernel of that size, its centre for None. Raise `ValueError` if the
    anchor lies outside the kernel.
    """
    if anchor is None:
        return size[0] // 2, size[1] // 2
    if len(anchor) != 2 or not all(0 <= a < n for a, n in zip(anchor, size, strict=True)):
        raise ValueError(f"anchor must lie in the kernel of size {size}, got {anchor}.")
    return index(anchor[0]), index(anchor[1])


def _check_weighs(border: str, *, of: str) -> None:
    """Raise `ValueError` for the border "normalised_zero" of a filter whose weights have sum 0."""
    if border == "normalised_zero":
        raise ValueError(
            f'border "normalised_zero" divides by the sum of the weights, which is 0 for {of}: '
            "take another."
        )


def _as_array(x: Any) -> Any:
    """Convert a list to an array, and return an array, traced or not, unchanged."""
    return x if hasattr(x, "dtype") else np.asarray(x)
