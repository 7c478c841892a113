"""The findings of a noise calibration, each with the condition under which it is reported."""

from collections.abc import Iterable
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Int

from ..codes import converter_in_words
from ..inference.diagnostics import identifiability
from ..inference.formatting import format_p, format_percent, format_with_error, format_within
from ..inference.trust import convergence_in_words
from ..report.sentences import Finding, Numbers, evaluate_findings, quoted
from .brighter_fatter import own_area_change
from .calibration import NoiseCalibration, lamp_error, steady_linearity
from .counted import SUB_ELECTRON
from .doubts import drifting, printed_times, trend_of
from .emva1288 import is_floored, least_dark_variance
from .levels import PhotonTransfer, partly_saturated_in_words, shot_of, signal_of
from .neighbours import are_known
from .pattern import pattern_variance, unequal_gains, unequal_offsets
from .periodic import Periodic, periodic_in_words, periodic_structure, taps_of
from .raw_frames import BLOCK, compressed_in_words, processing_in_words
from .regressions import MISFIT, Part, deviation_quantiles, least_squares
from .shared import LINES, Found, drift, temporal_lines
from .statement import gain_drop

LEAST_EFFICIENCY = 1e-2  # least efficiency of any sensor in its design spectrum
DISAGREEMENT_SIGMAS = 3.0  # standard errors from which two figures disagree
LARGEST_GAIN_DEVIATION = 0.5  # relative deviation from which a gain is meaningless
FEWEST_FOR_OFFSET = 5  # levels besides the dimmest, for a line and an offset
SIGNIFICANCE_SIGMAS = 6.0  # standard errors of a smooth unevenness of darks
LEAST_GROWTH = 3.0  # ratio of the rms unevenness to that at the shortest exposure
LEAST_UNEVENNESS = 0.1  # least unevenness, relative to the noise of a pixel
CONTRADICTION_SIGMAS = 4.0  # standard errors between a number of the rig and its estimate
LONG_EXPOSURE = 10.0  # s, of a flat, from which exposures may be in milliseconds
LEAST_DARK_SIGNAL = 0.02  # of the signal of the light
SAME_RATE = 0.01  # difference of light over exposure time, up to which light follows the times
FEWEST_FOR_NOISE = 4  # levels in the lower half of the signal
# Standard errors between the noise of darks and of flats without light, and least logarithm of
# their ratio
SURE_OF_NOISE, LEAST_RATIO_OF_NOISE = 4.0, 0.05
LOOSE_CHECK = 1.25  # factor on the darks' noise that would not show in the flats
LEAST_OFFSET_SIGMAS = 2.0  # standard errors below which an offset of the light is not reported


def findings(calibration: NoiseCalibration) -> tuple[str, ...]:
    """Return the findings that apply to a calibration, the most consequential first."""
    return evaluate_findings(FINDINGS, calibration)


def is_impossible(calibration: NoiseCalibration) -> bool:
    """Whether the quantum efficiency exceeds 1 by more than its error explains."""
    return calibration.least_efficiency is not None and calibration.least_efficiency > 1


def is_no_sensor(calibration: NoiseCalibration) -> bool:
    """Whether no sensor file is written, because it would not describe the camera."""
    return (
        calibration.likelihood is None
        or any("system_gain" in doubt.of for doubt in calibration.measurement.doubts)
        or is_impossible(calibration)
        or bool(processing_in_words(calibration.measurement, calibration.usable))
    )


def processing(calibration: NoiseCalibration) -> list[str]:
    """Return sentences on compressed, denoised or resized files; none for raw frames."""
    sentences = processing_in_words(calibration.measurement, calibration.usable)
    no_sensor = "No sensor file is written: it would describe how these files were processed."
    return [*sentences, no_sensor] if sentences else []


def _efficiency(kind: str, calibration: NoiseCalibration) -> Numbers | None:
    """Return a quantum efficiency that is too "low", too "high" or above "one"; else None."""
    value = calibration.efficiency
    if value is None:
        return None
    high = "high" if is_impossible(calibration) else "one"
    own = high if value > 1 else "low" if value < LEAST_EFFICIENCY else ""
    return {"efficiency": 100 * value} if own == kind else None


def _periodic(calibration: NoiseCalibration) -> tuple[Periodic, ...]:
    """Return the periodic structure that blocks of a compression do not explain."""
    return _without_blocks(calibration.measurement, calibration.usable, calibration.periodic)


def _without_blocks(
    measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"], found: tuple[Periodic, ...]
) -> tuple[Periodic, ...]:
    blocks = compressed_in_words(measurement, usable)
    return tuple(one for one in found if not (blocks and BLOCK % (one.period or 3) == 0))


def unequal_pixels(
    measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"], gain: float
) -> list[str]:
    """Return findings on classes of pixels that differ, for figures without a fit to each class."""
    found = _without_blocks(measurement, usable, periodic_structure(measurement, usable))
    spacing = 1 if measurement.pattern is None else 2
    return periodic_in_words(found, gain, spacing=spacing, fitted=False)


def periodic_findings(calibration: NoiseCalibration, *, apart: bool = False) -> list[str]:
    """Return findings on classes of pixels; `apart` if these were calibrated separately."""
    spacing = 1 if calibration.measurement.pattern is None else 2
    return periodic_in_words(_periodic(calibration), calibration.gain, apart=apart, spacing=spacing)


def unstated_taps(calibration: NoiseCalibration) -> tuple[int, int] | str | None:
    """Return the `camera.taps` to state; None if pixels agree or frames are not raw."""
    measurement = calibration.measurement
    if is_no_sensor(calibration):
        return None
    if measurement.pattern is not None:  # a site of a mosaic
        return taps_of(_periodic(calibration), apart=2)
    return None if measurement.site is not None else taps_of(_periodic(calibration))


