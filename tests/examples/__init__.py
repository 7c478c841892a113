"""One call of every public function, for the tests in `test_api`: {module.function: (arguments,
options)}. There is one file per module, and arguments are arrays or records, never Python numbers.

A file runs JAX when it is imported, so tests import it when they run, not when they are
collected."""

import importlib
import pkgutil

HELPERS = {"random_sensors"}  # draw records for tests of their own
ROOMS = sorted({name for _, name, _ in pkgutil.iter_modules(__path__)} - HELPERS)


def examples_of(room: str) -> dict[str, tuple[tuple, dict]]:
    """Return the calls of one file of this folder."""
    return importlib.import_module(f"{__name__}.{room}").EXAMPLES
