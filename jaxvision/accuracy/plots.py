"""Plot error against time: one figure for each knob, and one figure with the Pareto fronts of all
knobs."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..plots.legible_axes import BLUE, PURPLE, RED, few_ticks, name_points, new_axes, tidy
from .records import Curve, Trial

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LEAST_RANGE = 2.0  # smallest ratio of an axis's ends, so that its labels differ
HEIGHT_SHARE = 0.15  # share of the height for points without an error
NAME_SHARE = 0.15  # share of the width for names of other programs
LEAST_SHARE = 0.03  # share of the smallest error, down to which the axis extends
_UNKNOWN = "no error is known: allow more time"


def plot(
    curve: Curve,
    *,
    others: Sequence[tuple[str, float, float]] = (),
    axes: "Axes | None" = None,
) -> "Axes":
    """Plot error against time for the settings of one knob. Filled points have error bars for the
    spread over seeds. A hollow point has an error of less than three times the error of the
    reference. A dashed line marks the error of the reference, unless it is far below all points.
    Points on the lower axis have the error 0. The solid line is the Pareto front.

    Args:
        curve: measured errors and times, from `curve`.
        others: results of other programs (name, s, relative error), drawn as triangles.
        axes: matplotlib axes to draw on; None makes new ones.

    Returns:
        The axes; time in s, error in percent.
    """
    axes = new_axes(axes)
    floor = curve.reference.error
    shown = [t for t in curve.trials if np.isfinite(t.error) and t.error > 0]
    # a much more accurate reference, or an error bar to zero, would flatten the points
    bottom = LEAST_SHARE * min((t.error for t in shown), default=0.0)
    for trial in shown:
        error = 100 * trial.error
        ends = (x if np.isfinite(x) else trial.error for x in (trial.error_low, trial.error_high))
        low, high = (100 * max(x, bottom) for x in ends)
        axes.errorbar(
            trial.seconds,
            error,
            xerr=[[trial.seconds - trial.seconds_low], [trial.seconds_high - trial.seconds]],
            yerr=[[max(error - low, 0)], [max(high - error, 0)]],
            fmt="o",
            color=BLUE,
            markerfacecolor="none" if trial.hollow else BLUE,
            markersize=6,
            elinewidth=1,
        )
    front = [curve.trials[i] for i in curve.pareto if curve.trials[i] in shown]
    axes.plot([t.seconds for t in front], [100 * t.error for t in front], color=BLUE, lw=1)
    if shown and np.isfinite(floor) and floor > bottom:
        axes.axhline(100 * floor, color=RED, ls="--", lw=1)
    exact = [t for t in curve.trials if t.error == 0 and np.isfinite(floor)]
    rivals = [(name, seconds, 100 * error) for name, seconds, error in others]
    for _, seconds, error in rivals:
        axes.plot(seconds, error, "^", color=PURPLE, ms=5)
    if rivals:
        axes.margins(x=NAME_SHARE)
    none = "no error was found" if exact else _UNKNOWN
    if shown and exact:
        axes.update_datalim([(t.seconds, 100 * shown[0].error) for t in exact])
    _scale_axis(axes, [t.error for t in shown], curve.error_axis, none)
    if shown:
        low, high = axes.get_ylim()
        axes.set_ylim(low * (low / high) ** (HEIGHT_SHARE if exact else 0), high)
        name_points(axes, [(str(t.setting), t.seconds, 100 * t.error) for t in shown])
        name_points(axes, rivals, below=True, color=PURPLE)
        _draw_errorless(axes, exact)
        few_ticks(axes)  # the names have extended the axis above
    unit = f" [{curve.knob.unit}]" if curve.knob.unit else ""
    order = ""
    if curve.order is not None:
        by_factor = curve.order.law == "geometric" and curve.order.is_known
        falls = "error" if by_factor else "order"
        order = f"\n{falls} {curve.order}"
    axes.set_title(f"{curve.knob.name}{unit}{order}", fontsize=10)
    tidy(axes)
    return axes


def _draw_errorless(axes: "Axes", trials: Sequence[Trial]) -> None:
    """Draw trials without error on the lower axis, since logarithms show no zero."""
    low, _ = axes.get_ylim()
    for trial in trials:
        axes.plot(trial.seconds, low, "o", color=BLUE, mfc="none", ms=6, clip_on=False)
    name_points(axes, [(f"{t.setting}: 0", t.seconds, low) for t in trials])


def front(curves: Sequence[Curve], *, axes: "Axes | None" = None) -> "Axes":
    """Draw the Pareto fronts of several knobs of one problem in one plot.

    Args:
        curves: measured errors and times, one curve for each setting.
        axes: matplotlib axes to draw on; None makes new ones.

    Returns:
        The axes; time in s, error in percent.
    """
    axes = new_axes(axes)
    drawn: list[float] = []
    for curve in curves:
        best = [curve.trials[i] for i in curve.pareto if curve.trials[i].error > 0]
        if best:
            places = [t.seconds for t in best], [100 * t.error for t in best]
            drawn += places[1]
            axes.plot(*places, "o-", ms=4, lw=1, label=curve.knob.name)
    _scale_axis(axes, drawn, curves[0].error_axis if curves else "error")
    if drawn:
        few_ticks(axes)
    axes.set_title("Pareto fronts of all knobs", fontsize=10)
    tidy(axes)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=8, frameon=False)
    return axes


def _scale_axis(axes: "Axes", errors: Sequence[float], of: str, none: str = _UNKNOWN) -> None:
    """Set logarithmic axes with labels, or write a message if there is nothing to draw."""
    axes.set(xlabel="time [s]", ylabel=of)
    if errors:
        axes.set(xscale="log", yscale="log")
        for limits, set_limits in (
            (axes.get_xlim(), axes.set_xlim),
            (axes.get_ylim(), axes.set_ylim),
        ):
            wide = max((LEAST_RANGE * limits[0] / limits[1]) ** 0.5, 1.0)
            set_limits(limits[0] / wide, limits[1] * wide)
    else:
        axes.set(xticks=[], yticks=[])
        axes.text(0.5, 0.5, none, ha="center", va="center", transform=axes.transAxes)