def _value_and_error(calibration: NoiseCalibration, name: str) -> tuple[float, float]:
    """Return value and standard error of a parameter, as the report's tables give them."""
    estimate = calibration.estimates[name]
    return float(estimate.value or 0.0), float(estimate.standard_error or 0.0)


def _size(calibration: NoiseCalibration, name: str, scale: float = 100) -> str:
    """Format a parameter with its error, by default in per cent."""
    return format_with_error(*(scale * x for x in _value_and_error(calibration, name)))


def _contradictions(calibration: NoiseCalibration) -> tuple[str, ...]:
    """Return sentences on numbers of the rig that the estimates contradict."""
    sentences = []
    for key, name, stated, sd in calibration.measurement.stated:
        estimate = calibration.estimates.get(name)
        if estimate is None or estimate.value is None or not estimate.standard_error:
            continue
        found, error = float(estimate.value), float(np.hypot(estimate.standard_error, sd))
        if abs(found - stated) > CONTRADICTION_SIGMAS * error:
            sentences.append(
                f"camera.{key} states {stated:g} {estimate.unit}, but the frames have "
                f"{format_with_error(found, estimate.standard_error)} {estimate.unit}, which is "
                "reported here. Other calibrations of this rig use the stated one: correct it."
            )
    return tuple(sentences)


def _lamp(kind: str, calibration: NoiseCalibration) -> Numbers | None:
    """Return the numbers on a light with a "drift", "either" drift or curve, or a "scatter"."""
    if calibration.likelihood is None:
        return None
    drifts, bends = _has("light_drift", calibration), _has("compression", calibration)
    own = "scatter" if not drifts else "either" if bends else "drift"
    error = lamp_error(calibration.chosen)
    if own != kind or not error:
        return None
    if own == "scatter":
        return {"error": 100 * error}
    drift = _value_and_error(calibration, "light_drift")
    found: Numbers = {
        "way": "rises" if drift[0] > 0 else "falls",
        "change": format_with_error(100 * abs(drift[0]), 100 * drift[1]),
        "error": 100 * error,
        "span": "dimmest to the brightest level"
        if calibration.measurement.bright.taken is None
        else "first to the last level, by the times in their files",
    }
    if kind == "either":
        found["low"], found["high"] = steady_linearity(calibration)
        trend = trend_of(calibration.measurement, calibration.usable)
        found["within"] = (
            ""
            if trend is None
            else (
                f" Within levels, the signal changes by {100 * trend.share:.2g} ± "
                f"{100 * trend.error:.1g} % from one frame to the next: a lamp that drifts at a "
                "constant rate shows there, too, one that changes between levels alone does not."
            )
        )
    return found


def _dim(calibration: NoiseCalibration) -> Numbers | None:
    """Return the brightest level if it is within 8 bits although the camera has more bits."""
    measurement = calibration.measurement
    top, step = measurement.full_scale or 0.0, min(measurement.converter.step or 1.0, 1.0)
    brightest = float(measurement.bright.mean.max())
    if top <= 255 or brightest / step > 255:
        return None
    return {"brightest": brightest, "top": top}


def _has(name: str, calibration: NoiseCalibration) -> bool:
    """Whether the chosen model includes the parameter `name`."""
    return calibration.likelihood is not None and name in calibration.chosen.values


def _flicker(calibration: NoiseCalibration) -> list[Numbers]:
    bright, found = calibration.measurement.bright, []
    for axis, name in enumerate(LINES):
        if name in calibration.flicker and bright.flicker is not None:
            out, size = (
                np.asarray(bright.flicker)[axis],
                _format_lines(calibration.flicker[name], 1),
            )
            share = float(np.max(out / np.maximum(np.asarray(bright.variance) + out, 1e-300)))
            found.append({"lines": name, "line": name[:-1], "size": size, "share": 100 * share})
    return found


def _drifting(calibration: NoiseCalibration) -> Numbers | None:
    found = drifting(calibration.measurement, calibration.usable)
    return found and {
        "way": "grows" if found.share > 0 else "falls",
        "change": format_with_error(100 * abs(found.share), 100 * found.error),
        "frames": found.frames,
        "total": 100 * abs(found.total),
    }


def _unequal_steps(calibration: NoiseCalibration) -> Numbers | None:
    """Return unequal steps of the ADC that change the read noise by half its error or more."""
    converter = calibration.measurement.converter
    read = next((one for one in calibration.sheet if one.name == "read_noise"), None)
    if not converter.imbalance or read is None or not read.value or not read.standard_error:
        return None
    more = converter.rounding - replace(converter, imbalance=0.0).rounding
    moved = more / (2 * calibration.gain**2 * read.value)
    if moved <= read.standard_error / 2:
        return None
    return {"imbalance": 100 * converter.imbalance, "moved": moved}


def _converter(calibration: NoiseCalibration) -> list[str]:
    measurement = calibration.measurement
    alike = measurement.bright.converter.step == measurement.dark.converter.step
    return converter_in_words(measurement.converter, measurement.full_scale) if alike else []


def _two_converters(below: bool, calibration: NoiseCalibration) -> bool:
    top = calibration.measurement.converter.coarse_from
    used = float(calibration.measurement.bright.mean[calibration.usable[-1]])
    return top is not None and (used < top) == below


