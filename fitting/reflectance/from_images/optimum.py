"""The best parameters of one channel: variable projection, weighted squares, maximum likelihood.

Variable projection finds the global optimum of unweighted least squares, without start values. Its
residuals give the spread and the weights of the final fit, which is one step of feasible
generalised least squares. If the misfit of the model exceeds the sensor's noise, the weights treat
it as a constant (`spread`), because a wrong model must not reduce the weight of the highlights that
it misses. Saturated pixels enter the likelihood as "at least this bright". Dropping them, or using
their numbers, would bias the highlight.
"""

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...inference.bounded import minimise_in_box
from ...inference.compiled import compiled_briefly
from ...inference.least_squares import minimise_residuals
from ...inference.newton import minimise
from ...inference.parameters import names, to_natural
from ...inference.separable import SeparableFit, fit_amplitudes, fit_separable
from ..models import has_lobe, is_searched, log_range, shape_of
from .derivatives import with_information
from .geometry_cells import Grouping, average, saturated_only
from .model import (
    Samples,
    encoding_gamma,
    linear_signal,
    negative_log_likelihood,
    parameter_space,
    predicted_dn,
    residuals,
    total_log_likelihood,
)
from .signal import decoded, encoding_slope, unit_lobe
from .spread import Spread, fit_spread, flat_spread, variance

GAMMAS = (1.0, 1.4, 1.8, 2.2, 2.6)  # tried as starts where gamma is free
REACH = 1.0  # half width of the bounded search, in log parameters
LONG = 300_000  # samples from which more programs, and optimised ones, save time
SMALLEST_SHARE = 1e-9  # of the brightest reflection: an amplitude below is absent


@dataclass(frozen=True)
class Optimum:
    """The most likely parameters."""

    samples: Samples  # with the deviations of the weights
    spread: Spread  # of the residuals that gave the weights
    # the same without the part that grows with the signal, where the model misses it
    weights: Spread
    vector: Array  # (P,) unconstrained
    information: Array  # (P, P) on that scale
    converged: bool  # whether it was reached


def best(samples: Samples, grouping: Grouping, sensor: Spread | None) -> Optimum:
    """Return the most likely parameters, found without a start. The form then lacks the terms of
    amplitude zero."""
    cells, first = project(average(samples, grouping))
    own = replace(samples, form=cells.form)
    if samples.form.free_gamma:  # the encodings that were tried lie apart
        first = minimise_residuals(residuals, first, cells).vector
    return weighed_and_fitted(first, own, grouping, sensor)


def weighed(
    first: Array, samples: Samples, sensor: Spread | None
) -> tuple[Samples, Spread, Spread]:
    """Return the samples with their deviations, the spread of a vector's residuals, and the spread
    of the weights."""
    seen = residual_signal_slope(first, samples)
    weights = spread = fit_spread(*seen, sensor=sensor)
    if spread.relative is not None:
        weights = flat_spread(*seen, sensor=sensor)
    return weighted(first, samples, weights), spread, weights


def weighed_and_fitted(
    first: Array, samples: Samples, grouping: Grouping, sensor: Spread | None
) -> Optimum:
    """Return the optimum near a first vector, whose residuals give the weights."""
    samples, spread, weights = weighed(first, samples, sensor)
    near = _nearer(first, samples, grouping)
    return Optimum(samples, spread, weights, *optimum(near, samples))


def project(samples: Samples) -> tuple[Samples, Float[Array, " parameters"]]:
    """Return the global optimum of the weighted squares of the unsaturated samples, with linearised
    deviations, and the samples in the form of that vector, which lacks every term of amplitude
    zero."""
    if not samples.form.free_gamma:
        return _present_terms(samples, _projected(samples, samples.gamma), None)
    tried = [(gamma, _projected(samples, jnp.asarray(gamma, float))) for gamma in GAMMAS]
    gamma, found = min(tried, key=lambda attempt: attempt[1].cost)
    return _present_terms(samples, found, gamma)


def _projected(samples: Samples, gamma: Array | None) -> SeparableFit:
    """Amplitudes of [diffuse, ambient, lobe] and the log shape for a given encoding."""
    model = samples.form.model
    fixed, linear, weights = _linearised(samples, gamma)
    if model == "lambert":
        return fit_amplitudes(fixed, linear, weights)
    lower, upper = log_range(model)
    columns = partial(_lobe_columns, samples)
    return fit_separable(columns, fixed, linear, weights, lower=lower, upper=upper)


