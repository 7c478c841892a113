"""One channel, one model: variable projection, weighted least squares, maximum likelihood.

Variable projection finds the global optimum of the plain squares without a start. Its residuals
give the spread, and with it the weights, of the fit proper: one step of feasible generalised least
squares. Where the model misses more than the sensor's noise, the weights take that for a constant
(`spread`): a wrong model must not discount the very highlights that it misses. Where
pixels are saturated, the likelihood counts them as "at least this bright"; leaving them out, or
trusting them, would bias the highlight.
"""

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.special import chdtri

from ...inference.bounded import minimise_in_box
from ...inference.clustering import Robustness, cluster_robust
from ...inference.compiled import compiled_briefly
from ...inference.diagnostics import Identifiability, identifiability
from ...inference.least_squares import minimise_residuals
from ...inference.neighbours import regions
from ...inference.newton import minimise
from ...inference.parameters import ParameterSpace, names, to_natural
from ...inference.separable import SeparableFit, fit_amplitudes, fit_separable
from ..models import has_lobe, is_searched, log_range, shape_of
from .derivatives import scores_and_slopes, with_information
from .geometry_cells import Grouping, average, saturated_only
from .model import (
    Form,
    Samples,
    decoded,
    encoding_gamma,
    encoding_slope,
    linear_signal,
    lobe,
    negative_log_likelihood,
    parameter_space,
    predicted_dn,
    residuals,
    total_log_likelihood,
)
from .read import ReflectanceObservation
from .samples import Gathered, Selection, make_samples, of_some_pixels
from .spread import (
    Spread,
    chi_square_per_dof,
    fit_spread,
    flat_spread,
    sensor_spread,
    variance,
)
from .stated import StatedErrors, stated_errors, with_stated_errors
from .turns import likeliest_turns, shifts_of_turns, turned

GAMMAS = (1.0, 1.4, 1.8, 2.2, 2.6)  # tried as starts where gamma is free
REACH = 1.0  # half width of the bounded search, in log parameters
LONG = 300_000  # samples from which more programs, and optimised ones, save time
MOST_TURNS = 10  # of the lights
SETTLED = 0.05  # standard deviations of a light's direction
IMPLAUSIBLE = 1e-3  # chance that lights as good as stated are turned by as much
ABSURD = 4.0  # standard deviations, rms over lights, of the first step, which comes from afar
ENOUGH = 20_000  # samples that put lights nearly where all samples do
SMALLEST_SHARE = 1e-9  # of the brightest reflection: an amplitude below is absent


@dataclass(frozen=True)
class ChannelFit:
    """A fitted channel. Its form lacks the terms whose best amplitude is zero.

    Attributes:
        channel: name.
        requested: the form asked for.
        samples: with the form and the deviations of the fit.
        selection: of the samples.
        regions: (lights,) of lights that err alike; each its own where neighbours do not.
        space: the P parameters.
        vector: (P,) unconstrained.
        information: (P, P) on that scale, as if all samples were independent.
        robustness: covariance that does not assume so; None where the data leave a direction open.
        identifiability: of the information.
        stated: what the rig calls uncertain.
        turns: (lights, 2) of the lights, in units of `direction_sd`; None where the rig has them.
        spread: of the residuals of plain squares.
        chi_square: per degree of freedom, with the weights of the fit.
        sensor_chi_square: with the sensor's noise alone; None if unknown.
        log_likelihood: with the spread of the final residuals.
        converged: whether the optimum was reached.
    """

    channel: str
    requested: Form
    samples: Samples
    selection: Selection
    regions: Int[np.ndarray, " lights"]
    space: ParameterSpace
    vector: Float[np.ndarray, " parameters"]
    information: Float[np.ndarray, "parameters parameters"]
    robustness: Robustness | None
    stated: StatedErrors
    turns: Float[np.ndarray, "lights 2"] | None
    identifiability: Identifiability
    spread: Spread
    chi_square: float
    sensor_chi_square: float | None
    log_likelihood: float
    converged: bool

    @property
    def form(self) -> Form:
        return self.samples.form

    @property
    def natural(self) -> Float[np.ndarray, " parameters"]:
        """Parameters in their own units."""
        return np.asarray(to_natural(self.space, jnp.asarray(self.vector)))

    @property
    def design_effect(self) -> float:
        return 1.0 if self.robustness is None else self.robustness.design_effect


