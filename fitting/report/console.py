"""Output of results as tables and sentences in a terminal."""

import io
import sys
from collections.abc import Sequence
from dataclasses import replace

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table as RichTable

from ..inference.formatting import format_cell
from .section import Section, Table
from .sentences import said_once
from .sheet import Cell, Sheet, sheet

COLUMNS = 3  # channels or methods side by side
PLAIN_WIDTH = 110  # columns if the output is not a terminal


def output() -> Console:
    """Return a console on standard output, as wide as the terminal, or 110 characters."""
    return Console(width=None if sys.stdout.isatty() else PLAIN_WIDTH, highlight=False)


def print_section(console: Console, section: Section) -> None:
    """Print the estimates and tables of a section, then its findings."""
    console.print()
    if section.headline:
        console.print(f"[bold]{_escape(section.headline)}", soft_wrap=not console.is_terminal)
    if section.estimates:
        found = sheet(section)
        for first in range(0, len(found.columns), COLUMNS):
            console.print(_sheet_table(section.title, found, slice(first, first + COLUMNS)))
        console.print(f"Value ± standard error, 95 % interval. {found.methods}".rstrip())
        for number, reason in enumerate(found.notes, 1):
            console.print(
                f"({number}) Not determined: {reason}.", soft_wrap=not console.is_terminal
            )
    for table in section.tables:
        for part in plain_tables(table, console.width):
            console.print(part)
    for finding in said_once([one for one in section.findings if one != section.headline]):
        console.print(f"• {finding}", soft_wrap=not console.is_terminal)


def section_text(section: Section) -> str:
    """Return the estimates and findings of a section as text, for `print`."""
    plain = {"highlight": False, "color_system": None, "force_jupyter": False}
    console = Console(file=io.StringIO(), width=PLAIN_WIDTH, **plain)
    with console.capture() as printed:
        print_section(console, replace(section, tables=()))
    return "\n".join(line.rstrip() for line in printed.get().strip().splitlines())


def _sheet_table(title: str, found: Sheet, shown: slice) -> RichTable:
    table = RichTable(title=_escape(title), title_justify="left", title_style="bold")
    heads = ("quantity", *found.columns[shown], *(["apart"] if found.compares else []))
    for head in heads:
        table.add_column(_escape(head), overflow="fold")
    for _, rows in found.blocks:
        table.add_section()
        for row in rows:
            name = f"{row.name}\n{row.unit}".rstrip()
            cells = (_cell(cell) for cell in row.cells[shown])
            compared = (row.difference,) if found.compares else ()
            table.add_row(*map(_escape, (name, *cells, *compared)))
    return table


def _cell(cell: Cell) -> str:
    note = f" ({cell.note})" if cell.note else ""
    return f"{cell.value}{note}\n{cell.interval}".rstrip()


def plain_tables(content: Table, width: int) -> list[RichTable]:
    """Format a table of results, followed by its caption. A table wider than `width` is split into
    parts. Each part begins with the columns that name the rows. The text of cells wraps between
    words. A word is cut only if the columns of names and one other column do not fit."""
    rows = [[format_cell(cell) for cell in row] for row in content.rows]
    texts = [*zip(content.columns, *rows, strict=True)]
    least = [max(map(cell_len, " ".join(column).split()), default=0) for column in texts]
    whole = [max(map(cell_len, column)) for column in texts]
    names = _columns_of_names(content)
    parts: list[list[int]] = []
    for i in range(names, len(least)):
        joined = [*(parts[-1] if parts else range(names)), i]
        if parts and _spare(joined, least, width) < 0:
            parts.append([*range(names), i])
        else:
            parts[-1:] = [joined]
    tables = []
    for chosen in parts:
        table = RichTable(title_justify="left", title_style="bold", caption_justify="left")
        spare = _spare(chosen, least, width)
        is_narrow = 0 <= spare < sum(whole[i] - least[i] for i in chosen)
        for i in chosen:
            added = min(whole[i] - least[i], max(spare, 0))
            spare -= added
            table.add_column(
                _escape(content.columns[i]),
                width=least[i] + added if is_narrow else None,
                overflow="fold",
            )
        for row in rows:
            table.add_row(*(_escape(row[i]) for i in chosen))
        tables.append(table)
    tables[0].title = _escape(content.title)
    tables[-1].caption = _escape(content.caption) or None
    return tables


def _columns_of_names(content: Table) -> int:
    """Return how many columns name a row: 1 or 2 if the first columns are text, else 0."""
    is_text = [
        all(isinstance(cell, str) for cell in column) for column in zip(*content.rows, strict=True)
    ]
    count = 0 if not is_text or not is_text[0] else 1 + all(is_text[1:2])
    return min(count, max(len(content.columns) - 1, 0))


def _spare(chosen: Sequence[int], least: Sequence[int], width: int) -> int:
    """Return the width left by the longest words of these columns; negative if too narrow."""
    return width - sum(least[i] for i in chosen) - 3 * len(chosen) - 1


def _escape(cell: str) -> str:
    return cell.replace("[", r"\[")
