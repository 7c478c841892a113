"""The findings of a noise calibration: a misfit first, then its consequences."""

from dataclasses import replace

import numpy as np

from ..codes import converter_in_words
from ..inference.diagnostics import identifiability
from ..inference.formatting import format_p, format_with_error, format_within
from ..inference.trust import convergence_in_words
from .brighter_fatter import own_area_change
from .calibration import NoiseCalibration
from .code_tables import SUB_ELECTRON
from .drifting import drifting, drifting_in_words
from .emva1288 import is_floored, least_dark_variance
from .flicker import flicker_in_words
from .levels import PhotonTransfer
from .misfit import MISFIT
from .neighbours import are_known
from .parts import Part, deviation_quantiles
from .pattern import pattern_variance, unequal_gains, unequal_offsets
from .periodic import Periodic, periodic_in_words, taps_of
from .printed_times import printed_times_in_words
from .raw_frames import BLOCK, is_compressed, processing_in_words
from .shared import Found, drift, temporal_lines
from .statement import gain_drop

LEAST_EFFICIENCY = 1e-4  # of any sensor, for light that it is made for
FAR = 3.0  # standard errors between two figures that should agree
ASTRAY = 0.5  # relative deviation of a gain from which it is none
FEWEST_FOR_OFFSET = 5  # levels besides the dimmest, for a line and an offset
SURE = 6.0  # standard errors by which darks are smoothly uneven
GROWS = 3.0  # times as uneven as at the shortest exposure, rms
MATTERS = 0.1  # of the noise of a pixel
SAID = 2.0  # standard errors below which an offset of the light is not reported


def findings(calibration: NoiseCalibration) -> tuple[str, ...]:
    """Every finding, the most consequential first."""
    measurement = calibration.measurement
    return (
        *measurement.bright.left_out,
        *measurement.dark.left_out,
        *(doubt.sentence for doubt in measurement.doubts),
        *flicker_in_words(measurement, calibration.flicker),
        *drifting_in_words(drifting(measurement, calibration.usable)),
        *processing(calibration),
        *_efficiency(calibration),
        *periodic_findings(calibration),
        *_converter(calibration),
        *_of_likelihood(calibration),
        *_counted(calibration),
        *_standard_scatter(calibration),
        *_near_black(calibration),
        *_saturation(calibration),
        *_glow(calibration),
        *_dark_current(calibration),
        *_linearity_errors(calibration),
        *_shared(calibration),
        *_drift(calibration),
        *_pattern(calibration),
        *_solver(calibration),
        *measurement.remarks,
    )


def _shown(calibration: NoiseCalibration, name: str) -> tuple[float, float]:
    """Value and standard error of one of the likelihood's parameters, as tables show them."""
    estimate = calibration.shown[name]
    return float(estimate.value or 0.0), float(estimate.standard_error or 0.0)


def is_impossible(calibration: NoiseCalibration) -> bool:
    """Whether the quantum efficiency exceeds 1 by more than its error explains."""
    return calibration.least_efficiency is not None and calibration.least_efficiency > 1


def is_no_sensor(calibration: NoiseCalibration) -> bool:
    """Whether a sensor made from the calibration would not describe the camera."""
    return (
        calibration.likelihood is None
        or any("system_gain" in doubt.of for doubt in calibration.measurement.doubts)
        or is_impossible(calibration)
        or bool(processing_in_words(calibration.measurement, calibration.usable))
    )


def processing(calibration: NoiseCalibration) -> list[str]:
    """Sentences on how the files were processed; none for raw frames."""
    told = processing_in_words(calibration.measurement, calibration.usable)
    if not told:
        return []
    return [
        *told,
        "No sensor file is written: it would describe how these files were processed.",
    ]


