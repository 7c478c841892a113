"""The registry of floating-point errors: each public function that computes numbers beside an
oracle, and for each other one what it is and which tests check it."""

import importlib
import pkgutil

from .entry import Entry

NOT_ROOMS = {"composed", "elsewhere", "entry"}
ROOMS = sorted({name for _, name, _ in pkgutil.iter_modules(__path__)} - NOT_ROOMS)


def entries_of(room: str) -> list[Entry]:
    """The rows of one file of this folder."""
    return importlib.import_module(f"{__name__}.{room}").ENTRIES


def every_entry() -> list[Entry]:
    return [entry for room in ROOMS for entry in entries_of(room)]
