"""What a notebook shows of a calibration: its estimates with intervals, and its findings."""

from html import escape
from importlib import import_module

from .section import Section
from .sentences import said_once
from .sheet import Cell, sheet


class ShownInNotebooks:
    """A calibration that a notebook shows by the section of its report, which the module `section`
    beside its own makes."""

    def _repr_html_(self) -> str:
        module = import_module(type(self).__module__.rpartition(".")[0] + ".section")
        return section_html(module.section(self))


def section_html(section: Section) -> str:
    """The estimates and findings of a section.

    Args:
        section: of a report.

    Returns:
        HTML.
    """
    found = sheet(section)
    head = "".join(f"<th>{escape(word)}</th>" for word in ("", *found.columns, "unit"))
    rows = "".join(
        f"<tr><td>{escape(row.name)}</td>{''.join(map(_cell, row.cells))}"
        f"<td>{escape(row.unit)}</td></tr>"
        for _, block in found.blocks
        for row in block
    )
    notes = "".join(f"<li>{escape(text)}</li>" for text in said_once(section.findings))
    missing = "".join(
        f"<br><sup>{i}</sup> Not determined: {escape(note)}."
        for i, note in enumerate(found.notes, 1)
    )
    return (
        f'<p><b>{escape(section.title)}</b></p><div style="overflow-x: auto"><table><tr>{head}</tr>'
        f"{rows}</table></div><p>Value ± standard error, 95 % interval.{missing}</p>"
        f"<ul>{notes}</ul>"
    )


def _cell(cell: Cell) -> str:
    note = f"<sup>{cell.note}</sup>" if cell.note else ""
    return f"<td>{escape(cell.value)}{note} {escape(cell.interval)}</td>"
