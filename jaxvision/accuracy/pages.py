"""A self-contained page of curves, dark or light as the reader prefers, and its numbers as JSON."""

import json
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from ..io import replaced_on_success
from ..plots.inline import inline_svg
from .plots import front, plot
from .records import Curve, Problem
from .scene_settings import machine
from .tables import as_dict, notes, rows

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def page(problem: Problem, curves: Sequence[Curve], *, command: str) -> str:
    """The page.

    Args:
        problem: whose knobs they are.
        curves: of the knobs, error against time in s.
        command: by which it can be repeated.

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
    drawn = [(curve.knob.about, _svg([curve])) for curve in curves]
    if len(curves) > 1:
        drawn.append(("every knob with the others at rest", _svg(curves)))
    return environment.get_template("accuracy.html.j2").render(
        title=problem.name,
        rows=rows(problem, curves),
        notes=notes(curves),
        figures=[(about, Markup(svg)) for about, svg in drawn],
        machine=machine(),
        command=command,
        about=problem.about,
        version=version("jaxvision"),
    )


def _svg(curves: Sequence[Curve]) -> str:
    """One curve, or the fronts of several."""

    def draw(axes: "Axes") -> None:
        if len(curves) == 1:
            plot(curves[0], axes=axes)
        else:
            front(curves, axes=axes)

    return inline_svg(draw)


def write_page(
    folder: Path, problem: Problem, curves: Sequence[Curve], *, command: str
) -> tuple[Path, Path]:
    """Writes the page and its numbers.

    Args:
        folder: made if needed.
        problem: whose knobs they are.
        curves: of the knobs, error against time in s.
        command: by which it can be repeated.

    Returns:
        Paths of `accuracy.html` and `accuracy.json`.
    """
    sheet = as_dict(problem, curves, machine=machine(), command=command)
    texts = {
        "accuracy.html": page(problem, curves, command=command),
        "accuracy.json": json.dumps(sheet, indent=2, ensure_ascii=False, allow_nan=False),
    }
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        with replaced_on_success(folder / name) as partial:
            partial.write_text(text, encoding="utf-8")
    return folder / "accuracy.html", folder / "accuracy.json"
