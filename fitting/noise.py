"""Calibration of a camera's noise from photon transfer: the EMVA 1288 sheet, twice.

Once by the standard's own regressions (`emva1288`), once by maximum likelihood (`noise_model`),
which weighs every level by what it knows, notices where the camera is not linear, and then reports
gain and efficiency at zero signal. Every figure has a standard error and intervals; what the
measurement cannot give says why.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from .emva1288 import (
    NEED_PHOTONS,
    NEED_SATURATION,
    QUANTITIES,
    Quantity,
    Ranges,
    evaluate,
    ranges,
    through_origin,
)
from .fixed_pattern import SEEN, fitted_pattern, standard_pattern
from .levels import PhotonTransfer, linear_levels
from .noise_calibration import LIKELIHOOD, STANDARD, NoiseCalibration
from .noise_findings import findings
from .noise_fit import LikelihoodFit, choose_model, likelihood_sheet, needed_window, noise_data
from .noise_model import NoiseData, log_density, predicted_moments
from .parameters import names, to_unconstrained
from .posterior import Posterior, SamplingOptions, estimates, laplace, sample
from .results import Estimate, Section, Table, gaussian_estimate, not_determined, sampled_estimate


def calibrate_noise(
    measurement: PhotonTransfer, *, sampling: SamplingOptions | None = None, seed: int = 0
) -> NoiseCalibration:
    """Both sheets of a measurement. With `sampling` the likelihood's posterior is drawn by emcee,
    else it is Laplace's, its draws by `seed`."""
    within = ranges(measurement)
    usable = linear_levels(measurement)
    standard = eqx.filter_jit(evaluate)(measurement, within)
    data = noise_data(measurement, usable, window=needed_window(measurement, usable))
    linear, chosen = choose_model(measurement, within, data, standard.values)
    args = (chosen.space, chosen.data, jnp.asarray(1 / chosen.inflation))
    mode, covariance = chosen.solution.vector, chosen.inflation * chosen.covariance
    if sampling is None:
        posterior = laplace(log_density, chosen.space, mode, args, covariance=covariance, seed=seed)
    else:
        posterior = sample(log_density, chosen.space, mode, covariance, args, options=sampling)
    patterns = None
    if measurement.bright.spatial_variance is not None:
        patterns = standard_pattern(measurement, within), fitted_pattern(measurement, usable)
    return NoiseCalibration(
        measurement=measurement,
        within=within,
        usable=usable,
        standard=standard,
        linear=linear,
        chosen=chosen,
        posterior=posterior,
        sheet=_likelihood_estimates(chosen, posterior, within, usable),
        standard_of_chosen=_standard_gain_of(chosen, within, usable),
        patterns=patterns,
    )


def noise_section(calibration: NoiseCalibration) -> Section:
    """Estimates, findings, tables and pictures for a report."""
    from .figures.noise import noise_pictures

    chosen = calibration.chosen
    return Section(
        kind="noise",
        title="Camera noise by photon transfer",
        estimates=_sheet_estimates(calibration),
        findings=findings(calibration),
        pictures=noise_pictures(calibration),
        tables=(_models_table(calibration),),
        posteriors={"": calibration.posterior},
        settings={
            "bright levels used by the likelihood": len(calibration.usable),
            "bright levels of the standard's gain": int(calibration.within.sensitivity.sum()),
            "dark levels": calibration.measurement.dark.mean.size,
            "pixels": int(calibration.measurement.bright.pixels),
            "parameters": ", ".join(names(chosen.space)),
            "exact moments of clipping and rounding": chosen.data.window is not None,
            "covariance inflated by": chosen.inflation,
        },
    )


def _linearity_of_usable(
    within: Ranges, usable: np.ndarray, darks: int
) -> Bool[np.ndarray, " levels"]:
    return np.concatenate([np.asarray(within.linearity)[usable], np.zeros(darks, bool)])


