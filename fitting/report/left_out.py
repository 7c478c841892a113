"""The table of the errors that a likelihood neglects."""

from collections.abc import Iterable
from itertools import compress

from ..inference.left_out import TOLERANCE, LeftOut
from .section import Table

LEAST = 1e-6  # s.d. below which digits are meaningless


def left_out_tables(channels: Iterable[tuple[str, tuple[LeftOut, ...]]]) -> tuple[Table, ...]:
    """Return the table of neglected errors, with bounds on their effect; empty if none."""
    rows = tuple(
        (name, own.name, own.size, own.bound if own.bound >= LEAST else f"below {LEAST:g}")
        for name, gone in channels
        for own in gone
    )
    if not rows:
        return ()
    columns = ("channel", "error", "as the rig states it", "moves the data by at most [s.d.]")
    named = [any(row[i] not in ("", None) for row in rows) for i in range(len(columns))]
    table = Table(
        title="Left out",
        columns=tuple(compress(columns, named)),
        rows=tuple(tuple(compress(row, named)) for row in rows),
        caption="Too small for any fit to detect: the most by which each changes the distribution "
        f"of all data, in standard deviations of their noise; together at most {TOLERANCE:g}.",
    )
    return (table,)
