"""The registry of rounding errors: each public function of numbers with an oracle, and for all
other functions their kind and the tests that check them."""

import importlib
import pkgutil

from .entry import Entry

NOT_ROOMS = {"composed", "elsewhere", "entry"}
ROOMS = sorted({name for _, name, _ in pkgutil.iter_modules(__path__)} - NOT_ROOMS)


def entries_of(room: str) -> list[Entry]:
    """Return the rows of one file of this folder."""
    return importlib.import_module(f"{__name__}.{room}").ENTRIES


def every_entry() -> list[Entry]:
    return [entry for room in ROOMS for entry in entries_of(room)]
