"""Output of the accuracy measurements: tables and JSON on the terminal, pages in a folder."""

import json
import os
import shlex
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from ..core._shown import aligned_columns
from ..errors import InputError
from .pages import write_page
from .records import Curve, Problem
from .scene_settings import machine
from .several import Together
from .tables import json_sheet, notes, rows

_OF_PAGES = ("jinja2", "matplotlib.backends.backend_svg", "matplotlib.figure")


def check_request(seconds: float, out: Path | None) -> None:
    """Raise `InputError` if a measuring command has no time budget, in s, or cannot write the HTML
    page of its results. The plotting modules are imported here, before the measurement, because
    there is little time to import them after an interrupt."""
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


def repeating(
    command: str, what: object, *, knobs: Sequence[str], seconds: float, out: Path | None
) -> str:
    """Return the command that repeats a measurement, of all settings if `knobs` is empty."""
    words = [*command.split(), str(what)]
    for knob in knobs:
        words += ["--knob", knob]
    words += ["--seconds", f"{seconds:g}"]
    return shlex.join(words if out is None else [*words, "--out", str(out)])


def show(
    problem: Problem,
    curves: Sequence[Curve],
    *,
    together: Sequence[Together] = (),
    command: str,
    as_json: bool = False,
) -> dict[str, Any]:
    """Print curves as a table or JSON; return them as JSON, or refuse if nothing was measured."""
    if not any(curve.trials for curve in curves):
        raise InputError(
            f"{problem.name}: {curves[0].stopped} before anything was measured; allow more "
            "--seconds."
        )
    if not as_json:
        print(f"{problem.name}; {machine()}", problem.about, sep="\n")
        print(aligned_columns(rows(problem, curves, together=together)))
        print("\n".join(notes(curves, together=together)), flush=True)
    return json_sheet(problem, curves, together=together, machine=machine(), command=command)


def keep(
    out: Path | None,
    problem: Problem,
    curves: Sequence[Curve],
    *,
    together: Sequence[Together] = (),
    command: str,
    as_json: bool = False,
) -> None:
    """Write page and JSON of the curves if a folder is given, and print their paths."""
    if out is None:
        return
    for path in write_page(out, problem, curves, command=command, together=together):
        if not as_json:
            print(f"Written: {path}", flush=True)


def print_json(sheet: Mapping[str, Any]) -> None:
    """Print one JSON document."""
    print(json.dumps(sheet, indent=2, ensure_ascii=False, allow_nan=False), flush=True)
