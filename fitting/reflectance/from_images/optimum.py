"""Search for the best parameters of one channel, in three steps: variable projection, weighted
least squares and maximum likelihood.

Variable projection finds the global optimum of unweighted least squares, without start values. The
residuals of this fit give the variance model and the weights of the final fit, which is one step of
feasible generalised least squares. A linear signal X (DN) has the variance

    floor + shot X + (relative X)^2

The terms `floor` and `shot` are properties of the sensor. The term `relative` is the misfit of the
model, due to unequal pixel gains (PRNU) or a surface that differs from the model. With weights by
this variance, bright highlights that the model describes badly would have little weight, although
these highlights dominate the errors of predicted pictures. The weights therefore treat a misfit as
a constant,

    floor + shot X + misfit^2,

so that the fit is plain least squares if the misfit dominates, and efficient if there is none.

A saturated pixel enters the likelihood as "at least this bright". If saturated pixels were dropped,
or used with their stored numbers, the estimated highlight would be biased.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np
import scipy.optimize
from jaxtyping import Float

from jaxvision.sensor import QUANTISATION_VARIANCE

from ...inference.newton import minimise_read
from ...inference.parameters import names
from ...inference.separable import SeparableFit, fit_amplitudes, fit_separable
from ..models import has_lobe, is_searched, log_range, shape_of
from .samples import (
    Grouping,
    Prediction,
    Samples,
    add_offset,
    average,
    cost_and_information,
    predict,
    saturated_only,
)
from .signal import (
    Matrix,
    OfSamples,
    Vector,
    decoded,
    encoding_slope,
    lobe_with_slopes,
    parameter_space,
)

GAMMAS = (1.0, 1.4, 1.8, 2.2, 2.6)  # starts if gamma is free
NEARBY = 2.0  # largest change of log parameters by weights, unless the data do not determine them
LINEAR = 0.02  # change of log parameters within which means over pixel areas are linear
MOST_ROUNDS = 3  # updates of these means
REACH = 1.0  # half width of the bounded search, in log parameters
TOLERANCE = 1e-7  # predicted decrease of the cost at which a search ends
MOST_STEPS = 300  # most steps of the bounded search
MOST_PARAMETERS = 5  # most parameters of any form; searches for all forms share one program
FINER = 9  # shapes of each finer grid of the search
SMALLEST_SHARE = 1e-9  # share of the brightest reflection below which an amplitude counts as absent
BINS = 64
EXCESS = 3.0  # standard deviations by which chi-square must exceed its expectation


# ---------------------------------------------------------------- spread


@dataclass(frozen=True)
class Spread:
    """The variance of residuals as a function of the linear signal X: floor + shot X + (relative
    X)^2.
    """

    floor: float  # DN^2
    shot: float  # DN; the system gain, DN per electron
    relative: float | None  # fraction of the signal; None where it is not significant


def variance(spread: Spread, signal: OfSamples, *, slope: OfSamples | float = 1.0) -> OfSamples:
    """Return the variance of the stored number, DN^2, at signal X and slope d DN / d X."""
    linear = spread.floor + spread.shot * np.maximum(signal, 0)
    if spread.relative is not None:
        linear = linear + (spread.relative * signal) ** 2
    return slope**2 * linear + QUANTISATION_VARIANCE


def sensor_spread(gain: float, read_noise: float) -> Spread:
    """Return the variance model of a sensor with a gain in DN/e- and a read noise in e-."""
    return Spread((gain * read_noise) ** 2, gain, None)


def fit_spread(
    residual: OfSamples, signal: OfSamples, slope: OfSamples, *, sensor: Spread | None
) -> Spread:
    """Return the most likely variance model of residuals (DN), from their mean squares in bins of
    signal (DN).

    With a known sensor, only the relative term is fitted, and only if chi-square exceeds its
    expectation by three standard deviations. Without a known sensor, a constant and a relative term
    are fitted.
    """
    bins = counts, squares, x, d = _bin_samples(residual, signal, slope)
    if sensor is not None:
        excess = np.sum(counts * squares / variance(sensor, x, slope=d)) / counts.sum() - 1
        if excess < EXCESS * np.sqrt(2 / counts.sum()):
            return sensor

    def spread_of(logs: np.ndarray) -> Spread:
        if sensor is not None:
            return Spread(sensor.floor, sensor.shot, float(np.exp(logs[0])))
        return Spread(float(np.exp(2 * logs[1])), 0.0, float(np.exp(logs[0])))

    typical = np.log(np.average(squares / d**2, weights=counts)) / 2
    brightest = np.log(np.maximum(x.max(), 1.0))
    start = [typical - brightest, typical - 1]
    bounds = [(typical - brightest - 12, 2.0), (typical - 12, typical + 2)]
    count = 2 if sensor is None else 1
    deviance = _deviance(spread_of, *bins)
    return spread_of(scipy.optimize.minimize(deviance, start[:count], bounds=bounds[:count]).x)


def flat_spread(
    residual: OfSamples, signal: OfSamples, slope: OfSamples, *, sensor: Spread | None
) -> Spread:
    """Return the sensor's variance plus the constant of most likely residuals."""
    bins = counts, squares, _, d = _bin_samples(residual, signal, slope)
    own = Spread(0.0, 0.0, None) if sensor is None else sensor

    def with_misfit(log_square: float) -> Spread:
        return Spread(own.floor + float(np.exp(log_square)), own.shot, None)

    typical = np.log(np.average(squares / d**2, weights=counts))
    bounds = (typical - 24, typical + 4)
    deviance = _deviance(with_misfit, *bins)
    return with_misfit(scipy.optimize.minimize_scalar(deviance, bounds=bounds).x)


