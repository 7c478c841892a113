"""Fit one model to one channel: the best parameters (`optimum`), the data to assess them, and their
posterior.

Pixels of one image share errors, so the product of their densities is a composite likelihood. The
mode of this product is a consistent estimate, but its curvature overstates the information. For
chains, the deviation of the parameters from the mode is therefore multiplied by a matrix, so that
the curvature becomes the inverse of the covariance over images (Ribatet, Cooley & Davison,
"Bayesian Inference from Composite Likelihoods", Statistica Sinica 22, 2012). The priors of surface
parameters are flat in the logarithms.

A step of the chain evaluates cells of similar pixels instead of single pixels. At the mode, cells
and pixels predict the same mean of each cell. However, derivatives vary inside a cell, so the
gradients of the two densities differ. The gradient of the cells' density at the mode is therefore
subtracted, so that this density has the same mode as the density of all pixels.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int

from ...inference.clustering import Robustness, cluster_robust, curvature_stretch
from ...inference.diagnostics import Identifiability, identifiability
from ...inference.emcee_run import Emcee, group_options
from ...inference.importance import laplace_where_it_holds
from ...inference.neighbours import regions
from ...inference.parameters import ParameterSpace, natural_numbers
from ...inference.posterior import Posterior, sample
from ...inference.precision import double_precision
from .lights import (
    StatedErrors,
    TurnedLights,
    add_stated_errors,
    fit_rotations,
    information_on_turns,
    shift_lights,
    shifts_of_turns,
    stated_errors,
    turn_sizes,
    widen_directions,
)
from .optimum import (
    Spread,
    best,
    fit_spread,
    residual_signal_slope,
    sensor_spread,
    variance,
    weighted,
)
from .read import Photographs
from .samples import (
    Grouping,
    Samples,
    Selection,
    View,
    average,
    cost_and_information,
    image_view,
    log_likelihood_of_dn,
    predict,
    saturated_only,
    scores_and_slopes,
    total_log_likelihood,
)
from .signal import Form, Matrix, OfSamples, Vector, parameter_space


@dataclass(frozen=True)
class ChannelFit:
    """The fit of one model to one channel, without the terms whose best amplitude is zero."""

    view: View
    requested: Form  # the requested form
    samples: Samples  # with the form and the deviations of the fit
    space: ParameterSpace
    vector: Vector  # unconstrained
    information: Matrix  # on that scale, as if all samples were independent
    stated: StatedErrors  # errors that the rig states
    # light directions estimated from the images; None if all directions are exact
    turned: TurnedLights | None
    identifiability: Identifiability  # with light directions marginalised
    spread: Spread  # spread of the residuals of unweighted least squares
    chi_square: float  # per degree of freedom, with the weights of the fit
    sensor_chi_square: float | None  # with the sensor's noise alone; None if unknown
    log_likelihood: float  # with the final residuals' spread and the fitted lights
    by_light: Float[np.ndarray, "lights 2"]  # `squared_errors` of the samples
    # (lights, errors) rotations and logarithms of intensities, and the information of the images on
    # them, in units of their uncertainty; None if all directions are exact
    turns_and_information: tuple[np.ndarray, np.ndarray] | None
    converged: bool  # whether the optimum was reached

    @property
    def channel(self) -> str:
        return self.view.observation.channels[self.view.channel]

    @property
    def selection(self) -> Selection:
        return self.view.selection

    @property
    def form(self) -> Form:
        return self.samples.form

    @property
    def natural(self) -> Vector:
        """Return the parameters in their own units."""
        return natural_numbers(self.space, self.vector)

    @cached_property
    def _scores_and_slopes(self) -> tuple[np.ndarray, np.ndarray]:
        scores, slopes = scores_and_slopes(predict(self.vector, self.samples), self.samples)
        return scores if self.stated.scores is None else self.stated.scores, slopes

    @cached_property
    def regions(self) -> Int[np.ndarray, " lights"]:
        """Return the index of the group to which each light belongs. Neighbouring lights with
        correlated errors form a group. Each of the other lights is a group of its own.
        """
        places = self.view.observation.wi.mean(axis=1)
        return regions(self._scores_and_slopes[0], self.selection.light, places)

    @cached_property
    def robustness(self) -> Robustness | None:
        """Return a covariance that does not assume independent samples; None if the data do not
        determine all parameters. The covariance is computed on demand, because most compared models
        do not need it.
        """
        every = np.arange(len(self.space))
        return robust_covariance(self, every) if self.identifiability.determined else None

    @property
    def design_effect(self) -> float:
        return 1.0 if self.robustness is None else self.robustness.design_effect

    def log_evidence(self, design_effect: float) -> float:
        """Return the log likelihood marginalised over the light directions. With e the most likely
        rotations of the lights, P the prior covariance of the rotations and S the derivatives of
        the samples with respect to them, in standard deviations, the result is

            ln L(e) - e^T P^-1 e / 2 - ln det(1 + P S^T S) / 2,

        where ln L and S^T S are divided by the design effect.
        """
        evidence = self.log_likelihood / design_effect
        if self.turns_and_information is None:
            return evidence
        turns, information = self.turns_and_information
        flat, scaled = turns.ravel(), information / design_effect
        prior = self.view.observation.turn_prior
        prior = np.eye(len(flat)) if prior is None else prior
        volume = np.linalg.slogdet(np.eye(len(flat)) + prior @ scaled)[1]
        return evidence - float(flat @ np.linalg.solve(prior, flat) + volume) / 2


@double_precision
def fit_channel(view: View, form: Form, grouping: Grouping) -> ChannelFit:
    """Return the best fit of one channel with its robustness, misfit and evidence."""
    observation, selection, samples = view.observation, view.selection, view.samples(form)
    sensor = None
    if observation.gain is not None and observation.read_noise is not None:
        sensor = sensor_spread(observation.gain, observation.read_noise)
    found, lights, turns = best(samples, grouping, sensor), None, None
    if np.any(observation.uncertain.get("direction_sd", 0) * ~observation.held_out):
        found, lights = fit_rotations(found, view, grouping, sensor)
        if lights.followed:
            turns = lights.turns / lights.widened
            wider = widen_directions(observation, lights.widened)
            view = replace(view, observation=wider)
    samples, prediction = found.samples, found.prediction
    space = parameter_space(samples.form)
    stated = stated_errors(view, prediction, samples, turns)
    residual, signal, slope = seen = residual_signal_slope(prediction, samples)
    likeliest = weighted(prediction, samples, fit_spread(*seen, sensor=sensor))
    known_turns = None
    if lights is not None:
        about = np.zeros_like(lights.turns) if turns is None else turns
        shifts = shifts_of_turns(view, about, prediction.vector, likeliest)
        known_turns = about, information_on_turns(shifts, likeliest, selection, len(about))

    def chi_square(spread: Spread) -> float:
        squares = residual**2 / variance(spread, signal, slope=slope)
        return float(np.sum(squares) / (len(residual) - len(space)))

    return ChannelFit(
        view=view,
        requested=form,
        samples=samples,
        space=space,
        vector=prediction.vector,
        information=found.information,
        stated=stated,
        turned=lights,
        identifiability=identifiability(space, stated.marginal_information(found.information)),
        spread=found.spread,
        chi_square=chi_square(found.weights),
        sensor_chi_square=None if sensor is None else chi_square(sensor),
        log_likelihood=float(log_likelihood_of_dn(prediction, likeliest)[0].sum()),
        by_light=squared_errors(prediction.dn, samples, selection),
        turns_and_information=known_turns,
        converged=found.converged,
    )


def robust_covariance(fit: ChannelFit, known: Int[np.ndarray, " known"]) -> Robustness:
    """Return the covariance of the `known` parameters with shared and stated errors."""
    gradients, slopes = fit._scores_and_slopes
    slopes = slopes if fit.stated.slopes is None else fit.stated.slopes
    among = fit.stated.marginal_information(fit.information)[np.ix_(known, known)]
    light, pixel = fit.selection.light, fit.selection.pixel
    found = cluster_robust(gradients[known], among, fit.regions[light], pixel, slopes=slopes[known])
    return add_stated_errors(found, fit.stated, among, known)


def squared_errors(
    predicted: OfSamples, samples: Samples, selection: Selection
) -> Float[np.ndarray, "lights 2"]:
    """Return sums of squared (predicted - measured) and of signals, (lights, 2)."""
    measured = np.asarray(samples.dn)
    trusted = measured < samples.clip
    light = selection.light[trusted]
    squares = (predicted - measured)[trusted] ** 2, (measured - samples.black)[trusted] ** 2
    sums = np.stack([np.bincount(light, square) for square in squares], axis=1)
    return sums[np.bincount(light) > 0]


def lights_as_fitted(observation: Photographs, fit: ChannelFit) -> Photographs:
    """Return the photographs with the light directions that a fit estimated."""
    if fit.turned is None or not fit.turned.followed:
        return observation
    return shift_lights(observation, fit.turned.turns * turn_sizes(observation))


def predicted_image(
    observation: Photographs, fit: ChannelFit, light: int
) -> Float[np.ndarray, " pixels"]:
    """Return (pixels,) DN predicted under one light without noise, limited to the clip level. The
    observation must have `lights_as_fitted`."""
    samples = image_view(observation, fit.view.channel, light).samples(fit.form)
    return np.minimum(predict(fit.vector, samples).dn, observation.clip)


# ---------------------------------------------------------------- posterior


class Adjusted(eqx.Module):
    """A log density whose argument is transformed linearly about the mode, so that it has another
    curvature."""

    density: Callable[[Array, Any], Array] = eqx.field(static=True)  # function of (vector, data)
    data: Any  # of the density
    mode: Float[Any, " parameters"]  # unconstrained
    stretch: Float[Any, "parameters parameters"]  # the matrix C of mode + C (vector - mode)
    # gradient of the density at the mode, to be subtracted; None for 0
    slope: Float[Any, " parameters"] | None = None


def adjusted_log_density(vector: Float[Array, " parameters"], data: Adjusted) -> Array:
    """Return the log density, with its argument stretched about the mode."""
    away = data.stretch @ (vector - data.mode)
    own = data.density(data.mode + away, data.data)
    return own if data.slope is None else own - data.slope @ away


def composite(fit: ChannelFit, grouping: Grouping) -> Adjusted:
    """Return the adjusted likelihood of cells and saturated samples."""
    assert fit.robustness is not None
    cells = average(fit.samples, grouping, exact_at=predict(fit.vector, fit.samples))
    data = cells, saturated_only(fit.samples)
    stretch = curvature_stretch(fit.information, fit.robustness.gaussian_covariance)
    slope = np.zeros(len(fit.vector))
    for own in data:
        if own is not None:
            slope -= cost_and_information(predict(fit.vector, own), own)[1]
    return Adjusted(total_log_likelihood, data, fit.vector, stretch, slope)


def channel_posterior(
    fit: ChannelFit, grouping: Grouping, *, sampling: Emcee | None, seed: int
) -> Posterior:
    """Return the posterior of one channel whose covariance is known."""
    assert fit.robustness is not None
    data, options = composite(fit, grouping), {"sampling": sampling, "seed": seed}
    return adjusted_posterior(data, fit.space, fit.channel, **robust(fit.robustness), **options)


def robust(covariance: Robustness) -> dict[str, Any]:
    """Return the arguments of `adjusted_posterior` for a covariance over images. With few images,
    intervals are those of Student's t, which are wider than Gaussian intervals of the same standard
    deviation. A non-Gaussian density is widened to match these intervals.
    """
    return {
        "covariance": covariance.covariance,
        "wider": covariance.gaussian_covariance,
        "freedom": covariance.freedom,
    }


def adjusted_posterior(
    data: Adjusted,
    space: ParameterSpace,
    channel: str,
    *,
    covariance: Matrix,
    wider: Matrix | None = None,
    sampling: Emcee | None,
    seed: int,
    **judged: Any,
) -> Posterior:
    """Return draws by emcee if asked, else Laplace's form or draws where it fails."""
    if sampling is None:
        of = adjusted_log_density, space, data.mode, covariance, data
        return laplace_where_it_holds(*of, seed=seed, wider=wider, **judged)
    of = adjusted_log_density, space, data.mode, covariance if wider is None else wider, data
    return sample(*of, options=group_options(sampling, channel), seed=seed)
