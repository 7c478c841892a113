"""Compute the errors of predicted reflectance in both metrics, and compare models by them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.special import bdtrc, stdtrit

from ..models import REFLECTANCES
from ..names import DESCRIBES, Axis, Model, Objective
from .fit import ModelFit, OfSamples, reflected
from .read import MeasuredBRDF

FEWEST_INCIDENCES = 3  # incidences needed for the standard error of a difference
SAME = 1e-6  # relative difference of errors below which it comes from the solvers' tolerance
NOTABLE = 1.05  # ratio of two errors from which their order is reported
LIKELY = 0.05  # p-value up to which a model with larger errors at most incidences is called worse
SMALLEST_ERROR = 1e-9  # of the signal's RMS: smaller errors are rounding, counted as this much
METRICS: dict[Objective, str] = {"cosine": "cosine-weighted RMS", "cube-root": "cube-root error"}
Side = Literal["half", "mirror", "neither"]  # which axis wins a comparison
OfIncidences = Float[np.ndarray, " incidences"]


@dataclass(frozen=True)
class Errors:
    """The errors of one model's prediction."""

    rms: float  # of f_r cos(theta_i), sr^-1
    relative: float  # `rms` over the RMS of the measured values
    cube_root: float  # RMS difference of the cube roots, sr^-1/3
    # `relative` of the samples of each incidence alone
    by_incidence: OfIncidences
    # contribution of each to the squares of `rms` and `cube_root`
    parts: Float[np.ndarray, "incidences 2"]


def errors(measured: MeasuredBRDF, predicted: OfSamples) -> Errors:
    """Return both error metrics of a prediction of f_r in sr^-1. Errors below a billionth of the
    signal are set to a billionth of the signal, so that rounding does not decide between models.
    """
    signal = reflected(measured, measured.values)
    missed = reflected(measured, predicted) - signal
    roots, root_signal = (
        np.cbrt(np.maximum(reflected(measured, v), 0)) for v in (predicted, measured.values)
    )

    def mean_square(x: np.ndarray, chosen: slice | np.ndarray = slice(None)) -> float:
        return float(np.average((x[chosen] ** 2).mean(axis=1), weights=measured.weights[chosen]))

    of_incidence = [measured.incidence == i for i in range(len(measured.incidences))]
    weights = [measured.weights[own].sum() / measured.weights.sum() for own in of_incidence]
    parts = [
        [share * mean_square(missed, own), share * mean_square(roots - root_signal, own)]
        for share, own in zip(weights, of_incidence, strict=True)
    ]
    rms, cube_root = np.sqrt(mean_square(missed)), np.sqrt(mean_square(roots - root_signal))
    scale = np.sqrt(mean_square(signal))
    if rms < SMALLEST_ERROR * scale:
        rms, cube_root = SMALLEST_ERROR * scale, SMALLEST_ERROR * np.sqrt(mean_square(root_signal))
    return Errors(
        rms=rms,
        relative=rms / scale,
        cube_root=cube_root,
        by_incidence=np.sqrt(
            [mean_square(missed, own) / mean_square(signal, own) for own in of_incidence]
        ),
        parts=np.array(parts),
    )


def metric(errors: Errors, objective: Objective) -> float:
    """Return the error in the metric of an objective: relative RMS, or sr^-1/3."""
    return errors.relative if objective == "cosine" else errors.cube_root


def format_error(errors: Errors, objective: Objective) -> str:
    """Return an error in words: in per cent of the signal, or in sr^(-1/3) for cube roots."""
    value = metric(errors, objective)
    return f"{100 * value:.3g} %" if objective == "cosine" else f"{value:.3g} sr⁻¹ᐟ³"


