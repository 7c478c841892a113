"""Bayesian fit of the curve and the shutter errors to the code-pair statistics, with a smoothness
prior.

In the prior, the local exponent dg / d ln(z - black) of the curve g(z) is a random walk along a
scale of codes, whose derivative is `CodeBins.pace`. On this scale each of the 201 measured curves
of Grossberg & Nayar (2003) is about equally rough at all codes. A pure gamma has a constant
exponent, so its prior energy is 0. If the black level has the standard deviation `black_sd`, a
gamma curve that is bent by an error b of the black level has the prior energy (b / black_sd)^2 / 2.
The precision of the prior and the shutter error tau maximise the marginal likelihood (MacKay's
fixed point, Neural Computation 4, 1992).

Pixels with common errors contain less information than independent pixels. Let A be the information
matrix of the pixels (`code_pairs.py`), and u_k the gradient of tile k's chi^2 / 2 at the fitted
curve. Then

    phi = tr(C sum u_k u_k^T) / tr(C A) >= 1,    C = (A / phi + prior)^-1,

is the factor (the design effect of survey sampling) by which A overstates the information. The
design effect phi is at least the number of pixels over `COUNTED`, because the error that remains
after the score's corrections is the same in all pixels. Without this limit, a fit to very many
pixels would treat this error as roughness of the curve. For simulated cameras of 700,000 pixels
without the limit, the 95 % bands covered the true curve at only 20 to 90 % of the codes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import cho_factor, cho_solve

from jaxvision.errors import InputError

from .code_bins import CodeBins
from .code_pairs import PairStatistics

SMOOTHEST = 1e8  # precision at which the exponent is constant to a few parts in 10,000
ROUGHEST = 30.0  # a tenth of the median of the 201 measured curves; a rougher curve is a misfit
MOST_ROUNDS = 30  # updates of the hyperparameters
LOG_TOLERANCE = 0.05  # step of the logarithm of the smoothness at which it has converged
STEADIEST, SHAKIEST = 1e-6, 0.2  # smallest assumed and largest accepted error of ln t
COUNTED = 1 << 14  # number of pixels beyond which more pixels do not reduce the errors
# Shutter error above which smoothly varying offsets count as a misfit of the curve
SHUTTER_ERROR_LIMIT = 0.02


@dataclass(frozen=True)
class Hyperparameters:
    """Parameters that are estimated together with a curve."""

    smoothness: float  # precision of the prior
    shutter_error: float  # tau, rms of the errors of ln t
    design_effect: float = 1.0  # phi, the factor by which the pixels overstate the information


@dataclass(frozen=True)
class Equations:
    """The normal equations for the unknowns (bin means of g, visible shutter errors)."""

    matrix: Float[np.ndarray, "unknowns unknowns"]  # left-hand side
    right: Float[np.ndarray, " unknowns"]  # right-hand side


@dataclass(frozen=True)
class Solution:
    """The Gaussian posterior of the bin means of g and the visible shutter errors, and
    hyperparameters for the next iteration.

    Attributes:
        means: (bins,) means of g over the bins.
        free: (free,) visible shutter errors d.
        covariance: (unknowns, unknowns) covariance C of both.
        basis: (exposures, free) basis of the visible shutter errors: delta = basis d.
        used: hyperparameters with which this solution was computed.
        suggested: updated hyperparameters for the next iteration.
        equations: normal equations of each tile of the picture.
        prior: (unknowns, unknowns) precision of the prior.
        clustering: phi as estimated from the tiles, before its lower limit is applied.
        log_evidence: log marginal likelihood of the hyperparameters used, up to a constant that is
            the same for all hyperparameters.
    """

    means: Float[np.ndarray, " bins"]
    free: Float[np.ndarray, " free"]
    covariance: Float[np.ndarray, "unknowns unknowns"]
    basis: Float[np.ndarray, "exposures free"]
    used: Hyperparameters
    suggested: Hyperparameters
    equations: tuple[Equations, ...]
    prior: Float[np.ndarray, "unknowns unknowns"]
    clustering: float
    log_evidence: float

    @property
    def delta(self) -> Float[np.ndarray, " exposures"]:
        """The shutter errors delta of the exposures, in ln t."""
        return self.basis @ self.free

    @property
    def free_covariance(self) -> Float[np.ndarray, "free free"]:
        return self.covariance[len(self.means) :, len(self.means) :]


def exponent_increments(bins: CodeBins) -> Float[np.ndarray, "rows bins"]:
    """Return the matrix D of scaled increments of the exponent dg / d ln(z - black)."""
    z, step = bins.centres, 1 / np.diff(bins.log_codes)
    clock = (z[2:] - z[:-2]) / 2 * bins.pace(z[1:-1])
    rows = np.arange(len(z) - 2)
    increments = np.zeros((len(rows), len(z)))
    for place, value in enumerate((step[:-1], -step[:-1] - step[1:], step[1:])):
        increments[rows, rows + place] = value / np.sqrt(clock)
    return increments


def shutter_basis(log_t: Float[np.ndarray, " exposures"]) -> Float[np.ndarray, "exposures free"]:
    """Return an orthonormal basis of errors that are no common factor or exponent."""
    absorbed = np.stack([np.ones_like(log_t), log_t], axis=1)
    return np.linalg.svd(absorbed)[0][:, 2:]


def solve(
    tiles: Sequence[PairStatistics],
    log_t: Float[np.ndarray, " exposures"],
    bins: CodeBins,
    start: Hyperparameters,
    *,
    least_error: float = STEADIEST,
    rounds: int = 1,
) -> Solution:
    """Solve for curve and shutter errors; update the hyperparameters once a round."""
    basis = shutter_basis(log_t)
    equations = tuple(equations_of(tile, log_t, basis) for tile in tiles)
    matrix = np.sum([tile.matrix for tile in equations], axis=0)
    right = np.sum([tile.right for tile in equations], axis=0)
    increments, size = exponent_increments(bins), len(bins.centres)
    rough = increments.T @ increments
    moved = _shift_by_black(bins, matrix[:size, :size], right[:size])
    pull = rough @ moved
    curve, errors = slice(0, size), slice(size, None)
    free, least_effect = basis.shape[1], sum(tile.pixels for tile in tiles) / COUNTED
    hyper = replace(start, design_effect=max(start.design_effect, least_effect))
    while True:
        believed = min(hyper.shutter_error, max(SHUTTER_ERROR_LIMIT, least_error))
        prior = np.zeros_like(matrix)
        # The energy of g - a moved: with a ~ N(0, 1) marginalised, and at the most likely a.
        gained = 1 + hyper.smoothness * (pull @ moved)
        of_black = np.outer(pull, pull) * hyper.smoothness / gained
        energy, rest = rough - of_black, rough - of_black * (1 + 1 / gained)
        prior[curve, curve] = hyper.smoothness * energy
        prior[errors, errors] = np.eye(free) / believed**2
        covariance = inverse(matrix / hyper.design_effect + prior, bins)
        mean = covariance @ right / hyper.design_effect
        g, d = mean[curve], mean[errors]
        taken_up = hyper.smoothness * np.sum(rest * covariance[curve, curve])
        determined = max(size - 3 + 1 / gained - taken_up, 1.0)
        known = max(free - covariance[errors, errors].trace() / believed**2, 1e-3)
        # Computed as a sum of squares: for a smooth curve, g R g would cancel numbers 1e9 times
        # larger.
        straight = g - hyper.smoothness * (pull @ g) / gained * moved
        energy_left = np.sum((increments @ straight) ** 2)
        smoothness = max(determined / (energy_left + determined / SMOOTHEST), ROUGHEST)
        tau = float(np.clip(np.sqrt(d @ d / known), least_error, max(SHAKIEST, least_error)))
        effect = _design_effect(equations, matrix, mean, covariance, hyper.design_effect)
        suggested = Hyperparameters(smoothness, tau, max(effect, least_effect))
        rounds -= 1
        pace = smoothness / hyper.smoothness
        if rounds <= 0:
            known_by = matrix / hyper.design_effect + prior
            held = np.log(known_by.trace() / size)  # the term that `inverse` adds
            evidence = mean @ right / hyper.design_effect + held + np.linalg.slogdet(covariance)[1]
            evidence += (size - 2) * np.log(hyper.smoothness) - 2 * free * np.log(believed)
            evidence -= np.log(gained)
            return Solution(
                g,
                d,
                covariance,
                basis,
                hyper,
                suggested,
                equations,
                prior,
                effect,
                float(evidence / 2),
            )
        # The iteration converges linearly from one side, so the step is doubled.
        ahead = float(np.clip(smoothness * pace, ROUGHEST, SMOOTHEST))
        hyper = replace(suggested, smoothness=ahead) if rounds > 1 else suggested
        if abs(np.log(pace)) < LOG_TOLERANCE:
            rounds = 1


def _shift_by_black(
    bins: CodeBins, matrix: Float[np.ndarray, "bins bins"], right: Float[np.ndarray, " bins"]
) -> Float[np.ndarray, " bins"]:
    """Return the change of the best gamma curve if black is lower by its error; 0 if exact."""
    column = bins.log_codes - bins.log_codes[bins.middle]
    known = column @ matrix @ column
    gamma = column @ right / known if known > 0 else 0.0
    lower = replace(bins, black=bins.black - bins.black_sd)
    return gamma * (lower.log_codes - bins.log_codes)


def inverse(
    normal: Float[np.ndarray, "unknowns unknowns"], bins: CodeBins
) -> Float[np.ndarray, "unknowns unknowns"]:
    """Invert the matrix of normal equations, with g = 0 fixed at mid-scale."""
    held = normal.copy()
    held[bins.middle, bins.middle] += normal.trace() / len(bins.centres)
    try:
        return cho_solve(cho_factor(held, lower=True), np.eye(len(held)))
    except np.linalg.LinAlgError as error:
        raise InputError(
            "the images determine no curve; check that each is an exposure with its own time."
        ) from error


def equations_of(
    statistics: PairStatistics,
    log_t: Float[np.ndarray, " exposures"],
    basis: Float[np.ndarray, "exposures free"],
) -> Equations:
    """Return the normal equations of one set of pixels."""
    size = len(statistics.score) - len(log_t)
    curve, errors = slice(0, size), slice(size, None)
    mixed, times = statistics.matrix[curve, errors], statistics.matrix[errors, errors]
    score, unknowns = statistics.score, size + basis.shape[1]
    matrix = np.empty((unknowns, unknowns))
    matrix[curve, curve] = statistics.matrix[curve, curve]
    matrix[curve, errors] = mixed @ basis
    matrix[errors, curve] = matrix[curve, errors].T
    matrix[errors, errors] = basis.T @ times @ basis
    right = [score[curve] - mixed @ log_t, basis.T @ (score[errors] - times @ log_t)]
    return Equations(matrix, np.concatenate(right))


def _design_effect(
    tiles: Sequence[Equations],
    matrix: np.ndarray,
    mean: np.ndarray,
    covariance: np.ndarray,
    known: float,
) -> float:
    if len(tiles) < 2:
        return known
    pulls = np.stack([tile.matrix @ mean - tile.right for tile in tiles])
    pulls -= pulls.mean(axis=0)
    spread = np.sum((pulls @ covariance) * pulls) * len(tiles) / (len(tiles) - 1)
    return max(1.0, float(spread / np.sum(covariance * matrix)))


def bin_centre_curve(
    means: Float[np.ndarray, " bins *more"], bins: CodeBins
) -> Float[np.ndarray, " bins *more"]:
    """Convert the means of g over bins to values at the centres of the bins, 0 at mid-scale."""
    # Light is log-uniform across a bin, so the mean is that of g at the two ends. In u = ln (code -
    # black), the ends lie `half` from the mean of u, and the centre deviates slightly from it:
    # g(centre) = mean + g' (u(centre) - mean of u) - g'' half^2 / 2.
    u = bins.log_codes
    half = np.log(bins.edges[1:] - bins.black) - u
    off = np.log(bins.centres - bins.black) - u
    slope = np.gradient(means, u, axis=0)
    bend = np.zeros_like(means)
    steps = np.diff(means, axis=0) / _column(np.diff(u), means)
    bend[1:-1] = 2 * np.diff(steps, axis=0) / _column(u[2:] - u[:-2], means)
    g = means + _column(off, means) * slope - _column(half**2 / 2, means) * bend
    return g - g[bins.middle]


def _column(values: np.ndarray, like: np.ndarray) -> np.ndarray:
    return values.reshape(-1, *[1] * (like.ndim - 1))


def spread_of_times(exposures: Float[np.ndarray, " exposures"]) -> float:
    """Return sum (ln t - mean)^2, the precision of a common exponent up to a factor."""
    log_t = np.log(exposures)
    return float(np.sum((log_t - log_t.mean()) ** 2))
