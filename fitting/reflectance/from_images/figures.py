"""Draw the pictures of a reflectance calibration."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ...report.figures import OF_CHANNEL, empty_panels
from ..models import LABELS, REFLECTANCES, has_lobe, shape_of
from .calibration import ReflectanceCalibration, mean_residual
from .fit import ChannelFit, lights_as_fitted, predicted_image
from .read import Photographs
from .samples import Selection, View
from .signal import decoded, lobe_with_slopes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARKERS = {"red": "o", "green": "s", "blue": "^", "grey": "o"}
DISPLAY_GAMMA = 2.2
SHOWN_LIGHTS = 2  # fitted, and held-out
OFF_HIGHLIGHT = 0.02  # share of the lobe's peak below which a pixel is away from the highlight
MOST_POINTS = 200_000


def images_figure(calibration: ReflectanceCalibration) -> "Figure":
    """Draw three rows of images: measured, predicted, and their difference. Columns are lights."""
    observation = calibration.observation
    as_fitted = [(lights_as_fitted(observation, fit), fit) for fit in calibration.chosen_fits]

    def images_of(light: int) -> tuple[np.ndarray, ...]:
        measured = observation.dn[:, light] - observation.black
        found = np.stack([predicted_image(seen, fit, light) for seen, fit in as_fitted])
        found -= observation.black
        white = np.quantile(found[:, observation.cosine[light] > 0], 0.995)
        clipped = observation.saturated[:, light].any(axis=0)
        left = np.where(clipped, np.nan, 100 * (measured - found).mean(axis=0) / white)
        return measured / white, found / white, left

    return draw_lights(observation, images_of, "% of white")


def draw_lights(
    observation: Photographs,
    images_of: Callable[[int], tuple[np.ndarray, ...]],
    label: str,
    *,
    largest: float | None = None,
) -> "Figure":
    """Draw the measured image, the predicted image and their difference under some of the lights.
    `images_of` returns these three for a light: two images (channels, pixels) relative to white and
    their difference (pixels,). `largest` is the end of the scale of differences; None for the 99th
    percentile of the differences.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import TwoSlopeNorm

    columns = {light: images_of(light) for light in shown_lights(observation)}
    if largest is None:
        worst = np.abs([left for _, _, left in columns.values()])
        largest = max(float(np.nanquantile(worst, 0.99)), 0.1)
    figure, axes = empty_panels(
        (1.2 + 2.2 * len(columns), 6.6), rows=3, columns=len(columns), squeeze=False
    )
    scale = TwoSlopeNorm(0, -largest, largest)
    for (light, (*pictures, left)), column in zip(columns.items(), axes.T, strict=True):
        for axis, values in zip(column, pictures, strict=False):
            displayed = np.clip(np.nan_to_num(values), 0, 1) ** (1 / DISPLAY_GAMMA)
            coloured = np.broadcast_to(displayed.T, (len(left), 3))
            axis.imshow(np.nan_to_num(_plane(observation, coloured)), interpolation="none")
        difference = _plane(observation, left)
        column[2].imshow(difference, cmap=_diverging(), norm=scale, interpolation="none")
        kind = "held out" if observation.held_out[light] else "fitted"
        column[0].set_title(f"{observation.files[light]}\n({kind})", fontsize=9)
    for axis, text in zip(axes[:, 0], ("measured", "predicted", "difference"), strict=True):
        axis.set_ylabel(text)
    for axis in axes.flat:
        axis.set(xticks=[], yticks=[])
    bar = {"extend": "both", "shrink": 0.3, "anchor": (0, 0), "aspect": 12}
    figure.colorbar(ScalarMappable(scale, _diverging()), ax=axes, label=label, **bar)
    return figure


def lobes_figure(calibration: ReflectanceCalibration) -> "Figure":
    """Draw measured diffuse and specular terms, each less the other as fitted."""
    figure, (diffuse, specular) = empty_panels((10, 4.2), columns=2)
    for fit in calibration.chosen_fits:
        _draw_terms(calibration, fit, diffuse, specular)
    diffuse.set(
        xlabel="n·l, cosine of incidence",
        ylabel="signal per unit light [DN]",
        title="away from the highlight",
        ylim=(0, None),
    )
    specular.set(
        xlabel="angle to the mirror direction [degrees]",
        ylabel="signal less diffuse term, per unit light [DN]",
        title="highlight",
    )
    diffuse.legend(fontsize=9, loc="upper left")
    specular.axhline(0, color="0.7", lw=0.8)
    return figure


