"""Draw pictures of lobes fitted to measured reflectance."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxvision import Vec

from ...report.figures import OF_CHANNEL, empty_panels
from ..models import LABELS, REFLECTANCES, has_lobe
from ..names import AXIS_NAMES, MODELS, Axis, Model
from .calibration import BRDFCalibration
from .errors import best, best_about_axis, metric
from .findings import AXES
from .fit import LobeFit, brdf
from .read import MeasuredBRDF

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

AXIS_COLOURS: dict[Axis, str] = {"mirror": "tab:orange", "half": "tab:blue", "none": "0.55"}
IN_PLANE = 0.6  # largest angle out of the plane of incidence, degrees
HEADROOM = 3.0  # top of the axis, relative to the brightest measured dot
SHOWN_INCIDENCES = 4
LIMIT = 200.0  # per cent: larger errors share a colour


def slices_figure(calibration: BRDFCalibration) -> "Figure":
    """Draw, for some incidences, the reflected light over the viewer's angle."""
    measured = calibration.measured
    shown = np.unique(
        np.linspace(0, len(measured.incidences) - 1, SHOWN_INCIDENCES).round().astype(int)
    )
    figure, axes = empty_panels((10.5, 7.4), rows=2, columns=2, squeeze=False)
    axes = axes.flat
    for axis, incidence in zip(axes, shown, strict=False):
        _draw_slice(axis, calibration, int(incidence))
    for axis in list(axes)[len(shown) :]:
        axis.set_visible(False)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, fontsize=9)
    return figure


def _draw_slice(axis: "Axes", calibration: BRDFCalibration, incidence: int) -> None:
    measured = calibration.measured
    x, off_plane = (np.degrees(angle) for angle in in_plane_angles(measured))
    chosen = (measured.incidence == incidence) & (np.abs(off_plane) < IN_PLANE)
    y = (measured.cosine[:, None] * measured.values).mean(axis=1)[chosen]
    axis.plot(x[chosen], y, "o", color="k", ms=3.5, label="measured", zorder=3)
    top = float(y.max()) if len(y) else 0.0

    theta_i = float(measured.incidences[incidence])
    theta_o = np.radians(np.linspace(-88, 88, 1409))
    near = np.radians(np.geomspace(1e-4, 0.5, 40))  # a mirror's peak is narrower than the grid
    about = theta_i + np.concatenate([-near, [0.0], near])
    theta_o = np.unique(np.concatenate([theta_o, about[np.abs(about) <= theta_o[-1]]]))
    held_out = calibration.held_out
    lines: list[Model] = [best_about_axis(held_out, kind, calibration.objective) for kind in AXES]
    highest = top
    for model, style in zip((*lines, "lambert"), ("-", "--", "-"), strict=True):
        fit = calibration.fits[model].without[incidence]
        curve = np.cos(theta_i) * predicted(fit, theta_i, theta_o, calibration.index)
        highest = max(highest, float(curve.max()))
        colour = AXIS_COLOURS[REFLECTANCES[model].axis]
        axis.plot(np.degrees(theta_o), curve, style, color=colour, lw=1.6, label=LABELS[model])
    top = min(highest, HEADROOM * top) if top > 0 else highest
    axis.axvline(np.degrees(theta_i), color="0.6", lw=0.8, ls=":")
    linear = max(float(np.quantile(np.maximum(y, 0), 0.2)) if len(y) else top, 1e-3 * top)
    steep = top > 8 * linear
    if steep:
        axis.set_yscale("symlog", linthresh=linear)
    axis.set(
        title=f"θi = {np.degrees(theta_i):.0f}°",
        xlabel="viewer's angle from the normal [degrees]",
        ylabel="$f_r$ cos $θ_i$ [sr$^{-1}$]",
        ylim=(0, (1.5 if steep else 1.1) * top),
    )


