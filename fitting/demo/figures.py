"""The demo's first picture: the error of each estimate."""

from collections.abc import Sequence

from matplotlib.figure import Figure

from ..inference.formatting import format_name
from ..report.colours import OF_CHANNEL
from .compare import Comparison

LIMIT = 4.5  # standard errors shown to either side


def forest_figure(comparisons: Sequence[Comparison]) -> Figure:
    """One row for each estimate: 68 and 95 % intervals about the truth, in standard errors."""
    figure = Figure(figsize=(5.4, 1.2 + 0.27 * len(comparisons)), layout="constrained")
    axis = figure.subplots()
    axis.axvspan(-1.96, 1.96, color="0.93", zorder=0)
    axis.axvline(0, color="0.4", lw=1)
    labels = []
    for row, comparison in enumerate(comparisons):
        estimate = comparison.estimate
        colour = OF_CHANNEL.get(estimate.group, "0.5")
        low95, low68, centre, high68, high95 = comparison.deviations
        axis.plot([low95, high95], [row, row], color=colour, lw=1.5)
        axis.plot([low68, high68], [row, row], color=colour, lw=4.5, solid_capstyle="butt")
        axis.plot(centre, row, "o", color="white", mec=colour, ms=5)
        name = format_name(estimate.name)
        detail = estimate.group or estimate.method
        labels.append(f"{name}, {detail}" if detail else name)
    axis.set_yticks(range(len(labels)), labels, fontsize=9)
    axis.set_ylim(len(labels) - 0.4, -0.6)
    axis.set_xlim(-LIMIT, LIMIT)
    axis.set_xlabel("(estimate − truth) / standard error")
    for side in ("top", "right", "left"):
        axis.spines[side].set_visible(False)
    axis.tick_params(left=False)
    return figure