def _linear(fits: bool, calibration: NoiseCalibration) -> Numbers | None:
    """Return the test of a linear camera, if it explains the measurement (`fits`) or does not."""
    if calibration.likelihood is None:
        return None
    linear, chosen = calibration.linear, calibration.chosen
    if (linear.p_value >= MISFIT) != fits:
        return None
    # State how much it matters, unless the fit failed.
    off = float(linear.values["system_gain"]) / float(chosen.values["system_gain"]) - 1
    noise = "with pixel noise only"
    if linear.data.shared is not None:
        noise = "with pixel noise, and with noise shared by rows, columns or frames of the darks,"
    return {
        "noise": noise,
        "chi_square": linear.chi_square,
        "degrees": linear.degrees,
        "ratio": linear.chi_square / linear.degrees,
        "p": format_p(linear.p_value),
        "moved": f" ({100 * off:+.2g} % off)" if 0 < abs(off) < LARGEST_GAIN_DEVIATION else "",
    }


def _compression(calibration: NoiseCalibration) -> Numbers | None:
    if not _linear(False, calibration) or not _has("compression", calibration):
        return None
    if _has("light_drift", calibration):
        return None
    chosen, likelihood = calibration.chosen, calibration.likelihood
    assert likelihood is not None
    drop = float(gain_drop(chosen.values, chosen.data))
    loss, error = _value_and_error(calibration, "compression")
    strength = f", {abs(loss) / error:.0f} standard errors from none"
    return {
        "way": "falls" if drop > 0 else "rises",
        "drop": 100 * abs(drop),
        "significance": "" if "compression_2" in chosen.values else strength,
        "gain": _size(calibration, "system_gain", 1),
        "standard": float(calibration.standard.values["system_gain"]),
        "of_chosen": likelihood.standard_of_chosen,
    }


def _light_offset(in_time: bool, calibration: NoiseCalibration) -> Numbers | None:
    """Return a significant offset of the light, as a time or as photons; else None."""
    if not _has("light_offset", calibration) or calibration.chosen.data.photons_known == in_time:
        return None
    offset, error = _value_and_error(calibration, "light_offset")
    if abs(offset) < LEAST_OFFSET_SIGMAS * error:
        return None
    scale, late = 1e6 if in_time else 1.0, ""
    if not in_time:
        data = calibration.chosen.data
        timed = np.asarray((data.lit > 0) & (data.exposure > 0))
        exposure, light = np.asarray(data.exposure)[timed], np.asarray(data.light)[timed]
        if np.ptp(np.asarray(data.exposure)[np.asarray(data.lit) > 0]) != 0:
            off = offset / np.median(light / exposure)
            late = f", as if the shutter were off by {off:.2g} s"
        late += " or light leaked" * (offset > 0)
    return {
        "size": format_with_error(abs(offset) * scale, error * scale),
        "way": "more" if offset > 0 else "less",
        "ratio": abs(offset) / error,
        "late": late,
    }


def _has_offset(calibration: NoiseCalibration) -> bool:
    """Whether a light offset is significant, and a linear camera alone explains nothing."""
    offset = _light_offset(True, calibration) or _light_offset(False, calibration)
    return bool(offset and _linear(False, calibration))


def _black_of_darks(calibration: NoiseCalibration) -> Numbers | None:
    """Return the light offset as a difference in black level of darks and flats, DN."""
    if not _has_offset(calibration):
        return None
    offset, _ = _value_and_error(calibration, "light_offset")
    measurement, usable = calibration.measurement, calibration.usable
    bright = measurement.bright
    light = np.asarray(bright.light if measurement.photons_known else bright.exposure)[usable]
    moved = offset * np.median(signal_of(measurement)[usable] / (light + offset))
    return {"moved": abs(moved), "side": "below" if moved > 0 else "above"}


def _noise_of_darks(differs: bool, calibration: NoiseCalibration) -> Numbers | None:
    """Return the noise of darks if it `differs` from that of flats, or if flats hardly test it."""
    found = _dark_noises(calibration.measurement, calibration.usable)
    if found is None or found["differ"] != differs:
        return None
    return found if differs or found["factor"] >= LOOSE_CHECK else None


def _dark_noises(measurement: PhotonTransfer, usable: np.ndarray) -> dict[str, float] | None:
    """Compare the noise of the darks with the noise of the flats extrapolated to no light; None
    where the levels do not determine it. The variance of the flats minus the variance of their
    darks is a parabola over the signal, and is 0 without light."""
    bright, dark = measurement.bright, measurement.dark
    signal, shot = signal_of(measurement)[usable], shot_of(measurement)[usable]
    low = signal < signal.max() / 2
    least = float(np.min(np.asarray(dark.variance)))
    fine = least > 2 * least_dark_variance(measurement) and bright.converter == dark.converter
    if np.count_nonzero(low) < FEWEST_FOR_NOISE or not fine or measurement.doubts:
        return None
    error = np.asarray(bright.variance_error)[usable]
    found = least_squares((1.0, signal, signal**2), shot, errors=error)
    of_dark = np.median(np.asarray(dark.variance_error)) / np.sqrt(len(np.asarray(dark.mean)))
    own = float(np.median(np.asarray(dark.variance)))
    flats = own + float(found.values[0])
    least = SURE_OF_NOISE * float(np.hypot(found.errors[0], of_dark))
    ratio = abs(np.log(max(flats, 1e-9) / own))
    return {
        "flats": float(np.sqrt(max(flats, 0.0))),
        "darks": float(np.sqrt(own)),
        "factor": float(np.sqrt(1 + least / own)),
        "differ": bool(abs(found.values[0]) > least and ratio > 2 * LEAST_RATIO_OF_NOISE),
    }


def _dark_signal(calibration: NoiseCalibration) -> Numbers | None:
    """Return the dark signal as a share of a light that is proportional to time; None if small."""
    measurement, usable = calibration.measurement, calibration.usable
    bright, dark = measurement.bright, measurement.dark
    times, lit = np.asarray(dark.exposure), np.asarray(bright.exposure)[usable]
    light = np.asarray(bright.light)[usable]
    if not measurement.photons_known or np.ptp(times) == 0 or not (lit > 0).all():
        return None
    if np.ptp(light / lit) > SAME_RATE * np.max(light / lit):
        return None
    rate = np.polyfit(times, np.asarray(dark.mean), 1)[0]
    share = float(rate * np.median(lit / signal_of(measurement)[usable]))
    return {"share": format_percent(share)} if share > LEAST_DARK_SIGNAL else None


