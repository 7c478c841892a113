"""Fit of a pure gamma response, f(x) = x^(1/gamma), with an uncertainty that includes shutter
errors.

The log exposure of a pure gamma, g(z) = gamma ln(z - black) + const, is linear in gamma. Therefore
a few sums of the code-pair statistics (`code_pairs.py`) contain all information of the pixels about
gamma, and a step of a sampler costs microseconds. In a regression, noisy and rounded codes would
reduce the slope. The score corrects for this attenuation.

The pixels of image j share the error delta_j ~ N(0, tau^2) of its exposure time t_j. A component of
these errors that is c (ln t - mean) cannot be distinguished from another gamma. This component
multiplies gamma by 1 + c, with Var(c) = tau^2 / sum (ln t - mean)^2. The other components
contradict the images, so they are visible and determine tau. Therefore

    gamma | tau ~ N(q / P, 1 / P + (q / P)^2 tau^2 / sum (ln t - mean)^2),

where P and q are the information and the score of gamma after marginalising over the visible
shutter errors. The posterior of gamma is integrated over ln tau. This posterior is a Student's t if
the images determine tau. With few images its width follows from the prior on tau.
"""

from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize.elementwise import find_root
from scipy.special import ndtr

from jaxvision.point_ops import srgb_decode

from ..inference.diagnostics import identifiability
from ..inference.emcee_run import Emcee
from ..inference.estimates import QUANTILES, Estimate, quantile_estimate, sampled_estimate
from ..inference.left_out import LeftOut, distance, negligible
from ..inference.parameters import (
    Parameter,
    ParameterSpace,
    to_natural,
    to_unconstrained,
)
from ..inference.posterior import Posterior, estimates, laplace, sample
from .curve import ResponseCurve, slope_error
from .shutter import SHUTTER_PRIOR, TABULATED, prior_of
from .solve import SHUTTER_ERROR_LIMIT, shutter_basis, spread_of_times

BLACK_STEP = 0.1  # change of black, DN, for the derivative of gamma
EDGES = 0.05, 0.95  # shares of the range of codes between which weightings are compared
FEWEST_CODES = 10
FEWEST_SHOWN = 3  # visible shutter errors needed for the upper limit on tau
BRACKET_SIGMAS = 40.0  # standard deviations within which a quantile is searched
GAMMA = Parameter("gamma", symbol="γ", unit="", transform="log")
SHUTTER_ERROR = Parameter(
    "shutter_error", symbol="τ", unit="relative", transform="log", prior=SHUTTER_PRIOR
)
SPACE: ParameterSpace = (GAMMA, SHUTTER_ERROR)


class GammaSums(eqx.Module):
    """The sums over all pixels that a fit of gamma needs. With d the visible shutter errors along
    the axes of their information, chi^2 / 2 is, up to a constant and in terms of the fields below,

        information gamma^2 / 2 - pull gamma
        + gamma mixed . d + information_d . d^2 / 2 - pull_d . d."""

    information: Float[Array, ""]  # Fisher information about gamma
    pull: Float[Array, ""]  # score of gamma
    mixed: Float[Array, " free"]  # Fisher information between gamma and d, its off-diagonal part
    information_d: Float[Array, " free"]  # Fisher information about d
    pull_d: Float[Array, " free"]  # score of d
    spread: Float[Array, ""]  # sum of squares of the log exposure times about their mean
    # the tau that the rig states, added in quadrature to the fitted tau; None for 0
    known: Float[Array, ""] | None
    # variance of gamma from sources other than tau and noise: black level, systematic errors and
    # choice of weights
    added: Float[Array, ""]
    most: Float[Array, ""]  # upper limit of the fitted tau
    median: Float[Array, ""]  # of the prior of the fitted tau
    log_sd: Float[Array, ""]  # standard deviation of its logarithm in that prior


class GivenShutter(eqx.Module):
    """The Gaussian posterior of gamma for a given tau."""

    mean: Float[Array, ""]  # of gamma
    variance: Float[Array, ""]  # of gamma
    log_evidence: Float[Array, ""]  # log marginal likelihood of that tau


