"""One call of every public function, for the sweep in `test_api`: {room.function: (arguments,
options)}. One file a room; arguments are arrays or records, never Python numbers."""

import importlib
import pkgutil


def every_example() -> dict[str, tuple[tuple, dict]]:
    """The `EXAMPLES` of all files of this folder in one table."""
    table: dict[str, tuple[tuple, dict]] = {}
    for _, name, _ in pkgutil.iter_modules(__path__):
        room = importlib.import_module(f"{__name__}.{name}")
        table |= getattr(room, "EXAMPLES", {})
    return table
