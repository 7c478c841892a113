"""The best parameters among lights whose directions the rig calls uncertain (`turns`)."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri

from .geometry_cells import Grouping
from .model import Samples
from .optimum import Optimum, weighed, weighed_and_fitted
from .read import Photographs
from .samples import Gathered, Selection, make_samples, of_some_pixels
from .spread import Spread
from .turns import likeliest_turns, shifts_of_turns, turned

MOST_TURNS = 10  # of the lights
SETTLED = 0.05  # standard deviations of a light's direction
IMPLAUSIBLE = 1e-3  # chance that lights as good as stated are turned by as much
WIDEST = 3.0  # times the stated size, from which it is the model that misses, not the lights
ABSURD = 2 * WIDEST  # standard deviations, of a step, which the next ones may take back
ENOUGH = 20_000  # samples that put lights nearly where all samples do


@dataclass(frozen=True)
class TurnedLights:
    """Where the images put the lights.

    Attributes:
        turns: (lights, 2) in units of `direction_sd`.
        size: their rms over the lights of uncertain direction.
        widened: factor by which `direction_sd` was taken larger, as such turns are no chance.
    """

    turns: Float[np.ndarray, "lights 2"]
    size: float
    widened: float = 1.0

    @property
    def followed(self) -> bool:
        """Whether the fit uses these directions. If they are too far from the rig's, the model
        misses something else and the fit keeps the rig's."""
        return self.size <= WIDEST


def among_turns(
    nominal: Optimum, gathered: Gathered, channel: int, grouping: Grouping, sensor: Spread | None
) -> tuple[Optimum, TurnedLights]:
    """Alternate between parameters and light rotations until no light moves. If lights are off by
    more than stated and chance allows, their uncertainty is taken from the images.

    Returns `nominal`, the optimum at the rig's directions, if the rotations are not followed.
    """
    observation = gathered.observation
    known = (observation.uncertain["direction_sd"] > 0) & ~observation.held_out
    seen = 2 * np.count_nonzero(known)
    most = float(np.sqrt(chdtri(seen, IMPLAUSIBLE) / seen))
    found, turns = _settled(nominal, gathered, known, channel, grouping, sensor)
    lights = TurnedLights(turns, _rms(turns[known]))
    if most < lights.size <= WIDEST:
        widened = lights.size
        wider = replace(gathered, observation=with_wider_directions(observation, widened))
        found, turns = _settled(nominal, wider, known, channel, grouping, sensor)
        lights = TurnedLights(widened * turns, widened * _rms(turns[known]), widened)
    return (found if lights.followed else nominal), lights


def with_wider_directions(observation: Photographs, factor: float) -> Photographs:
    """Return the observation with a larger `direction_sd`."""
    sizes = observation.uncertain | {"direction_sd": factor * observation.uncertain["direction_sd"]}
    return replace(observation, uncertain=sizes)


def _settled(
    nominal: Optimum,
    gathered: Gathered,
    known: np.ndarray,
    channel: int,
    grouping: Grouping,
    sensor: Spread | None,
) -> tuple[Optimum, np.ndarray]:
    """Return the optimum and the rotations that agree with each other. Of many samples, a part is
    used until no light moves, then all of them twice. It ends if lights go astray."""
    whole = gathered.observation, gathered.selection
    found, turns = nominal, np.zeros((len(known), 2))
    step = max(1, len(whole[1].light) // ENOUGH)
    stages = [(*whole, MOST_TURNS)]
    if step > 1:
        stages = [(*of_some_pixels(*whole, step), MOST_TURNS), (*whole, 2)]
    for observation, selection, rounds in stages:
        if step > 1:
            samples = _about(observation, selection, channel, found, turns)
            found = replace(found, samples=weighed(found.vector, samples, sensor)[0])
        for _ in range(rounds):
            vector, samples = found.vector, found.samples
            shifts = shifts_of_turns(observation, turns, channel, vector, samples, selection)
            before = turns
            turns = likeliest_turns(shifts, before, vector, samples, selection)
            if _rms(turns[known]) > ABSURD:
                return nominal, turns
            samples = _about(observation, selection, channel, found, turns)
            found = weighed_and_fitted(vector, samples, grouping, sensor)
            if np.abs(turns - before).max() < SETTLED:
                break
    return found, turns


def _about(
    observation: Photographs,
    selection: Selection,
    channel: int,
    found: Optimum,
    turns: np.ndarray,
) -> Samples:
    lights = turned(observation, turns * observation.uncertain["direction_sd"][:, None])
    return make_samples(lights, channel, found.samples.form, selection)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
