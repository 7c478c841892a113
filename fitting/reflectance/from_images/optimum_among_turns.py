"""The best parameters among lights whose directions the rig calls uncertain (`turns`)."""

from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from .geometry_cells import Grouping
from .model import Samples
from .optimum import Optimum, weighed, weighed_and_fitted
from .read import ReflectanceObservation
from .samples import Gathered, Selection, make_samples, of_some_pixels
from .spread import Spread
from .turns import likeliest_turns, shifts_of_turns, turned

MOST_TURNS = 10  # of the lights
SETTLED = 0.05  # standard deviations of a light's direction
IMPLAUSIBLE = 1e-3  # chance that lights as good as stated are turned by as much
ABSURD = 4.0  # standard deviations, rms over lights, of the first step, which comes from afar
ENOUGH = 20_000  # samples that put lights nearly where all samples do


def among_turns(
    nominal: Optimum, gathered: Gathered, channel: int, grouping: Grouping, sensor: Spread | None
) -> tuple[Optimum, np.ndarray | None]:
    """Parameters and turns of the lights, one at the other's best, until no light moves; of many
    samples a part until then, and all of them twice.

    Args:
        nominal: the optimum where lights stand as the rig says.
        gathered: the samples that all fits share.
        channel: index.
        grouping: cells of the samples.
        sensor: what the sensor's noise makes; None if unknown.

    Returns:
        The optimum, and (lights, 2) turns in units of `direction_sd`; `nominal` and None where
        lights would have to be turned by far more than the rig says: then the model misses.
    """
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
            found = replace(found, samples=weighed(found.vector, samples, sensor)[0])
        for number in range(rounds):
            vector, samples = found.vector, found.samples
            shifts = shifts_of_turns(observation, turns, channel, vector, samples, selection)
            before = turns
            turns = likeliest_turns(shifts, before, vector, samples, selection)
            if _rms(turns[known]) > (ABSURD if number == 0 and rounds > 2 else most):
                return nominal, None
            samples = _about(observation, selection, channel, found, turns)
            found = weighed_and_fitted(vector, samples, grouping, sensor)
            if np.abs(turns - before).max() < SETTLED:
                break
    return found, turns


def _about(
    observation: ReflectanceObservation,
    selection: Selection,
    channel: int,
    found: Optimum,
    turns: np.ndarray,
) -> Samples:
    lights = turned(observation, turns * observation.uncertain["direction_sd"][:, None])
    return make_samples(lights, channel, found.samples.form, selection)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
