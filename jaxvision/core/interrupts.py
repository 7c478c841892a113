"""Handle interrupts: Ctrl-C ends a command at once, with one line and exit status 130.

Python raises `KeyboardInterrupt` only after XLA has finished compiling or computing, which may take
minutes. Inside a callback from XLA the exception is lost. The exception may crash the process
during the import of a compiled library, or while XLA's threads are working. A separate thread
therefore receives the signal, prints the line and ends the process. The files of a command are
valid at every moment, so even `kill -9` does not damage them, and the same command can continue
from these files. `KeyboardInterrupt` is raised only within `raised_interrupts`, so that a command
can save its measurements.

This module imports only small modules, because a command imports this module before everything
else.
"""

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

MOMENT = 1.0  # s, after which a message says that the exception has not been handled yet
INTERRUPTED = 130  # the exit status of shells: 128 + SIGINT


class _Ending:
    """The state of interrupt handling in this process: the message, the files to remove, and event
    flags."""

    def __init__(self) -> None:
        self.sentence = "interrupted."
        self.unfinished: set[Path] = set()
        self.seen = threading.Event()  # an interrupt has arrived
        self.reported = threading.Event()  # the message has been printed
        self.raised = threading.Event()  # a context expects the exception
        self.thrown = threading.Event()  # the exception was raised, perhaps in an ended context
        self.handled = threading.Event()  # the command has caught it and will end the process
        self.behind = threading.Event()  # abandoned threads still run
        self.leaving = threading.Lock()  # taken by the thread that ends the process; never released


_ending = _Ending()


def say_if_interrupted(sentence: str) -> None:
    """Set the message that is printed, after the command's name, at an interrupt from now on."""
    _ending.sentence = sentence


def mark_reported() -> None:
    """Record that the command itself has reported how it ended, so that no further message is
    printed."""
    _ending.reported.set()


def is_handled() -> None:
    """Record that the command has caught `KeyboardInterrupt`, saves its results and will end by
    itself. A second interrupt ends the process at once."""
    _ending.handled.set()


def leaves_work_behind() -> None:
    """Record that threads are still working on abandoned tasks, so that the process must end
    without waiting for them."""
    _ending.behind.set()


@contextmanager
def raised_interrupts() -> Iterator[None]:
    """Let an interrupt raise `KeyboardInterrupt` in this context; contexts may be nested."""
    outermost = not _ending.raised.is_set()
    _ending.raised.set()
    try:
        yield
    finally:
        if outermost:
            _ending.raised.clear()


@contextmanager
def removed_if_interrupted(file: Path) -> Iterator[None]:
    """Remove an incomplete file if an interrupt ends the process in this context."""
    _ending.unfinished.add(file)
    try:
        yield
    finally:
        _ending.unfinished.discard(file)


def ending_on_interrupt(command: str, work: Callable[[], object]) -> None:
    """Run the work of a command, including its imports, so that an interrupt ends the process.
    Afterwards Python ends normally."""
    _open_closed_streams()
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    threading.Thread(target=_watch, args=(command, reader), daemon=True).start()
    signal.signal(signal.SIGINT, _handle_interrupt)
    status: object = 0
    try:
        work()
    except KeyboardInterrupt:
        _ending.seen.set()
    except SystemExit as end:
        status = end.code
        if not (_ending.seen.is_set() or _ending.behind.is_set()):
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            raise
    if _ending.seen.is_set():
        _leave(command)
    if _ending.behind.is_set():
        _end(status if isinstance(status, int) else int(status is not None))
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _open_closed_streams() -> None:
    """Open each standard stream that the shell has closed (`>&-`) on the null device. Otherwise
    the next opened file would get the number of that stream, and a library would print into the
    file."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open(mode))  # noqa: SIM115


def _handle_interrupt(number: int, frame: FrameType | None) -> None:
    del number, frame
    _ending.seen.set()  # the watching thread may set this flag too late
    if _ending.raised.is_set():
        _ending.thrown.set()
        raise KeyboardInterrupt


def _watch(command: str, reader: int) -> None:
    """End the process at the first interrupt, or at the second if the first raises
    `KeyboardInterrupt`."""
    _wait_for_interrupt(reader)
    _ending.seen.set()
    if _ending.raised.is_set() or _ending.thrown.is_set():
        again = threading.Event()

        def listen() -> None:
            _wait_for_interrupt(reader)
            again.set()

        threading.Thread(target=listen, daemon=True).start()
        if not again.wait(MOMENT) and not _ending.handled.is_set():
            wait = "interrupted; ends with what runs now, at once if interrupted again."
            print(f"{command}: {wait}", file=sys.stderr)
        again.wait()
    _leave(command)


def _wait_for_interrupt(reader: int) -> None:
    while os.read(reader, 1)[0] != signal.SIGINT:
        pass


def _leave(command: str) -> None:
    """Print the message, remove incomplete files, and end the process without destroying objects
    that threads still use."""
    _ending.leaving.acquire()
    if not _ending.reported.is_set():
        _ending.reported.set()
        print(f"{command}: {_ending.sentence}", file=sys.stderr)
    for file in tuple(_ending.unfinished):
        file.unlink(missing_ok=True)
    _end(INTERRUPTED)


def _end(status: int) -> None:
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(status)
