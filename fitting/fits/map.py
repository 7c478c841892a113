"""`FitMap`: the result of fitting a problem at every pixel."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, UInt8

from jaxvision.core.in_notebooks import figure_png, picture_html, record_html
from jaxvision.files.images import replaced_on_success, write_image

from ..inference.formatting import format_spread, format_unit
from ..inference.misfit import CHANCE
from ..report.figures import empty_panels
from .result import Fit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STATES = ("converged", "misfit", "stopped", "undetermined", "not finite", "no data")
WHY = {
    "misfit": "{share} scatter more than the likelihood says ({chance:.3g} of so many would by "
    "chance); their estimates are kept.",
    "stopped": "{share} stopped before a maximum and are NaN.",
    "undetermined": "The data of {share} do not determine all parameters; they are NaN.",
    "not finite": "The prediction of {share} is not finite; they are NaN.",
    "no data": "{share} have no data and are NaN.",
}
SHOWN = (1, 99)  # percentiles at the ends of a picture's colour scale


@dataclass(frozen=True)
class FitMap:
    """The result of a small problem that was fitted at every pixel. Print it for its contents, or
    show it in a notebook.

    Attributes:
        estimate: (..., *map) best fit of each parameter by name, in its unit; NaN where there is
            none.
        sd: standard errors of the estimates, of the same shape.
        interval_68: (2, ..., *map) lower and upper ends of the 68 % intervals.
        interval_95: (2, ..., *map) lower and upper ends of the 95 % intervals.
        chi_square: (*map) chi-square of the pixel's data; where pixels share a label, of all data
            of that label.
        dof: (*map) degrees of freedom.
        state: (*map) index into `fitting.fits.map.STATES`; 0 where the fit converged and describes
            its data.
        units: units of the parameters, by name.
        findings: sentences on how many pixels failed, and why.
        fits: the fits by label, where pixels share one.

    Example:
        >>> from fitting import Gaussian, Parameter, Problem, fit_map
        >>> pixel = Problem(
        ...     {"mean": Parameter(start=0.0)},
        ...     predict=lambda mean: mean * jnp.ones(4),
        ...     likelihood=Gaussian(sd=1.0),
        ...     data=np.zeros(4),
        ... )
        >>> found = fit_map(pixel, np.array([[1.0, 9.0]] * 4))  # four images of two pixels
        >>> found.estimate["mean"].round(2).tolist(), found.sd["mean"].round(2).tolist()
        ([1.0, 9.0], [0.5, 0.5])
    """

    estimate: dict[str, Float[np.ndarray, "..."]]
    sd: dict[str, Float[np.ndarray, "..."]]
    interval_68: dict[str, Float[np.ndarray, "2 ..."]]
    interval_95: dict[str, Float[np.ndarray, "2 ..."]]
    chi_square: Float[np.ndarray, "..."]
    dof: Float[np.ndarray, "..."]
    state: UInt8[np.ndarray, "..."]
    units: dict[str, str]
    findings: tuple[str, ...]
    fits: Mapping[int, Fit] = field(default_factory=dict, repr=False)

    @property
    def converged(self) -> Bool[np.ndarray, "..."]:
        """Return, for each pixel, whether the fit is a maximum that describes the pixel's data,
        (*map).
        """
        return self.state == 0

    def to_xarray(self) -> Any:
        """Return all maps as one xarray data set.

        Returns:
            An `xarray.Dataset`. For a parameter `gain` it has the variables `gain`, `gain_sd`,
            `gain_interval_68` and `gain_interval_95` (dimension `end`: low, high). It also has
            `chi_square`, `dof` and `state`. The last two dimensions are `y` and `x` of a
            two-dimensional map.
        """
        import xarray

        shape = self.state.shape
        along = ("y", "x") if len(shape) == 2 else tuple(f"axis_{i}" for i in range(len(shape)))
        variables: dict[str, Any] = {}
        for name, values in self.estimate.items():
            inner = tuple(f"{name}_{i}" for i in range(values.ndim - len(shape)))
            unit = {"units": self.units[name]}
            variables[name] = ((*inner, *along), values, unit)
            variables[f"{name}_sd"] = ((*inner, *along), self.sd[name], unit)
            for level, ends in (("68", self.interval_68), ("95", self.interval_95)):
                variables[f"{name}_interval_{level}"] = (("end", *inner, *along), ends[name], unit)
        states = {"flag_values": list(range(len(STATES))), "flag_meanings": ", ".join(STATES)}
        variables["chi_square"] = (along, self.chi_square)
        variables["dof"] = (along, self.dof)
        variables["state"] = (along, self.state, states)
        words = {"findings": "\n".join(self.findings)}
        return xarray.Dataset(variables, {"end": ["low", "high"]}, words)

    def write(self, folder: Path | str) -> list[Path]:
        """Write `maps.nc` (NetCDF). A map of two dimensions also gives `maps.png`, and an EXR file
        of each number with its standard error.

        Args:
            folder: folder for the files, created if needed.

        Returns:
            Paths of the files.
        """
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        written = [folder / "maps.nc"]
        with replaced_on_success(written[0]) as unfinished:
            self.to_xarray().to_netcdf(unfinished, engine="h5netcdf")
        if self.state.ndim != 2:
            return written
        for name, value, sd in self._numbers():
            for kind, pixels in (("", value), ("_sd", sd)):
                file = folder / f"{name}{kind}.exr"
                write_image(file, pixels.astype(np.float32))
                written.append(file)
        written.append(folder / "maps.png")
        with replaced_on_success(written[-1]) as unfinished:
            self._figure().savefig(unfinished, format="png", dpi=120)
        return written

    def _numbers(self) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
        """Yield the name, the map and the map of standard errors of every number of every
        parameter.
        """
        for name, values in self.estimate.items():
            for index in np.ndindex(values.shape[: values.ndim - self.state.ndim]):
                tail = f"[{','.join(map(str, index))}]" if index else ""
                yield name + tail, values[index], self.sd[name][index]

    def _unit(self, name: str) -> str:
        return self.units[name.partition("[")[0] if name not in self.units else name]

    def _figure(self) -> "Figure":
        """Draw the maps of the estimates, of their standard errors, and of the states."""
        from matplotlib import colormaps

        numbers = list(self._numbers())
        rows = len(numbers) + 1
        figure, axes = empty_panels((9, 3.2 * rows), rows=rows, columns=2, squeeze=False)
        for row, (name, value, sd) in zip(axes, numbers, strict=False):
            unit = format_unit(self._unit(name))
            for axis, pixels, title in ((row[0], value, name), (row[1], sd, f"{name}: s.e.")):
                known = pixels[np.isfinite(pixels)]
                low, high = np.percentile(known, SHOWN) if known.size else (0.0, 1.0)
                shown = axis.imshow(pixels, cmap="viridis", vmin=low, vmax=high)
                axis.set_title(f"{title} [{unit}]" if unit else title)
                figure.colorbar(shown, ax=axis, extend="both")
        ratio = self.chi_square / np.where(self.dof > 0, self.dof, np.nan)
        known = ratio[np.isfinite(ratio)]
        high = np.percentile(known, SHOWN[1]) if known.size else 1.0
        shown = axes[-1, 0].imshow(ratio, cmap="magma", vmin=0, vmax=high)
        axes[-1, 0].set_title("chi-square per degree of freedom")
        figure.colorbar(shown, ax=axes[-1, 0], extend="max")
        colours = colormaps["Set2"].resampled(len(STATES))
        shown = axes[-1, 1].imshow(self.state, cmap=colours, vmin=-0.5, vmax=len(STATES) - 0.5)
        axes[-1, 1].set_title("state")
        bar = figure.colorbar(shown, ax=axes[-1, 1], ticks=range(len(STATES)))
        bar.ax.set_yticklabels(STATES)
        return figure

    def __str__(self) -> str:
        rows = [
            f"  {name}: median {middle}, 90 % of pixels in {ends}, median standard error {error}"
            for name, middle, ends, error, _ in self._rows()
        ]
        remarks = (f"• {sentence}" for sentence in self.findings)
        return "\n".join([self._heading(), *rows, *remarks])

    def _heading(self) -> str:
        good = self.converged
        return f"Fits at {good.size} pixels: {int(good.sum())} converged"

    def _rows(self) -> list[tuple[str, str, str, str, str]]:
        rows = []
        for name, value, sd in self._numbers():
            known = np.isfinite(value)
            if known.any():
                error = f"{np.median(sd[known]):.2g}"
                spread = format_spread(value[known])
                rows.append((name, *spread, error, format_unit(self._unit(name))))
        return rows

    def _repr_html_(self) -> str:
        """Return the HTML table that a notebook shows; two-dimensional maps are drawn too."""
        heads = ("parameter", "median", "90 % of pixels in", "median s.e.", "unit")
        table = record_html(heads, self._rows(), title=self._heading(), notes=self.findings)
        if self.state.ndim != 2:
            return table
        return picture_html(figure_png(self._figure()), table, meaning="maps, errors and states")


def map_findings(state: UInt8[np.ndarray, "..."], *, by_label: bool) -> tuple[str, ...]:
    """Return sentences on how many pixels failed, and why."""
    counts = np.bincount(state.ravel(), minlength=len(STATES))
    tested = int(counts[: STATES.index("stopped")].sum())
    found = []
    for name, count in zip(STATES, counts, strict=True):
        if name in WHY and count:
            share = f"{count} of {state.size} pixels"
            sentence = WHY[name].format(share=share, chance=CHANCE * tested)
            if by_label:
                sentence = sentence.replace(
                    f" ({CHANCE * tested:.3g} of so many would by chance)", ""
                )
            found.append(sentence)
    return tuple(found)
