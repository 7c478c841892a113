"""A progress bar for long commands."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def progress_bar(
    title: str, *, shown: bool = True, transient: bool = False
) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar on standard error if that is a terminal. Yield a function of the number
    of finished parts and the number of all parts, which updates the bar. If `transient`, the bar
    vanishes at the end."""
    if not (shown and sys.stderr.isatty()):
        yield lambda done, total: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.progress import TimeRemainingColumn as Remaining

    console = Console(stderr=True, highlight=False)
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), Remaining()
    hidden = not console.is_terminal
    with Progress(*columns, console=console, disable=hidden, transient=transient) as progress:
        task = progress.add_task(title, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)
