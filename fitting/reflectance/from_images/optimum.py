"""The best parameters of one channel: variable projection, weighted squares, maximum likelihood.

Variable projection finds the global optimum of unweighted least squares, without start values. Its
residuals give the spread and the weights of the final fit, which is one step of feasible
generalised least squares. If the misfit of the model exceeds the sensor's noise, the weights treat
it as a constant (`spread`), because a wrong model must not reduce the weight of the highlights that
it misses. Saturated pixels enter the likelihood as "at least this bright". Dropping them, or using
their numbers, would bias the highlight.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np
import scipy.optimize
from jaxtyping import Float

from ...inference.newton import minimise_read
from ...inference.parameters import names
from ...inference.separable import SeparableFit, fit_amplitudes, fit_separable
from ..models import has_lobe, is_searched, log_range, shape_of
from .derivatives import Prediction, Vector, cost_and_information, predict
from .geometry_cells import Grouping, average, saturated_only
from .model import Samples, parameter_space
from .signal import decoded, encoding_slope, lobe_with_slopes
from .spread import Spread, fit_spread, flat_spread, variance

GAMMAS = (1.0, 1.4, 1.8, 2.2, 2.6)  # tried as starts where gamma is free
NEARBY = 2.0  # of log parameters: weights move an optimum less, unless the data leave it open
REACH = 1.0  # half width of the bounded search, in log parameters
TOLERANCE = 1e-7  # fall in cost that a further step may promise
MOST_STEPS = 300  # of the bounded search
MOST_PARAMETERS = 5  # of any form: searches of all forms are one program
FINER = 9  # shapes of each finer grid of the search
SMALLEST_SHARE = 1e-9  # of the brightest reflection: an amplitude below is absent


@dataclass(frozen=True)
class Optimum:
    """The most likely parameters."""

    samples: Samples  # with the deviations of the weights
    spread: Spread  # of the residuals that gave the weights
    # the same without the part that grows with the signal, where the model misses it
    weights: Spread
    prediction: Prediction  # of the samples at the optimum
    information: Float[np.ndarray, "parameters parameters"]  # of the unconstrained vector
    converged: bool  # whether it was reached

    @property
    def vector(self) -> Vector:
        return self.prediction.vector


def best(samples: Samples, grouping: Grouping, sensor: Spread | None) -> Optimum:
    """Return the most likely parameters, found without a start. The form then lacks the terms of
    amplitude zero."""
    cells, first = project(average(samples, grouping))
    own = replace(samples, form=cells.form)
    if samples.form.free_gamma:  # the encodings that were tried lie apart
        first = minimise_samples(first, [cells]).vector
    return weighed_and_fitted(first, own, grouping, sensor)


def weighed(
    first: Vector, samples: Samples, sensor: Spread | None
) -> tuple[Samples, Spread, Spread, Prediction]:
    """Return the samples with their deviations, the spread of a vector's residuals, the spread of
    the weights, and the samples as predicted at the vector."""
    prediction = predict(first, samples)
    seen = residual_signal_slope(prediction, samples)
    weights = spread = fit_spread(*seen, sensor=sensor)
    if spread.relative is not None:
        weights = flat_spread(*seen, sensor=sensor)
    return weighted(prediction, samples, weights), spread, weights, prediction


def weighed_and_fitted(
    first: Vector, samples: Samples, grouping: Grouping, sensor: Spread | None
) -> Optimum:
    """Return the optimum near a first vector, whose residuals give the weights. The optimum of
    cells and saturated samples, if it is nearby, saves all but the last two steps of the search."""
    samples, spread, weights, prediction = weighed(first, samples, sensor)
    cells, saturated = average(samples, grouping, exact_at=prediction), saturated_only(samples)
    near = minimise_samples(first, [cells] if saturated is None else [cells, saturated])
    nearby = near.converged and np.abs(near.vector - first).max() < NEARBY
    return Optimum(samples, spread, weights, *optimum(near.vector if nearby else first, samples))


def project(samples: Samples) -> tuple[Samples, Vector]:
    """Return the global optimum of the weighted squares of the unsaturated samples, with linearised
    deviations, and the samples in the form of that vector, which lacks every term of amplitude
    zero."""
    if not samples.form.free_gamma:
        return _present_terms(samples, _projected(samples, samples.gamma), None)
    tried = [(gamma, _projected(samples, gamma)) for gamma in GAMMAS]
    gamma, found = min(tried, key=lambda attempt: attempt[1].cost)
    return _present_terms(samples, found, gamma)


def _projected(samples: Samples, gamma: float | None) -> SeparableFit:
    """Amplitudes of [diffuse, ambient, lobe] and the log shape for a given encoding."""
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


def _present_terms(
    samples: Samples, found: SeparableFit, gamma: float | None
) -> tuple[Samples, Vector]:
    diffuse, ambient, specular = np.asarray(found.amplitudes[0])
    rough = samples.form.model != "lambert" and not has_lobe(samples.form.model)
    if rough:
        diffuse, specular = specular, 0.0
    elif specular == 0 and samples.form.model != "lambert":
        samples = replace(samples, form=replace(samples.form, model="lambert"))
    if ambient == 0 and samples.form.ambient:
        samples = replace(samples, form=replace(samples.form, ambient=False))
    form = samples.form
    smallest = SMALLEST_SHARE * max(diffuse, specular)
    vector = [np.log(max(diffuse, smallest))]
    vector += [np.log(specular)] if has_lobe(form.model) else []
    vector += [found.nonlinear] if form.model != "lambert" else []
    vector += [np.log(ambient)] if form.ambient else []
    vector += [np.log(gamma)] if gamma is not None else []
    return samples, np.array(vector)


def residual_signal_slope(
    prediction: Prediction, samples: Samples
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return measured - predicted (DN), linear signal (DN) and d DN / d X of the unsaturated
    samples, from which a spread is fitted."""
    trusted = slice(None) if samples.saturated is None else ~np.asarray(samples.saturated)
    each = samples.dn - prediction.dn, prediction.signal, prediction.slope
    residual, signal, slope = (np.asarray(x)[trusted] for x in each)
    return residual, signal, slope


