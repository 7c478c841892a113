"""Flats whose signal drifts in one direction from frame to frame, as while a lamp or a camera warms
up. A drift within levels continues between them, where it resembles a curved response.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Int
from scipy.special import stdtrit

from .levels import PhotonTransfer

FEWEST_LEVELS = 5
CHANCE = 1e-6  # that levels of a steady lamp, or of one that flickers, seem to drift


class Drifting(NamedTuple):
    """A drift of the signal.

    Attributes:
        share: relative change from one frame of a level to the next.
        error: its standard error.
        frames: number of flats.
    """

    share: float
    error: float
    frames: int

    @property
    def total(self) -> float:
        """Relative change over all flats if they were taken in sequence."""
        return self.share * (self.frames - 1)


def drifting(measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"]) -> Drifting | None:
    """The drift of the flats, or None if it is not significant."""
    bright, dark = measurement.bright, measurement.dark
    if bright.trend is None or len(usable) < FEWEST_LEVELS:
        return None
    black = np.asarray(dark.mean)[np.asarray(measurement.dark_of)[usable]]
    signal = np.asarray(bright.mean)[usable] - black
    if not (signal > 0).all():
        return None
    frames = np.asarray(bright.frames)[usable]
    squares = frames * (frames**2 - 1) / 12  # of the order about its mean
    shares = np.asarray(bright.trend)[usable] / signal
    noise = np.asarray(bright.variance)[usable] / float(bright.pixels) / squares / signal**2
    weights = 1 / noise
    share = float(np.sum(weights * shares) / np.sum(weights))
    degrees = len(usable) - 1
    scatter = max(float(np.sum(weights * (shares - share) ** 2)) / degrees, 1.0)
    error = float(np.sqrt(scatter / np.sum(weights)))
    if abs(share) < stdtrit(degrees, 1 - CHANCE / 2) * error:
        return None
    return Drifting(share, error, int(frames.sum()))
