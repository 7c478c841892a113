"""The data sheet of EMVA Standard 1288, release 3.1, by the regressions that the standard
prescribes.

    responsivity    mu_y - mu_y.dark = R mu_p                      through the origin, to 70 %
    gain            var_y - var_y.dark = K (mu_y - mu_y.dark)      through the origin, to 70 %
    efficiency      eta = R / K
    dark noise      sigma_y.dark^2 = intercept of var_y.dark over exposure, at least 0.24 DN^2
                    sigma_d = sqrt(sigma_y.dark^2 - 1/12) / K
    dark current    slopes of mu_y.dark (/ K) and var_y.dark (/ K^2) over exposure
    saturation      light at the largest var_y;  mu_e.sat = eta mu_p.sat;  SNR_max = sqrt(mu_e.sat)
    threshold       mu_p.min = (sigma_y.dark / K + 1/2) / eta;  DR = mu_p.sat / mu_p.min
    linearity       relative deviations from a line weighted by 1 / signal^2, from 5 % to 95 %
    fixed pattern   s^2 = s^2_measured - var_y / L;  DSNU = s_dark / K;
                    PRNU = sqrt(s_50^2 - s_dark^2) / (mu_50 - mu_dark)

The limits in per cent are shares of the saturation signal. The figures are a differentiable
function of the measured means and variances, so the delta method gives the standard error of each
figure from the sampling covariance of the means and variances. If measured values scatter about
their regression more than pixel noise explains (p < 1 %), their sampling variances are multiplied
by chi-square per degree of freedom (Birge 1932). This factor widens the errors but leaves the
standard's estimates unchanged.

Decibels are 20 log10. Usable bits are the base-2 logarithm of the dynamic range.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..codes import Converter
from ..inference.compiled import compiled_briefly
from .levels import PhotonTransfer, linear_levels, signal_of
from .quantities import NEED_PHOTONS
from .regressions import (
    SamplingErrors,
    chi_square,
    line,
    line_misfit,
    sampling_errors,
    slope_through_origin,
    surprise,
)
from .shared import SharedNoise

SENSITIVITY_TOP = 0.7
LINEARITY_RANGE = (0.05, 0.95)
FEWEST_FOR_LINE = 3  # fewest levels in the linearity range for deviations from a line
# In squared steps of the converter; below it, according to the standard, rounding dominates.
LEAST_DARK_VARIANCE = 0.24
UNLIKELY = 0.01  # p-value of a chi-square below which scatter is significant

Sheet = dict[str, Float[Array, ""]]


class Ranges(eqx.Module):
    """The bright levels that enter each regression."""

    sensitivity: Bool[Array, " levels"]  # indices of the levels for responsivity and gain
    linearity: Bool[Array, " levels"]  # indices of the levels for the linearity errors
    # light at the saturation point; None without saturation
    saturation: Float[Array, ""] | None = None
    # distance between the two neighbours of the saturation point; the true maximum lies between
    # them
    saturation_width: Float[Array, ""] | None = None
    # number of different exposures of the darks
    dark_exposures: int = eqx.field(static=True, default=0)


class Statistics(eqx.Module):
    """The measured statistics from which the data sheet is computed."""

    bright_mean: Float[Array, " levels"]  # DN
    bright_variance: Float[Array, " levels"]  # DN^2
    dark_mean: Float[Array, " darks"]  # DN
    dark_variance: Float[Array, " darks"]  # DN^2
    saturation: Float[Array, ""] | None  # light at saturation; None without


class Evaluation(eqx.Module):
    """The figures of a data sheet with their standard errors."""

    values: Sheet  # figures by name
    errors: Sheet  # their standard errors
    # factors on the variances of dark means, dark variances, bright means and bright variances,
    # because these scatter about their regressions; 1 where chance explains the scatter
    factors: Float[Array, "4"]


def ranges(measurement: PhotonTransfer) -> Ranges:
    """Return the levels of a measurement that the standard uses in each regression.

    If there is no saturation point, the brightest usable level replaces it, and figures that need
    saturation are not given.
    """
    bright = measurement.bright
    signal = signal_of(measurement)
    saturated = measurement.saturated
    top = saturated if saturated is not None else int(linear_levels(measurement)[-1])
    light, width = None, None
    if saturated is not None:
        lights = np.asarray(bright.light)
        neighbours = lights[max(saturated - 1, 0)], lights[min(saturated + 1, len(lights) - 1)]
        light, width = jnp.asarray(lights[saturated]), jnp.asarray(neighbours[1] - neighbours[0])
    return Ranges(
        *used_levels(signal, top + 1, signal[top]),
        saturation=light,
        saturation_width=width,
        dark_exposures=len(np.unique(np.asarray(measurement.dark.exposure))),
    )


def used_levels(
    signal: Float[np.ndarray, " levels"], end: int, top: float
) -> tuple[Bool[Array, " levels"], Bool[Array, " levels"]]:
    """Return masks of the levels before `end` for slopes and for linearity; `top` saturates."""
    below, (low, high) = np.arange(len(signal)) < end, LINEARITY_RANGE
    linear = below & (signal >= low * top) & (signal <= high * top)
    return jnp.asarray(below & (signal <= SENSITIVITY_TOP * top)), jnp.asarray(linear)


def statistics(measurement: PhotonTransfer, saturation: Array | None) -> Statistics:
    """Collect the measured statistics from which a sheet is computed."""
    bright, dark = measurement.bright, measurement.dark
    return Statistics(bright.mean, bright.variance, dark.mean, dark.variance, saturation)


def sheet(stats: Statistics, measurement: PhotonTransfer, within: Ranges) -> Sheet:
    """Return the standard's figures; those that the measurement cannot give are missing.

    Source:
        EMVA Standard 1288, release 3.1.
    """
    signal = _signal(stats, measurement)
    gain = slope_through_origin(signal, _shot_variance(stats, measurement), within.sensitivity)
    responsivity = slope_through_origin(measurement.bright.light, signal, within.sensitivity)
    dark_variance, variance_slope = _dark_variance(stats, measurement, within)
    mean_slope = 0.0
    if within.dark_exposures > 2:
        _, mean_slope = line(measurement.dark.exposure, stats.dark_mean)
    figures = derived_figures(
        gain,
        responsivity,
        jnp.maximum(dark_variance, least_dark_variance(measurement)),
        stats.saturation,
        photons_known=measurement.photons_known,
        converter=measurement.converter,
    )
    if within.dark_exposures > 2:
        figures["dark_current_mean"] = mean_slope / gain
        figures["dark_current_variance"] = variance_slope / gain**2
    low, high = linearity_errors(measurement.bright.light, signal, within.linearity)
    return figures | {"linearity_error_min": low, "linearity_error_max": high}


def _dark_variance(
    stats: Statistics, measurement: PhotonTransfer, within: Ranges
) -> tuple[Array, Array | float]:
    """Return the dark variance at zero exposure, DN^2, and its slope over exposure."""
    if within.dark_exposures > 2:
        return line(measurement.dark.exposure, stats.dark_variance)
    return stats.dark_variance[0], 0.0


def is_floored(measurement: PhotonTransfer, within: Ranges) -> bool:
    """Return whether dark noise is below the standard's minimum, so that figures are bounds."""
    found, _ = _dark_variance(statistics(measurement, None), measurement, within)
    return float(found) < least_dark_variance(measurement)


