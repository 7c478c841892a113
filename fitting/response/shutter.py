"""The error of a response curve from errors of the exposure times, delta_j ~ N(0, tau^2).

Suppose the true times are the stated times raised to a common exponent. Then another curve explains
the images equally well, so the images cannot reveal this error of the times: the error is
invisible. The expected size of this error depends on tau, the rms of the errors delta_j of ln t.
All other errors of the times contradict the images. The visible errors determine tau, but there are
few of them. With three exposures there is only one visible error, which may be small by chance
although tau is large. Therefore the error of the curve is modelled as a mixture over a grid of
values tau_k,

    sum_k w_k N(0, v + r tau_k^2), w_k ~ p(visible errors | tau_k) p(tau_k),

where w_k is the weight of tau_k, v is the variance of the curve g from other sources, and r = g^2 /
sum (ln t - mean)^2 is the variance from the common exponent per unit of tau^2. Student's t
intervals at the most likely tau alone, with the number of visible errors as degrees of freedom,
would be too narrow if the visible errors happen to be small. The mixture is represented by the
Student's t that has the same 68 and 95 % intervals.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize.elementwise import find_root
from scipy.special import ndtr, ndtri, stdtr, stdtrit

from ..inference.priors import LogNormal
from .solve import STEADIEST

SHUTTER_PRIOR = LogNormal(median=0.01, log_sd=1.5)  # within a factor of 4.5 at one sigma
SHUTTER_SHOWN = LogNormal(median=0.01, log_sd=2.5)  # with visible errors: a factor of 12
# Median of the error in addition to a stated one, as a share of the stated one
MEDIAN_EXTRA_ERROR = 0.1
BEYOND_LOG_SD = 1.5  # of its logarithm
TABULATED = (1e-6, 1.0)  # range of tau over which errors are mixed
GRID = 101  # of ln tau
BRACKET_FACTORS = 0.99, 1.01  # factors that move the ends of a bracket off a quantile
QUANTILE_TOLERANCE = {"xrtol": 1e-7}  # tolerance of quantiles
UNINFORMATIVE = 1e-9  # share of the information below which the images do not determine an error
LEAST = 1e-6  # largest weight of a tau that is left out
MOST_FREE = 1e6  # degrees of freedom from which they count as infinite
FEWEST_OF_STEP = 5  # images of a stack in which a step of the exposures is looked for
LEAST_STEP = 0.1  # logarithm of the exposure
UNEXPLAINED = 0.02  # largest share of the squared errors that a step leaves
LEVELS = ndtr(1.0), 0.975
FREEDOMS = np.geomspace(0.2, MOST_FREE, 400)
RATIOS = stdtrit(FREEDOMS, LEVELS[1]) / stdtrit(FREEDOMS, LEVELS[0])


@dataclass(frozen=True)
class Shutter:
    """The variance of a curve from the invisible error of the exposure times (a common exponent),
    and the posterior of tau."""

    per_square: Float[np.ndarray, " bins"]  # variance of g per unit of tau^2
    likeliest: float  # tau of maximum posterior probability
    tau: Float[np.ndarray, " grid"]  # values of tau
    weights: Float[np.ndarray, " grid"]  # probability of each tau; their sum is 1

    @property
    def variance(self) -> Float[np.ndarray, " bins"]:
        """Variance of g at the most likely tau."""
        return self.per_square * self.likeliest**2


def step_of(
    log_t: Float[np.ndarray, " exposures"], offsets: Float[np.ndarray, " exposures"]
) -> tuple[int, float] | None:
    """Return the first image, and the logarithm of the factor, of a step in the light of the images
    that explains their visible errors of ln t (another aperture, or a time that is missing); None
    if a single step does not explain them."""
    count, best = len(log_t), None
    least = UNEXPLAINED * float(np.sum((offsets - offsets.mean()) ** 2))
    for first in range(2, count - 1) if count >= FEWEST_OF_STEP else ():
        step = (np.arange(count) >= first).astype(float)
        design = np.stack([np.ones(count), log_t, step], axis=1)
        found = np.linalg.lstsq(design, offsets, rcond=None)[0]
        left = float(np.sum((offsets - design @ found) ** 2))
        if left < least and abs(found[2]) > LEAST_STEP:
            # The curve has taken a part of the step as a common exponent.
            best, least = (first, float(found[2] / (1 + found[1]))), left
    return best


def prior_of(shown: int, *, stated: float = 0.0) -> LogNormal:
    """Return the prior on tau, for `shown`, the number of visible errors. If a shutter error is
    stated, the prior is on the error in addition to the stated one. If no error is visible, the
    prior alone determines the width of the interval, so a narrower prior, near the errors of real
    cameras, is used."""
    if stated > STEADIEST:
        return LogNormal(median=MEDIAN_EXTRA_ERROR * stated, log_sd=BEYOND_LOG_SD)
    return SHUTTER_SHOWN if shown else SHUTTER_PRIOR


def tau_posterior(
    score: Float[np.ndarray, " shown"],
    information: Float[np.ndarray, "shown shown"],
    known: float,
) -> tuple[Float[np.ndarray, " grid"], Float[np.ndarray, " grid"]]:
    """Return a grid of tau and its posterior weights, from the visible shutter errors."""
    low, high = TABULATED
    log_tau = np.linspace(np.log(low), np.log(high), GRID)
    tau = np.hypot(np.exp(log_tau), known)
    known_by, axes = np.linalg.eigh(information)
    informed = known_by > UNINFORMATIVE * known_by.max(initial=0.0)
    known_by, pull = known_by[informed], (score @ axes)[informed]
    square = tau[:, None] ** 2
    log_weight = (pull**2 * square / (1 + known_by * square) - np.log1p(known_by * square)).sum(
        axis=1
    ) / 2
    prior = prior_of(int(informed.sum()), stated=known)
    log_weight -= ((log_tau - np.log(prior.median)) / prior.log_sd) ** 2 / 2
    weights = np.exp(log_weight - log_weight.max())
    kept = weights > LEAST * weights.sum()
    return tau[kept], weights[kept] / weights[kept].sum()


def mix_over_tau(
    variance: Float[np.ndarray, " bins"], freedom: Float[np.ndarray, " bins"], shutter: Shutter
) -> tuple[Float[np.ndarray, " bins"], Float[np.ndarray, " bins"]]:
    """Add the variance from shutter errors, mixed over tau, to a `variance` from other sources with
    `freedom` degrees of freedom. Return the squared scale and the degrees of freedom of an
    equivalent Student's t at each bin."""
    parts = variance[:, None] + shutter.per_square[:, None] * shutter.tau**2
    some = np.where(parts > 0, parts, 1)  # none at mid-scale, where g = 0 by definition
    uncertain = np.where(variance > 0, variance, 1)[:, None]
    free = np.minimum(freedom[:, None] * (some / uncertain) ** 2, MOST_FREE)  # Satterthwaite's
    gaussian, scales = bool((freedom >= MOST_FREE).all()), np.sqrt(some)

    def quantile(level: float) -> np.ndarray:
        def excess(at: np.ndarray, i: np.ndarray) -> np.ndarray:
            z = at[:, None] / scales[i]
            return (ndtr(z) if gaussian else stdtr(free[i], z)) @ shutter.weights - level

        low = BRACKET_FACTORS[0] * ndtri(level) * scales.min(axis=1)
        high = BRACKET_FACTORS[1] * (stdtrit(free, level) * scales).max(axis=1)
        return find_root(
            excess, (low, high), args=(np.arange(len(low)),), tolerances=QUANTILE_TOLERANCE
        ).x

    inner, outer = map(quantile, LEVELS)
    ratio = np.clip(outer / inner, RATIOS[-1], RATIOS[0])
    own = np.exp(np.interp(-ratio, -RATIOS, np.log(FREEDOMS)))
    scale = np.where(parts.max(axis=1) > 0, outer / stdtrit(own, LEVELS[1]), 0)
    return scale**2, own
