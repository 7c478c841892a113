"""Calibration of a camera's noise from photon transfer, by EMVA 1288 and by maximum likelihood.

The figures of the EMVA 1288 data sheet are computed twice, by the standard's regressions
(`emva1288`) and by maximum likelihood (`model`). The likelihood weights every level by its
precision. The likelihood also tests the response for nonlinearity, and for a nonlinear camera it
gives gain and efficiency at zero signal. Every figure has a standard error and 68 % and 95 %
intervals. If the measurement cannot give a figure, the data sheet states the reason instead.

If rows or columns share more noise in flats than in darks, as under flickering light with a rolling
shutter, the excess is subtracted before the fits. No model includes this excess noise, and its
variance resembles that of shot noise. An analysis of variance detects the excess and estimates its
size.
"""

import warnings
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from jaxvision import as_dtype
from jaxvision.errors import InputError

from ..inference.compiled import compiled_briefly
from ..inference.emcee_run import Emcee
from ..inference.estimates import Estimate, gaussian_estimate, not_determined, sampled_estimate
from ..inference.given import require_kind
from ..inference.importance import laplace_where_it_holds
from ..inference.left_out import LeftOut
from ..inference.parameters import Parameter, names, to_unconstrained
from ..inference.posterior import Posterior, estimates, sample
from ..inference.precision import double_precision
from ..inference.problem import log_density
from ..inference.search import search
from ..report.notebook import ShownInNotebooks
from .counted import CodeFit, fitted_tables
from .doubts import drifting
from .emva1288 import Evaluation, Ranges, Sheet, evaluate, ranges
from .levels import Levels, PhotonTransfer, linear_levels
from .model import NoiseData, predicted_moments
from .neighbours import are_significant
from .pattern import PatternVariance, Spread, fitted_pattern, standard_pattern
from .periodic import Periodic, periodic_structure, unequal_gains_of
from .quantised import FINEST_READ_NOISE
from .quantities import (
    LIGHT_DRIFT,
    LIGHT_SCATTER,
    NEED_PHOTONS,
    OFFSET_SPREAD,
    ON_GAIN,
    QUANTITIES,
    READ_NOISE,
    Quantity,
)
from .regressions import Part, slope_through_origin
from .shared import LINES, Found, extra_lines, shared_noise, temporal_lines
from .statement import (
    LikelihoodFit,
    base_space,
    choose_model,
    fit_model,
    likelihood_sheet,
    make_problem,
    noise_data,
    posterior_problem,
    replace_parameters,
)
from .window import needed_window, offset_data


def extra_in_flats(
    measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"]
) -> dict[str, Found]:
    """Return the row and column noise by which flats significantly exceed darks."""
    found = {
        name: extra_lines(measurement.bright, measurement.dark, usable, axis)
        for axis, name in enumerate(LINES)
    }
    return {name: one for name, one in found.items() if one.is_significant}


def subtract_flicker(measurement: PhotonTransfer, flicker: dict[str, Found]) -> PhotonTransfer:
    """Return the measurement with the row and column noise of its flats cut to the darks'."""
    bright = measurement.bright
    if not flicker or bright.shared is None:
        return measurement
    extra = np.zeros((2, bright.mean.size))
    for axis, name in enumerate(LINES):
        if name in flicker:
            unlit = temporal_lines(measurement.dark, axis)
            extra[axis] = bright.shared.lines[axis] - (
                unlit.variance if unlit.is_significant else 0.0
            )
    variance = np.maximum(np.asarray(bright.variance) - extra.sum(axis=0), 0.0)
    steady: Levels = replace(
        bright, variance=jnp.asarray(variance), flicker=jnp.asarray(np.maximum(extra, 0.0))
    )
    return replace(measurement, bright=steady)


STANDARD, LIKELIHOOD = "EMVA 1288", "likelihood"
BY_NAME = {quantity.name: quantity for quantity in QUANTITIES}


@dataclass(frozen=True)
class Likelihood:
    """The results of the maximum-likelihood fits to a camera."""

    linear: LikelihoodFit  # the fit of a linear camera
    # the fit of the model that describes the camera; `linear` where the linear model does
    chosen: LikelihoodFit
    posterior: Posterior  # of the chosen model
    # K, DN/e-, from the standard's regression on curves simulated with the chosen model
    standard_of_chosen: float


