"""Plot estimates with their uncertainties, compared with the true values."""

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from ..core.plain_arrays import plain_array
from ..errors import InputError
from .legible_axes import (
    BLUE,
    GREEN,
    GREY,
    OCHRE,
    PINK,
    PURPLE,
    RED,
    TEAL,
    few_ticks,
    name_points,
    new_axes,
    tidy,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INCH = 1.7  # inch per parameter of a corner plot
MARGIN = 0.9  # inch, for the numbers and names of a corner plot
REGIONS: dict[str, Any] = {  # how the package corner draws them
    "levels": (0.68, 0.95),
    "bins": 30,
    "smooth": 1.0,
    "smooth1d": 1.0,
    "plot_datapoints": False,
    "plot_density": False,
    "no_fill_contours": True,
    "max_n_ticks": 3,
}
SEVERAL = (BLUE, RED, GREEN, PURPLE, OCHRE, GREY, PINK, TEAL)
MARKS = "osD^vX*P"
MOST_PATHS = 8  # of chains in a row
MOST_VECTORS = 8_000  # number of points in a row, above which pixels make a smaller file


@runtime_checkable
class Measured(Protocol):
    """A setting with the measured error and time of a computation, as in `accuracy.Trial`."""

    @property
    def setting(self) -> Any: ...
    @property
    def error(self) -> float: ...
    @property
    def seconds(self) -> float: ...


def curve(
    x: np.ndarray,
    y: np.ndarray,
    *,
    band: tuple[np.ndarray, np.ndarray] | None = None,
    truth: np.ndarray | None = None,
    names: tuple[str, str] = ("", ""),
    axes: "Axes | None" = None,
) -> "Axes":
    """Plot a curve with its uncertainty band, such as a camera's response or a prediction.

    Args:
        x: (n,) any unit.
        y: (n,) estimates, any unit.
        band: lower and upper end of the interval of y, (n,) each, or None.
        truth: (n,) true values in the unit of y, or None.
        names: names of x and y, with their units.
        axes: matplotlib axes to draw on; None makes new ones.

    Returns:
        The axes; estimates are blue, true values red and dashed.

    Raises:
        InputError: for arrays of different lengths.

    Example:
        >>> x = np.linspace(0, 1, 5)
        >>> axes = jv.plots.curve(x, x**2, band=(x**2 - 0.1, x**2 + 0.1), truth=x**2)
        >>> print(len(axes.lines), len(axes.collections))
        2 1
    """
    x, y = plain_array("x", x), plain_array("y", y)
    found = np.asarray(y, float)
    rows = [found, *(band or ()), *(() if truth is None else (truth,))]
    if any(np.shape(row) != np.shape(x) for row in rows) or np.ndim(x) != 1:
        raise InputError("x, y, the band and the truth of a curve must be (n,), of one length.")
    axes = new_axes(axes)
    if band is not None:
        axes.fill_between(x, *band, color=BLUE, alpha=0.25, lw=0, label="band")
    axes.plot(x, found, color=BLUE, lw=1.5, label="found")
    if truth is not None:
        axes.plot(x, truth, color=RED, lw=1.2, ls="--", label="truth")
    axes.set(xlabel=names[0], ylabel=names[1])
    if len(rows) > 1:
        axes.legend(fontsize=8)
    tidy(axes)
    return axes


def curves(
    x: np.ndarray | Mapping[str, np.ndarray],
    y: Mapping[str, np.ndarray],
    *,
    names: tuple[str, str] = ("", ""),
    scales: tuple[str, str] = ("linear", "linear"),
    dots: Collection[str] = (),
    dashed: Collection[str] = (),
    title: str = "",
    axes: "Axes | None" = None,
) -> "Axes":
    """Plot several curves by name, in distinct colours.

    Args:
        x: (n,) in any unit, for all curves; or a mapping from the names in y to the (n,) of each
            curve.
        y: (n,) each, any unit, by name.
        names: names of x and y, with their units.
        scales: scales of x and y, as matplotlib names them: "linear", "log", "symlog".
        dots: names of the curves that are drawn as dots, such as measurements.
        dashed: names of the curves that are dashed, such as theory.
        title: title of the axes.
        axes: matplotlib axes to draw on; None makes new ones.

    Returns:
        The axes, with a legend of the names. The label of x counts the points that a logarithmic
        scale cannot show.

    Raises:
        InputError: for a curve that differs in length from its x, and for an unknown name.

    Example:
        >>> n = np.arange(1, 9)
        >>> axes = jv.plots.curves(n, {"one": 1 / n, "two": 1 / n**2}, scales=("log", "log"))
        >>> print([line.get_label() for line in axes.lines])
        ['one', 'two']
    """
    unknown = {*dots, *dashed} - set(y)
    if unknown:
        raise InputError(f"{min(unknown)!r} is the name of no curve; correct it.")
    axes, hidden = new_axes(axes), 0
    for i, (name, one) in enumerate(y.items()):
        along = x[name] if isinstance(x, Mapping) else x
        if np.shape(along) != np.shape(one) or np.ndim(one) != 1:
            raise InputError(
                f"curve {name!r} has shape {np.shape(one)} where x has {np.shape(along)}."
            )
        line = "" if name in dots else "--" if name in dashed else "-"
        colour, mark = SEVERAL[i % len(SEVERAL)], "." if name in dots else ""
        axes.plot(along, one, color=colour, ls=line, marker=mark, label=name)
        pair = zip((along, one), scales, strict=True)
        outside = [np.asarray(values) <= 0 for values, scale in pair if scale == "log"]
        hidden += int(np.any(outside, axis=0).sum())
    below = f"\n{hidden} point{'s' * (hidden > 1)} at or below 0 not drawn" if hidden else ""
    axes.set(xlabel=names[0] + below, ylabel=names[1], title=title)
    axes.set(xscale=scales[0], yscale=scales[1])
    axes.legend(fontsize=8)
    tidy(axes)
    return axes


def error_against_time(trials: Sequence[Measured], *, axes: "Axes | None" = None) -> "Axes":
    """Plot the error of several settings against their time.

    A line joins the settings of the Pareto front. If every setting is a pair (method, value), each
    method has its own line, colour and marker. `accuracy.plot` draws a `Curve` with the spread over
    seeds and the error of its reference.

    Args:
        trials: trials, as from `accuracy.error_against_time`. Trials without a finite error above 0
            are not drawn.
        axes: matplotlib axes to draw on; None makes new ones.

    Returns:
        The axes, both logarithmic; time in s, error relative.

    Raises:
        InputError: if no trial has a finite error above 0.

    Example:
        >>> means = {n: (lambda n=n: jnp.exp(jnp.linspace(0.0, 1.0, n)).mean()) for n in (2, 8)}
        >>> trials = jv.accuracy.error_against_time(means, reference=np.e - 1)
        >>> axes = jv.plots.error_against_time(trials)
        >>> print([text.get_text() for text in axes.texts])
        ['2', '8']
    """
    shown = [t for t in trials if np.isfinite(t.error) and t.error > 0]
    if not shown:
        raise InputError("no trial has a finite error above 0, which a logarithm could show.")
    axes = new_axes(axes)
    by_method = all(
        isinstance(t.setting, tuple) and len(t.setting) == 2 and isinstance(t.setting[0], str)
        for t in shown
    )
    named = []
    if by_method:
        for i, method in enumerate(dict.fromkeys(t.setting[0] for t in shown)):
            own = [t for t in shown if t.setting[0] == method]
            colour, mark = SEVERAL[i % len(SEVERAL)], MARKS[i % len(MARKS)]
            of_own = ([t.seconds for t in own], [t.error for t in own])
            axes.loglog(*of_own, color=colour, marker=mark, lw=1, label=str(method))
            named.append(([(str(t.setting[1]), t.seconds, t.error) for t in own], colour))
        axes.legend(fontsize=8)
    else:
        axes.loglog([t.seconds for t in shown], [t.error for t in shown], "o", color=BLUE)
        front = [
            t
            for t in sorted(shown, key=lambda t: t.seconds)
            if not any(o.seconds <= t.seconds and o.error < t.error for o in shown)
        ]
        axes.plot([t.seconds for t in front], [t.error for t in front], color=BLUE, lw=1)
        named.append(([(str(t.setting), t.seconds, t.error) for t in shown], None))
    for i, (points, colour) in enumerate(named):  # the limits are known now
        name_points(axes, points, below=i % 2 == 0 and by_method, color=colour, size=8)
    axes.set_ylabel("relative error")
    few_ticks(axes)
    tidy(axes)
    return axes


def corner(
    draws: Mapping[str, np.ndarray], *, truth: Mapping[str, float] | None = None
) -> "Figure":
    """Plot the draws of a posterior: each parameter, and each pair of parameters with its 68 and 95
    % regions.

    Args:
        draws: by name of the parameter, (draws,), or (chains, draws, ...) as in `Fit.draws`; each
            number of an array has its own row.
        truth: true values by the same names, drawn in red; a parameter without a true value has no
            red line; None for none.

    Returns:
        The figure.

    Raises:
        InputError: without draws, for draws of different lengths or not finite, for a parameter
            that does not vary, and for an unknown name in `truth`.

    Example:
        >>> draws = {"gain": np.random.default_rng(0).normal(2.0, 0.1, 500)}
        >>> print(len(jv.plots.corner(draws, truth={"gain": 2.0}).axes))
        1
    """
    import corner as package
    from matplotlib.figure import Figure

    unknown = set(truth or ()) - set(draws)
    if unknown:
        raise InputError(f"{min(unknown)!r} is true of nothing that was drawn; correct its name.")
    columns, values = {}, []
    for name, drawn in draws.items():
        numbers = _numbers(name, drawn)
        columns |= {each: chains.ravel() for each, chains in numbers.items()}
        true = np.broadcast_to(np.ravel((truth or {}).get(name, np.nan)), len(numbers))
        values += [None if np.isnan(value) else float(value) for value in true]
    if len({len(column) for column in columns.values()}) != 1:
        raise InputError("a corner plot takes draws of one length, of at least one parameter.")
    for name, column in columns.items():
        if not np.isfinite(column).all() or column.min() == column.max():
            raise InputError(
                f"the draws of {name!r} are not finite, or all the same; leave it out."
            )
    size = INCH * len(columns) + MARGIN + 0.2
    figure = Figure(figsize=(size, size))
    package.corner(
        np.stack(list(columns.values()), axis=-1),
        labels=list(columns),
        truths=values if len(values) > 1 else None,  # drawn on an array of axes
        truth_color=RED,
        color=BLUE,
        fig=figure,
        **REGIONS,
    )
    if len(values) == 1 and values[0] is not None:
        figure.axes[0].axvline(values[0], color=RED)
    figure.subplots_adjust(left=MARGIN / size, bottom=MARGIN / size)
    for axes in figure.axes:
        axes.tick_params(labelsize=8)
        axes.xaxis.set_label_coords(
            0.5, 0.12 - MARGIN / INCH
        )  # below slanted numbers of any length
        axes.yaxis.set_label_coords(0.12 - MARGIN / INCH, 0.5)
    return figure


def trace(draws: Mapping[str, np.ndarray]) -> "Figure":
    """Plot the traces of Markov chains, one row for each parameter. The trace of a converged chain
    looks like stationary noise.

    Args:
        draws: by name of the parameter, (draws,), or (chains, draws, ...) as in `Fit.draws`; each
            number of an array has its own row.

    Returns:
        The figure, with at most 8 chains.

    Raises:
        InputError: without draws.

    Example:
        >>> draws = {"gain": np.random.default_rng(0).normal(2.0, 0.1, (4, 50))}
        >>> (axes,) = jv.plots.trace(draws).axes
        >>> print(len(axes.lines), axes.get_ylabel())
        4 gain
    """
    from matplotlib.figure import Figure

    rows = {k: v for name, drawn in draws.items() for k, v in _numbers(name, drawn).items()}
    if not rows:
        raise InputError("a trace plot takes draws of at least one parameter.")
    figure = Figure(figsize=(8, 1.1 * len(rows) + 0.8), layout="constrained")
    panels = figure.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (name, chains) in zip(panels, rows.items(), strict=True):
        paths = chains[:MOST_PATHS].T
        axes.plot(paths, color=BLUE, alpha=0.3, lw=0.5, rasterized=paths.size > MOST_VECTORS)
        axes.set_ylabel(name, fontsize=8)
        axes.tick_params(labelsize=8)
        axes.spines[["top", "right"]].set_visible(False)
    panels[-1].set_xlabel("step after burn-in")
    return figure


def _numbers(name: str, drawn: np.ndarray) -> dict[str, np.ndarray]:
    """Return the draws of each number of a parameter, (chains, draws), by its name."""
    whole = np.atleast_1d(np.asarray(plain_array(name, drawn), float))
    chains = whole[None] if whole.ndim == 1 else whole
    flat = chains.reshape(*chains.shape[:2], -1)
    count = flat.shape[2]
    return {name if count == 1 else f"{name}[{i}]": flat[..., i] for i in range(count)}
