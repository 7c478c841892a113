"""Records for the measurement of an approximation: settings, problems, trials and curves."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

Law = Literal["power", "geometric"]
Compute = Callable[[int], Any]
Compared = Callable[[np.ndarray], np.ndarray]
RELATIVE = "relative rms error [%]"


@dataclass(frozen=True)
class Knob:
    """One approximation of the library, and the values that trade its error for time.

    Attributes:
        name: by which it is asked for.
        unit: of a setting.
        about: what it approximates, in a few words.
        settings: cheapest first.
        reference: settings finer than all of those, coarser ones first, of which the finest that
            time allows makes the reference.
        order: the exponent p of error ~ setting^p that theory gives, such as -2 of a midpoint rule;
            None: no law is known.
        law: whether the error is a power of the setting, or falls by a factor with each unit of it.
        random: whether another seed gives another error; else the error is a bias, and results of
            one seed are compared with each other.
        whole: whether any whole number is a setting, not only those listed.
        sets: the public parameters that it stands for, as patterns of `fnmatch` on the names below
            `jaxvision` or `fitting`.
    """

    name: str
    unit: str
    about: str
    settings: tuple[Any, ...]
    reference: tuple[Any, ...]
    order: float | None = None
    law: Law = "power"
    random: bool = False
    whole: bool = False
    sets: tuple[str, ...] = ()


@dataclass(frozen=True)
class Problem:
    """A computation as a function of settings and a seed.

    Attributes:
        name: in tables and plots.
        prepare: from the settings of all knobs by name to a function of a seed; what that returns
            is an array of numbers. It is asked once for each setting, and may compile in its first
            call.
        settings: of the knobs that are not varied.
        exact: the truth, where a closed form is known; None: a reference is made.
        level: what errors are relative to, in the unit of the result; None: the root mean square of
            the reference.
        developed: from a result and the reference, by whose brightness it is exposed, to the Lab of
            the developed picture, (pixels, 3), where there is one.
        whole: seconds of the whole over seconds of a call, for a problem that is a part of another.
        compiled: whether the settings of all knobs take no new program, so that their first call
            takes no longer than others; None: every setting takes its own.
        about: what errors and times are of, in sentences.
        compiling: s that one more program is expected to take, before any was seen to.
        once: s of the last call that the whole takes no longer for, such as what comes before the
            first pixel of a picture.
        error_axis: what errors are, with their unit, as the label of an axis.
        compared: from a result, or the mean of several, to what is compared, such as radiance cut
            at white; None: the result itself.
        alone: by the name of a random knob `prepare` where the seed changes its chance alone, and
            not that of other knobs, which would hide its error.
    """

    name: str
    prepare: Callable[[Mapping[str, Any]], Compute]
    settings: Mapping[str, Any] = field(default_factory=dict)
    exact: Any = None
    level: float | None = None
    developed: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    whole: float = 1.0
    compiled: Callable[[Mapping[str, Any]], bool] | None = None
    compiling: float = 0.0
    once: Callable[[], float] = lambda: 0.0
    about: str = "Errors are root mean squares over the result, relative to that of the result."
    error_axis: str = RELATIVE
    compared: Compared | None = None
    alone: Mapping[str, Callable[[Mapping[str, Any]], Compute]] = field(default_factory=dict)


@dataclass(frozen=True)
class Trial:
    """The measurement of one setting.

    Attributes:
        setting: the setting.
        error: relative, root mean square over seeds, in the first norm that was asked for.
        error_low, error_high: relative; a run with another seed stays between the two in 95 of 100
            cases, and below the upper one in 97.5, whatever the reference is itself off by.
        seconds: median time of a warm call, in s.
        seconds_low, seconds_high: s, its quartiles.
        first_seconds: s, of the first call, with tracing and compilation.
        seeds: with which it was run.
        norms: every norm by name: "rms", "p99" and "max" relative, "delta_e" in units of L*.
        hollow: whether the error is below three times that of the reference: it says little then.
        beside: whether a program that had been given up was still at work meanwhile, so that the
            time is too long.
        measured: False for a setting that was inferred from others by the knob's order.
    """

    setting: Any
    error: float
    error_low: float
    error_high: float
    seconds: float
    seconds_low: float
    seconds_high: float
    first_seconds: float
    seeds: int = 1
    norms: Mapping[str, float] = field(default_factory=dict)
    hollow: bool = False
    beside: bool = False
    measured: bool = True


@dataclass(frozen=True)
class Reference:
    """The reference for errors.

    Attributes:
        setting: that made it; None: a closed form, or the caller's.
        error: relative, its own, estimated; 0 for a closed form, inf where there is no estimate.
        how: "closed form", "given", "other seeds", "twice as fine", "exact setting", "finest
            setting" or "none".
    """

    setting: Any
    error: float
    how: str


@dataclass(frozen=True)
class Order:
    """The law of an error, fitted by least squares to the points that are not hollow.

    Attributes:
        exponent: p of error ~ setting^p; of a geometric law the logarithm of the factor by which
            the error changes with each unit of the setting.
        low, high: its 95 % interval, infinite for two points.
        law: "power" or "geometric".
        points: how many entered.
    """

    exponent: float
    low: float
    high: float
    law: Law
    points: int

    @property
    def is_known(self) -> bool:
        """Whether the interval reaches no farther than 0.5, or a quarter of the exponent, from its
        middle. With two points there is no interval, and the result is False."""
        return self.high - self.low <= max(1.0, abs(self.exponent) / 2)

    def __str__(self) -> str:
        """The order as a table shows it."""
        if not self.is_known:
            return "unknown"
        if self.law == "geometric":
            middle, low, high = (f"{np.exp(x):.2g}" for x in (self.exponent, self.low, self.high))
            return f"× {middle} ({low} to {high}) a unit"
        return f"{self.exponent:.2f} ± {(self.high - self.low) / 2:.2f}"


@dataclass(frozen=True)
class Curve:
    """Error against time for one setting of one problem.

    Attributes:
        problem: its name.
        knob: whose settings were measured.
        trials: of each setting that was run, cheapest first; none where time was too short.
        reference: of the errors.
        order: fitted, or None for fewer than two points.
        pareto: indices of the trials that no other beats in both error and time.
        not_run: settings for which time was too short.
        stopped: "" if all was measured; else the reason, such as "out of time", with the abandoned
            setting, or "interrupted".
        taken: s, of the whole measurement.
        error_axis: what its errors are, with their unit, as the label of an axis.
    """

    problem: str
    knob: Knob
    trials: tuple[Trial, ...]
    reference: Reference
    order: Order | None
    pareto: tuple[int, ...]
    not_run: tuple[Any, ...] = ()
    stopped: str = ""
    taken: float = 0.0
    error_axis: str = RELATIVE
