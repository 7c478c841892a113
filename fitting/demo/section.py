"""Report the demo's result: every true value next to its estimate."""

from collections.abc import Iterable, Sequence
from functools import partial
from typing import TYPE_CHECKING

from ..inference.formatting import format_interval, format_name, format_unit, format_value
from ..report.figures import OF_CHANNEL, empty_panels
from ..report.section import Picture, Section, Table
from .compare import Comparison, compare
from .lab import Truth

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LIMIT = 4.5  # standard errors shown to either side


def comparison_table(comparisons: Sequence[Comparison]) -> Table:
    """Tabulate true values and estimates with their 68 and 95 % intervals, and count the intervals
    that cover the true value.
    """
    rows = tuple(
        (
            f"{format_name(c.estimate.name)} {c.estimate.group}".rstrip(),
            f"{c.truth:g}",
            format_value(c.estimate),
            format_unit(c.estimate.unit),
            format_interval(c.estimate, 95),
            "68 %" if c.inside_68 else "95 %" if c.inside_95 else "outside",
            c.estimate.method,
        )
        for c in comparisons
    )
    held_68, held_95 = (
        sum(getattr(c, name) for c in comparisons) for name in ("inside_68", "inside_95")
    )
    count = len(comparisons)
    return Table(
        "Every known truth",
        ("quantity", "truth", "estimate", "unit", "95 %", "truth in", "method"),
        rows,
        f"{held_68} of {count} true values lie in their 68 % interval (about {0.68 * count:.0f} "
        f"are expected) and {held_95} in their 95 % interval (about {0.95 * count:.0f}).",
    )


def against_truth(sections: Iterable[Section], truth: Truth) -> Section:
    """Return the demo's section of the report: every true value next to its estimate.

    Args:
        sections: report sections of the calibrations from the files of `simulate_lab`.
        truth: the true values that `simulate_lab` returned.

    Returns:
        A section with a table and a picture, `forest`.
    """
    comparisons = compare(sections, truth)
    caption = (
        "Each estimate minus its true value, in standard errors: thick 68 %, thin 95 % interval. "
        "Grey: the range in which 95 % of all estimates should lie."
    )
    return Section(
        kind="demo",
        title="Truth against estimate",
        estimates=(),
        tables=(comparison_table(comparisons),),
        pictures=(
            Picture(
                "forest", "Estimates from the files", caption, partial(forest_figure, comparisons)
            ),
        ),
    )


def forest_figure(comparisons: Sequence[Comparison]) -> "Figure":
    """Draw one row for each estimate: its 68 and 95 % intervals minus the true value, in standard
    errors.
    """
    figure, axis = empty_panels((5.4, 1.2 + 0.27 * len(comparisons)))
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