@dataclass(frozen=True)
class Mixture:
    """The posterior of tau and of a parameter that is Gaussian given tau, on a grid of tau."""

    log_tau: Float[np.ndarray, " grid"]  # ln tau, evenly spaced
    weights: Float[np.ndarray, " grid"]  # posterior weight of each tau; their sum is 1
    mean: Float[np.ndarray, " grid"]  # mean of the parameter, given tau
    variance: Float[np.ndarray, " grid"]  # variance of the parameter, given tau

    def mean_estimate(self, what: Parameter, group: str) -> Estimate:
        """Return the estimate of the parameter, with the quantiles of the mixture."""
        centre = float(self.weights @ self.mean)
        spread = float(np.sqrt(self.weights @ (self.variance + (self.mean - centre) ** 2)))

        def excess(at: np.ndarray, quantile: np.ndarray) -> np.ndarray:
            z = (at[:, None] - self.mean) / np.sqrt(self.variance)
            return ndtr(z) @ self.weights - quantile

        bracket = centre - BRACKET_SIGMAS * spread, centre + BRACKET_SIGMAS * spread
        ends = find_root(excess, bracket, args=(np.array(QUANTILES),)).x
        return quantile_estimate(what, centre, spread, ends, method="marginal", group=group)

    def tau_estimate(self, what: Parameter, group: str, *, stated: float = 0.0) -> Estimate:
        """Return the estimate of tau, whose value is the posterior median."""
        tau = np.hypot(np.exp(self.log_tau), stated)
        ends = np.interp(QUANTILES, np.cumsum(self.weights), tau)
        spread = float(np.sqrt(self.weights @ (tau - self.weights @ tau) ** 2))
        return quantile_estimate(what, ends[2], spread, ends, method="marginal", group=group)

    def draws(self, count: int, seed: int) -> Float[np.ndarray, "count 2"]:
        """Draw the parameter and tau: a grid point by weight, then values about it."""
        rng = np.random.default_rng(seed)
        which = rng.choice(len(self.log_tau), size=count, p=self.weights)
        step = (self.log_tau[1] - self.log_tau[0]) * rng.uniform(-0.5, 0.5, count)
        deviation = np.sqrt(self.variance[which]) * rng.standard_normal(count)
        return np.stack([self.mean[which] + deviation, np.exp(self.log_tau[which] + step)], axis=1)


@dataclass(frozen=True)
class GammaFit:
    """The gamma that fits a response best, with the deviations of the curve from it."""

    gamma: Estimate  # estimate with intervals
    shutter_error: Estimate  # tau, rms of the error of ln t
    # of (gamma, tau); if the rig states an exposure error, tau is the error in addition to the
    # stated error
    posterior: Posterior
    # ln X of the measured curve minus ln X of the best gamma; NaN for codes without observations
    departure: Float[np.ndarray, " bins"]
    srgb_departure: Float[np.ndarray, " bins"]  # the same difference from the sRGB curve
    dispersion: float  # chi-square of the best gamma divided by that of the free curve
    findings: tuple[str, ...]  # sentences on parameters that the data cannot distinguish
    # errors stated in the rig that the fit neglects because they are too small to matter
    left_out: tuple[LeftOut, ...] = ()


def fit_gamma(
    curve: ResponseCurve,
    *,
    label: str = "",
    black_sd: float = 0.0,
    exposure_sd: float = 0.0,
    sampling: Emcee | None = None,
    seed: int = 0,
) -> GammaFit:
    """Fit gamma to the pixels from which a response curve was fitted."""
    column = log_code_means(curve)
    dispersion = _dispersion(curve, column)
    gone = _undetectable(
        curve,
        _least_squares(curve, column) * (log_code_means(curve, shift=black_sd) - column),
        dispersion * curve.design_effect,
        black_sd=black_sd,
        exposure_sd=exposure_sd,
    )
    named = {own.name for own in gone}
    black_sd = 0.0 if "black_sd" in named else black_sd
    known = 0.0 if "exposure_sd" in named else exposure_sd
    sums = _gamma_sums(curve, column, dispersion, known, exposure_sd)
    sums = eqx.tree_at(
        lambda s: s.added, sums, _omitted_variance(curve, sums, dispersion, black_sd)
    )
    log_tau = np.linspace(np.log(TABULATED[0]), np.log(float(sums.most)), 1001)
    given = _tabulate(sums, jnp.asarray(log_tau))
    prior = -(((log_tau - np.log(float(sums.median))) / float(sums.log_sd)) ** 2) / 2
    log_weight = np.asarray(given.log_evidence) + prior
    weights = np.exp(log_weight - log_weight.max())
    weights /= weights.sum()
    best = int(np.argmax(weights))
    prior_of_tau = prior_of(sums.pull_d.size, stated=exposure_sd)
    space = GAMMA, replace(SHUTTER_ERROR, prior=prior_of_tau)
    likeliest = jnp.asarray([float(given.mean[best]), float(np.exp(log_tau[best]))])
    mode = to_unconstrained(space, likeliest)
    spread = _spread(given, log_tau, weights)
    found = laplace(log_density, space, mode, sums, covariance=spread, seed=seed)
    if sampling is not None:
        found = sample(
            log_density, space, mode, found.covariance, sums, options=sampling, seed=seed
        )
        gamma, _ = estimates(found, group=label)
        of_tau = np.hypot(found.samples[:, 1], exposure_sd)
        tau = sampled_estimate(SHUTTER_ERROR, of_tau, method=found.method, group=label)
    else:
        mixture = Mixture(log_tau, weights, np.asarray(given.mean), np.asarray(given.variance))
        drawn = mixture.draws(len(found.samples), seed)
        found = replace(found, method="marginal", draws=drawn[None])
        gamma = mixture.mean_estimate(GAMMA, label)
        tau = mixture.tau_estimate(SHUTTER_ERROR, label, stated=exposure_sd)
    assert gamma.value is not None
    information = np.linalg.inv(found.covariance)
    encoded = (curve.codes - curve.bins.black) / (curve.bins.full_scale - curve.bins.black)
    srgb = np.log(np.asarray(jax.jit(srgb_decode)(encoded)))
    return GammaFit(
        gamma=gamma,
        shutter_error=tau,
        posterior=found,
        departure=_departure(curve, gamma.value * np.log(curve.codes - curve.bins.black)),
        srgb_departure=_departure(curve, srgb),
        dispersion=dispersion,
        findings=identifiability(space, information).sentences,
        left_out=gone,
    )


