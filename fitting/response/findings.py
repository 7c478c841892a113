"""Findings of a response calibration: the curve's shape, errors of exposure times, and data that
were left out."""

from collections.abc import Sequence

import numpy as np
from scipy.special import stdtrit

from ..inference.diagnostics import listed
from ..inference.formatting import format_percent, format_with_error
from ..inference.trust import convergence_in_words
from .calibration import ChannelResponse, ResponseCalibration
from .curve import ResponseCurve, ripple
from .read import unchanged
from .repeats import FAR
from .shape import (
    FALSE_ALARM_PROBABILITY,
    LARGEST_STANDARD_ERROR,
    PURE,
    error_of_departure,
    judged_codes,
    largest,
    largest_departure,
    shapes,
)
from .shutter import step_of
from .solve import ROUGHEST

DRAWN = 0.1  # standard error of ln exposure up to which the figure shows a departure
CLUSTERED = 2.0  # number of pixels that count as one, from which it is reported
MOSTLY_SEEN = 0.8  # share of observed codes below which the extrapolated ones are reported
FEW_FREE = 2  # number of determined shutter errors below which the prior dominates
LEAST_MOVED = 0.002  # share of an image's pixels that show something else than the others
SUSPECT_SHUTTER_ERROR = 0.1  # shutter error from which a time or a gain is more likely wrong
APART_ERRORS = 3.0  # standard errors from which a deviation of one image is named
RARE, WIDE = 0.01, 8.0  # share of pixels at an image's lowest code; range of exposures
BLACKS = 0.01  # shutter error from which black points of single images are a possible cause
LEAST_POWER = 0.01  # departure of the power between two colours from 1 that is reported
ENCODED = 0.1  # difference of gamma from 1 from which pictures are encoded
SAID = 0.1  # DN of shared rounding from which it is reported
NOTABLE_RIPPLE = 0.5  # share of a curve's variance from which its ripple is reported


def findings(calibration: ResponseCalibration) -> tuple[str, ...]:
    """Return the findings about the response and its images as sentences."""
    channels = calibration.channels
    found = [*calibration.stack.remarks, _shape_in_words(channels), _untested_codes(channels)]
    found += [_extrapolated_in_words(channels), _anchor_in_words(channels)]
    found += [_moved_in_words(channels), *_shutter_in_words(channels), _local_in_words(channels)]
    found += [_held_out_in_words(channels), _repeats_in_words(channels), _rough_in_words(channels)]
    found += [_clipping_sentences(channels), _hidden_in_words(channels)]
    found += [_busy_in_words(channels), _ripple_in_words(channels)]
    found += [_one_hue_in_words(channels), _colours_apart_in_words(channels)]
    found += [
        f"{channel.plane.label or 'The grey channel'}: the measured curve is not monotone, so some "
        "codes share an exposure; look for misaligned images or a moving scene."
        for channel in channels
        if not channel.curve.monotone
    ]
    found.append(_black_in_words(channels))
    remarks = " ".join(calibration.stack.remarks)
    for channel in channels:
        dropped = len(channel.plane.exposures) - len(channel.curve.exposures)
        dropped -= sum(f"{name} was left out" in remarks for name in channel.plane.files)
        if dropped > 0:
            found.append(
                f"{channel.plane.label or 'The stack'}: {dropped} of "
                f"{len(channel.plane.exposures)} exposures share no unclipped pixels with another "
                "and were not used."
            )
    for plane, reason in calibration.skipped:
        found.append(
            f"{plane.label or 'The stack'} was not calibrated, and is NaN in the radiance map: "
            f"{reason}"
        )
    for channel in channels:
        found += [f"{channel.plane.label}: {text}" for text in channel.gamma.findings]
        if calibration.sampling is not None:
            found.append(f"{channel.plane.label}: {convergence_in_words(channel.gamma.posterior)}")
    return tuple(text for text in found if text)


