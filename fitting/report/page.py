"""Writing of a calibration's files: `report.html` (self-contained), `results.json`, and the
posterior draws as NetCDF in ArviZ' layout. The contents of the page and of the results are computed
before the first file is written, so that a failure leaves no incomplete file."""

import csv
import json
import math
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from jaxvision import __version__
from jaxvision.files.images import replaced_on_success
from jaxvision.plots.inline import figure_strips

from ..inference.estimates import Estimate
from ..inference.formatting import format_cell, format_unit, size_in_words
from .chains import chain_pictures, write_chains
from .section import Input, Picture, Section, Table
from .sentences import said_once
from .sheet import sheet

WIDE = 520  # px of a figure that needs the width of the page
NARROW = 390  # px of the widest strip of a figure, for a phone
PACKAGES = ("jax", "optimistix", "jaxopt", "emcee", "numpy", "scipy")


def versions() -> dict[str, str]:
    """Return the versions of this package and of the packages on which its results depend."""
    return {"jaxvision": __version__} | {name: version(name) for name in PACKAGES}


def as_json(sections: Sequence[Section], *, seed: int, settings: dict[str, Any]) -> str:
    """Return estimates with units and intervals, findings, tables and settings as JSON."""
    parts = ("kind", "title", "estimates", "findings", "tables", "settings", "inputs")
    content = {
        "created": _current_time(),
        "seed": seed,
        "versions": versions(),
        "settings": settings,
        "sections": [{part: getattr(section, part) for part in parts} for section in sections],
    }
    return json.dumps(_finite(content), indent=2, ensure_ascii=False, allow_nan=False)


def as_html(sections: Sequence[Section], *, title: str) -> str:
    """Return the report as one HTML page with embedded figures."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("fitting.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
    )
    environment.filters |= {
        function.__name__: function
        for function in (chain_pictures, format_cell, format_unit, said_once, sheet, size_in_words)
    } | {"drawn": _draw}
    return environment.get_template("report.html.j2").render(
        title=title, created=_current_time(), versions=versions(), sections=sections
    )


def write_report(
    folder: Path, sections: Sequence[Section], *, title: str, seed: int, settings: dict[str, Any]
) -> list[Path]:
    """Write report, results, draws and fitted records to a folder; return the paths."""
    page = as_html(sections, title=title)
    data = as_json(sections, seed=seed, settings=settings)
    written = []
    for name, text in (("report.html", page), ("results.json", data)):
        with replaced_on_success(folder / name) as partial:
            partial.write_text(text, encoding="utf-8")
        written.append(folder / name)
    for section in sections:
        if section.posteriors:
            path = folder / f"{section.kind}_chains.nc"
            write_chains(path, section.posteriors, arrays=section.arrays, data=section.data)
            written.append(path)
        for name, columns in section.data.items():
            path = folder / f"{name}.csv"
            with replaced_on_success(path) as partial, partial.open("w", newline="") as stream:
                rows = csv.writer(stream)
                rows.writerow(columns)
                rows.writerows(zip(*columns.values(), strict=True))
            written.append(path)
        for name, write in section.records.items():
            write(folder / f"{name}.toml")
            written.append(folder / f"{name}.toml")
    return written


@dataclass(frozen=True)
class _Drawn:
    """A figure as SVG elements for the page."""

    title: str
    caption: str
    strips: tuple[tuple[str, int], ...]  # elements, and their widths in px as they were drawn
    aspect: float  # total width over height

    @property
    def is_wide(self) -> bool:
        """Whether a figure needs the whole width of the page to be legible."""
        return sum(width for _, width in self.strips) > WIDE


def _draw(pictures: Sequence[Picture]) -> list[_Drawn]:
    from markupsafe import Markup

    found = []
    for picture in pictures:
        strips = figure_strips(picture.figure, widest=math.inf if picture.is_whole else NARROW)
        sizes = np.array([re.findall(r'viewBox="0 0 ([\d.]+) ([\d.]+)', svg)[0] for svg in strips])
        widths, heights = sizes.astype(float).T
        drawn = tuple(zip(map(Markup, strips), np.rint(widths).astype(int), strict=True))
        aspect = round(float(widths.sum() / heights[0]), 3)
        found.append(_Drawn(picture.title, picture.caption, drawn, aspect))
    return found


def _current_time() -> str:
    return datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")


def _finite(content: Any) -> Any:
    """Convert to JSON's types: arrays to lists, numbers that are not finite to null."""
    match content:
        case Input():
            return {part: getattr(content, part) for part in ("files", "kind", "settings", "bytes")}
        case Estimate() | Table():
            return _finite(asdict(content))
        case dict():
            return {str(key): _finite(value) for key, value in content.items()}
        case list() | tuple():
            return [_finite(value) for value in content]
        case np.ndarray():
            return _finite(content.tolist())
        case bool() | str() | int() | None:
            return content
        case float() | np.floating():
            return float(content) if np.isfinite(content) else None
        case np.integer():
            return int(content)
        case Path():
            return content.name
    return str(content)
