"""Convert figures to SVG for HTML pages, in the text colour of the page, which may be dark or
light."""

import io
import math
import re
from collections.abc import Callable
from itertools import pairwise
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    _Strip = tuple[float, float, tuple[Axes, ...]]

INK = "#010203"  # drawn in this colour, which is replaced by that of the page's text
_INKED = "text.color axes.edgecolor axes.labelcolor axes.titlecolor xtick.color ytick.color"
_REPLACED = {  # black, dark grey, white and pale grey are replaced by colours of the page
    INK: "currentColor",
    "#000000": "currentColor",
    "#404040": "currentColor",
    "#4d4d4d": "currentColor",
    "#ffffff": "var(--paper, #ffffff)",
    "#ededed": "var(--tint, #ededed)",
}
_COLOUR = re.compile("|".join(_REPLACED))
POINTS = 72  # per inch
DOTS_PER_INCH = 130  # resolution of pictures and clouds of points, which remain pixels


def inline_svg(
    draw: "Callable[[Axes], None]", *, size: tuple[float, float] = (4.8, 3.6), font: float = 11
) -> str:
    """Draw a plot as an `<svg>` for HTML that is as wide as its container; `size` is in inches.
    Text remains text in the SVG, of the given size in points. Lines in the colour `INK` take the
    text colour of the page."""

    def make_figure() -> "Figure":
        from matplotlib.figure import Figure

        figure = Figure(figsize=size, layout="constrained")
        draw(figure.add_subplot())
        return figure

    return figure_svg(make_figure, font=font)


def figure_svg(draw: "Callable[[], Figure]", *, font: float = 10) -> str:
    """Convert a figure to an `<svg>` for HTML that is as wide as its container. Text stays text, of
    the given size in points, and black and white become the colours of the page."""
    (whole,) = figure_strips(draw, widest=math.inf, font=font)
    return whole


def figure_strips(
    draw: "Callable[[], Figure]", *, widest: float, font: float = 10
) -> tuple[str, ...]:
    """Convert a figure as `figure_svg` does, but divide the figure between columns of panels into
    as few pieces as possible, each at most `widest` points wide. On a narrow page, the pieces are
    then shown below each other."""
    import matplotlib
    from matplotlib.transforms import Bbox

    style: dict[Any, Any] = dict.fromkeys(_INKED.split(), INK)
    style |= {"svg.fonttype": "none", "font.size": font, "svg.hashsalt": "jaxvision"}
    with matplotlib.rc_context(style):
        figure = draw()
        figure.patch.set_alpha(0)
        for axes in figure.axes:
            axes.patch.set_alpha(0)
        width, height = figure.get_size_inches()
        if POINTS * width <= widest or figure.texts or figure.legends:
            return (_svg(figure),)
        strips = _strips(_columns(figure), widest / POINTS)
        figure.set_layout_engine("none")  # the size as drawn, even if panels are hidden
        cuts = [0.0, *((a[1] + b[0]) / 2 for a, b in pairwise(strips)), float(width)]
        found = []
        for (_, _, own), (left, right) in zip(strips, pairwise(cuts), strict=True):
            for axes in figure.axes:
                axes.set_visible(axes in own)
            found.append(_svg(figure, bbox_inches=Bbox([[left, 0], [right, height]])))
        return tuple(found)


def _columns(figure: "Figure") -> "list[_Strip]":
    """Return, for each column of panels, the left and right end in inches, including labels, and
    the panels."""
    figure.draw_without_rendering()
    found: list[_Strip] = []
    boxes = [(axes.get_tightbbox(), axes) for axes in figure.axes]
    ends = [(box.x0 / figure.dpi, box.x1 / figure.dpi, axes) for box, axes in boxes if box]
    for left, right, axes in sorted(ends, key=lambda end: end[:2]):
        if found and left < found[-1][1]:
            start, end, own = found.pop()
            found.append((start, max(end, right), (*own, axes)))
        else:
            found.append((left, right, (axes,)))
    return found


def _strips(columns: "list[_Strip]", widest: float) -> "list[_Strip]":
    """Join neighbouring columns of panels into as few strips as the largest width allows. The
    strips have similar widths."""
    packed = _pack(columns, widest)
    for limit in sorted(b[1] - a[0] for a in columns for b in columns if a[0] < b[1]):
        alike = _pack(columns, limit)
        if limit <= widest and len(alike) == len(packed):
            return alike
    return packed


def _pack(columns: "list[_Strip]", widest: float) -> "list[_Strip]":
    found = columns[:1]
    for left, right, own in columns[1:]:
        start, _, others = found[-1]
        if right - start <= widest:
            found[-1] = start, right, (*others, *own)
        else:
            found.append((left, right, own))
    return found


def _svg(figure: "Figure", **options: Any) -> str:
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None}, dpi=DOTS_PER_INCH, **options)
    svg = buffer.getvalue()
    svg = _COLOUR.sub(lambda found: _REPLACED[found[0]], svg[svg.index("<svg") :])
    svg = re.sub(r'<g id="[^"]*"', "<g", svg)  # pages contain many groups, to which nothing refers
    return re.sub(r' (width|height)="[^"]*pt"', "", svg, count=2)
