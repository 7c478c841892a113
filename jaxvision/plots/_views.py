"""Draw the views in the figure of an image, one function for each view."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from ..histogram import exact_histogram
from ..point_ops import srgb_encode
from .summary import BandSummary, colours_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from mpl_toolkits.mplot3d import Axes3D

INK = {
    "grey": "0.25",
    "red": "tab:red",
    "green": "tab:green",
    "blue": "tab:blue",
    "alpha": "tab:purple",
}
OTHER_INKS = ("tab:blue", "tab:orange", "tab:green", "tab:red", "tab:purple", "tab:brown")
NOT_A_NUMBER = (1.0, 0.0, 1.0)  # the colour of NaN pixels: no natural image is full of magenta
BINS = 256
HIGH_DYNAMIC_RANGE = 1000.0  # above this ratio of values the histogram's axis is logarithmic
MOST_NOTES = 6  # largest number of notes on cut bins, one a band
SURFACE_SIDE = 72  # most facets along a side of the surface
BEFORE_NOTE = 1.5  # a bin this much higher than the axis is noted instead of squeezing the rest


def as_picture(pixels: np.ndarray, white: float) -> tuple[np.ndarray, str]:
    """Convert an image to a picture, (h, w, 3) in [0, 1], with NaN pixels in magenta, and describe
    the mapping in words."""
    colours = colours_of(pixels).astype(float)
    how = ""
    if colours.shape[-1] not in (1, 3):
        how = f"mean of {colours.shape[-1]} bands, "
        colours = colours.mean(axis=-1, keepdims=True)
    finite = colours[np.isfinite(colours)]
    brightest = float(np.quantile(finite, 0.99)) if finite.size else 0.0
    if pixels.dtype.kind == "f" and finite.size and finite.max() > white and brightest > 0:
        shown = np.asarray(srgb_encode(jnp.asarray(np.maximum(colours, 0) / brightest)))
        how += f"sRGB of value / {brightest:.3g}"
    else:
        shown = colours / white
        how += "as stored" if white == 1 else f"value / {white:.6g}"
    if finite.size and finite.min() < 0:
        how += ", below 0 black"
    if finite.size and (finite.max() > white or how.startswith("sRGB")):
        how += ", brightest cut"
    picture = np.broadcast_to(np.clip(shown, 0, 1), (*shown.shape[:2], 3)).copy()
    picture[np.isnan(colours).any(axis=-1)] = NOT_A_NUMBER
    return np.nan_to_num(picture), how


def _ink(name: str, index: int) -> str:
    return INK.get(name, OTHER_INKS[index % len(OTHER_INKS)])


def draw_picture(
    axis: "Axes", picture: np.ndarray, how: str, line: int, rows: range, columns: range
) -> None:
    from matplotlib.patches import Rectangle

    axis.imshow(picture, interpolation="nearest" if max(picture.shape) < 200 else "antialiased")
    axis.axhline(line, color="gold", lw=1)
    corner = columns.start - 0.5, rows.start - 0.5
    axis.add_patch(Rectangle(corner, len(columns), len(rows), fill=False, ec="cyan", lw=1.2))
    axis.set(xlabel="column", ylabel="row", title=f"picture ({how})")


def draw_histogram(axis: "Axes", pixels: np.ndarray, white: float, names: Sequence[str]) -> None:
    """Draw the number of pixels in equal bins of codes, of values, or, for a high dynamic range, of
    log10 of the values. The axis label states the number of values that are not finite, and, with
    log10, of values at or below 0."""
    bands = pixels.shape[-1]
    values, unit = pixels.astype(float), "DN" if pixels.dtype.kind in "ui" else "relative"
    finite = values[np.isfinite(values)]
    positive = finite[finite > 0]
    logarithmic = (
        pixels.dtype.kind == "f"
        and positive.size > 0
        and positive.max() > HIGH_DYNAMIC_RANGE * np.quantile(positive, 0.01)
    )
    if logarithmic:
        values = np.log10(np.where(values > 0, values, np.nan))
        finite = np.log10(positive)
    low, high = (finite.min(), finite.max()) if finite.size else (0.0, 1.0)
    if pixels.dtype.kind in "ui":
        width = max(1, int(np.ceil((max(high, white if white <= 255 else high) + 1) / BINS)))
        low, high = min(low, 0.0), min(low, 0.0) + width * BINS
    elif low == high:
        half = max(0.5, 1e-3 * abs(low))  # 0.5 is lost in the rounding of large numbers
        low, high = low - half, high + half
    counts, edges = _counts(values, (float(low), float(high)))
    # without alpha, whose full bins would squeeze the others
    light = counts[: colours_of(pixels).shape[-1]]
    ceiling = BEFORE_NOTE * max(float(np.quantile(light, 0.995)), 1.0)
    for i, name in enumerate(names):
        axis.stairs(
            counts[i], edges, color=_ink(name, i), label=name, fill=bands == 1, lw=1.0, alpha=0.9
        )
    if counts.max() > BEFORE_NOTE * ceiling:
        axis.set_ylim(0, ceiling)
        cut = [band for band in range(bands) if counts[band].max() > ceiling]
        for line, band in enumerate(cut[:MOST_NOTES]):
            place = counts[band].argmax()
            where = edges[place] if unit == "DN" else (edges[place] + edges[place + 1]) / 2
            value = 10**where if logarithmic else where
            axis.text(
                *(0.97, 0.97 - 0.06 * line),
                f"{names[band]}, highest bin: {counts[band].max():,} at {value:.4g}",
                transform=axis.transAxes,
                ha="right",
                va="top",
                fontsize=8,
                color=_ink(names[band], band),
            )
    axis.set_xlim(edges[0], edges[-1])
    axis.locator_params(axis="x", nbins=6)  # more numbers would overlap if each has a minus sign
    label = f"log10 of the value ({unit})" if logarithmic else f"value ({unit})"
    hidden = int((pixels <= 0).sum()) if logarithmic else 0
    lost = int((~np.isfinite(pixels)).sum())
    for count, what in ((hidden, "at or below 0"), (lost, "not finite and")):
        if count:
            label += f"\n{count:,} value{'s' * (count > 1)} {what} not drawn"
    width = edges[1] - edges[0]
    axis.set(xlabel=label, ylabel=f"pixels per bin of {width:.3g}", title="histogram")
    axis.grid(alpha=0.3)


def _counts(values: np.ndarray, value_range: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    histogram = exact_histogram(values, bins=BINS, value_range=value_range)
    return np.asarray(histogram.counts), np.asarray(histogram.edges)


def draw_scan_line(axis: "Axes", pixels: np.ndarray, line: int, names: Sequence[str]) -> None:
    for i, name in enumerate(names):
        values = pixels[line, :, i].astype(float)
        axis.plot(
            np.where(np.isfinite(values), values, np.nan),
            color=_ink(name, i),
            lw=1.0,
            marker="." if len(values) < 40 else "",
            label=name,
        )
    unit = "DN" if pixels.dtype.kind in "ui" else "relative"
    axis.set(xlabel="column", ylabel=f"value ({unit})", title=f"scan line: row {line}")
    axis.margins(x=0)
    if pixels.shape[-1] <= len(OTHER_INKS):
        axis.legend(fontsize=8, loc="best")
    axis.grid(alpha=0.3)


def draw_numbers(
    axis: "Axes",
    pixels: np.ndarray,
    picture: np.ndarray,
    rows: range,
    columns: range,
    names: Sequence[str],
) -> None:
    """Draw each pixel as a cell with its values printed one below the other."""
    cells = [[_print_values(pixels[i, j]) for j in columns] for i in rows]
    longest = max(len(number) for line in cells for cell in line for number in cell)
    stacked = max(len(cell) for line in cells for cell in line)
    size = min(10.0, 46.0 / longest, 30.0 / stacked)
    axis.imshow(
        picture[rows.start : rows.stop, columns.start : columns.stop],
        extent=(columns.start - 0.5, columns.stop - 0.5, rows.stop - 0.5, rows.start - 0.5),
        interpolation="nearest",
    )
    for i, line in zip(rows, cells, strict=True):
        for j, cell in zip(columns, line, strict=True):
            dark = picture[i, j] @ (0.2126, 0.7152, 0.0722) < 0.5
            axis.text(
                *(j, i),
                "\n".join(cell),
                ha="center",
                va="center",
                fontsize=size,
                color="white" if dark else "black",
                linespacing=1.05,
            )
    axis.set_xticks(list(columns))
    axis.set_yticks(list(rows))
    order = "" if len(names) == 1 else f" ({', '.join(names[:4])} from above)"
    axis.set(xlabel="column", ylabel="row", title=f"values{order}")


def _print_values(pixel: np.ndarray) -> list[str]:
    """Print the values of one pixel, at most four."""
    shown: Sequence[Any] = pixel[:4].tolist()
    return [f"{v:.3g}" if isinstance(v, float) else str(v) for v in shown]


def draw_surface(axis: "Axes3D", pixels: np.ndarray) -> None:
    """Draw the mean of the colour bands as the height of a surface. Each facet is the mean over the
    finite pixels of a block of pixels. A block without finite pixels gets the mean of the whole
    image."""
    height, width, _ = pixels.shape
    colours = colours_of(pixels).astype(float)
    step = max(1, -(-max(height, width) // SURFACE_SIDE))
    y, x = np.arange(0, height, step), np.arange(0, width, step)

    def block_sums(values: np.ndarray) -> np.ndarray:
        return np.add.reduceat(np.add.reduceat(values.sum(axis=-1), y, axis=0), x, axis=1)

    finite = np.isfinite(colours)
    known = block_sums(finite.astype(float))
    overall = colours[finite].mean() if finite.any() else 0.0
    sums = block_sums(np.where(finite, colours, 0))
    heights = np.where(known > 0, sums / np.maximum(known, 1), overall)
    if min(len(x), len(y)) > 1:
        columns, rows = np.meshgrid(x, y)
        axis.plot_surface(columns, rows, heights, cmap="viridis", rstride=1, cstride=1, lw=0)
    unit = "DN" if pixels.dtype.kind in "ui" else "relative"
    axis.set(xlabel="column", ylabel="row", title=f"surface: mean of bands ({unit})")
    axis.yaxis.labelpad = 12  # away from the numbers, which the view rotates towards it
    axis.invert_yaxis()
    axis.view_init(elev=50, azim=-75)
    axis.tick_params(labelsize=8)


def draw_summary(axis: "Axes", bands: Sequence[BandSummary], white: float) -> None:
    """Draw the numbers of `summarise` as a table with one column for each band."""
    rows = ["min", "max", "mean", "s.d.", "median", "≤ 0", f"≥ {white:.6g}", "NaN", "inf"]
    shown = bands[:4]
    cells = zip(*(_cells(band) for band in shown), strict=True)
    table = axis.table(
        [list(line) for line in cells],
        rowLabels=rows,
        colLabels=[band.name for band in shown],
        loc="center",
        cellLoc="right",
        bbox=[0.16, 0.04, 0.84, 0.92],  # type: ignore[arg-type]
    )
    table.auto_set_font_size(False)
    longest = max(len(text) for band in shown for text in _cells(band))
    table.set_fontsize(9 if longest * len(shown) < 32 else 7)
    axis.set_axis_off()
    more = "" if len(bands) <= 4 else f" (first 4 of {len(bands)} bands)"
    axis.set_title(f"in numbers{more}")


def _cells(band: BandSummary) -> list[str]:
    moments = (band.minimum, band.maximum, band.mean, band.standard_deviation, band.median)
    counts = (band.black, band.saturated, band.nan, band.infinite)
    return [f"{v:.5g}" for v in moments] + [f"{n:,}" for n in counts]