@dataclass(frozen=True, repr=False)
class NoiseCalibration(ShownInNotebooks):
    """The complete calibration of a camera, from which findings, figures and report are made.

    Attributes:
        measurement: the calibrated levels.
        within: levels that enter each regression, by the standard.
        usable: indices of the bright levels below saturation.
        standard: the EMVA 1288 data sheet by the standard's regressions.
        likelihood: the fit by maximum likelihood; None where the likelihood has no maximum.
        no_likelihood: a sentence that states why the likelihood has no maximum; empty where it has
            one.
        sheet: the figures of the EMVA 1288 data sheet by the chosen model.
        patterns: DSNU and PRNU by the standard and by the fit to all levels; None where only
            temporal sums are known.
        left_out: effects that the likelihood omits because no fit can determine them.
        flicker: noise of rows and columns in the flats in excess of that of the darks, which was
            subtracted from the measurement.
        periodic: classes of pixels (rows, columns, mosaic sites or halves of the frame) that differ
            although the rig does not state this.
        counted: fit to histograms of codes at levels of few electrons; None without such
            histograms.
    """

    measurement: PhotonTransfer
    within: Ranges
    usable: Int[np.ndarray, " usable"]
    standard: Evaluation
    likelihood: Likelihood | None
    no_likelihood: str
    sheet: tuple[Estimate, ...]
    patterns: tuple[PatternVariance, PatternVariance] | None
    left_out: tuple[LeftOut, ...]
    flicker: dict[str, Found]
    periodic: tuple[Periodic, ...] = ()
    counted: CodeFit | None = None

    def _require_likelihood(self) -> Likelihood:
        if self.likelihood is None:
            raise InputError(self.no_likelihood)
        return self.likelihood

    @property
    def linear(self) -> LikelihoodFit:
        """The likelihood fit of a linear camera; `InputError` where it has no maximum."""
        return self._require_likelihood().linear

    @property
    def chosen(self) -> LikelihoodFit:
        """The fit of the chosen model; `InputError` where it has no maximum."""
        return self._require_likelihood().chosen

    @property
    def posterior(self) -> Posterior:
        """The posterior of the chosen model; `InputError` where it has no maximum."""
        return self._require_likelihood().posterior

    @property
    def gain(self) -> float:
        """The gain K, DN/e-, by the likelihood, else by the standard's regression."""
        estimate = self.estimates.get("system_gain")
        of_standard = float(self.standard.values["system_gain"])
        return of_standard if estimate is None or estimate.value is None else estimate.value

    @property
    def unequal(self) -> float:
        """Relative rms deviation between the gains of the pixel classes in `periodic`."""
        return unequal_gains_of(self.periodic)

    @property
    def estimates(self) -> dict[str, Estimate]:
        """The likelihood's figures and parameters by name, as the report's tables give them."""
        if self.likelihood is None:
            return {}
        by_name = {found.name: found for found in estimates(self.posterior)}
        return by_name | {found.name: found for found in self.sheet}

    @property
    def shown(self) -> dict[str, Estimate]:
        """Former name of `estimates`."""
        warnings.warn("shown is now estimates.", DeprecationWarning, stacklevel=2)
        return self.estimates

    @property
    def efficiency(self) -> float | None:
        """The quantum efficiency, electrons per photon, as in the report's table. A sensor uses the
        value at the posterior mode. If only that value exceeds 1, which means an error in the
        input, it is returned instead. None if photons are not known."""
        if not self.measurement.photons_known:
            return None
        if self.likelihood is None:
            return float(self.standard.values["quantum_efficiency"]) / 100
        values = dict(zip(names(self.posterior.space), self.posterior.mode, strict=True))
        at_mode = float(values["responsivity"] / values["system_gain"])
        shown = (self.estimates["quantum_efficiency"].value or 0.0) / 100
        return at_mode if at_mode > 1 >= shown else shown

    @property
    def least_efficiency(self) -> float | None:
        """Lower end of the 95 % interval of `efficiency`; None if photons are not known."""
        if not self.measurement.photons_known:
            return None
        if self.likelihood is None:
            values, errors = self.standard.values, self.standard.errors
            value, error = (float(x["quantum_efficiency"]) for x in (values, errors))
            return (value - 2 * error) / 100
        interval = self.estimates["quantum_efficiency"].interval_95
        return None if interval is None else interval[0] / 100