def _black_in_words(channels: Sequence[ChannelResponse]) -> str:
    names: dict[str, list[str]] = {}
    for channel in channels:
        names.setdefault(f"{channel.plane.black:g}", []).append(channel.plane.name)
    if max(channel.plane.black for channel in channels) < 0.5:
        lowest = _lowest_above_assumed_black(channels)
        if lowest is None:
            return ""
        return (
            "Neither the rig nor the files state a black level, so 0 DN was assumed. "
            f"The lowest code is {lowest}, so the black level may be as high as that. The curve's "
            "shape and gamma depend on it: state camera.black_level, or give darks."
        )
    each = [f"{level} ({', '.join(own)})" for level, own in names.items()]
    levels = listed(each) if len(names) > 1 else next(iter(names))
    return f"The black level is {levels} DN; the curve begins above it."


def _lowest_above_assumed_black(channels: Sequence[ChannelResponse]) -> int | None:
    """Return the lowest code if it is above an assumed black level; else None."""
    if any(c.plane.black_measured or c.plane.black >= 0.5 for c in channels):
        return None
    lowest = []
    for plane in (c.plane for c in channels):
        seen = plane.mask & ~unchanged(plane.codes, plane.exposures)
        lowest.append(int((plane.codes[:, seen] if seen.any() else plane.codes).min()))
    return min(lowest) if min(lowest) > 1 else None


def _own_blacks_in_words(channels: Sequence[ChannelResponse]) -> str:
    """Return a finding on images each scaled to its own black: equal, rare lowest codes."""
    for channel in channels:
        plane = channel.plane
        lowest = np.array([int(image.min()) for image in plane.codes])
        span = plane.exposures.max() / plane.exposures.min()
        brightest = plane.codes[int(np.argmax(plane.exposures))]
        rare = np.mean(brightest == lowest[0]) < RARE
        if not plane.black_measured and (lowest == lowest[0]).all() and span >= WIDE and rare:
            return (
                f" The lowest code of every image is {lowest[0]}, although the exposures differ by "
                f"a factor of {span:.0f}. A raw converter that sets a black point for each image "
                "has this effect and biases exposure times and gamma; switch it off."
            )
    return ""


def _shape_in_words(channels: Sequence[ChannelResponse]) -> str:
    found = shapes(channels)
    sizes = np.array([shape.size for shape in found])
    odd = _oddest_time(channels)
    doubt = f" A wrong exposure time or gain has the same effect: check {odd} first." if odd else ""
    unsure = f" A wrong exposure time or gain can hide in it: check {odd} first." if odd else ""
    if not np.isfinite(sizes).any():
        return "No code is known well enough to judge how far the response is a pure gamma."
    judged = [channel.curve.codes[judged_codes(channel.curve)] for channel in channels]
    ends = [(own[0], own[-1]) for own in judged if len(own)]
    each = "it is" if len(ends) == 1 else "each channel is"
    codes = (
        f"codes {min(low for low, _ in ends):g} to {max(high for _, high in ends):g}, where {each} "
        f"known to {format_percent(LARGEST_STANDARD_ERROR)}"
    )
    shown = np.array([shape.significant for shape in found])
    worst = int(np.argmax(shown) if shown.any() else np.nanargmax(sizes))
    shape, where = found[worst], channels[worst].plane.label or "the grey channel"
    if not shown.any():
        size = f"{100 * np.expm1(shape.size):.2g} % in exposure ({where}, code {shape.code:g})"
        if shape.size > PURE:
            return (
                f"A pure gamma explains the response over {codes}: the measured curve departs from "
                f"it by up to {size}, which its errors explain. Exposures closer to each other "
                f"would test this more sharply.{unsure}"
            )
        return (
            f"A pure gamma describes the response over {codes}: the measured curve departs from it "
            f"by at most {size}, which its errors explain.{unsure}"
        )
    largest_one = format_percent(np.expm1(shape.significant), decimals=int(shape.pure))
    size = (
        f"by up to {largest_one} in exposure ({where}, code {shape.significant_code:g}, known to "
        f"{format_percent(shape.significant_error)})"
    )
    if shape.pure:
        return (
            f"A pure gamma describes the response roughly over {codes}: the measured curve departs "
            f"from it {size}, more than its errors explain. Use the curve where that matters."
        )
    srgb, _ = largest_departure(channels[worst].curve, channels[worst].gamma.srgb_departure)
    better = (
        f"; the sRGB curve fits better, to within {100 * np.expm1(srgb):.2g} %"
        if srgb < shape.significant / 2
        else ""
    )
    many = sum(not one.pure for one in found)
    if (lowest := _lowest_above_assumed_black(channels)) is not None:
        doubt += f" So has a black level other than the assumed 0 DN; the lowest code is {lowest}."
    return (
        f"The response is not a pure gamma in {many} of {len(channels)} channels: the measured "
        f"curve departs {size}{better}. Use the curve rather than gamma.{doubt}"
    )


