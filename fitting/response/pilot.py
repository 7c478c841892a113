"""Pilot fit to a sample of pixels with few bins: a first curve, the noise models and the
hyperparameters."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int, Integer
from scipy.interpolate import CubicSpline
from scipy.ndimage import median as labelled_median
from scipy.optimize import nnls

from jaxvision.errors import InputError

from .code_bins import CodeBins, interval_variance
from .code_pairs import PairStatistics, pair_statistics
from .solve import MOST_ROUNDS, SMOOTHEST, STEADIEST, Hyperparameters, Solution, solve
from .weights import (
    NoiseModel,
    Observations,
    WeightRule,
    coarsest,
    hat_rule,
    noise_rule,
    observe,
)

PASSES = 4
KEPT = 0.3  # smallest share of a class's pixels that its noise model must keep
FIRST_SMOOTHNESS = 300.0  # the median of the 201 measured curves
FIRST_ERROR = 0.01  # of the shutter
SLOWEST = 3.0  # largest factor by which a response may rise more slowly than a linear one
LOG_ODDS = 10.0  # log evidence that a bent curve needs over a smoother one
MOST_CELLS, FEWEST_CELLS = 48, 6  # cells of predicted exposure for a noise model: most, fewest
REWEIGHTED = 4  # fits of a noise model, each with weights from the fit before
IN_CELL, FEWEST_IN_CELL = 40, 10  # observations per cell: intended, and least that counts
NO_CURVE = (
    "the images agree on no response curve; check the exposure times, the black level, that "
    "neither scene nor camera moved, and that the images are not mostly noise."
)
WINSOR = 9 / 0.4549  # three standard deviations, squared, over a squared normal's median


@dataclass(frozen=True)
class Pilot:
    """The results of the pilot fit."""

    means: Float[np.ndarray, " bins"]  # means of the rising curve over coarse bins
    # noise model of each class of steepness; None for classes whose pixels no noise model fits
    noises: tuple[NoiseModel | None, ...]
    rule: WeightRule  # the weights of observations, computed from these noise models
    solution: Solution  # the posterior of the last of the four passes


def fit_pilot(
    codes: Integer[np.ndarray, "exposures pixels"],
    classes: Int[np.ndarray, " pixels"],
    log_t: Float[np.ndarray, " exposures"],
    bins: CodeBins,
    *,
    least_error: float = STEADIEST,
) -> Pilot:
    """Fit the pilot curve in four passes, the first with weights of Debevec & Malik."""
    x = bins.log_codes
    means, binned = x - x[bins.middle], bins.lookup[codes]
    count = int(classes.max()) + 1
    full = np.bincount(classes, minlength=count)
    noises: list[NoiseModel | None] = [None] * count
    rule, alive = hat_rule(bins, classes=count), full > 0
    hyper, offset_t, found = Hyperparameters(FIRST_SMOOTHNESS, STEADIEST), log_t, None
    for turn in range(PASSES):
        statistics = pair_statistics(codes, classes, offset_t, bins, rule, means)
        free = degrees_of_freedom(statistics)
        misfit = max(1.0, statistics.chi_square / free) if turn else 1.0  # of the models
        hyper = replace(hyper, design_effect=misfit)
        rounds = MOST_ROUNDS if turn == PASSES - 1 else 1
        found = solve([statistics], log_t, bins, hyper, least_error=least_error, rounds=rounds)
        if rounds > 1:
            # The smoothness has two fixed points if the residual of the score's corrections looks
            # like curvature. The smoother curve is taken unless the images clearly support the
            # other.
            smooth = replace(hyper, smoothness=SMOOTHEST)
            other = solve([statistics], log_t, bins, smooth, least_error=least_error, rounds=rounds)
            rises = min(np.ptp(found.means), np.ptp(other.means)) > np.ptp(x) / SLOWEST
            if rises and other.log_evidence > found.log_evidence - LOG_ODDS:
                found = other
        means = make_rising(found.means, bins)
        offset_t = log_t + found.delta
        hyper = found.suggested if turn else Hyperparameters(FIRST_SMOOTHNESS, FIRST_ERROR)
        seen = observe(binned, classes, offset_t, means, rule, screened=False)
        # If a class loses more of its pixels, their errors are not noise.
        alive &= np.bincount(seen.classes, minlength=count) >= KEPT * full
        if not alive.any():
            raise InputError(NO_CURVE)
        noises = [
            fit_noise(seen, seen.classes == kind, offset_t, means) if alive[kind] else None
            for kind in range(count)
        ]
        rule = noise_rule(noises, means, coarsest=coarsest(log_t))
    assert found is not None
    return Pilot(means, tuple(noises), rule, found)


def degrees_of_freedom(statistics: PairStatistics) -> float:
    """Return the number of observations minus the number of pixels; refuse 0 and less."""
    free = float(statistics.observations.sum() - statistics.pixels)
    if free <= 0:
        raise InputError(NO_CURVE)
    return free


def make_rising(means: Float[np.ndarray, " bins"], bins: CodeBins) -> Float[np.ndarray, " bins"]:
    """Enforce increasing bin means, with at least a third of the slope of a linear response."""
    floor = bins.log_codes / SLOWEST
    return np.maximum.accumulate(means - floor) + floor


def rebin(
    means: Float[np.ndarray, " bins"], bins: CodeBins, other: CodeBins
) -> Float[np.ndarray, " others"]:
    """Interpolate a curve, given by its means over bins of codes, to other bins."""
    spline = CubicSpline(bins.log_codes, means)
    return spline(other.log_codes)


def fit_noise(
    seen: Observations,
    of_class: Bool[np.ndarray, " pixels"],
    log_t: Float[np.ndarray, " exposures"],
    means: Float[np.ndarray, " bins"],
) -> NoiseModel:
    """Fit the three variances of a noise model to one class of pixels by non-negative least
    squares. The data are the mean squared residuals in cells of predicted log exposure, clipped at
    three standard deviations."""
    used = (seen.weights > 0) & of_class
    predicted = (seen.log_irradiance + log_t[:, None])[used]
    free = (1 - seen.weights / seen.total)[used]
    count_of_cells = int(np.clip(len(predicted) // IN_CELL, FEWEST_CELLS, MOST_CELLS))
    edges = np.linspace(predicted.min(), predicted.max() + 1e-9, count_of_cells + 1)
    cells = np.digitize(predicted, edges) - 1
    count = np.bincount(cells, free, count_of_cells)
    filled = count > FEWEST_IN_CELL
    square = seen.residuals[used] ** 2 / np.maximum(free, 1e-3)
    limit = labelled_median(square, cells, np.arange(count_of_cells))
    square = np.minimum(square, WINSOR * limit[cells])
    measured = np.bincount(cells, square * free, count_of_cells)[filled] / count[filled]
    centre = ((edges[1:] + edges[:-1]) / 2)[filled]
    interval = np.interp(centre, means, interval_variance(means))
    terms = np.exp(-centre[:, None] * np.arange(3))
    # The fit minimises relative errors, so that a few cells full of misfit do not set the noise of
    # all cells. Errors are relative to the model, because errors relative to the data favour small
    # values.
    expected, found = measured, np.zeros(terms.shape[1])
    for _ in range(REWEIGHTED):
        precision = np.sqrt(count[filled]) / np.maximum(expected, 1e-12)
        found = nnls(terms * precision[:, None], (measured - interval) * precision)[0]
        expected = terms @ found + interval
    return NoiseModel(*(float(x) for x in found))