@double_precision
def calibrate(
    measurement: PhotonTransfer, *, sampling: Emcee | None = None, seed: int = 0
) -> NoiseCalibration:
    """Calibrate a camera by the standard's regressions and by maximum likelihood.

    Args:
        measurement: bright and dark levels.
        sampling: how to draw the likelihood's posterior by emcee; None for Laplace.
        seed: of every draw.

    Returns:
        The calibration; without likelihood results if the likelihood has no maximum.
    """
    require_kind("noise.calibrate: measurement", measurement, PhotonTransfer, source="from_frames")
    measurement = as_dtype(measurement, np.float64)  # the caller may use float32
    flicker = extra_in_flats(measurement, linear_levels(measurement))
    measurement = subtract_flicker(measurement, flicker)
    within = ranges(measurement)
    usable = linear_levels(measurement)
    # Taps that differ only in remarks share one compiled program.
    bare = replace(measurement, remarks=(), lossy=(), doubts=(), site=None, pattern=None)
    standard = evaluate(bare, within, shared=shared_noise(measurement.dark))
    window, gone = needed_window(measurement, usable)
    offsets = None if window is None else offset_data(measurement, usable)
    counted = fitted_tables(measurement)
    of_tables = None if counted is None else counted.counted_levels(usable)
    data = noise_data(measurement, usable, window=window, offsets=offsets, counted=of_tables)
    likelihood, why, sheet = None, "", ()
    try:
        linear, chosen = choose_model(
            measurement,
            make_problem(base_space(measurement, within, offsets=offsets), *data),
            standard.values,
            trend=drifting(measurement, usable),
            sharing=are_significant(measurement, usable),
        )
        posterior = _posterior(chosen, sampling, seed)
        of_chosen = _standard_gain_of(chosen, within, usable)
        likelihood = Likelihood(linear, chosen, posterior, of_chosen)
        sheet = _limit_read_noise(_likelihood_estimates(chosen, posterior, within, usable), chosen)
    except InputError as error:
        why = str(error)
    periodic = periodic_structure(measurement, usable)
    unequal = unequal_gains_of(periodic)
    lamp = 0.0 if likelihood is None else lamp_error(likelihood.chosen)
    patterns = None
    if measurement.bright.spatial_variance is not None:
        fit_to_all = fitted_pattern(measurement, usable)
        if likelihood is not None:
            fit_to_all = _replace_rounded_dsnu(fit_to_all, likelihood.posterior)
        patterns = standard_pattern(measurement, within), fit_to_all
    return NoiseCalibration(
        measurement=measurement,
        within=within,
        usable=usable,
        standard=standard,
        likelihood=likelihood,
        no_likelihood=why,
        sheet=tuple(widened(one, unequal, lamp=lamp) for one in sheet),
        patterns=patterns,
        left_out=gone,
        flicker=flicker,
        periodic=periodic,
        counted=counted,
    )


def refitted(calibration: NoiseCalibration, terms: tuple[Parameter, ...]) -> NoiseCalibration:
    """Return the calibration, fitted again with these terms if its model lacks any."""
    chosen, likelihood = calibration.chosen, calibration.likelihood
    lacking = tuple(term for term in terms if term not in chosen.space)
    if not lacking or likelihood is None:
        return calibration
    problem = replace_parameters(chosen.problem, chosen.space + lacking)
    fit = fit_model(problem, calibration.standard.values)
    posterior = _posterior(fit, None, calibration.posterior.seed)
    return replace(calibration, likelihood=replace(likelihood, chosen=fit, posterior=posterior))


def _replace_rounded_dsnu(pattern: PatternVariance, posterior: Posterior) -> PatternVariance:
    """Return the fixed pattern; the likelihood's DSNU replaces one that rounding distorts."""
    labels = names(posterior.space)
    if OFFSET_SPREAD.name not in labels:
        return pattern
    place = labels.index(OFFSET_SPREAD.name)
    variance = float(posterior.mode[place]) ** 2
    noise = 2 * variance * float(np.sqrt(posterior.covariance[place, place]))
    scale = variance / max(pattern.dark.variance, np.finfo(float).tiny)
    parts = tuple(Part(scale * part.variance, part.degrees) for part in pattern.dark.parts)
    return replace(pattern, dark=Spread(variance, noise, parts))


