"""Define what the shell commands of both packages share: the options `--version` and `-v`, and the
ending of a failed command with one sentence on standard error and an exit status."""

import gc
import logging
import os
import re
import sys
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperCommand, TyperGroup

from .. import __version__
from ..core.interrupts import INTERRUPTED, mark_reported, say_if_interrupted
from ..errors import DISTRIBUTION, InputError, check_utf8, nearest, unwritable
from ..programs import program_folder

UNREAD = 141  # the exit status of shells: 128 + SIGPIPE
# base class of all usage errors, which is not exported
_USAGE_ERROR: Any = typer.BadParameter.mro()[1]
PLAIN_WIDTH = 140  # width in columns if the output is not a terminal
# Number of new objects after which Python looks for garbage. Imports and tracing make many objects
# and no garbage; with Python's number, 700, the search takes 6 % of a short command's time.
_NEW_OBJECTS = 10**6
_SIDE_BY_SIDE = 4  # largest number of records side by side in a table
# The word that the help shows for an option's value, if it has no word of its own.
_WORDS = {int: "N", float: "NUMBER", str: "TEXT", Path: "PATH"}
_WORDS_BY_NAME = {"seconds": "SECONDS", "measure": "SECONDS"}
# Options of every command that measures accuracy.
KnobNames = Annotated[
    list[str] | None,
    typer.Option(help="Measure this setting only; can be repeated.", metavar="NAME"),
]
PageFolder = Annotated[
    Path | None,
    typer.Option(help="Write a page and its numbers to this folder.", metavar="DIR"),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]
# Options of every command whose work is made of independent tasks.
Workers = Annotated[
    int, typer.Option(help="Number of worker processes on this machine; 0: none.", min=0)
]
Scheduler = Annotated[
    str,
    typer.Option(help="Dask scheduler whose workers do the work.", metavar="ADDRESS"),
]


def _described_parameters(params: Any, ctx: Any) -> Any:
    """Set the placeholder that the help shows for the value of each option of a command, such as N
    or PATH. Flags have no placeholder, and positional arguments are shown by name."""
    for param in params:
        if param.param_type_name == "argument":
            param.display_type_rich = lambda ctx: None
        elif getattr(param, "is_flag", False):
            param.metavar = param.metavar or ""
        elif param.metavar is None:
            word = _WORDS.get(param.type_descriptor.annotation)
            word = word or param.display_type(ctx).strip("<>")  # the choices
            param.metavar = _WORDS_BY_NAME.get(param.name, word)
    return params


class _Command(TyperCommand):
    """A sub-command whose usage line names its arguments without braces."""

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        pieces = super().collect_usage_pieces(ctx)  # "{PATH}..." of several
        return [piece.replace("{", "").replace("}", "") for piece in pieces]

    def get_params(self, ctx: Any) -> Any:
        return _described_parameters(super().get_params(ctx), ctx)


class _Group(TyperGroup):
    """A command with sub-commands. An argument or a working folder whose name is not valid UTF-8 is
    an error."""

    def get_params(self, ctx: Any) -> Any:
        return _described_parameters(super().get_params(ctx), ctx)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        try:
            for word in (os.getcwd(), *args):
                check_utf8(word)
        except InputError as error:
            leave(str(self.name), str(error), 2)
        except FileNotFoundError:
            leave(str(self.name), "the working folder was removed; change to another.", 2)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        gc.set_threshold(_NEW_OBJECTS)
        try:
            return super().invoke(ctx)
        except _USAGE_ERROR as error:
            error.message = self._clearer(str(error.message), ctx)
            raise

    def _clearer(self, said: str, ctx: Any) -> str:
        """Reword the error message for a wrong command line to say what to do."""
        said = said.removeprefix("Value error, ")
        if " is not one of " in said:
            word, *known = re.findall(r"'([^']*)'", said)
            return f"{word!r} is unknown; {nearest(word, known)}."
        if re.match("No such option: (-v|--verbose)", said):
            return f"-v stands before the command: {self.name} -v COMMAND."
        unknown = re.match("No such command '(.*?)'", said)
        if unknown and unknown[1] in (ctx.obj or {}):
            return f"{said} Write {ctx.obj[unknown[1]]} {unknown[1]}."
        return said


def command_app(
    name: str, about: str, *, elsewhere: Mapping[str, str] | None = None
) -> typer.Typer:
    """Make a command that has sub-commands and the options `--help`, `--version` and `--verbose`.
    `elsewhere` maps a sub-command that only the other package has to the command that the error
    message suggests."""
    # pydantic looks for plugins in the metadata of every installed package
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    app = typer.Typer(
        name=name,
        cls=_Group,
        help=about,
        no_args_is_help=True,
        context_settings={"obj": elsewhere},
        pretty_exceptions_enable=False,
    )
    flag = typer.Option(
        "--version",
        help="Print the version; with -v, also those of Python and of the libraries.",
        callback=_print_version,
    )
    more = typer.Option(  # eager, so that `--version` knows it in any order
        "--verbose",
        "-v",
        help="Say what is read, done and compiled, with times.",
        is_eager=True,
    )

    def options(
        version: Annotated[bool, flag] = False, verbose: Annotated[bool, more] = False
    ) -> None:
        del version  # printed by its callback
        if verbose:
            say_what_is_done()

    app.callback()(options)
    return app