def _periodic(calibration: NoiseCalibration) -> tuple[Periodic, ...]:
    """The periodic structure without the blocks of a compression and the repeats of resizing."""
    blocks = is_compressed(calibration.measurement, calibration.usable)
    return tuple(
        one for one in calibration.periodic if not (blocks and BLOCK % (one.period or 3) == 0)
    )


def periodic_findings(calibration: NoiseCalibration, *, apart: bool = False) -> list[str]:
    """Findings on rows, columns, cells and parts of the frame that differ. `apart` names those that
    were calibrated separately."""
    spacing = 1 if calibration.measurement.pattern is None else 2
    return periodic_in_words(_periodic(calibration), calibration.gain, apart=apart, spacing=spacing)


def unstated_taps(calibration: NoiseCalibration) -> tuple[int, int] | str | None:
    """The value of `camera.taps` for a camera whose pixels need separate calibrations; None if they
    agree, or if frames are not raw."""
    measurement = calibration.measurement
    if is_no_sensor(calibration):
        return None
    if measurement.pattern is not None:  # a site of a mosaic
        return taps_of(_periodic(calibration), apart=2)
    return None if measurement.site is not None else taps_of(_periodic(calibration))


def _efficiency(calibration: NoiseCalibration) -> list[str]:
    if calibration.efficiency is not None and calibration.efficiency < LEAST_EFFICIENCY:
        return [
            f"The quantum efficiency is {100 * calibration.efficiency:.3g} %, less than that of "
            "any sensor for light that it is made for: photons are stated too high (give "
            "photons per pixel and exposure)."
        ]
    if not is_impossible(calibration):
        if calibration.efficiency is None or calibration.efficiency <= 1:
            return []
        return [
            f"The quantum efficiency, {100 * calibration.efficiency:.4g} %, is 100 % within its "
            "error. The sensor file has 100 %, and a gain with the same signal."
        ]
    return [
        f"The quantum efficiency is {100 * (calibration.efficiency or 0):.3g} %, which "
        "no sensor has. Either photons are stated too low (give photons per pixel and exposure, "
        "not per area or second). Or the images were averaged, denoised, compressed, smoothed or "
        "interpolated, which lowers their variance and so the gain: give raw frames. No sensor "
        "file is written."
    ]


def _converter(calibration: NoiseCalibration) -> list[str]:
    """Findings on the converter. Unequal steps are named only if they change the read noise."""
    measurement = calibration.measurement
    converter = measurement.converter
    alike = measurement.bright.converter.step == measurement.dark.converter.step
    told = converter_in_words(converter, measurement.full_scale) if alike else []
    if converter.coarse_from is not None:
        used = float(measurement.bright.mean[calibration.usable[-1]])
        told.append(
            "The likelihood uses the levels below it. The standard's figures use all levels."
            if used < converter.coarse_from
            else "Too few levels lie below it, so all figures use all levels."
        )
    read = next((one for one in calibration.sheet if one.name == "read_noise"), None)
    if converter.imbalance and read is not None and read.value and read.standard_error:
        gain = calibration.gain
        more = converter.rounding - replace(converter, imbalance=0.0).rounding
        moved = more / (2 * gain**2 * read.value)
        if moved > read.standard_error / 2:
            told.append(
                f"The counts of even and odd codes differ by {100 * converter.imbalance:.2g} %, as "
                "if the ADC's steps are unequal. The rounding error includes these steps, which "
                f"lowers the read noise by {moved:.2g} e⁻."
            )
    return told


def _of_likelihood(calibration: NoiseCalibration) -> list[str]:
    if calibration.likelihood is None:
        why = calibration.no_likelihood.rstrip(".")
        return [
            f"Maximum likelihood gives no figures: {why[:1].lower()}{why[1:]}. The standard's "
            "regressions need no maximum. Their figures are reported, with errors from their "
            "scatter."
        ]
    return [*_linearity(calibration), *_random_effects(calibration)]


