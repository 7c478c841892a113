"""Records of accuracy measurements: approximations, problems, trials and curves."""

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
    """One approximation of the library, and the values of its parameter, which trade error for
    time.

    Attributes:
        name: the name by which the knob is selected.
        unit: unit of the setting.
        about: what the setting approximates, in a few words.
        settings: values of the setting, cheapest first.
        reference: finer values, coarsest first; the reference is computed with the finest value
            that the time allows.
        order: theoretical exponent p of error ~ setting^p, such as -2 for a midpoint rule; None
            where no law is known.
        law: "power": the error is a power of the setting; "geometric": the error changes by a
            constant factor with each unit of the setting.
        random: whether the error depends on the seed. If False, the error is a bias, and only
            results of the same seed are compared with each other.
        whole: whether any whole number is a valid setting, not only the numbers in `settings`.
        sets: public parameters that the knob varies, as `fnmatch` patterns of the names below
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
    """A computation as a function of its settings and of a random seed.

    Attributes:
        name: name of the problem in tables and plots.
        prepare: function of the settings of all knobs by name, which returns a function from a seed
            to an array of numbers. `prepare` is called once for each setting. The returned function
            may compile in its first call.
        settings: default settings of all knobs.
        exact: the exact result, if a closed form is known; None computes a reference.
        level: the level by which errors are divided, in the unit of the result; None for the root
            mean square of the reference.
        developed: function from a result and the reference (which sets the exposure) to the Lab
            colours of the developed picture, (pixels, 3); None where there is no picture.
        whole: time of the whole computation divided by the time of a call, for a problem that
            computes only a part.
        compiled: whether one compiled program serves all settings, so that no first call takes
            longer than others; otherwise every setting compiles its own program.
        about: sentences on the meaning of errors and times.
        compiling: s, expected time to compile one more program, before any measurement.
        once: s, part of a call that the whole computation needs only once, such as the work before
            the first pixel of a picture.
        error_axis: label for the axis of errors, with their unit.
        compared: function from a result, or the mean of several, to the numbers that are compared,
            such as radiance clipped at white; None for the result itself.
        alone: for random knobs by name, a variant of `prepare` in which the seed changes the random
            numbers of that knob only. Otherwise the noise of other knobs would hide the error of
            that knob.
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
    """The measured error and time of one value of a setting.

    Attributes:
        setting: the value of the setting.
        error: relative error, root mean square over seeds, in the first requested norm.
        error_low, error_high: interval of the relative error, in which the error of a run with
            another seed lies with 95 % probability, and below the upper end with 97.5 %. The
            interval includes the error of the reference.
        seconds: median time of a warm call, s.
        seconds_low, seconds_high: quartiles of that time, s.
        first_seconds: time of the first call with tracing and compilation, s.
        seeds: number of seeds.
        norms: the error in every norm by name: "rms", "p99" and "max" relative, "delta_e" in units
            of L*.
        hollow: whether the error is below three times the error of the reference, and thus
            uncertain.
        beside: whether an abandoned program was still running during the calls, so that the times
            are too long.
        measured: False for a setting whose error was inferred from other settings by the order of
            the knob.
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
    """The source of the reference result, from which errors are measured, and its own estimated
    error.

    Attributes:
        setting: the setting with which the reference was computed; None for a closed form or the
            caller's reference.
        error: relative error estimate of the reference; 0 for a closed form, inf where there is no
            estimate.
        how: source of the reference and its error: "closed form", "given", "other seeds", "twice as
            fine", "exact setting", "finest setting" or "none".
    """

    setting: Any
    error: float
    how: str


@dataclass(frozen=True)
class Order:
    """The law by which the error depends on a setting, fitted by least squares to the trials whose
    error is well above that of the reference.

    Attributes:
        exponent: p of error ~ setting^p; for a geometric law, the logarithm of the factor by which
            the error changes with each unit of the setting.
        low, high: ends of the 95 % interval of the exponent, infinite for two points.
        law: "power" or "geometric".
        points: number of fitted trials.
    """

    exponent: float
    low: float
    high: float
    law: Law
    points: int

    @property
    def is_known(self) -> bool:
        """Whether the 95 % interval extends at most 0.5, or at most a quarter of the exponent, from
        its centre. With two points the interval is infinite, and the result is False."""
        return self.high - self.low <= max(1.0, abs(self.exponent) / 2)

    def __str__(self) -> str:
        """Return the order as text for tables, or "unknown"."""
        if not self.is_known:
            return "unknown"
        if self.law == "geometric":
            middle, low, high = (f"{np.exp(x):.2g}" for x in (self.exponent, self.low, self.high))
            return f"× {middle} ({low} to {high}) a unit"
        return f"{self.exponent:.2f} ± {(self.high - self.low) / 2:.2f}"


@dataclass(frozen=True)
class Curve:
    """The measured errors and times of the values of one setting, on one problem.

    Attributes:
        problem: name of the problem.
        knob: the knob whose settings were measured.
        trials: one trial for each setting that was run, cheapest first; empty where the time was
            too short.
        reference: how the reference result was computed, from which the errors are measured.
        order: fitted order; None for fewer than two points.
        pareto: indices of the Pareto-optimal trials: no other trial is better in both error and
            time.
        not_run: settings that were not run because the time was too short.
        stopped: "" for a complete measurement. Otherwise the reason why it stopped: "interrupted",
            or "out of time" with the abandoned setting.
        taken: time of the whole measurement, s.
        error_axis: label for the axis of errors, with their unit.
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