def least_dark_variance(measurement: PhotonTransfer) -> float:
    """Return the smallest dark variance that the standard allows, DN^2."""
    converter = measurement.converter
    return max(LEAST_DARK_VARIANCE * converter.width**2, 1.2 * converter.rounding)


def derived_figures(
    gain: Array,
    responsivity: Array,
    dark_variance: Array,
    saturation: Array | None,
    *,
    photons_known: bool,
    converter: Converter,
) -> Sheet:
    """Compute the figures that follow from gain, responsivity, dark noise and saturation."""
    efficiency = responsivity / gain
    threshold = jnp.sqrt(dark_variance) / gain + 0.5
    figures = {
        "system_gain": gain,
        "inverse_gain": 1 / gain,
        "quantum_efficiency": 100 * efficiency,
        "responsivity": responsivity,
        "temporal_dark_noise": jnp.sqrt(dark_variance),
        "read_noise": jnp.sqrt(dark_variance - converter.rounding) / gain,
        "threshold_photons": threshold / efficiency,
        "threshold_electrons": threshold,
    }
    if saturation is not None:
        electrons = efficiency * saturation
        snr = jnp.sqrt(electrons)
        figures |= dynamic_ranges(electrons, threshold) | {
            "saturation_photons": saturation,
            "saturation_electrons": electrons,
            "snr_max": snr,
            "snr_max_db": 20 * jnp.log10(snr),
            "snr_max_bits": jnp.log2(snr),
        }
    if not photons_known:
        figures = {name: x for name, x in figures.items() if name not in NEED_PHOTONS}
    return figures


def dynamic_ranges(saturation: Array, threshold: Array) -> Sheet:
    """Return the dynamic range between two numbers of electrons, also in decibels and in bits."""
    ratio = saturation / threshold
    return {
        "dynamic_range": ratio,
        "dynamic_range_db": 20 * jnp.log10(ratio),
        "usable_bits": jnp.log2(ratio),
    }


