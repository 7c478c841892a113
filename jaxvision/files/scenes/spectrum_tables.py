"""Read spectra from CSV files: find the columns of wavelengths and values, and their units, from
the headers. Ambiguous headers are refused, because a wrong column or unit would give plausible but
wrong numbers.
"""

import csv
import re
from pathlib import Path

import numpy as np

from ...errors import InputError, nearest, plain_text

_WAVELENGTH = {"wavelength", "wavelengths", "wave", "lambda", "λ", "wl"}
_WAVELENGTH |= {"wavenumber", "wavenumbers"}
_INDEX = {"", "index", "id", "no", "nr", "row", "unnamed"}
_UNCERTAINTY = {
    "uncertainty",
    "unc",
    "u",
    "std",
    "stdev",
    "stddev",
    "sd",
    "sigma",
    "σ",
    "se",
    "sem",
}
_UNCERTAINTY |= {"err", "error", "errors", "stderr", "deviation", "variance", "var", "tolerance"}
_VALUES = {
    "reflectance": {"reflectance", "reflectivity", "albedo", "r", "value", "values"},
    "light": {"irradiance", "radiance", "power", "intensity", "flux", "spd", "value", "values"},
}
_UNITS = {  # m
    1e-9: "nm nanometer nanometers nanometre nanometres",
    1e-6: "um µm μm micron microns micrometer micrometers micrometre micrometres",
    1e-10: "å angstrom angstroms ångström ångstrom",
    1.0: "m metre metres meter meters",
}
_METRES = {word: size for size, words in _UNITS.items() for word in words.split()}
_PER_CENTIMETRE = re.compile(r"wave ?numbers?|cm\W{0,2}[-−]1|cm⁻¹|1 ?/ ?cm", re.IGNORECASE)
_NO_LENGTH = {"hz", "thz", "ev", "frequency", "energy"}


def read_table(file: Path, column: str | None, quantity: str) -> tuple[np.ndarray, np.ndarray]:
    """Read the wavelengths, (n,) m, ascending, and the values, (n,) in the file's unit, of a column
    of a CSV file. The default column is the only column that is a spectrum, or the only column that
    is named after the quantity. Raise `InputError` if the column or its unit is ambiguous."""
    lines = plain_text(file).splitlines()
    first = next((n for n, line in enumerate(lines) if line.strip()[:1] not in ("", "#")), None)
    heads = [] if first is None else _cells(lines[first])
    if len(heads) < 2:
        marks = [mark for mark in ";\t" if heads and mark in heads[0]]
        advice = "separate them by commas, with decimal points" if marks else "begin with a line of"
        raise InputError(
            f"{file}: no columns; {advice}{'' if marks else ' heads'}, as in wavelength,value."
        )
    assert first is not None
    if all(_is_number(head) for head in heads):
        raise InputError(
            f"{file}: its first line, {lines[first].strip()[:40]!r}, holds numbers and no heads; "
            "begin with a line of heads, as in wavelength,value."
        )
    wavelengths = _wavelength_column(file, heads)
    others = [head for place, head in enumerate(heads) if place != wavelengths]
    if column is not None and column not in others:
        raise InputError(f"{file}: no column {column!r}; {nearest(column, others)}.")
    wanted = _value_column(file, others, quantity) if column is None else column
    at = next(n for n, head in enumerate(heads) if head == wanted and n != wavelengths)
    rows = []
    for number, line in enumerate(lines[first + 1 :], first + 2):
        if line.strip():
            cells = _cells(line)
            try:
                rows.append((float(cells[wavelengths]), float(cells[at])))
            except (ValueError, IndexError):
                raise InputError(
                    f"{file}, line {number}: {line.strip()[:40]!r} has no number for {wanted!r}; "
                    "correct it."
                ) from None
    table = np.asarray(rows).reshape(-1, 2)
    given, values = table.T
    if len(table) < 2 or not np.isfinite(table).all() or (np.diff(given) <= 0).any():
        raise InputError(
            f"{file}: a spectrum takes at least two rows of finite numbers whose wavelengths "
            "ascend; correct it."
        )
    if (values < 0).any():
        raise InputError(f"{file}: {wanted!r} has negative values; a spectrum has none.")
    is_percent = "%" in wanted or _words(wanted) & {"percent", "pct"}
    if is_percent and quantity == "reflectance":
        values = values / 100
    return _metres(file, heads[wavelengths], given, values, quantity)


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in next(csv.reader([line]))]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _words(head: str) -> set[str]:
    """Split a header into its words in lower case: "Wavelength_um" gives wavelength and um."""
    return set(re.findall(r"[^\W\d_]+", head.lower())) or {""}


def _wavelength_column(file: Path, heads: list[str]) -> int:
    """Return the first column headed by wavelengths or a unit of length, else the first column."""
    sure = [set() if _words(head) & _UNCERTAINTY else _words(head) for head in heads]
    units = set(_METRES) | _NO_LENGTH
    named = [n for n, words in enumerate(sure) if words & _WAVELENGTH]
    named = named or [n for n, words in enumerate(sure) if words and words <= units]
    if not named and _words(heads[0]) <= _INDEX:
        raise InputError(
            f"{file}: none of its columns {', '.join(map(repr, heads))} is named as wavelengths; "
            "name it, as in wavelength."
        )
    return named[0] if named else 0


def _value_column(file: Path, others: list[str], quantity: str) -> str:
    """Return the header of the only column of values; `InputError` if several are possible."""
    left = [h for h in others if not (_words(h) <= _INDEX or _words(h) & _UNCERTAINTY)]
    named = [h for h in left if _words(h) & _VALUES[quantity]]
    chosen = left if len(left) == 1 else named
    if len(chosen) != 1:
        raise InputError(
            f"{file}: which of its columns {', '.join(map(repr, left or others))} holds the "
            'spectrum is open; name it, as in column = "...".'
        )
    return chosen[0]


def _metres(
    file: Path, head: str, given: np.ndarray, values: np.ndarray, quantity: str
) -> tuple[np.ndarray, np.ndarray]:
    words = _words(head)
    if _PER_CENTIMETRE.search(head) and given[0] > 0 and quantity == "reflectance":
        return 1e-2 / given[::-1], values[::-1]
    if _PER_CENTIMETRE.search(head) or words & _NO_LENGTH:
        raise InputError(
            f"{file}: {head!r} is no wavelength; convert it to nm"
            f"{', and light to values per wavelength' if quantity == 'light' else ''}."
        )
    sizes = {size for word, size in _METRES.items() if word in words}
    return given * (sizes.pop() if len(sizes) == 1 else 1e-9), values