def _deviance(
    spread_of: Callable[..., Spread], counts: Vector, squares: Vector, x: Vector, d: Vector
) -> Callable[..., float]:
    """Return -2 ln L per binned residual, by the logarithms of the variance's terms."""

    def deviance(logs: np.ndarray) -> float:
        v = variance(spread_of(logs), x, slope=d)
        return float(np.sum(counts * (np.log(v) + squares / v)) / counts.sum())

    return deviance


def _bin_samples(
    residual: OfSamples, signal: OfSamples, slope: OfSamples
) -> tuple[np.ndarray, ...]:
    """Return counts, mean squares, mean signals and rms slopes in bins of equally many samples."""
    order = np.argsort(signal)
    edges = np.unique(np.linspace(0, len(order), min(BINS, len(order)) + 1).astype(int))
    counts = np.diff(edges)
    each = residual**2, signal, slope**2
    squares, x, d = (np.add.reduceat(v[order], edges[:-1]) / counts for v in each)
    return counts, squares, x, np.sqrt(d)


# ---------------------------------------------------------------- optimum


@dataclass(frozen=True)
class Optimum:
    """The most likely parameters of one channel, with the weights of the fit."""

    samples: Samples  # with the deviations of the weights
    spread: Spread  # of the residuals that gave the weights
    # the same without the relative part, if that is a misfit of the model
    weights: Spread
    prediction: Prediction  # of the samples at the optimum
    information: Matrix  # of the unconstrained vector
    converged: bool  # whether the optimum was reached

    @property
    def vector(self) -> Vector:
        return self.prediction.vector


def best(samples: Samples, grouping: Grouping, sensor: Spread | None) -> Optimum:
    """Return the most likely parameters without a start; terms of zero are removed."""
    cells, first = project(average(samples, grouping))
    own = replace(samples, form=cells.form)
    if samples.form.free_gamma:  # the tried encodings are far from each other
        first = minimise_samples(first, [cells]).vector
    found = weighed_and_fitted(first, own, grouping, sensor)
    for _ in range(MOST_ROUNDS if samples.points else 0):
        moved = np.abs(found.vector - first).max()
        if moved < LINEAR or moved > NEARBY:
            break
        first, found = found.vector, weighed_and_fitted(found.vector, own, grouping, sensor)
    return found


