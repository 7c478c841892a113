"""Run independent pieces of work on all cores of one process. Threads run in parallel, because
compilation and computation release Python's lock."""

import contextvars
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import nullcontext
from typing import TypeVar

import jax
import numpy as np

T = TypeVar("T")


def cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def for_any_thread(work: Callable[[], T]) -> Callable[[], T]:
    """Wrap work so that it can run in another thread with the settings of this one: its precision
    and context variables."""
    context, double = contextvars.copy_context(), _double()

    def done() -> T:
        # JAX's settings belong to a thread. A context that changes nothing would still recompile.
        with nullcontext() if _double() == double else jax.enable_x64(double):
            return context.run(work)

    return done


def _double() -> bool:
    """Whether this thread computes in double precision where requested."""
    return jax.dtypes.canonicalize_dtype(np.float64) == np.float64


def side_by_side(
    pieces: Sequence[Callable[[], T]], *, progress: Callable[[int, int], None] | None = None
) -> list[T]:
    """Return the results of independent pieces of work, in order. As many pieces run at a time as
    there are cores. The first exception is raised at once. After each piece, `progress(finished,
    all)` is called."""
    threads = ThreadPoolExecutor(min(cores(), len(pieces)) or 1)
    waiting = [threads.submit(for_any_thread(piece)) for piece in pieces]
    try:
        for count, ended in enumerate(as_completed(waiting), 1):
            ended.result()
            if progress is not None:
                progress(count, len(pieces))
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
    return [piece.result() for piece in waiting]
