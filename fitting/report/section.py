"""What a calibration hands to its reader: estimates, findings in words, tables and pictures."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..inference.estimates import Estimate
from ..inference.posterior import Posterior

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Columns = dict[str, np.ndarray]  # of equal length, by their heads


@dataclass(frozen=True)
class Table:
    """Rows of text or numbers under column heads.

    Attributes:
        title: above it.
        columns: heads.
        rows: cells; floats are shown to four digits, None as a dash.
        caption: below it.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]
    caption: str = ""


@dataclass(frozen=True)
class Picture:
    """A figure, drawn only when a report asks for it.

    Attributes:
        name: a word.
        title: above it.
        caption: what it shows and how to read it.
        draw: the function that draws it.
    """

    name: str
    title: str
    caption: str
    draw: "Callable[[], Figure]"


@dataclass(frozen=True)
class Section:
    """One calibration as its reader sees it.

    Attributes:
        kind: a word; chains are stored under it.
        title: heading.
        estimates: rows of the table of results.
        findings: full sentences: misfit, identifiability, what was masked or refused.
        pictures: the most telling one first.
        tables: beside the estimates.
        posteriors: by group.
        settings: everything needed to repeat the fit.
        data: what is too long for a table, whole: columns by the name of their file.
        records: what was fitted, for use in a simulation: by the name of its file the function that
            writes it to a path, ending in .toml.
    """

    kind: str
    title: str
    estimates: tuple[Estimate, ...]
    findings: tuple[str, ...] = ()
    pictures: tuple[Picture, ...] = ()
    tables: tuple[Table, ...] = ()
    posteriors: dict[str, Posterior] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)
    data: dict[str, Columns] = field(default_factory=dict)
    records: dict[str, Callable[[Path], None]] = field(default_factory=dict)
