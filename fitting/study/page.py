"""Write the comparison of a study's cameras as one page with links to the reports."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from jaxvision import __version__
from jaxvision.plots.inline import INK, inline_svg

from ..report.figures import BLUE, RED
from .compare import Compared, Drift
from .outcomes import Outcome

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST = 12  # most figures, quantities with outliers first
MOST_NAMED = 3  # most quantities named in which a camera differs from the others
TALLEST = 60  # most cameras named beside an axis


def page(
    title: str,
    outcomes: Sequence[Outcome],
    found: xr.Dataset,
    quantities: Sequence[Compared],
    drifting: Sequence[Drift],
    *,
    shown: str = "report.html",
) -> str:
    """Return the page as HTML that contains its figures as SVG."""
    import jinja2
    from markupsafe import Markup

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("fitting.study"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
    )
    drawn = sorted(quantities, key=lambda one: (not one.outliers, not one.differ))[:MOST]
    return environment.get_template("study.html.j2").render(
        title=title,
        outcomes=outcomes,
        quantities=quantities,
        drifting=drifting,
        shown=shown,
        unlike=_unlike(quantities),
        figures=[(one, Markup(_svg(one, found))) for one in drawn],
        left_out=max(len(quantities) - MOST, 0),
        version=__version__,
    )


def _unlike(quantities: Sequence[Compared]) -> dict[str, str]:
    """Return, for each camera, the quantities in which it deviates from the others, largest ratio
    first.

    One cause may affect many quantities, so a few are named and the others counted.
    """
    found: dict[str, list[tuple[float, str]]] = {}
    for one in quantities:
        name = f"{one.quantity} {one.channel}".strip()
        unit = "" if one.unit == "1" else f" {one.unit}"
        for camera, value in zip(one.outliers, one.values, strict=True):
            ratio = value / one.median if one.median else np.inf
            words = f"{name} {value:.4g}{unit} (median {one.median:.4g})"
            found.setdefault(camera, []).append((-abs(np.log(abs(ratio) or 1e-300)), words))
    named = {}
    for camera, several in found.items():
        words = [text for _, text in sorted(several)]
        more = len(words) - MOST_NAMED
        rest = [f"{more} more quantities, below"] if more > 1 else words[MOST_NAMED:]
        named[camera] = "; ".join([*words[:MOST_NAMED], *rest])
    return named


def _svg(one: Compared, found: xr.Dataset) -> str:
    """Draw the values of a quantity with their 95 % intervals, smallest first, and the median, as
    SVG.
    """
    some = found.sel(quantity=one.quantity, channel=one.channel)
    some = some.isel(camera=np.isfinite(some["value"].values)).sortby("value")
    names, values = some["camera"].values, some["value"].values
    unlike, y = np.isin(names, one.outliers), np.arange(len(names))

    def draw(axes: "Axes") -> None:
        axes.hlines(y, some["low_95"].values, some["high_95"].values, color=BLUE, linewidth=1.5)
        axes.plot(values[~unlike], y[~unlike], "o", color=BLUE, markersize=4)
        axes.plot(values[unlike], y[unlike], "D", color=RED, markersize=5)
        axes.axvline(one.median, color=INK, linewidth=0.8, linestyle="--")
        shown = len(names) <= TALLEST
        axes.set_yticks(y if shown else [], names if shown else [])
        axes.set_xlabel(one.quantity + ("" if one.unit == "1" else f" / {one.unit}"))
        axes.spines[["top", "right"]].set_visible(False)

    height = 1.0 + 0.2 * min(len(names), TALLEST)
    return inline_svg(draw, size=(5.2, max(height, 2.0)), font=10)
