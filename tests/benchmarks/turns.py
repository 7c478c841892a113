"""Rivals timed in turns, so that what else the machine does meets all of them alike."""

import time
from collections.abc import Callable

import jax
import numpy as np

_SETTLED = 0.05  # s: by then the last rival's threads, which spin while they wait, are asleep


def in_turns(
    rivals: dict[str, Callable[[], object]], *, rounds: int
) -> tuple[dict[str, float], dict[str, float]]:
    """(seconds of the first call, median seconds of the later ones) of each. A rival's turn begins
    with calls that do not count, until it has the cores and the cache to itself."""
    first, seconds = {}, {name: [] for name in rivals}
    for name, run in rivals.items():
        first[name] = _seconds(run)
    for _ in range(rounds):
        for name, run in rivals.items():
            begin = time.perf_counter()
            while time.perf_counter() - begin < _SETTLED:
                _seconds(run)
            seconds[name].append(_seconds(run))
    return first, {name: float(np.median(taken)) for name, taken in seconds.items()}


def _seconds(run: Callable[[], object]) -> float:
    start = time.perf_counter()
    jax.block_until_ready(run())
    return time.perf_counter() - start
