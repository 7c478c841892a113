"""Figures of a noise calibration: photon transfer, responsivity, signal-to-noise ratio and dark
signal."""

from functools import partial
from typing import TYPE_CHECKING

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..inference.formatting import decimals_for, format_number
from ..report.figures import BLUE, GREY, ORANGE, empty_panels
from ..report.section import Picture
from .calibration import NoiseCalibration
from .emva1288 import linearity_deviation
from .levels import shot_of, signal_of
from .model import NoiseData, predicted_moments
from .neighbours import NeighbourData
from .quantised import Moments
from .regressions import line

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIZE = (5.4, 4.6)
POINTS = 300  # points of a drawn curve


def noise_pictures(calibration: NoiseCalibration) -> tuple[Picture, ...]:
    """Return the four figures of a calibration, as functions that draw them."""
    return (
        Picture(
            "photon_transfer",
            "Photon transfer",
            "Temporal variance against mean signal, both above dark. The slope is the gain K; "
            "the variance collapses past the saturation point. Below: how far each variance is off "
            "the straight line of the standard's K, in per cent; a curve there is a gain that "
            "changes with signal.",
            partial(photon_transfer_figure, calibration),
        ),
        Picture(
            "signal_to_noise",
            "Signal to noise ratio",
            "Measured points against the fitted camera, and the limit of an ideal sensor, which "
            "loses no photon. Dashed: threshold (SNR = 1) and saturation; between them lies the "
            "dynamic range.",
            partial(signal_to_noise_figure, calibration),
        ),
        Picture(
            "responsivity",
            "Responsivity and linearity",
            "Mean signal above dark against light. Below: deviations in per cent of the standard's "
            "linearity line; their extremes over the shaded range are the linearity errors.",
            partial(responsivity_figure, calibration),
        ),
        Picture(
            "dark_signal",
            "Dark signal",
            "Mean and variance without light against exposure, with the pixel noise of each point "
            "as its error bar. Slopes are dark current; scatter beyond the bars is a black level "
            "that wanders or noise that pixels share.",
            partial(dark_signal_figure, calibration),
        ),
    )


def photon_transfer_figure(calibration: NoiseCalibration) -> "Figure":
    """Draw variance against mean on logarithmic axes; below, the residuals."""
    measurement = calibration.measurement
    signal, shot = signal_of(measurement), shot_of(measurement)
    gain = float(calibration.standard.values["system_gain"])
    figure, (upper, lower) = empty_panels(SIZE, rows=2, sharex=True, height_ratios=(3, 1.4))
    used = np.isin(np.arange(len(signal)), calibration.usable)
    drawable = (signal > 0) & (shot > 0)
    floor = shot[used & drawable].min() / 3
    beyond, below = ~used & (signal > 0), shot < floor
    for mask, height, mark, colour, label in (
        (used & drawable, shot, ".", BLUE, "levels used by the likelihood"),
        (beyond & ~below, shot, ".", GREY, "beyond the linear range"),
        # A clipped level has almost no variance: draw an arrow on the edge, not two more decades.
        (beyond & below, 1.15 * floor + 0 * shot, "v", GREY, "clipped, below the axis"),
    ):
        if mask.any():
            upper.loglog(signal[mask], height[mask], mark, color=colour, label=label, ms=6)
    curve_x = curve_y = np.zeros(0)
    if calibration.likelihood is not None:
        _, moments, unlit = _model_curve(calibration)
        curve_x, curve_y = moments.mean - unlit.mean, moments.variance - unlit.variance
        upper.loglog(curve_x, curve_y, color=ORANGE, lw=1.5, label="fitted camera")
    ends = np.array([signal[used & drawable].min(), signal.max()])
    upper.loglog(
        ends, gain * ends, color="k", lw=0.8, ls="--", label=f"EMVA 1288: K = {gain:.4g} DN/e⁻"
    )
    _mark_saturation(calibration, upper, signal)
    upper.set_ylabel("variance above dark [DN²]")
    upper.set_ylim(floor, 6 * np.nanmax(shot))  # with room for the legend
    upper.legend(fontsize=9, loc="upper left")

    expected = gain * signal[used]
    error = 100 * measurement.bright.variance_error[used] / np.abs(expected)
    lower.errorbar(
        signal[used], 100 * (shot[used] / expected - 1), error, fmt=".", color=BLUE, ms=6, lw=0.8
    )
    inside = (curve_x >= ends[0]) & (curve_x <= signal[used].max())
    lower.semilogx(
        curve_x[inside], 100 * (curve_y / (gain * curve_x) - 1)[inside], color=ORANGE, lw=1.5
    )
    lower.axhline(0, color="k", lw=0.8, ls="--")
    lower.set_ylabel("off the line [%]")
    lower.set_xlabel("mean signal above dark [DN]")
    return figure


