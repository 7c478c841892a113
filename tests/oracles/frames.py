"""Summarise frames of one level as the reader of a rig does."""

import jax.numpy as jnp
import numpy as np

from fitting.noise.level_sums import fixed_variance, temporal_variance
from fitting.noise.levels import Levels, SharedVariance
from fitting.noise.live_pixels import LivePixels


def level_of(
    stack: np.ndarray,
) -> tuple[np.ndarray, float, tuple[float, ...]]:
    """Return average, temporal variance and variances shared by lines, of one level's frames."""
    live, count = LivePixels(np.ones(stack[0].shape, bool)), len(stack)
    shifts = stack.mean(axis=(1, 2))
    still = stack - shifts[:, None, None]
    average, variance = stack.mean(axis=0), still.var(axis=0, ddof=1).mean()
    of_lines = (still.mean(axis=axis).var(axis=0, ddof=1).mean() for axis in (2, 1))
    parts = temporal_variance(live, variance, *of_lines, shifts.var(ddof=1))
    lines = parts.rows, parts.columns, *fixed_variance(live, average, parts, count), parts.frames
    return average, parts.pixel_variance, lines


def shared_variance(of_levels: np.ndarray, shape: tuple[int, ...]) -> SharedVariance:
    """Return the shared variances from the lines of each level, (5, levels), as `level_of` gives
    them."""
    return SharedVariance(
        *map(jnp.asarray, (of_levels[:2], of_levels[2:4], of_levels[4], np.array(shape, float)))
    )


def levels_sharing(
    shared: SharedVariance, variance: np.ndarray, frames: int, spatial: np.ndarray | None = None
) -> Levels:
    """Return dark levels with these shared, temporal and spatial variances."""
    one = jnp.ones(len(variance))
    return Levels(
        *(0 * one, one, 100 * one, jnp.asarray(variance), frames * one, jnp.prod(shared.shape)),
        spatial_variance=None if spatial is None else jnp.asarray(spatial),
        shared=shared,
    )