def in_plane_angles(measured: MeasuredBRDF) -> tuple[np.ndarray, np.ndarray]:
    """Return the viewer's angles in the plane of incidence and out of it.

    Args:
        measured: reflectance at n samples.

    Returns:
        (n,) angle from the normal within the plane, positive away from the light, and (n,) angle
        out of the plane, rad.
    """
    sine = np.sin(measured.elevation)
    along = np.arctan2(-sine * np.cos(measured.azimuth), np.cos(measured.elevation))
    return along, np.arcsin(sine * np.sin(measured.azimuth))


def predicted(
    fit: LobeFit, theta_i: float, theta_o: Float[np.ndarray, " n"], index: float
) -> Float[np.ndarray, " n"]:
    """Return f_r, averaged over bands, toward viewers in the plane of incidence.

    Args:
        fit: fit of one model.
        theta_i: angle of the light from the normal, rad.
        theta_o: (n,) angles of the viewers from the normal, positive away from the light, rad.
        index: index of refraction of dielectric facets.

    Returns:
        f_r (n,), sr^-1.
    """
    flat, light = np.zeros(len(theta_o)), np.full(len(theta_o), theta_i)
    wi = Vec(*(jnp.asarray(c) for c in (np.sin(light), flat, np.cos(light))))
    wo = Vec(*(jnp.asarray(c) for c in (-np.sin(theta_o), flat, np.cos(theta_o))))
    amplitudes = fit.diffuse.mean(keepdims=True), fit.specular.mean(keepdims=True)
    found = np.asarray(brdf(fit.model, *amplitudes, fit.shape, wi, wo, index))
    return np.broadcast_to(found[:, 0], len(theta_o))


def errors_figure(calibration: BRDFCalibration) -> "Figure":
    """Draw bars of both error metrics, in the order of the one that the fits minimise."""
    from matplotlib.patches import Rectangle

    order: list[Model] = sorted(
        MODELS, key=lambda m: -metric(calibration.held_out[m], calibration.objective)
    )
    figure, (cosine, root) = empty_panels((10.5, 4.4), columns=2, sharey=True)
    places = np.arange(len(order))
    colours = [AXIS_COLOURS[REFLECTANCES[m].axis] for m in order]
    shown = (
        (cosine, [100 * calibration.held_out[m].relative for m in order], "{:.1f}"),
        (root, [calibration.held_out[m].cube_root for m in order], "{:.3f}"),
    )
    seen = (
        [100 * calibration.fitted[m].relative for m in order],
        [calibration.fitted[m].cube_root for m in order],
    )
    for (axis, heights, style), lines in zip(shown, seen, strict=True):
        axis.barh(places, heights, 0.72, color=colours)
        axis.vlines(lines, places - 0.36, places + 0.36, color="k", lw=2)
        for place, height, line in zip(places, heights, lines, strict=True):
            axis.annotate(
                style.format(height),
                (max(height, line), place),
                (4, 0),
                textcoords="offset points",
                va="center",
                fontsize=9,
            )
        axis.margins(x=0.13)
    cosine.set_yticks(places, [LABELS[m] for m in order])
    cosine.set_xlabel("cosine-weighted RMS [% of the signal's]")
    root.set_xlabel("RMS of the cube root [sr$^{-1/3}$]")
    kinds = [Rectangle((0, 0), 1, 1, color=colour) for colour in AXIS_COLOURS.values()]
    labels = [f"lobe about the {name}" if name else "no lobe" for name in AXIS_NAMES.values()]
    figure.legend(kinds, labels, loc="outside upper center", ncols=3, fontsize=9)
    return figure


def incidences_figure(calibration: BRDFCalibration) -> "Figure":
    """Draw a table of held-out errors: one row for each model, one column for each incidence."""
    order: list[Model] = sorted(
        MODELS, key=lambda m: metric(calibration.held_out[m], calibration.objective)
    )
    percent = 100 * np.array([calibration.held_out[m].by_incidence for m in order])
    columns = [f"{x:.0f}°" for x in np.degrees(calibration.measured.incidences)]
    figure = _heat_table(percent, [LABELS[m] for m in order], columns, "held-out RMS [% of signal]")
    figure.axes[0].set_xlabel("angle of incidence")
    return figure