@compiled_briefly
def _linearised(samples: Samples, gamma: Array | None) -> tuple[Array, Array, Array]:
    """The fixed columns, and the decoded values and weights as one band each."""
    form = samples.form
    linear = decoded(samples.dn, samples.black, samples.white, gamma)
    slope = encoding_slope(linear, samples.white, gamma)
    weights = (slope / samples.deviation) ** 2
    if samples.saturated is not None:
        weights = jnp.where(samples.saturated, 0, weights)
    constant = jnp.ones_like(linear) if form.ambient else jnp.zeros_like(linear)
    # A rough diffuse surface is a single term: its amplitude is the searched column's.
    geometry = samples.geometry
    cosine = jnp.maximum(geometry.wi.z, 0)
    body = cosine if form.model == "lambert" or has_lobe(form.model) else 0 * constant
    return jnp.stack([geometry.irradiance * body, constant]), linear[:, None], weights[:, None]


@compiled_briefly
def _lobe_columns(samples: Samples, log_shapes: Array) -> Array:
    def column(log_shape: Array) -> Array:
        unit = unit_lobe(samples.form, jnp.exp(log_shape), samples.geometry)
        return samples.geometry.irradiance * unit

    return jax.lax.map(column, log_shapes)


def _present_terms(
    samples: Samples, found: SeparableFit, gamma: float | None
) -> tuple[Samples, Array]:
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
    return samples, jnp.asarray(vector, samples.dn.dtype)


def residual_signal_slope(
    vector: Array, samples: Samples
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return measured - predicted (DN), linear signal (DN) and d DN / d X of the unsaturated
    samples, from which a spread is fitted."""
    trusted = slice(None) if samples.saturated is None else ~np.asarray(samples.saturated)
    signal, slope, predicted = _predicted(vector, samples)
    left = samples.dn - predicted
    residual, signal, slope = (np.asarray(x, np.float64)[trusted] for x in (left, signal, slope))
    return residual, signal, slope


@compiled_briefly
def _predicted(vector: Array, samples: Samples) -> tuple[Array, Array, Array]:
    """Linear signal, d DN / d X and DN of all samples."""
    signal = linear_signal(vector, samples)
    slope = encoding_slope(signal, samples.white, encoding_gamma(vector, samples))
    return signal, slope, predicted_dn(vector, samples)


def weighted(vector: Array, samples: Samples, spread: Spread) -> Samples:
    """Return the samples with the deviations of a spread at a vector's signal."""
    signal, slope, _ = _predicted(vector, samples)
    deviation = np.sqrt(variance(spread, np.asarray(signal), slope=np.asarray(slope)))
    return replace(samples, deviation=jnp.asarray(deviation, samples.dn.dtype))


def _nearer(vector: Array, samples: Samples, grouping: Grouping) -> Array:
    """For many samples, return the optimum of cells and saturated samples, which saves all but the
    last two steps of the search."""
    if samples.dn.size < LONG:
        return vector
    cells = average(samples, grouping, exact_at=vector)
    return minimise(_cost_of_cells, vector, (cells, saturated_only(samples))).vector


def _cost_of_cells(vector: Array, data: tuple[Samples, Samples | None]) -> Array:
    return -total_log_likelihood(vector, data)


def optimum(vector: Float[Array, " parameters"], samples: Samples) -> tuple[Array, Array, bool]:
    """Return the optimum on all samples, its information, and whether the search converged within
    the searched shapes. Newton's method starts next to it; if saturated pixels are in between, a
    bounded search comes first."""
    objective = negative_log_likelihood
    search = partial(minimise, derivatives=with_information, long=samples.dn.size >= LONG)
    found = search(objective, vector, samples)
    if not found.converged:
        box = minimise_in_box(
            objective,
            vector,
            vector - REACH,
            vector + REACH,
            samples,
            scale=float(samples.dn.size),
        )
        found = search(objective, box.vector, samples)
    form, known = samples.form, parameter_space(samples.form)
    natural = dict(zip(names(known), np.asarray(to_natural(known, found.vector)), strict=True))
    within = form.model == "lambert" or is_searched(
        form.model, float(natural[shape_of(form.model).name])
    )
    return found.vector, found.information, bool(found.converged) and within
