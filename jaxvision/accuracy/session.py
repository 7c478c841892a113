"""Calls of a problem, timed: cheapest settings first, within a budget, with an estimate of what the
next one will take."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np

from ..errors import InputError
from .records import Compute, Knob, Problem

Clock = Callable[[], float]
STEEPEST = 3.0  # no cost grows faster than this power of a setting


@dataclass
class Point:
    """The calls of one setting.

    Attributes:
        setting: the setting.
        compute: from a seed to a result; None before the first call.
        first: s, of the first call.
        warm: s, of each later one.
        results: by seed, float64.
        rounding: no unit, of the format that the results came in.
    """

    setting: Any
    compute: Compute | None = None
    first: float = 0.0
    warm: list[float] = field(default_factory=list)
    results: dict[int, np.ndarray] = field(default_factory=dict)
    rounding: float = 0.0

    @property
    def seconds(self) -> float:
        """Of a warm call, s; of the first one where there is no other."""
        return float(np.median(self.warm)) if self.warm else self.first


class Session:
    """One problem, one knob, and the time that is left for them."""

    def __init__(
        self, problem: Problem, knob: Knob, seconds: float, clock: Clock | None = None
    ) -> None:
        self.problem, self.knob, self.seconds = problem, knob, seconds
        self.clock = clock or time.perf_counter
        self.begun = self.clock()
        self.points: dict[Any, Point] = {}
        self.refused: dict[Any, InputError] = {}

    @property
    def taken(self) -> float:
        """s since the beginning."""
        return self.clock() - self.begun

    @property
    def left(self) -> float:
        """s until the budget is used up."""
        return self.seconds - self.taken

    def call(self, setting: Any, seed: int) -> Point:
        """Runs a setting once more, and keeps time and result."""
        point = self.points.setdefault(setting, Point(setting))
        start = self.clock()
        if point.compute is None:
            settings: Mapping[str, Any] = {**self.problem.settings, self.knob.name: setting}
            point.compute = self.problem.prepare(settings)
            result = jax.block_until_ready(point.compute(seed))
            point.first = self.clock() - start
        else:
            result = jax.block_until_ready(point.compute(seed))
            point.warm.append(self.clock() - start)
        values = np.asarray(result)
        floating = np.issubdtype(values.dtype, np.floating)
        point.rounding = float(np.finfo(values.dtype).eps) if floating else 0.0
        point.results[seed] = values.astype(np.float64)
        return point

    def refuse(self, setting: Any, why: InputError) -> None:
        """Leaves out a setting that the problem cannot be computed with."""
        self.points.pop(setting, None)
        self.refused[setting] = why

    def expected(self, setting: Any, *, calls: int) -> float:
        """s that so many calls of a setting will take, by the power of the settings so far."""
        known = self.points.get(setting)
        if known is not None and known.compute is not None:
            return calls * known.seconds
        before = list(self.points.values())
        compiling = max(self.problem.compiling, *(p.first - p.seconds for p in before), 0.0)
        if self.is_compiled(setting):
            compiling = 0.0
        return compiling + (calls * self._warm(setting, before) if before else 0.0)

    def is_compiled(self, setting: Any) -> bool:
        """Whether the problem says that a setting takes no new program."""
        settings = {**self.problem.settings, self.knob.name: setting}
        return self.problem.compiled is not None and self.problem.compiled(settings)

    def _warm(self, setting: Any, before: list[Point]) -> float:
        last = before[-1]
        if not (_is_positive(setting) and _is_positive(last.setting)):
            return 2 * last.seconds
        power, ratio = 1.0, setting / last.setting
        if len(before) > 1 and _is_positive(before[-2].setting):
            earlier, apart = before[-2], last.setting / before[-2].setting
            if last.seconds > 0 and earlier.seconds > 0 and apart > 1:
                power = float(np.log(last.seconds / earlier.seconds) / np.log(apart))
        if ratio < 1:  # a setting whose cost falls as it grows, such as a tolerance
            return last.seconds * 2
        return last.seconds * ratio ** float(np.clip(power, 0, STEEPEST))


def _is_positive(setting: object) -> bool:
    return isinstance(setting, int | float) and not isinstance(setting, bool) and setting > 0
