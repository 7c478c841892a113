"""What was measured, on the terminal and in a folder."""

import json
import os
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from ..errors import InputError
from .pages import write_page
from .records import Curve, Problem
from .scene_settings import machine
from .tables import as_dict, notes, rows

_OF_PAGES = ("jinja2", "matplotlib.backends.backend_svg", "matplotlib.figure")


def check_request(seconds: float, out: Path | None) -> None:
    """Checks the options that all measuring commands share. What draws a page is imported here,
    since an interrupted run still writes one and has little time for it.

    Args:
        seconds: s, to measure in.
        out: folder of the page, or None.

    Raises:
        InputError: for no time, a file where a folder is to be, and one that cannot be written.
    """
    if not seconds > 0:
        raise InputError(f"--seconds {seconds:g}: give a time above 0.")
    if out is not None and out.exists() and not out.is_dir():
        raise InputError(f"{out}: is a file; give --out a folder.")
    if out is not None:
        there = next(place for place in (out, *out.absolute().parents) if place.exists())
        if not os.access(there, os.W_OK | os.X_OK):
            raise InputError(f"{there}: cannot be written; give --out another folder.")
        for module in _OF_PAGES:
            import_module(module)


def show(
    problem: Problem,
    curves: Sequence[Curve],
    *,
    command: str,
    out: Path | None = None,
    as_json: bool = False,
) -> None:
    """Prints the table, or JSON, at once, and then writes the page.

    Args:
        problem: whose knobs they are.
        curves: of the knobs, error against time in s.
        command: by which it can be repeated.
        out: folder of the page, or None.
        as_json: whether to print JSON instead of the table.

    Raises:
        InputError: where time was too short for any setting of any knob.
    """
    if not any(curve.trials for curve in curves):
        raise InputError(
            f"{problem.name}: {curves[0].stopped} before anything was measured; allow more "
            "--seconds."
        )
    if as_json:
        sheet = as_dict(problem, curves, machine=machine(), command=command)
        print(json.dumps(sheet, indent=2, ensure_ascii=False, allow_nan=False), flush=True)
    else:
        print(f"{problem.name}; {machine()}")
        print(in_columns(rows(problem, curves)))
        print("\n".join(notes(curves)), flush=True)
    if out is None:
        return
    for path in write_page(out, problem, curves, command=command):
        if not as_json:
            print(f"Written: {path}", flush=True)


def in_columns(rows: Sequence[tuple[str, ...]]) -> str:
    """Rows of cells as lines, columns below each other.

    Args:
        rows: of text, equally long.

    Returns:
        Lines; no unit.
    """
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    )
