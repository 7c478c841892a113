"""Calibration of a camera's noise from photon transfer: the EMVA 1288 sheet, twice.

Once by the standard's own regressions (`emva1288`), once by maximum likelihood (`model`),
which weighs every level by what it knows, notices where the camera is not linear, and then reports
gain and efficiency at zero signal. Every figure has a standard error and intervals; what the
measurement cannot give says why.
"""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from ..inference.estimates import Estimate, gaussian_estimate, sampled_estimate
from ..inference.parameters import to_unconstrained
from ..inference.posterior import Posterior, SamplingOptions, laplace, sample
from .emva1288 import QUANTITIES, Evaluation, Quantity, Ranges, evaluate, ranges, through_origin
from .fit import LikelihoodFit, choose_model, likelihood_sheet, needed_window, noise_data
from .levels import PhotonTransfer, linear_levels
from .model import NoiseData, log_density, predicted_moments
from .pattern import PatternVariance, fitted_pattern, standard_pattern

STANDARD, LIKELIHOOD = "EMVA 1288", "likelihood"


@dataclass(frozen=True)
class NoiseCalibration:
    """standard: the sheet by the standard. linear, chosen: the likelihood fits of a linear camera
    and of the model that the camera calls for, the same where the linear one does. sheet: figures
    of the chosen model. standard_of_chosen: K, DN/e-, that the standard's regression would give for
    the chosen model's own curves. usable: the bright levels below saturation. patterns: by the
    standard and by the fit to all levels, None where only temporal sums are known."""

    measurement: PhotonTransfer
    within: Ranges
    usable: Int[np.ndarray, " usable"]
    standard: Evaluation
    linear: LikelihoodFit
    chosen: LikelihoodFit
    posterior: Posterior
    sheet: tuple[Estimate, ...]
    standard_of_chosen: float
    patterns: tuple[PatternVariance, PatternVariance] | None


def calibrate(
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
        found.append(sheet_estimate(quantities[name], float(value), error, LIKELIHOOD))
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


def sheet_estimate(quantity: Quantity, value: float, error: float, method: str) -> Estimate:
    """A line of the sheet as an estimate."""
    return gaussian_estimate(
        quantity.name,
        quantity.symbol,
        quantity.unit,
        value,
        error,
        method=method,
        log_scale=quantity.positive,
    )
