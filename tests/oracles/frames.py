"""Frames of one level, summed up as the reader of a rig does."""

import numpy as np

from fitting.noise.variance_parts import Moments


def level_of(
    stack: np.ndarray,
) -> tuple[np.ndarray, float, tuple[float, ...]]:
    """Average, temporal variance and what lines share, of one level's frames."""
    moments = Moments(stack[0])
    for frame in stack[1:]:
        moments.add(frame - stack[0])
    wander = stack.mean(axis=(1, 2)).var(ddof=1)
    average, parts = stack.mean(axis=0), moments.temporal(stack.var(axis=0, ddof=1).mean(), wander)
    lines = parts.rows, parts.columns, *moments.fixed(average, parts), parts.frames
    return average, parts.of_a_pixel, lines
