"""Errors of a prediction of measured reflectance, in both metrics, and the model of least error."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..names import Model, Objective
from .fit import ModelFit, reflected
from .read import MeasuredBRDF

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
    """

    rms: float
    relative: float
    cube_root: float
    by_incidence: Float[np.ndarray, " incidences"]


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
    )


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

    def metric(model: Model) -> float:
        return scores[model].rms if objective == "cosine" else scores[model].cube_root

    return min(scores, key=metric)