def _posterior(fit: LikelihoodFit, sampling: Emcee | None, seed: int) -> Posterior:
    """Return the posterior of the chosen model, whose mode the prior of a scatter may shift."""
    vector, covariance = fit.optimum.vector, fit.inflation * fit.covariance
    problem = posterior_problem(fit)
    if problem.inputs.jeffreys:
        found = search(problem, vector[None])
        if found.stationary:
            vector, covariance = found.vector, np.linalg.inv(found.information)
    of = log_density, fit.space, jnp.asarray(vector), covariance, problem
    if sampling is not None:
        return sample(*of, options=sampling, seed=seed)
    return laplace_where_it_holds(*of, seed=seed, by_chain=False)


def _likelihood_estimates(
    fit: LikelihoodFit, posterior: Posterior, within: Ranges, usable: np.ndarray
) -> tuple[Estimate, ...]:
    """Return the data sheet of the chosen model, with errors by the delta method or draws."""
    args = (fit.space, fit.data, _range_of_linearity(fit, within, usable))
    if posterior.sampled:
        return _estimates_from_draws(posterior, within, args)
    vector = jnp.asarray(fit.optimum.vector)
    values, slopes = _sheet_and_slopes(vector, within.saturation, args)
    found = []
    for name, value in values.items():
        slope, at_saturation = (x if x is None else np.asarray(x) for x in slopes[name])
        variance = float(slope @ posterior.covariance @ slope)
        if at_saturation is not None and within.saturation_width is not None:
            variance += float(at_saturation * within.saturation_width) ** 2 / 24
        found.append(sheet_estimate(BY_NAME[name], float(value), variance**0.5, LIKELIHOOD))
    return tuple(found)


def _range_of_linearity(fit: LikelihoodFit, within: Ranges, usable: np.ndarray) -> Array:
    """Return a mask of the fit's levels: True for levels in the linearity error of EMVA 1288."""
    linearity = np.zeros(fit.data.lit.size, bool)
    linearity[: len(usable)] = np.asarray(within.linearity)[usable]
    return jnp.asarray(linearity)


def steady_linearity(calibration: NoiseCalibration) -> tuple[float, float]:
    """Return the linearity errors LE_min and LE_max, %, for a steady light, from a fit that has
    both a curved response and a drifting light. The parameters are the most likely ones without a
    drift."""
    fit = calibration.chosen
    vector, place = np.array(fit.optimum.vector), names(fit.space).index(LIGHT_DRIFT.name)
    of_drift = fit.covariance[:, place]
    vector -= of_drift / of_drift[place] * vector[place]
    linearity = _range_of_linearity(fit, calibration.within, calibration.usable)
    args = (fit.space, fit.data, linearity)
    values, _ = _sheet_and_slopes(jnp.asarray(vector), calibration.within.saturation, args)
    return float(values["linearity_error_min"]), float(values["linearity_error_max"])


def widened(estimate: Estimate, unequal: float, *, lamp: float = 0.0) -> Estimate:
    """Return an estimate with the relative errors of unequal gains of pixels and of the lamp."""
    name, value = estimate.name, estimate.value
    relative = np.hypot(unequal * (name in ON_GAIN), lamp * (name in NEED_PHOTONS))
    if not relative or value is None:
        return estimate
    error = float(np.hypot(estimate.standard_error or 0.0, relative * value))
    return sheet_estimate(BY_NAME[name], value, error, estimate.method)


def lamp_error(fit: LikelihoodFit) -> float:
    """Return the relative error that the stated light of all levels shares if the lamp drifts over
    the series; 0 if the levels show no drift. The error arises because the level at which the
    stated light was correct is unknown.

    The unknown factor on the light is assumed uniform within the largest deviation of any level. A
    scatter of the light counts as a drift if successive levels differ by less than independent
    levels would. The test is von Neumann's ratio, which is 2 for independent levels.
    """
    if LIGHT_DRIFT not in fit.space and LIGHT_SCATTER not in fit.space:
        return 0.0
    lit = np.asarray(fit.data.lit) > 0
    expected, black = _means(fit.values, fit.data), float(fit.values["black_level"])
    rates = (np.asarray(fit.problem.data[:, 0])[lit] - black) / (np.asarray(expected)[lit] - black)
    away = rates - rates.mean()
    if fit.data.series is not None:
        away = away[np.argsort(np.asarray(fit.data.series)[lit], kind="stable")]
    alike = np.sum(np.diff(away) ** 2) < 2 * np.sum(away**2)
    if LIGHT_DRIFT not in fit.space and not alike:
        return 0.0
    return float(np.abs(away).max()) / 3**0.5


