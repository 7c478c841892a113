"""Results as tables and sentences on standard output."""

import io
import sys
from dataclasses import replace

from rich.console import Console
from rich.table import Table as RichTable

from ..inference.formatting import format_cell
from .section import Section, Table
from .sentences import said_once
from .sheet import Cell, Sheet, sheet

COLUMNS = 3  # channels or methods side by side
PLAIN_WIDTH = 110  # columns where the output is not a terminal, which would tell its width


def output() -> Console:
    """Standard output: as wide as the terminal, of one width when it is piped."""
    return Console(width=None if sys.stdout.isatty() else PLAIN_WIDTH, highlight=False)


def print_section(console: Console, section: Section) -> None:
    """The estimates of a calibration as tables, its findings as sentences under them."""
    console.print()
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
        console.print(plain_table(table))
    for finding in said_once(section.findings):
        console.print(f"• {finding}", soft_wrap=not console.is_terminal)


def section_text(section: Section) -> str:
    """Estimates and findings of a calibration, as `print` shows them.

    Args:
        section: of a report.

    Returns:
        Lines, without the end of the last.
    """
    plain = {"highlight": False, "color_system": None, "force_jupyter": False}
    console = Console(file=io.StringIO(), width=PLAIN_WIDTH, **plain)
    with console.capture() as printed:
        print_section(console, replace(section, tables=()))
    return "\n".join(line.rstrip() for line in printed.get().strip().splitlines())


def _sheet_table(title: str, found: Sheet, shown: slice) -> RichTable:
    """A row a quantity, a block under another; of its columns those of `shown`."""
    table = RichTable(title=_escaped(title), title_justify="left", title_style="bold")
    heads = ("quantity", *found.columns[shown], *(["apart"] if found.compares else []))
    for head in heads:
        table.add_column(_escaped(head))
    for _, rows in found.blocks:
        table.add_section()
        for row in rows:
            name = f"{row.name}\n{row.unit}".rstrip()
            cells = (_cell(cell) for cell in row.cells[shown])
            compared = (row.apart,) if found.compares else ()
            table.add_row(*map(_escaped, (name, *cells, *compared)))
    return table


def _cell(cell: Cell) -> str:
    note = f" ({cell.note})" if cell.note else ""
    return f"{cell.value}{note}\n{cell.interval}".rstrip()


def plain_table(content: Table) -> RichTable:
    """A results table as it stands, its caption under it."""
    table = RichTable(
        title=_escaped(content.title),
        title_justify="left",
        title_style="bold",
        caption=_escaped(content.caption) or None,
        caption_justify="left",
    )
    for column in content.columns:
        table.add_column(_escaped(column))
    for row in content.rows:
        table.add_row(*(_escaped(format_cell(cell)) for cell in row))
    return table


def _escaped(cell: str) -> str:
    return cell.replace("[", r"\[")
