"""How a command ends that cannot go on: one sentence on standard error, and an exit status."""

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NoReturn

import typer

from .errors import InputError


@contextmanager
def failures_as_sentences(command: str, *, interrupted: str = "interrupted.") -> Iterator[None]:
    """What a user can put right becomes one line and exit status 2, an interrupt status 130, a
    warning a line. `interrupted`: said where the interrupt itself says nothing."""
    try:
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *_: print(
                f"{command}: {message}", file=sys.stderr
            )
            yield
    except InputError as error:
        leave(command, str(error), 2)
    except OSError as error:
        where = error.filename or "a file"
        sentence = f"{where}: {error.strerror or error}; choose another path or make room."
        leave(command, sentence, 2)
    except KeyboardInterrupt as interrupt:
        leave(command, str(interrupt) or interrupted, 130)


def leave(command: str, sentence: str, status: int) -> NoReturn:
    print(f"{command}: {sentence}", file=sys.stderr)
    raise typer.Exit(status)