def weighted(prediction: Prediction, samples: Samples, spread: Spread) -> Samples:
    """Return the samples with the deviations of a spread at a predicted signal."""
    deviation = np.sqrt(variance(spread, prediction.signal, slope=prediction.slope))
    return replace(samples, deviation=deviation)


@dataclass(frozen=True)
class Minimum:
    """Where a search by Newton's method ended."""

    vector: Vector
    information: Float[np.ndarray, "parameters parameters"]
    converged: bool
    last: Prediction  # of the last of the parts, where the search looked last


def minimise_samples(
    start: Vector, parts: Sequence[Samples], *, tolerance: float = TOLERANCE
) -> Minimum:
    """Return the optimum of all parts together that Newton's method finds from a start."""
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

    found = minimise_read(
        derivatives, np.pad(start, (0, MOST_PARAMETERS - count)), tolerance=tolerance
    )
    return Minimum(
        np.asarray(found.vector)[:count],
        np.asarray(found.information)[:count, :count],
        bool(found.converged),
        last[0],
    )


def optimum(start: Vector, samples: Samples) -> tuple[Prediction, np.ndarray, bool]:
    """Return the samples as predicted at the optimum, its information, and whether the search
    converged within the searched shapes. Newton's method starts next to it; if saturated pixels are
    in between, a bounded search comes first."""
    found = minimise_samples(start, [samples])
    if not found.converged:
        found = minimise_samples(_in_box(start, samples), [samples])
    vector, form = found.vector, samples.form
    natural = dict(zip(names(parameter_space(form)), np.exp(vector), strict=True))
    within = form.model == "lambert" or is_searched(
        form.model, float(natural[shape_of(form.model).name])
    )
    there = np.array_equal(found.last.vector, vector)
    prediction = found.last if there else predict(vector, samples)
    return prediction, found.information, found.converged and within


def _in_box(start: Vector, samples: Samples) -> Vector:
    """The least cost within `REACH` of a start, by L-BFGS-B."""

    def scaled(away: Vector) -> tuple[float, Vector]:
        cost, gradient, _ = cost_and_information(predict(start + away, samples), samples)
        return cost / samples.dn.size, gradient / samples.dn.size

    found = scipy.optimize.minimize(
        scaled,
        np.zeros(len(start)),
        jac=True,
        method="L-BFGS-B",
        bounds=[(-REACH, REACH)] * len(start),
        options={"maxiter": MOST_STEPS, "gtol": 1e-6, "ftol": 0.0},
    )
    return start + found.x
