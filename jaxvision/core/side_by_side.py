"""Run independent pieces of work in parallel threads of one process. The threads run in parallel
because compiling and computing release Python's global lock."""

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


def keep_context(work: Callable[[], T]) -> Callable[[], T]:
    """Wrap a function so that it can run in another thread with the precision and the context
    variables of this thread."""
    context, double = contextvars.copy_context(), _double()

    def run_in_context() -> T:
        # JAX's settings belong to a thread. Setting the same precision again would still recompile.
        with nullcontext() if _double() == double else jax.enable_x64(double):
            return context.run(work)

    return run_in_context


def _double() -> bool:
    """Return whether double precision is enabled in this thread."""
    return jax.dtypes.canonicalize_dtype(np.float64) == np.float64


def side_by_side(
    pieces: Sequence[Callable[[], T]], *, progress: Callable[[int, int], None] | None = None
) -> list[T]:
    """Run independent pieces of work in threads, and return their results in order. As many pieces
    run at a time as this process has cores. If a piece raises an exception, the exception is raised
    at once and pieces that have not started are cancelled. After each piece, `progress(finished,
    all)` is called with the numbers of finished pieces and of all pieces."""
    threads = ThreadPoolExecutor(min(cores(), len(pieces)) or 1)
    waiting = [threads.submit(keep_context(piece)) for piece in pieces]
    try:
        for count, ended in enumerate(as_completed(waiting), 1):
            ended.result()
            if progress is not None:
                progress(count, len(pieces))
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
    return [piece.result() for piece in waiting]
