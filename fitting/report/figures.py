"""What figures share: empty panels, and colours that are distinguishable on white and on black."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RED, GREEN, BLUE = "#d1495b", "#2e9e5b", "#3b82c4"
ORANGE, GREY = "tab:orange", "0.45"
OF_CHANNEL = {
    "red": RED,
    "green": GREEN,
    "green 1": GREEN,
    "green 2": "tab:olive",
    "blue": BLUE,
    "grey": "0.5",
}
OF_TAPS = "0.5", "tab:orange", "tab:purple", "tab:cyan"


def colour_of(channel: str) -> str:
    """Return the colour of a channel. If taps are the only channels, each tap has its own
    colour."""
    colour, _, place = channel.partition("tap ")
    if colour:
        return OF_CHANNEL[colour.strip()]
    if "," not in place:
        row, column = "bottom" in place, "right" in place
    else:
        row, column = map(int, place.split(","))
    return OF_TAPS[(2 * row + column) % len(OF_TAPS)]


def empty_panels(
    size: tuple[float, float], *, rows: int = 1, columns: int = 1, **options: Any
) -> "tuple[Figure, Any]":
    """Return an empty figure of (width, height) in inches, with its axes as `Figure.subplots`
    returns them."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, **options)
