"""The report section of a noise calibration: the figures of the EMVA 1288 data sheet, findings, and
plots."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from jaxvision.errors import InputError

from ..inference.estimates import Estimate, Named, not_determined, quantile_estimate
from ..inference.formatting import format_value
from ..inference.parameters import names
from ..inference.precision import double_precision
from ..report.left_out import left_out_tables
from ..report.section import Section, Table, section_of_part
from ..rig import Camera
from .brighter_fatter import fitted_area_changes
from .calibration import LIKELIHOOD, STANDARD, NoiseCalibration, sheet_estimate, widened
from .doubts import OF_DARK_NOISE
from .emva1288 import Evaluation, Ranges, is_floored, least_dark_variance
from .figures import noise_pictures
from .findings import findings, is_no_sensor, processing
from .levels import PhotonTransfer
from .pattern import PatternVariance, Spread
from .prediction import section as prediction
from .prediction.predict import predict_own_frames
from .quantities import HEADINGS, NEED_PHOTONS, NEED_SATURATION, ON_GAIN, QUANTITIES, Quantity
from .regressions import MISFIT, deviation_quantiles
from .sensor import write_fitted_sensor
from .sites import sensor_of_sites, unequal_greens, write_sensor_of_sites

# Figures that depend on dark noise, and whether its upper bound gives an upper bound of theirs.
FROM_DARK_NOISE = {
    "temporal_dark_noise": True,
    "read_noise": True,
    "threshold_photons": True,
    "threshold_electrons": True,
    "dynamic_range": False,
    "dynamic_range_db": False,
    "usable_bits": False,
}
KIND, TITLE = "noise", "Camera noise by photon transfer"


@double_precision
def section(calibration: NoiseCalibration) -> Section:
    """Return the report section of a calibrated camera."""
    likelihood = calibration.likelihood
    found, pictures = [*findings(calibration)], [*noise_pictures(calibration)]
    tables, records, of_fit = [], {}, {}
    if likelihood is not None:
        chosen = likelihood.chosen
        counted = chosen.data.counted
        of_fit = {
            "parameters": ", ".join(names(chosen.space)),
            "exact moments of clipping and rounding": chosen.data.window is not None,
            "covariance inflated by": chosen.inflation,
            "levels by the histogram of codes": 0 if counted is None else counted.levels.size,
        }
        tables += [_models_table(calibration), *_area_changes_table(calibration)]
    if not is_no_sensor(calibration):
        try:
            predicted = predict_own_frames(calibration)
        except (InputError, ArithmeticError, ValueError) as error:
            found.append(
                f"The fit does not predict its own frames, so no sensor is written: {error}"
            )
        else:
            found += prediction.findings(predicted)
            pictures.append(prediction.picture(predicted))
            tables.append(prediction.table(predicted))
            records = {"sensor": partial(write_fitted_sensor, calibration)}
    return Section(
        kind=KIND,
        title=TITLE,
        estimates=_sheet_estimates(calibration),
        findings=tuple(found),
        pictures=tuple(pictures),
        tables=(*tables, *left_out_tables([("", calibration.left_out)])),
        posteriors={} if likelihood is None else {"": likelihood.posterior},
        records=records,
        about=_operating_point(calibration),
        headline=next(iter(processing(calibration)), ""),
        headings=HEADINGS,
        settings={
            "bright levels used by the likelihood": len(calibration.usable),
            "bright levels of the standard's gain": int(calibration.within.sensitivity.sum()),
            "dark levels": calibration.measurement.dark.mean.size,
            "pixels": int(calibration.measurement.bright.pixels),
            **of_fit,
        },
    )


def sections_of_sites(
    calibrations: Mapping[str, NoiseCalibration], camera: Camera
) -> list[Section]:
    """Return a report section for each mosaic site or amplifier tap."""
    found = []
    for site, calibration in calibrations.items():
        own = section_of_part(section(calibration), site)
        found.append(replace(own, pictures=own.pictures[:1]) if found else replace(own, kind=KIND))
    shown = ("system_gain", "quantum_efficiency", "read_noise", "black_level", "dsnu", "prnu")
    rows, heads = [], []
    for one in found:
        by_name = {e.name: e for e in one.estimates if e.method == LIKELIHOOD}
        there = [by_name[name] for name in shown if name in by_name]
        heads = heads or [f"{e.symbol} [{e.unit}]" for e in there]
        rows.append((one.title.removeprefix(f"{TITLE}: "), *(format_value(e) for e in there)))
    table = Table(
        "Sites by likelihood",
        ("site", *heads),
        tuple(row for row in rows if len(row) == len(heads) + 1),
        "Each site is calibrated separately; value and standard error.",
    )
    remarks, records = (), {}
    whole = all(site in calibrations for site in camera.sites)
    if whole and not any(is_no_sensor(one) for one in calibrations.values()):
        remarks = sensor_of_sites(calibrations, camera).findings
        records = {"sensor": partial(write_sensor_of_sites, calibrations, camera)}
    first, *others = found
    greens = unequal_greens({site: one.measurement for site, one in calibrations.items()})
    tables, findings = (table, *first.tables), (*greens, *remarks, *first.findings)
    return [replace(first, tables=tables, findings=findings, records=records), *others]


def _operating_point(calibration: NoiseCalibration) -> str:
    """Describe the camera's operating point, which the standard requires with every data sheet."""
    measurement = calibration.measurement
    bright, dark = measurement.bright, measurement.dark
    shortest, longest = (f"{1e3 * float(end(bright.exposure)):.3g}" for end in (np.min, np.max))
    exposures = f"exposure{'s' * (shortest != longest)} {shortest}"
    exposures += f" to {longest}" * (shortest != longest)
    light = "in photons per pixel" if measurement.photons_known else "as exposure only"
    top = measurement.full_scale
    scale = "" if top is None else f"full scale {top:g} DN, "
    return (
        f"EMVA 1288: {scale}{int(bright.pixels)} pixels, {bright.mean.size} levels of light and "
        f"{dark.mean.size} of dark, {exposures} ms, light known {light}."
    )


