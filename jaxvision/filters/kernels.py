"""Kernels of plain numbers, as NumPy arrays: they are known before anything is traced.

All are kernels of correlation, (taps,) down a column or along a row, or (kh, kw): an entry stands
on the picture where it is written, so that a derivative is positive where the picture rises to the
right, or downwards. Distances are in pixels, weights have no unit unless they say so.
"""

import math
from collections.abc import Sequence
from numbers import Integral

import numpy as np

# Smoothing across the derivative, and its name.
SMOOTHING = {
    "central": (0, 1, 0),
    "prewitt": (1, 1, 1),
    "sobel": (1, 2, 1),
    "scharr": (3, 10, 3),
}


def box_kernel(size: int) -> np.ndarray:
    """(size,) equal weights of sum 1. `ValueError` for size < 1."""
    return np.full(_checked(size), 1 / size)


def binomial_kernel(size: int) -> np.ndarray:
    """(size,) binomial coefficients over their sum 2 ** (size - 1): variance (size - 1) / 4.
    `ValueError` for size < 1."""
    n = _checked(size) - 1
    # whole numbers divided: of the largest there is no float, of every quotient there is
    return np.array([math.comb(n, k) / 2**n for k in range(size)])


def derivative_kernels(*, scheme: str = "central") -> tuple[np.ndarray, np.ndarray]:
    """(derivative, smoothing), each (3,): the slope per pixel along an axis, exact for a parabola,
    and the weights of sum 1 across it.

    `scheme`: "central" differences, no smoothing; "prewitt"; "sobel"; "scharr", whose direction is
    the most nearly true (Scharr, thesis, Heidelberg 2000). `ValueError` for another.
    """
    if scheme not in SMOOTHING:
        raise ValueError(f"scheme must be one of {', '.join(SMOOTHING)}, got {scheme!r}.")
    across = np.array(SMOOTHING[scheme], float)
    return np.array([-0.5, 0.0, 0.5]), across / across.sum()


def laplacian_kernel(*, isotropic: bool = False) -> np.ndarray:
    """(3, 3) sum of second differences, per square pixel: the five-point stencil, or with
    `isotropic` the nine-point one, whose first error is the same in all directions."""
    if isotropic:
        return np.array([[1, 4, 1], [4, -20, 4], [1, 4, 1]]) / 6.0
    return np.array([[0.0, 1, 0], [1, -4, 1], [0, 1, 0]])


def gaussian_size(sigma: float, *, truncate: float = 4.0) -> int:
    """The odd size that reaches `truncate` sigmas to both sides, 2 round(truncate sigma) + 1, as in
    scipy; at 4 a share of 6e-5 is cut off, at 6 2e-9. `ValueError` for sigma < 0 or not finite."""
    if not (np.isfinite(sigma) and sigma >= 0):
        raise ValueError(f"sigma must be finite and >= 0 pixels, got {sigma}.")
    return 2 * int(truncate * sigma + 0.5) + 1


def blur_sigmas(low: float, high: float, *, members: int) -> tuple[float, ...]:
    """The sigmas of a bank from `low` to `high` pixels, equally spaced in log(sigma + 1 / 2): the
    error is the same at all, wide blurs being smooth. `ValueError` unless 0 <= low < high and
    members >= 2."""
    if not 0 <= low < high or members < 2:
        raise ValueError(
            f"a bank needs 0 <= low < high and members >= 2, got {low}, {high} and {members}."
        )
    steps = np.linspace(np.log(low + 0.5), np.log(high + 0.5), members)
    return tuple(float(s) for s in np.maximum(np.exp(steps) - 0.5, low))


def _checked(size: int) -> int:
    if not isinstance(size, Integral) or size < 1:
        raise ValueError(
            f"a kernel must have at least one entry, a whole number of them, got size {size}."
        )
    return int(size)


def _both_ways(size: int | np.integer | Sequence[int]) -> tuple[int, int]:
    """(down, across) of a size that may be one number for both. `ValueError` for another form."""
    pair = tuple(size) if isinstance(size, Sequence) else (size, size)
    if len(pair) != 2 or not all(isinstance(n, Integral) and n >= 1 for n in pair):
        raise ValueError(f"size must be n or (down, across), each at least 1, got {size}.")
    return int(pair[0]), int(pair[1])