def linearity_errors(
    light: Float[Array, " levels"], signal: Float[Array, " levels"], within: Bool[Array, " levels"]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Return the least and the largest relative deviation from the linearity line, per cent."""
    deviation = linearity_deviation(light, signal, within)
    return (
        jnp.min(jnp.where(within, deviation, jnp.inf)),
        jnp.max(jnp.where(within, deviation, -jnp.inf)),
    )


def linearity_deviation(
    light: Float[Array, " levels"], signal: Float[Array, " levels"], within: Bool[Array, " levels"]
) -> Float[Array, " levels"]:
    """Return deviations from the linearity line, per cent; NaN for fewer than 3 levels."""
    enough = jnp.sum(within) >= FEWEST_FOR_LINE
    within = within | ~enough
    safe = jnp.where(within, signal, 1)
    offset, slope = line(light, signal, weights=jnp.where(within, 1 / safe**2, 0))
    expected = offset + slope * light
    off = 100 * (signal - expected) / jnp.where(within, expected, 1)
    return jnp.where(enough, off, jnp.nan)


@compiled_briefly
def evaluate(
    measurement: PhotonTransfer,
    within: Ranges,
    *,
    shared: SharedNoise | None = None,
    figures: Callable[[Statistics, PhotonTransfer, Ranges], Sheet] = sheet,
) -> Evaluation:
    """Compute a data sheet with standard errors by the delta method. `figures` is the function that
    computes the figures by one release of the standard."""
    stats = statistics(measurement, within.saturation)
    values = figures(stats, measurement, within)
    bright, dark, factors = _sampling(stats, measurement, within, values["system_gain"], shared)
    slopes = jax.jacrev(lambda stats: figures(stats, measurement, within))(stats)

    def standard_error(slope: Statistics) -> Array:
        total = _propagate(slope.bright_mean, slope.bright_variance, bright)
        total = total + _propagate(slope.dark_mean, slope.dark_variance, dark)
        if within.saturation_width is not None and slope.saturation is not None:
            # The true maximum lies between the neighbours: triangular over their distance.
            total = total + slope.saturation**2 * within.saturation_width**2 / 24
        return jnp.sqrt(total)

    errors = {name: standard_error(slope) for name, slope in slopes.items()}
    return Evaluation(values, errors, factors)


def _signal(stats: Statistics, measurement: PhotonTransfer) -> Array:
    return stats.bright_mean - stats.dark_mean[measurement.dark_of]


def _shot_variance(stats: Statistics, measurement: PhotonTransfer) -> Array:
    return stats.bright_variance - stats.dark_variance[measurement.dark_of]


def _propagate(mean_slope: Array, variance_slope: Array, errors: SamplingErrors) -> Array:
    return jnp.sum(
        mean_slope**2 * errors.mean
        + 2 * mean_slope * variance_slope * errors.both
        + variance_slope**2 * errors.variance
    )


def _sampling(
    stats: Statistics,
    measurement: PhotonTransfer,
    within: Ranges,
    gain: Array,
    shared: SharedNoise | None,
) -> tuple[SamplingErrors, SamplingErrors, Float[Array, "4"]]:
    """Return the sampling errors of bright and dark levels, and the factors in them."""
    shot = _shot_variance(stats, measurement)
    bright = sampling_errors(measurement.bright, shot_variance=shot, gain=gain, shared=shared)
    dark = sampling_errors(measurement.dark, shared=shared)

    def factor(chi2: Array, degrees: Array) -> Array:
        unlikely = surprise(chi2, degrees) < UNLIKELY
        return jnp.where(unlikely, jnp.maximum(chi2 / jnp.maximum(degrees, 1), 1), 1)

    def scale_errors(errors: SamplingErrors, of_mean: Array, of_variance: Array) -> SamplingErrors:
        return SamplingErrors(of_mean * errors.mean, of_variance * errors.variance, errors.both)

    exposure, of_dark = measurement.dark.exposure, 2 * [jnp.ones_like(gain)]
    if within.dark_exposures > 2:
        of_dark = [
            factor(*line_misfit(exposure, stats.dark_mean, dark.mean)),
            factor(*line_misfit(exposure, stats.dark_variance, dark.variance)),
        ]
    dark = scale_errors(dark, *of_dark)
    own_dark = jax.tree.map(lambda error: error[measurement.dark_of], dark)
    signal, used = _signal(stats, measurement), within.sensitivity
    degrees = jnp.sum(used, dtype=gain.dtype) - 1
    responsivity = slope_through_origin(measurement.bright.light, signal, used)
    missed = signal - responsivity * measurement.bright.light
    of_mean = factor(chi_square(missed, bright.mean + own_dark.mean, used), degrees)
    missed = shot - gain * signal
    spread = bright.variance + own_dark.variance + gain**2 * (bright.mean + own_dark.mean)
    of_variance = factor(chi_square(missed, spread - 2 * gain * bright.both, used), degrees)
    factors = jnp.stack([*of_dark, of_mean, of_variance])
    return scale_errors(bright, of_mean, of_variance), dark, factors
