"""Axes to draw on."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def new_axes(axes: "Axes | None", *, polar: bool = False) -> "Axes":
    """The given axes, or the only one of a new figure."""
    from matplotlib.figure import Figure

    if axes is not None:
        return axes
    figure = Figure(figsize=(4.8, 3.6), layout="constrained")
    return figure.add_subplot(projection="polar") if polar else figure.add_subplot()


def tidy(axes: "Axes") -> None:
    """A quiet grid, and no frame above and to the right."""
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