@eqx.filter_jit
def _means(values: dict[str, Array], data: NoiseData) -> Array:
    """Return the expected mean of each level in the stated light, DN."""
    return predicted_moments(values, data, data.light).mean


def finest_read_noise(fit: LikelihoodFit) -> float:
    """Return the read noise, e-, below which rounding leaves only an upper limit; else 0."""
    if fit.data.window is None:
        return 0.0
    return FINEST_READ_NOISE * fit.data.converter.step / float(fit.values["system_gain"])


def _limit_read_noise(sheet: tuple[Estimate, ...], fit: LikelihoodFit) -> tuple[Estimate, ...]:
    """Return the data sheet; a read noise that rounding hides becomes an upper limit."""
    finest, found = finest_read_noise(fit), []
    for one in sheet:
        low, high = one.interval_95 or (0.0, 0.0)
        if one.name == READ_NOISE.name and low < finest:
            most = max(finest, high)
            why = f"below {most:.3g} {one.unit}: perhaps finer than {FINEST_READ_NOISE:g} of a code"
            one = not_determined(BY_NAME[one.name], why, method=LIKELIHOOD)
        found.append(one)
    return tuple(found)


@compiled_briefly
def _sheet_and_slopes(mode: Array, saturation: Array | None, args: tuple) -> tuple[dict, dict]:
    """Return the sheet and its derivatives with respect to parameters and saturation point."""
    slopes = jax.jacfwd(likelihood_sheet, argnums=(0, 1))(mode, saturation, args)
    return likelihood_sheet(mode, saturation, args), slopes


def _estimates_from_draws(
    posterior: Posterior, within: Ranges, args: tuple
) -> tuple[Estimate, ...]:
    vectors = to_unconstrained(posterior.space, jnp.asarray(posterior.samples))
    lights = None
    if within.saturation is not None and within.saturation_width is not None:
        half = float(within.saturation_width) / 2
        rng = np.random.default_rng(posterior.seed)
        offsets = rng.triangular(-half, 0, half, len(vectors)) if half > 0 else 0.0
        lights = jnp.broadcast_to(float(within.saturation) + offsets, len(vectors))
    drawn = _sheets(vectors, None if lights is None else jnp.asarray(lights), args)
    return tuple(
        sampled_estimate(BY_NAME[name], np.asarray(values), method=LIKELIHOOD)
        for name, values in drawn.items()
    )


@eqx.filter_jit
def _sheets(vectors: Array, lights: Array | None, args: tuple) -> Sheet:
    return jax.vmap(lambda vector, light: likelihood_sheet(vector, light, args))(vectors, lights)


def _standard_gain_of(fit: LikelihoodFit, within: Ranges, usable: np.ndarray) -> float:
    """Return the gain of the standard's regression on moments of the fitted model."""
    predicted = eqx.filter_jit(predicted_moments)
    moments = predicted(fit.values, fit.data, fit.data.light)
    unlit_data = eqx.tree_at(lambda data: data.lit, fit.data, jnp.zeros_like(fit.data.lit))
    unlit = predicted(fit.values, unlit_data, jnp.zeros_like(fit.data.light))
    bright = slice(0, len(usable))
    signal = (moments.mean - unlit.mean)[bright]
    shot = (moments.variance - unlit.variance)[bright]
    return float(slope_through_origin(signal, shot, within.sensitivity[jnp.asarray(usable)]))


def sheet_estimate(quantity: Quantity, value: float, error: float, method: str) -> Estimate:
    """Return a figure with intervals, symmetric in its logarithm if it must be positive."""
    return gaussian_estimate(quantity, value, error, method=method, log_scale=quantity.positive)
