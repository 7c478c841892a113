"""Write a self-contained HTML page of the measured curves, for light and dark displays, and their
numbers as JSON."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from .. import __version__
from ..files.images import replaced_on_success
from ..plots.inline import figure_svg
from .plots import front, plot
from .records import Curve, Problem
from .scene_settings import machine
from .several import Together, all_together
from .tables import json_sheet, notes, rows

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# shares of a figure for the axes: matplotlib's own layout takes as long as all the drawing
_WITHIN = (0.18, 0.15, 0.79, 0.7)


def page(
    problem: Problem,
    curves: Sequence[Curve],
    *,
    command: str,
    together: Sequence[Together] | None = None,
) -> str:
    """Make the HTML page of the measured curves.

    Args:
        problem: the problem whose settings were measured.
        curves: error against time of its settings, in s.
        command: the command that repeats the measurement.
        together: combinations of all settings, with or without a check run; None to compute them
            from the curves.

    Returns:
        HTML with the plots inside, as SVG.
    """
    import jinja2
    from markupsafe import Markup

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("jaxvision.accuracy"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
    )
    together = all_together(problem, curves) if together is None else together
    drawn = [(curve.knob.about, _svg([curve])) for curve in curves]
    if len(curves) > 1:
        drawn.append(("every knob, with the others at their values in the problem", _svg(curves)))
    return environment.get_template("accuracy.html.j2").render(
        title=problem.name,
        rows=rows(problem, curves, together=together),
        notes=notes(curves, together=together),
        figures=[(about, Markup(svg)) for about, svg in drawn],
        machine=machine(),
        command=command,
        about=problem.about,
        version=__version__,
    )


def _svg(curves: Sequence[Curve]) -> str:
    """Return an SVG figure of one curve, or of the Pareto fronts of several curves."""

    def draw() -> "Figure":
        from matplotlib.figure import Figure

        figure = Figure(figsize=(4.8, 3.6))
        axes = figure.add_axes(_WITHIN)
        if len(curves) == 1:
            plot(curves[0], axes=axes)
        else:
            front(curves, axes=axes)
        return figure

    return figure_svg(draw, font=11)


def write_page(
    folder: Path,
    problem: Problem,
    curves: Sequence[Curve],
    *,
    command: str,
    together: Sequence[Together] | None = None,
) -> tuple[Path, Path]:
    """Write the HTML page of the curves, and their numbers as JSON.

    Args:
        folder: the folder of the files; it is made if needed.
        problem: the problem whose settings were measured.
        curves: error against time of its settings, in s.
        command: the command that repeats the measurement.
        together: combinations of all settings, with or without a check run; None to compute them
            from the curves.

    Returns:
        Paths of `accuracy.html` and `accuracy.json`. Each file is written as soon as its contents
        are known.
    """
    sheet = json_sheet(problem, curves, together=together, machine=machine(), command=command)
    folder.mkdir(parents=True, exist_ok=True)
    numbers, drawn = folder / "accuracy.json", folder / "accuracy.html"
    _write(numbers, json.dumps(sheet, indent=2, ensure_ascii=False, allow_nan=False))
    _write(drawn, page(problem, curves, command=command, together=together))
    return drawn, numbers


def _write(file: Path, text: str) -> None:
    with replaced_on_success(file) as partial:
        partial.write_text(text, encoding="utf-8")
