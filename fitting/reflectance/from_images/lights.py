"""Include errors that the rig states, above all those of lights, and estimate light directions from
the images.

An error e of one standard deviation changes the prediction of each sample by s. To first order, the
best parameters change by

    d theta = I^-1 p,    p = sum slope * s / deviation,

where `slope` is the gradient of the prediction in standard deviations, `deviation` the standard
deviation of a sample and I the Fisher information. Errors of one light (`intensity_sd`,
`exposure_sd`, `stray_sd`) shift only the samples of its image. The residuals contain these errors,
too. With few lights, the covariance from the stated errors therefore replaces the covariance over
lights, if the stated errors can explain the residuals. An error that all images share (`black_sd`,
`gamma_sd`) changes the images as a different surface would. The residuals do not reveal such
errors, so the covariance that these errors cause is added. The gain only weights the samples, so
`gain_sd` changes no parameter to first order. Errors that change the distribution of the samples by
at most a tenth of their noise are dropped (`inference.left_out`).

A rig's `direction_sd` is a normal prior for the rotations e of the lights, two for each light. The
joint covariance of lights measured on balls adds the logarithm of the intensity and, for a light
nearby, the distance to the errors e of each light. In units of standard deviations, the residuals r
of the images change by S e to first order. The most likely errors for given parameters are
therefore

    e = K^-1 S^T r,    K = P^-1 + S^T S,

where P is the prior covariance of all errors. P is the identity, or the joint covariance of lights
that were measured on one ball and share the error of its outline. Let J be the derivatives
of the predictions with respect to the parameters, and I the information about the parameters for
known directions. After marginalising over the rotations, the information about the parameters is

    I - J^T S K^-1 S^T J, where 1 - S K^-1 S^T = (1 + S P S^T)^-1.

A highlight is not a linear function of the direction of its light. If light directions with errors
of a degree are not corrected, the fit describes the mean of displaced highlights, which is wider
and weaker than each single highlight. All images are affected equally, so the scatter between
images does not reveal this bias. Rotations and parameters are therefore fitted in alternation, each
time linearised about the last values (Gauss-Newton).
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import block_diag, solve_triangular
from scipy.special import chdtri

from ...inference.clustering import Robustness
from ...inference.left_out import LeftOut, distance, negligible
from .optimum import Optimum, Spread, weighed, weighed_and_fitted
from .read import Photographs, across, angles
from .samples import (
    Grouping,
    Prediction,
    Samples,
    Selection,
    View,
    inverse_deviation,
    predict,
    scores_and_slopes,
)
from .signal import Form, Matrix, Vector

SHADOWED = -0.05  # n.l of a safe shadow
FEWEST_SHADOWED = 100  # pixels
SIGNIFICANT = 4.0  # standard errors from 0 of light in shadows that counts
EXPLAINED = 3.0  # stated errors of the black level that explain light in shadows
STEP = 0.5  # step of a slope to either side, standard deviations
LEAST_INFORMATION = 1e-12  # least information of an image on a rotation, in units of the prior's
MOST_TURNS = 10  # most updates of the lights' rotations
SETTLED = 0.05  # change of a light's direction at convergence, standard deviations
IMPLAUSIBLE = 1e-3  # probability of larger deviations if the stated errors are correct
WIDEST = 3.0  # ratio to the stated size from which the model has another misfit
ABSURD = 2 * WIDEST  # standard deviations of a single step, which later steps may reduce
ENOUGH = 20_000  # samples that determine the lights nearly as well as all samples
ROUNDING = 1e-9
CHANCE = 0.05  # probability of a false finding of larger errors

# two rotations, the logarithm of the intensity and the relative distance, or the first two or three
# of these, in units of their standard deviations unless stated
Turns = Float[np.ndarray, "lights errors"]
Shifts = Float[np.ndarray, "errors samples"]  # DN
Prior = Float[np.ndarray, "turns turns"]  # P, in these units; None where it is 1


# ---------------------------------------------------------------- directions


def turn_sizes(observation: Photographs) -> Turns:
    """Return the standard deviations of the errors of each light in `turn_prior`; without it, those
    of two rotations, rad.
    """
    names = "direction_sd", "direction_sd", "intensity_sd", "distance_sd"
    prior, lights = observation.turn_prior, len(observation.files)
    kept = 2 if prior is None else len(prior) // lights
    exact = np.zeros(lights)
    return np.stack([observation.uncertain.get(name, exact) for name in names[:kept]], axis=1)


def shift_lights(observation: Photographs, turns: Turns) -> Photographs:
    """Rotate the lights by two angles in rad, about axes perpendicular to each light's direction.
    Change the logarithm of their intensity by a third number, and their relative distance by a
    fourth, if there are any.
    """
    changes, aside = {}, np.einsum("la,lac->lc", turns[:, :2], across(observation.wi))[:, None]
    moved = observation.wi + aside
    if turns.shape[1] > 2:
        changes["intensity"] = observation.intensity * np.exp(turns[:, 2])
    if turns.shape[1] > 3:  # the rotated light, moved along its direction
        distance = observation.falloff[..., None] ** -0.5
        middle = observation.wi.mean(axis=1, keepdims=True)
        middle = middle / np.linalg.norm(middle, axis=-1, keepdims=True)
        step = (middle + aside) * np.exp(turns[:, 3, None, None]) - middle
        moved = distance * observation.wi + distance.mean(axis=1, keepdims=True) * step
        changes["falloff"] = np.sum(moved**2, axis=-1) ** -1.0
    moved /= np.linalg.norm(moved, axis=-1, keepdims=True)
    cosine, mirror = angles(observation.normals, moved)
    return replace(observation, wi=moved, cosine=cosine, mirror_angle=mirror, **changes)


def shifts_of_turns(view: View, turns: Turns, vector: Vector, samples: Samples) -> Shifts:
    """Return the change of each sample's prediction, (errors, samples) DN, by each error of its
    light of one standard deviation. The derivative is taken at the errors `turns`.
    """
    units = np.eye(turns.shape[1])

    def predict_turned(step: np.ndarray) -> np.ndarray:
        moved = _about(view, turns + step, samples.form)
        return predict(vector, replace(moved, gamma=samples.gamma)).dn

    moves = [predict_turned(STEP * unit) - predict_turned(-STEP * unit) for unit in units]
    return np.stack(moves) / (2 * STEP)


def _about(view: View, turns: Turns, form: Form) -> Samples:
    seen = shift_lights(view.observation, turns * turn_sizes(view.observation))
    return replace(view, observation=seen).samples(form)


def likeliest_turns(
    shifts: Shifts,
    turns: Turns,
    prediction: Prediction,
    samples: Samples,
    selection: Selection,
    prior: Prior | None,
) -> Turns:
    """Return the most likely errors of the lights, (lights, errors), for the parameters that are
    best for these errors. The prediction is linearised about the errors `turns` and the parameters.
    (With fixed parameters, the alternation would stop far from the optimum where parameters and
    errors change the prediction alike.)
    """
    moves, light = shifts * inverse_deviation(samples), selection.light
    left = (samples.dn - prediction.dn) * inverse_deviation(samples)
    left = left + np.einsum("as,sa->s", moves, turns[light])
    pulls = np.stack([np.bincount(light, m * left, len(turns)) for m in moves], axis=1)
    information = information_on_turns(shifts, samples, selection, len(turns))
    own = np.eye(turns.size) if prior is None else np.linalg.inv(prior)
    slopes = scores_and_slopes(prediction, samples)[1]
    both = np.array([[np.bincount(light, row * m, len(turns)) for m in moves] for row in slopes])
    both = np.swapaxes(both, 1, 2).reshape(len(slopes), -1)  # J^T S
    taken = both.T @ np.linalg.pinv(slopes @ slopes.T, hermitian=True)
    pulls = pulls.ravel() - taken @ (slopes @ left)
    return np.linalg.solve(own + information - taken @ both, pulls).reshape(turns.shape)


def information_on_turns(
    shifts: Shifts, samples: Samples, selection: Selection, lights: int
) -> Prior:
    """Return S^T S, the images' information on rotations, without the rig's prior."""
    moves = shifts * inverse_deviation(samples)
    products = [[np.bincount(selection.light, a * b, lights) for b in moves] for a in moves]
    return np.asarray(block_diag(*np.moveaxis(np.array(products), -1, 0)))


def marginalise_directions(
    values: Float[np.ndarray, "rows samples"],
    shifts: Shifts,
    samples: Samples,
    selection: Selection,
    lights: int,
    *,
    prior: Prior | None = None,
) -> Float[np.ndarray, "rows samples"]:
    """Return (1 + S P S^T)^(-1/2) x for slopes and errors x, (rows, samples) in standard
    deviations. The product of the results for x and for y equals x^T (1 - S K^-1 S^T) y, the
    product after marginalising over the light directions.
    """
    moves, light = shifts * inverse_deviation(samples), selection.light
    information = information_on_turns(shifts, samples, selection, lights)
    root = np.eye(len(information)) if prior is None else np.linalg.cholesky(prior)
    squares, axes = np.linalg.eigh(root.T @ information @ root)
    squares, axes = np.maximum(squares, LEAST_INFORMATION), root @ axes
    taken = (1 - 1 / np.sqrt(1 + squares)) / squares
    pulls = np.array([[np.bincount(light, row * m, lights) for m in moves] for row in values])
    pulls = np.swapaxes(pulls, 1, 2).reshape(len(values), -1)
    back = ((pulls @ axes) * taken @ axes.T).reshape(len(values), lights, -1)
    return values - np.einsum("as,rsa->rs", moves, back[:, light])


@dataclass(frozen=True)
class TurnedLights:
    """The light directions that were estimated from the images."""

    turns: Turns
    size: float  # rms of the rotations over the lights of uncertain direction
    # factor by which `direction_sd` was increased because the rotations are too large for chance
    widened: float = 1.0

    @property
    def followed(self) -> bool:
        """Return whether the fit uses the estimated directions. If the estimated directions are too
        far from those of the rig, the model fails for another reason, and the fit uses the rig's
        directions.
        """
        return self.size <= WIDEST


def fit_rotations(
    nominal: Optimum, view: View, grouping: Grouping, sensor: Spread | None
) -> tuple[Optimum, TurnedLights]:
    """Fit parameters and light rotations in alternation until no light moves. If the stated
    uncertainty and chance cannot explain rotations of this size, the uncertainty is estimated from
    the images.

    Return `nominal`, the optimum at the rig's directions, if the fit does not use the rotations.
    """
    observation = view.observation
    known = (observation.uncertain["direction_sd"] > 0) & ~observation.held_out
    errors = turn_sizes(observation).shape[1]
    seen = errors * int(np.count_nonzero(known))
    most = float(np.sqrt(chdtri(seen, IMPLAUSIBLE) / seen))
    root = np.eye(seen)
    if observation.turn_prior is not None:
        both = np.repeat(known, errors)
        root = np.linalg.cholesky(observation.turn_prior[np.ix_(both, both)])

    def size(turns: np.ndarray) -> float:
        return _rms(solve_triangular(root, turns[known].ravel(), lower=True))

    found, turns = _consistent_turns(nominal, view, known, grouping, sensor)
    lights = TurnedLights(turns, size(turns))
    if most < lights.size <= WIDEST:
        widened = lights.size
        wider = replace(view, observation=widen_directions(observation, widened))
        found, turns = _consistent_turns(nominal, wider, known, grouping, sensor)
        lights = TurnedLights(widened * turns, widened * size(turns), widened)
    return (found if lights.followed else nominal), lights


def widen_directions(observation: Photographs, factor: float) -> Photographs:
    """Return the photographs with the sizes of `turn_sizes` multiplied by a factor."""
    kept = turn_sizes(observation).shape[1] - 1
    names = ("direction_sd", "intensity_sd", "distance_sd")[:kept]
    wider = {name: factor * observation.uncertain[name] for name in names}
    return replace(observation, uncertain=observation.uncertain | wider)


def _consistent_turns(
    nominal: Optimum, view: View, known: np.ndarray, grouping: Grouping, sensor: Spread | None
) -> tuple[Optimum, Turns]:
    """Alternate between the search for the best parameters and the search for the rotations until
    neither changes, and return both. With many samples, a subset is used until no light moves, and
    then all samples in two more iterations. The iteration stops if lights move too far.
    """
    found, turns = nominal, np.zeros_like(turn_sizes(view.observation))
    step, prior = max(1, len(view.selection.light) // ENOUGH), view.observation.turn_prior
    stages = [(view, MOST_TURNS)]
    if step > 1:
        stages = [(view.every_nth_pixel(step), MOST_TURNS), (view, 2)]
    for seen, rounds in stages:
        if step > 1:
            samples = _about(seen, turns, found.samples.form)
            samples, _, _, prediction = weighed(found.vector, samples, sensor)
            found = replace(found, samples=samples, prediction=prediction)
        for _ in range(rounds):
            vector, samples, before = found.vector, found.samples, turns
            shifts = shifts_of_turns(seen, before, vector, samples)
            turns = likeliest_turns(
                shifts, before, found.prediction, samples, seen.selection, prior
            )
            if _rms(turns[known]) > ABSURD:
                return nominal, turns
            found = weighed_and_fitted(vector, _about(seen, turns, samples.form), grouping, sensor)
            if np.abs(turns - before).max() < SETTLED:
                break
    return found, turns


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


# ---------------------------------------------------------------- stated errors


@dataclass(frozen=True)
class StatedErrors:
    """The vectors p (see the module docstring) of the errors that a rig states, each for an error
    of one standard deviation.
    """

    of_lights: Float[np.ndarray, "errors parameters"]  # each error affects one image
    common: Float[np.ndarray, "more parameters"]  # each error affects all images
    # derivatives of the predictions, in standard deviations, after marginalising over the light
    # directions; None if these are not fitted
    slopes: Float[np.ndarray, "parameters samples"] | None = None
    # gradients of the log likelihood after marginalising; None if lights are independent, because
    # the sums over the samples of a light are then those without marginalising
    scores: Float[np.ndarray, "parameters samples"] | None = None
    # errors that the rig states and that are too small to matter
    left_out: tuple[LeftOut, ...] = ()

    def marginal_information(self, information: Matrix) -> Matrix:
        """Return the (P, P) information about the parameters after marginalising over light
        directions.

        The result is the Gauss-Newton information. The exact curvature of the likelihood is
        unsuitable for a model with a misfit, because it may not be positive definite after
        marginalising over the light directions.
        """
        return information if self.slopes is None else self.slopes @ self.slopes.T


def stated_errors(
    view: View, prediction: Prediction, samples: Samples, turns: Turns | None
) -> StatedErrors:
    """Return the vectors p (see the module docstring) of all stated errors that are not negligible.
    `turns` are the errors (lights, errors) of the samples' lights, if these were fitted.
    """
    observation, light, lights = view.observation, view.selection.light, view.lights
    sizes, count = observation.uncertain, len(prediction.vector)
    deviation = np.asarray(samples.deviation, np.float64)

    def sum_by_light(values: np.ndarray) -> np.ndarray:
        return np.bincount(light, values, lights)

    # DN, (shifts, samples): the change of the prediction by each error of one standard deviation
    relative = prediction.slope * prediction.signal
    stray = prediction.slope * np.asarray(samples.geometry.irradiance)
    along = {"intensity_sd": relative, "exposure_sd": relative, "stray_sd": stray}
    if turn_sizes(observation).shape[1] > 2:
        del along["intensity_sd"]  # one of the turns
    own = {n: (sizes[n][light] * s)[None] for n, s in along.items() if np.any(sizes.get(n, 0))}
    if np.any(sizes.get("direction_sd", 0)):
        about = np.zeros_like(turn_sizes(observation)) if turns is None else turns
        own["direction_sd"] = shifts_of_turns(view, about, prediction.vector, samples)
    shared = {}
    glow = light_in_shadows(observation, view.channel)
    glow = 0.0 if glow is None or samples.form.ambient else glow
    if abs(glow) < EXPLAINED * observation.black_sd:
        glow = 0.0
    if observation.black_sd or glow:
        black = np.hypot(observation.black_sd, glow)
        shared["black_sd"] = np.full((1, len(samples.dn)), black)
    if observation.gamma_sd and samples.gamma is not None:
        up, down = (
            predict(prediction.vector, replace(samples, gamma=samples.gamma + step)).dn
            for step in (observation.gamma_sd, -observation.gamma_sd)
        )
        shared["gamma_sd"] = (up - down)[None] / 2
    squares = {n: ((s / deviation) ** 2).sum(axis=0) for n, s in (own | shared).items()}
    gone = negligible(
        [LeftOut(n, float(np.median(sizes[n])), distance(sum_by_light(squares[n]))) for n in own]
        + [LeftOut(n, getattr(observation, n), distance(squares[n].sum())) for n in shared]
    )
    turnable = own.pop("direction_sd", None) if turns is not None else None
    for error in gone:
        own.pop(error.name, None)
        shared.pop(error.name, None)
        turnable = None if error.name == "direction_sd" else turnable

    def marginalise_turns(values: np.ndarray) -> np.ndarray:
        if turnable is None:
            return values
        prior = observation.turn_prior
        return marginalise_directions(
            values, turnable, samples, view.selection, lights, prior=prior
        )

    gradients, slopes = scores_and_slopes(prediction, samples)
    slopes, scores = marginalise_turns(slopes), None
    if turnable is not None and turns is not None and observation.turn_prior is not None:
        weight = inverse_deviation(samples)
        left = (samples.dn - prediction.dn) + np.einsum("as,sa->s", turnable, turns[light])
        scores = np.where(weight > 0, slopes * marginalise_turns((left * weight)[None]), gradients)
    of_lights = [
        np.stack([sum_by_light(row * shift) for row in slopes], axis=1)
        for shifts in own.values()
        for shift in marginalise_turns(shifts / deviation)
    ]
    common = [
        slopes @ shift
        for shifts in shared.values()
        for shift in marginalise_turns(shifts / deviation)
    ]
    return StatedErrors(
        np.concatenate(of_lights) if of_lights else np.empty((0, count)),
        np.array(common).reshape(-1, count),
        None if turnable is None else slopes,
        scores,
        tuple(error for error in gone if error.size != 0),  # 0: light in shadows, not stated
    )


def light_in_shadows(observation: Photographs, channel: int) -> float | None:
    """Return the mean signal in attached shadows, which no light of the rig reaches, in DN above
    black. Return None for encoded files and where too few pixels are in shadow.

    A wrong black level, stray light or interreflection may add the same signal to lit pixels. The
    fit cannot distinguish such a signal from another surface, so intervals include its effect, as
    they do for `black_sd`.
    """
    light, pixel = np.nonzero(observation.cosine < SHADOWED)
    if observation.gamma is not None or len(light) < FEWEST_SHADOWED:
        return None
    dark = observation.dn[channel, light, pixel] - observation.black
    mean = float(dark.mean())
    return mean if abs(mean) > SIGNIFICANT * dark.std() / np.sqrt(dark.size) else 0.0


def no_more_than(robust: Robustness, model: Matrix) -> bool:
    """Return whether the images' variances exceed a model's by no more than chance."""
    least = np.maximum(robust.freedom, 1)
    known = np.isfinite(robust.freedom)
    likely = np.where(known, chdtri(least, CHANCE / len(least)) / least, 1 + ROUNDING)
    return bool(np.all(np.diagonal(robust.covariance) <= likely * np.diagonal(model)))


def add_stated_errors(
    robust: Robustness, stated: StatedErrors, information: Matrix, known: Int[np.ndarray, " known"]
) -> Robustness:
    """Widen the `known` covariance, and its degrees of freedom, by stated errors."""
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