def materials_figure(calibrations: Sequence[BRDFCalibration]) -> "Figure":
    """Draw a table of held-out errors: one row for each model, one column for each material. The
    best model of each material is framed.
    """
    from matplotlib.patches import Rectangle

    objective = calibrations[0].objective
    factor = 100 if objective == "cosine" else 1
    label = "held-out RMS [% of signal]" if objective == "cosine" else "held-out RMS of cube root"
    values = np.array(
        [[factor * metric(c.held_out[m], objective) for c in calibrations] for m in MODELS]
    )
    columns = [c.measured.name.replace("_", "\n") for c in calibrations]
    figure = _heat_table(
        values, [LABELS[m] for m in MODELS], columns, label, style=".1f" if factor > 1 else ".3f"
    )
    for column, calibration in enumerate(calibrations):
        winner = MODELS.index(best(calibration.held_out, objective))
        frame = Rectangle((column - 0.5, winner - 0.5), 1, 1, fill=False, lw=2.5, color="tab:red")
        figure.axes[0].add_patch(frame)
    return figure


def _heat_table(
    values: Float[np.ndarray, "rows columns"],
    rows: Sequence[str],
    columns: Sequence[str],
    label: str,
    *,
    style: str = ".0f",
) -> "Figure":
    """Draw a table of numbers in which the shade of a cell shows the logarithm of its number."""
    from matplotlib.colors import LogNorm

    figure, axis = empty_panels((3.4 + 0.95 * len(columns), 1.2 + 0.42 * len(rows)))
    limit = min(float(values.max()), LIMIT) if style != ".3f" else float(values.max())
    scale = LogNorm(float(values.min()), max(limit, 1.01 * float(values.min())))
    shown = axis.imshow(values, cmap="viridis_r", norm=scale, aspect="auto")
    for (row, column), value in np.ndenumerate(values):
        dark = scale(min(value, limit)) > 0.55
        axis.text(
            column,
            row,
            format(value, style),
            ha="center",
            va="center",
            fontsize=9,
            color="w" if dark else "k",
        )
    axis.set_xticks(range(len(columns)), columns)
    axis.set_yticks(range(len(rows)), rows)
    bar = figure.colorbar(
        shown, ax=axis, label=label, extend="max" if values.max() > limit else "neither"
    )
    bar.ax.yaxis.set_major_formatter("{x:g}")
    bar.ax.yaxis.set_minor_formatter("{x:g}")
    return figure


def amplitudes_figure(calibration: BRDFCalibration) -> "Figure":
    """Draw the spectra of both amplitudes, or points if there are few bands."""
    measured, found, model = calibration.measured, calibration.amplitudes, calibration.model
    row = REFLECTANCES[model]
    terms = [("k_d", found.diffuse, found.diffuse_error, "sr$^{-1}$")]
    if has_lobe(model):
        unit = "" if row.unit == "1" else "sr$^{-1}$"
        terms.append(("k_s", found.specular, found.specular_error, unit))
    figure, axes = empty_panels((5 * len(terms), 3.4), columns=len(terms), squeeze=False)
    for axis, (symbol, values, error, unit) in zip(axes.flat, terms, strict=True):
        _draw_bands(axis, measured, values, error)
        name = f"${symbol[0]}_{symbol[2]}$"
        axis.set(ylabel=f"{name} [{unit}]" if unit else name, ylim=(0, None))
    return figure


def _draw_bands(
    axis: "Axes", measured: MeasuredBRDF, values: np.ndarray, error: np.ndarray
) -> None:
    if measured.wavelengths is not None:
        axis.errorbar(measured.wavelengths, values, error, fmt="o-", ms=3, lw=1, capsize=2)
        axis.set_xlabel("wavelength [nm]")
        return
    for i, band in enumerate(measured.bands):
        axis.errorbar(i, values[i], error[i], fmt="o", color=OF_CHANNEL.get(band, "0.5"), capsize=4)
    axis.set_xticks(range(len(measured.bands)), measured.bands)
    axis.margins(x=0.3)