def _likelihood_estimates(
    fit: LikelihoodFit, posterior: Posterior, within: Ranges, usable: np.ndarray
) -> tuple[Estimate, ...]:
    """The sheet of the chosen model: by the delta method for Laplace, from the draws for emcee."""
    darks = fit.data.mean.size - len(usable)
    linearity = jnp.asarray(_linearity_of_usable(within, usable, darks))
    args = (fit.space, fit.data, linearity)
    mode, saturation = fit.solution.vector, within.saturation
    quantities = {quantity.name: quantity for quantity in QUANTITIES}
    if posterior.method == "emcee":
        return _drawn_estimates(posterior, within, args, quantities)
    values, slopes, at_saturation = eqx.filter_jit(_sheet_and_slopes)(mode, saturation, args)
    covariance = posterior.covariance
    found = []
    for name, value in values.items():
        slope = np.asarray(slopes[name])
        variance = slope @ covariance @ slope
        if at_saturation is not None and within.saturation_width is not None:
            variance += float(at_saturation[name] * within.saturation_width) ** 2 / 24
        error = float(np.sqrt(variance))
        found.append(_estimate(quantities[name], float(value), error, LIKELIHOOD))
    return tuple(found)


def _sheet_and_slopes(
    mode: Array, saturation: Array | None, args: tuple
) -> tuple[dict, dict, dict | None]:
    values = likelihood_sheet(mode, saturation, args)
    slopes = jax.jacfwd(likelihood_sheet)(mode, saturation, args)
    if saturation is None:
        return values, slopes, None
    return values, slopes, jax.jacfwd(likelihood_sheet, argnums=1)(mode, saturation, args)


def _drawn_estimates(
    posterior: Posterior, within: Ranges, args: tuple, quantities: dict[str, Quantity]
) -> tuple[Estimate, ...]:
    vectors = to_unconstrained(posterior.space, jnp.asarray(posterior.samples))
    if within.saturation is None or within.saturation_width is None:
        drawn = jax.jit(jax.vmap(lambda vector: likelihood_sheet(vector, None, args)))(vectors)
    else:
        half = float(within.saturation_width) / 2
        rng = np.random.default_rng(posterior.seed)
        offsets = rng.triangular(-half, 0, half, len(vectors)) if half > 0 else 0.0
        lights = jnp.asarray(float(within.saturation) + offsets)
        drawn = jax.jit(jax.vmap(lambda vector, light: likelihood_sheet(vector, light, args)))(
            vectors, lights
        )
    return tuple(
        sampled_estimate(
            name,
            quantities[name].symbol,
            quantities[name].unit,
            np.asarray(values),
            method=LIKELIHOOD,
        )
        for name, values in drawn.items()
    )


def _standard_gain_of(fit: LikelihoodFit, within: Ranges, usable: np.ndarray) -> float:
    """What the standard's regression makes of the fitted curves: K of the model's own means and
    variances."""
    moments = predicted_moments(fit.values, fit.data, fit.data.light)
    unlit = predicted_moments(fit.values, _unlit(fit.data), jnp.zeros_like(fit.data.light))
    bright = slice(0, len(usable))
    signal = (moments.mean - unlit.mean)[bright]
    shot = (moments.variance - unlit.variance)[bright]
    return float(through_origin(signal, shot, within.sensitivity[jnp.asarray(usable)]))


def _unlit(data: NoiseData) -> NoiseData:
    return eqx.tree_at(lambda data: data.lit, data, jnp.zeros_like(data.lit))


def _estimate(quantity: Quantity, value: float, error: float, method: str) -> Estimate:
    return gaussian_estimate(
        quantity.name,
        quantity.symbol,
        quantity.unit,
        value,
        error,
        method=method,
        log_scale=quantity.positive,
    )


