"""Make axes legible: labels of points and ticks that do not overlap, and colours for any
background."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Legible on white and on near black, 4 to 1 on either.
BLUE, RED, PURPLE = "#2d7dd2", "#d2530f", "#a05ce0"
GREEN, OCHRE, PINK, TEAL, GREY = "#1f8a4c", "#a87400", "#d6408a", "#0f8b8d", "#767b83"
TOGETHER = 0.08, 0.06  # share of the axes' width and height, within which points share a name
WIDE, HIGH = 0.62, 1.2  # width of a letter and height of a line, in font sizes
APART = 5.0  # pt, distance of a name from its point, and of a number from the next
LAID_OUT = 0.9  # factor on the axes' current size, because a layout may still shrink them
MARGIN = 2.0  # pt, distance of a name from drawn marks
OF_MARK, OF_LINE = 60.0, 5.0  # pt^2, area that a name covers of a mark, and of a point on a line
MOST = 4  # largest number of tick labels on an axis


def name_points(
    axes: "Axes",
    points: Sequence[tuple[str, float, float]],
    *,
    below: bool = False,
    color: str | None = None,
    size: float | None = None,
) -> None:
    """Write the names of points, (name, s, error) each, in free places next to the points on
    logarithmic axes. Points that are close together share a label."""
    from matplotlib import rcParams

    if not points:
        return
    letters = size or rcParams["font.size"]
    places = np.log([[seconds, error] for _, seconds, error in points]).reshape(-1, 2)
    _make_room(axes, places[:, 1], APART + HIGH * letters, below)
    first, last = np.log([axes.get_xlim(), axes.get_ylim()]).T
    within = (places - first) / np.maximum(last - first, 1e-9)
    together: list[tuple[np.ndarray, list[str]]] = []
    for (name, *_), place in zip(points, within, strict=True):
        near = (known for at, known in together if (np.abs(place - at) < TOGETHER).all())
        known = next(near, None)
        if known is None:
            together.append((place, [name]))
        elif name and name not in known:
            known.append(name)
    whole = _size(axes)
    taken = [_box_of(text, whole, first, last) for text in axes.texts if hasattr(text, "xyann")]
    drawn = _drawing(axes, whole, first, last)
    for place, known in together:
        if not any(known):
            continue
        label = ", ".join(known)
        extent = np.array([WIDE * len(label), HIGH]) * letters
        boxes = list(_label_offsets(place * whole, extent, below=below))
        x, y, box = min(boxes, key=lambda one: _covered_area(one[2], taken, drawn, whole))
        taken.append(box)
        axes.annotate(
            label,
            np.exp(first + place * (last - first)),
            (x, y),
            textcoords="offset points",
            ha="right" if x < 0 else "left",
            va="top" if y < 0 else "bottom",
            color=color,
            fontsize=size,
        )


def few_ticks(axes: "Axes") -> None:
    """Set at most `MOST` tick labels on each axis, without overlap. The tick values are powers of
    ten, 1, 2 and 5 times powers of ten, or equal steps, whichever gives most labels. Times below a
    second are written in ms."""
    from matplotlib import rcParams
    from matplotlib.font_manager import FontProperties
    from matplotlib.ticker import FixedFormatter, FixedLocator, NullFormatter, NullLocator

    words = rcParams["xtick.labelsize"], rcParams["ytick.labelsize"]
    in_ms = max(axes.get_xlim()) < 1
    axes.set_xlabel("time [ms]" if in_ms else "time [s]")
    units = 1e-3 if in_ms else 1.0, 1.0
    for axis, unit, length, word in zip(
        (axes.xaxis, axes.yaxis), units, _size(axes), words, strict=True
    ):
        letters = FontProperties(size=word).get_size_in_points()
        low, high = (end / unit for end in sorted(axis.get_view_interval()))
        best = max(
            (ticks for ticks in _candidates(low, high) if len(ticks) <= MOST),
            key=lambda ticks: len(ticks) * _fits(ticks, low, high, length, letters, axis.axis_name),
        )
        axis.set_major_locator(FixedLocator([unit * tick for tick in best]))
        axis.set_major_formatter(FixedFormatter([f"{tick:g}" for tick in best]))
        axis.set_minor_formatter(NullFormatter())
        if high < 3 * low:
            axis.set_minor_locator(NullLocator())


def _candidates(low: float, high: float) -> Iterator[list[float]]:
    """Yield candidate lists of tick values between the ends of an axis, the roundest first."""
    from matplotlib.ticker import MaxNLocator

    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    sets = [[10.0**p for p in powers if p % step == 0] for step in range(1, len(powers) + 1)]
    sets += [
        [n * 10.0**p for p in powers for n in round_ones] for round_ones in ((1, 2, 5), (1, 3))
    ]
    if high < 10 * low:
        equal = (MaxNLocator(n, steps=[1, 2, 2.5, 5, 10]) for n in (4, 3, 2, 1))
        sets += [list(locator.tick_values(low, high)) for locator in equal]
    for ticks in sets:
        yield [float(tick) for tick in ticks if low <= tick <= high]
    yield []


def _fits(
    ticks: list[float], low: float, high: float, length: float, letters: float, name: str
) -> bool:
    """Return whether the tick labels do not overlap on an axis of the given length, in pt."""
    at = length * np.log(np.array(ticks) / low) / np.log(high / low)
    wide = [WIDE * len(f"{tick:g}") if name == "x" else HIGH for tick in ticks]
    room = letters * np.convolve(wide, [0.5, 0.5], "valid") if len(ticks) > 1 else np.zeros(0)
    return bool((np.diff(at) >= room + APART).all())


def _size(axes: "Axes") -> np.ndarray:
    """Estimate the width and height of the axes, in pt, before the layout is computed."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    share = LAID_OUT if figure.get_layout_engine() else 1.0
    return np.array([axes.bbox.width, axes.bbox.height]) * share * 72 / figure.dpi


