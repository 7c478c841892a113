"""Propagation of the uncertainties that a rig states through a fit.

An error e changes the prediction of each sample by s e. To first order, the best parameters change
by

    d theta = I^-1 p e,    p = sum slope * s / deviation,

where slope is the gradient of the prediction in standard deviations and I the information. Errors
of a light (`intensity_sd`, `exposure_sd`, `stray_sd`, and `direction_sd` unless `turns` fits the
directions) shift the samples of its image only. The residuals contain them too, so the covariance
over a few lights is replaced by the stated one, unless the residuals are larger. Errors of all
images at once (`black_sd`, `gamma_sd`) look like another surface. No residual shows them, and their
covariance is added. The gain only weights the samples, so `gain_sd` changes no parameter to first
order.

Errors that change the distribution of the samples by at most a tenth of their noise are dropped
(`inference.left_out`).
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.special import chdtri

from ...inference.clustering import Robustness
from ...inference.left_out import LeftOut, distance, negligible
from .derivatives import Prediction, predict, scores_and_slopes
from .model import Samples
from .read import Photographs
from .samples import Selection
from .turns import beyond_turns, shifts_of_turns

ROUNDING = 1e-9
CHANCE = 0.05  # that residuals of lights as good as stated seem to show more


@dataclass(frozen=True)
class StatedErrors:
    """The vectors p e for the errors that a rig states, each of one standard deviation."""

    of_lights: Float[np.ndarray, "errors parameters"]  # each of one image
    common: Float[np.ndarray, "more parameters"]  # each of all images
    # of the predictions, in standard deviations, as far as turns of the lights leave them; None
    # where none are found
    slopes: Float[np.ndarray, "parameters samples"] | None = None
    # errors that the rig states and that are too small to matter
    left_out: tuple[LeftOut, ...] = ()

    def left_of(
        self, information: Float[np.ndarray, "parameters parameters"]
    ) -> Float[np.ndarray, "parameters parameters"]:
        """Return the (P, P) information left after marginalising over light directions.

        It is the Gauss-Newton information. If the model has a misfit, the curvature of the
        likelihood is not a sum of squares. After subtracting the part of the light directions, it
        need not be positive.
        """
        return information if self.slopes is None else self.slopes @ self.slopes.T


def stated_errors(
    observation: Photographs,
    channel: int,
    prediction: Prediction,
    samples: Samples,
    selection: Selection,
    turns: Float[np.ndarray, "lights 2"] | None,
) -> StatedErrors:
    """Return p e for all errors that the rig states and a fit can notice. `turns` are the (lights,
    2) rotations of the samples' lights in units of `direction_sd`, if they were fitted."""
    sizes, light, count = observation.uncertain, selection.light, len(prediction.vector)
    lights = len(next(iter(sizes.values()), ()))
    own = _shifts_of_lights(observation, channel, prediction, samples, selection, turns)
    shared = _shifts_of_all(observation, prediction, samples)
    if not own and not shared:
        return StatedErrors(np.empty((0, count)), np.empty((0, count)))
    deviation = np.asarray(samples.deviation, np.float64)

    def by_light(values: np.ndarray) -> np.ndarray:
        return np.bincount(light, values, lights)

    squares = {name: _squares(shifts, deviation) for name, shifts in (own | shared).items()}
    errors = [
        LeftOut(name, float(np.median(sizes[name])), distance(by_light(squares[name])))
        for name in own
    ]
    errors += [
        LeftOut(name, getattr(observation, name), distance(squares[name].sum())) for name in shared
    ]
    gone = negligible(errors)
    named = {error.name for error in gone}
    slopes = scores_and_slopes(prediction, samples)[1]
    turnable = None
    if turns is not None and "direction_sd" in own:
        shifts = own.pop("direction_sd")
        turnable = None if "direction_sd" in named else shifts

    def left(values: np.ndarray) -> np.ndarray:
        if turnable is None:
            return values
        return beyond_turns(
            values, turnable, samples, selection, lights, prior=observation.turn_prior
        )

    slopes = left(slopes)
    of_lights = [
        np.stack([by_light(row * shift) for row in slopes], axis=1)
        for name, shifts in own.items()
        if name not in named
        for shift in left(shifts / deviation)
    ]
    of_all = [
        slopes @ shift
        for name, shifts in shared.items()
        if name not in named
        for shift in left(shifts / deviation)
    ]
    return StatedErrors(
        np.concatenate(of_lights) if of_lights else np.empty((0, count)),
        np.array(of_all).reshape(-1, count),
        None if turnable is None else slopes,
        gone,
    )