def _sheet_estimates(calibration: NoiseCalibration) -> tuple[Estimate, ...]:
    """The sheet line by line, both methods, then the likelihood's own parameters."""
    by_likelihood = {estimate.name: estimate for estimate in calibration.sheet}
    values, errors = calibration.standard.values, calibration.standard.errors
    listed: list[Estimate] = []
    for quantity in QUANTITIES:
        name = quantity.name
        if name in ("dsnu", "prnu"):
            listed += _pattern_estimates(calibration, quantity)
            continue
        if name in values:
            value, error = float(values[name]), float(errors[name])
            listed.append(_estimate(quantity, value, error, STANDARD))
        if name in by_likelihood:
            listed.append(by_likelihood[name])
        missing = _missing_method(name, name in values, name in by_likelihood)
        if missing is not None:
            reason = _why_missing(calibration, name)
            listed.append(
                not_determined(name, quantity.symbol, quantity.unit, reason, method=missing)
            )
    own = [replace(found, method=LIKELIHOOD) for found in estimates(calibration.posterior)]
    return (*listed, *(found for found in own if found.name not in by_likelihood))


def _missing_method(name: str, standard: bool, likelihood: bool) -> str | None:
    """The method that lacks a figure, "" for both, None for neither; the likelihood's one dark
    current, from means and variances together, is a parameter and no line of the sheet."""
    if not standard and not likelihood:
        return ""
    return None if likelihood or name.startswith("dark_current") else LIKELIHOOD


def _why_missing(calibration: NoiseCalibration, name: str) -> str:
    if name in NEED_PHOTONS and not calibration.measurement.photons_known:
        return "the light was not measured; give photons or irradiance for every flat"
    if name in NEED_SATURATION:
        return "no level saturates the camera; add brighter flats"
    if name.startswith("dark_current"):
        return "the darks have fewer than three different exposures; add darks at other exposures"
    return "within the noise the camera is linear, so its fitted curve has no linearity error"


def _pattern_estimates(calibration: NoiseCalibration, quantity: Quantity) -> tuple[Estimate, ...]:
    name, symbol, unit, _ = quantity
    if calibration.patterns is None:
        reason = (
            "a table of temporal sums does not hold the variance from pixel to pixel; give the "
            "frames in a rig folder"
        )
        return (not_determined(name, symbol, unit, reason),)
    gain = float(calibration.standard.values["system_gain"])
    gain_error = float(calibration.standard.errors["system_gain"]) / gain
    by_fit = {estimate.name: estimate for estimate in calibration.sheet}["system_gain"]
    found = []
    for pattern, method, k, relative in (
        (calibration.patterns[0], STANDARD, gain, gain_error),
        (
            calibration.patterns[1],
            LIKELIHOOD,
            by_fit.value or gain,
            (by_fit.standard_error or 0.0) / (by_fit.value or gain),
        ),
    ):
        if name == "dsnu":
            square, error, scale = pattern.dark / k**2, pattern.dark_error / k**2, 1.0
        else:
            square, error, scale, relative = pattern.response, pattern.response_error, 100.0, 0.0
        if square < SEEN * error:
            bound = scale * np.sqrt(max(square, 0) + SEEN * error)
            reason = f"hidden under temporal noise, below {bound:.3g} {unit}; take more frames"
            found.append(not_determined(name, symbol, unit, reason, method=method))
            continue
        value = float(np.sqrt(square))
        spread = np.hypot(error / (2 * value), value * relative)
        found.append(_estimate(quantity, scale * value, scale * float(spread), method))
    return tuple(found)


def _models_table(calibration: NoiseCalibration) -> Table:
    rows = []
    fits = [("linear camera, pixel noise only", calibration.linear)]
    if calibration.chosen is not calibration.linear:
        added = [
            name.replace("_", " ")
            for name in names(calibration.chosen.space)
            if name not in names(calibration.linear.space)
        ]
        fits.append(("+ " + ", ".join(added), calibration.chosen))
    for label, fit in fits:
        rows.append(
            (
                label,
                len(fit.space),
                fit.chi_square / fit.degrees,
                fit.p_value,
                fit.bic,
                float(fit.values["system_gain"]),
            )
        )
    return Table(
        "Models fitted by likelihood",
        ("model", "parameters", "χ² per degree", "p-value", "BIC", "K at zero signal [DN/e⁻]"),
        tuple(rows),
        "A good model has χ² per degree of freedom near 1; the smaller BIC is preferred.",
    )
