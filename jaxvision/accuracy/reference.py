"""What errors are measured against, made apart from what is measured, and how far it may itself be
off: by other seeds where a knob is random, by ever finer settings where it is not."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from .deadlines import OutOfTime
from .records import Reference
from .session import Session

DRAWS = 4  # independent ones that a random reference is the mean of, at least
MOST_DRAWS = 16
SHARE = 0.6  # of the time that is left
LATEST = 0.9  # of the time that is left, after which a reference is given up
FIRST_SEED = 1_000_000  # of references; trials have smaller seeds
PAIRED = (0, 1)  # seeds with which settings of a bias are compared with each other
UNITS = 4  # in the last place, to which no sum is right
MOST_TAIL = 3.0  # of the last step between two settings, for the rest of the sequence


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def random_reference(session: Session) -> tuple[Reference, np.ndarray]:
    """The mean of independent draws of the finest setting that time allows; its error, in the unit
    of the result, is the scatter of the draws over the root of their number."""
    setting, run = _finest(session, calls=DRAWS), tuple(session.points)
    try:
        draws = _drawn(session, setting)
    except OutOfTime:
        if setting not in run:
            session.points.pop(setting, None)
        coarser = run[: run.index(setting)] if setting in run else run
        if not coarser:
            raise
        setting = coarser[-1]
        draws = _drawn(session, setting)
    mean = np.mean(draws, axis=0)
    scatter = np.sqrt(np.mean(np.var(draws, axis=0, ddof=1)))
    return Reference(setting, float(scatter) / len(draws) ** 0.5, "other seeds"), mean


def _drawn(session: Session, setting: Any) -> list[np.ndarray]:
    """Independent draws of a setting, as many as are worth their time; what was foreseen wrongly
    leaves something for a coarser one."""
    draws: list[np.ndarray] = []
    until = session.taken + SHARE * max(session.left, 0.0)
    latest = session.taken + LATEST * session.left
    while len(draws) < MOST_DRAWS:
        if len(draws) >= DRAWS and session.taken + session.expected(setting, calls=1) > until:
            break
        seed = FIRST_SEED + len(draws)
        try:
            point = session.call(setting, seed, within=latest - session.taken)
        except OutOfTime:
            if len(draws) < DRAWS:
                raise
            break
        draws.append(point.results.pop(seed))
    return draws


def paired_reference(session: Session) -> tuple[Reference, dict[int, np.ndarray]]:
    """The finest setting that time allows, by the same seeds as the trials. What it is still off by
    follows from the steps between it and the two settings before it."""
    knob = session.knob
    exact = bool(knob.reference) and not isinstance(knob.reference[-1], int | float)
    steps: list[Any] = list(session.points)[-2:]
    chosen = list(session.points)[-1]
    for setting in knob.reference:
        if session.expected(setting, calls=len(PAIRED)) > SHARE * session.left:
            break
        try:
            for seed in PAIRED:
                session.call(setting, seed)
        except OutOfTime:
            session.points.pop(setting, None)
            break
        steps = [step for step in steps if step != setting] + [setting]
        chosen = setting
    found = {seed: session.points[chosen].results[seed] for seed in PAIRED}
    rounding = UNITS * session.points[chosen].rounding * _rms(found[PAIRED[0]])
    if exact and chosen == knob.reference[-1]:
        return Reference(chosen, rounding, "exact setting"), found
    ladder = [session.points[step].results for step in steps[-3:]]
    how = "twice as fine" if chosen in knob.reference else "finest setting"
    return Reference(chosen, max(_tail(ladder), rounding), how), found


def _finest(session: Session, *, calls: int) -> Any:
    """The finest setting, of those that were run and those of the reference, whose calls fit; else
    the cheapest."""
    chosen = next(iter(session.points))
    for setting in (*session.points, *session.knob.reference):
        if session.expected(setting, calls=calls) <= SHARE * session.left:
            chosen = setting
    return chosen


def _tail(ladder: Sequence[dict[int, np.ndarray]]) -> float:
    """What the last of a sequence is off by: the sum of the steps to come, if each is to the one
    before as the last two are."""
    if len(ladder) < 2:
        return float("inf")
    steps = [
        _rms(np.mean([after[s] - before[s] for s in PAIRED], axis=0))
        for before, after in pairwise(ladder)
    ]
    if len(steps) < 2 or steps[0] == 0:
        return steps[-1]
    ratio = steps[1] / steps[0]
    return steps[1] * (min(ratio / (1 - ratio), MOST_TAIL) if ratio < 1 else MOST_TAIL)
