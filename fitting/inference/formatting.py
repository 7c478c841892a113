"""Format numbers with the digits that their uncertainty supports."""

import math
import re
from typing import Protocol

import numpy as np

SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
DIGITS = 2  # significant digits of an uncertainty
ACRONYMS = {"dsnu": "DSNU", "prnu": "PRNU", "snr": "SNR", "db": "dB"}


class Uncertain(Protocol):
    """The fields of an `Estimate` that are printed."""

    @property
    def value(self) -> float | None: ...
    @property
    def standard_error(self) -> float | None: ...
    @property
    def interval_68(self) -> tuple[float, float] | None: ...
    @property
    def interval_95(self) -> tuple[float, float] | None: ...


def decimals_for(uncertainty: float) -> int | None:
    """Return the number of decimal places that keep two significant digits of an uncertainty. It is
    negative for tens and more, and None if the uncertainty is zero or not finite.
    """
    if not math.isfinite(uncertainty) or uncertainty <= 0:
        return None
    return DIGITS - 1 - math.floor(math.log10(uncertainty))


def format_name(name: str) -> str:
    """Return the name of a quantity in words: `snr_max` becomes "SNR max".

    Args:
        name: with underscores.

    Returns:
        The words.
    """
    return " ".join(ACRONYMS.get(word, word) for word in name.split("_"))


def format_p(p_value: float) -> str:
    """Format a p-value as `p = 0.03`, or as `p < 1e-300` if it underflows."""
    return f"p = {p_value:.2g}" if p_value > 1e-300 or math.isnan(p_value) else "p < 1e-300"


def format_percent(share: float, *, decimals: int = 0) -> str:
    """Format a fraction as a percentage: 0.125 with one decimal is "12.5 %"."""
    return f"{100 * share:.{decimals}f} %"


def format_spread(values: np.ndarray) -> tuple[str, str]:
    """Format the median of finite values, and the interval that contains their middle 90 %."""
    low, middle, high = np.percentile(values, (5, 50, 95))
    return f"{middle:.4g}", f"[{low:.4g}, {high:.4g}]"


def format_number(value: float, decimals: int | None, *, beside: float | None = None) -> str:
    """Format a number, rounded to the given decimal places (negative for tens, hundreds and so on;
    None for six digits). It has an exponent if `beside`, the number printed next to it, has one.
    """
    if decimals is None or not math.isfinite(value):
        return f"{value:.6g}"
    size = abs(value if beside is None else beside)
    if size >= 1e7 or (decimals > 7 and size < 1e-3):
        exponent = math.floor(math.log10(abs(value))) if value else 0
        return f"{value:.{max(decimals + exponent, 1)}e}"
    return f"{round(value, decimals):.{max(decimals, 0)}f}"


def format_with_error(value: float, error: float, *, signed: bool = False) -> str:
    """Format `value ± error`, both to two significant digits of the error."""
    places = decimals_for(error)
    sign = "+" if signed and value > 0 else ""
    return f"{sign}{format_number(value, places)} ± {format_number(error, places, beside=value)}"


def format_within(value: float, width: float) -> str:
    """Format a number whose uncertainty is `width`, to two significant digits of that width."""
    return format_number(value, decimals_for(width))


def format_value(estimate: Uncertain) -> str:
    """Return `value ± standard error` without the unit, or a dash if there is no value.

    Args:
        estimate: with or without a value.

    Returns:
        The text, with as many digits as the standard error allows.
    """
    if estimate.value is None:
        return "–"
    if estimate.standard_error is None:
        return f"{estimate.value:.6g}"
    return format_with_error(estimate.value, estimate.standard_error)


def format_interval(estimate: Uncertain, level: int) -> str:
    """Format the 68 or 95 % interval as `[low, high]`.

    Args:
        estimate: with or without an interval.
        level: 68 or 95.

    Returns:
        The text, empty where there is no interval.
    """
    interval = estimate.interval_68 if level == 68 else estimate.interval_95
    if interval is None:
        return ""
    deviations = 2 if level == 68 else 4
    places = decimals_for((interval[1] - interval[0]) / deviations)
    largest = max(interval, key=abs)
    low, high = (format_number(end, places, beside=largest) for end in interval)
    return f"[{low}, {high}]"


def format_unit(unit: str) -> str:
    """Format a unit: `sr^-1` as sr⁻¹, and the unit one as an empty text.

    Args:
        unit: with powers after `^`.

    Returns:
        The text, empty for `1`.
    """
    if unit == "1":
        return ""
    return re.sub(r"\^(-?\d+)", lambda power: power[1].translate(SUPERSCRIPTS), unit)


def split_symbol(symbol: str) -> tuple[str, str]:
    """Split a symbol such as `σ_d` into its letter and its subscript (empty if it has none)."""
    letter, _, subscript = symbol.partition("_")
    return letter, subscript


def format_axis(symbol: str, unit: str) -> str:
    """Return the label of an axis: the symbol as mathematical text, and its unit in brackets."""
    letter, subscript = split_symbol(symbol)
    mathematics = f"${letter}_{{\\rm {subscript}}}$" if subscript else f"${letter}$"
    return f"{mathematics} [{format_unit(unit)}]" if format_unit(unit) else mathematics


def size_in_words(bytes: int) -> str:
    """Format the size of files: 154 kB."""
    for unit, size in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if bytes >= size:
            return f"{bytes / size:.3g} {unit}"
    return f"{bytes} bytes"


def format_cell(cell: object) -> str:
    """Format a table cell: floats to four digits, None as a dash."""
    if cell is None:
        return "–"
    if not isinstance(cell, float):
        return str(cell)
    rounded = float(f"{cell:.4g}")
    return f"{rounded:.0f}" if 1e4 <= abs(rounded) < 1e7 else f"{cell:.4g}"
