"""The draws of a posterior: written as NetCDF, and drawn as corner plot and paths of its chains."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter

from jaxvision.io import replaced_on_success

from ..inference.parameters import names
from ..inference.posterior import Posterior
from .formatting import format_axis
from .section import Columns, Picture, Section

MOST_PATHS = 16  # drawn; more only blacken the panel


def corner_figure(posterior: Posterior) -> Figure:
    """Every pair of parameters with 68 and 95 % regions, quantiles on the diagonal."""
    import corner

    labels = [format_axis(p.symbol, p.unit) for p in posterior.space]
    size = 1.6 + 1.5 * len(labels)
    figure = corner.corner(
        posterior.samples,
        labels=labels,
        quantiles=[0.16, 0.5, 0.84],
        levels=(0.68, 0.95),
        smooth=1.0,
        plot_datapoints=False,
        label_kwargs={"fontsize": 9},
        max_n_ticks=3,
        labelpad=0.12,
        fig=Figure(figsize=(size, size)),
    )
    for axis in figure.axes:
        for direction in (axis.xaxis, axis.yaxis):
            if isinstance(direction.get_major_formatter(), ScalarFormatter):
                direction.get_major_formatter().set_useOffset(False)
    return figure


def trace_figure(posterior: Posterior) -> Figure:
    """Paths of some chains after burn-in: a settled chain looks like even noise."""
    count = len(posterior.space)
    figure = Figure(figsize=(8, 1.1 * count + 0.8), layout="constrained")
    axes = np.atleast_1d(figure.subplots(count, 1, sharex=True))
    for i, (axis, parameter) in enumerate(zip(axes, posterior.space, strict=True)):
        axis.plot(posterior.draws[:MOST_PATHS, :, i].T, color="tab:blue", alpha=0.3, lw=0.5)
        axis.set_ylabel(format_axis(parameter.symbol, parameter.unit), fontsize=8)
        axis.tick_params(labelsize=8)
    axes[-1].set_xlabel("step after burn-in")
    return figure


def write_chains(
    path: Path, posteriors: dict[str, Posterior], *, data: Mapping[str, Columns] | None = None
) -> None:
    """Draws of every posterior in one NetCDF file of ArviZ' layout.

    The groups are `posterior` and `sample_stats` with the dimensions chain and draw, and, where
    there are several posteriors, channel. Channels are of one length: of chains that ended at
    different steps the last draws are kept, as many as the shortest has. What a channel does not
    have is NaN in it.

    Args:
        path: of the file, replaced once it is complete.
        posteriors: by name.
        data: columns of numbers, each record of them a group of its own.
    """
    import xarray

    first = next(iter(posteriors.values()))
    chains, kept = np.min([p.draws.shape[:2] for p in posteriors.values()], axis=0)
    parameters = {p.name: p for posterior in posteriors.values() for p in posterior.space}
    dimensions, channels = ("chain", "draw"), {}
    if len(posteriors) > 1:
        dimensions, channels = (*dimensions, "channel"), {"channel": [*posteriors]}

    def beside(columns: list[np.ndarray]) -> np.ndarray:
        return np.stack(columns, axis=-1) if channels else columns[0]

    absent = np.full((chains, kept), np.nan)
    variables = {
        label: (
            dimensions,
            beside([_draws_of(p, label, absent) for p in posteriors.values()]),
            {"units": parameter.unit},
        )
        for label, parameter in parameters.items()
    }
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
            xarray.Dataset({"lp": (dimensions, beside(known))}, channels).to_netcdf(
                unfinished, mode="a", group="sample_stats", engine="h5netcdf"
            )
        for group, columns in (data or {}).items():
            rows = {name: ("row", values) for name, values in columns.items()}
            xarray.Dataset(rows).to_netcdf(unfinished, mode="a", group=group, engine="h5netcdf")


def _draws_of(posterior: Posterior, label: str, absent: np.ndarray) -> np.ndarray:
    """(chains, draws) of one parameter, cut to the shape of what stands for an absent one."""
    chains, kept = absent.shape
    if label not in names(posterior.space):
        return absent
    return posterior.draws[:chains, -kept:, names(posterior.space).index(label)]


def chain_pictures(section: Section) -> tuple[Picture, ...]:
    """The corner plot of each posterior of a section, and the paths of a sampled one."""
    pictures = []
    for group, posterior in section.posteriors.items():
        which = f" ({group})" if group else ""
        if len(posterior.space) > 1:
            caption = (
                f"{posterior.method} posterior: 68 and 95 % regions of every pair of parameters; "
                "a slanted ellipse is a pair the data partly confuse."
            )
            draw = partial(corner_figure, posterior)
            pictures.append(Picture(f"corner_{group}", f"Joint uncertainty{which}", caption, draw))
        if posterior.steps:
            caption = "Paths of some chains after burn-in; a settled chain looks like even noise."
            draw = partial(trace_figure, posterior)
            pictures.append(Picture(f"trace_{group}", f"Chains{which}", caption, draw))
    return tuple(pictures)
