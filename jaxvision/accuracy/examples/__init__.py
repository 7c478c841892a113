"""A small problem for each setting that no scene file has. Each takes seconds.

light      roulette, strategies, form factors, adaptive nodes, tables of directions, spectra
cameras    lens, motion, pixel aperture, diffraction, shot noise
pictures   filters, mattes, curves
"""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

from ...errors import InputError, nearest
from ..records import Compute, Problem

ROOMS = ("light", "cameras", "pictures")


def examples() -> dict[str, Callable[[], Problem]]:
    """Functions without arguments that make the problems, by setting."""
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
    """The problem whose result is that of `make(setting)`, compiled, for the given arrays, or for a
    random key if `seeded`."""
    import jax

    def prepare(settings: Mapping[str, Any]) -> Compute:
        run = jax.jit(make(settings[knob]))
        return lambda seed: run(*([jax.random.key(seed)] if seeded else given))

    return Problem(name, prepare, exact=exact)


def example(knob: str) -> Problem:
    """The problem on which a setting is measured when there is no scene file.

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
