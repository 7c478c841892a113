"""What was found, with its errors, beside what is true."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ..errors import InputError
from ._axes import BLUE, RED, new_axes, tidy

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INCH = 1.7  # of a corner plot, a parameter


class Measured(Protocol):
    """A setting with its error and time, as `accuracy.Trial`."""

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
    """A curve with its band, such as a camera's response or a prediction.

    Args:
        x: (n,) any unit.
        y: (n,) what was found, any unit.
        band: its lower and upper end, (n,) each, or None.
        truth: (n,) in the unit of y, or None.
        names: of x and y, with their units.
        axes: of matplotlib to draw on; None: new ones.

    Returns:
        The axes: found blue, truth red and dashed.

    Raises:
        InputError: for arrays of different lengths.

    Example:
        >>> x = np.linspace(0, 1, 5)
        >>> axes = jv.plots.curve(x, x**2, band=(x**2 - 0.1, x**2 + 0.1), truth=x**2)
        >>> print(len(axes.lines), len(axes.collections))
        2 1
    """
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


def error_against_time(trials: Sequence[Measured], *, axes: "Axes | None" = None) -> "Axes":
    """What settings cost: error against time, those that none beats in both joined by a line.

    `accuracy.plot` draws a `Curve`, with its spread and the error of its reference.

    Args:
        trials: as from `accuracy.error_against_time`; those without a finite error above 0 are
            left out.
        axes: of matplotlib to draw on; None: new ones.

    Returns:
        The axes, both logarithmic; time in s, error relative.

    Raises:
        InputError: if no trial has a finite error above 0.

    Example:
        >>> means = {n: (lambda n=n: jnp.exp((jnp.arange(n) + 0.5) / n).mean()) for n in (2, 8)}
        >>> trials = jv.accuracy.error_against_time(means, reference=np.e - 1)
        >>> axes = jv.plots.error_against_time(trials)
        >>> print([text.get_text() for text in axes.texts])
        ['2', '8']
    """
    shown = [t for t in trials if np.isfinite(t.error) and t.error > 0]
    if not shown:
        raise InputError("no trial has a finite error above 0, which a logarithm could show.")
    axes = new_axes(axes)
    axes.loglog([t.seconds for t in shown], [t.error for t in shown], "o", color=BLUE)
    front = [
        t
        for t in sorted(shown, key=lambda t: t.seconds)
        if not any(o.seconds <= t.seconds and o.error < t.error for o in shown)
    ]
    axes.plot([t.seconds for t in front], [t.error for t in front], color=BLUE, lw=1)
    for t in shown:
        axes.annotate(
            str(t.setting), (t.seconds, t.error), (5, 5), textcoords="offset points", fontsize=8
        )
    axes.set(xlabel="time [s]", ylabel="relative error")
    tidy(axes)
    return axes


def corner(
    draws: Mapping[str, np.ndarray], *, truth: Mapping[str, float] | None = None
) -> "Figure":
    """Draws of a posterior: each parameter, and each pair with its 68 and 95 % regions.

    Args:
        draws: by the parameter's name (draws,), or (chains, draws, ...) as in `Fit.draws`, where
            each of several numbers has a row.
        truth: what is true, by the same names, red; None, or a name that is missing: not drawn.

    Returns:
        The figure.

    Raises:
        InputError: without draws, for draws of several lengths or not finite, for a parameter that
            does not vary, and for a truth of something else.

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
    columns, values, lengths = {}, [], set()
    for name, drawn in draws.items():
        whole = np.asarray(drawn, float)
        flat = whole.reshape(int(np.prod(whole.shape[:2])), -1)
        lengths.add(len(flat))
        true = np.broadcast_to(np.ravel((truth or {}).get(name, np.nan)), flat.shape[1])
        for i in range(flat.shape[1]):
            columns[name if flat.shape[1] == 1 else f"{name}[{i}]"] = flat[:, i]
            values.append(None if np.isnan(true[i]) else float(true[i]))
    if len(lengths) != 1:
        raise InputError("a corner plot takes draws of one length, of at least one parameter.")
    for name, column in columns.items():
        if not np.isfinite(column).all() or column.min() == column.max():
            raise InputError(
                f"the draws of {name!r} are not finite, or all the same; leave it out."
            )
    size = INCH * len(columns) + 0.8
    figure = Figure(figsize=(size, size))
    package.corner(
        np.stack(list(columns.values()), axis=-1),
        labels=list(columns),
        truths=values if len(values) > 1 else None,  # which it draws on an array of axes
        truth_color=RED,
        color=BLUE,
        levels=(0.68, 0.95),
        bins=30,
        smooth=1.0,
        smooth1d=1.0,
        plot_datapoints=False,
        plot_density=False,
        no_fill_contours=True,
        max_n_ticks=3,
        fig=figure,
    )
    if len(values) == 1 and values[0] is not None:
        figure.axes[0].axvline(values[0], color=RED)
    return figure