@dataclass(frozen=True)
class Ratio:
    """The ratio of the errors of two models."""

    value: float  # ratio of the errors of all incidences
    without: OfIncidences  # the same with each incidence left out
    alone: OfIncidences  # the same of each incidence alone

    @property
    def significant(self) -> bool:
        """Return whether the ratio differs significantly from 1: whether its logarithm exceeds
        Student's 95 % limit times the standard error of the logarithm, by the jackknife over
        incidences.
        """
        count, log = len(self.without), abs(np.log(self.value))
        if count < FEWEST_INCIDENCES or log < SAME:
            return False
        error = np.sqrt((count - 1) * np.var(np.log(self.without)))
        return bool(log > stdtrit(count - 1, 0.975) * error)

    @property
    def more_often(self) -> int:
        """Return at how many incidences the model of larger total error is also worse."""
        logs = np.log(self.alone) * np.sign(np.log(self.value))
        return int(np.sum(logs > SAME))

    @property
    def chance(self) -> float:
        """Return the two-sided p-value of a sign test: the chance that, of two equally good models,
        one has the larger error at this many incidence angles.
        """
        return min(2 * float(bdtrc(self.more_often - 1, len(self.alone), 0.5)), 1.0)

    @property
    def ordered(self) -> bool:
        """Return whether the same model has the larger error at so many incidences that chance is
        unlikely. A single outlier may make the size of the difference uncertain, so that
        `significant` is False, although the sign of the difference is certain.
        """
        return self.chance <= LIKELY and abs(np.log(self.value)) >= np.log(NOTABLE)


def ratio(one: Errors, other: Errors, objective: Objective) -> Ratio:
    """Return the ratio of two models' errors; 1 where one has only rounding errors."""
    value = metric(one, objective) / metric(other, objective)
    column = 0 if objective == "cosine" else 1
    ours, theirs = one.parts[:, column], other.parts[:, column]
    others = 1 - np.eye(len(ours))

    def ratio_of_sums(ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
        exact = (ours <= 0) | (theirs <= 0)
        return np.sqrt(np.where(exact, 1, ours) / np.where(exact, 1, theirs))

    return Ratio(value, ratio_of_sums(others @ ours, others @ theirs), ratio_of_sums(ours, theirs))


def exceeds_signal(errors: Errors, objective: Objective) -> bool:
    """Return whether a prediction's error exceeds that of predicting zero. The result is False for
    cube roots, whose errors are not relative to their signal.
    """
    return objective == "cosine" and errors.relative > 1


def describes(errors: Errors, objective: Objective) -> bool:
    """Return whether the error of a prediction is at most half of the signal. The result is True
    for cube roots, whose errors are not relative to their signal.
    """
    return objective != "cosine" or errors.relative <= DESCRIBES


def winner_of(half: Errors, mirror: Errors, objective: Objective) -> Side:
    """Return the lobe axis with the significantly smaller error, half vector or mirror direction.
    The result is "neither" if the difference is insignificant or neither model describes the data.
    """
    useless = exceeds_signal(half, objective) and exceeds_signal(mirror, objective)
    if useless or not ratio(half, mirror, objective).significant:
        return "neither"
    return "half" if metric(half, objective) < metric(mirror, objective) else "mirror"


def weight_by_incidence(measured: MeasuredBRDF, objective: Objective) -> OfIncidences:
    """Return the share of each incidence in the sum of squares of the data."""
    signal = reflected(measured, measured.values)
    if objective == "cube-root":
        signal = np.cbrt(np.maximum(signal, 0))
    squares = measured.weights * (signal**2).mean(axis=1)
    return np.bincount(measured.incidence, squares, len(measured.incidences)) / squares.sum()


def prediction_of_held_out(measured: MeasuredBRDF, fit: ModelFit) -> OfSamples:
    """Return f_r, sr^-1, of every sample by the fit to the other incidences."""
    predicted = np.empty_like(measured.values)
    for i, without in enumerate(fit.without):
        own = measured.incidence == i
        predicted[own] = without.predicted[own]
    return predicted


def best(scores: Mapping[Model, Errors], objective: Objective) -> Model:
    """Return the model, the first of equals, with the smallest error by an objective."""
    return min(scores, key=lambda model: metric(scores[model], objective))


def best_about_axis(scores: Mapping[Model, Errors], axis: Axis, objective: Objective) -> Model:
    """Return the best model among those with a lobe about one axis.

    Args:
        scores: errors by model.
        axis: axis of the lobe.
        objective: objective whose metric decides.

    Returns:
        The name of the best model.
    """
    own: dict[Model, Errors] = {m: e for m, e in scores.items() if REFLECTANCES[m].axis == axis}
    return best(own, objective)