def _oddest_time(channels: Sequence[ChannelResponse]) -> str:
    """Name the exposure time to check if times scatter more than shutters do; else ""."""
    shaky = [c for c in channels if (c.curve.shutter_error or 0.0) > SUSPECT_SHUTTER_ERROR]
    if not shaky:
        return ""
    worst = max(shaky, key=lambda c: c.curve.shutter_error or 0.0)
    curve, plane = worst.curve, worst.plane
    if step := exposure_step(worst):
        return f"aperture, gain and times from {step[0]} on"
    offsets = np.abs(curve.shutter_offsets)
    most = int(np.argmax(offsets))
    clear = offsets[most] > APART_ERRORS * curve.shutter_offset_errors[most]
    if not clear or offsets[most] < 2 * np.median(offsets):
        return "the stated times and the gains"
    place = int(np.argmin(np.abs(plane.exposures - curve.exposures[most])))
    return f"the time and gain of {plane.files[place]}"


def exposure_step(channel: ChannelResponse) -> tuple[str, float] | None:
    """Return the image from which the light steps, and the factor; else None."""
    curve, plane = channel.curve, channel.plane
    if not (curve.shutter_error or 0.0) > SUSPECT_SHUTTER_ERROR:
        return None
    order = np.argsort(curve.exposures)
    step = step_of(np.log(curve.exposures[order]), curve.shutter_offsets[order])
    if step is None:
        return None
    first = curve.exposures[order][step[0]]
    place = int(np.argmin(np.abs(plane.exposures - first)))
    return plane.files[place], float(np.exp(step[1]))


def _step_in_words(channels: Sequence[ChannelResponse]) -> str:
    steps = [step for channel in channels if (step := exposure_step(channel))]
    if not steps:
        return ""
    return (
        f" From {steps[0][0]} on the light is {steps[0][1]:.3g} times that of the other images at "
        "the stated times, as with another aperture or gain, or where a time is missing and the "
        "next ones took its place. Curve and radiance map are wrong by that."
    )


def _untested_codes(channels: Sequence[ChannelResponse]) -> str:
    """Return a finding on larger deviations from gamma outside the tested codes."""
    found = []
    for channel in channels:
        curve, gap, error = (
            channel.curve,
            channel.gamma.departure,
            error_of_departure(channel.curve),
        )
        drawn = curve.seen & (curve.standard_error < DRAWN)
        limit = stdtrit(
            curve.freedom, 1 - FALSE_ALARM_PROBABILITY / (2 * max(np.count_nonzero(drawn), 1))
        )
        size, code = largest(curve, gap, drawn & (np.abs(gap) > limit * error))
        if np.isfinite(size):
            found.append((size, code, error[curve.codes == code][0], channel.plane.label))
    judged = [largest_departure(c.curve, c.gamma.departure)[0] for c in channels]
    size, code, error, name = max(found, key=lambda one: one[0], default=(0.0, 0.0, 0.0, ""))
    if not size > max(PURE, np.nanmax([0, *judged])):
        return ""
    return (
        f"Outside these codes the figure shows a departure of {format_percent(np.expm1(size))} "
        f"({name or 'the grey channel'}, code {code:g}, known to {format_percent(error)})."
    )