def _counted(calibration: NoiseCalibration) -> list[str]:
    """Whether tables of codes replaced moments, and by how much the errors decreased."""
    counted = calibration.counted
    if counted is None or calibration.likelihood is None:
        return []
    read, electrons = np.exp(counted.logs[1]), np.exp(counted.logs[2:])
    about = (
        f"Read noise is about {read:.2g} e⁻. Below {SUB_ELECTRON:g} e⁻ the histogram of codes "
        "holds more information than mean and variance: "
    )
    if counted.failures:
        return [
            f"{about}it was fitted, but {counted.failures[0][:1].lower()}{counted.failures[0][1:]} "
            "Means and variances were used."
        ]
    gain, error = np.exp(counted.logs[0]), np.sqrt(counted.covariance[0, 0])
    of = "level" if len(electrons) == 1 else "levels"
    return [
        f"{about}for {len(electrons)} {of} of {electrons.min():.2g} to {electrons.max():.2g} "
        f"electrons it was fitted in their place ({counted.numbers} values), which alone gives "
        f"K = {format_with_error(float(gain), float(gain * error))} DN/e⁻. Each pixel's mean dark "
        "value was subtracted, so that DSNU does not blur the histogram; the gains of the pixels "
        "are assumed equal there."
    ]


def _linear_model(calibration: NoiseCalibration) -> str:
    if calibration.linear.data.shared is None:
        return "A linear camera with pixel noise only"
    return (
        "A linear camera with pixel noise, and with noise shared by rows, columns or frames of the "
        "darks,"
    )


def _misfit(calibration: NoiseCalibration) -> list[str]:
    linear, chosen = calibration.linear, calibration.chosen
    if linear.p_value >= MISFIT:
        return []
    # By how much it matters; the number of a failed fit is meaningless.
    off = float(linear.values["system_gain"]) / float(chosen.values["system_gain"]) - 1
    moved = f" ({100 * off:+.2g} % off)" if 0 < abs(off) < ASTRAY else ""
    return [
        f"{_linear_model(calibration)} does not explain the measurement (chi-square is "
        f"{linear.chi_square:.3g} with {linear.degrees} degrees of freedom). Its gain{moved} and "
        "its small error are not used."
    ]


def _linearity(calibration: NoiseCalibration) -> list[str]:
    linear, chosen = calibration.linear, calibration.chosen
    told = _misfit(calibration)
    if not told:
        return [
            f"{_linear_model(calibration)} explains every mean and variance: chi-square per degree "
            f"of freedom {linear.chi_square / linear.degrees:.2f} ({format_p(linear.p_value)}).",
            *_neighbours(calibration),
        ]
    if "compression" in chosen.values:
        told += _compression(calibration)
    if "light_offset" in chosen.values:
        offset = _light_offset(calibration)
        told += offset
        if offset and _by_the_dimmest_alone(calibration.measurement, calibration.usable):
            told.append(
                "Without the dimmest level the others show no such offset: the light or the "
                "exposure time of that level may be wrong instead."
            )
    return [*told, *_neighbours(calibration)]


def _neighbours(calibration: NoiseCalibration) -> list[str]:
    """The reduction of variances by the brighter-fatter effect and by mixing with neighbours."""
    chosen, sentences = calibration.chosen, []
    if "brighter_fatter" in chosen.values:
        share, error = _shown(calibration, "brighter_fatter")
        own, own_error = own_area_change(chosen)
        sentences.append(
            "The variance flattens with light more than the mean does. Charges that repel each "
            "other (the brighter-fatter effect) take "
            f"{format_with_error(100 * share, 100 * error)} % of it at the brightest level used: "
            f"a₀₀ = ({format_with_error(own * 1e6, own_error * 1e6)}) · 10⁻⁶ per electron."
        )
        sentences.append(
            "The covariances of neighbours, which a compression does not raise, were fitted with "
            "it. Variance and covariances add up to the noise of independent electrons."
            if are_known(chosen.data.neighbours)
            else "Only the shape of the variance distinguishes it from a wrong gain. Covariances "
            "of neighbouring pixels would too, but a table, a mosaic, or noise shared by rows or "
            "columns does not show them. Give the frames of a monochrome camera in a rig."
        )
    if "pixel_mixing" in chosen.values:
        share, error = _shown(calibration, "pixel_mixing")
        sentences.append(
            f"Neighbouring pixels share {format_with_error(100 * share, 100 * error)} % of the "
            "variance that is proportional to light, as with capacitance between pixels or "
            "interpolation. The variance alone would give a gain too small by that share."
        )
    return sentences


