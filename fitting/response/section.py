"""The report on a response calibration: estimates, findings, tables and figures."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from ..inference.estimates import Estimate, not_determined
from ..inference.formatting import format_percent, format_with_error
from ..report.left_out import left_out_tables
from ..report.section import Columns, Picture, Section, Table
from . import figures
from .calibration import ChannelResponse, ResponseCalibration, radiance_images
from .curve import ResponseCurve
from .findings import exposure_step, findings
from .gamma import GAMMA, SHUTTER_ERROR
from .shape import Shape, largest_departure, shapes

UNKNOWN = 1e6  # error factor of a curve above which a code counts as unknown


def section(calibration: ResponseCalibration) -> Section:
    """Return the report section of a calibrated response."""
    estimates: list[Estimate] = []
    for channel, shape in zip(calibration.channels, shapes(calibration.channels), strict=True):
        estimates += _gamma_estimates(channel, shape)
    for plane, reason in calibration.skipped:
        estimates.append(not_determined(GAMMA, reason, group=plane.label))
    return Section(
        kind="response",
        title="Camera response",
        estimates=tuple(estimates),
        findings=findings(calibration),
        pictures=_pictures(calibration),
        tables=(
            _channel_table(calibration.channels),
            _curve_table(calibration.channels),
            *left_out_tables(
                (channel.plane.name, channel.gamma.left_out) for channel in calibration.channels
            ),
        ),
        posteriors={
            channel.plane.name: channel.gamma.posterior for channel in calibration.channels
        },
        settings=_settings(calibration),
        data={"curve": curve_columns(calibration.channels)},
    )


def curve_columns(channels: Sequence[ChannelResponse]) -> Columns:
    """Return the columns of the complete curves, with a row for each code and channel."""
    curves = [channel.curve for channel in channels]
    labels = [channel.plane.name for channel in channels]
    log_exposure = np.concatenate([curve.log_exposure for curve in curves])
    error = np.concatenate([curve.standard_error for curve in curves])
    exposure, half = np.exp(log_exposure), np.concatenate([c.half_width for c in curves])
    half = np.where(half > np.log(UNKNOWN), np.inf, half)  # unknown codes
    return {
        "channel": np.repeat(labels, [len(curve.codes) for curve in curves]),
        "code": np.concatenate([curve.codes for curve in curves]),
        "exposure": exposure,
        "standard_error": exposure * error,
        "lower_95": np.exp(log_exposure - half),
        "upper_95": np.exp(log_exposure + half),
        "seen": np.concatenate([curve.seen for curve in curves]),
    }


def _gamma_estimates(channel: ChannelResponse, shape: Shape) -> list[Estimate]:
    """Return gamma and shutter error, or why a response that is no gamma has none."""
    if step := exposure_step(channel):
        reason = f"the light changes by a factor of {step[1]:.3g} at {step[0]}, as the findings say"
        names = (GAMMA, SHUTTER_ERROR)
        return [not_determined(name, reason, group=channel.plane.label) for name in names]
    if shape.pure:
        return [channel.gamma.gamma, channel.gamma.shutter_error]
    reason = (
        f"the response is no pure gamma: the best one, {channel.gamma.gamma.value:.3f}, differs "
        "from the measured curve by up to "
        f"{format_percent(np.expm1(shape.significant))} in exposure; "
        "use the curve"
    )
    label = channel.plane.label
    return [
        not_determined(GAMMA, reason, group=label),
        not_determined(SHUTTER_ERROR, "it would include the misfit of gamma", group=label),
    ]


def _channel_table(channels: Sequence[ChannelResponse]) -> Table:
    rows = []
    for channel in channels:
        gap, _ = largest_departure(channel.curve, channel.gamma.departure)
        srgb, _ = largest_departure(channel.curve, channel.gamma.srgb_departure)
        clean = float(np.mean(channel.radiance.coverage[channel.plane.mask] > 0))
        held = channel.curve.held_out
        rows.append(
            (
                channel.plane.name,
                len(channel.curve.exposures),
                channel.curve.statistics.pixels,
                f"{channel.plane.black:g}",
                format_percent(np.expm1(gap), decimals=1),
                format_percent(np.expm1(srgb), decimals=1),
                f"{channel.gamma.dispersion:.2f}",
                "" if held is None else format_with_error(held.mean, held.standard_error),
                format_percent(clean, decimals=1),
            )
        )
    return Table(
        "Channels",
        (
            "channel",
            "exposures",
            "pixels",
            "black (DN)",
            "off gamma",
            "off sRGB",
            "χ² ratio",
            "left out (DN)",
            "merged",
        ),
        tuple(rows),
        "Off gamma and off sRGB: largest departure of the measured curve, in exposure, between "
        "5 and 95 % of the range where the curve is known to 5 % and a pixel to 10 %. χ² ratio: "
        "misfit of the best gamma over that of the free curve. Left out: rms error of the "
        "prediction of each exposure from the others. Merged: pixels with at least one exposure "
        "clear of clipping.",
    )


def _curve_table(channels: Sequence[ChannelResponse]) -> Table:
    shown = channels[:4]
    codes = shown[0].curve.codes
    picks = codes[np.linspace(0, len(codes) - 1, 17).astype(int)]
    return Table(
        "Response curve",
        ("code (DN)", *(channel.plane.name for channel in shown)),
        tuple((f"{code:g}", *(_exposure_at_code(c.curve, code) for c in shown)) for code in picks),
        "Exposure of each code relative to mid-scale, with its standard error. A dash stands for "
        "codes that the channel does not have above its black.",
    )


def _exposure_at_code(curve: ResponseCurve, code: float) -> str | None:
    """Format the exposure at a code, interpolated in logarithms; None outside."""
    if not max(curve.bins.black, curve.bins.edges[0]) < code <= curve.bins.edges[-1]:
        return None
    place = np.log(code - curve.bins.black)
    value = np.exp(np.interp(place, curve.bins.log_codes, curve.log_exposure))
    error = value * np.interp(place, curve.bins.log_codes, curve.standard_error)
    seen = curve.seen[np.argmin(np.abs(curve.codes - code))]
    return format_with_error(value, error) + ("" if seen else " (extrapolated)")


def _settings(calibration: ResponseCalibration) -> dict[str, Any]:
    return {
        "bits": calibration.stack.bits,
        "seed": calibration.seed,
        "planes": {
            channel.plane.name: {
                "files": list(channel.plane.files),
                "exposures": channel.plane.exposures.tolist(),
                "black": channel.plane.black,
                "clip": channel.plane.clip,
                "smoothness": channel.curve.smoothness,
                "design_effect": channel.curve.design_effect,
                "noise": vars(channel.curve.noise),
                "codes": channel.curve.codes.tolist(),
                "log_exposure": channel.curve.log_exposure.tolist(),
                "standard_error": channel.curve.standard_error.tolist(),
                "half_width_95": channel.curve.half_width.tolist(),
            }
            for channel in calibration.channels
        },
    }


def _pictures(calibration: ResponseCalibration) -> tuple[Picture, ...]:
    first = calibration.channels[0]
    images = radiance_images(calibration) or {first.plane.group: first.radiance.radiance}
    return (
        Picture(
            "response_curve",
            "Response curve",
            "Exposure of each code, with its 95 % band; dots are pixels, at the radiance "
            "estimated from all their exposures. Dashed: the best gamma. A straight line on these "
            "axes is a pure gamma; dotted parts have no usable pixels and are extrapolated. Where "
            "the band is narrower than its line, the next figure shows it.",
            partial(figures.curve_figure, calibration),
        ),
        Picture(
            "gamma_departure",
            "How far the response is from gamma and from sRGB",
            "Measured exposure over that of the model, with the curve's 95 % band. A "
            "model that fits stays at zero within the band.",
            partial(figures.departure_figure, calibration),
        ),
        Picture(
            "exposure_offsets",
            "Exposure times estimated from the images",
            "Offset of each image's exposure from its nominal time, after a common factor and a "
            "common exponent; bars are 95 %. Scatter is shutter error, and a smooth curve is a "
            "slight misfit of the response.",
            partial(figures.offsets_figure, calibration),
        ),
        Picture(
            "radiance_map",
            "Merged radiance map",
            "Radiance merged from all exposures, beside that of the middle exposure alone, "
            "in sRGB up to the same white. Where that exposure clips, its radiance is that of "
            "the brightest code. Below, both are brightened equally: the shadows of the map come "
            "from longer exposures, which have less noise.",
            partial(figures.radiance_figure, calibration, images),
            is_whole=True,
        ),
        Picture(
            "coverage",
            "Exposures behind each pixel",
            "Number of exposures behind each pixel of the map, without clipped and noisy ones, in "
            "its worst channel. Zero marks pixels for which only a bound is known.",
            partial(figures.coverage_figure, calibration),
        ),
    )