def sub_command(
    app: typer.Typer, *examples: str
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that adds a function to a command as a sub-command. The docstring of the
    function becomes the help text, in one paragraph, followed by the examples."""

    def add(function: Callable[..., None]) -> Callable[..., None]:
        sentences = " ".join((function.__doc__ or "").split())
        shown = "\n\n".join(f"Example: {line}" for line in examples)  # a paragraph each
        app.command(function.__name__, cls=_Command, help=sentences, epilog=shown)(function)
        return function

    return add


def _print_version(context: typer.Context, wanted: bool) -> bool:
    if wanted:
        lines = surroundings() if context.params.get("verbose") else []
        print("\n".join([f"jaxvision {__version__}", *lines]))
        raise typer.Exit
    return wanted


def surroundings() -> list[str]:
    """Return, one per line, the versions and settings on which results depend besides the package
    itself: Python, the dependencies, the folder of compiled programs, and the devices."""
    import platform

    import jax

    lines = [f"Python {platform.python_version()} on {platform.platform()}"]
    for requirement in metadata.requires(DISTRIBUTION) or ():
        name = re.match(r"[\w.-]+", requirement)
        try:
            lines.append(f"{name[0]} {metadata.version(name[0])}" if name else "")
        except metadata.PackageNotFoundError:  # a package of an extra that is not installed
            continue
    unique = [*dict.fromkeys(lines)]
    devices = ", ".join(str(device) for device in jax.devices())
    return [*unique, f"Compiled programs: {program_folder() or 'not kept'}", f"Devices: {devices}"]


def say_what_is_done() -> None:
    """Print the package's log and each program that JAX compiles on standard error, with the
    seconds since the start."""
    handler = logging.StreamHandler()
    handler.setFormatter(_Elapsed("%(message)s"))
    own = logging.getLogger("jaxvision")
    own.setLevel(logging.INFO)
    own.addHandler(handler)
    import jax  # its own handlers would print thousands of lines

    of_jax = logging.getLogger(jax.__name__)
    of_jax.setLevel(logging.DEBUG)
    of_jax.propagate = False
    of_jax.handlers = [handler]
    handler.addFilter(
        lambda record: (
            record.name.startswith("jaxvision")
            or record.levelno >= logging.WARNING
            or record.getMessage().startswith("Finished XLA")
        )
    )


class _Elapsed(logging.Formatter):
    """Prefixes log messages with the seconds since the `logging` module was loaded."""

    def format(self, record: logging.LogRecord) -> str:
        return f"{record.relativeCreated / 1e3:7.2f} s  {super().format(record)}"


@contextmanager
def failures_as_sentences(command: str, *, interrupted: str = "interrupted.") -> Iterator[None]:
    """Run the body of a `with` block so that an error in the user's input ends the command with one
    line on standard error, which begins with the name of the command. The exit status is 2 for
    wrong input and for files that cannot be read or written, 130 for an interrupt, and 141, without
    a message, if the reader of the output has closed it. A warning is also printed as one line. If
    several files cause the same warning, the warning is printed once, with the number of further
    files."""
    say_if_interrupted(interrupted)
    alike: Counter[str] = Counter()

    def one_line(message: Warning | str, *_: Any) -> None:
        about = str(message).partition(": ")[2] or str(message)  # the message begins with the file
        alike[about] += 1
        if alike[about] == 1:
            print(f"{command}: {message}", file=sys.stderr)

    try:
        with warnings.catch_warnings():
            # NumPy's warnings, whose cause a finding describes
            warnings.simplefilter("ignore", RuntimeWarning)
            warnings.showwarning = one_line
            try:
                yield
            finally:
                for about, times in alike.items():
                    if times > 1:
                        print(f"{command}: {times - 1} more files: {about}", file=sys.stderr)
    except InputError as error:
        leave(command, str(error), 2)
    except BrokenPipeError:  # the reader of the output, such as `head`, has stopped reading
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise typer.Exit(UNREAD) from None
    except OSError as error:
        where = error.filename or "a file"
        leave(command, f"{where}: {unwritable(error)}.", 2)
    except KeyboardInterrupt as interrupt:
        mark_reported()
        leave(command, str(interrupt) or interrupted, INTERRUPTED)


def print_table(title: str, records: Sequence[Any]) -> None:
    """Print dataclass records of one type as tables: one row for each numeric field, one column for
    each record, headed by its `name`. A table has at most four records side by side."""
    from rich.console import Console
    from rich.table import Table

    width = None if sys.stdout.isatty() else PLAIN_WIDTH
    console = Console(width=width, highlight=False)
    for first in range(0, len(records), _SIDE_BY_SIDE):
        shown = [asdict(record) for record in records[first : first + _SIDE_BY_SIDE]]
        table = Table(title=title if first == 0 else None, title_justify="left", title_style="bold")
        table.add_column("")
        for record in shown:
            table.add_column(record["name"], justify="right", no_wrap=True)
        for field in shown[0]:
            if field != "name":
                cells = (record[field] for record in shown)
                table.add_row(
                    field.replace("_", " "),
                    *(f"{cell:.6g}" if isinstance(cell, float) else str(cell) for cell in cells),
                )
        console.print(table)


def leave(command: str, sentence: str, status: int) -> NoReturn:
    """Print one line with the command's name and the error message on standard error, and exit with
    the given status."""
    print(f"{command}: {sentence}", file=sys.stderr)
    raise typer.Exit(status)