def _dimmest_alone(measurement: PhotonTransfer, usable: np.ndarray) -> bool:
    """Whether the signals of all levels but the dimmest extrapolate to 0 without light."""
    bright = measurement.bright
    light = np.asarray(bright.light if measurement.photons_known else bright.exposure)[usable]
    rest = np.argsort(light)[1:]
    rest = rest[light[rest] > 0]
    light, signal = light[rest], signal_of(measurement)[usable][rest]
    if len(light) < FEWEST_FOR_OFFSET:
        return False
    found = least_squares((1.0, light, 1 / light), signal / light)
    error = np.sqrt(found.covariance[2, 2] * found.misfit)
    return bool(abs(found.values[2]) < DISAGREEMENT_SIGMAS * error)


def _brighter_fatter(calibration: NoiseCalibration) -> Numbers | None:
    if not _has("brighter_fatter", calibration):
        return None
    own = own_area_change(calibration.chosen)
    share = _size(calibration, "brighter_fatter")
    return {"share": share, "own": format_with_error(*(x * 1e6 for x in own))}


def _covariances_known(known: bool, calibration: NoiseCalibration) -> bool:
    there = _has("brighter_fatter", calibration)
    return there and are_known(calibration.chosen.data.neighbours) == known


def _black_scatter(calibration: NoiseCalibration) -> Numbers | None:
    if not _has("black_scatter", calibration):
        return None
    dark = calibration.measurement.dark
    noise = float(np.median(np.sqrt(dark.variance / (dark.pixels * dark.frames))))
    wander = _value_and_error(calibration, "black_scatter")[0]
    return {"size": _size(calibration, "black_scatter", 1), "ratio": wander / noise}


def _variance_scatter(calibration: NoiseCalibration) -> Numbers | None:
    if not _has("variance_scatter", calibration):
        return None
    data = calibration.chosen.data
    known = calibration.linear.data.shared is not None
    return {
        "size": _size(calibration, "variance_scatter"),
        "expected": 100 * float(np.median(np.sqrt(2 / (data.pixels * (data.frames - 1))))),
        "shared": ", as by noise shared by rows, columns or whole frames" if known else "",
    }


def _misfit(explained: bool, calibration: NoiseCalibration) -> Numbers | None:
    """Return the chosen chi-square, if its misfit is significant or (`explained`) is not."""
    if calibration.likelihood is None or (calibration.chosen.inflation == 1) != explained:
        return None
    chosen = calibration.chosen
    if explained and chosen is calibration.linear:
        return None
    ratio, factor = chosen.chi_square / chosen.degrees, np.sqrt(chosen.inflation)
    return {"ratio": ratio, "p": format_p(chosen.p_value), "factor": factor}


def _histogram_numbers(failed: bool, calibration: NoiseCalibration) -> Numbers | None:
    """Return the numbers on histograms of codes, if their fit `failed` or did not."""
    counted = calibration.counted
    if counted is None or calibration.likelihood is None or bool(counted.failures) != failed:
        return None
    electrons, gain = np.exp(counted.logs[2:]), float(np.exp(counted.logs[0]))
    why = counted.failures[0] if failed else ""
    return {
        "read": np.exp(counted.logs[1]),
        "most": SUB_ELECTRON,
        "why": f"{why[:1].lower()}{why[1:]}",
        "count": f"{len(electrons)} {'level' if len(electrons) == 1 else 'levels'}",
        "low": electrons.min(),
        "high": electrons.max(),
        "numbers": counted.numbers,
        "gain": format_with_error(gain, gain * float(np.sqrt(counted.covariance[0, 0]))),
    }


def _standard_scatter(calibration: NoiseCalibration) -> Numbers | None:
    names = ("dark means", "dark variances", "responsivity", "gain")
    factors = np.sqrt(np.asarray(calibration.standard.factors))
    larger = [f"{name} {x:.3g}" for name, x in zip(names, factors, strict=True) if x > 1]
    return {"larger": ", ".join(larger)} if larger else None


def _exact(calibration: NoiseCalibration) -> Numbers | None:
    """Return the number of levels with exact rounding and clipping; None if there are none."""
    window = None if calibration.likelihood is None else calibration.chosen.data.window
    if window is None:
        return None
    count = len(np.unique(window.levels))
    return {"levels": f"{count} level{'s' * (count > 1)}"}


def _dark_variance_floor(bent: bool, calibration: NoiseCalibration) -> Numbers | None:
    """Return the standard's minimum of the dark variance if the dark variance, extrapolated to zero
    exposure, is below that minimum; else None. The extrapolated variance may be below the minimum
    although the variance of every dark is above it. `bent` selects the finding for this case, and
    False the finding for all other cases."""
    measurement = calibration.measurement
    least = least_dark_variance(measurement)
    above = float(np.min(np.asarray(measurement.dark.variance))) > least
    if above != bent or not is_floored(measurement, calibration.within):
        return None
    return {"least": least}


def _knee(calibration: NoiseCalibration) -> Numbers | None:
    knee = calibration.measurement.knee
    return knee and {"signal": knee.signal, "slope": knee.slope, "square": knee.slope**2}


def _saturation(calibration: NoiseCalibration) -> Numbers | None:
    within = calibration.within
    if within.saturation is None or within.saturation_width is None or _knee(calibration):
        return None
    unit = "photons" if calibration.measurement.photons_known else "s"
    level, width = float(within.saturation), float(within.saturation_width)
    return {
        "level": format_within(level, width),
        "width": format_within(width, width),
        "unit": unit,
    }