def _undetectable(
    curve: ResponseCurve,
    of_black: Float[np.ndarray, " bins"],
    overstated: float,
    *,
    black_sd: float,
    exposure_sd: float,
) -> tuple[LeftOut, ...]:
    """Return stated errors too small to matter beside the pixels' information."""
    # The energy of the code pairs, v' A v / 2 for a shift v of the curve and of the log exposures,
    # is half the squared shift in standard deviations of all pixels, with their irradiances
    # eliminated. Therefore |h|^2 = v' A v for an error of one standard deviation.
    found, size = [], len(of_black)
    matrix = curve.statistics.matrix / overstated
    if black_sd:
        square = max(float(of_black @ matrix[:size, :size] @ of_black), 0.0)
        found.append(LeftOut("black_sd", black_sd, distance(np.array(square))))
    if exposure_sd:
        squares = np.linalg.eigvalsh(exposure_sd**2 * matrix[size:, size:])
        found.append(LeftOut("exposure_sd", exposure_sd, distance(np.maximum(squares, 0))))
    return negligible(found)


def log_code_means(curve: ResponseCurve, *, shift: float = 0.0) -> Float[np.ndarray, " bins"]:
    """Return the mean of ln(code - black) over each bin, minus that of the middle bin."""
    ends = np.log(np.maximum(curve.bins.edges - curve.bins.black - shift, 1e-3))
    means = (ends[1:] + ends[:-1]) / 2
    return means - means[len(means) // 2]


def given_shutter(sums: GammaSums, tau: Float[Array, ""]) -> GivenShutter:
    """Return the posterior of gamma for a given shutter error tau."""
    if sums.known is not None:
        tau = jnp.hypot(tau, sums.known)
    precision = sums.information_d + 1 / tau**2
    information = sums.information - jnp.sum(sums.mixed**2 / precision)
    mean = (sums.pull - jnp.sum(sums.mixed * sums.pull_d / precision)) / information
    evidence = (
        jnp.sum(sums.pull_d**2 / precision - jnp.log(precision * tau**2))
        + mean**2 * information
        - jnp.log(information)
    ) / 2
    return GivenShutter(
        mean, 1 / information + (mean * tau) ** 2 / sums.spread + sums.added, evidence
    )


def log_density(vector: Float[Array, " parameters"], sums: GammaSums) -> Float[Array, ""]:
    """Return the log posterior density of (ln gamma, ln tau), for a flat prior in gamma."""
    gamma, tau = to_natural(SPACE, vector)
    given = given_shutter(sums, tau)
    miss = (gamma - given.mean) ** 2 / given.variance
    density = (
        -miss / 2
        - jnp.log(given.variance) / 2
        + given.log_evidence
        + vector[0]
        - (jnp.log(tau / sums.median) / sums.log_sd) ** 2 / 2
    )
    return jnp.where(tau <= sums.most, density, -jnp.inf)


def _spread(given: GivenShutter, log_tau: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the covariance of (ln gamma, ln tau), from the grid, as the mode is very flat."""
    mean = np.asarray(given.mean)
    away = np.stack([np.log(mean), log_tau])
    away -= (away @ weights)[:, None]
    covariance = weights * away @ away.T
    covariance[0, 0] += weights @ (np.asarray(given.variance) / mean**2)
    return covariance


def _dispersion(curve: ResponseCurve, column: np.ndarray) -> float:
    """Return chi-square of the best gamma over that of the free curve, at least 1."""
    matrix = curve.statistics.matrix
    log_t = np.log(curve.exposures) + curve.shutter_offsets
    of_gamma = np.concatenate([_least_squares(curve, column) * column, log_t])
    of_curve = np.concatenate([curve.bin_means + curve.busy_places, log_t])
    return max(1.0, float((of_gamma @ matrix @ of_gamma) / (of_curve @ matrix @ of_curve)))


def _least_squares(curve: ResponseCurve, column: np.ndarray) -> float:
    """Return the least-squares gamma, with the shutter errors of the free curve."""
    matrix, size = curve.statistics.matrix, len(column)
    log_t = np.log(curve.exposures) + curve.shutter_offsets
    return -float(
        (column @ matrix[:size, size:] @ log_t) / (column @ matrix[:size, :size] @ column)
    )


def _omitted_variance(
    curve: ResponseCurve, sums: GammaSums, dispersion: float, black_sd: float
) -> Array:
    """Return gamma's variance from errors of black and slope, and excess change by reweighting."""
    tau = jnp.asarray(SHUTTER_PRIOR.median)
    mean = float(given_shutter(sums, tau).mean)
    shifted = log_code_means(curve, shift=BLACK_STEP)
    moved = float(given_shutter(_gamma_sums(curve, shifted, dispersion), tau).mean)
    of_black = ((moved - mean) / BLACK_STEP * black_sd) ** 2
    excess = [(other - mean) ** 2 - variance for other, variance in _reweighted_gammas(curve)]
    of_slope = (mean * slope_error(curve.noise)) ** 2
    return jnp.asarray(of_black + of_slope + max([0.0, *excess]), float)


def _reweighted_gammas(curve: ResponseCurve) -> list[tuple[float, float]]:
    """Return (gamma, variance) of central slopes weighted evenly in code, then in ln code."""
    z = curve.codes - curve.bins.black
    share = z / (curve.bins.edges[-1] - curve.bins.black)
    used = curve.seen & (share > EDGES[0]) & (share < EDGES[1])
    if used.sum() < FEWEST_CODES:
        return []
    x, found = np.log(z[used]), []
    for weight in (np.ones(used.sum()), 1 / z[used]):
        row = weight * (x - np.average(x, weights=weight))
        row /= row @ x
        covariance = curve.covariance[np.ix_(used, used)]
        found.append((float(row @ curve.log_exposure[used]), float(row @ covariance @ row)))
    return found


def _gamma_sums(
    curve: ResponseCurve,
    column: np.ndarray,
    dispersion: float,
    known: float = 0.0,
    stated: float = 0.0,
) -> GammaSums:
    """Return the sums over pixels; `stated` sets the prior of tau, `known` is added to it."""
    overstated = dispersion * curve.design_effect
    size, matrix = len(column), curve.statistics.matrix / overstated
    score = curve.statistics.score / overstated
    log_t, basis = np.log(curve.exposures), shutter_basis(np.log(curve.exposures))
    mixed, times = column @ matrix[:size, size:], matrix[size:, size:]
    information_d, axes = np.linalg.eigh(basis.T @ times @ basis)
    basis = basis @ axes
    prior = prior_of(basis.shape[1], stated=stated)
    # Without a limit, shutter errors of a half could explain a response that is not a gamma. A few
    # visible errors do not limit the invisible ones.
    few = basis.shape[1] < FEWEST_SHOWN
    most = TABULATED[1] if few else max(SHUTTER_ERROR_LIMIT, curve.shutter_bound)
    sums: dict[str, Any] = {
        "information": column @ matrix[:size, :size] @ column,
        "pull": score[:size] @ column - mixed @ log_t,
        "mixed": mixed @ basis,
        "information_d": information_d,
        "pull_d": (score[size:] - log_t @ times) @ basis,
        "spread": spread_of_times(curve.exposures),
        "known": known or None,
        "added": 0.0,
        "most": most,
        "median": prior.median,
        "log_sd": prior.log_sd,
    }
    return GammaSums(**jax.tree.map(lambda x: jnp.asarray(x, float), sums))


@jax.jit
def _tabulate(sums: GammaSums, log_tau: Float[Array, " grid"]) -> GivenShutter:
    return jax.vmap(lambda x: given_shutter(sums, jnp.exp(x)))(log_tau)


def _departure(curve: ResponseCurve, model: np.ndarray) -> np.ndarray:
    """Return measured minus modelled log exposure at observed codes, of weighted mean 0."""
    gap = np.where(curve.seen, curve.log_exposure - model, np.nan)
    weight = np.where(curve.seen, 1 / np.maximum(curve.standard_error, 1e-3) ** 2, 0)
    return gap - np.nansum(weight * gap) / weight.sum()
