"""One call of every public function, for the sweep in `test_api`: {room.function: (arguments,
options)}. One file a room; arguments are arrays or records, never Python numbers.

A file runs JAX when it is imported, so a test imports it, and collecting tests does not.
"""

import importlib
import pkgutil

HELPERS = {"random_sensors"}  # draw records for tests of their own
ROOMS = sorted({name for _, name, _ in pkgutil.iter_modules(__path__)} - HELPERS)


def examples_of(room: str) -> dict[str, tuple[tuple, dict]]:
    """The calls of one file of this folder."""
    return importlib.import_module(f"{__name__}.{room}").EXAMPLES
