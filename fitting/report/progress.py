"""Progress display of long commands on standard error."""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich import progress
from rich.console import Console

_LOG = logging.getLogger("jaxvision.fitting")
Progress = Callable[[int, int], None]  # called with (done, total)
REPORT_SECONDS = 30.0  # s after which a step reports, without a terminal, that it is still running


class Reporter:
    """The progress display of a command, with named steps. Each step may have a progress bar."""

    def __init__(self, bars: progress.Progress) -> None:
        self._progress = bars

    @contextmanager
    def step(self, description: str) -> Iterator[Progress]:
        """Show `description` in a `with` block, which gets a function of (done, total)."""
        begun = printed = time.perf_counter()
        task = self._progress.add_task(description, total=None)
        terminal = self._progress.console.is_terminal

        def advance(done: int, total: int) -> None:
            nonlocal printed
            self._progress.update(task, completed=done, total=total)
            now = time.perf_counter()
            if not terminal and (done == 0 or (done < total and now - printed > REPORT_SECONDS)):
                printed = now
                self._progress.console.print(f"{description}: {done} of {total}")

        yield advance
        self._progress.update(task, total=1, completed=1)
        if not terminal:
            self._progress.console.print(f"{description}: done")
        _LOG.info("%s took %.2f s", description, time.perf_counter() - begun)


@contextmanager
def reporting() -> Iterator[Reporter]:
    """Show progress on standard error in a `with` block, as plain lines off a terminal."""
    console = Console(stderr=True, highlight=False)
    columns = (
        progress.SpinnerColumn(),
        progress.TextColumn("{task.description}"),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
    )
    with progress.Progress(*columns, console=console, disable=not console.is_terminal) as bars:
        yield Reporter(bars)
