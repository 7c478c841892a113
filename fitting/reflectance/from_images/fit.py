"""One channel, one model: the best parameters (`optimum`) and the data to assess them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import block_diag

from ...inference.clustering import Robustness, cluster_robust
from ...inference.diagnostics import Identifiability, identifiability
from ...inference.neighbours import regions
from ...inference.parameters import ParameterSpace, natural_numbers
from ...inference.precision import in_double
from .derivatives import log_likelihood_of_dn, predict, scores_and_slopes
from .geometry_cells import Grouping
from .model import Samples, parameter_space
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


@dataclass(frozen=True)
class ChannelFit:
    """A fitted channel. Its form lacks the terms whose best amplitude is zero."""

    channel: str
    requested: Form  # the form asked for
    samples: Samples  # with the form and the deviations of the fit
    selection: Selection
    places: Float[np.ndarray, "lights 3"]  # of the lights, in units that compare
    space: ParameterSpace
    vector: Float[np.ndarray, " parameters"]  # unconstrained
    # on that scale, as if all samples were independent
    information: Float[np.ndarray, "parameters parameters"]
    stated: StatedErrors  # what the rig calls uncertain
    # where the images put lights of uncertain directions; None without such
    turned: TurnedLights | None
    identifiability: Identifiability  # of the information, less what turns of lights take
    spread: Spread  # of the residuals of plain squares
    chi_square: float  # per degree of freedom, with the weights of the fit
    sensor_chi_square: float | None  # with the sensor's noise alone; None if unknown
    log_likelihood: float  # with the spread of the final residuals, where lights stand in the fit
    by_light: Float[np.ndarray, "lights 2"]  # `squared_errors` of the samples
    # (lights, 2) turns and (lights, 2, 2) what the images tell of them, in units of the directions'
    # uncertainty; None without such
    turns_and_information: tuple[np.ndarray, np.ndarray] | None
    converged: bool  # whether the optimum was reached
    # (turns, turns) covariance of the rotations where lights err together, in these units
    turn_prior: np.ndarray | None = None

    @property
    def form(self) -> Form:
        return self.samples.form

    @property
    def natural(self) -> Float[np.ndarray, " parameters"]:
        """Parameters in their own units."""
        return natural_numbers(self.space, self.vector)

    @cached_property
    def _scores_and_slopes(self) -> tuple[np.ndarray, np.ndarray]:
        return scores_and_slopes(predict(self.vector, self.samples), self.samples)

    @cached_property
    def regions(self) -> Int[np.ndarray, " lights"]:
        """Of lights that err alike; each its own where neighbours do not."""
        return regions(self._scores_and_slopes[0], self.selection.light, self.places)

    @cached_property
    def robustness(self) -> Robustness | None:
        """Covariance that does not assume independent samples; None where the data leave a
        direction open. Of most models compared nobody needs it."""
        every = np.arange(len(self.space))
        return robust_covariance(self, every) if self.identifiability.determined else None

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
        if self.turns_and_information is None:
            return evidence
        turns, information = self.turns_and_information
        if self.turn_prior is None:
            widening = np.linalg.slogdet(np.eye(2) + information / design_effect)[1]
            return evidence - float(np.sum(turns**2) + widening.sum()) / 2
        prior, flat = self.turn_prior, turns.ravel()
        root = np.linalg.cholesky(prior)
        told = root.T @ np.asarray(block_diag(*information)) @ root / design_effect
        volume = np.linalg.slogdet(np.eye(len(flat)) + told)[1]
        return evidence - float(flat @ np.linalg.solve(prior, flat) + volume) / 2


@in_double
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
    samples, prediction = found.samples, found.prediction
    space = parameter_space(samples.form)
    stated = stated_errors(known, channel, prediction, samples, selection, turns)
    seen = residual_signal_slope(prediction, samples)
    likeliest = weighted(prediction, samples, fit_spread(*seen, sensor=sensor))
    told = None
    if lights is not None:
        about = np.zeros_like(lights.turns) if turns is None else turns
        shifts = shifts_of_turns(known, about, channel, prediction.vector, likeliest, selection)
        told = about, information_on_turns(shifts, likeliest, selection, len(about))
    dof = len(seen[0]) - len(space)
    return ChannelFit(
        channel=observation.channels[channel],
        requested=form,
        samples=samples,
        selection=selection,
        places=observation.wi.mean(axis=1),
        space=space,
        vector=prediction.vector,
        information=found.information,
        stated=stated,
        turned=lights,
        identifiability=identifiability(space, stated.left_of(found.information)),
        spread=found.spread,
        chi_square=chi_square_per_dof(*seen, found.weights, dof),
        sensor_chi_square=None if sensor is None else chi_square_per_dof(*seen, sensor, dof),
        log_likelihood=float(log_likelihood_of_dn(prediction, likeliest)[0].sum()),
        by_light=squared_errors(prediction.dn, samples, selection),
        turns_and_information=told,
        converged=found.converged,
        turn_prior=known.turn_prior,
    )


def robust_covariance(fit: ChannelFit, known: Int[np.ndarray, " known"]) -> Robustness:
    """Return the covariance of the `known` parameters, with the others fixed, including shared
    errors of lights and pixels and the errors that the rig states."""
    gradients, slopes = fit._scores_and_slopes
    slopes = slopes if fit.stated.slopes is None else fit.stated.slopes
    among = fit.stated.left_of(fit.information)[np.ix_(known, known)]
    light, pixel = fit.selection.light, fit.selection.pixel
    found = cluster_robust(gradients[known], among, fit.regions[light], pixel, slopes=slopes[known])
    return with_stated_errors(found, fit.stated, among, known)


def squared_errors(
    predicted: Float[np.ndarray, " samples"], samples: Samples, selection: Selection
) -> Float[np.ndarray, "lights 2"]:
    """Return (lights, 2) sums over a light's unsaturated samples of squared (predicted - measured)
    and of squared signals above black."""
    measured = np.asarray(samples.dn)
    trusted = measured < samples.clip
    light = selection.light[trusted]
    squares = (predicted - measured)[trusted] ** 2, (measured - samples.black)[trusted] ** 2
    sums = np.stack([np.bincount(light, square) for square in squares], axis=1)
    return sums[np.bincount(light) > 0]


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
    return np.minimum(predict(fit.vector, samples).dn, observation.clip)
