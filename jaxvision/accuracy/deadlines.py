"""Run work in another thread, and abandon it if it exceeds a time limit.

Python cannot stop a program while XLA compiles or runs it. Therefore the work runs in another
thread, and the caller waits until the deadline. An abandoned thread runs to the end of its work. At
exit, a Python process waits for abandoned threads, because XLA's threads must not outlive their
data. The package's shell commands exit without waiting.
"""

import atexit
import queue
import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from ..core.interrupts import leaves_work_behind
from ..core.side_by_side import keep_context
from ..errors import InputError

TICK = 0.1  # s between two checks of the time


class OutOfTime(Exception):
    """Raised if a call was abandoned, or not started, because its time limit was reached."""


class TooLittleTime(InputError):
    """Raised if the requested measurement does not fit into the given time."""


class _Job:
    """A function to call and, after the call, its result or its error."""

    def __init__(self, work: Callable[[], Any]) -> None:
        self.work = keep_context(work)
        self.ended = threading.Event()
        self.result: Any = None
        self.error: BaseException | None = None

    def run(self) -> None:
        try:
            self.result = self.work()
        except BaseException as error:
            self.error = error
        self.ended.set()


class _Hand:
    """A thread that runs one job after another."""

    def __init__(self) -> None:
        self.jobs: queue.SimpleQueue[_Job | None] = queue.SimpleQueue()
        self.thread = threading.Thread(target=self._serve, daemon=True)
        self.thread.start()

    def _serve(self) -> None:
        while (job := self.jobs.get()) is not None:
            job.run()

    def leave(self, job: _Job) -> None:
        """Abandon the job. The thread ends after the job, and nothing waits for the result."""
        self.jobs.put(None)
        _left_behind.append(job)
        leaves_work_behind()
        atexit.register(self.thread.join)


_idle: list[_Hand] = []
_left_behind: list[_Job] = []


def something_left_behind() -> bool:
    """Return whether abandoned work is still running and slows down all other work."""
    _left_behind[:] = [job for job in _left_behind if not job.ended.is_set()]
    return bool(_left_behind)


def wait_for_the_rest(left: Callable[[], float]) -> None:
    """Wait until all abandoned work has ended, for at most `left()` seconds."""
    while something_left_behind() and left() > 0:
        _left_behind[0].ended.wait(TICK)


def run_within(work: Callable[[], Any], left: Callable[[], float]) -> Any:
    """Return the result of calling `work`, or raise `OutOfTime` if the call takes longer than
    `left()` seconds. An abandoned call continues, so `work` must not change anything that the
    caller still needs."""
    if np.isinf(left()):
        return work()
    hand, job = _idle.pop() if _idle else _Hand(), _Job(work)
    hand.jobs.put(job)
    try:
        while not job.ended.wait(TICK):
            if left() <= 0:
                raise OutOfTime
    except BaseException:
        hand.leave(job)
        raise
    _idle.append(hand)
    if job.error is not None:
        raise job.error
    return job.result
