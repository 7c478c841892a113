"""The curves of several settings in sequence."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

from ..core.interrupts import is_handled, raised_interrupts
from ..errors import InputError
from .curves import LEAST
from .records import Curve
from .session import Clock

WORTH = 1.5  # times its share, for a knob to be measured again
KEPT = 0.5  # the same of a problem that keeps its programs


def asked_knobs(of: str, names: Sequence[str] | None, known: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the requested settings, or of all known ones. An unknown name raises
    `InputError`, whose message begins with the subject of the measurement."""
    for name in names or ():
        if name not in known:
            words = ", ".join(repr(one) for one in known)
            raise InputError(f"{of}: knob {name!r} changes nothing here; use {words}.")
    return tuple(names or known)


def measure_in_turn(
    names: Sequence[str],
    measure: Callable[[str, float], Curve],
    *,
    seconds: float,
    worth: float = WORTH,
    clock: Clock | None = None,
) -> tuple[Curve, ...]:
    """Measure the curves of settings with equal shares of the given s by `measure(name, share)`,
    then again those with the fewest values while `worth` shares remain; an interrupt keeps the
    finished curves."""
    now = clock or time.perf_counter
    until = now() + seconds
    found: list[Curve] = []
    shares: list[float] = []

    def measured(name: str, share: float) -> Curve | None:
        """The measured curves; None if an interrupt came before the first."""
        try:
            with raised_interrupts():
                return measure(name, max(share, LEAST))
        except KeyboardInterrupt:
            if not found:
                raise
            is_handled()
            return None

    for number, name in enumerate(names):
        shares.append(max(until - now(), 0.0) / (len(names) - number))
        one = measured(name, shares[-1])
        found.append(one or replace(found.pop(), stopped="interrupted"))
        if found[-1].stopped == "interrupted":
            return tuple(found)
    for number in sorted(range(len(found)), key=lambda n: len(found[n].trials)):
        left, before = until - now(), found[number]
        if before.stopped != "out of time" or left < worth * shares[number]:
            continue
        again = measured(names[number], left)
        if again is None or len(again.trials) >= len(before.trials):
            found[number] = again or replace(before, stopped="interrupted")
        if again is None or again.stopped == "interrupted":
            break
    return tuple(found)
