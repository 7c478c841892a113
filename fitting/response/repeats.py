"""Jackknife errors of a curve, over tiles of the picture and over exposures.

A jackknife repeats the fit without each tile, or without each exposure. For the fit without tile k,
the normal equations of the other tiles are added. For the fit without exposure j, the statistics of
a sample of pixels are computed again, because the mean of each pixel over exposures changes. From T
fits with the curves g_(k), the covariance of the curve is

    V = (T - 1) / T  sum_k (g_(k) - mean)(g_(k) - mean)^T.

Each jackknife covariance includes pixel noise. Pixel noise is subtracted from both, because the
covariance of the fit already includes it (two-way clustering: Cameron, Gelbach & Miller, J. Bus.
Econ. Stat. 29, 2011). The fit without an exposure predicts that exposure, and the error of the
prediction is an independent test.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int, Integer
from scipy.special import chdtri

from .code_bins import CodeBins
from .code_pairs import pair_statistics
from .pilot import Pilot
from .shutter import MOST_FREE, Shutter, mix_over_tau
from .solve import Hyperparameters, Solution, bin_centre_curve, inverse, solve
from .weights import predicted_weights, weighted_mean, weights_by_code

FEWEST_PREDICTING = 3  # exposures: leaving one out must leave two
FEWEST_EXPOSURES = 5  # of a jackknife: with fewer, the rest determines another part of the curve
FALSE_ALARM_PROBABILITY = 0.05  # probability of a false finding of excess variance
FAR = 12.0  # of the median error of a prediction, from which a pixel shows something else
GROUPS = 20  # of pixels of similar brightness, each with its own usual error
LEAST_USUAL = 0.5  # DN, of the median error
FEWEST_PREDICTED = 30  # fewest pixels for the prediction error of a left-out exposure


@dataclass(frozen=True)
class HeldOut:
    """The errors of predicting the codes of each exposure by a curve and a radiance that were
    fitted to the other exposures."""

    # rms error of each prediction, DN; NaN where too few pixels can be predicted
    rms: Float[np.ndarray, " exposures"]
    exposures: Float[np.ndarray, " exposures"]  # s
    # share of pixels whose error is far beyond that of most pixels, as where something moved; NaN
    # likewise
    far: Float[np.ndarray, " exposures"]

    @property
    def mean(self) -> float:
        """Rms prediction error over all exposures, DN."""
        return float(np.sqrt(np.nanmean(self.rms**2)))

    @property
    def standard_error(self) -> float:
        """Standard error of `mean`, from the scatter between exposures, DN."""
        square = self.rms[np.isfinite(self.rms)] ** 2
        if len(square) < 2:
            return float("nan")
        return float(np.std(square, ddof=1) / np.sqrt(len(square)) / (2 * self.mean))


@dataclass(frozen=True)
class Repeats:
    """The jackknife deviations of g at the centres of bins, scaled so that their products sum to a
    covariance."""

    departures: Float[np.ndarray, "fits bins"]  # scaled deviations of each fit from the mean of all
    pixels: Float[np.ndarray, " bins"]  # variance that the pixel noise explains

    @property
    def variance(self) -> Float[np.ndarray, " bins"]:
        return np.sum(self.departures**2, axis=0)

    def excess_variance(
        self, explained: Float[np.ndarray, " bins"], lost: int
    ) -> tuple[Float[np.ndarray, " bins"], int]:
        """Return significant variance beyond `explained`, else 0, and its degrees of freedom."""
        freedom = len(self.departures) - lost
        likely = chdtri(freedom, FALSE_ALARM_PROBABILITY) / freedom * explained
        return np.where(self.variance > likely, self.variance - explained, 0), freedom


def tile_jackknife(found: Solution, bins: CodeBins) -> Repeats | None:
    """Fit the curve without each tile; return the deviations, or None if there is only one tile."""
    if len(found.equations) < 2:
        return None
    tiles, phi = found.equations, found.used.design_effect
    matrix = np.sum([tile.matrix for tile in tiles], axis=0)
    right = np.sum([tile.right for tile in tiles], axis=0)
    size = len(found.means)
    fits = []
    for tile in tiles:
        covariance = inverse((matrix - tile.matrix) / phi + found.prior, bins)
        fits.append(bin_centre_curve((covariance @ (right - tile.right))[:size] / phi, bins))
    return Repeats(_jackknife(fits), _pixel_variance(found, matrix / phi, bins))


def exposure_jackknife(
    codes: Integer[np.ndarray, "exposures pixels"],
    classes: Int[np.ndarray, " pixels"],
    log_t: Float[np.ndarray, " exposures"],
    coarse: CodeBins,
    pilot: Pilot,
    hyper: Hyperparameters,
    bins: CodeBins,
    fraction: float,
) -> tuple[Repeats | None, HeldOut | None]:
    """Leave out one exposure at a time and fit the curve to the others. Return the deviations of
    these curves from their mean, and the errors with which each predicts the exposure left out;
    None if there are too few exposures."""
    if len(log_t) < FEWEST_PREDICTING:
        return None, None

    def fit_without(j: int | None) -> Solution:
        kept = np.arange(len(log_t)) != j
        offset = log_t[kept] + pilot.solution.delta[kept]
        part = pair_statistics(codes[kept], classes, offset, coarse, pilot.rule, pilot.means)
        part = replace(part, matrix=part.matrix / fraction, score=part.score / fraction)
        return solve([part], log_t[kept], coarse, hyper)

    fits = [fit_without(j) for j in range(len(log_t))]
    found = [_prediction_error(codes, log_t, j, fit, coarse, pilot) for j, fit in enumerate(fits)]
    rms, far = np.array(found).T
    held_out = HeldOut(rms, np.exp(log_t), far)
    if len(log_t) < FEWEST_EXPOSURES:
        return None, held_out
    whole = fit_without(None)
    departures = _jackknife([bin_centre_curve(fit.means, coarse) for fit in fits])
    matrix = whole.equations[0].matrix / hyper.design_effect**2 / fraction
    explained = 2 * _pixel_variance(whole, matrix, coarse)  # either exposure loses a pair
    fine, x = np.log(bins.centres - bins.black), np.log(coarse.centres - coarse.black)
    on_fine = Repeats(
        np.stack([np.interp(fine, x, row) for row in departures]), np.interp(fine, x, explained)
    )
    return on_fine, held_out


def widen(
    covariance: Float[np.ndarray, "bins bins"],
    shutter: Shutter,
    tiles: Repeats | None,
    exposures: Repeats | None,
) -> tuple[Float[np.ndarray, "bins bins"], Float[np.ndarray, " bins"]]:
    """Enlarge the covariance of g to the scatter between repeated fits, and return it with
    Satterthwaite's degrees of freedom for each bin. Three variances are added to the diagonal, and
    the correlations are retained: the jackknife variance over tiles in excess of pixel noise, the
    jackknife variance over exposures in excess of pixel noise and shutter errors, and the variance
    from shutter errors (`shutter.py`)."""
    parts = []
    if tiles is not None:
        parts.append(tiles.excess_variance(tiles.pixels, 1))
    if exposures is not None:
        parts.append(exposures.excess_variance(exposures.pixels + shutter.variance, 2))
    own = np.diagonal(covariance)
    repeated = own + sum(part for part, _ in parts)
    some = np.where(repeated > 0, repeated, 1)  # none at mid-scale, where g = 0 by definition
    share = sum(
        ((part / some) ** 2 / max(freedom, 1) for part, freedom in parts), np.zeros(len(own))
    )
    variance, freedom = mix_over_tau(repeated, 1 / np.maximum(share, MOST_FREE**-1), shutter)
    scale = np.sqrt(variance / np.where(own > 0, own, 1))
    return covariance * np.outer(scale, scale), freedom


def _jackknife(fits: Sequence[np.ndarray]) -> np.ndarray:
    stacked = np.stack(fits)
    return (stacked - stacked.mean(axis=0)) * np.sqrt((len(fits) - 1) / len(fits))


def _pixel_variance(found: Solution, noise: np.ndarray, bins: CodeBins) -> np.ndarray:
    """Return the variance of g at bin centres, from that of the equations' right-hand side."""
    size = len(found.means)
    rows = bin_centre_curve(found.covariance[:size], bins)
    return np.maximum(np.sum((rows @ noise) * rows, axis=1), 0)