def _highest_unsaturated(calibration: NoiseCalibration) -> Numbers | None:
    if _knee(calibration) or _saturation(calibration):
        return None
    left_out = calibration.measurement.bright.left_out
    return {"which": "No remaining level" if left_out else "No level"}


def _long_exposures(calibration: NoiseCalibration) -> Numbers | None:
    """Return long exposures of flats in seconds; None if short or without dark current."""
    bright, current = calibration.measurement.bright, calibration.estimates.get("dark_current")
    times, frames = np.asarray(bright.exposure), np.asarray(bright.frames)
    if current is None or not current.value or times.max() < LONG_EXPOSURE:
        return None
    return {
        "longest": float(times.max()),
        "hours": float(np.sum(times * frames)) / 3600,
        "current": float(current.value),
        "other": 1e3 * float(current.value),
    }


def _glow(calibration: NoiseCalibration) -> Numbers | None:
    """Return darks whose smooth unevenness grows with exposure; None if there are none."""
    dark = calibration.measurement.dark
    if dark.local_pattern is None or dark.spatial_variance is None:
        return None
    exposure = np.asarray(dark.exposure)
    short, long = int(np.argmin(exposure)), int(np.argmax(exposure))
    pattern, by_noise = pattern_variance(dark)
    smooth = pattern - np.asarray(dark.local_pattern)
    of_pixels = 8 / float(dark.pixels) * np.asarray(dark.local_pattern) ** 2
    error = np.sqrt(2 * by_noise + of_pixels)
    beneath = max(smooth[short], 0.0) + error[short]
    rounding = dark.converter.rounding
    noise = float(np.sqrt(np.median(np.asarray(dark.variance)) + rounding))
    uneven = np.sqrt(np.maximum(smooth, 0.0))
    least = max(
        SIGNIFICANCE_SIGMAS * error[long],
        LEAST_GROWTH**2 * beneath,
        (LEAST_UNEVENNESS * noise) ** 2,
    )
    if not smooth[long] >= least:
        return None
    return {
        "long": uneven[long],
        "of_long": exposure[long],
        "short": uneven[short],
        "of_short": exposure[short],
        "rise": float(dark.mean[long] - dark.mean[short]),
    }


def _dark_currents(kind: str, calibration: NoiseCalibration) -> Numbers | None:
    """Return two dark currents that disagree, if the reason is `kind`; else None."""
    values, errors = calibration.standard.values, calibration.standard.errors
    if "dark_current_mean" not in values:
        return None
    mean, variance = (float(values[f"dark_current_{way}"]) for way in ("mean", "variance"))
    error = float(np.hypot(errors["dark_current_mean"], errors["dark_current_variance"]))
    if abs(mean - variance) < DISAGREEMENT_SIGMAS * error or calibration.measurement.doubts:
        return None
    scattered = float(calibration.standard.factors[1]) > 1
    own = "scattered" if scattered else "biased" if _exact(calibration) else "plain"
    numbers = {"mean": mean, "variance": variance, "ratio": abs(mean - variance) / error}
    return numbers if own == kind else None


def _bounds_alone(calibration: NoiseCalibration) -> bool:
    """Whether both linearity errors are insignificant, and no curved response was found."""
    if calibration.likelihood is not None and _has("compression", calibration):
        return False
    values, errors = calibration.standard.values, calibration.standard.errors
    names = ("linearity_error_min", "linearity_error_max")
    return all(
        abs(float(values[name])) <= DISAGREEMENT_SIGMAS * float(errors[name]) for name in names
    )


def _significant(rows_and_columns: Iterable[Found]) -> Iterable[tuple[str, Found]]:
    """Yield, by name, the significant noises or differences of rows and of columns."""
    named = zip(LINES, rows_and_columns, strict=True)
    return ((name, one) for name, one in named if one.is_significant)


def _shared_noise(calibration: NoiseCalibration) -> list[Numbers]:
    """Return significant temporal noise that rows or columns of the darks share, e-."""
    dark, scale = calibration.measurement.dark, 1 / calibration.gain
    whole = float(np.mean(np.asarray(dark.variance)))
    return [
        {
            "lines": name,
            "size": _format_lines(one, scale),
            "read": np.sqrt(whole) * scale,
            "rest": np.sqrt(max(whole - one.variance, 0)) * scale,
        }
        for name, one in _significant(temporal_lines(dark, axis) for axis in range(len(LINES)))
    ]


def _banding(calibration: NoiseCalibration) -> list[Numbers]:
    """Return significant fixed differences between rows or columns of the darks, e-."""
    kind, scale = "" if _glow(calibration) else "banding, ", 1 / calibration.gain
    return [
        {"lines": name, "size": _format_lines(one, scale), "kind": kind}
        for name, one in _significant(unequal_offsets(calibration.measurement.dark))
    ]


def _format_lines(found: Found, scale: float) -> str:
    """Format the standard deviation of rows or columns with its error, times a scale."""
    size = found.deviation
    return format_with_error(scale * size, scale * found.error / (2 * size))


def _drift(calibration: NoiseCalibration) -> Numbers | None:
    wander = drift(calibration.measurement.dark)
    fades = any("dark_current_mean" in doubt.of for doubt in calibration.measurement.doubts)
    if not wander.is_significant or fades:
        return None
    part = Part(wander.variance, 2 * (wander.variance / wander.error) ** 2)
    low, _, value, _, high = deviation_quantiles(wander.variance, 0.0, [part])
    return {"size": f"{value:.3g} (95 %: {low:.3g} to {high:.3g})"}