def _compression(calibration: NoiseCalibration) -> list[str]:
    assert calibration.likelihood is not None
    chosen, standard = calibration.chosen, calibration.standard
    drop = float(gain_drop(chosen.values, chosen.data))
    one_term = "compression_2" not in chosen.values
    loss, loss_error = _shown(calibration, "compression")
    strength = abs(loss) / loss_error
    significance = f", {strength:.0f} standard errors from none" if one_term else ""
    way = "falls" if drop > 0 else "rises"
    gain, error = _shown(calibration, "system_gain")
    return [
        f"The camera is not linear: the gain {way} by {100 * abs(drop):.2g} % from zero signal to "
        f"the brightest level used{significance}.",
        "The likelihood and the standard therefore define the gain differently. "
        f"K = {format_with_error(gain, error)} DN/e⁻ holds at zero signal. The "
        f"standard's {float(standard.values['system_gain']):.5f} DN/e⁻ is a mean slope up to 70 % "
        "of saturation, weighted towards its upper end. The standard's regression of the fitted "
        f"curves gives {calibration.likelihood.standard_of_chosen:.5f} DN/e⁻.",
    ]


def _light_offset(calibration: NoiseCalibration) -> list[str]:
    chosen = calibration.chosen
    offset, error = _shown(calibration, "light_offset")
    if abs(offset) < SAID * error:
        return []
    way = "more" if offset > 0 else "less"
    data = chosen.data
    if not data.photons_known:
        return [
            f"Every exposure lasts {format_with_error(abs(offset) * 1e6, error * 1e6)} µs {way} "
            f"than recorded ({abs(offset) / error:.0f} standard errors)."
        ]
    bright = np.asarray(data.lit) > 0
    exposure, light = np.asarray(data.exposure)[bright], np.asarray(data.light)[bright]
    timed = exposure > 0
    rate = np.median(light[timed] / exposure[timed])
    late = "" if np.ptp(exposure) == 0 else f", as if the shutter were off by {offset / rate:.2g} s"
    return [
        f"Every exposure gets {format_with_error(abs(offset), error)} photons {way} than recorded "
        f"({abs(offset) / error:.0f} standard errors){late} or light leaked."
    ]


def _by_the_dimmest_alone(measurement: PhotonTransfer, usable: np.ndarray) -> bool:
    """Whether only the dimmest level shows an offset of the light: the others lie on a line of
    signal over light through the origin."""
    bright = measurement.bright
    light = np.asarray(bright.light if measurement.photons_known else bright.exposure)[usable]
    dark = np.asarray(measurement.dark.mean)[np.asarray(measurement.dark_of)[usable]]
    rest = np.argsort(light)[1:]
    rest = rest[light[rest] > 0]
    light, signal = light[rest], (np.asarray(bright.mean)[usable] - dark)[rest]
    if len(light) < FEWEST_FOR_OFFSET:
        return False
    x = light / light.max()
    design, rates = np.stack([np.ones_like(x), x, 1 / x], axis=1), signal / light
    found, squares, *_ = np.linalg.lstsq(design, rates)
    covariance = np.linalg.inv(design.T @ design) * squares[0] / (len(x) - design.shape[1])
    return bool(abs(found[2]) < FAR * np.sqrt(covariance[2, 2]))


