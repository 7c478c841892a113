"""Names of points in a figure."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TOGETHER = 0.08, 0.06  # of the axes' width and height, within which names would overlap


def name_points(
    axes: "Axes",
    points: Sequence[tuple[str, float, float]],
    *,
    below: bool = False,
    color: str | None = None,
    size: float | None = None,
) -> None:
    """Writes names beside points, left of those in the right third; points that lie together have
    one label, of all their names.

    Args:
        axes: logarithmic, with the points drawn.
        points: (name, s, error) of each.
        below: whether under the points.
        color: of matplotlib.
        size: of the letters, pt.
    """
    if not points:
        return
    places = np.log([[seconds, error] for _, seconds, error in points]).reshape(-1, 2)
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
    for place, known in together:
        if not any(known):
            continue
        late = place[0] > 0.7
        axes.annotate(
            ", ".join(known),
            np.exp(first + place * (last - first)),
            (-5 if late else 5, -11 if below else 5),
            textcoords="offset points",
            ha="right" if late else "left",
            color=color,
            fontsize=size,
        )