def comparison_figure(calibration: ReflectanceCalibration) -> "Figure":
    """Draw the relative RMS error of each model and channel on a logarithmic axis."""
    from matplotlib.ticker import LogLocator, NullFormatter

    scores, channels = calibration.scores, calibration.observation.channels
    models = tuple(calibration.fits)
    figure, axis = empty_panels((5.4, 1.6 + 0.42 * len(models)))
    tested = any(score.predicted_error is not None for score in scores)
    for i, channel in enumerate(channels):
        own = {score.model: score for score in scores if score.channel == channel}
        rows = np.arange(len(models)) + 0.22 * (i - (len(channels) - 1) / 2)
        fitted = np.array([100 * own[model].fitted_error for model in models])
        predicted = np.array([own[model].predicted_error for model in models], float)
        shown = np.where(np.isnan(predicted), fitted, 100 * predicted)
        colour, marker = OF_CHANNEL[channel], MARKERS[channel]
        axis.plot(shown, rows, marker, color=colour, ms=6, label=channel)
        if tested:
            axis.plot(fitted, rows, "|", color="k", ms=9, mew=1.2)
        for value, row in zip(shown, rows, strict=True):
            place, offset = (value, row), (7, 0)
            axis.annotate(
                f"{value:.3g}", place, offset, fontsize=8.5, va="center", textcoords="offset points"
            )
    if tested:
        axis.plot([], [], "k|", ms=9, mew=1.2, label="on the fitted lights")
    axis.set_xscale("log")
    axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.xaxis.set_major_formatter("{x:g}")
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.set_yticks(range(len(models)), [LABELS[model] for model in models])
    axis.set_ylim(len(models) - 0.5, -0.5)
    axis.margins(x=0.12)
    axis.set_xlabel("relative RMS [%]")
    axis.grid(axis="x", alpha=0.3)
    figure.legend(
        *axis.get_legend_handles_labels(), fontsize=9, loc="outside upper center", ncols=4
    )
    return figure


def residual_map_figure(calibration: ReflectanceCalibration) -> "Figure":
    """Draw the mean relative residual of every pixel."""
    from matplotlib.colors import TwoSlopeNorm

    percent = 100 * mean_residual(calibration)
    largest = max(float(np.nanquantile(np.abs(percent), 0.98)), 0.1)
    figure, axis = empty_panels((5.4, 4.4))
    observation = calibration.observation
    rows, columns = observation.rows, observation.columns
    shown = axis.imshow(
        _plane(observation, percent),
        extent=(columns.min() - 0.5, columns.max() + 0.5, rows.max() + 0.5, rows.min() - 0.5),
        cmap=_diverging(),
        norm=TwoSlopeNorm(0, -largest, largest),
    )
    axis.set(xlabel="column [pixel]", ylabel="row [pixel]")
    figure.colorbar(shown, ax=axis, label="measured − predicted [%]", extend="both")
    return figure


def shown_lights(observation: Photographs) -> list[int]:
    """Return two fitted and two held-out lights, one near the view and one oblique."""
    lit = (observation.cosine > 0).mean(axis=1)
    chosen = []
    for kept in (False, True):
        of_kind = np.flatnonzero(observation.held_out == kept)
        ordered = of_kind[np.argsort(-lit[of_kind])]
        chosen += [*ordered[:: max(len(ordered) - 1, 1)][:SHOWN_LIGHTS]]
    return [int(light) for light in chosen]


