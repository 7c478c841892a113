"""What a calibration hands to its reader: estimates, findings in words, tables and pictures."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from ..inference.estimates import Estimate
from ..inference.posterior import Posterior

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Table:
    """Rows of text or numbers under column heads."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]
    caption: str = ""


@dataclass(frozen=True)
class Picture:
    """A figure drawn only when a report asks for it."""

    name: str
    title: str
    caption: str
    draw: "Callable[[], Figure]"


@dataclass(frozen=True)
class Section:
    """One calibration as its reader sees it, the first picture being the one to look at first.

    `findings` are full sentences: misfit, identifiability, what was masked or refused.
    `posteriors` are keyed by group; `settings` is everything needed to repeat the fit.
    """

    kind: str
    title: str
    estimates: tuple[Estimate, ...]
    findings: tuple[str, ...] = ()
    pictures: tuple[Picture, ...] = ()
    tables: tuple[Table, ...] = ()
    posteriors: dict[str, Posterior] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)
