"""Run and time a problem within a time budget, the cheapest settings first. The time of each
setting is predicted from the growth of compile and run times over the settings before. A call that
exceeds the remaining time by more than a twentieth of the budget is abandoned."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import jax
import numpy as np

from ..errors import InputError
from .deadlines import OutOfTime, run_within, something_left_behind, wait_for_the_rest
from .fitted import is_number
from .records import Compute, Knob, Problem

Clock = Callable[[], float]
WAIT = 0.25  # share of the remaining time to wait for abandoned work
GRACE = 0.05  # share of the budget by which a call may exceed it before it is abandoned
STEEPEST = 4.0  # largest assumed power of a cost as a function of a setting
ONE_STEP = 4.0  # growth of the compile time between two settings that is accepted without a third
UNKNOWN = 2.0  # smallest growth between successive settings that are not increasing numbers


class NotComparable(InputError):
    """Raised if results cannot be compared, for example because their shapes differ."""


@dataclass
class Point:
    """The results and times of all calls of one setting."""

    setting: Any
    compute: Compute | None = None  # from a seed to a result; None before the first call
    first: float = 0.0  # s, of the first call
    warm: list[float] = field(default_factory=list)  # s, of each later one
    results: dict[int, np.ndarray] = field(default_factory=dict)  # by seed, float64
    rounding: float = 0.0  # relative rounding error of the dtype of the results
    once: float = 0.0  # s of a call that do not grow from the part to the whole
    beside: bool = False  # whether abandoned work was still running during a call

    @property
    def seconds(self) -> float:
        """The median time of the warm calls, in s, or the time of the first call if there is no
        other."""
        return float(np.median(self.warm)) if self.warm else self.first


class Session:
    """Runs and times the settings of one knob on one problem, and counts the remaining time."""

    def __init__(
        self, problem: Problem, knob: Knob, seconds: float, clock: Clock | None = None
    ) -> None:
        self.problem, self.knob, self.seconds = problem, knob, seconds
        self.clock = clock or time.perf_counter
        self.begun = self.clock()
        self.points: dict[Any, Point] = {}
        self.refused: dict[Any, Exception] = {}
        self.given_up = ""

    @property
    def elapsed(self) -> float:
        """The time since the session began, in s."""
        return self.clock() - self.begun

    @property
    def remaining(self) -> float:
        """The remaining time of the budget, in s."""
        return self.seconds - self.elapsed

    def wait_for_the_rest(self) -> None:
        """Wait for abandoned work to end, because timings taken while it runs would be too long."""
        until = self.elapsed + WAIT * self.remaining
        wait_for_the_rest(lambda: until - self.elapsed)

    def call(self, setting: Any, seed: int, *, within: float = np.inf) -> Point:
        """Run a setting once with a seed, and return the calls of that setting so far. Raise
        `OutOfTime` if the call takes longer than `within` s or the remaining time."""
        begun, beside = self.clock(), something_left_behind()
        point = self.points.get(setting) or Point(setting)

        def run() -> tuple[Compute, np.ndarray, float, float]:
            start = self.clock()
            compute = point.compute
            if compute is None:
                settings: Mapping[str, Any] = {**self.problem.settings, self.knob.name: setting}
                own = self.problem.alone.get(self.knob.name, self.problem.prepare)
                compute = own(settings)
            result = jax.block_until_ready(compute(seed))
            taken = self.clock() - start
            return compute, self._array(setting, result), taken, self.problem.once()

        def remaining_time() -> float:
            spent = self.clock() - begun
            return min(self.remaining + GRACE * self.seconds, within - spent)

        try:
            compute, values, taken, once = run_within(run, remaining_time)
        except OutOfTime:
            self.given_up = f" ({setting} was given up after {self.clock() - begun:.3g} s)"
            raise
        self._check(setting, values)
        self.points[setting] = point
        if point.compute is None:
            point.compute, point.first = compute, taken
        else:
            point.warm.append(taken)
        point.once, point.beside = once, point.beside or beside
        floating = np.issubdtype(values.dtype, np.floating)
        point.rounding = float(np.finfo(values.dtype).eps) if floating else 0.0
        point.results[seed] = values.astype(np.float64)
        return point

    def compared(self, values: Any) -> np.ndarray:
        """Return the quantity of a result, or of a mean, that is compared."""
        return self.problem.compared(values) if self.problem.compared else np.asarray(values)

    def _label(self, setting: Any) -> str:
        return f"{self.problem.name}: the result of {self.knob.name} {setting}"

    def _array(self, setting: Any, result: Any) -> np.ndarray:
        try:
            return np.asarray(result)
        except ValueError:
            raise NotComparable(f"{self._label(setting)} is no array; give real numbers.") from None

    def _check(self, setting: Any, values: np.ndarray) -> None:
        """Raise `NotComparable` unless the result is an array of real numbers of the same shape as
        the other results, and `InputError` if a number is not finite.
        """
        of = self._label(setting)
        if values.dtype.kind not in "biuf":
            raise NotComparable(f"{of} is {values.dtype}; give real numbers.")
        if values.size == 0:
            raise NotComparable(f"{of} is empty; give at least one number.")
        if lost := int(np.sum(~np.isfinite(values))):
            raise InputError(
                f"{of} is not finite in {lost} of {values.size} numbers, so that no error is known."
            )
        shapes = {one.shape for p in self.points.values() for one in p.results.values()}
        if shapes and values.shape not in shapes:
            raise NotComparable(
                f"{of} has shape {values.shape}, that of others {shapes.pop()}; give arrays that "
                "can be compared."
            )

    def refuse(self, setting: Any, why: Exception) -> None:
        """Skip a setting that the problem cannot compute. If results cannot be compared, or if the
        first setting fails with another error than `InputError`, raise the error again."""
        self.points.pop(setting, None)
        if isinstance(why, NotComparable) or not (self.points or isinstance(why, InputError)):
            raise why
        self.refused[setting] = why

    @property
    def refusal(self) -> str:
        """A note about the first skipped setting and its reason; "" if none was skipped."""
        for setting, why in self.refused.items():
            words = str(why).strip().split("\n")[0].rstrip(".")
            kind = "" if isinstance(why, InputError) else f"{type(why).__name__}: "
            return f"{setting} refused ({kind}{words})"
        return ""

    def expected(self, setting: Any, *, calls: int) -> float:
        """Predict the time of a further call of a setting, s. For a new setting the prediction uses
        the settings before."""
        known = self.points.get(setting)
        if known is not None and known.compute is not None:
            return calls * known.seconds
        before = list(self.points.values())
        compiling = 0.0
        if not self.is_compiled(setting):
            apart = [(p.setting, max(p.first - p.seconds, 0.0)) for p in before]
            if len(apart) == 2:  # a cached or shared program does not show growth
                apart[0] = apart[0][0], max(apart[0][1], apart[1][1] / ONE_STEP)
            compiling = max(self.problem.compiling, _next(apart, setting, 0.0))
        running = _next([(p.setting, p.seconds) for p in before], setting, 1.0)
        return compiling + calls * running

    def is_compiled(self, setting: Any) -> bool:
        """Return whether this setting certainly runs without another compilation."""
        settings = {**self.problem.settings, self.knob.name: setting}
        return self.problem.compiled is not None and self.problem.compiled(settings)


def whole_seconds(problem: Problem, seconds: Any, once: float) -> Any:
    """Return the time of the whole computation, in s, from the time of a call of the measured part.
    `once` is the part of a call, in s, that the whole computation needs only once."""
    return once + problem.whole * np.maximum(seconds - once, 0.0)


def part_seconds(problem: Problem, seconds: float) -> float:
    """Return the time of a call of the measured part, s, from the time of the whole."""
    once = min(problem.once(), seconds)
    return once + (seconds - once) / problem.whole


def _next(before: Sequence[tuple[Any, float]], setting: Any, power: float) -> float:
    """Predict the time of the next setting, in s, from the times of earlier settings (setting, s).
    The smaller growth of the last two steps is extrapolated both as a power of the setting and as a
    constant factor per step. The larger prediction is returned."""
    if not before:
        return 0.0
    last, taken = before[-1]
    steps = [_growth(*step) for step in pairwise(before[-3:]) if step[0][1] > 0]
    factor = min((factor for factor, _ in steps), default=1.0)
    power = min((power for _, power in steps), default=power)
    ratio = _ratio(last, setting)
    if ratio is None:
        return taken * max(factor, UNKNOWN if power else 1.0)
    return taken * max(factor, ratio ** min(power, STEEPEST))


def _growth(before: tuple[Any, float], after: tuple[Any, float]) -> tuple[float, float]:
    """Return the growth of time between settings: as a factor >= 1, and as a power >= 0."""
    factor = max(after[1] / before[1], 1.0)
    ratio = _ratio(before[0], after[0])
    return factor, float(np.log(factor) / np.log(ratio)) if ratio else 1.0


def _ratio(before: Any, after: Any) -> float | None:
    """Return the ratio of two increasing positive settings, or None for others."""
    if is_number(before) and is_number(after) and after > before:
        return after / before
    return None
