"""Errors of a prediction of measured reflectance, in both metrics, and the model of least error."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import bdtrc, stdtrit

from ..names import DESCRIBES, Model, Objective
from .fit import ModelFit, reflected
from .read import MeasuredBRDF

FEWEST_INCIDENCES = 3  # from which a difference has a standard error worth its name
SAME = 1e-6  # of an error: a smaller difference is where the solvers stopped, not the models'
NOTABLE = 1.05  # ratio of two errors from which an order of them is worth a word
LIKELY = 0.05  # chance up to which a model that errs more at most incidences is called worse
SMALLEST_ERROR = 1e-9  # of the signal's RMS: smaller errors are rounding, counted as this much


@dataclass(frozen=True)
class Errors:
    """Errors of one prediction.

    Attributes:
        rms: of f_r cos(theta_i), sr^-1.
        relative: over the RMS of what was measured.
        cube_root: RMS difference of the cube roots, sr^-1/3.
        by_incidence: (incidences,) `relative`, the RMS of both being that of each incidence's own
            samples.
        parts: (incidences, 2) what each adds to the squares of `rms` and `cube_root`.
    """

    rms: float
    relative: float
    cube_root: float
    by_incidence: Float[np.ndarray, " incidences"]
    parts: Float[np.ndarray, "incidences 2"]


def errors(measured: MeasuredBRDF, predicted: Float[np.ndarray, "n bands"]) -> Errors:
    """Both metrics of a prediction.

    What rounding alone misses counts as a billionth of the signal in either, so that no model wins
    by it.

    Args:
        measured: samples of one material.
        predicted: (n, bands) f_r, sr^-1.

    Returns:
        The errors.
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
    """The error that belongs to an objective, in the form a reader compares.

    Args:
        errors: of one prediction.
        objective: whose metric counts.

    Returns:
        Relative RMS, or sr^-1/3.
    """
    return errors.relative if objective == "cosine" else errors.cube_root


@dataclass(frozen=True)
class Ratio:
    """How many times as much one model errs as another.

    Attributes:
        value: of the whole errors.
        without: (incidences,) the same with each incidence left out.
        alone: (incidences,) the same of each by itself.
    """

    value: float
    without: Float[np.ndarray, " incidences"]
    alone: Float[np.ndarray, " incidences"]

    @property
    def told(self) -> bool:
        """Whether it differs from 1 by more than chance: its logarithm exceeds Student's 95 % of
        its standard error, the jackknife's over incidences."""
        count, log = len(self.without), abs(np.log(self.value))
        if count < FEWEST_INCIDENCES or log < SAME:
            return False
        error = np.sqrt((count - 1) * np.var(np.log(self.without)))
        return bool(log > stdtrit(count - 1, 0.975) * error)

    @property
    def more_often(self) -> int:
        """At how many incidences the model errs more that errs more on the whole."""
        logs = np.log(self.alone) * np.sign(np.log(self.value))
        return int(np.sum(logs > SAME))

    @property
    def chance(self) -> float:
        """That of two equal models one errs more at as many incidences (sign test, both sides)."""
        return min(2 * float(bdtrc(self.more_often - 1, len(self.alone), 0.5)), 1.0)

    @property
    def ordered(self) -> bool:
        """Whether the same model errs more at so many incidences that chance is unlikely. One that
        stands apart from the others may leave the size of a difference open, hence `told` false,
        and yet not its sign."""
        return self.chance <= LIKELY and abs(np.log(self.value)) >= np.log(NOTABLE)


def ratio(one: Errors, other: Errors, objective: Objective) -> Ratio:
    """The ratio of two models' errors of the same samples.

    Args:
        one: of a model.
        other: of another.
        objective: whose metric counts.

    Returns:
        The ratio; 1 of incidences where rounding is all that one of them misses.
    """
    value = metric(one, objective) / metric(other, objective)
    column = 0 if objective == "cosine" else 1
    ours, theirs = one.parts[:, column], other.parts[:, column]
    others = 1 - np.eye(len(ours))

    def of(ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
        exact = (ours <= 0) | (theirs <= 0)
        return np.sqrt(np.where(exact, 1, ours) / np.where(exact, 1, theirs))

    return Ratio(value, of(others @ ours, others @ theirs), of(ours, theirs))


def distinguished(one: Errors, other: Errors, objective: Objective) -> bool:
    """Whether two predictions of the same samples differ by more than chance: by `ratio`.

    Args:
        one: of a model.
        other: of another.
        objective: whose metric counts.

    Returns:
        Whether; never with fewer than three incidences.
    """
    return ratio(one, other, objective).told


def exceeds_signal(errors: Errors, objective: Objective) -> bool:
    """Whether a prediction misses more than one of no reflectance at all would.

    Args:
        errors: of one prediction.
        objective: whose metric counts.

    Returns:
        Whether; never of cube roots, whose errors are not relative to their signal.
    """
    return objective == "cosine" and errors.relative > 1


def describes(errors: Errors, objective: Objective) -> bool:
    """Whether a prediction tells most of the signal: its relative error is at most a half.

    Args:
        errors: of one prediction.
        objective: whose metric counts.

    Returns:
        Whether; always of cube roots, whose errors are not relative to their signal.
    """
    return objective != "cosine" or errors.relative <= DESCRIBES


def weight_by_incidence(
    measured: MeasuredBRDF, objective: Objective
) -> Float[np.ndarray, " incidences"]:
    """Share of each incidence in the sum of squares that a fit of nothing would have: what decides
    the fit.

    Args:
        measured: samples of one material.
        objective: of the fit.

    Returns:
        (incidences,), of sum 1.
    """
    signal = reflected(measured, measured.values)
    if objective == "cube-root":
        signal = np.cbrt(np.maximum(signal, 0))
    squares = measured.weights * (signal**2).mean(axis=1)
    return np.bincount(measured.incidence, squares, len(measured.incidences)) / squares.sum()


def prediction_of_held_out(measured: MeasuredBRDF, fit: ModelFit) -> Float[np.ndarray, "n bands"]:
    """f_r of every sample by the fit that has not seen its incidence.

    Args:
        measured: samples of one material.
        fit: of one model.

    Returns:
        (n, bands) sr^-1.
    """
    predicted = np.empty_like(measured.values)
    for i, without in enumerate(fit.without):
        own = measured.incidence == i
        predicted[own] = without.predicted[own]
    return predicted


def best(scores: Mapping[Model, Errors], objective: Objective) -> Model:
    """The model of least error in the metric of an objective; of equal ones the first.

    Args:
        scores: errors by model.
        objective: whose metric counts.

    Returns:
        Its name.
    """

    return min(scores, key=lambda model: metric(scores[model], objective))
