"""Report estimates: named numbers with units, standard errors and intervals."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import stdtrit

from jaxvision.core.in_notebooks import record_html

from .formatting import format_interval, format_name, format_unit, format_value

QUANTILES = (0.025, 0.16, 0.5, 0.84, 0.975)  # ends of the 95 and 68 % intervals and the middle
END_SHARE = 1 / 8  # share of an interval over which the density at each end is counted


@runtime_checkable
class Named(Protocol):
    """An object with a name, a symbol and a unit: a `Parameter`, or a line of a data sheet."""

    @property
    def name(self) -> str: ...
    @property
    def symbol(self) -> str: ...
    @property
    def unit(self) -> str: ...


@dataclass(frozen=True)
class Estimate:
    """A number with its name, unit and uncertainty.

    Attributes:
        name: name of the quantity, a word.
        symbol: letter of the quantity, with a subscript after `_`.
        unit: unit of the value; "1" for none.
        value: None where the data cannot determine it.
        standard_error: standard error, in the unit of the value.
        interval_68: (low, high) ends of the 68 % interval.
        interval_95: (low, high) ends of the 95 % interval.
        method: distinguishes several estimates of one quantity.
        group: distinguishes equal names, for example by colour channel.
        reason: why the value is None.

    Example:
        >>> import jaxvision as jv
        >>> from fitting import Gaussian, Parameter, Problem, fit
        >>> free = {"gain": Parameter(start=1.0), "bias": Parameter(start=0.0)}
        >>> line = {"x": np.array([-1.0, 0.0, 1.0]), **free}
        >>> found = fit(Problem(line, jv.gain_bias, Gaussian(sd=0.1), np.array([1.0, 3.0, 5.0])))
        >>> gain, bias = found.estimates
        >>> round(gain.value, 4), round(gain.standard_error, 4)  # 0.1 / sqrt(2)
        (2.0, 0.0707)
    """

    name: str
    symbol: str
    unit: str
    value: float | None
    standard_error: float | None = None
    interval_68: tuple[float, float] | None = None
    interval_95: tuple[float, float] | None = None
    method: str = ""
    group: str = ""
    reason: str = ""

    def _repr_html_(self) -> str:
        named = {"of": self.group, "": format_name(self.name), "by": self.method}
        cells = {
            **{head: text for head, text in named.items() if text},
            "value ± s.e.": format_value(self),
            "unit": format_unit(self.unit),
            "68 %": format_interval(self, 68),
            "95 %": format_interval(self, 95),
        }
        missing = [f"Not determined: {self.reason}."] if self.reason else []
        return record_html([*cells], [[*cells.values()]], notes=missing)


def quantile_estimate(
    what: Named,
    value: float | np.floating,
    standard_error: float | np.floating,
    quantiles: Sequence[float] | Float[np.ndarray, "5"],
    *,
    method: str = "",
    group: str = "",
) -> Estimate:
    """Return an estimate with quantiles as intervals; without a value if one is infinite."""
    if not np.all(np.isfinite(np.asarray([value, standard_error, *quantiles], float))):
        why = "the data do not determine it: its interval exceeds all floating-point numbers"
        return not_determined(what, why, method=method, group=group)
    low95, low68, _, high68, high95 = (float(q) for q in quantiles)
    return Estimate(
        *(what.name, what.symbol, what.unit, float(value), float(standard_error)),
        *((low68, high68), (low95, high95), method, group),
    )


def gaussian_estimate(
    what: Named,
    value: float,
    standard_error: float,
    *,
    method: str = "",
    group: str = "",
    log_scale: bool = False,
    freedom: float = np.inf,
) -> Estimate:
    """Return an estimate with Gaussian intervals, or those of Student's t."""
    steps = stdtrit(freedom, QUANTILES) * standard_error
    with np.errstate(over="ignore"):  # an infinite end is reported as such
        ends = value * np.exp(steps / value) if log_scale and value > 0 else value + steps
    return quantile_estimate(what, value, standard_error, ends, method=method, group=group)


def reach_from_end(
    distance: Float[np.ndarray, "draws ..."], level: float
) -> tuple[Bool[np.ndarray, "..."], Float[np.ndarray, "..."]]:
    """Return whether a shortest interval begins at the end of the range from which `distance` is
    measured, and the length of that interval. It begins there if the density of the draws at this
    end is at least the density at the other end of the interval."""
    reach = np.quantile(distance, level, axis=0)
    width = END_SHARE * reach
    first = np.sum(distance < width, axis=0)
    last = np.sum((distance > reach - width) & (distance <= reach), axis=0)
    return (first >= last) & (reach > 0), reach


def sampled_estimate(
    what: Named,
    draws: Float[np.ndarray, " draws"],
    *,
    method: str = "",
    group: str = "",
    ends: Sequence[float] | Float[np.ndarray, "5"] | None = None,
    value: float | None = None,
) -> Estimate:
    """Return an estimate from draws: their median or a given value, their standard deviation, and
    intervals from their quantiles or from `ends`, the values at `QUANTILES`.
    """
    ends = np.quantile(draws, QUANTILES) if ends is None else ends
    value = float(ends[2]) if value is None else value
    return quantile_estimate(
        what, value, float(np.std(draws)), np.asarray(ends), method=method, group=group
    )


def not_determined(what: Named, reason: str, *, method: str = "", group: str = "") -> Estimate:
    """Return an estimate without a value, for a quantity that the input does not determine."""
    why = reason.rstrip(".")
    return Estimate(what.name, what.symbol, what.unit, None, method=method, group=group, reason=why)


def find(
    estimates: Sequence[Estimate], name: str, *, method: str = "", group: str = ""
) -> Estimate:
    """Return the first estimate with a given name.

    Args:
        estimates: estimates to search.
        name: name of the quantity.
        method: method of the estimate; empty for any.
        group: group of the estimate; empty for any.

    Returns:
        The estimate.

    Raises:
        KeyError: if there is none.
    """
    for estimate in estimates:
        if (
            estimate.name == name
            and (not method or estimate.method == method)
            and (not group or estimate.group == group)
        ):
            return estimate
    raise KeyError(f"no estimate {name!r} with method {method!r} and group {group!r}")
