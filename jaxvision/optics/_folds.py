"""Find pixels beyond the fold of a strong distortion, at which the image of a line turns back."""

import numpy as np

from ..scene import Distortion

_STEEPEST = 20.0  # largest slope of a ray that is looked at, 87 degrees


def folded_share(
    lens: Distortion, pitch: float, resolution: tuple[int, int], *, ideal: bool = False
) -> float:
    """Return the share of the pixels beyond the fold, from 0 to 1: no light falls there, or, with
    `ideal`, in a picture without distortion, light that the lens images to another pixel. `pitch`
    is in units of the image distance. Tangential distortion is neglected."""
    slopes = np.linspace(0, _STEEPEST, 4001)
    powers = slopes[:, None] ** (2 * np.arange(1, 1 + len(lens.radial)))
    images = slopes * (1 + powers @ np.asarray(lens.radial, float))
    folds = np.flatnonzero(np.diff(images) <= 0)
    if not folds.size:
        return 0.0
    limit = slopes[folds[0]] if ideal else images[folds[0]]
    down, right = (pitch * (np.arange(n) - (n - 1) / 2) for n in resolution)
    if not ideal:
        across, below = (0.0, 0.0) if lens.shift is None else np.asarray(lens.shift, float)
        stretch = 1.0 if lens.stretch is None else float(lens.stretch)
        down, right = (down - below) / stretch, right - across
    return float(np.mean(np.hypot(down[:, None], right) > limit))
