"""The demo's summary: every known truth next to its estimate."""

from collections.abc import Iterable, Sequence
from functools import partial

from ..inference.formatting import format_interval, format_name, format_unit, format_value
from ..report.section import Picture, Section, Table
from .compare import Comparison, compare
from .figures import forest_figure
from .lab import Truth


def comparison_table(comparisons: Sequence[Comparison]) -> Table:
    """Truth and estimate with 68 and 95 % intervals, and the number of intervals that cover the
    truth."""
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
        f"{held_68} of {count} truths lie in their 68 % interval (about {0.68 * count:.0f} are "
        f"expected) and {held_95} in their 95 % interval (about {0.95 * count:.0f}).",
    )


def against_truth(sections: Iterable[Section], truth: Truth) -> Section:
    """The demo's summary: every known truth next to its estimate.

    Args:
        sections: of the calibrations of the files of `simulate_lab`.
        truth: the true values that it returned.

    Returns:
        A section with a table and a picture, `forest`.
    """
    comparisons = compare(sections, truth)
    caption = (
        "Each estimate less its truth, in standard errors: thick 68 %, thin 95 % interval. "
        "Grey: where 95 % of all truths should fall."
    )
    return Section(
        kind="demo",
        title="Truth against estimate",
        estimates=(),
        tables=(comparison_table(comparisons),),
        pictures=(
            Picture(
                "forest", "What the files gave back", caption, partial(forest_figure, comparisons)
            ),
        ),
    )