def _sheet_estimates(calibration: NoiseCalibration) -> tuple[Estimate, ...]:
    """Return the figures by regressions and by likelihood, then other parameters of the fit."""
    by_likelihood = {estimate.name: estimate for estimate in calibration.sheet}
    measurement, within = calibration.measurement, calibration.within
    values, listed = calibration.standard.values, []
    for quantity in QUANTITIES:
        name = quantity.name
        if name in ("dsnu", "prnu"):
            listed += _pattern_estimates(calibration, quantity)
            continue
        if name in values:
            one = standard_estimate(quantity, measurement, within, calibration.standard, STANDARD)
            listed.append(widened(one, calibration.unequal))
        if name in by_likelihood:
            listed.append(by_likelihood[name])
        # The likelihood has one dark current, from means and variances together.
        elif name not in values or not name.startswith("dark_current"):
            method, reason = LIKELIHOOD if name in values else "", _why_missing(calibration, name)
            listed.append(not_determined(quantity, reason, method=method))
    own = [found for name, found in calibration.estimates.items() if name not in by_likelihood]
    listed += [replace(found, method=LIKELIHOOD) for found in own]
    return replace_doubted(listed, measurement, processed=bool(processing(calibration)))


def replace_doubted(
    listed: Sequence[Estimate], measurement: PhotonTransfer, *, processed: bool = False
) -> tuple[Estimate, ...]:
    """Return figures, with reasons for those that contradictory or `processed` frames hide."""
    why = {name: doubt.reason for doubt in reversed(measurement.doubts) for name in doubt.of}
    if processed:
        not_raw = "these files are not raw frames (see the first sentence)"
        why |= dict.fromkeys((*ON_GAIN, *OF_DARK_NOISE), not_raw)
    found = []
    for one in listed:
        name = one.name.split("_")[0] if one.name.startswith(("dsnu", "prnu")) else one.name
        if name in why and (one.value is not None or name in FROM_DARK_NOISE):
            one = not_determined(one, why[name], method=one.method or "", group=one.group)
        found.append(one)
    return tuple(found)


def standard_estimate(
    quantity: Quantity,
    measurement: PhotonTransfer,
    within: Ranges,
    evaluation: Evaluation,
    method: str,
) -> Estimate:
    """Return a figure by the standard's regressions, or why they do not give it."""
    name = quantity.name
    if name not in evaluation.values:
        return not_determined(quantity, why_missing(measurement, name), method=method)
    value, error = (float(x[name]) for x in (evaluation.values, evaluation.errors))
    reason = ""
    if name in FROM_DARK_NOISE and is_floored(measurement, within):
        side = "below" if FROM_DARK_NOISE[name] else "above"
        reason = (
            f"{side} {value:.3g} {quantity.unit}: dark noise is under the standard's floor of "
            f"{np.sqrt(least_dark_variance(measurement)):.2g} DN, where rounding dominates"
        )
    elif not np.isfinite(value) and name.startswith("linearity"):
        reason = "too few levels lie between 5 and 95 % of saturation; add flats there"
    if reason:
        return not_determined(quantity, reason, method=method)
    return sheet_estimate(quantity, value, error, method)


def _why_missing(calibration: NoiseCalibration, name: str) -> str:
    measurement = calibration.measurement
    if calibration.likelihood is None and name in calibration.standard.values:
        return "maximum likelihood has no maximum here, as the findings say"
    if name.startswith("linearity"):
        return "the camera is linear within its noise, so its fitted curve has no linearity error"
    unlit = name in NEED_PHOTONS and not measurement.photons_known
    if name in NEED_SATURATION and measurement.knee is not None and not unlit:
        return "the response has a knee, as the findings say, and no level shows its end"
    return why_missing(measurement, name)