def _random_effects(calibration: NoiseCalibration) -> list[str]:
    values, data = calibration.chosen.values, calibration.chosen.data
    sentences = []
    if "light_scatter" in values:
        scatter, error = _shown(calibration, "light_scatter")
        sentences.append(
            "The light of the levels scatters about the recorded light by "
            f"{format_with_error(100 * scatter, 100 * error)} % rms."
        )
        sentences += printed_times_in_words(calibration.measurement, calibration.usable)
    if "black_scatter" in values:
        wander, error = _shown(calibration, "black_scatter")
        dark = calibration.measurement.dark
        noise = float(np.median(np.sqrt(dark.variance / (dark.pixels * dark.frames))))
        sentences.append(
            f"The black level varies by {format_with_error(wander, error)} DN rms from level to "
            f"level, {wander / noise:.0f} times the error of its mean by pixel noise."
        )
    if "variance_scatter" in values:
        scatter, error = _shown(calibration, "variance_scatter")
        expected = float(np.median(np.sqrt(2 / (data.pixels * (data.frames - 1)))))
        known = calibration.linear.data.shared is not None
        shared = ", as by noise shared by rows, columns or whole frames" if known else ""
        sentences.append(
            f"Variances scatter by {format_with_error(100 * scatter, 100 * error)} % rms beyond "
            f"the {100 * expected:.2g} % of independent pixels{shared}."
        )
    chosen = calibration.chosen
    if chosen.inflation > 1:
        sentences.append(
            "The remaining misfit is significant: chi-square per degree of freedom is "
            f"{chosen.chi_square / chosen.degrees:.2f} ({format_p(chosen.p_value)}), so all errors "
            f"of the likelihood are multiplied by {np.sqrt(chosen.inflation):.2f}."
        )
    elif chosen is not calibration.linear:
        sentences.append(
            "This explains the measurement: chi-square per degree of freedom is "
            f"{chosen.chi_square / chosen.degrees:.2f} ({format_p(chosen.p_value)})."
        )
    return sentences


def _standard_scatter(calibration: NoiseCalibration) -> list[str]:
    names = ("dark means", "dark variances", "responsivity", "gain")
    factors = np.sqrt(np.asarray(calibration.standard.misfit.factors))
    larger = [f"{name} {x:.3g}" for name, x in zip(names, factors, strict=True) if x > 1]
    if not larger:
        return []
    return [
        "The standard's regressions scatter more than pixel noise explains. The errors of its "
        f"figures are multiplied by: {', '.join(larger)}."
    ]


def _near_black(calibration: NoiseCalibration) -> list[str]:
    sentences = []
    window = None if calibration.likelihood is None else calibration.chosen.data.window
    if window is not None:
        count = len(np.unique(window.levels))
        sentences.append(
            "Black is clipped, or read noise is too small to smooth the rounding. At "
            f"{count} level{'s' * (count > 1)} the likelihood uses the exact moments of the "
            "clipped, rounded signal. The standard's figures are biased there."
        )
    least = least_dark_variance(calibration.measurement)
    dark = calibration.measurement.dark
    if not is_floored(calibration.measurement, calibration.within):
        return sentences
    if float(np.min(np.asarray(dark.variance))) > least:
        sentences.append(
            f"The line through the variances of the darks over exposure starts below "
            f"{least:.3g} DN², although every variance is above it. The variances are not linear "
            "in exposure, so the standard gives only an upper bound on dark noise."
        )
    else:
        sentences.append(
            f"Dark variance is below {least:.3g} DN², where rounding dominates. The standard gives "
            "only an upper bound on dark noise."
        )
    return sentences


