"""Places at which a curve is drawn: near together where it bends, however narrow its peaks are."""

from collections.abc import Callable

import numpy as np

FINE = 0.01  # of the largest value: the most that neighbouring points differ by
NARROWEST = 1e-6  # of the range: points are no nearer
_AT_ONCE = 128  # points in one call, so that one program serves all rounds
_ROUNDS = 40


def refined(
    function: Callable[[np.ndarray], np.ndarray], places: np.ndarray, *, peaks: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Places, (m,) ascending, m >= n, and the values of a function there, from (n,) places of the
    first look; narrow peaks are looked for at all distances from where they may stand."""
    low, high = places[0], places[-1]
    steps = (high - low) * np.geomspace(NARROWEST, 0.05, 24)
    about = np.concatenate([peaks, *(peaks[:, None] + sign * steps for sign in (-1, 1))], axis=None)
    x = np.unique(np.concatenate([places, about[(about > low) & (about < high)]]))
    y = _in_blocks(function, x)
    for _ in range(_ROUNDS):
        jumps, gaps = np.abs(np.diff(y)), np.diff(x)
        coarse = (jumps > FINE * np.abs(y).max()) & (gaps > 2 * NARROWEST * (high - low))
        if not coarse.any():
            break
        first = np.flatnonzero(coarse)
        worst = first[np.argsort(jumps[first])[::-1][:_AT_ONCE]]
        new = (x[worst] + x[worst + 1]) / 2
        order = np.argsort(x := np.concatenate([x, new]), kind="stable")
        x, y = x[order], np.concatenate([y, _in_blocks(function, new)])[order]
    return x, y


def _in_blocks(function: Callable[[np.ndarray], np.ndarray], x: np.ndarray) -> np.ndarray:
    padded = np.resize(x, -(-len(x) // _AT_ONCE) * _AT_ONCE)
    return np.concatenate([function(block) for block in padded.reshape(-1, _AT_ONCE)])[: len(x)]
