"""The curves of several knobs, one after another."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

from ..errors import InputError
from ..interrupts import is_handled, raised_interrupts
from .curves import LEAST
from .records import Curve
from .session import Clock


def asked_knobs(of: str, names: Sequence[str] | None, known: Sequence[str]) -> tuple[str, ...]:
    """The knobs to turn, by the names that a user gives.

    Args:
        of: what is measured, the beginning of a complaint.
        names: those asked for; None: all.
        known: those that change it.

    Returns:
        Names of knobs.

    Raises:
        InputError: for one that is not known.
    """
    for name in names or ():
        if name not in known:
            words = ", ".join(repr(one) for one in known)
            raise InputError(f"{of}: knob {name!r} changes nothing here; use {words}.")
    return tuple(names or known)


def in_turn(
    names: Sequence[str],
    measure: Callable[[str, float], Curve],
    *,
    seconds: float,
    clock: Clock | None = None,
) -> tuple[Curve, ...]:
    """The curves of several knobs, the time shared equally; an interrupt keeps those there are.

    Args:
        names: of the knobs.
        measure: from a name and its share of the time, s, to the curve.
        seconds: s, for all.
        clock: seconds as a function; None: the machine's.

    Returns:
        The curves.
    """
    now = clock or time.perf_counter
    until = now() + seconds
    found: list[Curve] = []
    for number, name in enumerate(names):
        left = max(until - now(), 0.0) / (len(names) - number)
        try:
            with raised_interrupts():
                found.append(measure(name, max(left, LEAST)))
        except KeyboardInterrupt:  # before anything of this knob was measured
            if not found:
                raise
            is_handled()
            found[-1] = replace(found[-1], stopped="interrupted")
        if found[-1].stopped == "interrupted":
            break
    return tuple(found)