def _extrapolated_in_words(channels: Sequence[ChannelResponse]) -> str:
    """Return a finding on codes at which curves are extrapolated, if many are."""
    sentences = []
    for channel in channels:
        curve = channel.curve
        codes = curve.codes[curve.seen]
        if not len(codes) or np.mean(curve.seen) > MOSTLY_SEEN:
            continue
        halfway = (codes[0] + curve.bins.black) / 2
        low = curve.half_width[np.argmax(curve.codes >= halfway)]
        sentences.append(
            f"{channel.plane.name} below {codes[0]:g} and above {codes[-1]:g} (95 % "
            f"within {format_percent(min(np.expm1(low), 99.0))} at code {halfway:g})"
        )
    if not sentences:
        return ""
    return (
        f"The curve is extrapolated over codes without usable pixels: {', '.join(sentences)}. "
        "The extrapolation averages gamma, sRGB, logarithmic and film curves that fit the other "
        "codes."
    )


def _anchor_in_words(channels: Sequence[ChannelResponse]) -> str:
    dim = [c for c in channels if c.curve.bins.anchor is not None]
    if not dim:
        return ""
    names = ", ".join(f"{c.plane.name}: {c.curve.codes[c.curve.bins.middle]:g}" for c in dim)
    return (
        "Too few pixels reach mid-scale. Exposures are therefore relative to the middle of the "
        f"observed codes ({names} DN), and the curve above these codes is extrapolated."
    )


def _held_out_in_words(channels: Sequence[ChannelResponse]) -> str:
    each = [
        f"{format_with_error(c.curve.held_out.mean, c.curve.held_out.standard_error)} DN"
        f"{f' ({c.plane.label})' if c.plane.label else ''}"
        for c in channels
        if c.curve.held_out is not None and np.isfinite(c.curve.held_out.standard_error)
    ]
    if not each:
        return ""
    return f"A held-out exposure is predicted from the others to {', '.join(each)} rms."


def _moved_in_words(channels: Sequence[ChannelResponse]) -> str:
    """Return a finding on pixels that show something else in one image."""
    held = [(c, c.curve.held_out) for c in channels if c.curve.held_out is not None]
    known = [(c, one) for c, one in held if np.isfinite(one.far).any()]
    channel, worst = max(known, key=lambda own: np.nanmax(own[1].far), default=(None, None))
    if channel is None or worst is None or not np.nanmax(worst.far) > LEAST_MOVED:
        return ""
    if _oddest_time(channels):  # wrong times shift all codes
        return ""
    most = int(np.nanargmax(worst.far))
    place = int(np.argmin(np.abs(channel.plane.exposures - worst.exposures[most])))
    return (
        f"At up to {format_percent(worst.far[most], decimals=1)} of the pixels an image differs "
        f"from what the others predict by more than {FAR:g} times the usual error, most of all "
        f"{channel.plane.files[place]}: something moved, or the light of a part of the scene "
        "changed (or edges were denoised differently). The radiance map is wrong there; mask it."
    )


def _local_in_words(channels: Sequence[ChannelResponse]) -> str:
    """Return a finding on local tone mapping, which a comparison of exposures does not reveal."""
    gammas = [channel.gamma.gamma for channel in channels]
    encoded = any(
        one.value is not None and abs(one.value - 1) > ENCODED + 3 * (one.standard_error or 0.0)
        for one in gammas
    )
    if not encoded:
        return ""
    return (
        "The curve is that of a pixel under all exposures. Tone mapping by the brightness of its "
        "surroundings (HDR modes, active lighting, clarity) can change all pixels alike with the "
        "exposure: gamma is then too high and the radiance map wrong between places, and the "
        "images do not show it. Switch it off, or use raw images."
    )