def weighed(
    first: Vector, samples: Samples, sensor: Spread | None
) -> tuple[Samples, Spread, Spread, Prediction]:
    """Predict the samples at a parameter vector. Return the samples with standard deviations, the
    variance model of their residuals, the variance model of the weights, and the prediction.
    """
    prediction = predict(first, samples)
    seen = residual_signal_slope(prediction, samples)
    weights = spread = fit_spread(*seen, sensor=sensor)
    if spread.relative is not None:
        weights = flat_spread(*seen, sensor=sensor)
    return weighted(prediction, samples, weights), spread, weights, prediction


def weighed_and_fitted(
    first: Vector, samples: Samples, grouping: Grouping, sensor: Spread | None
) -> Optimum:
    """Return the optimum near a first parameter vector. The weights come from the residuals at this
    vector, and the means over the pixels' areas are linearised about it. If the optimum for cells
    and saturated samples is nearby, the search starts at this optimum and needs only two steps.
    """
    samples, spread, weights, prediction = weighed(first, samples, sensor)
    samples = add_offset(samples, prediction) if samples.points else samples
    cells, saturated = average(samples, grouping, exact_at=prediction), saturated_only(samples)
    near = minimise_samples(first, [cells] if saturated is None else [cells, saturated])
    open_ = not has_lobe(samples.form.model)  # roughness may be undetermined
    nearby = near.converged and (open_ or np.abs(near.vector - first).max() < NEARBY)
    return Optimum(samples, spread, weights, *optimum(near.vector if nearby else first, samples))


def project(samples: Samples) -> tuple[Samples, Vector]:
    """Find the global optimum of the weighted squares of the unsaturated samples, with linearised
    deviations. Return the samples without the terms whose amplitude is zero at the optimum, and the
    optimum.
    """
    form, gammas = samples.form, GAMMAS if samples.form.free_gamma else (samples.gamma,)
    gamma, found = min(
        ((gamma, _project(samples, gamma)) for gamma in gammas), key=lambda tried: tried[1].cost
    )
    diffuse, ambient, specular = np.asarray(found.amplitudes[0])
    if form.model != "lambert" and not has_lobe(form.model):
        diffuse, specular = specular, 0.0
    elif specular == 0:
        form = replace(form, model="lambert")
    form = replace(form, ambient=bool(form.ambient and ambient != 0))
    smallest = SMALLEST_SHARE * max(diffuse, specular)
    vector = [np.log(max(diffuse, smallest))]
    vector += [np.log(specular)] if has_lobe(form.model) else []
    vector += [found.nonlinear] if form.model != "lambert" else []
    vector += [np.log(ambient)] if form.ambient else []
    vector += [] if gamma is None or not form.free_gamma else [np.log(gamma)]
    return replace(samples, form=form), np.array(vector)


def _project(samples: Samples, gamma: float | None) -> SeparableFit:
    """Return amplitudes of diffuse, ambient and lobe, and log shape, for an encoding."""
    form, geometry, white = samples.form, samples.geometry, float(samples.white)
    linear = decoded(samples.dn, float(samples.black), white, gamma)
    weights = (encoding_slope(linear, white, gamma) / samples.deviation) ** 2
    if samples.saturated is not None:
        weights = np.where(samples.saturated, 0, weights)
    light, nothing = np.asarray(geometry.irradiance), np.zeros(linear.size)
    # A rough diffuse surface is a single term: its amplitude is the searched column's.
    matt = form.model == "lambert" or has_lobe(form.model)
    body = light * np.maximum(np.asarray(geometry.wi.z), 0) if matt else nothing
    fixed = np.stack([body, np.ones(linear.size) if form.ambient else nothing])
    bands = linear[:, None], weights[:, None]
    if form.model == "lambert":
        return fit_amplitudes(fixed, *bands)

    def columns(log_shapes: Float[np.ndarray, " knots"]) -> Float[np.ndarray, "knots samples"]:
        repeated = jax.tree.map(lambda x: np.tile(x, len(log_shapes)), geometry)
        unit = lobe_with_slopes(form, np.repeat(log_shapes, linear.size), repeated)[0]
        return light * unit.reshape(len(log_shapes), -1)

    lower, upper = log_range(form.model)
    return fit_separable(columns, fixed, *bands, lower=lower, upper=upper, finer=FINER)