def fit_channel(gathered: Gathered, channel: int, form: Form, grouping: Grouping) -> ChannelFit:
    """Best fit of one channel, with everything needed to judge it.

    Args:
        gathered: the samples that all fits share.
        channel: index.
        form: terms of the fit.
        grouping: cells of the samples, on which all but the last digits are found.

    Returns:
        The fit.
    """
    observation, selection = gathered.observation, gathered.selection
    samples = gathered.samples(channel, form)
    sensor = None
    if observation.gain is not None and observation.read_noise is not None:
        sensor = sensor_spread(observation.gain, observation.read_noise)
    cells, first = project(average(samples, grouping))
    geometry = None if cells.geometry is None else samples.geometry
    samples = replace(samples, form=cells.form, geometry=geometry)
    if form.free_gamma:  # the encodings that were tried lie apart
        first = minimise_residuals(residuals, first, cells).vector
    found, turns = _weighed_and_fitted(first, samples, grouping, sensor), None
    if np.any(observation.uncertain.get("direction_sd", 0) * ~observation.held_out):
        found, turns = _among_turns(found, gathered, channel, grouping, sensor)
    samples, vector = found.samples, found.vector

    space = parameter_space(samples.form)
    information = np.asarray(found.information, np.float64)
    judged = identifiability(space, information)
    robustness = None
    stated = stated_errors(observation, channel, vector, samples, selection, turns)
    alike = _lights_alike(observation, vector, samples, selection)
    if judged.determined:
        robustness = robust_covariance(
            vector, samples, selection, information, np.arange(len(space)), stated, alike
        )
    residual, signal, slope = _residual_signal_slope(vector, samples)
    likeliest = _weighted(vector, samples, fit_spread(residual, signal, slope, sensor=sensor))
    dof = len(residual) - len(space)
    return ChannelFit(
        channel=observation.channels[channel],
        requested=form,
        samples=samples,
        selection=selection,
        regions=alike,
        space=space,
        vector=np.asarray(vector, np.float64),
        information=information,
        robustness=robustness,
        stated=stated,
        turns=turns,
        identifiability=judged,
        spread=found.spread,
        chi_square=chi_square_per_dof(residual, signal, slope, found.weights, dof),
        sensor_chi_square=None
        if sensor is None
        else chi_square_per_dof(residual, signal, slope, sensor, dof),
        log_likelihood=-float(_cost(vector, likeliest)),
        converged=found.converged,
    )


@dataclass(frozen=True)
class _Found:
    samples: Samples
    spread: Spread
    weights: Spread
    vector: Array
    information: Array
    converged: bool


def _weighed(
    first: Array, samples: Samples, sensor: Spread | None
) -> tuple[Samples, Spread, Spread]:
    """The samples with weights of a vector's residuals; their spread, and that of the weights."""
    seen = _residual_signal_slope(first, samples)
    weights = spread = fit_spread(*seen, sensor=sensor)
    if spread.relative is not None:
        weights = flat_spread(*seen, sensor=sensor)
    return _weighted(first, samples, weights), spread, weights


def _weighed_and_fitted(
    first: Array, samples: Samples, grouping: Grouping, sensor: Spread | None
) -> _Found:
    """The optimum near a first one, whose residuals give the weights."""
    samples, spread, weights = _weighed(first, samples, sensor)
    near = _nearer(first, samples, grouping)
    return _Found(samples, spread, weights, *optimum(near, samples))


