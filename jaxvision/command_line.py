"""What the commands share: `--version`, and how a command that fails ends, with one sentence on
standard error and an exit status."""

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from . import __version__
from .errors import InputError
from .interrupts import INTERRUPTED, is_said, say_if_interrupted

# Options of every command that measures accuracy.
KnobNames = Annotated[
    list[str] | None,
    typer.Option(help="Measure this knob only; may be given again.", metavar="NAME"),
]
PageFolder = Annotated[
    Path | None,
    typer.Option(help="Write a page and its numbers to this folder.", metavar="DIR"),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]
# Options of every command whose work is made of independent tasks.
Workers = Annotated[
    int, typer.Option(help="Processes of this machine to share the work; 0: this one.", min=0)
]
Scheduler = Annotated[
    str,
    typer.Option(help="Dask scheduler whose workers do the work.", metavar="ADDRESS"),
]


def command_app(about: str) -> typer.Typer:
    """A command to which sub-commands are added.

    Args:
        about: one sentence, the head of its help.

    Returns:
        The command; it knows `--help` and `--version`.
    """
    app = typer.Typer(
        help=about, add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False
    )
    flag = typer.Option(
        "--version", help="Print the version.", callback=_print_version, is_eager=True
    )

    def options(version: Annotated[bool, flag] = False) -> None:
        del version  # printed by the callback

    app.callback()(options)
    return app


def _print_version(wanted: bool) -> bool:
    if wanted:
        print(f"jaxvision {__version__}")
        raise typer.Exit
    return wanted


@contextmanager
def failures_as_sentences(command: str, *, interrupted: str = "interrupted.") -> Iterator[None]:
    """Context in which errors that a user can correct end the command with one line.

    Input errors and file errors end with exit status 2, an interrupt with 130; a warning becomes
    one line.

    Args:
        command: name of the command, the beginning of each line.
        interrupted: sentence for an interrupt that has none of its own.

    Returns:
        A context manager.

    Raises:
        typer.Exit: in place of `InputError`, `OSError` and `KeyboardInterrupt`.
    """
    say_if_interrupted(interrupted)
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
        is_said()
        leave(command, str(interrupt) or interrupted, INTERRUPTED)


def leave(command: str, sentence: str, status: int) -> NoReturn:
    """Prints one line on standard error and ends the command.

    Args:
        command: name of the command, the beginning of the line.
        sentence: what went wrong and what to do.
        status: exit status.

    Raises:
        typer.Exit: always.
    """
    print(f"{command}: {sentence}", file=sys.stderr)
    raise typer.Exit(status)
