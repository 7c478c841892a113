"""Print records, and display them in notebooks."""

import inspect
import re
from collections.abc import Iterator, Sequence
from dataclasses import fields
from html import escape
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from ..errors import nearest

WIDE = 88  # columns of a printed record
_SYMBOL = r"(?:W|J|m|s|K|Hz|F|eV|rad|sr|DN|e-|photons?|pixels?|rows)(?:\^-?\d+)?(?!\w)"
# The unit after the shape, at the beginning of a field's description in a docstring.
UNIT = re.compile(rf"(?:\([^)]*\) (?:or )?)+({_SYMBOL}(?: (?:per )?{_SYMBOL})*)")
SHORT = 12  # largest size of an array whose numbers are all printed


class Shown(eqx.Module):
    """Base of records that print their fields with numbers; `str` also prints the units. A long
    array is printed as its shape and range. Fields that are None are omitted. Creating a record
    with an unknown field raises `TypeError`, which names the nearest known field."""

    def __new__(cls, *args: Any, **given: Any):  # `Self`, which checkers of types infer
        for name in given:
            if name not in cls.__dataclass_fields__:
                known = inspect.signature(cls).parameters
                free = any(one.kind == one.VAR_KEYWORD for one in known.values())
                if name not in known and not free:
                    hint = nearest(name, known)
                    raise TypeError(f"{cls.__name__} has no field {name!r}; {hint}.")
        return super().__new__(cls)

    def __repr__(self) -> str:
        return _format(self)

    def __str__(self) -> str:
        return _format(self, units=True)

    def _repr_html_(self) -> str:
        """Return the HTML table that a notebook shows: each field with its numbers, unit and
        meaning."""
        head = f"<tr><th>{type(self).__name__}</th><th></th><th></th></tr>"
        rows = "".join(
            f'<tr><td style="text-align: left; padding-left: {1 + depth}em">{escape(name)}</td>'
            + "".join(f'<td style="text-align: left">{escape(cell)}</td>' for cell in cells)
            + "</tr>"
            for depth, name, *cells in _rows(self)
        )
        return f'<div style="overflow-x: auto"><table>{head}{rows}</table></div>'


def _rows(record: eqx.Module, depth: int = 0) -> Iterator[tuple[int, str, str, str]]:
    """List the depth, the name, the numbers, and the unit and meaning of each field that is not
    None. The fields of a nested record follow the field that contains it."""
    about = meanings(type(record))
    for field in fields(record):
        value, meaning = getattr(record, field.name), about.get(field.name, "")
        if value is None or not field.repr:
            continue
        several = isinstance(value, tuple | list)
        members = [*value] if several else [value]
        if not any(isinstance(one, eqx.Module) for one in members):
            yield depth, field.name, _format(value), meaning
            continue
        for i, one in enumerate(members[:SHORT]):
            name = f"{field.name}[{i}]" if several else field.name
            inside = isinstance(one, eqx.Module)
            yield depth, name, type(one).__name__ if inside else _format(one), "" if i else meaning
            yield from _rows(one, depth + 1) if inside else ()
        if len(members) > SHORT:
            yield depth, field.name, f"and {len(members) - SHORT} more", ""


def meanings(kind: object) -> dict[str, str]:
    """Read the description of each field of a record, or of each argument of a function, from its
    docstring."""
    listed = re.split(r"^(?:Attributes|Args):\n", inspect.getdoc(kind) or "", flags=re.MULTILINE)
    entries = re.findall(r"^    (\w+): (.+(?:\n {5,}.+)*)", "".join(listed[1:]), re.MULTILINE)
    return {name: " ".join(text.split()) for name, text in entries}


def _format(value: Any, indent: str = "", *, units: bool = False) -> str:
    if isinstance(value, eqx.Module):
        # the text after a field's shape, with a space before it
        read = {name: UNIT.match(text) for name, text in meanings(type(value)).items() if units}
        unit = {name: f" {match[1]}" for name, match in read.items() if match}
        kept = [(f.name, getattr(value, f.name)) for f in fields(value) if f.repr]
        given = [
            (f"{name}=", one, "" if isinstance(one, eqx.Module) else unit.get(name, ""))
            for name, one in kept
            if one is not None
        ]
        return _list_items(f"{type(value).__name__}(", given, ")", indent, units=units)
    if isinstance(value, tuple | list) and any(isinstance(one, eqx.Module) for one in value):
        given = [("", one, "") for one in value]
        return _list_items("(", given, ",)" if len(value) == 1 else ")", indent, units=units)
    if not isinstance(value, jax.Array | np.ndarray):
        return eqx.tree_pformat(value)
    if isinstance(value, Tracer) or jnp.issubdtype(value.dtype, jax.dtypes.extended):
        return eqx.tree_pformat(value)
    numbers = np.asarray(value)
    if numbers.size <= SHORT:
        return _number_text(numbers)
    return f"{numbers.dtype}{list(numbers.shape)} from {numbers.min():.4g} to {numbers.max():.4g}"


def _number_text(numbers: np.ndarray) -> str:
    if numbers.ndim == 0:
        return str(numbers) if numbers.dtype == bool else f"{numbers + 0:.6g}"  # no -0
    return f"[{', '.join(map(_number_text, numbers))}]"


def _list_items(
    head: str, given: list[tuple[str, Any, str]], tail: str, indent: str, *, units: bool
) -> str:
    """Print all (name, value, unit) on one line if they fit, otherwise each on a separate line."""
    line = head + ", ".join(n + _format(one, units=units) + unit for n, one, unit in given) + tail
    if len(indent) + len(line) <= WIDE and "\n" not in line:
        return line
    inner = indent + "  "
    entries = "".join(
        f"\n{inner}{name}{_format(one, inner, units=units)}{unit}," for name, one, unit in given
    )
    return f"{head}{entries}\n{indent}{tail.lstrip(',')}"


def aligned_columns(rows: Sequence[tuple[str, ...]]) -> str:
    """Format rows of cells as lines of text with aligned columns."""
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    )