def _among_turns(
    nominal: _Found, gathered: Gathered, channel: int, grouping: Grouping, sensor: Spread | None
) -> tuple[_Found, np.ndarray | None]:
    """Parameters and turns of the lights, one at the other's best, until no light moves; of many
    samples a part until then, and all of them twice. None where lights would have to be turned by
    far more than the rig says: then it is the model that misses."""
    whole = gathered.observation, gathered.selection
    known = (whole[0].uncertain["direction_sd"] > 0) & ~whole[0].held_out
    found, turns = nominal, np.zeros((len(known), 2))
    seen = 2 * np.count_nonzero(known)
    most = np.sqrt(chdtri(seen, IMPLAUSIBLE) / seen)
    step = max(1, len(whole[1].light) // ENOUGH)
    stages = [(*whole, MOST_TURNS)]
    if step > 1:
        stages = [(*of_some_pixels(*whole, step), MOST_TURNS), (*whole, 2)]
    for observation, selection, rounds in stages:
        if step > 1:
            samples = _about(observation, selection, channel, found, turns)
            found = replace(found, samples=_weighed(found.vector, samples, sensor)[0])
        for number in range(rounds):
            vector, samples = found.vector, found.samples
            shifts = shifts_of_turns(observation, turns, channel, vector, samples, selection)
            before = turns
            turns = likeliest_turns(shifts, before, vector, samples, selection)
            if _rms(turns[known]) > (ABSURD if number == 0 and rounds > 2 else most):
                return nominal, None
            samples = _about(observation, selection, channel, found, turns)
            found = _weighed_and_fitted(vector, samples, grouping, sensor)
            if np.abs(turns - before).max() < SETTLED:
                break
    return found, turns


def _about(
    observation: ReflectanceObservation,
    selection: Selection,
    channel: int,
    found: _Found,
    turns: np.ndarray,
) -> Samples:
    lights = turned(observation, turns * observation.uncertain["direction_sd"][:, None])
    return make_samples(lights, channel, found.samples.form, selection)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def robust_covariance(
    vector: Float[Array, " parameters"],
    samples: Samples,
    selection: Selection,
    information: Float[np.ndarray, "parameters parameters"],
    known: Int[np.ndarray, " known"],
    stated: StatedErrors,
    alike: Int[np.ndarray, " lights"],
) -> Robustness:
    """Covariance of some parameters, the others held at their best values.

    Args:
        vector: (parameters,) of the fit, unconstrained.
        samples: of the fit.
        selection: of the samples.
        information: (parameters, parameters), as if all samples were independent.
        known: (known,) indices of the parameters.
        stated: what the rig calls uncertain, of the same fit.
        alike: (lights,) regions of lights that err alike.

    Returns:
        What lights and pixels share, and what the rig states, allowed for.
    """
    gradients, slopes = (
        np.asarray(x, np.float64)[known] for x in scores_and_slopes(vector, samples)
    )
    among = information[np.ix_(known, known)]
    found = cluster_robust(gradients, among, alike[selection.light], selection.pixel, slopes=slopes)
    return with_stated_errors(found, stated, among, known)


def _lights_alike(
    observation: ReflectanceObservation,
    vector: Float[Array, " parameters"],
    samples: Samples,
    selection: Selection,
) -> Int[np.ndarray, " lights"]:
    """Regions of lights whose images a fit misses alike."""
    gradients = np.asarray(scores_and_slopes(vector, samples)[0], np.float64)
    return regions(gradients, selection.light, observation.wi.mean(axis=1))


def predicted_image(
    observation: ReflectanceObservation, fit: ChannelFit, light: int
) -> Float[np.ndarray, " pixels"]:
    """Digital numbers that a fit predicts under one light, without noise and not above the clip
    level.

    Args:
        observation: of the object.
        fit: of one channel.
        light: index.

    Returns:
        (pixels,) DN of all pixels of the object.
    """
    pixels = np.arange(observation.cosine.shape[1])
    selection = Selection(np.full_like(pixels, light), pixels)
    channel = observation.channels.index(fit.channel)
    samples = make_samples(observation, channel, fit.form, selection)
    predicted = predicted_dn(jnp.asarray(fit.vector), samples)
    return np.minimum(np.asarray(predicted, np.float64), observation.clip)


def project(samples: Samples) -> tuple[Samples, Float[Array, " parameters"]]:
    """The global optimum of the weighted squares of the unsaturated samples, for linearised
    deviations.

    Args:
        samples: of one channel; saturated ones are left out.

    Returns:
        The samples, with a form that has lost every term of amplitude zero, and the vector of that
        form, (parameters,).
    """
    if not samples.form.free_gamma:
        return _present_terms(samples, _projected(samples, samples.gamma), None)
    tried = [(gamma, _projected(samples, jnp.asarray(gamma, float))) for gamma in GAMMAS]
    gamma, found = min(tried, key=lambda attempt: attempt[1].cost)
    return _present_terms(samples, found, gamma)


def _projected(samples: Samples, gamma: Array | None) -> SeparableFit:
    """Amplitudes of [diffuse, ambient, lobe] and the log shape at a given encoding."""
    model = samples.form.model
    fixed, linear, weights = _linearised(samples, gamma)
    if model == "lambert":
        return fit_amplitudes(fixed, linear, weights)
    lower, upper = log_range(model)
    columns = partial(_lobe_columns, samples)
    return fit_separable(columns, fixed, linear, weights, lower=lower, upper=upper)


@compiled_briefly
def _linearised(samples: Samples, gamma: Array | None) -> tuple[Array, Array, Array]:
    """Fixed columns, decoded values and weights, the latter two as one band."""
    form = samples.form
    linear = decoded(samples.dn, samples.black, samples.white, gamma)
    slope = encoding_slope(linear, samples.white, gamma)
    weights = (slope / samples.deviation) ** 2
    if samples.saturated is not None:
        weights = jnp.where(samples.saturated, 0, weights)
    constant = jnp.ones_like(linear) if form.ambient else jnp.zeros_like(linear)
    # A rough diffuse surface is a single term: its amplitude is the searched column's.
    body = samples.cosine if form.model == "lambert" or has_lobe(form.model) else 0 * constant
    return jnp.stack([samples.irradiance * body, constant]), linear[:, None], weights[:, None]


@compiled_briefly
def _lobe_columns(samples: Samples, log_shapes: Array) -> Array:
    geometry = samples.geometry
    assert geometry is not None, "a model with a lobe has its angles"

    def column(log_shape: Array) -> Array:
        unit = lobe(samples.form, geometry, jnp.exp(log_shape))
        return jnp.where(samples.cosine > 0, samples.irradiance * unit, 0)

    return jax.lax.map(column, log_shapes)


def _present_terms(
    samples: Samples, found: SeparableFit, gamma: float | None
) -> tuple[Samples, Array]:
    diffuse, ambient, specular = np.asarray(found.amplitudes[0])
    rough = samples.form.model != "lambert" and not has_lobe(samples.form.model)
    if rough:
        diffuse, specular = specular, 0.0
    elif specular == 0 and samples.form.model != "lambert":
        samples = replace(samples, form=replace(samples.form, model="lambert"), geometry=None)
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


def _residual_signal_slope(
    vector: Array, samples: Samples
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Measured - predicted (DN), linear signal and d DN / d X of the unsaturated samples."""
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


_cost = compiled_briefly(negative_log_likelihood)


def _weighted(vector: Array, samples: Samples, spread: Spread) -> Samples:
    """The samples with the deviations of a spread."""
    signal, slope, _ = _predicted(vector, samples)
    deviation = np.sqrt(variance(spread, np.asarray(signal), slope=np.asarray(slope)))
    return replace(samples, deviation=jnp.asarray(deviation, samples.dn.dtype))


def _nearer(vector: Array, samples: Samples, grouping: Grouping) -> Array:
    """Of many samples, the optimum of cells that predict what their pixels do, and of saturated
    samples: all but the last two steps of the search, in a fraction of its time."""
    if samples.dn.size < LONG:
        return vector
    cells = average(samples, grouping, exact_at=vector)
    return minimise(_cost_of_cells, vector, (cells, saturated_only(samples))).vector


def _cost_of_cells(vector: Array, data: tuple[Samples, Samples | None]) -> Array:
    return -total_log_likelihood(vector, *data)


def optimum(vector: Float[Array, " parameters"], samples: Samples) -> tuple[Array, Array, bool]:
    """The optimum on all samples, by Newton's method from next to it; where saturated pixels lie in
    between, by a bounded search first.

    Args:
        vector: (parameters,) to begin with, unconstrained.
        samples: of one channel.

    Returns:
        The vector there, (parameters,), the information, (parameters, parameters), and whether
        an optimum was reached, its shape within the range that is searched.
    """
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