def _prnu(calibration: NoiseCalibration) -> Numbers | None:
    if calibration.patterns is None:
        return None
    bright, level = calibration.measurement.bright, calibration.patterns[0].level
    return {"frames": float(bright.frames[level]), "mean": float(bright.mean[level])}


def _unequal_gains(calibration: NoiseCalibration) -> list[Numbers]:
    if calibration.patterns is None:
        return []
    found = unequal_gains(calibration.measurement, calibration.usable)
    return [{"lines": name, "size": _format_lines(one, 100)} for name, one in _significant(found)]


def _pattern_misfit(calibration: NoiseCalibration) -> Numbers | None:
    fitted = calibration.patterns and calibration.patterns[1]
    if not fitted or fitted.p_value is None or fitted.p_value >= MISFIT:
        return None
    return {"ratio": fitted.chi_square_per_dof, "p": format_p(fitted.p_value)}


def _solver(calibration: NoiseCalibration) -> list[str]:
    if calibration.likelihood is None:
        return []
    space, optimum = calibration.chosen.space, calibration.chosen.optimum
    judged = identifiability(space, optimum.information, vector=optimum.vector)
    return [*judged.sentences, convergence_in_words(calibration.posterior)]


_CODES = (
    "Read noise is about {read:.2g} e⁻. Below {most:g} e⁻ the histogram of codes holds more "
    "information than mean and variance: "
)
_NOT_EQUAL = "Dark current is {mean:.3g} e⁻/s by the mean but {variance:.3g} by the variance"