def _saturation(calibration: NoiseCalibration) -> list[str]:
    within, knee = calibration.within, calibration.measurement.knee
    if knee is not None:
        return [
            f"Above about {knee.signal:.4g} DN over black the slope of the signal is "
            f"{knee.slope:.3g} of that below, and its variance {knee.slope**2:.2g} of that below: "
            "a knee of a piecewise linear response (companding), not a full well. Only the levels "
            "below it are used. Figures that need the capacity are not determined, and the sensor "
            "file is wrong above the knee; give linear frames."
        ]
    if within.saturation is None or within.saturation_width is None:
        which = "No remaining level" if calibration.measurement.bright.left_out else "No level"
        return [
            f"{which} saturates the camera, so no figure that needs its capacity is determined. "
            "The ranges of the standard end at the brightest level. Add brighter flats."
        ]
    unit = "photons" if calibration.measurement.photons_known else "s"
    level, width = float(within.saturation), float(within.saturation_width)
    return [
        f"Saturation is the level of largest variance, {format_within(level, width)} {unit}. The "
        f"true saturation point lies between its neighbours, {format_within(width, width)} {unit} "
        "apart. This is most of the error of every capacity."
    ]


def _glow(calibration: NoiseCalibration) -> list[str]:
    """Darks with a smooth unevenness that grows with exposure."""
    dark = calibration.measurement.dark
    if dark.local_pattern is None or dark.spatial_variance is None:
        return []
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
    least = max(SURE * error[long], GROWS**2 * beneath, (MATTERS * noise) ** 2)
    if not smooth[long] >= least:
        return []
    rise = float(dark.mean[long] - dark.mean[short])
    return [
        f"The darks vary smoothly over the frame, by {uneven[long]:.3g} DN rms at "
        f"{exposure[long]:.3g} s and {uneven[short]:.2g} DN at {exposure[short]:.3g} s, where "
        f"their mean is {rise:.3g} DN lower. Light leaks in, the read-out glows, or the sensor is "
        "warmer at one side. This adds to dark current and DSNU, which are then not those of the "
        "pixels. Cover the camera, or calibrate a uniform region (camera.region)."
    ]


def _dark_current(calibration: NoiseCalibration) -> list[str]:
    values, errors = calibration.standard.values, calibration.standard.errors
    if "dark_current_mean" not in values:
        return []
    mean, variance = (float(values[f"dark_current_{way}"]) for way in ("mean", "variance"))
    error = float(np.hypot(errors["dark_current_mean"], errors["dark_current_variance"]))
    if abs(mean - variance) < FAR * error or calibration.measurement.doubts:
        return []
    if float(np.asarray(calibration.standard.misfit.factors)[1]) > 1:
        return [
            f"Dark current is {mean:.3g} e⁻/s by the mean but {variance:.3g} by the variance. The "
            "variances scatter about a line over exposure more than noise explains, so the second "
            "figure is not valid."
        ]
    apart = f"{abs(mean - variance) / error:.1f} standard errors apart"
    window = None if calibration.likelihood is None else calibration.chosen.data.window
    if window is not None:
        return [
            f"By the standard dark current is {mean:.3g} e⁻/s by the mean but {variance:.3g} by "
            f"the variance, {apart}. Both are biased, because black is clipped or hardly dithered; "
            "the likelihood's figure is not."
        ]
    return [
        f"Dark current is {mean:.3g} e⁻/s by the mean but {variance:.3g} by the variance, "
        f"{apart}. A camera that subtracts dark current from its black level shows it in the "
        "variance only."
    ]


def _linearity_errors(calibration: NoiseCalibration) -> list[str]:
    values, errors = calibration.standard.values, calibration.standard.errors
    names = ("linearity_error_min", "linearity_error_max")
    if any(abs(float(values[name])) > FAR * float(errors[name]) for name in names):
        return []
    return [
        "The standard's linearity errors are the extremes of deviations, and are within their "
        "noise. They bound the camera's non-linearity and do not measure it."
    ]


