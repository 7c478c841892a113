"""Find pixels beyond the fold of a strong distortion, where the image folds back on itself."""

import numpy as np

from .lenses import Distortion

_STEEPEST = 20.0  # largest slope of the rays that are checked, 87 degrees


def folded_share(
    lens: Distortion, pitch: float, resolution: tuple[int, int], *, ideal: bool = False
) -> float:
    """Return the share of the pixels beyond the fold, from 0 to 1. No light reaches these pixels.
    With `ideal`, pixels of a picture without distortion are counted: those whose ray is beyond the
    fold. `pitch` is in units of the image distance."""
    p1, p2 = (0.0, 0.0) if lens.tangential is None else np.asarray(lens.tangential, float)
    rays, directions = (501, 120) if p1 or p2 else (4001, 1)
    slopes = np.tan(np.linspace(0, np.arctan(_STEEPEST), rays))
    angles = np.linspace(0, 2 * np.pi, directions, endpoint=False)[:, None]
    x, y, square = slopes * np.cos(angles), slopes * np.sin(angles), slopes**2
    coefficients = [1.0, *np.asarray(lens.radial, float)]
    scale = np.polynomial.polynomial.polyval(square, coefficients)
    change = np.polynomial.polynomial.polyval(
        square, np.polynomial.polynomial.polyder(coefficients)
    )
    down_down = scale + 2 * y * y * change + 6 * p1 * y + 2 * p2 * x
    down_right = 2 * x * y * change + 2 * p1 * x + 2 * p2 * y
    right_right = scale + 2 * x * x * change + 2 * p1 * y + 6 * p2 * x
    folds = (right_right <= 0) | (right_right * down_down <= down_right**2)
    first = np.arange(len(angles)), folds.argmax(axis=1)
    if not ideal:
        x, y = (
            x * scale + 2 * p1 * x * y + p2 * (square + 2 * x * x),
            y * scale + p1 * (square + 2 * y * y) + 2 * p2 * x * y,
        )
    limit = np.where(folds.any(axis=1), np.hypot(x, y)[first], np.inf)
    down, right = (pitch * (np.arange(n) - (n - 1) / 2) for n in resolution)
    if not ideal:
        across, below = (0.0, 0.0) if lens.shift is None else np.asarray(lens.shift, float)
        stretch = 1.0 if lens.stretch is None else float(lens.stretch)
        down, right = (down - below) / stretch, right - across
    if np.hypot(np.abs(down).max(), np.abs(right).max()) <= limit.min():
        return 0.0
    radius = np.hypot(down[:, None], right)
    toward = np.arctan2(down[:, None], right)
    most = np.minimum(limit, 2 * radius.max())  # interpolation needs finite numbers
    limits = np.interp(toward, np.arctan2(y[first], x[first]), most, period=2 * np.pi)
    return float(np.mean(radius > limits))
