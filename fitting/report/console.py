"""Results as tables and sentences on standard output."""

import io
import sys
from collections.abc import Sequence
from dataclasses import replace

from rich.console import Console
from rich.table import Table as RichTable

from ..inference.estimates import Estimate
from .formatting import format_cell, format_interval, format_name, format_unit, format_value
from .section import Section, Table
from .sentences import said_once

PLAIN_WIDTH = 170  # columns where the output is not a terminal, which would tell its width


def output() -> Console:
    """Standard output, wide enough for whole tables when it is piped."""
    return Console(width=None if sys.stdout.isatty() else PLAIN_WIDTH, highlight=False)


def print_section(console: Console, section: Section) -> None:
    """The estimates of a calibration as a table, its findings as sentences under it."""
    console.print()
    if section.estimates:
        console.print(estimate_table(section.title, section.estimates))
    for estimate in section.estimates:
        if estimate.reason:
            console.print(
                f"  {_label(estimate)}: not determined: {estimate.reason}", soft_wrap=True
            )
    for table in section.tables:
        console.print(plain_table(table))
    for finding in said_once(section.findings):
        console.print(f"• {finding}", soft_wrap=True)


def section_text(section: Section) -> str:
    """Estimates and findings of a calibration, as `print` shows them.

    Args:
        section: of a report.

    Returns:
        Lines, without the end of the last.
    """
    console = Console(file=io.StringIO(), width=PLAIN_WIDTH, highlight=False, color_system=None)
    with console.capture() as printed:
        print_section(console, replace(section, tables=()))
    return "\n".join(line.rstrip() for line in printed.get().strip().splitlines())


def estimate_table(title: str, estimates: Sequence[Estimate]) -> RichTable:
    """What is determined, a row each."""
    table = RichTable(title=title, title_justify="left", title_style="bold")
    grouped = any(estimate.group for estimate in estimates)
    heads = ["quantity", "value ± s.e.", "unit", "68 %", "95 %", "method"]
    for head in (["channel"] if grouped else []) + heads:
        table.add_column(head, no_wrap=head in ("value ± s.e.", "68 %", "95 %"))
    for estimate in estimates:
        if estimate.reason:
            continue
        cells = [
            format_name(estimate.name),
            format_value(estimate),
            format_unit(estimate.unit),
            format_interval(estimate, 68),
            format_interval(estimate, 95),
            estimate.method,
        ]
        table.add_row(*([estimate.group] if grouped else []), *(_escaped(cell) for cell in cells))
    return table


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


def _label(estimate: Estimate) -> str:
    name = format_name(estimate.name)
    return f"{name} ({estimate.method})" if estimate.method else name


def _escaped(cell: str) -> str:
    return cell.replace("[", r"\[")
