"""Pixels with outliers in single frames, such as hits by cosmic rays.

A few such pixels can outweigh the noise of all others in a variance. They are separate from the
distribution of the others. A noise distribution with a tail, as from few electrons, multiplied
electrons or warm pixels, is continuous.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from .live_pixels import DECILE, LivePixels

HIT, BULK = 8.0, 5.0  # standard deviations of a pixel's change: of most hits, and of no noise
MOST = 0.01  # share of the pixels; of more, something else is the cause
AWAY = 5  # rows to the pixel whose noise stands in, further than neighbours are compared
SAMPLED = 100_000  # pixels that estimate the usual change


class Hits(NamedTuple):
    """Outlying pixels between two frames, and their replacement values.

    Attributes:
        up: (h, w) true where a pixel is much brighter in the second frame.
        down: (h, w) true where it is much brighter in the first frame.
        change: (h, w) second frame less the first, with these pixels set aside, DN.
    """

    up: Bool[np.ndarray, "h w"]
    down: Bool[np.ndarray, "h w"]
    change: Float[np.ndarray, "h w"]


def hits(change: Float[np.ndarray, "h w"], live: LivePixels) -> Hits | None:
    """The outlying pixels."""
    stride = max(int(np.sqrt(change.size / SAMPLED)), 1)
    sample = change[::stride, ::stride][live.mask[::stride, ::stride]]
    if not sample.size:
        return None
    middle = float(np.median(sample))
    usual = float(np.quantile(np.abs(sample - middle), 0.8)) / DECILE
    size = np.abs(change - middle)
    far = live.mask & (size > BULK * usual)
    if usual == 0 or not far.any():
        return None
    count, plain = int(far.sum()), int((far & (size > HIT * usual)).sum())
    if not count < 2 * plain or count > MOST * live.count:
        return None
    other = np.roll(change, AWAY, axis=0)
    spare = np.where(np.roll(far | ~live.mask, AWAY, axis=0), middle, other)
    return Hits(far & (change > middle), far & (change < middle), np.where(far, spare, change))
