"""One channel, one model: the best parameters (`optimum`) and the data to assess them."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...inference.clustering import Robustness, cluster_robust
from ...inference.compiled import compiled_briefly
from ...inference.diagnostics import Identifiability, identifiability
from ...inference.neighbours import regions
from ...inference.parameters import ParameterSpace, to_natural
from .derivatives import scores_and_slopes
from .geometry_cells import Grouping
from .model import Samples, negative_log_likelihood, parameter_space, predicted_dn
from .optimum import best, residual_signal_slope, weighted
from .read import Photographs
from .samples import Gathered, Selection, make_samples
from .signal import Form
from .spread import Spread, chi_square_per_dof, fit_spread, sensor_spread
from .stated import StatedErrors, stated_errors, with_stated_errors
from .turns import (
    TurnedLights,
    among_turns,
    information_on_turns,
    shifts_of_turns,
    turned,
    with_wider_directions,
)

_cost = compiled_briefly(negative_log_likelihood)


@dataclass(frozen=True)
class ChannelFit:
    """A fitted channel. Its form lacks the terms whose best amplitude is zero."""

    channel: str
    requested: Form  # the form asked for
    samples: Samples  # with the form and the deviations of the fit
    selection: Selection
    # of lights that err alike; each its own where neighbours do not
    regions: Int[np.ndarray, " lights"]
    space: ParameterSpace
    vector: Float[np.ndarray, " parameters"]  # unconstrained
    # on that scale, as if all samples were independent
    information: Float[np.ndarray, "parameters parameters"]
    # covariance that does not assume so; None where the data leave a direction open
    robustness: Robustness | None
    stated: StatedErrors  # what the rig calls uncertain
    # where the images put lights of uncertain directions; None without such
    turned: TurnedLights | None
    identifiability: Identifiability  # of the information, less what turns of lights take
    spread: Spread  # of the residuals of plain squares
    chi_square: float  # per degree of freedom, with the weights of the fit
    sensor_chi_square: float | None  # with the sensor's noise alone; None if unknown
    log_likelihood: float  # with the spread of the final residuals, where lights stand in the fit
    # (lights, 2) turns and (lights, 2, 2) what the images tell of them, in units of the directions'
    # uncertainty; None without such
    told_of_turns: tuple[np.ndarray, np.ndarray] | None
    converged: bool  # whether the optimum was reached

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

    def log_evidence(self, design_effect: float) -> float:
        """Logarithm of the likelihood marginalised over the light directions, with e their most
        likely rotations,

            ln L(e) - e^2 / 2 - ln det(1 + S^T S) / 2,

        where ln L and S^T S are divided by a design effect.
        """
        evidence = self.log_likelihood / design_effect
        if self.told_of_turns is None:
            return evidence
        turns, information = self.told_of_turns
        widening = np.linalg.slogdet(np.eye(2) + information / design_effect)[1]
        return evidence - float(np.sum(turns**2) + widening.sum()) / 2


def fit_channel(gathered: Gathered, channel: int, form: Form, grouping: Grouping) -> ChannelFit:
    """Return the best fit of one channel with its robustness, misfit and evidence."""
    observation, selection = gathered.observation, gathered.selection
    samples = gathered.samples(channel, form)
    sensor = None
    if observation.gain is not None and observation.read_noise is not None:
        sensor = sensor_spread(observation.gain, observation.read_noise)
    found, lights, turns, known = best(samples, grouping, sensor), None, None, observation
    if np.any(observation.uncertain.get("direction_sd", 0) * ~observation.held_out):
        found, lights = among_turns(found, gathered, channel, grouping, sensor)
        if lights.followed:
            turns = lights.turns / lights.widened
            known = with_wider_directions(observation, lights.widened)
    samples, vector = found.samples, found.vector

    space = parameter_space(samples.form)
    information = np.asarray(found.information, np.float64)
    robustness = None
    stated = stated_errors(known, channel, vector, samples, selection, turns)
    judged = identifiability(space, stated.left_of(information))
    gradients = np.asarray(scores_and_slopes(vector, samples)[0], np.float64)
    alike = regions(gradients, selection.light, observation.wi.mean(axis=1))
    if judged.determined:
        robustness = robust_covariance(
            vector, samples, selection, information, np.arange(len(space)), stated, alike
        )
    residual, signal, slope = residual_signal_slope(vector, samples)
    likeliest = weighted(vector, samples, fit_spread(residual, signal, slope, sensor=sensor))
    told = None
    if lights is not None:
        about = np.zeros_like(lights.turns) if turns is None else turns
        shifts = shifts_of_turns(known, about, channel, vector, likeliest, selection)
        told = about, information_on_turns(shifts, likeliest, selection, len(about))
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
        turned=lights,
        identifiability=judged,
        spread=found.spread,
        chi_square=chi_square_per_dof(residual, signal, slope, found.weights, dof),
        sensor_chi_square=None
        if sensor is None
        else chi_square_per_dof(residual, signal, slope, sensor, dof),
        log_likelihood=-float(_cost(vector, likeliest)),
        told_of_turns=told,
        converged=found.converged,
    )


def robust_covariance(
    vector: Float[Array, " parameters"],
    samples: Samples,
    selection: Selection,
    information: Float[np.ndarray, "parameters parameters"],
    known: Int[np.ndarray, " known"],
    stated: StatedErrors,
    alike: Int[np.ndarray, " lights"],
) -> Robustness:
    """Return the covariance of the `known` parameters, with the others fixed, including shared
    errors of lights and pixels and the errors that the rig states."""
    gradients, slopes = (np.asarray(x, np.float64) for x in scores_and_slopes(vector, samples))
    slopes = slopes if stated.slopes is None else stated.slopes
    among = stated.left_of(information)[np.ix_(known, known)]
    found = cluster_robust(
        gradients[known], among, alike[selection.light], selection.pixel, slopes=slopes[known]
    )
    return with_stated_errors(found, stated, among, known)


def lights_as_fitted(observation: Photographs, fit: ChannelFit) -> Photographs:
    """Return the observation with the light directions of a fit."""
    if fit.turned is None or not fit.turned.followed:
        return observation
    return turned(observation, fit.turned.turns * observation.uncertain["direction_sd"][:, None])


def predicted_image(
    observation: Photographs, fit: ChannelFit, light: int
) -> Float[np.ndarray, " pixels"]:
    """Return (pixels,) DN predicted under one light without noise, limited to the clip level. The
    observation must have `lights_as_fitted`."""
    pixels = np.arange(observation.cosine.shape[1])
    selection = Selection(np.full_like(pixels, light), pixels)
    channel = observation.channels.index(fit.channel)
    samples = make_samples(observation, channel, fit.form, selection)
    predicted = predicted_dn(jnp.asarray(fit.vector), samples)
    return np.minimum(np.asarray(predicted, np.float64), observation.clip)