def _shared(calibration: NoiseCalibration) -> list[str]:
    """Noise that rows and columns of the darks share, in electrons."""
    dark = calibration.measurement.dark
    if dark.shared is None:
        return []
    variance, frames = np.asarray(dark.variance), np.asarray(dark.frames)
    scale, unit = calibration.gain, "e⁻"
    sentences = []
    for axis, name in enumerate(("rows", "columns")):
        found = temporal_lines(dark.shared, variance, frames, axis)
        if found.believed:
            read = float(np.sqrt(np.mean(variance)))
            rest = float(np.sqrt(max(np.mean(variance) - found.variance, 0)))
            error = found.error / (2 * found.deviation)
            sentences.append(
                f"The {name} of a dark frame share noise of "
                f"{format_with_error(found.deviation / scale, error / scale)} {unit} rms, new in "
                f"every frame. It is part of the temporal noise ({read / scale:.3g} {unit}). The "
                f"independent noise of each pixel is {rest / scale:.3g} {unit}."
            )
    for stays, name in zip(unequal_offsets(dark), ("rows", "columns"), strict=False):
        if stays.believed:
            error = stays.error / (2 * stays.deviation)
            sentences.append(
                f"The {name} of the darks differ by "
                f"{format_with_error(stays.deviation / scale, error / scale)} {unit} rms, the same "
                f"in every frame: {'' if _glow(calibration) else 'banding, '}part of DSNU."
            )
    return sentences


def _drift(calibration: NoiseCalibration) -> list[str]:
    dark = calibration.measurement.dark
    if dark.shared is None:
        return []
    wander = drift(dark.shared, np.asarray(dark.variance), np.asarray(dark.frames))
    fades = any("dark_current_mean" in doubt.of for doubt in calibration.measurement.doubts)
    if not wander.believed or fades:
        return []
    return [
        f"From frame to frame the black level drifts by {_with_interval(wander)} DN rms. The "
        "temporal noise does not include it; the errors of the levels' means do."
    ]


def _with_interval(found: Found) -> str:
    """The square root of a variance from a few frames, with an interval from its degrees of
    freedom."""
    part = Part(found.variance, 2 * (found.variance / found.error) ** 2)
    low, _, value, _, high = deviation_quantiles(found.variance, 0.0, [part])
    return f"{value:.3g} (95 %: {low:.3g} to {high:.3g})"


def _pattern(calibration: NoiseCalibration) -> list[str]:
    if calibration.patterns is None:
        return []
    standard, fitted = calibration.patterns
    measurement, level = calibration.measurement, standard.level
    sentences = [
        f"PRNU by the standard is from {float(measurement.bright.frames[level]):.0f} frames at "
        f"{float(measurement.bright.mean[level]):.0f} DN, PRNU by the fit from all levels. Uneven "
        "light counts as PRNU in both."
    ]
    for axis, name in enumerate(("rows", "columns") if measurement.bright.shared else ()):
        found = unequal_gains(measurement, calibration.usable, axis)
        if found.believed:
            size, error = 100 * found.deviation, 50 * found.error / found.deviation
            sentences.append(
                f"The {name} of the flats differ by {format_with_error(size, error)} % rms, "
                "the same in every frame: part of PRNU, from gains or from uneven light."
            )
    if fitted.p_value is not None and fitted.p_value < MISFIT:
        sentences.append(
            "Offsets and gains of pixels do not explain how the pattern grows with signal: "
            f"chi-square per degree of freedom is {fitted.chi_square_per_dof:.3g} "
            f"({format_p(fitted.p_value)}). The errors of the fit include this misfit."
        )
    return sentences


def _solver(calibration: NoiseCalibration) -> list[str]:
    if calibration.likelihood is None:
        return []
    chosen = calibration.chosen
    optimum = chosen.optimum
    judged = identifiability(chosen.space, optimum.information, vector=optimum.vector)
    told = list(judged.sentences)
    if not optimum.stationary:
        told.insert(0, "The likelihood fit did not converge. Do not use its figures.")
    return [*told, convergence_in_words(calibration.posterior)]