def responsivity_figure(calibration: NoiseCalibration) -> "Figure":
    """Draw the signal against light, with a second panel of the deviations from linearity."""
    measurement = calibration.measurement
    light = np.asarray(measurement.bright.light)
    signal = signal_of(measurement)
    within = np.asarray(calibration.within.linearity)
    figure, (upper, lower) = empty_panels(SIZE, rows=2, sharex=True, height_ratios=(3, 1.4))
    upper.plot(light, signal, ".", color=BLUE, ms=6, label="levels")
    if calibration.likelihood is not None:
        x, moments, unlit = _model_curve(calibration, spacing="even")
        upper.plot(x, moments.mean - unlit.mean, color=ORANGE, lw=1.5, label="fitted camera")
    _mark_saturation(calibration, upper, light)
    upper.set_ylabel("mean signal above dark [DN]")
    upper.legend(fontsize=9)

    deviation = np.asarray(
        linearity_deviation(jnp.asarray(light), jnp.asarray(signal), calibration.within.linearity)
    )
    lower.axvspan(light[within].min(), light[within].max(), color="0.93", zorder=0)
    lower.plot(light[within], deviation[within], ".-", color=BLUE, ms=6, lw=0.6)
    lower.axhline(0, color="k", lw=0.8, ls="--")
    lower.set_ylabel("off the line [%]")
    lower.set_xlabel(_light_label(calibration))
    return figure


def signal_to_noise_figure(calibration: NoiseCalibration) -> "Figure":
    """Draw the signal-to-noise ratio against light, on logarithmic axes."""
    measurement = calibration.measurement
    light = np.asarray(measurement.bright.light)
    signal = signal_of(measurement)
    noise = np.sqrt(np.asarray(measurement.bright.variance))
    figure, axis = empty_panels((SIZE[0], 3.8))
    shown = (signal > 0) & (noise > 0)
    if calibration.within.saturation is not None:
        shown &= light <= float(calibration.within.saturation)
    axis.loglog(light[shown], signal[shown] / noise[shown], ".", color=BLUE, ms=6, label="levels")
    x = light[shown]
    if calibration.likelihood is not None:
        # From the light at an SNR of about one half.
        values = calibration.standard.values
        threshold = float(values["threshold_electrons"] * values["system_gain"])
        x, moments, unlit = _model_curve(calibration, spacing="even")
        faintest = 0.5 * threshold / float(np.max(moments.mean - unlit.mean)) * float(x.max())
        x, moments, unlit = _model_curve(calibration, faintest=faintest)
        ratio = (moments.mean - unlit.mean) / np.sqrt(moments.variance)
        axis.loglog(x, ratio, color=ORANGE, lw=1.5, label="fitted camera")
    if measurement.photons_known:
        axis.loglog(x, np.sqrt(x), color=GREY, lw=0.8, label="ideal sensor")
    values = calibration.standard.values
    marks = {"threshold_photons": "threshold", "saturation_photons": "saturation"}
    for name, label in marks.items():
        if name in values:
            place = float(values[name])
            known = format_number(place, decimals_for(float(calibration.standard.errors[name])))
            axis.axvline(place, color="k", lw=0.8, ls="--")
            axis.annotate(
                f" {label}\n {known} photons",
                (place, axis.get_ylim()[0]),
                xytext=(2 if name == "threshold_photons" else -2, 6),
                textcoords="offset points",
                ha="left" if name == "threshold_photons" else "right",
                fontsize=9,
            )
    axis.axhline(1, color="k", lw=0.5, ls=":")
    axis.set_xlabel(_light_label(calibration))
    axis.set_ylabel("signal to noise ratio")
    axis.legend(fontsize=9, loc="upper left")
    return figure


