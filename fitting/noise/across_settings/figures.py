"""Figures of a camera at several gains and temperatures: gain, read noise and dark current."""

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ...report.figures import BLUE, GREY, ORANGE, empty_panels
from ...report.section import Picture
from ..figures import SIZE
from .calibration import CameraCalibration
from .statement import BOLTZMANN_EV, proportional_gain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

POINTS = 200  # of a drawn curve
HALF_BAND = (0.025, 0.975)  # quantiles of what is shaded
ZERO_CELSIUS = 273.15  # K


def camera_pictures(calibration: CameraCalibration) -> tuple[Picture, ...]:
    """Return the figures that show how settings differ, as functions that draw them."""
    gains = {setting.gain for setting in calibration.settings}
    found = []
    if len(gains) > 1:
        found.append(
            Picture(
                "gain_over_settings",
                "Conversion gain",
                "K against the stated gain: of each setting by itself, and of all together, which "
                "the shared quantum efficiency ties to each other. Below: how far each is off "
                "proportion, with 95 % intervals.",
                partial(gain_figure, calibration),
            )
        )
        found.append(
            Picture(
                "read_noise_over_gain",
                "Read noise over gain",
                "Noise before the amplifier (dashed) and noise behind it (dotted), which falls "
                "with gain; shaded: the 95 % band of the law. Points: each setting by itself, with "
                "95 % intervals; below, in per cent of the fit.",
                partial(read_noise_figure, calibration),
            )
        )
    if len({setting.temperature for setting in calibration.settings}) > 1 and any(
        {"dark_current", "dark_signal_rate"} & {*one.names} for one in calibration.fit.by_setting
    ):
        found.append(
            Picture(
                "dark_current_over_temperature",
                "Dark current over temperature",
                "Arrhenius' plot: a straight line is one mechanism, its slope the activation "
                "energy; shaded: the 95 % band. Points: each setting by itself, with 95 % "
                "intervals; arrows are upper ends where nothing was seen.",
                partial(dark_current_figure, calibration),
            )
        )
    return tuple(found)


def gain_figure(calibration: CameraCalibration) -> "Figure":
    """Draw the gain K against the stated gain; below, its deviations from proportionality."""
    fit = calibration.fit
    factor = np.array([setting.gain_factor for setting in calibration.settings])
    proportion = proportional_gain(fit)
    assert proportion is not None
    scale = proportion[0]
    figure, (upper, lower) = empty_panels(SIZE, rows=2, sharex=True, height_ratios=(3, 1.6))
    alone, log_gain, error = _separate_estimates(calibration, "system_gain")
    shared = np.exp(np.asarray(calibration.figures.log_gain))
    spread = np.sqrt(np.diagonal(fit.covariance))[np.asarray(fit.fit.problem.inputs["system_gain"])]
    upper.loglog(factor, shared, "o", color=ORANGE, ms=8, mfc="none", label="all settings together")
    upper.loglog(factor[alone], np.exp(log_gain), ".", color=BLUE, ms=6, label="each by itself")
    ends = np.array([factor.min(), factor.max()])
    upper.loglog(ends, scale * ends, color="k", lw=0.8, ls="--", label="proportional")
    upper.set_ylabel("K [DN/e⁻]")
    _plain_ticks(upper.yaxis)
    upper.legend(fontsize=9)
    beside = _separate_abscissas(factor[alone])
    off = 100 * (np.exp(log_gain) / (scale * factor[alone]) - 1)
    lower.errorbar(factor[alone] * beside, off, 196 * error, fmt=".", color=BLUE, ms=5, lw=0.8)
    off = 100 * (shared / (scale * factor) - 1)
    lower.errorbar(factor, off, 196 * spread, fmt="o", color=ORANGE, ms=8, mfc="none", lw=1.5)
    lower.axhline(0, color="k", lw=0.8, ls="--")
    lower.set_ylabel("off proportion [%]")
    unit = "ISO speed" if calibration.settings[0].gain_unit == "ISO" else "factor"
    lower.set_xlabel(f"stated gain [{unit}]")
    factors = np.unique(factor)
    lower.set_xticks(factors, [f"{one:.4g}" for one in factors], minor=False)
    lower.set_xticks([], minor=True)
    return figure


def read_noise_figure(calibration: CameraCalibration) -> "Figure":
    """Draw read noise against K, with the law of noise before and behind the amplifier."""
    fit = calibration.fit
    gain = np.exp(np.asarray(calibration.figures.log_gain))
    figure, (axis, lower) = empty_panels(SIZE, rows=2, sharex=True, height_ratios=(3, 1.6))
    alone, log_value, error = _separate_estimates(calibration, "read_noise")
    best, draws = fit.fit.values, fit.fit.draws
    if "variance_before_gain" in best:
        x = np.geomspace(gain.min() / 1.15, 1.15 * gain.max(), POINTS)
        variances = "variance_before_gain", "variance_behind_gain"
        before, behind = (float(best[name]) for name in variances)
        of_draws = (draws[name].reshape(-1, 1) for name in variances)
        drawn = next(of_draws) + next(of_draws) / x**2
        curve = np.sqrt(before + behind / x**2)
        _draw_law(axis, lower, x, curve, np.sqrt(np.maximum(drawn, 0)), "law")
        if before > 0:
            axis.axhline(np.sqrt(before), color=GREY, lw=0.8, ls="--", label="before the amplifier")
        if behind > 0:
            axis.plot(x, np.sqrt(behind) / x, color=GREY, lw=0.8, ls=":", label="behind it")
    log_fit = np.log(np.asarray(calibration.figures.read_variance))[alone] / 2
    value = np.exp(log_value)
    bars = value * (1 - np.exp(-1.96 * error)), value * (np.exp(1.96 * error) - 1)
    beside = gain[alone] * _separate_abscissas(gain[alone])
    _draw_settings(axis, lower, beside, value, bars, np.exp(log_value - log_fit) - 1, error)
    axis.set(xscale="log", yscale="log", ylim=(0.6 * value.min(), 1.6 * value.max()))
    lower.set_xlabel("K [DN/e⁻]")
    axis.set_ylabel("read noise [e⁻]")
    _plain_ticks(axis.xaxis)
    _plain_ticks(axis.yaxis)
    axis.legend(fontsize=9)
    return figure