def _make_room(axes: "Axes", logs: np.ndarray, needed: float, below: bool) -> None:
    """Extend the axis above the highest point, or below the lowest if `below`, to make room for a
    name."""
    bottom, top = np.log(axes.get_ylim())
    share = min(needed / _size(axes)[1], 0.4)
    if below:
        bottom = min(bottom, (logs.min() - share * top) / (1 - share))
    else:
        top = max(top, (logs.max() - share * bottom) / (1 - share))
    axes.set_ylim(np.exp(bottom), np.exp(top))


def _label_offsets(
    point: np.ndarray, extent: np.ndarray, *, below: bool
) -> Iterator[tuple[float, float, np.ndarray]]:
    """Yield possible offsets of a name from its point, in pt, each with the lower left and upper
    right corner of the name."""
    for lines in (0.0, 0.8):
        for up in (-1, 1) if below else (1, -1):
            for right in (1, -1):
                offset = np.array([right, up]) * (APART, 0.6 * APART + lines * extent[1])
                start = point + offset + np.minimum([right, up], 0) * extent
                yield offset[0], offset[1], np.array([start, start + extent])


def _box_of(text, whole: np.ndarray, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return the bounding box of a name that is already written."""
    place = (np.log(text.xy) - first) / np.maximum(last - first, 1e-9) * whole
    extent = np.array([WIDE * len(text.get_text()), HIGH]) * text.get_fontsize()
    sides = np.sign(text.xyann)
    start = place + text.xyann + np.minimum(sides, 0) * extent
    return np.array([start, start + extent])


def _drawing(axes: "Axes", whole: np.ndarray, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return points on markers, lines and error bars, (n, 3), about `APART` pt from each other. The
    three numbers of a point are its position, in pt from the lower left corner of the axes, and the
    cost of covering the point with a name."""
    paths = [
        (line.get_xydata(), line.get_marker() not in ("", " ", "None", None))
        for line in axes.lines
        if line.get_transform() == axes.transData
    ]
    for bars in axes.collections:
        paths += [(path, False) for path in getattr(bars, "get_segments", list)()]
    found = [np.zeros((0, 3))]
    for path, marked in paths:
        with np.errstate(divide="ignore", invalid="ignore"):
            at = (np.log(np.asarray(path, float)) - first) / np.maximum(last - first, 1e-9) * whole
        at = at[np.isfinite(at).all(1)]
        if marked:
            found.append(np.insert(at, 2, OF_MARK, 1))
        for start, end in pairwise(at):
            steps = int(np.clip(np.abs(end - start).max() / APART, 1, 1000))
            found.append(np.insert(np.linspace(start, end, steps), 2, OF_LINE, 1))
    return np.concatenate(found)


def _covered_area(
    box: np.ndarray, taken: Sequence[np.ndarray], drawn: np.ndarray, whole: np.ndarray
) -> float:
    """Return a cost, as an area in pt^2, for a name that covers other names or drawn marks, or lies
    outside the axes."""
    overlaps = (np.minimum(box[1], one[1]) - np.maximum(box[0], one[0]) for one in taken)
    inside = np.clip(np.minimum(box[1], whole) - np.maximum(box[0], 0), 0, None)
    beyond = float(np.prod(box[1] - box[0]) - np.prod(inside))
    at, cost = drawn[:, :2], drawn[:, 2]
    covered = float(cost[((at > box[0] - MARGIN) & (at < box[1] + MARGIN)).all(1)].sum())
    return 2 * beyond + sum(float(np.prod(np.clip(one, 0, None))) for one in overlaps) + covered


if TYPE_CHECKING:
    from matplotlib.axes import Axes


def new_axes(axes: "Axes | None", *, polar: bool = False) -> "Axes":
    """Return the given axes, or the only axes of a new figure."""
    from matplotlib.figure import Figure

    if axes is not None:
        return axes
    figure = Figure(figsize=(4.8, 3.6), layout="constrained")
    return figure.add_subplot(projection="polar") if polar else figure.add_subplot()


def tidy(axes: "Axes") -> None:
    """Draw a light grid, and remove the frame at the top and on the right."""
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
