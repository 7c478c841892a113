"""Where lights stand, as far as their images tell.

A rig's `direction_sd` is a normal prior of the two turns e of each light. With everything in
standard deviations, an image of residuals r moves by S e to first order, so that

    e = K^-1 S^T r,    K = 1 + S^T S,

are the likeliest turns at given parameters, and eliminating them leaves of the information I on
the parameters, whose slopes are J,

    I - J^T S K^-1 S^T J,    1 - S K^-1 S^T = (1 + S S^T)^-1.

A highlight does not follow its light linearly: lights off by a degree, left where the rig puts
them, show the mean of highlights that lie apart, wider and weaker than each of them. All images
show it alike, so that no spread among them tells. Turns and parameters are therefore found in
turn, about the last ones (Gauss-Newton).
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Array, Float

from jaxvision import as_array, as_vec
from jaxvision.geometry.hemisphere import local_frame

from .model import Samples, predicted_dn, residuals
from .read import Photographs, angles
from .samples import Selection, make_samples

STEP = 0.5  # standard deviations to either side, of a slope
TOLD = 1e-12  # least information of an image on a turn, in units of the prior's


def turned(observation: Photographs, angles_across: Float[np.ndarray, "lights 2"]) -> Photographs:
    """Rotate the lights by (lights, 2) rad along two axes across them."""
    middle = observation.wi.mean(axis=1)
    frame = local_frame(as_vec(middle / np.linalg.norm(middle, axis=1, keepdims=True)))
    axes = np.stack([np.asarray(as_array(v)) for v in (frame.tangent, frame.bitangent)], axis=1)
    moved = observation.wi + np.einsum("la,lac->lc", angles_across, axes)[:, None]
    moved /= np.linalg.norm(moved, axis=-1, keepdims=True)
    cosine, mirror = angles(observation.normals, moved)
    return replace(observation, wi=moved, cosine=cosine, mirror_angle=mirror)


def shifts_of_turns(
    observation: Photographs,
    turns: Float[np.ndarray, "lights 2"],
    channel: int,
    vector: Float[Array, " parameters"],
    samples: Samples,
    selection: Selection,
) -> Float[np.ndarray, "2 samples"]:
    """Return (2, samples) DN by which a rotation of its light by one standard deviation along each
    axis moves a prediction, about `turns`."""

    def predicted(axis: int, step: float) -> np.ndarray:
        aside = turns + step * np.eye(2)[axis]
        lights = turned(observation, aside * observation.uncertain["direction_sd"][:, None])
        moved = make_samples(lights, channel, samples.form, selection)
        moved = replace(moved, gamma=samples.gamma)
        return np.asarray(predicted_dn(vector, moved), np.float64)

    moves = [predicted(axis, STEP) - predicted(axis, -STEP) for axis in (0, 1)]
    return np.stack(moves) / (2 * STEP)


def likeliest_turns(
    shifts: Float[np.ndarray, "2 samples"],
    turns: Float[np.ndarray, "lights 2"],
    vector: Float[Array, " parameters"],
    samples: Samples,
    selection: Selection,
) -> Float[np.ndarray, "lights 2"]:
    """Return the (lights, 2) most likely rotations at given parameters, in units of `direction_sd`,
    linearised about `turns`."""
    moves, precision = _standard(shifts, samples, selection, len(turns))
    left = -np.asarray(residuals(vector, samples), np.float64)
    left += np.einsum("as,sa->s", moves, turns[selection.light])
    pulls = [np.bincount(selection.light, move * left, len(turns)) for move in moves]
    return np.linalg.solve(precision, np.stack(pulls, axis=1)[..., None])[..., 0]


def information_on_turns(
    shifts: Float[np.ndarray, "2 samples"], samples: Samples, selection: Selection, lights: int
) -> Float[np.ndarray, "lights 2 2"]:
    """S^T S, the information of the images on the rotations without the rig's, (lights, 2, 2) in
    units of `direction_sd`."""
    return _standard(shifts, samples, selection, lights)[1] - np.eye(2)


def beyond_turns(
    values: Float[np.ndarray, "rows samples"],
    shifts: Float[np.ndarray, "2 samples"],
    samples: Samples,
    selection: Selection,
    lights: int,
) -> Float[np.ndarray, "rows samples"]:
    """Return (1 + S S^T)^(-1/2) x for slopes and errors x, (rows, samples) in standard deviations.
    Products of these equal x^T (1 - S K^-1 S^T) y, after marginalising over the light directions.
    """
    moves, precision = _standard(shifts, samples, selection, lights)
    squares, axes = np.linalg.eigh(precision - np.eye(2))  # of S^T S
    squares = np.maximum(squares, TOLD)
    taken = (1 - 1 / np.sqrt(1 + squares)) / squares
    pulls = np.stack(
        [[np.bincount(selection.light, row * move, lights) for move in moves] for row in values]
    )  # (rows, 2, lights)
    back = np.einsum("lab,lb,lcb,rcl->ral", axes, taken, axes, pulls)
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
