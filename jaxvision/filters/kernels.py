"""Kernels as NumPy arrays, whose numbers are known before tracing.

All functions return correlation kernels, (taps,) down a column or along a row, or (kh, kw).
Correlation kernels are not rotated, so a derivative is positive where the picture increases to the
right or downwards. Distances are in pixels; weights have no unit unless stated.
"""

import math
from collections.abc import Sequence
from numbers import Integral

import numpy as np

from ..core._types import check_choice

# Smoothing across the derivative, and its name.
SMOOTHING = {
    "central": (0, 1, 0),
    "prewitt": (1, 1, 1),
    "sobel": (1, 2, 1),
    "scharr": (3, 10, 3),
}


def box_kernel(size: int) -> np.ndarray:
    """Return equal weights of sum 1.

    Args:
        size: number of taps, at least 1.

    Returns:
        (size,) no unit.

    Raises:
        ValueError: for a size that is not a whole number of at least 1.

    Example:
        >>> print(jv.filters.box_kernel(4))
        [0.25 0.25 0.25 0.25]
    """
    return np.full(_check_kernel(size), 1 / size)


def binomial_kernel(size: int) -> np.ndarray:
    """Return the binomial coefficients divided by their sum 2^(size - 1); the kernel's variance is
    (size - 1) / 4 pixels^2.

    Args:
        size: number of taps, at least 1.

    Returns:
        (size,) no unit.

    Raises:
        ValueError: for a size that is not a whole number of at least 1.

    Example:
        >>> print(jv.filters.binomial_kernel(5) * 16)
        [1. 4. 6. 4. 1.]
    """
    n = _check_kernel(size) - 1
    # divided as integers, because the largest exceed the range of a float but their quotients do
    # not
    return np.array([math.comb(n, k) / 2**n for k in range(size)])


def derivative_kernels(*, scheme: str = "central") -> tuple[np.ndarray, np.ndarray]:
    """Return the kernel of the first difference along an axis, and the smoothing kernel across it.

    Args:
        scheme: "central" differences without smoothing; "prewitt"; "sobel"; or "scharr", whose
            direction is the most accurate.

    Returns:
        (3,) the slope per pixel, exact for a parabola, and (3,) weights of sum 1, no unit.

    Raises:
        ValueError: for another scheme.

    Source: H. Scharr, thesis, Heidelberg 2000, for "scharr".

    Example:
        >>> slope, smooth = jv.filters.derivative_kernels(scheme="sobel")
        >>> print(slope, smooth)
        [-0.5  0.   0.5] [0.25 0.5  0.25]
    """
    check_choice("scheme", scheme, SMOOTHING)
    across = np.array(SMOOTHING[scheme], float)
    return np.array([-0.5, 0.0, 0.5]), across / across.sum()


def laplacian_kernel(*, isotropic: bool = False) -> np.ndarray:
    """Return the kernel of the Laplacian, the sum of both second differences.

    Args:
        isotropic: whether to take the nine-point stencil, whose leading error is the same in all
            directions, instead of the five-point one.

    Returns:
        (3, 3) per square pixel.

    Example:
        >>> print(jv.filters.laplacian_kernel())
        [[ 0.  1.  0.]
         [ 1. -4.  1.]
         [ 0.  1.  0.]]
    """
    if isotropic:
        return np.array([[1, 4, 1], [4, -20, 4], [1, 4, 1]]) / 6.0
    return np.array([[0.0, 1, 0], [1, -4, 1], [0, 1, 0]])


def gaussian_size(sigma: float, *, truncate: float = 4.0) -> int:
    """Return the odd kernel size that covers `truncate` sigmas to both sides, as in scipy.

    The size is 2 round(truncate sigma) + 1. At 4 sigmas, 6e-5 of the Gaussian is cut off, at 6
    sigmas 2e-9.

    Args:
        sigma: in pixels, at least 0.
        truncate: in sigmas, no unit.

    Returns:
        The number of taps.

    Raises:
        ValueError: for a sigma below 0 or not finite.

    Example:
        >>> print(jv.filters.gaussian_size(2.0), jv.filters.gaussian_size(2.0, truncate=2.0))
        17 9
    """
    if not (np.isfinite(sigma) and sigma >= 0):
        raise ValueError(f"sigma must be finite and >= 0 pixels, got {sigma}.")
    return 2 * int(truncate * sigma + 0.5) + 1


def blur_sigmas(low: float, high: float, *, members: int) -> tuple[float, ...]:
    """Return the sigmas of a bank of Gaussians, equally spaced in log(sigma + 1 / 2).

    With this spacing the error of a blend of two neighbours is about the same at every sigma,
    because wide blurs are smooth.

    Args:
        low: the smallest sigma, in pixels, at least 0.
        high: the largest sigma, in pixels, above `low`.
        members: number of kernels, at least 2.

    Returns:
        The sigmas in pixels, ascending.

    Raises:
        ValueError: unless 0 <= low < high and members >= 2.
    """
    if not 0 <= low < high or members < 2:
        raise ValueError(
            f"a bank needs 0 <= low < high and members >= 2, got {low}, {high} and {members}."
        )
    steps = np.linspace(np.log(low + 0.5), np.log(high + 0.5), members)
    return tuple(float(s) for s in np.maximum(np.exp(steps) - 0.5, low))


def _check_kernel(size: int) -> int:
    if not isinstance(size, Integral) or size < 1:
        raise ValueError(
            f"a kernel must have at least one entry, a whole number of them, got size {size}."
        )
    return int(size)


def _size_pair(size: int | np.integer | Sequence[int]) -> tuple[int, int]:
    """Return (down, across), the sizes along columns and rows, from a pair or from one number for
    both. `ValueError` for another form.
    """
    pair = tuple(size) if isinstance(size, Sequence) else (size, size)
    if len(pair) != 2 or not all(isinstance(n, Integral) and n >= 1 for n in pair):
        raise ValueError(f"size must be n or (down, across), each at least 1, got {size}.")
    return int(pair[0]), int(pair[1])