def why_missing(measurement: PhotonTransfer, name: str) -> str:
    """Return the reason why the frames do not give a figure of the standard."""
    if name in NEED_PHOTONS and not measurement.photons_known:
        return "the light was not measured; give photons or irradiance for every flat"
    if name in NEED_SATURATION:
        return "no level saturates the camera; add brighter flats"
    return "the darks have fewer than three different exposures; add darks at other exposures"


def _pattern_estimates(calibration: NoiseCalibration, quantity: Quantity) -> tuple[Estimate, ...]:
    if calibration.patterns is None:
        reason = (
            "a table of temporal sums does not contain the variance between pixels; give the "
            "frames in a rig folder"
        )
        return (not_determined(quantity, reason),)
    gain = float(calibration.standard.values["system_gain"])
    gain_error = float(calibration.standard.errors["system_gain"]) / gain
    fitted = calibration.estimates.get("system_gain")
    found = []
    for pattern, method, k, relative in (
        (calibration.patterns[0], STANDARD, gain, gain_error),
        (
            calibration.patterns[1],
            LIKELIHOOD,
            calibration.gain,
            gain_error if fitted is None else (fitted.standard_error or 0.0) / calibration.gain,
        ),
    ):
        if quantity.name == "dsnu":
            spread, scale = pattern.dark, 1 / k
        else:
            spread, scale, relative = pattern.response, 100.0, 0.0
        why = _why_hidden(pattern, spread)
        found.append(
            deviation_estimate(quantity, spread, why, scale=scale, relative=relative, method=method)
        )
    return tuple(found)


def deviation_estimate(
    what: Named,
    spread: Spread,
    why: str,
    *,
    scale: float = 1.0,
    relative: float = 0.0,
    method: str = "",
) -> Estimate:
    """Return the root of an estimated variance, or a bound (in `why`) if it is not significant."""
    if not spread.significant:
        bound = f"below {scale * np.sqrt(spread.bound):.3g} {what.unit}"
        return not_determined(what, why.format(bound), method=method)
    value = float(np.sqrt(spread.variance))
    error = scale * np.hypot(spread.error / (2 * value), value * relative)
    ends = scale * deviation_quantiles(
        spread.variance, spread.noise, spread.parts, relative=relative
    )
    return quantile_estimate(what, scale * value, error, ends, method=method)


def _why_hidden(pattern: PatternVariance, spread: Spread) -> str:
    """Return why a pattern is insignificant, with a placeholder for its upper limit."""
    if spread.hidden_by_noise:
        return "hidden under temporal noise, {}; take more frames"
    if pattern.p_value is not None and pattern.p_value < MISFIT:
        return (
            "offsets and gains of pixels do not explain how the pattern grows with the signal "
            f"(chi-square per degree of freedom {pattern.chi_square_per_dof:.3g}); more frames do "
            "not help"
        )
    return "{}: hidden by the chance correlation of the pixels' offsets and gains"


def _models_table(calibration: NoiseCalibration) -> Table:
    linear, chosen = calibration.linear, calibration.chosen
    noise = "pixel noise only" if linear.data.shared is None else "pixel and shared noise"
    fits = {f"linear camera, {noise}": linear}
    if chosen is not linear:
        added = [name for name in names(chosen.space) if name not in names(linear.space)]
        fits[f"+ {', '.join(added).replace('_', ' ')}"] = chosen
    return Table(
        "Models fitted by likelihood",
        ("model", "parameters", "χ² per degree", "p-value", "BIC", "K at zero signal [DN/e⁻]"),
        tuple(
            (label, len(fit.space), fit.chi_square / fit.degrees, fit.p_value, fit.bic, gain)
            for label, fit in fits.items()
            for gain in [float(fit.values["system_gain"])]
        ),
        "A good model has χ² per degree of freedom near 1; the smaller BIC is preferred.",
    )


def _area_changes_table(calibration: NoiseCalibration) -> tuple[Table, ...]:
    chosen = calibration.chosen
    if "brighter_fatter" not in chosen.values:
        return ()
    found = fitted_area_changes(calibration.measurement, calibration.usable, chosen)
    if found is None:
        return ()
    places = sorted(np.ndindex(found.values.shape), key=lambda place: np.hypot(*place))
    return (
        Table(
            "Change of a pixel's area by one electron",
            ("rows away", "columns away", "a [10⁻⁶ per e⁻]", "standard error"),
            tuple((*at, found.values[at] * 1e6, found.errors[at] * 1e6) for at in places),
            "Astier et al. (2019) without b, fitted to the covariances of neighbouring pixels; a₀₀ "
            "is the likelihood's. Over all pixels, of either sign of the offsets, they sum to 0.",
        ),
    )