def dark_current_figure(calibration: CameraCalibration) -> "Figure":
    """Draw dark current against the inverse of temperature (Arrhenius' plot)."""
    fit = calibration.fit
    gain = np.exp(np.asarray(calibration.figures.log_gain))
    points = [own.dark_current(k) for own, k in zip(fit.by_setting, gain, strict=True)]
    value, error = np.array(points).T
    kelvin = np.array([setting.temperature or ZERO_CELSIUS for setting in fit.settings])
    known = np.isfinite(value)
    x = 1000 / kelvin
    figure, (axis, lower) = empty_panels(SIZE, rows=2, sharex=True, height_ratios=(3, 1.6))
    floor = np.inf
    expected = np.asarray(calibration.figures.dark_current)
    best, draws = fit.fit.values, fit.fit.draws
    if "activation_energy" in best:
        line = np.linspace(x.min(), x.max(), POINTS)
        colder = -(line / 1000 - 1 / (fit.reference or 1.0)) / BOLTZMANN_EV
        energy = float(best["activation_energy"])
        curve = best["dark_current"] * np.exp(energy * colder)
        drawn = np.exp(draws["activation_energy"].reshape(-1, 1) * colder)
        drawn = draws["dark_current"].reshape(-1, 1) * drawn
        label = f"Arrhenius' law, E = {energy:.3g} eV"
        floor = _draw_law(axis, lower, line, curve, drawn, label)
    seen = known & (value > 1.96 * error)
    beside = x * (1 + 0.002 * (_separate_abscissas(x) - 1) / 0.02)
    off, off_error = value / expected - 1, np.abs(error / expected)
    own = (one[seen] for one in (beside, value, 1.96 * error, off, off_error))
    _draw_settings(axis, lower, *own)
    hidden = known & ~seen
    upper = value + 1.96 * error
    axis.plot(beside[hidden], upper[hidden], "v", color=BLUE, ms=5, mfc="none")
    lowest = min([floor, *(value[seen] - 1.96 * error[seen]), *upper[hidden]])
    axis.set(yscale="log", ylim=(max(lowest, 1e-12) / 1.5, 1.5 * float(np.max(upper[known]))))
    lower.set_xlabel("1000 / temperature [1/K]")
    axis.set_ylabel("dark current [e⁻/s]")
    above = axis.secondary_xaxis(
        "top", functions=(lambda u: 1000 / np.maximum(u, 1e-3), lambda t: 1000 / np.maximum(t, 1))
    )
    above.set_ticks(np.unique(kelvin))
    above.set_xlabel("temperature [K]")
    axis.legend(fontsize=9)
    return figure


def _draw_law(
    upper: "Axes", lower: "Axes", x: np.ndarray, curve: np.ndarray, drawn: np.ndarray, label: str
) -> float:
    """Draw a law with the 95 % band of its draws; return the lowest value of the band."""
    band = np.quantile(drawn, HALF_BAND, axis=0)
    upper.plot(x, curve, color=ORANGE, lw=1.5, label=label)
    for axis, (low, high) in ((upper, band), (lower, 100 * (band / curve - 1))):
        axis.fill_between(x, low, high, color=ORANGE, alpha=0.25, lw=0)
    return float(band[0].min())


def _draw_settings(
    upper: "Axes",
    lower: "Axes",
    x: np.ndarray,
    value: np.ndarray,
    bars: np.ndarray | tuple[np.ndarray, np.ndarray],
    off: np.ndarray,
    error: np.ndarray,
) -> None:
    """Draw each setting's estimate with 95 % bars, and below its deviation from the joint fit."""
    style = {"fmt": ".", "color": BLUE, "lw": 0.8}
    upper.errorbar(x, value, bars, ms=6, label="each setting by itself", **style)
    lower.errorbar(x, 100 * off, 196 * error, ms=5, **style)
    lower.axhline(0, color=ORANGE, lw=1.0)
    lower.set_ylabel("off the fit [%]")


def _separate_estimates(
    calibration: CameraCalibration, name: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return indices, estimates and errors of the settings that determine a quantity alone."""
    value, error = np.array([one.estimate(name) for one in calibration.fit.by_setting]).T
    alone = np.flatnonzero(np.isfinite(value))
    return alone, value[alone], error[alone]


def _separate_abscissas(x: Float[np.ndarray, " points"]) -> Float[np.ndarray, " points"]:
    """Return factors on the abscissas that separate points of equal abscissa in a figure."""
    order = np.zeros(len(x))
    for place in np.unique(x):
        own = np.flatnonzero(x == place)
        order[own] = np.arange(len(own)) - (len(own) - 1) / 2
    return 1 + 0.02 * order


def _plain_ticks(axis: "Axis") -> None:
    """Label a logarithmic axis with plain numbers instead of powers of ten."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())
