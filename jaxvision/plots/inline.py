"""Figures inside a page, in the colours of its text, dark or light as the reader prefers."""

import io
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK = "#010203"  # drawn so, and replaced by the colour of the page's text
_INKED = "text.color axes.edgecolor axes.labelcolor axes.titlecolor xtick.color ytick.color"
_REPLACED = {  # what is drawn in black, dark grey, white and pale grey follows the page
    INK: "currentColor",
    "#000000": "currentColor",
    "#404040": "currentColor",
    "#4d4d4d": "currentColor",
    "#ffffff": "var(--paper, #ffffff)",
    "#ededed": "var(--tint, #ededed)",
}
_COLOUR = re.compile("|".join(_REPLACED))
DOTS_PER_INCH = 130  # of pictures and clouds of points, which stay pixels


def inline_svg(
    draw: "Callable[[Axes], None]", *, size: tuple[float, float] = (4.8, 3.6), font: float = 11
) -> str:
    """One axes as SVG that stands inside HTML and takes the width that it is given.

    Args:
        draw: draws on the axes; what it draws in `INK` has the colour of the page's text.
        size: width and height, inches at the size of `font`.
        font: points.

    Returns:
        The `<svg>` element; its text is text.
    """

    def drawn() -> "Figure":
        from matplotlib.figure import Figure

        figure = Figure(figsize=size, layout="constrained")
        draw(figure.add_subplot())
        return figure

    return figure_svg(drawn, font=font)


def figure_svg(draw: "Callable[[], Figure]", *, font: float = 10) -> str:
    """A figure as SVG that stands inside HTML and takes the width that it is given.

    Black and white follow the page's text and background; the background itself is not drawn.

    Args:
        draw: makes the figure; artists that it rasterises stay pixels.
        font: points.

    Returns:
        The `<svg>` element; its text is text.
    """
    import matplotlib

    style: dict[Any, Any] = dict.fromkeys(_INKED.split(), INK)
    style |= {"svg.fonttype": "none", "font.size": font, "svg.hashsalt": "jaxvision"}
    with matplotlib.rc_context(style):
        figure = draw()
        figure.patch.set_alpha(0)
        for axes in figure.axes:
            axes.patch.set_alpha(0)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None}, dpi=DOTS_PER_INCH)
    svg = buffer.getvalue()
    svg = _COLOUR.sub(lambda found: _REPLACED[found[0]], svg[svg.index("<svg") :])
    svg = re.sub(r'<g id="[^"]*"', "<g", svg)  # nothing refers to groups, and pages hold many
    return re.sub(r' (width|height)="[^"]*pt"', "", svg, count=2)
