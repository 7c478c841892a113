"""All settings of a problem together, for each tolerance of a table: the best combination, checked
by runs with fresh seeds as time allows."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

from ..core.interrupts import is_handled, raised_interrupts
from ..errors import InputError
from ..files.scenes import SceneFile
from .checks import settled
from .knobs_in_turn import asked_knobs
from .records import Curve, Problem
from .scene_settings import measured
from .scenes import APART, knobs_of
from .session import Clock
from .several import Combination, combined

TOLERANCES = (0.1, 0.01, 0.001)
SHARE = 0.25  # of the time to measure in, for the checks


@dataclass(frozen=True)
class Together:
    """The cheapest settings of all knobs within a tolerance."""

    combination: Combination | None  # of the settings; None: no settings are known to be within it
    # whether error and time are those of runs with fresh seeds; else they follow from the curves of
    # single knobs
    checked: bool = False


def turned_together(problem: Problem, curves: Sequence[Curve]) -> list[Curve]:
    """Return the curves of the settings whose value the problem uses while others are measured. The
    result is empty for fewer than two."""
    found = [curve for curve in curves if curve.knob.name in problem.settings]
    return found if len(found) > 1 else []


def all_together(
    problem: Problem,
    curves: Sequence[Curve],
    *,
    seconds: float = 0.0,
    clock: Clock | None = None,
) -> tuple[Together, ...]:
    """Choose the cheapest combination of settings for each of `TOLERANCES`, and check it for the
    given time, s, the widest tolerance first. The result is empty for fewer than two knobs. An
    interrupt ends the checks."""
    known = turned_together(problem, curves)
    if not known:
        return ()
    now = clock or time.perf_counter
    until, found = now() + seconds, list[Together]()
    try:
        with raised_interrupts():
            for tolerance in TOLERANCES:
                left = max(until - now(), 0.0)
                found.append(_within(problem, known, tolerance, found, left, clock))
    except KeyboardInterrupt:
        is_handled()
        for tolerance in TOLERANCES[len(found) :]:
            found.append(_within(problem, known, tolerance, found, 0.0, clock))
    return tuple(found)


def measured_together(
    source: SceneFile,
    *,
    names: Sequence[str] | None = None,
    seconds: float = 60.0,
    metrics: tuple[str, ...] = ("rms", "p99", "max"),
    clock: Clock | None = None,
) -> tuple[Problem, tuple[Curve, ...], tuple[Together, ...]]:
    """The curves of a scene file's settings and, in a quarter of the time, checks of their
    combination.

    Args:
        source: the scene and its view, with its `[render]`.
        names: of the knobs; None for all that change the picture.
        seconds: time budget, s.
        metrics: as in `curve`.
        clock: function that returns seconds; None for the machine's clock.

    Returns:
        The problem, the curves, and the settings for each of `TOLERANCES`.

    Raises:
        InputError: for a knob that the scene file does not have.
    """
    now = clock or time.perf_counter
    until = now() + seconds
    asked = asked_knobs(str(source.path), names, knobs_of(source, source.render))
    several = len(set(asked) - set(APART)) > 1
    problem, curves = measured(
        source,
        source.render,
        names=asked,
        seconds=(1 - SHARE) * seconds if several else seconds,
        metrics=metrics,
        clock=clock,
    )
    ended = any(curve.stopped == "interrupted" for curve in curves)
    left = 0.0 if ended else until - now()
    return problem, curves, all_together(problem, curves, seconds=left, clock=clock)


def _within(
    problem: Problem,
    curves: Sequence[Curve],
    tolerance: float,
    before: Sequence[Together],
    seconds: float,
    clock: Clock | None,
) -> Together:
    try:
        best = combined(curves, problem.settings, tolerance=tolerance)
        for one in before:  # the same settings need no second check
            known = one.combination if one.checked else None
            if known and known.settings == best.settings and known.error <= tolerance:
                return one
        if seconds <= 0:
            return Together(best)
        return Together(*settled(problem, curves, tolerance, None, seconds=seconds, clock=clock))
    except InputError:
        return Together(None)