def dark_signal_figure(calibration: NoiseCalibration) -> "Figure":
    """Draw the mean and the variance of the darks against exposure."""
    dark = calibration.measurement.dark
    exposure = 1e3 * np.asarray(dark.exposure)
    count = np.asarray(dark.pixels * dark.frames)
    mean, variance = np.asarray(dark.mean), np.asarray(dark.variance)
    figure, (upper, lower) = empty_panels(SIZE, rows=2, sharex=True)
    panels = (
        (upper, mean, np.sqrt(variance / count), "dark mean [DN]", "mean"),
        (lower, variance, dark.variance_error, "dark variance [DN²]", "variance"),
    )
    values, errors = calibration.standard.values, calibration.standard.errors
    for axis, y, error, label, way in panels:
        axis.errorbar(exposure, y, error, fmt=".", color=BLUE, ms=6, lw=0.8)
        axis.set_ylabel(label)
        axis.ticklabel_format(axis="y", useOffset=False)
        name = f"dark_current_{way}"
        if name in values:
            intercept, slope = line(jnp.asarray(exposure), jnp.asarray(y))
            ends = np.array([0, exposure.max()])
            places = decimals_for(float(errors[name]))
            value, error = (format_number(float(x), places) for x in (values[name], errors[name]))
            current = f"{value} ± {error} e⁻/s"
            axis.plot(ends, float(intercept) + float(slope) * ends, color=ORANGE, label=current)
            axis.legend(fontsize=9)
    lower.set_xlabel("exposure [ms]")
    return figure


def _model_curve(
    calibration: NoiseCalibration, *, spacing: str = "log", faintest: float | None = None
) -> tuple[np.ndarray, Moments, Moments]:
    """Return light values, and the chosen model's mean and variance with that light and without
    light, at the median exposure. The light offset of the model is set to 0, because the offset is
    a property of the test bench."""
    fit = calibration.chosen
    data = fit.data
    bright = np.asarray(data.light)[np.asarray(data.lit) > 0]
    low = faintest if faintest is not None else bright[bright > 0].min()
    light = (
        np.geomspace(low, bright.max(), POINTS)
        if spacing == "log"
        else np.linspace(0, bright.max(), POINTS)
    )
    curve = NoiseData(
        light=jnp.asarray(light),
        lit=jnp.zeros(POINTS),
        exposure=jnp.full(POINTS, jnp.median(data.exposure)),
        frames=jnp.full(POINTS, 2.0),
        pixels=data.pixels,
        top_signal=data.top_signal,
        neighbours=data.neighbours and NeighbourData(data.neighbours.variance_terms),
        photons_known=data.photons_known,
    )
    predicted = eqx.filter_jit(predicted_moments)
    lit, unlit = (predicted(fit.values, curve, light) for light in (curve.light, 0 * curve.light))
    return light, lit, unlit


def _mark_saturation(calibration: NoiseCalibration, axis: "Axes", x: np.ndarray) -> None:
    saturated = calibration.measurement.saturated
    if saturated is not None:
        axis.axvline(x[saturated], color="k", lw=0.8, ls=":", label="saturation point")


def _light_label(calibration: NoiseCalibration) -> str:
    if calibration.measurement.photons_known:
        return "light [photons per pixel and exposure]"
    return "light, as exposure [s]"