def _usual_errors(
    missed: Float[np.ndarray, " pixels"], predicted: Float[np.ndarray, " pixels"]
) -> Float[np.ndarray, " pixels"]:
    """Return the median error of pixels of similar prediction, DN; at least the median of all."""
    usual = np.empty(len(missed))
    for group in np.array_split(np.argsort(predicted, kind="stable"), GROUPS):
        usual[group] = np.median(missed[group])
    return np.maximum(usual, np.median(missed))


def _prediction_error(
    codes: np.ndarray,
    log_t: np.ndarray,
    j: int,
    fit: Solution,
    coarse: CodeBins,
    pilot: Pilot,
) -> tuple[float, float]:
    """Return exposure j's rms prediction error, DN, and the share of pixels with large errors."""
    kept = np.arange(len(log_t)) != j
    g = np.maximum.accumulate(fit.means) + 1e-9 * np.arange(len(fit.means))
    binned, rule = coarse.lookup[codes], pilot.rule
    quietest = np.full(codes.shape[1], np.argmax(rule.by_bin.sum(axis=1)))
    rough = weights_by_code(rule, binned[kept], quietest)
    by_each = g[binned[kept]] - log_t[kept, None]
    weights, _ = predicted_weights(rule, rule.weight, rough, by_each, log_t[kept], quietest)
    weights = np.where(weights.any(axis=0), weights, rough)
    log_irradiance = weighted_mean(weights, by_each)
    predicted = np.interp(log_irradiance + log_t[j], g, coarse.centres)
    judged = (weights.sum(axis=0) > 0) & (binned[j] >= 0)
    if np.count_nonzero(judged) < FEWEST_PREDICTED:
        return float("nan"), float("nan")
    missed = np.abs(predicted - codes[j])[judged]
    usual = np.maximum(_usual_errors(missed, predicted[judged]), LEAST_USUAL)
    return float(np.sqrt(np.mean(missed**2))), float(np.mean(missed > FAR * usual))
