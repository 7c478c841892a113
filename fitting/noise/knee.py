"""Flats whose converter writes codes of a piecewise linear curve (companding): above a knee, the
slope of the signal is r times the slope below.

With K DN an electron below the knee and s_k DN of signal at it, the variance of light is

    K s                        below,
    r K (s - (1 - r) s_k)      above:

At the knee it falls to r^2 of its value, as at a full well, and then rises again. The light itself
is not used, so a lamp that flickers between levels neither hides nor imitates a knee.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

FEWEST = 3  # levels to either side
BENT = 0.85  # r, from which a bend may be a smooth one
FLAT = 0.02  # r, below which a well is full
ALIKE = 0.03  # relative departure of variances from both lines, rms, besides their own noise
RISES = 1.05  # largest signal to that of the first level behind a knee, at least
BESIDE = 0.1  # of the signal, by which the knee may lie beside the gap between the levels


class Knee(NamedTuple):
    """Where a response bends.

    Attributes:
        level: index of the first level above the knee.
        slope: r, the slope above the knee over the slope below it.
        signal: s_k, DN above black.
    """

    level: int
    slope: float
    signal: float


def knee_of(
    signal: Float[np.ndarray, " levels"],
    shot: Float[np.ndarray, " levels"],
    error: Float[np.ndarray, " levels"],
) -> Knee | None:
    """The knee of a response of two slopes."""
    known = (signal > 0) & (shot > 0) & (error < shot / 4)
    places = np.flatnonzero(known)
    s, v, e = signal[places], shot[places], error[places] / shot[places]
    best, found = np.inf, None
    for place in range(FEWEST, len(s) - FEWEST + 1):
        if s[-1] < RISES * s[place]:
            continue
        gain = float(np.average(v[:place] / s[:place], weights=1 / (e[:place] ** 2 + ALIKE**2)))
        slope, cut = np.polyfit(s[place:], v[place:], 1, w=1 / v[place:])
        ratio = float(slope) / gain
        if not FLAT < ratio < BENT:
            continue
        knee = -float(cut) / (slope * (1 - ratio))
        if not (1 - BESIDE) * s[place - 1] <= knee <= (1 + BESIDE) * s[place]:
            continue
        line = np.concatenate([gain * s[:place], slope * s[place:] + cut])
        left = (v / line - 1) / np.hypot(e, ALIKE)
        sides = [float(np.sqrt(np.mean(part**2))) for part in (left[:place], left[place:])]
        if max(sides) < min(best, 1.5):
            best, found = max(sides), Knee(int(places[place]), ratio, knee)
    return found
