"""The table of a section's estimates, with a row for each quantity and a column for each method or
channel."""

from collections.abc import Sequence
from dataclasses import dataclass

from ..inference.estimates import Estimate
from ..inference.formatting import (
    format_interval,
    format_name,
    format_unit,
    format_value,
    split_symbol,
)
from .section import Section


@dataclass(frozen=True)
class Cell:
    """The text of one estimate in the table."""

    value: str = ""  # the value with its standard error; a dash where there is no value
    interval: str = ""  # the 95 % interval; empty where there is no interval
    note: int = 0  # number of the note that gives the reason for a missing value; 0 without a note


@dataclass(frozen=True)
class Row:
    """The text of one quantity, a row of the table."""

    name: str  # name of the quantity, in words
    letter: str  # letter of the quantity's symbol
    subscript: str  # subscript of the quantity's symbol
    unit: str  # unit of the quantity, as printed
    cells: tuple[Cell, ...]  # one cell for each column
    difference: str = ""  # difference of two methods over the larger of their standard errors


@dataclass(frozen=True)
class Sheet:
    """The content of the table of a section's estimates."""

    columns: tuple[str, ...]  # headings of the columns of cells
    # rows of the table, grouped under the headings of the section. The heading is empty where the
    # section has none.
    blocks: tuple[tuple[str, tuple[Row, ...]], ...]
    notes: tuple[str, ...]  # reasons for undetermined values, numbered from 1
    # sentence that names the methods of estimation, for a table whose columns are channels
    methods: str
    compares: bool  # whether rows state the difference of two methods


def sheet(section: Section) -> Sheet:
    """Arrange a section's estimates as a table."""
    found = section.estimates
    places = [(one.name, one.group) for one in found]
    several = len(set(places)) < len(places)
    keys = [f"{one.group} {one.method}".strip() if several else one.group for one in found]
    columns = tuple(dict.fromkeys(key for key in keys if key)) or ("value",)
    compares = several and len(columns) == 2
    notes: dict[str, int] = {}
    rows: dict[str, Row] = {}
    for name in dict.fromkeys(one.name for one in found):
        own = {key: one for key, one in zip(keys, found, strict=True) if one.name == name}
        first = next(iter(own.values()))
        cells = tuple(_cell(own.get(column, own.get("")), notes) for column in columns)
        apart = _difference([own.get(column) for column in columns]) if compares else ""
        letter, subscript = split_symbol(first.symbol)
        unit = format_unit(first.unit)
        rows[name] = Row(format_name(name), letter, subscript, unit, cells, apart)
    listed = {name for names in section.headings.values() for name in names}
    blocks = [
        (heading, tuple(rows[name] for name in names if name in rows))
        for heading, names in section.headings.items()
    ]
    rest = tuple(row for name, row in rows.items() if name not in listed)
    blocks.append(("Of the fit" if section.headings else "", rest))
    methods = "" if several else _methods(found)
    kept = tuple(block for block in blocks if block[1])
    return Sheet(columns, kept, tuple(notes), methods, compares)


def _cell(estimate: Estimate | None, notes: dict[str, int]) -> Cell:
    if estimate is None:
        return Cell()
    if estimate.reason:
        return Cell("–", note=notes.setdefault(estimate.reason, len(notes) + 1))
    return Cell(format_value(estimate), format_interval(estimate, 95))


def _difference(pair: Sequence[Estimate | None]) -> str:
    one, other = pair
    if one is None or other is None or one.value is None or other.value is None:
        return ""
    error = max(one.standard_error or 0.0, other.standard_error or 0.0)
    return f"{(other.value - one.value) / error:+z.1f} σ" if error > 0 else ""


def _methods(found: Sequence[Estimate]) -> str:
    by_method: dict[str, list[str]] = {}
    for one in found:
        if one.method:
            by_method.setdefault(one.method, []).append(one.group)
    if len(by_method) < 2:
        return "".join(f"Method: {method}." for method in by_method)
    methods = [f"{method} ({', '.join(dict.fromkeys(g))})" for method, g in by_method.items()]
    return f"Methods: {'; '.join(methods)}."