def _draw_terms(
    calibration: ReflectanceCalibration, fit: ChannelFit, diffuse: "Axes", specular: "Axes"
) -> None:
    values, cosine, angle, unit = _normalise_signal(calibration, fit)
    colour, marker = OF_CHANNEL[fit.channel], MARKERS[fit.channel]
    natural = dict(zip((p.name for p in fit.space), fit.natural, strict=True))
    shown = has_lobe(fit.form.model)
    rough = fit.form.model != "lambert" and not shown
    body = natural["diffuse"] * (unit if rough else np.maximum(cosine, 0))
    glossy = unit / unit.max() if shown else np.zeros_like(unit)
    away = glossy < OFF_HIGHLIGHT
    edges = np.linspace(0, 1, 26)
    _draw_medians(diffuse, cosine[away], values[away], edges, colour, marker)
    if rough:
        _draw_medians(diffuse, cosine, body, edges, colour, label=fit.channel)
    else:
        diffuse.plot([0, 1], [0, natural["diffuse"]], color=colour, label=fit.channel)
    reach = _lobe_reach(angle, glossy)
    edges = reach * np.linspace(0, 1, 31) ** 1.3
    _draw_medians(specular, np.degrees(angle), values - body, np.degrees(edges), colour, marker)
    if not shown:
        return
    highlight = natural["specular"] * unit
    if REFLECTANCES[fit.form.model].axis == "mirror":
        order = np.argsort(angle)
        near = order[angle[order] <= reach][:: max(1, len(order) // 20_000)]
        specular.plot(np.degrees(angle[near]), highlight[near], color=colour)
    else:
        _draw_medians(specular, np.degrees(angle), highlight, np.degrees(edges), colour)


def _normalise_signal(
    calibration: ReflectanceCalibration, fit: ChannelFit
) -> tuple[Float[np.ndarray, " samples"], ...]:
    """Return the decoded signal per irradiance, n.l, mirror angle and unit lobe of the fitted,
    unsaturated samples. Of many samples, only every n-th is used.
    """
    observation = calibration.observation
    step = max(1, len(calibration.fitted.light) // MOST_POINTS)
    selection = Selection(calibration.fitted.light[::step], calibration.fitted.pixel[::step])
    channel = fit.view.channel
    samples = View(lights_as_fitted(observation, fit), channel, selection).samples(fit.form)
    natural = {p.name: v for p, v in zip(fit.space, fit.natural, strict=True)}
    gamma = natural.get("gamma", samples.gamma)
    linear = decoded(samples.dn, float(samples.black), float(samples.white), gamma)
    ambient = natural.get("ambient", 0.0)
    unit = np.zeros(len(linear))
    if fit.form.model != "lambert":
        place = [p.name for p in fit.space].index(shape_of(fit.form.model).name)
        unit = lobe_with_slopes(fit.form, fit.vector[place], samples.geometry)[0]
    angle = observation.mirror_angle[selection.light, selection.pixel]
    cosine = np.asarray(samples.geometry.wi.z)
    lit = cosine > 0
    trusted = lit & (observation.dn[channel, selection.light, selection.pixel] < observation.clip)
    values = (linear - ambient) / np.asarray(samples.geometry.irradiance)
    return values[trusted], cosine[trusted], angle[trusted], unit[trusted]


def _lobe_reach(angle: np.ndarray, unit: np.ndarray) -> float:
    """Return the mirror angle, rad, beyond the highlight; 1 without a highlight."""
    inside = unit > OFF_HIGHLIGHT
    return float(min(1.3 * angle[inside].max(), np.pi)) if inside.any() else 1.0


def _draw_medians(
    axis: "Axes",
    x: np.ndarray,
    y: np.ndarray,
    edges: np.ndarray,
    colour: str,
    marker: str | None = None,
    *,
    label: str | None = None,
) -> None:
    """Draw medians in bins: marks with bars over the middle 68 %, or a line."""
    place = np.digitize(x, edges) - 1
    rows = [
        (np.median(x[chosen]), *np.quantile(y[chosen], [0.16, 0.5, 0.84]))
        for chosen in (place == i for i in range(len(edges) - 1))
        if chosen.sum() >= 5
    ]
    if not rows:
        return
    middle, low, median, high = np.array(rows).T
    if marker is None:
        axis.plot(middle, median, color=colour, label=label)
        return
    axis.errorbar(
        middle, median, [median - low, high - median], fmt=marker, ms=3, lw=0.8, color=colour
    )


def _plane(observation: Photographs, values: np.ndarray) -> np.ndarray:
    """Return the values as an image of the object's bounding box, NaN outside the object."""
    row, column = (x - x.min() for x in (observation.rows, observation.columns))
    plane = np.full((row.max() + 1, column.max() + 1, *values.shape[1:]), np.nan)
    plane[row, column] = values
    return plane


def _diverging():
    import matplotlib

    return matplotlib.colormaps["RdBu_r"].with_extremes(bad="0.6")
