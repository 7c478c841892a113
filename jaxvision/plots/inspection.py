"""Show five views of an image in one figure."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from . import _views as views
from .summary import checked, summarise, white_level

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def inspect(
    image: np.ndarray,
    *,
    row: int | None = None,
    at: tuple[int, int] | None = None,
    white: float | None = None,
    title: str = "",
    names: Sequence[str] = (),
) -> "Figure":
    """Plot an image in one figure with five views: a picture, a histogram, a scan line, printed
    values and a surface.

    Args:
        image: (h, w) or (h, w, bands), DN or relative; 1 to 4 bands are grey, grey and alpha, RGB
            and RGBA.
        row: index of the row for the scan line, from 0 at the top; None for the row of `at`.
        at: (row, column) of the pixel whose neighbourhood is printed; None for the middle.
        white: the value from which a pixel counts as saturated, as for `summarise`.
        title: title of the figure.
        names: names of the bands; empty for those of `band_names`.

    Returns:
        The figure.

    Raises:
        InputError: for an array that is no image, and for a row or pixel outside it.
    """
    from matplotlib.figure import Figure

    pixels = checked(image)
    height, width, _ = pixels.shape
    place = (height // 2, width // 2) if at is None else at
    line = place[0] if row is None else row
    if not 0 <= line < height:
        raise InputError(f"row {line} is outside the image; it has rows 0 to {height - 1}.")
    if not (0 <= place[0] < height and 0 <= place[1] < width):
        raise InputError(
            f"pixel ({place[0]}, {place[1]}) is outside the image; it has rows 0 to {height - 1} "
            f"and columns 0 to {width - 1}."
        )
    limit = white_level(pixels, white)
    picture, how = views.as_picture(pixels, limit)
    rows, columns = (_window(*pair) for pair in zip(place, (height, width), strict=True))

    figure = Figure(figsize=(13, 8.4), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.08, h_pad=0.08, wspace=0.04, hspace=0.05)  # type: ignore[union-attr]
    grid = figure.add_gridspec(2, 3, width_ratios=(1.05, 1, 1))
    views.draw_picture(figure.add_subplot(grid[0, 0]), picture, how, line, rows, columns)
    bands = summarise(pixels, white=limit, names=names)
    called = [band.name for band in bands]
    views.draw_histogram(figure.add_subplot(grid[0, 1]), pixels, limit, called)
    views.draw_scan_line(figure.add_subplot(grid[0, 2]), pixels, line, called)
    views.draw_numbers(figure.add_subplot(grid[1, 0]), pixels, picture, rows, columns, called)
    views.draw_surface(figure.add_subplot(grid[1, 1], projection="3d"), pixels)  # type: ignore[arg-type]
    views.draw_summary(figure.add_subplot(grid[1, 2]), bands, limit)
    shape = f"{height} × {width}" + (f" × {pixels.shape[2]}" if pixels.shape[2] > 1 else "")
    figure.suptitle(f"{title}   {shape}, {pixels.dtype}".strip(), fontsize=12)
    return figure


def _window(centre: int, size: int) -> range:
    """Return the range of up to 7 pixels around a pixel, within the image."""
    side = min(7, size)
    start = min(max(centre - side // 2, 0), size - side)
    return range(start, start + side)
