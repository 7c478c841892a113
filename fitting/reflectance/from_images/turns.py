"""Uncertain light directions, estimated from the images together with the parameters.

A rig's `direction_sd` is a normal prior for the two rotations e of each light. In units of standard
deviations, the residuals r of an image change by S e to first order, so that

    e = K^-1 S^T r,    K = 1 + S^T S,

are the most likely rotations for given parameters. Marginalising over them leaves the information

    I - J^T S K^-1 S^T J,    1 - S K^-1 S^T = (1 + S S^T)^-1,

for the parameters, whose derivatives are J and whose information was I. Where lights were measured
together, on a ball whose outline they share, their rotations have a common covariance P, and K is
P^-1 + S^T S of all lights.

A highlight is not linear in its light's direction. If lights have errors of a degree and the rig's
directions are kept, the fit shows the mean of displaced highlights, which is wider and weaker than
each of them. All images are affected equally, so scatter between them does not reveal it. Rotations
and parameters are therefore fitted in alternation, each linearised about the last ones
(Gauss-Newton).
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag, solve_triangular
from scipy.special import chdtri

from .derivatives import Prediction, Vector, predict, residuals
from .geometry_cells import Grouping
from .model import Samples
from .optimum import Optimum, weighed, weighed_and_fitted
from .read import Photographs, across, angles
from .samples import Gathered, Selection, make_samples, of_some_pixels
from .spread import Spread

STEP = 0.5  # standard deviations to either side, of a slope
LEAST_INFORMATION = 1e-12  # least information of an image on a rotation, in units of the prior's
MOST_TURNS = 10  # of the lights
SETTLED = 0.05  # standard deviations of a light's direction
IMPLAUSIBLE = 1e-3  # chance that lights as good as stated are off by as much
WIDEST = 3.0  # times the stated size, from which the model misses something else
ABSURD = 2 * WIDEST  # standard deviations, of a step, which the next ones may take back
ENOUGH = 20_000  # samples that put lights nearly where all samples do


def turned(observation: Photographs, angles_across: Float[np.ndarray, "lights 2"]) -> Photographs:
    """Rotate the lights by (lights, 2) rad along two axes across them."""
    moved = observation.wi + np.einsum("la,lac->lc", angles_across, across(observation.wi))[:, None]
    moved /= np.linalg.norm(moved, axis=-1, keepdims=True)
    cosine, mirror = angles(observation.normals, moved)
    return replace(observation, wi=moved, cosine=cosine, mirror_angle=mirror)


def shifts_of_turns(
    observation: Photographs,
    turns: Float[np.ndarray, "lights 2"],
    channel: int,
    vector: Vector,
    samples: Samples,
    selection: Selection,
) -> Float[np.ndarray, "2 samples"]:
    """Return (2, samples) DN, the change of a prediction when its light rotates by one standard
    deviation about each axis, at `turns`."""

    def predicted(axis: int, step: float) -> np.ndarray:
        aside = turns + step * np.eye(2)[axis]
        lights = turned(observation, aside * observation.uncertain["direction_sd"][:, None])
        moved = make_samples(lights, channel, samples.form, selection)
        moved = replace(moved, gamma=samples.gamma)
        return predict(vector, moved).dn

    moves = [predicted(axis, STEP) - predicted(axis, -STEP) for axis in (0, 1)]
    return np.stack(moves) / (2 * STEP)


def likeliest_turns(
    shifts: Float[np.ndarray, "2 samples"],
    turns: Float[np.ndarray, "lights 2"],
    prediction: Prediction,
    samples: Samples,
    selection: Selection,
    prior: Float[np.ndarray, "turns turns"] | None,
) -> Float[np.ndarray, "lights 2"]:
    """Return the (lights, 2) most likely rotations at given parameters, in units of `direction_sd`,
    linearised about `turns`."""
    moves, precision = _standard(shifts, samples, selection, len(turns))
    left = -residuals(prediction, samples)
    left += np.einsum("as,sa->s", moves, turns[selection.light])
    pulls = np.stack([np.bincount(selection.light, m * left, len(turns)) for m in moves], axis=1)
    if prior is None:
        return np.linalg.solve(precision, pulls[..., None])[..., 0]
    whole = np.linalg.inv(prior) + np.asarray(block_diag(*(precision - np.eye(2))))
    return np.linalg.solve(whole, pulls.ravel()).reshape(-1, 2)


def information_on_turns(
    shifts: Float[np.ndarray, "2 samples"], samples: Samples, selection: Selection, lights: int
) -> Float[np.ndarray, "lights 2 2"]:
    """S^T S, the information of the images about the rotations without the rig's, (lights, 2, 2) in
    units of `direction_sd`."""
    return _standard(shifts, samples, selection, lights)[1] - np.eye(2)


def beyond_turns(
    values: Float[np.ndarray, "rows samples"],
    shifts: Float[np.ndarray, "2 samples"],
    samples: Samples,
    selection: Selection,
    lights: int,
    *,
    prior: Float[np.ndarray, "turns turns"] | None = None,
) -> Float[np.ndarray, "rows samples"]:
    """Return (1 + S P S^T)^(-1/2) x for slopes and errors x, (rows, samples) in standard
    deviations.
    Products of these equal x^T (1 - S K^-1 S^T) y, after marginalising over the light directions.
    """
    moves, precision = _standard(shifts, samples, selection, lights)
    told = precision - np.eye(2)  # S^T S
    root = np.eye(2)
    if prior is not None:
        root = np.linalg.cholesky(prior)[None]
        told = np.swapaxes(root, 1, 2) @ np.asarray(block_diag(*told)) @ root
    squares, axes = np.linalg.eigh(told)
    squares, axes = np.maximum(squares, LEAST_INFORMATION), root @ axes
    taken = (1 - 1 / np.sqrt(1 + squares)) / squares
    pulls = np.stack(
        [[np.bincount(selection.light, row * move, lights) for move in moves] for row in values]
    )  # (rows, 2, lights)
    if prior is not None:
        pulls = np.swapaxes(pulls, 1, 2).reshape(len(pulls), -1, 1)
    back = np.einsum("lab,lb,lcb,rcl->ral", axes, taken, axes, pulls)
    if prior is not None:
        back = np.swapaxes(back.reshape(len(back), -1, 2), 1, 2)
    return values - np.einsum("as,ras->rs", moves, back[:, :, selection.light])


def _standard(
    shifts: np.ndarray, samples: Samples, selection: Selection, lights: int
) -> tuple[np.ndarray, np.ndarray]:
    """S in standard deviations, (2, samples), and K, (lights, 2, 2)."""
    moves = shifts / np.asarray(samples.deviation, np.float64)
    if samples.saturated is not None:
        moves = np.where(np.asarray(samples.saturated), 0, moves)
    squares = [
        [np.bincount(selection.light, one * other, lights) for other in moves] for one in moves
    ]
    return moves, np.eye(2) + np.moveaxis(np.array(squares), -1, 0)


@dataclass(frozen=True)
class TurnedLights:
    """The light directions from the images."""

    turns: Float[np.ndarray, "lights 2"]  # in units of `direction_sd`
    size: float  # their rms over the lights of uncertain direction
    # factor by which `direction_sd` was taken larger, as such turns are no chance
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
    prior = observation.turn_prior

    def size(turns: np.ndarray) -> float:
        if prior is None:
            return _rms(turns[known])
        both = np.repeat(known, 2)
        root = np.linalg.cholesky(prior[np.ix_(both, both)])
        return _rms(solve_triangular(root, turns[known].ravel(), lower=True))

    found, turns = _consistent_turns(nominal, gathered, known, channel, grouping, sensor)
    lights = TurnedLights(turns, size(turns))
    if most < lights.size <= WIDEST:
        widened = lights.size
        wider = replace(gathered, observation=with_wider_directions(observation, widened))
        found, turns = _consistent_turns(nominal, wider, known, channel, grouping, sensor)
        lights = TurnedLights(widened * turns, widened * size(turns), widened)
    return (found if lights.followed else nominal), lights


def with_wider_directions(observation: Photographs, factor: float) -> Photographs:
    """Return the observation with a larger `direction_sd`."""
    sizes = observation.uncertain | {"direction_sd": factor * observation.uncertain["direction_sd"]}
    return replace(observation, uncertain=sizes)


def _consistent_turns(
    nominal: Optimum,
    gathered: Gathered,
    known: np.ndarray,
    channel: int,
    grouping: Grouping,
    sensor: Spread | None,
) -> tuple[Optimum, np.ndarray]:
    """Return the optimum and the rotations that agree with each other. With many samples, a subset
    is used until no light moves, then all of them twice. It stops if lights move too far."""
    whole = gathered.observation, gathered.selection
    found, turns = nominal, np.zeros((len(known), 2))
    step = max(1, len(whole[1].light) // ENOUGH)
    stages = [(*whole, MOST_TURNS)]
    if step > 1:
        stages = [(*of_some_pixels(*whole, step), MOST_TURNS), (*whole, 2)]
    for observation, selection, rounds in stages:
        if step > 1:
            samples = _about(observation, selection, channel, found, turns)
            samples, _, _, prediction = weighed(found.vector, samples, sensor)
            found = replace(found, samples=samples, prediction=prediction)
        for _ in range(rounds):
            vector, samples = found.vector, found.samples
            shifts = shifts_of_turns(observation, turns, channel, vector, samples, selection)
            before = turns
            turns = likeliest_turns(
                shifts, before, found.prediction, samples, selection, observation.turn_prior
            )
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
