"""What the registry contains for one function, and how its arguments are drawn."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Range:
    """Numbers drawn between two ends.

    Attributes:
        low, high: the ends, with their sign if `log`.
        log: uniform in the logarithm of the magnitude.
        signed: of either sign.
    """

    low: float
    high: float
    log: bool = True
    signed: bool = False

    def __str__(self) -> str:
        return f"{'±' * self.signed}{self.low:g}…{self.high:g}"

    def draw(self, rng: np.random.Generator, n: int) -> np.ndarray:
        u = rng.uniform(size=n)
        if not self.log:
            return self.low + (self.high - self.low) * u
        size = np.exp(np.log(self.low) + np.log(self.high / self.low) * u)
        return size * rng.choice([-1.0, 1.0], size=n) if self.signed else size


@dataclass(frozen=True)
class Columns:
    """Vectors of independent components."""

    of: Range
    count: int = 3

    def __str__(self) -> str:
        return f"{self.count} of {self.of}"

    def draw(self, rng: np.random.Generator, n: int) -> np.ndarray:
        return np.stack([self.of.draw(rng, n) for _ in range(self.count)], axis=-1)


@dataclass(frozen=True)
class Unit:
    """Unit vectors, rounded where they are used. `above`: with positive z, half of them with
    uniform ln z. `least`: the smallest z."""

    above: bool = False
    least: float = 0.0

    def __str__(self) -> str:
        return f"unit, z > {self.least:g}" if self.above or self.least else "unit"

    def draw(self, rng: np.random.Generator, n: int) -> np.ndarray:
        if not self.above and not self.least:
            v = rng.normal(size=(n, 3))
            return v / np.linalg.norm(v, axis=-1, keepdims=True)
        flat = rng.uniform(self.least, 1, size=n)
        grazing = (rng.uniform(size=n) < 0.5) & self.above
        z = np.where(grazing, Range(1e-3, 1).draw(rng, n), flat)
        turn, sine = rng.uniform(0, 2 * np.pi, size=n), np.sqrt(1 - z * z)
        return np.stack([sine * np.cos(turn), sine * np.sin(turn), z], axis=-1)


@dataclass(frozen=True)
class Whole:
    """Integers from `low` to `high`."""

    low: int
    high: int

    def __str__(self) -> str:
        return f"whole {self.low}…{self.high}"

    def draw(self, rng: np.random.Generator, n: int) -> np.ndarray:
        return rng.integers(self.low, self.high + 1, size=n).astype(float)


FRACTION = Range(0, 1, log=False)
RELATIVE = Range(1e-6, 1.0)


@dataclass(frozen=True)
class Entry:
    """One row of the table: a function and its oracle.

    Attributes:
        name: of the public function, below `jaxvision` (or `fitting`, with that word before it).
        call: takes the arrays of ONE point, returns one array or a tuple of them.
        oracle: `oracle(m, *arguments)` takes many points, returns one array for each of `parts`.
        domain: how each argument is drawn: `Range`, `Columns`, `Unit`.
        hard: arguments at which a naive formula fails.
        bound: allowed error in float32 and float64, in units in the last place.
        form: what distinguishes the row from others of the function.
        parts: names of the results.
        conditioned: the bound is in units in the last place times 1 + sum |x df/dx| / |f|, because
            the result is a difference, or an exponential, of rounded numbers; `note` says which.
        gradient: allowed relative error of a derivative in float32; None if it is not tested.
        of_quotient: share of f / x to which a derivative's error may also be relative, where the
            derivative is a difference of numbers of that size; `note` says of which.
        turn: of a part called "hue": `turn(m)`, its period.
        of_digits: the oracle needs functions that only mpmath has; fewer points are drawn.
        precisions: in which it is measured.
        note: remarks for the reader.
    """

    name: str
    call: Callable[..., Any]
    oracle: Callable[..., Any]
    domain: tuple[Any, ...]
    hard: tuple[tuple[Any, ...], ...] = ()
    bound: float = 4.0
    form: str = ""
    parts: tuple[str, ...] = ("",)
    conditioned: bool = False
    gradient: float | None = 1e-5
    of_quotient: float = 0.0
    turn: Callable[..., Any] | None = None
    of_digits: bool = False
    precisions: tuple[str, ...] = ("float32", "float64")
    note: str = ""

    @property
    def title(self) -> str:
        return f"{self.name} ({self.form})" if self.form else self.name

    @property
    def is_curve(self) -> bool:
        """Return whether it is a function of one variable."""
        return len(self.domain) == 1 and isinstance(self.domain[0], Range) and not self.of_digits
