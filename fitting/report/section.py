"""The results of a calibration for a report: estimates, findings, tables and figures."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxvision.errors import InputError, nearest

from ..inference.estimates import Estimate, find, not_determined
from ..inference.posterior import Posterior
from ..inference.precision import double_precision
from ..inference.trust import convergence_in_words

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Columns = dict[str, np.ndarray]  # arrays of equal length by column heading


@dataclass(frozen=True)
class Table:
    """A table of a report: rows of text or numbers under column headings.

    Attributes:
        title: heading above the table.
        columns: column headings.
        rows: cells; floats are shown to four digits, None as a dash.
        caption: text below the table.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]
    caption: str = ""


@dataclass(frozen=True)
class Picture:
    """A figure of a report, drawn only when it is requested.

    Attributes:
        name: one word, by which `Section.figure` finds the figure.
        title: heading above the figure.
        caption: text on what the figure shows and how to read it.
        draw: the function that draws the figure.
        is_whole: whether the columns of the figure must be seen side by side. If not, a narrow page
            may place the columns one below the other.
    """

    name: str
    title: str
    caption: str
    draw: "Callable[[], Figure]"
    is_whole: bool = False

    def figure(self) -> "Figure":
        """Draw the figure, with numbers in double precision."""
        return double_precision(self.draw)()

    def __repr__(self) -> str:
        return f"Picture({self.name!r}, {self.title!r})"  # the data behind the figure may be long


@dataclass(frozen=True)
class Input:
    """An input of a calibration: an image file, or several files of one setting.

    Attributes:
        files: names of the files.
        kind: of the files: flat, dark, exposure or light.
        settings: settings that the rig states for the files, in words.
        bytes: size of all files; None if a file has been removed since.
        picture: function that returns a small PNG of the first file, base64-encoded, or None if
            that file has been removed since; None for files without a thumbnail.
    """

    files: tuple[str, ...]
    kind: str
    settings: str
    bytes: int | None
    picture: Callable[[], str | None] | None = None


@dataclass(frozen=True)
class Section:
    """The report of one calibration: estimates, findings, figures, tables, posteriors and settings.

    Attributes:
        kind: one word, such as "noise", under which chains are stored.
        title: heading of the section.
        estimates: rows of the table of results.
        findings: full sentences on misfit, on identifiability, and on masked or refused data.
        pictures: figures, the most important first.
        tables: further tables, below the table of estimates.
        posteriors: the posterior of each group (channel, site or setting).
        arrays: shapes of array parameters, by name. The posteriors list the numbers of such arrays
            one by one.
        settings: all settings that are needed to repeat the fit.
        about: one line under the heading on what was measured.
        headings: names of estimates under each heading of the table of estimates, in its order.
        truth: true values of the parameters of a simulation, by (name, group).
        inputs: source files of the data.
        data: data that are too long for a table: columns by the name of the file to which they are
            written.
        records: for each fitted record (such as a sensor) that a simulation can use, the function
            that writes the record to a path, by the name of the file (ending in .toml).
        failure: sentence with the reason why there are no results; empty where there are results.
        headline: the finding that no model describes the data, shown above the estimates; empty if
            a model describes the data.
    """

    kind: str
    title: str
    estimates: tuple[Estimate, ...]
    findings: tuple[str, ...] = ()
    pictures: tuple[Picture, ...] = ()
    tables: tuple[Table, ...] = ()
    posteriors: dict[str, Posterior] = field(default_factory=dict)
    arrays: dict[str, tuple[int, ...]] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)
    about: str = ""
    headings: dict[str, tuple[str, ...]] = field(default_factory=dict)
    truth: dict[tuple[str, str], float] = field(default_factory=dict)
    inputs: tuple[Input, ...] = ()
    data: dict[str, Columns] = field(default_factory=dict)
    records: dict[str, Callable[[Path], None]] = field(default_factory=dict)
    failure: str = ""
    headline: str = ""

    def estimate(self, name: str, *, method: str = "", group: str = "") -> Estimate:
        """Return the first estimate with a given name and, if given, method and group."""
        return find(self.estimates, name, method=method, group=group)

    def figure(self, name: str) -> "Figure":
        """Draw the figure with a given name."""
        drawn = {picture.name: picture.figure for picture in self.pictures}
        if name not in drawn:
            raise InputError(
                f"there is no picture {name!r} of {self.kind}; {nearest(name, drawn)}."
            )
        return drawn[name]()


def word_for_file(label: str) -> str:
    """Convert a label to a word for a file name."""
    return "_".join(label.lower().replace(",", " ").replace("-", "minus_").split())


def section_of_part(section: Section, part: str) -> Section:
    """Return the section for one site, tap or setting of a camera. The name `part` is added to the
    kind, title and estimates of the section, and the section writes no camera file."""
    return replace(
        section,
        kind=f"{section.kind}_{word_for_file(part)}",
        title=f"{section.title}: {part}",
        estimates=tuple(
            replace(one, group=f"{part} {one.group}".strip()) for one in section.estimates
        ),
        records={},
    )


def failed_section(kind: str, title: str, why: str, *, known: Sequence[str] = ()) -> Section:
    """Return the section of a failed calibration, with the reason and `known` findings."""
    return Section(kind=kind, title=title, estimates=(), findings=(why, *known), failure=why)


def describing_nothing(section: Section, headline: str, groups: Collection[str]) -> Section:
    """Return a section for a model that does not describe the data of some groups. A headline
    states this, the estimates of these groups are withheld, and no records are written."""
    why = "the model does not describe the data (see the first sentence)"
    return replace(
        section,
        headline=headline,
        findings=(headline, *section.findings),
        estimates=tuple(
            not_determined(one, why, method=one.method, group=one.group)
            if one.group in groups and one.value is not None
            else one
            for one in section.estimates
        ),
        records={},
    )


def drop_short_chains(section: Section, *, kept: bool) -> Section:
    """Return the section, without its estimates if a chain is too short."""
    short = [(group, one) for group, one in section.posteriors.items() if one.missing_steps]
    if not short:
        return section
    group, worst = max(short, key=lambda pair: pair[1].missing_steps)
    steps = f"--steps {worst.steps + worst.missing_steps}"
    if kept:
        remedy = f"allow {steps} and run again: it goes on from here."
    else:
        remedy = f"allow {steps}; with --out it would go on from here."
    why = f"{group}{': ' if group else ''}{convergence_in_words(worst)[:-1]}; {remedy}"
    return Section(
        kind=section.kind,
        title=section.title,
        estimates=(),
        findings=(why,),
        about=section.about,
        settings=section.settings,
        inputs=section.inputs,
        failure=why,
    )