def _repeats_in_words(channels: Sequence[ChannelResponse]) -> str:
    worst = max(channels, key=lambda c: c.curve.clustering)
    if not worst.curve.clustering > CLUSTERED:
        return ""
    return (
        "The errors of neighbouring pixels are correlated: up to "
        f"{worst.curve.clustering:.0f} pixels count as one "
        f"({worst.plane.label or 'the grey channel'}). Causes are misregistration, motion, "
        "compression, local tone mapping (which gives a wrong curve), or a response that depends "
        "on colour. The error bands are estimated from "
        "the scatter between parts of the picture and between exposures."
    )


def _hidden_in_words(channels: Sequence[ChannelResponse]) -> str:
    blurred = [c for c in channels if c.hidden_peaks]
    if not blurred:
        return ""
    names = ", ".join(c.plane.name for c in blurred)
    kept = ", ".join(c.plane.name for c in blurred if not c.clear_of_hidden)
    unless = f" They were kept for {kept}, where too few would remain: bright codes may be too low."
    return (
        "Pixels around clipped peaks are darker than other pixels of equal code "
        f"({names}), as if the camera blurs or resamples after clipping. Pixels within four of "
        "such peaks were left out, so few pixels near full scale may remain."
        f"{unless if kept else ''}"
    )


def _clipping_sentences(channels: Sequence[ChannelResponse]) -> str:
    near = [c for c in channels if not c.clear]
    if not near:
        return ""
    names = ", ".join(c.plane.name for c in near)
    return (
        f"Too few pixels are far from clipped ones ({names}), so those near them count too. If "
        "demosaicking or JPEG mixes neighbours, the curve is too steep near full scale."
    )


def _ripple_in_words(channels: Sequence[ChannelResponse]) -> str:
    sizes = {}
    for channel in channels:
        curve, name = channel.curve, channel.plane.name
        size = ripple(curve.exposures, curve.smoothness)
        if size**2 > NOTABLE_RIPPLE * np.median(curve.standard_error[curve.seen] ** 2):
            sizes[name] = size
    if not sizes:
        return ""
    return (
        "All exposures are more than two stops apart, so the data cannot exclude a ripple of that "
        f"period in the response ({', '.join(sizes)}). The error bands include a ripple of "
        f"{format_percent(max(sizes.values()), decimals=1)}. "
        "One more exposure, a stop from another, would settle this."
    )


def _one_hue_in_words(channels: Sequence[ChannelResponse]) -> str:
    shared = {c.plane.label: c.shared_rounding for c in channels if c.shared_rounding > SAID}
    if not shared:
        return ""
    return (
        "The pictures were JPEG, which rounds brightness and colour separately. In a scene of one "
        "hue all pixels of a code share that error, which the error bands include: "
        f"{max(shared.values()):.2g} DN rms ({', '.join(shared)}). A scene of several hues does "
        "not have this error."
    )


def _colours_apart_in_words(channels: Sequence[ChannelResponse]) -> str:
    """Return a finding on colours whose exposures are powers of each other."""
    powers = []
    for green in (c for c in channels if c.plane.channel == "green"):
        for other in channels:
            if other.plane.group == green.plane.group and other.plane.channel in ("red", "blue"):
                power, error = _power_of(other.curve, green.curve)
                if abs(power - 1) > max(LEAST_POWER, APART_ERRORS * error):
                    powers.append(f"{other.plane.label} {format_with_error(power, error)}")
    if not powers:
        return ""
    return (
        f"The exposures of equal codes are powers of those of green ({', '.join(powers)}), as with "
        "a white balance that changes from image to image with the exposure; curves and gammas are "
        "then wrong by these powers. Fix the white balance, unless the camera has another curve in "
        "each colour."
    )


