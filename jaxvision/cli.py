"""The `jaxvision` command: looking at image files.

Bad input ends with one sentence on standard error and exit status 2; an interrupt with status 130.
"""

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, NoReturn

import jax
import typer

from .errors import InputError

FIGURE_SUFFIXES = (".png", ".pdf", ".svg")
PLAIN_WIDTH = 140  # columns where the output is no terminal and so has no width of its own

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Photometric image formation: look at images as numbers.",
)


@app.callback()
def commands() -> None:
    """Keeps `inspect` a sub-command while it is the only one."""


@app.command()
def inspect(
    file: Annotated[Path, typer.Argument(help="PNG, TIFF, EXR, HDR or NPY image.", metavar="FILE")],
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Draw the figure to this PNG, PDF or SVG.", metavar="FIGURE"),
    ] = None,
    row: Annotated[
        int | None, typer.Option("--row", help="Row of the scan line (default: that of --at).")
    ] = None,
    at: Annotated[
        str, typer.Option("--at", help="Pixel to print (default: the middle).", metavar="ROW,COL")
    ] = "",
    white: Annotated[
        float | None,
        typer.Option("--white", help="Value of saturation (default: top code; 1 if floating)."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """Range, moments and saturation of each channel; with --out the picture, histograms, a scan
    line, a grid of values and the surface as one figure."""
    with failures_as_sentences("jaxvision"):
        _inspect(file, out, row, at, white, as_json)


def _inspect(
    file: Path, out: Path | None, row: int | None, at: str, white: float | None, as_json: bool
) -> None:
    from . import plots
    from .io import read_image, replaced_on_success

    pixel = _pixel(at)
    if out is not None and out.suffix.lower() not in FIGURE_SUFFIXES:
        known = ", ".join(FIGURE_SUFFIXES)
        raise InputError(f"{out}: unknown figure suffix {out.suffix!r}; use one of {known}.")
    image = read_image(file)
    try:
        bands = plots.summarise(image, white=white)
        figure = plots.inspect(image, row=row, at=pixel, white=white, title=file.name)
    except InputError as error:
        raise InputError(f"{file}: {error}") from error
    if out is not None:
        with replaced_on_success(out) as partial:
            figure.savefig(partial, dpi=130)
    if as_json:
        sheet = {
            "file": str(file),
            "shape": image.shape,
            "dtype": str(image.dtype),
            "bands": [_finite_or_null(asdict(band)) for band in bands],
        }
        print(json.dumps(sheet, indent=2, allow_nan=False))
        return
    _print_table(f"{file.name}: {' × '.join(map(str, image.shape))}, {image.dtype}", bands)
    if out is not None:
        print(f"Figure: {out}")


def _pixel(at: str) -> tuple[int, int] | None:
    if not at:
        return None
    try:
        row, column = (int(part) for part in at.split(","))
    except ValueError:
        raise InputError(f"--at {at}: give a row and a column, as in --at 120,80.") from None
    return row, column


def _finite_or_null(values: dict[str, Any]) -> dict[str, Any]:
    """JSON has no NaN."""
    return {name: None if value != value else value for name, value in values.items()}


def _print_table(title: str, bands: Any) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold")
    for name in asdict(bands[0]):
        table.add_column(name.replace("_", " "), justify="left" if name == "name" else "right")
    for band in bands:
        cells = asdict(band).values()
        table.add_row(*(f"{cell:.6g}" if isinstance(cell, float) else str(cell) for cell in cells))
    width = None if sys.stdout.isatty() else PLAIN_WIDTH
    Console(width=width, highlight=False).print(table)


@contextmanager
def failures_as_sentences(command: str) -> Iterator[None]:
    """Turns what a user can put right into one line on standard error and an exit status."""
    try:
        yield
    except InputError as error:
        _leave(command, str(error), 2)
    except OSError as error:
        where = error.filename or "a file"
        _leave(command, f"{where}: {error.strerror or error}; choose another path.", 2)
    except KeyboardInterrupt:
        _leave(command, "interrupted.", 130)


def _leave(command: str, sentence: str, status: int) -> NoReturn:
    print(f"{command}: {sentence}", file=sys.stderr)
    raise typer.Exit(status)


def main() -> None:
    """Entry point. Histograms of 16-bit and floating images want double precision, so it is
    switched on here, never on import."""
    jax.config.update("jax_enable_x64", True)
    app()
