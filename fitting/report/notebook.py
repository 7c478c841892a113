"""Display of a calibration in notebooks and by `print`: estimates with intervals, and findings."""

from dataclasses import replace
from functools import cached_property
from html import escape
from importlib import import_module

import numpy as np

from ..inference.precision import double_precision
from ..inference.trust import cost_in_words
from .section import Section
from .sentences import said_once
from .sheet import Cell, sheet


class ShownInNotebooks:
    """Base class of calibrations, which a notebook shows by their package's `section`."""

    @cached_property
    def section(self) -> Section:
        """The report section: estimates, findings, tables, and figures by `section.figure`."""
        module = import_module(type(self).__module__.rpartition(".")[0] + ".section")
        return double_precision(module.section)(self)

    def _repr_html_(self) -> str:
        return section_html(_add_cost(self.section))

    def __repr__(self) -> str:
        from .console import section_text  # imports rich, which calibrations do not need

        return section_text(_add_cost(self.section))


def _add_cost(section: Section) -> Section:
    """Return the section with a finding on the errors of the fit's approximations."""
    cost = cost_in_words(section.posteriors.values(), np.nan, argument="sampling")
    return replace(section, findings=(*section.findings, cost)) if cost else section


def section_html(section: Section) -> str:
    """Return the estimates and findings of a section as HTML."""
    found = sheet(section)
    shown = [row for _, block in found.blocks for row in block]
    units = any(row.unit for row in shown)  # a section with gamma alone has no units
    heads = ("", *found.columns, *(("unit",) if units else ()))
    head = "".join(f"<th>{escape(word)}</th>" for word in heads)
    rows = "".join(
        f"<tr><td>{escape(row.name)}</td>{''.join(map(_cell, row.cells))}"
        f"{f'<td>{escape(row.unit)}</td>' if units else ''}</tr>"
        for row in shown
    )
    sentences = said_once([one for one in section.findings if one != section.headline])
    notes = "".join(f"<li>{escape(text)}</li>" for text in sentences)
    headline = f"<p><b>{escape(section.headline)}</b></p>" if section.headline else ""
    missing = "".join(
        f"<br><sup>{i}</sup> Not determined: {escape(note)}."
        for i, note in enumerate(found.notes, 1)
    )
    return (
        f"{headline}<p><b>{escape(section.title)}</b></p>"
        f'<div style="overflow-x: auto"><table><tr>{head}</tr>'
        f"{rows}</table></div><p>Value ± standard error, 95 % interval.{missing}</p>"
        f"<ul>{notes}</ul>"
    )


def _cell(cell: Cell) -> str:
    note = f"<sup>{cell.note}</sup>" if cell.note else ""
    return f"<td>{_without_breaks(cell.value)}{note} {_without_breaks(cell.interval)}</td>"


def _without_breaks(text: str) -> str:
    """Return the text as HTML in which no line break is allowed."""
    return (
        f'<span style="white-space: nowrap">{escape(text)}</span>' if " " in text else escape(text)
    )