def _squares(shifts: np.ndarray, deviation: np.ndarray) -> np.ndarray:
    """(samples,) sum over all shifts, (shifts, samples) DN, of their squares in standard
    deviations."""
    return ((shifts / deviation) ** 2).sum(0)


def _shifts_of_all(
    observation: Photographs, prediction: Prediction, samples: Samples
) -> dict[str, np.ndarray]:
    """(1, samples) DN, the change of a prediction by each error of all images at once."""
    found = {}
    if observation.black_sd:
        found["black_sd"] = np.full((1, len(samples.dn)), observation.black_sd)
    if observation.gamma_sd and samples.gamma is not None:
        steps = observation.gamma_sd, -observation.gamma_sd
        up, down = (
            predict(prediction.vector, replace(samples, gamma=samples.gamma + step)).dn
            for step in steps
        )
        found["gamma_sd"] = (up - down)[None] / 2
    return found


def _shifts_of_lights(
    observation: Photographs,
    channel: int,
    prediction: Prediction,
    samples: Samples,
    selection: Selection,
    turns: np.ndarray | None,
) -> dict[str, np.ndarray]:
    """(shifts, samples) DN, the change of a prediction by each kind of error of the lights."""
    known = {n: sd[selection.light] for n, sd in observation.uncertain.items() if np.any(sd)}
    relative = prediction.slope * prediction.signal
    along = {
        "intensity_sd": relative,
        "exposure_sd": relative,
        "stray_sd": prediction.slope * np.asarray(samples.geometry.irradiance),
    }
    found = {name: moved[None] * known[name] for name, moved in along.items() if name in known}
    if "direction_sd" in known:
        if turns is None:
            turns = np.zeros((len(observation.files), 2))
        found["direction_sd"] = shifts_of_turns(
            observation, turns, channel, prediction.vector, samples, selection
        )
    return found


def no_more_than(robust: Robustness, model: Float[np.ndarray, "parameters parameters"]) -> bool:
    """Whether the images' variances exceed a model's by no more than chance."""
    least = np.maximum(robust.freedom, 1)
    known = np.isfinite(robust.freedom)
    likely = np.where(known, chdtri(least, CHANCE / len(least)) / least, 1 + ROUNDING)
    return bool(np.all(np.diagonal(robust.covariance) <= likely * np.diagonal(model)))


def with_stated_errors(
    robust: Robustness,
    stated: StatedErrors,
    information: Float[np.ndarray, "parameters parameters"],
    known: Int[np.ndarray, " known"],
) -> Robustness:
    """Widen a covariance of the `known` parameters by the errors that the rig states, and adjust
    its degrees of freedom."""
    inverse = np.linalg.inv(information)
    covariance, freedom = robust.covariance, robust.freedom
    if len(stated.of_lights) or stated.slopes is not None:
        moved = stated.of_lights[:, known] @ inverse
        model = inverse + moved.T @ moved
        if no_more_than(robust, model):
            covariance, freedom = model, np.full(len(known), np.inf)
    moved = stated.common[:, known] @ inverse
    total = covariance + moved.T @ moved
    share = np.diagonal(covariance) / np.diagonal(total)
    return replace(robust, covariance=total, freedom=freedom / share**2)