FINDINGS = (
    quoted("left out", lambda c: (*c.measurement.bright.left_out, *c.measurement.dark.left_out)),
    quoted("doubts", lambda c: [doubt.sentence for doubt in c.measurement.doubts]),
    Finding(
        "flicker",
        _flicker,
        "The {lines} of a flat share noise of {size} DN rms beyond that of the darks at the level "
        "where it is most significant, new in every frame. It is up to {share:.2g} % of a flat's "
        "variance. Causes are a flickering lamp, interference, or resampled frames. It was "
        "subtracted, {line} by {line}: gain and quantum efficiency follow from the independent "
        "noise of pixels, and the errors of the flats' means include it.",
    ),
    Finding(
        "drifting",
        _drifting,
        "From frame to frame of a level the signal {way} by {change} %, as when a lamp or a camera "
        "warms up. Over {frames} consecutive flats the drift is {total:.2g} %, so that a smaller "
        "non-linearity cannot be detected. Let lamp and camera warm up, or take the levels in "
        "random order.",
    ),
    quoted("processing", processing),
    Finding(
        "low efficiency",
        partial(_efficiency, "low"),
        "The quantum efficiency is {efficiency:.3g} %, less than that of sensors for light that "
        "they are made for: the light is stated too high (photons are per pixel and exposure, "
        "irradiance in W m^-2), or is at the end of the sensor's spectrum.",
    ),
    Finding(
        "high efficiency",
        partial(_efficiency, "high"),
        "The quantum efficiency is {efficiency:.3g} %, which no sensor has. Either photons are "
        "stated too low (give photons per pixel and exposure, not per area or second). Or the "
        "images were averaged, denoised, compressed, smoothed or interpolated, which lowers their "
        "variance and so the gain: give raw frames. No sensor file is written.",
    ),
    Finding(
        "efficiency of one",
        partial(_efficiency, "one"),
        "The quantum efficiency, {efficiency:.4g} %, is 100 % within its error. The sensor file "
        "has 100 %, and a gain with the same signal.",
    ),
    quoted("periodic", periodic_findings),
    quoted("converter", _converter),
    Finding(
        "levels of one converter",
        partial(_two_converters, True),
        "The likelihood uses the levels below it. The standard's figures use all levels.",
    ),
    Finding(
        "levels of two converters",
        partial(_two_converters, False),
        "Too few levels lie below it, so all figures use all levels.",
    ),
    Finding(
        "unequal steps",
        _unequal_steps,
        "The counts of even and odd codes differ by {imbalance:.2g} %, as if the ADC's steps are "
        "unequal. The rounding error includes these steps, which lowers the read noise by "
        "{moved:.2g} e⁻.",
    ),
    Finding(
        "no maximum",
        lambda c: (
            {"why": c.no_likelihood[:1].lower() + c.no_likelihood[1:].rstrip(".")}
            if c.likelihood is None
            else None
        ),
        "Maximum likelihood gives no figures: {why}. The standard's regressions need no maximum. "
        "Their figures are reported, with errors from their scatter.",
    ),
    Finding(
        "linear",
        partial(_linear, True),
        "A linear camera {noise} explains every mean and variance: chi-square per degree of "
        "freedom {ratio:.2f} ({p}).",
    ),
    Finding(
        "not linear",
        partial(_linear, False),
        "A linear camera {noise} does not explain the measurement (chi-square is {chi_square:.3g} "
        "with {degrees} degrees of freedom). Its gain{moved} and its small error are not used.",
    ),
    Finding(
        "compression",
        _compression,
        "The camera is not linear: the gain {way} by {drop:.2g} % from zero signal to the "
        "brightest level used{significance}.",
    ),
    Finding(
        "two gains",
        _compression,
        "The likelihood and the standard therefore define the gain differently. K = {gain} DN/e⁻ "
        "holds at zero signal. The standard's {standard:.5f} DN/e⁻ is a mean slope up to 70 % of "
        "saturation, weighted towards its upper end. The standard's regression of the fitted "
        "curves gives {of_chosen:.5f} DN/e⁻.",
    ),
    Finding(
        "drift of the light",
        partial(_lamp, "drift"),
        "The light {way} by {change} % from the {span}, as if the lamp drifts over the series: "
        "the means differ from a line, but not as with a curved response. It is unknown at which "
        "level the light equals the stated light, so figures per photon have a further error of "
        "{error:.2g} %. Measure the light of every level.",
    ),
    Finding(
        "drift or curve",
        partial(_lamp, "either"),
        "Signal over light changes with light. A curved response and a light that drifts over the "
        "series explain it about equally well, so both were fitted. The errors of all figures, "
        "including the linearity error, allow for both. If the light is steady, the "
        "linearity error is {low:.2g} to {high:.2g} %; if the response is linear, the light "
        "drifts.{within} Take the levels in random order, or measure the light of every level.",
    ),
    Finding(
        "offset of the exposure",
        lambda c: _linear(False, c) and _light_offset(True, c),
        "Every exposure lasts {size} µs {way} than recorded ({ratio:.0f} standard errors).",
    ),
    Finding(
        "offset of the light",
        lambda c: _linear(False, c) and _light_offset(False, c),
        "Every exposure gets {size} photons {way} than recorded ({ratio:.0f} standard "
        "errors){late}.",
    ),
    Finding(
        "black level of the darks",
        _black_of_darks,
        "Darks of another camera, setting or temperature, {moved:.3g} DN {side} the flats' black "
        "level, would have the same effect. Dark noise and dark current are computed from the "
        "darks.",
    ),
    Finding(
        "noise of the darks",
        partial(_noise_of_darks, True),
        "Without light the flats have {flats:.3g} DN of noise, and the darks {darks:.3g} DN, as "
        "darks of another gain, setting or camera have. Dark noise, read noise and DSNU are "
        "computed from the darks: take them at the setting of the flats.",
    ),
    Finding(
        "noise of the darks unchecked",
        partial(_noise_of_darks, False),
        "Dark noise and read noise are those of the darks. The flats confirm their noise of "
        "{darks:.3g} DN only to within a factor of {factor:.2g}, so that darks of another gain or "
        "read noise can pass. Take more frames of dim flats.",
    ),
    Finding(
        "dimmest level",
        lambda c: _has_offset(c) and _dimmest_alone(c.measurement, c.usable),
        "Only the dimmest level shows this offset: instead, its light or its exposure time may be "
        "wrong.",
    ),
    Finding(
        "brighter-fatter effect",
        _brighter_fatter,
        "The variance flattens with light more than the mean does. Charges that repel each other "
        "(the brighter-fatter effect) take {share} % of it at the brightest level used: a₀₀ = "
        "({own}) · 10⁻⁶ per electron.",
    ),
    Finding(
        "covariances",
        partial(_covariances_known, True),
        "The covariances of neighbours, which a compression does not raise, were fitted with it. "
        "Variance and covariances add up to the noise of independent electrons.",
    ),
    Finding(
        "no covariances",
        partial(_covariances_known, False),
        "Only the shape of the variance distinguishes it from a wrong gain. Covariances of "
        "neighbouring pixels would too, but a table, a mosaic, or noise shared by rows or columns "
        "does not show them. Give the frames of a monochrome camera in a rig.",
    ),
    Finding(
        "mixing",
        lambda c: {"share": _size(c, "pixel_mixing")} if _has("pixel_mixing", c) else None,
        "Neighbouring pixels share {share} % of the variance that is proportional to light, as "
        "with capacitance between pixels or interpolation. The variance alone would give a gain "
        "too small by that share.",
    ),
    Finding(
        "scatter of the light",
        lambda c: {"size": _size(c, "light_scatter")} if _has("light_scatter", c) else None,
        "The light of the levels scatters about the recorded light by {size} % rms.",
    ),
    Finding(
        "lights that drift",
        partial(_lamp, "scatter"),
        "The lamp may drift: successive levels differ by less than independent ones do. It is "
        "then unknown at which level the light equals the stated light, so figures per photon have "
        "a further error of {error:.2g} %. Measure the light of every level.",
    ),
    Finding(
        "printed times",
        lambda c: printed_times(c.measurement, c.usable) if _has("light_scatter", c) else None,
        "The exposure times are rounded as cameras print them: with whole fractions of a stop "
        "({worst}, and so on) the light departs from a smooth response by {left:.2g} % rms, with "
        "the stated times by {stated:.2g} %; state the exact times.",
    ),
    Finding(
        "scatter of the black level",
        _black_scatter,
        "The black level varies by {size} DN rms from level to level, {ratio:.0f} times the error "
        "of its mean by pixel noise.",
    ),
    Finding(
        "scatter of the variances",
        _variance_scatter,
        "Variances scatter by {size} % rms beyond the {expected:.2g} % of independent "
        "pixels{shared}.",
    ),
    Finding(
        "misfit",
        partial(_misfit, False),
        "The remaining misfit is significant: chi-square per degree of freedom is {ratio:.2f} "
        "({p}), so all errors of the likelihood are multiplied by {factor:.2f}.",
    ),
    Finding(
        "explained",
        partial(_misfit, True),
        "This explains the measurement: chi-square per degree of freedom is {ratio:.2f} ({p}).",
    ),
    Finding(
        "codes not used",
        partial(_histogram_numbers, True),
        _CODES + "it was fitted, but {why} Means and variances were used.",
    ),
    Finding(
        "codes",
        partial(_histogram_numbers, False),
        _CODES + "for {count} of {low:.2g} to {high:.2g} electrons it was fitted in their place "
        "({numbers} values), which alone gives K = {gain} DN/e⁻. Each pixel's mean dark value was "
        "subtracted, so that DSNU does not blur the histogram; the gains of the pixels are assumed "
        "equal there.",
    ),
    Finding(
        "scatter of the standard",
        _standard_scatter,
        "The standard's regressions scatter more than pixel noise explains. The errors of its "
        "figures are multiplied by: {larger}.",
    ),
    Finding(
        "exact moments",
        _exact,
        "Black is clipped, or read noise is too small to smooth the rounding. At {levels} the "
        "likelihood uses the exact moments of the clipped, rounded signal. The standard's figures "
        "are biased there.",
    ),
    Finding(
        "bent dark variance",
        partial(_dark_variance_floor, True),
        "The line through the variances of the darks over exposure starts below {least:.3g} DN², "
        "although every variance is above it. The variances are not linear in exposure, so the "
        "standard gives only an upper bound on dark noise.",
    ),
    Finding(
        "floor of the dark noise",
        partial(_dark_variance_floor, False),
        "Dark variance is below {least:.3g} DN², where rounding dominates. The standard gives only "
        "an upper bound on dark noise.",
    ),
    Finding(
        "knee",
        _knee,
        "Above about {signal:.4g} DN over black the slope of the signal is {slope:.3g} of that "
        "below, and its variance {square:.2g} of that below: a knee of a piecewise linear response "
        "(companding), not a full well. Only the levels below it are used. Figures that need the "
        "capacity are not determined, and the sensor file is wrong above the knee; give linear "
        "frames.",
    ),
    Finding(
        "dark signal",
        _dark_signal,
        "Dark current gives {share} of the signal of the light, and both grow with exposure time. "
        "It is that of the darks: if they were warmer or cooler than the flats, quantum efficiency "
        "and responsivity are wrong by as much as the dark signals differ.",
    ),
    Finding(
        "long exposures",
        _long_exposures,
        "Exposures are read as seconds: the longest flat has {longest:.4g} s, and all flats have "
        "{hours:.2g} hours. If they are milliseconds, the dark current is {other:.3g} e⁻/s, not "
        "{current:.3g}, and light per second is 1000 times as large: give seconds.",
    ),
    quoted("partly saturated", lambda c: partly_saturated_in_words(c.measurement)),
    Finding(
        "no saturation",
        _highest_unsaturated,
        "{which} saturates the camera, so no figure that needs its capacity is determined. The "
        "ranges of the standard end at the brightest level. Add brighter flats.",
    ),
    Finding(
        "dim flats",
        _dim,
        "The brightest flat has {brightest:.4g} DN of {top:g}. If the files hold 8-bit data, "
        "correct camera.bits, which sets the end of the scale. Otherwise add brighter flats, "
        "because the figures hold for this range alone.",
    ),
    Finding(
        "saturation",
        _saturation,
        "Saturation is the level of largest variance, {level} {unit}. The true saturation point "
        "lies between its neighbours, {width} {unit} apart. This distance causes most of the "
        "error of every capacity.",
    ),
    Finding(
        "glow",
        _glow,
        "The darks vary smoothly over the frame, by {long:.3g} DN rms at {of_long:.3g} s and "
        "{short:.2g} DN at {of_short:.3g} s, where their mean is {rise:.3g} DN lower. Light leaks "
        "in, the read-out glows, or the sensor is warmer at one side. This adds to dark current "
        "and DSNU, which are then not those of the pixels. Cover the camera, or calibrate a "
        "uniform region (camera.region).",
    ),
    Finding(
        "dark current of scattered variances",
        partial(_dark_currents, "scattered"),
        _NOT_EQUAL + ". The variances scatter about a line over exposure more than noise explains, "
        "so the second figure is not valid.",
    ),
    Finding(
        "dark current of rounded darks",
        partial(_dark_currents, "biased"),
        "By the standard dark current is {mean:.3g} e⁻/s by the mean but {variance:.3g} by the "
        "variance, {ratio:.1f} standard errors apart. Both are biased, because black is clipped or "
        "hardly dithered; the likelihood's figure is not.",
    ),
    Finding(
        "two dark currents",
        partial(_dark_currents, "plain"),
        _NOT_EQUAL + ", {ratio:.1f} standard errors apart. A camera that subtracts dark current "
        "from its black level shows it in the variance only.",
    ),
    Finding(
        "linearity errors",
        _bounds_alone,
        "The standard's linearity errors are the extremes of deviations, and are within their "
        "noise. They bound the camera's non-linearity and do not measure it.",
    ),
    Finding(
        "shared noise",
        _shared_noise,
        "The {lines} of a dark frame share noise of {size} e⁻ rms, new in every frame. It is part "
        "of the temporal noise ({read:.3g} e⁻). The independent noise of each pixel is {rest:.3g} "
        "e⁻.",
    ),
    Finding(
        "banding",
        _banding,
        "The {lines} of the darks differ by {size} e⁻ rms, the same in every frame: {kind}part of "
        "DSNU.",
    ),
    Finding(
        "drift of black",
        _drift,
        "From frame to frame the black level drifts by {size} DN rms. The temporal noise does not "
        "include it; the errors of the levels' means do.",
    ),
    Finding(
        "PRNU",
        _prnu,
        "PRNU by the standard is from {frames:.0f} frames at {mean:.0f} DN, PRNU by the fit from "
        "all levels. Uneven light counts as PRNU in both.",
    ),
    Finding(
        "unequal gains",
        _unequal_gains,
        "The {lines} of the flats differ by {size} % rms, the same in every frame: part of PRNU, "
        "from gains or from uneven light.",
    ),
    Finding(
        "misfit of the pattern",
        _pattern_misfit,
        "Offsets and gains of pixels do not explain how the pattern grows with signal: chi-square "
        "per degree of freedom is {ratio:.3g} ({p}). The errors of the fit include this misfit.",
    ),
    Finding(
        "not converged",
        lambda c: c.likelihood is not None and not c.chosen.optimum.stationary,
        "The likelihood fit did not converge. Do not use its figures.",
    ),
    quoted("solver", _solver),
    quoted("remarks", lambda c: c.measurement.remarks),
    quoted("contradicted", _contradictions),
)
