"""Rivals timed in turns, so that what else the machine does meets all of them alike."""

import time
from collections.abc import Callable

import jax
import numpy as np


def in_turns(
    rivals: dict[str, Callable[[], object]], *, rounds: int
) -> tuple[dict[str, float], dict[str, float]]:
    """(seconds of the first call, median seconds of the later ones) of each."""
    first, seconds = {}, {name: [] for name in rivals}
    for name, run in rivals.items():
        start = time.perf_counter()
        jax.block_until_ready(run())
        first[name] = time.perf_counter() - start
    for _ in range(rounds):
        for name, run in rivals.items():
            start = time.perf_counter()
            jax.block_until_ready(run())
            seconds[name].append(time.perf_counter() - start)
    return first, {name: float(np.median(taken)) for name, taken in seconds.items()}
