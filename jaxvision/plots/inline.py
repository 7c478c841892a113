"""Figures inside a page, in the colours of its text, dark or light as the reader prefers."""

import io
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INK = "#010203"  # drawn so, and replaced by the colour of the page's text
_INKED = "text.color axes.edgecolor axes.labelcolor axes.titlecolor xtick.color ytick.color"


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
    import matplotlib
    from matplotlib.figure import Figure

    style: dict[Any, Any] = dict.fromkeys(_INKED.split(), INK)
    style |= {"svg.fonttype": "none", "font.size": font, "svg.hashsalt": "jaxvision"}
    with matplotlib.rc_context(style):
        figure = Figure(figsize=size, layout="constrained")
        axes = figure.add_subplot()
        axes.patch.set_alpha(0)
        figure.patch.set_alpha(0)
        draw(axes)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :].replace(INK, "currentColor")
    return re.sub(r' (width|height)="[^"]*pt"', "", svg, count=2)
