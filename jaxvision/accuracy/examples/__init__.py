"""A small example problem for each knob that scene files do not set. Each problem takes seconds.

- `light` has problems of light transport, area lights, sampling tables and spectra.
- `cameras` has problems of lenses, motion, pixel apertures, diffraction and shot noise.
- `pictures` has problems of image filters, mattes and interpolated curves.
"""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

from ...errors import InputError, nearest
from ..records import Compute, Problem

ROOMS = ("light", "cameras", "pictures")


def examples() -> dict[str, Callable[[], Problem]]:
    """Return, for each knob by name, a function that makes the example problem of that knob."""
    found: dict[str, Callable[[], Problem]] = {}
    for room in ROOMS:
        found |= import_module(f"{__name__}.{room}").EXAMPLES
    return found


def problem_of(
    name: str,
    knob: str,
    make: Callable[[Any], Callable[..., Any]],
    *given: Any,
    seeded: bool = False,
    exact: Any = None,
) -> Problem:
    """Make a problem that calls the compiled `make(setting)`, with a key if `seeded`."""
    import jax

    def prepare(settings: Mapping[str, Any]) -> Compute:
        run = jax.jit(make(settings[knob]))
        return lambda seed: run(*([jax.random.key(seed)] if seeded else given))

    return Problem(name, prepare, exact=exact)


def example(knob: str) -> Problem:
    """Make the example problem on which a knob is measured if no scene file is given.

    Args:
        knob: name of the knob, one of `KNOBS`.

    Returns:
        The problem; errors are relative, times in s.

    Raises:
        InputError: for a knob without an example.
    """
    known = examples()
    if knob not in known:
        raise InputError(f"knob {knob!r} has no example of its own; {nearest(knob, known)}.")
    return known[knob]()