def _power_of(curve: ResponseCurve, reference: ResponseCurve) -> tuple[float, float]:
    """Return the power between the exposures of two curves, and its largest error."""
    codes = curve.codes[curve.seen]
    x = np.interp(codes, reference.codes, reference.log_exposure)
    x = np.where(np.interp(codes, reference.codes, reference.seen) > 0.5, x, 0.0)
    y, errors = curve.log_exposure[curve.seen], curve.standard_error[curve.seen]
    errors = np.hypot(errors, np.interp(codes, reference.codes, reference.standard_error))
    square = float(x @ x)
    if square == 0:
        return 1.0, np.inf
    return float(x @ y) / square, float(np.abs(x) @ errors) / square


def _busy_in_words(channels: Sequence[ChannelResponse]) -> str:
    each = {
        c.plane.name: largest(c.curve, c.curve.busy_places, judged_codes(c.curve))
        for c in channels
        if np.any(c.curve.busy_places)
    }
    known = {name: (size, code) for name, (size, code) in each.items() if np.isfinite(size)}
    if not known:
        return ""
    size, code = max(known.values())
    return (
        "The curve of detailed parts of the picture differs from the curve of flat parts "
        f"({', '.join(known)}), by up "
        f"to {format_percent(np.expm1(size), decimals=1)} in exposure at code {code:g}, as if the "
        "camera sharpens. The curve uses flat parts only, gamma uses all."
    )


def _rough_in_words(channels: Sequence[ChannelResponse]) -> str:
    """Return a finding on curves that are no gamma and have the smallest allowed smoothness."""
    if not any(c.curve.smoothness <= ROUGHEST for c in channels):
        return ""
    rough = [
        c
        for c, shape in zip(channels, shapes(channels), strict=True)
        if c.curve.smoothness <= ROUGHEST and (shape.significant > 0 or np.isnan(shape.size))
    ]
    if not rough:
        return ""
    names = ", ".join(c.plane.name for c in rough)
    return (
        f"The smoothness is at its lower bound ({names}): the measured curve bends more than "
        "those of cameras do, so part of its detail is misfit."
    )


def _shutter_in_words(channels: Sequence[ChannelResponse]) -> list[str]:
    found = []
    shaky = [c for c in channels if c.curve.shutter_error is not None]
    few = [c for c in channels if len(c.curve.exposures) - 2 < FEW_FREE]
    odd = _oddest_time(channels)
    if shaky:
        worst = max(shaky, key=lambda c: c.curve.shutter_error or 0.0)
        error = worst.curve.shutter_error or 0.0
        found.append(
            f"In {len(shaky)} of {len(channels)} channels the images disagree on their exposure "
            "times by more than pixel noise, at most "
            f"{100 * error:.2g} % rms "
            f"({worst.plane.label or 'the grey channel'}). Causes are inaccurate shutter times, or "
            "a small misfit of the curve. The intervals include this error, which the channels of "
            "one image share."
            + (f" No shutter is as inaccurate as that: check {odd} first." if odd else "")
            + _step_in_words(channels)
            + (_own_blacks_in_words(channels) if error > BLACKS else "")
        )
    elif not few:
        found.append(
            "The exposure times agree with the images within pixel noise; no shutter error is "
            "seen. A light or shutter that drifts in proportion to the log exposure would not "
            "show, and would bias gamma."
        )
    if few:
        count, stated = len(few[0].curve.exposures), few[0].plane.exposure_sd
        if stated:
            rests = f"the intervals use the error of {100 * stated:.2g} % that the rig states"
        elif count > 2:
            rests = "the intervals average over the possible size of the other errors"
        else:
            rests = "the intervals assume an error of about 1 % (within a factor of 4.5)"
        found.append(
            f"{count} exposures determine {'only one error' if count > 2 else 'no error'} of the "
            f"shutter times, so {rests}. Take more exposures."
        )
    return found