def residual_signal_slope(
    prediction: Prediction, samples: Samples
) -> tuple[OfSamples, OfSamples, OfSamples]:
    """Return measured - predicted (DN), linear signal (DN) and d DN / d X of the unsaturated
    samples, to which a variance model is fitted.
    """
    trusted = slice(None) if samples.saturated is None else ~np.asarray(samples.saturated)
    left = np.asarray(samples.dn - prediction.dn)
    return left[trusted], prediction.signal[trusted], prediction.slope[trusted]


def weighted(prediction: Prediction, samples: Samples, spread: Spread) -> Samples:
    """Return the samples with a variance model's deviations at a predicted signal."""
    deviation = np.sqrt(variance(spread, prediction.signal, slope=prediction.slope))
    return replace(samples, deviation=deviation)


@dataclass(frozen=True)
class Minimum:
    """The point at which a search by Newton's method ended."""

    vector: Vector
    information: Matrix
    converged: bool
    last: Prediction  # for the last part, at the last evaluated point


def minimise_samples(
    start: Vector, parts: Sequence[Samples], *, tolerance: float = TOLERANCE
) -> Minimum:
    """Minimise the cost of all parts together by Newton's method from a start."""
    count = len(start)
    last: list[Prediction] = []

    def derivatives(padded: Vector) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        total, slope, curvature = np.zeros(()), np.zeros(MOST_PARAMETERS), np.eye(MOST_PARAMETERS)
        curvature[:count, :count] = 0
        for samples in parts:
            last[:] = [predict(np.asarray(padded)[:count], samples)]
            cost, gradient, information = cost_and_information(last[0], samples)
            total += cost
            slope[:count] += gradient
            curvature[:count, :count] += information
        return total, slope, curvature

    padded = np.pad(start, (0, MOST_PARAMETERS - count))
    found = minimise_read(derivatives, padded, tolerance=tolerance)
    information = np.asarray(found.information)[:count, :count]
    return Minimum(np.asarray(found.vector)[:count], information, bool(found.converged), last[0])


def optimum(start: Vector, samples: Samples) -> tuple[Prediction, Matrix, bool]:
    """Return the prediction of the samples at the optimum, the information at the optimum, and
    whether the search converged to a shape within the searched range. Newton's method converges
    from a close start. If Newton's method does not converge, because pixels saturate during the
    search, a bounded search is done first.
    """
    found = minimise_samples(start, [samples])
    if not found.converged:
        found = minimise_samples(_box_optimum(start, samples), [samples])
    vector, model, within = found.vector, samples.form.model, True
    if model != "lambert":
        place = names(parameter_space(samples.form)).index(shape_of(model).name)
        within = is_searched(model, float(np.exp(vector[place])))
    there = np.array_equal(found.last.vector, vector)
    prediction = found.last if there else predict(vector, samples)
    return prediction, found.information, found.converged and within


def _box_optimum(start: Vector, samples: Samples) -> Vector:
    """Return the point of least cost within `REACH` of a start, by L-BFGS-B."""

    def scaled_cost(away: Vector) -> tuple[float, Vector]:
        cost, gradient, _ = cost_and_information(predict(start + away, samples), samples)
        return cost / samples.dn.size, gradient / samples.dn.size

    found = scipy.optimize.minimize(
        scaled_cost,
        np.zeros(len(start)),
        jac=True,
        method="L-BFGS-B",
        bounds=[(-REACH, REACH)] * len(start),
        options={"maxiter": MOST_STEPS, "gtol": 1e-6, "ftol": 0.0},
    )
    return start + found.x
