"""The camera response from an exposure stack: the whole curve, gamma, and the merged radiance map,
per colour channel (or Bayer site) and group of images.

    stack = read_exposure_stack(load_rig("folder"))
    section = response_section(calibrate_response(stack))
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxvision.errors import InputError

from .exposures import ExposureStack, Plane, read_exposure_stack
from .gamma import GammaFit, fit_gamma
from .posterior import SamplingOptions, convergence_in_words
from .radiance_map import RadianceMap, merge
from .response_curve import ResponseCurve, fit_response_curve
from .results import Estimate, Picture, Section, Table, not_determined

__all__ = [
    "ChannelResponse",
    "ResponseCalibration",
    "calibrate_response",
    "radiance_images",
    "read_exposure_stack",
    "response_section",
]

PURE = 0.05  # departure in ln exposure up to which a response counts as a pure gamma
SURE = 0.02  # standard error of ln exposure up to which a departure is judged
QUIET = 0.1  # relative noise of one pixel up to which a departure is judged
EDGES = 0.05, 0.95  # of the range of codes, between which a departure is judged
FEW_FREE = 2  # visible shutter errors below which the prior speaks


@dataclass(frozen=True)
class ChannelResponse:
    """What one plane gave."""

    plane: Plane
    curve: ResponseCurve
    gamma: GammaFit
    radiance: RadianceMap


@dataclass(frozen=True)
class ResponseCalibration:
    """The planes that could be calibrated, and (plane, reason) of those that could not."""

    stack: ExposureStack
    channels: tuple[ChannelResponse, ...]
    skipped: tuple[tuple[Plane, str], ...]
    sampling: SamplingOptions | None
    seed: int


def calibrate_response(
    stack: ExposureStack, *, sampling: SamplingOptions | None = None, seed: int = 0
) -> ResponseCalibration:
    """Calibrates every plane of a stack; with `sampling` gamma's intervals come from emcee.

    A plane that cannot be calibrated (too dark, all clipped) is set aside with its reason;
    `InputError` when none can.
    """
    channels, skipped = [], []
    for plane in stack.planes:
        try:
            channels.append(_calibrate(plane, stack, sampling, seed))
        except InputError as error:
            skipped.append((plane, str(error)))
    if not channels:
        plane, reason = skipped[0]
        raise InputError(f"{plane.files[0]} and its stack ({plane.label}): {reason}")
    return ResponseCalibration(stack, tuple(channels), tuple(skipped), sampling, seed)


def _calibrate(
    plane: Plane, stack: ExposureStack, sampling: SamplingOptions | None, seed: int
) -> ChannelResponse:
    curve = fit_response_curve(
        plane.codes[:, plane.mask],
        plane.exposures,
        bits=stack.bits,
        black=plane.black,
        clip=plane.clip,
    )
    if sampling is not None and sampling.checkpoint is not None:
        sampling = replace(sampling, checkpoint=sampling.checkpoint / plane.label.replace("/", "_"))
    gamma = fit_gamma(curve, label=plane.label, sampling=sampling, seed=seed)
    return ChannelResponse(plane, curve, gamma, merge(plane.codes, plane.exposures, curve))


def radiance_images(calibration: ResponseCalibration) -> dict[str, Float[np.ndarray, "h w *rgb"]]:
    """Radiance maps by group, float32, relative: (h, w, 3) for colour, (h / 2, w / 2, 3) for a
    mosaic (its greens averaged), (h, w) for grey. A group lacking a colour is left out."""
    images = {}
    for group in dict.fromkeys(channel.plane.group for channel in calibration.channels):
        maps = {
            channel.plane.channel: channel.radiance.radiance
            for channel in calibration.channels
            if channel.plane.group == group
        }
        if {"green 1", "green 2"} <= maps.keys():
            maps["green"] = (maps["green 1"] + maps["green 2"]) / 2
        if "grey" in maps:
            images[group] = maps["grey"]
        elif {"red", "green", "blue"} <= maps.keys():
            images[group] = np.stack([maps[colour] for colour in ("red", "green", "blue")], axis=-1)
    return images


def response_section(calibration: ResponseCalibration) -> Section:
    """The calibration as its reader sees it."""
    estimates: list[Estimate] = []
    for channel in calibration.channels:
        estimates += _gamma_estimates(channel)
    for plane, reason in calibration.skipped:
        estimates.append(not_determined("gamma", "γ", "", reason, group=plane.label))
    return Section(
        kind="response",
        title="Camera response",
        estimates=tuple(estimates),
        findings=_findings(calibration),
        pictures=_pictures(calibration),
        tables=(_channel_table(calibration.channels), _curve_table(calibration.channels)),
        posteriors={
            channel.plane.label or "grey": channel.gamma.posterior
            for channel in calibration.channels
        },
        settings=_settings(calibration),
    )


def _gamma_estimates(channel: ChannelResponse) -> list[Estimate]:
    """Gamma and the shutter error; neither where the response is no pure gamma, for the misfit
    would pass for one or the other."""
    size, _ = largest_departure(channel.curve, channel.gamma.departure)
    if not size > PURE:
        return [channel.gamma.gamma, channel.gamma.shutter_error]
    reason = (
        f"the response is no pure gamma: the best one, {channel.gamma.gamma.value:.3f}, misses the "
        f"measured curve by up to {np.expm1(size):.0%} in exposure; use the curve"
    )
    label = channel.plane.label
    return [
        not_determined("gamma", "γ", "", reason, group=label),
        not_determined("shutter_error", "τ", "", "it would hold the misfit of gamma", group=label),
    ]


def largest_departure(
    curve: ResponseCurve, departure: Float[np.ndarray, " bins"]
) -> tuple[float, float]:
    """(|departure| in ln exposure, code) where it is largest, among the codes between 5 and 95 % of
    the range that are known to 2 % and whose pixels are known to 10 %."""
    share = (curve.codes - curve.bins.black) / (curve.bins.edges[-1] - curve.bins.black)
    central = (share > EDGES[0]) & (share < EDGES[1])
    known = (curve.standard_error < SURE) & (curve.pixel_noise < QUIET)
    judged = central & curve.seen & known & np.isfinite(departure)
    if not judged.any():
        return float("nan"), float("nan")
    size = np.where(judged, np.abs(departure), -1)
    return float(size.max()), float(curve.codes[np.argmax(size)])


def _findings(calibration: ResponseCalibration) -> tuple[str, ...]:
    channels = calibration.channels
    found = [_shape_in_words(channels), *_shutter_in_words(channels)]
    found += [
        f"{channel.plane.label or 'The grey channel'}: the measured curve is not monotone, so some "
        "codes share an exposure; look for misaligned images or a moving scene."
        for channel in channels
        if not channel.curve.monotone
    ]
    black = sorted({channel.plane.black for channel in channels})
    if black[-1] >= 0.5:
        levels = " and ".join(f"{level:g}" for level in {black[0]: 0, black[-1]: 0})
        found.append(f"Black lies at {levels} DN; codes at or below it were left out.")
    for channel in channels:
        dropped = len(channel.plane.exposures) - len(channel.curve.exposures)
        if dropped:
            found.append(
                f"{channel.plane.label or 'The stack'}: {dropped} of "
                f"{len(channel.plane.exposures)} exposures share no unclipped pixels with another "
                "and were not used."
            )
    for plane, reason in calibration.skipped:
        found.append(f"{plane.label or 'The stack'} was not calibrated: {reason}")
    for channel in channels:
        found += [f"{channel.plane.label}: {text}" for text in channel.gamma.findings]
        if calibration.sampling is not None:
            found.append(f"{channel.plane.label}: {convergence_in_words(channel.gamma.posterior)}")
    return tuple(text for text in found if text)


def _shape_in_words(channels: Sequence[ChannelResponse]) -> str:
    sizes = [largest_departure(c.curve, c.gamma.departure) for c in channels]
    worst = int(np.nanargmax([size for size, _ in sizes])) if np.isfinite(sizes).any() else 0
    size, code = sizes[worst]
    where = channels[worst].plane.label or "the grey channel"
    if not np.isfinite(size):
        return "No code is known well enough to judge how far the response is a pure gamma."
    if size <= PURE:
        return (
            f"A pure gamma describes the response: the measured curve departs from it by at most "
            f"{np.expm1(size):.1%} in exposure ({where}, code {code:g})."
        )
    srgb, _ = largest_departure(channels[worst].curve, channels[worst].gamma.srgb_departure)
    better = (
        f"; the sRGB curve fits better, to within {np.expm1(srgb):.1%}" if srgb < size / 2 else ""
    )
    many = sum(s > PURE for s, _ in sizes)
    return (
        f"The response is not a pure gamma in {many} of {len(channels)} channels: the measured "
        f"curve departs by up to {np.expm1(size):.0%} in exposure ({where}, code {code:g})"
        f"{better}. Use the curve rather than gamma."
    )


def _shutter_in_words(channels: Sequence[ChannelResponse]) -> list[str]:
    found = []
    shaky = [c for c in channels if c.curve.shutter_error is not None]
    few = [c for c in channels if len(c.curve.exposures) - 2 < FEW_FREE]
    if shaky:
        worst = max(shaky, key=lambda c: c.curve.shutter_error or 0.0)
        found.append(
            f"In {len(shaky)} of {len(channels)} channels the images disagree on their exposure "
            f"times by more than pixel noise, at most {worst.curve.shutter_error:.1%} rms "
            f"({worst.plane.label or 'the grey channel'}): inaccurate shutter times, or a small "
            "misfit of the curve. The intervals include it, and channels of one image share it."
        )
    elif not few:
        found.append(
            "The exposure times agree with the images within pixel noise; no shutter error is seen."
        )
    if few:
        found.append(
            f"{len(few[0].curve.exposures)} exposures show next to nothing of the shutter's error: "
            "the intervals of gamma rest on the assumption of about 1 % (a factor of 4.5 either "
            "way); take more exposures."
        )
    return found


def _channel_table(channels: Sequence[ChannelResponse]) -> Table:
    rows = []
    for channel in channels:
        gap, _ = largest_departure(channel.curve, channel.gamma.departure)
        srgb, _ = largest_departure(channel.curve, channel.gamma.srgb_departure)
        clean = np.mean(channel.radiance.coverage[channel.plane.mask] > 0)
        rows.append(
            (
                channel.plane.label or "grey",
                len(channel.curve.exposures),
                channel.curve.statistics.pixels,
                f"{channel.plane.black:g}",
                f"{np.expm1(gap):.1%}",
                f"{np.expm1(srgb):.1%}",
                f"{channel.gamma.dispersion:.2f}",
                f"{clean:.1%}",
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
            "merged",
        ),
        tuple(rows),
        "Off gamma and off sRGB: largest departure of the measured curve, in exposure, between "
        "5 and 95 % of the range. χ² ratio: misfit of the best gamma over that of the free curve. "
        "Merged: pixels with at least one exposure clear of clipping.",
    )


def _curve_table(channels: Sequence[ChannelResponse]) -> Table:
    shown = channels[:4]
    codes = shown[0].curve.codes
    picks = codes[np.linspace(0, len(codes) - 1, 17).astype(int)]
    rows = []
    for code in picks:
        cells: list[Any] = [f"{code:g}"]
        for channel in shown:
            place = int(np.argmin(np.abs(channel.curve.codes - code)))
            value = np.exp(channel.curve.log_exposure[place])
            error = value * channel.curve.standard_error[place]
            seen = channel.curve.seen[place]
            cells.append(f"{value:.4g} ± {error:.1g}" if seen else "(extrapolated)")
        rows.append(tuple(cells))
    return Table(
        "Response curve",
        ("code (DN)", *(channel.plane.label or "grey" for channel in shown)),
        tuple(rows),
        "Exposure of each code relative to mid-scale, with its standard error.",
    )


def _settings(calibration: ResponseCalibration) -> dict[str, Any]:
    return {
        "bits": calibration.stack.bits,
        "seed": calibration.seed,
        "planes": {
            channel.plane.label or "grey": {
                "files": list(channel.plane.files),
                "exposures": channel.plane.exposures.tolist(),
                "black": channel.plane.black,
                "clip": channel.plane.clip,
                "smoothness": channel.curve.smoothness,
                "noise": vars(channel.curve.noise),
                "codes": channel.curve.codes.tolist(),
                "log_exposure": channel.curve.log_exposure.tolist(),
                "standard_error": channel.curve.standard_error.tolist(),
            }
            for channel in calibration.channels
        },
    }


def _pictures(calibration: ResponseCalibration) -> tuple[Picture, ...]:
    from .figures import response as figures

    first = calibration.channels[0]
    images = radiance_images(calibration) or {first.plane.group: first.radiance.radiance}
    return (
        Picture(
            "response-curve",
            "Response curve",
            "Exposure that gives each code, with its 95 % band; dots are pixels, at the radiance "
            "that all their exposures agree on. Dashed: the best gamma. A straight line on these "
            "axes is a pure gamma; dotted parts hold no usable pixels and are extrapolated.",
            lambda: figures.curve_figure(calibration),
        ),
        Picture(
            "gamma-departure",
            "How far the response is from gamma and from sRGB",
            "Measured exposure over the one that the model gives, with the curve's 95 % band. A "
            "model that fits stays at zero within the band.",
            lambda: figures.departure_figure(calibration),
        ),
        Picture(
            "exposure-offsets",
            "Exposure times as the images see them",
            "Offset of each image's exposure from its nominal time, beyond what a factor or an "
            "exponent common to all explains; bars are 95 %. Scatter is shutter error, a smooth "
            "bow a slight misfit of the curve.",
            lambda: figures.offsets_figure(calibration),
        ),
        Picture(
            "radiance-map",
            "Merged radiance map",
            "The merged map, tone-mapped by r / (1 + r) of its log average, beside the middle "
            "exposure alone. Highlights and shadows that clip on the right hold detail on the "
            "left.",
            lambda: figures.radiance_figure(calibration, images),
        ),
        Picture(
            "coverage",
            "Exposures behind each pixel",
            "How many exposures, clear of clipping and noise, each pixel of the map rests on, in "
            "its worst channel. Zero marks pixels that are only bounded.",
            lambda: figures.coverage_figure(calibration),
        ),
    )
