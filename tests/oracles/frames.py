"""Frames of one level, summed up as the reader of a rig does."""

import numpy as np

from fitting.noise.level_sums import Moments
from fitting.noise.live_pixels import LivePixels


def level_of(
    stack: np.ndarray,
) -> tuple[np.ndarray, float, tuple[float, ...]]:
    """Average, temporal variance and what lines share, of one level's frames."""
    moments, count = Moments(LivePixels(np.ones(stack[0].shape, bool))), len(stack)
    shifts = stack.mean(axis=(1, 2))
    still = stack - shifts[:, None, None]
    for frame in still[1:]:
        moments.add(frame - still[0])
    average, variance = stack.mean(axis=0), still.var(axis=0, ddof=1).mean()
    total = (still - still[0]).sum(axis=0)
    parts = moments.temporal(total, variance, shifts.var(ddof=1), count)
    lines = parts.rows, parts.columns, *moments.fixed(average, parts, count), parts.frames
    return average, parts.of_a_pixel, lines
