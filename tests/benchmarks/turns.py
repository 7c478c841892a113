"""Time programs in alternation, so that other load on the machine affects all of them equally.
Freed memory is kept for the next large array, as in the commands."""

import json
import os
import time
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np

from jaxvision import keep_memory

_SETTLED = 0.05  # s: by then the last program's threads, which spin while they wait, are asleep
KEPT = "JAXVISION_BENCHMARKS"  # names the file to which every measurement is appended

keep_memory()


def in_turns(
    rivals: dict[str, Callable[[], object]],
    *,
    rounds: int,
    title: str = "",
    settled: float = _SETTLED,
    errors: dict[str, float] | None = None,
) -> tuple[dict[str, float], dict[str, float]]:
    """Return (seconds of the first call, median seconds of the later ones) for each program.

    Before a program is timed, calls that do not count run for `settled` seconds, until it has the
    cores and the cache to itself. `title` distinguishes several comparisons in one test. `errors`
    are Monte Carlo errors, which fall as the root of the time, so that times can be compared at
    equal error."""
    first, seconds = {}, {name: [] for name in rivals}
    for name, run in rivals.items():
        first[name] = _seconds(run)
    for _ in range(rounds):
        for name, run in rivals.items():
            begin = time.perf_counter()
            while time.perf_counter() - begin < settled:
                _seconds(run)
            seconds[name].append(_seconds(run))
    if KEPT in os.environ:
        test = os.environ["PYTEST_CURRENT_TEST"].rpartition("/")[2].removesuffix(" (call)")
        kept = {"test": test, "title": title, "seconds": seconds, "errors": errors}
        with Path(os.environ[KEPT]).open("a") as file:
            file.write(json.dumps(kept) + "\n")
    return first, {name: float(np.median(taken)) for name, taken in seconds.items()}


def _seconds(run: Callable[[], object]) -> float:
    start = time.perf_counter()
    jax.block_until_ready(run())
    return time.perf_counter() - start
