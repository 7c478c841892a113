"""Output of posterior draws: a NetCDF file, corner plots and trace plots."""

import warnings
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxvision.files.images import replaced_on_success
from jaxvision.plots import trace
from jaxvision.plots.estimates import REGIONS

from ..inference.formatting import format_axis
from ..inference.parameters import Parameter, names, scalars
from ..inference.posterior import Posterior
from .figures import BLUE, OF_CHANNEL, RED
from .section import Columns, Picture, Section

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MARGIN = 1.15  # inches left of and below a corner plot, for rotated numbers and names
LONGEST_TAIL = 0.75  # longest drawn tail beyond the 95 % interval, in widths of that interval


def corner_figure(
    posteriors: Mapping[str, Posterior], truth: Mapping[tuple[str, str], float]
) -> "Figure":
    """Draw every pair of parameters, with 68 and 95 % regions; `truth` by (parameter, channel)."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import ScalarFormatter

    with warnings.catch_warnings():  # importing ArviZ, if installed, warns of its changes
        warnings.simplefilter("ignore", FutureWarning)
        import corner

    space = next(iter(posteriors.values())).space
    relative = _relative(posteriors)
    draws, truths = {}, {}
    for channel, posterior in posteriors.items():
        middle = np.median(posterior.samples, axis=0)
        zero, unit = np.where(relative, middle, 0.0), np.where(relative, middle / 100, 1.0)
        draws[channel] = (posterior.samples - zero) / unit
        known = [truth.get((p.name, channel)) for p in space]
        truths[channel] = [
            None if one is None else (one - z) / u
            for one, z, u in zip(known, zero, unit, strict=True)
        ]
    lowest, low, high, highest = np.quantile(
        np.concatenate([*draws.values()]), [0.0005, 0.025, 0.975, 0.9995], axis=0
    )
    beyond = LONGEST_TAIL * (high - low)
    ends = np.stack([np.maximum(lowest, low - beyond), np.minimum(highest, high + beyond)], axis=1)
    equal = ends[:, :1] == ends[:, 1:]
    ends += np.where(equal, np.abs(ends) + 1e-9, 0) * (-1, 1)
    size = 1.35 + 1.4 * len(space)
    figure = Figure(figsize=(size, size))
    for channel, samples in draws.items():
        colour = OF_CHANNEL.get(channel, BLUE)
        corner.corner(
            samples,
            labels=[_label(p, in_percent=one) for p, one in zip(space, relative, strict=True)],
            range=[tuple(pair) for pair in ends],
            color=colour,
            truths=truths[channel],
            truth_color=colour if len(posteriors) > 1 else RED,
            weights=np.full(len(samples), 1 / len(samples)),
            label_kwargs={"fontsize": 10},
            labelpad=0.26,
            fig=figure,
            **REGIONS,
        )
    for own in figure.axes[:: len(space) + 1]:  # diagonal: fit the highest channel
        curves = [np.asarray(line.get_ydata(), float) for line in own.lines]
        own.set_ylim(0, 1.1 * max((y.max() for y in curves if y.size > 2), default=1.0))
    for axis in figure.axes:
        axis.tick_params(labelsize=9, rotation=30)
        for direction in (axis.xaxis, axis.yaxis):
            formatter = direction.get_major_formatter()
            if isinstance(formatter, ScalarFormatter):
                formatter.set_useOffset(False)
    figure.subplots_adjust(left=MARGIN / size, bottom=MARGIN / size)
    return figure


def _label(parameter: Parameter, *, in_percent: bool) -> str:
    """Return the axis label of a parameter, with the unit below the symbol."""
    axis = format_axis(parameter.symbol, "%" if in_percent else parameter.unit)
    return f"{'Δ' if in_percent else ''}{axis}".replace(" [", "\n[")


def _relative(posteriors: Mapping[str, Posterior]) -> np.ndarray:
    """Return a mask of the parameters that are plotted in per cent of their medians. A parameter is
    plotted in per cent if several posteriors have it and it is far from 0 in all of them, unlike a
    size with only an upper limit."""
    ends = [np.quantile(one.samples, [0.025, 0.975], axis=0) for one in posteriors.values()]
    clear = [(low * high > 0) & (high - low < np.abs(low + high) / 2) for low, high in ends]
    return np.all(clear, axis=0) & (len(posteriors) > 1)


def trace_figure(posterior: Posterior) -> "Figure":
    """Draw some chains over the step; a converged chain looks like stationary noise."""
    figure = trace(posterior.by_name)
    for axes, parameter in zip(figure.axes, posterior.space, strict=True):
        axes.set_ylabel(format_axis(parameter.symbol, parameter.unit), fontsize=9)
        axes.tick_params(labelsize=9)
    return figure


def write_chains(
    path: Path,
    posteriors: dict[str, Posterior],
    *,
    arrays: Mapping[str, tuple[int, ...]] | None = None,
    data: Mapping[str, Columns] | None = None,
) -> None:
    """Write the draws of every posterior to one NetCDF file in ArviZ' layout, with a dimension of
    channels if there are several posteriors. All chains are cut to their last draws, as many as the
    shortest chain has. A parameter that one channel lacks is NaN for this channel."""
    import xarray

    first = next(iter(posteriors.values()))
    chains, kept = np.min([p.draws.shape[:2] for p in posteriors.values()], axis=0)
    parameters = {p.name: p for posterior in posteriors.values() for p in posterior.space}
    dimensions, channels = ("chain", "draw"), {}
    if len(posteriors) > 1:
        dimensions, channels = (*dimensions, "channel"), {"channel": [*posteriors]}

    def stack_channels(columns: list[np.ndarray]) -> np.ndarray:
        return np.stack(columns, axis=-1) if channels else columns[0]

    absent = np.full((chains, kept), np.nan)
    variables: dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]] = {
        label: (
            dimensions,
            stack_channels(
                [
                    p.by_name[label][:chains, -kept:] if label in p.by_name else absent
                    for p in posteriors.values()
                ]
            ),
            {"units": parameter.unit},
        )
        for label, parameter in parameters.items()
    }
    for name, shape in (arrays or {}).items():
        parts = [variables.pop(number.name) for number in scalars(Parameter(name), shape)]
        own = tuple(f"{name}_dim_{axis}" for axis in range(len(shape)))
        numbers = np.stack([values for _, values, _ in parts], axis=-1)
        values = numbers.reshape(*numbers.shape[:-1], *shape)
        variables[name] = (dimensions + own, values, parts[0][2])
    densities = [p.log_density for p in posteriors.values()]
    known = [x[:chains, -kept:] for x in densities if x is not None]
    attributes = {
        "method": first.method,
        "seed": [p.seed for p in posteriors.values()] if channels else first.seed,
    }
    with replaced_on_success(path) as unfinished:
        xarray.Dataset(variables, channels, attributes).to_netcdf(
            unfinished, mode="w", group="posterior", engine="h5netcdf"
        )
        if len(known) == len(densities):
            xarray.Dataset({"lp": (dimensions, stack_channels(known))}, channels).to_netcdf(
                unfinished, mode="a", group="sample_stats", engine="h5netcdf"
            )
        for group, columns in (data or {}).items():
            rows = {name: ("row", values) for name, values in columns.items()}
            xarray.Dataset(rows).to_netcdf(unfinished, mode="a", group=group, engine="h5netcdf")


def chain_pictures(section: Section) -> tuple[Picture, ...]:
    """Return the corner plots of a section's posteriors, and the trace plots of the posteriors that
    were sampled by chains. Posteriors with the same parameters share a corner plot. A posterior
    whose draws are not finite, because the data do not determine its parameters, has no corner
    plot."""
    alike: dict[tuple[str, ...], dict[str, Posterior]] = {}
    for group, posterior in section.posteriors.items():
        if not np.isfinite(posterior.samples).all():  # Laplace's draws of undetermined parameters
            continue
        alike.setdefault(names(posterior.space), {})[group] = posterior
    pictures = [
        _corner_picture(of_one_kind, section)
        for space, of_one_kind in alike.items()
        if len(space) > 1
    ]
    for group, posterior in section.posteriors.items():
        if posterior.steps:
            which = f" ({group})" if group else ""
            caption = "Traces of some chains after burn-in; a converged chain has no trend."
            draw = partial(trace_figure, posterior)
            pictures.append(Picture(f"trace_{group}", f"Chains{which}", caption, draw))
    return tuple(pictures)


def _corner_picture(posteriors: dict[str, Posterior], section: Section) -> Picture:
    channels = ", ".join(filter(None, posteriors))
    each = ("exact integrals" if p.method == "marginal" else p.method for p in posteriors.values())
    methods = " and ".join(dict.fromkeys(each))
    about = (
        f"Values are in per cent of the median of each ({channels}) where that is clear of 0, so "
        "that the regions overlap. "
        if len(posteriors) > 1
        else ""
    )
    lines = " Straight lines: the truth." if section.truth else ""
    caption = (
        f"Posterior by {methods}: 68 and 95 % regions of every pair of parameters. {about}"
        f"A slanted ellipse is a pair of correlated parameters.{lines}"
    )
    draw = partial(corner_figure, posteriors, section.truth)
    return Picture(f"corner_{channels}", "Joint uncertainty", caption, draw, is_whole=True)
