"""Pictures of a posterior: the corner plot, and the walkers' paths of a sampled one."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter

from ..formatting import format_axis
from ..posterior import Posterior

MOST_WALKERS = 16  # paths drawn; more only blacken the panel


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
    """Some walkers' paths after burn-in: a settled chain looks like even noise."""
    count = len(posterior.space)
    figure = Figure(figsize=(8, 1.1 * count + 0.8), layout="constrained")
    axes = np.atleast_1d(figure.subplots(count, 1, sharex=True))
    for i, (axis, parameter) in enumerate(zip(axes, posterior.space, strict=True)):
        axis.plot(posterior.draws[:MOST_WALKERS, :, i].T, color="tab:blue", alpha=0.3, lw=0.5)
        axis.set_ylabel(format_axis(parameter.symbol, parameter.unit), fontsize=8)
        axis.tick_params(labelsize=8)
    axes[-1].set_xlabel("step after burn-in")
    return figure
