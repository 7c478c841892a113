"""Assess the convergence of chains: the effective number of independent draws, and the agreement of
chains.

For an ensemble, the autocorrelation time is Sokal's, as in emcee, computed from the mean
autocorrelation function of all walkers. For independent chains, R-hat and the effective number of
draws use ranks, so that they are valid for heavy tails (Vehtari, Gelman, Simpson, Carpenter &
Bürkner, Bayesian Analysis 16, 2021).
"""

import math

import numpy as np
from jaxtyping import Float
from numpy.fft import irfft, rfft
from scipy.fft import next_fast_len
from scipy.special import ndtri

WINDOW = 5.0  # autocorrelation times after which Sokal's sum ends


def autocorrelation_times(
    chain: Float[np.ndarray, "steps walkers parameters"],
) -> Float[np.ndarray, " parameters"]:
    """Compute the integrated autocorrelation times of an ensemble's chain.

    The results equal `emcee.autocorr.integrated_time`. The walkers' spectra are averaged before the
    inverse transform, which takes a seventh of the time.

    Returns (P,) in steps, at least 1; infinite if a walker never moved.

    Source:
        Sokal, "Monte Carlo Methods in Statistical Mechanics", 1997; Goodman & Weare, CAMCoS 5,
        2010.
    """
    steps = len(chain)
    size = next_fast_len(2 * steps, real=True)
    times = []
    for paths in np.moveaxis(chain - chain.mean(axis=0), 2, 0):
        energy = np.sum(paths**2, axis=0)
        if not (energy > 0).all():
            times.append(np.inf)
            continue
        power = np.abs(rfft(paths, size, axis=0)) ** 2 / energy
        sums = 2 * np.cumsum(irfft(power.mean(axis=1), size)[:steps]) - 1
        beyond = np.flatnonzero(np.arange(steps) >= WINDOW * sums)
        times.append(max(sums[beyond[0] if beyond.size else -1], 1.0))
    return np.array(times)


def correct_bias(time: float, length: int) -> float:
    """Correct an autocorrelation time for the bias of a short chain.

    Let tau be the true autocorrelation time and N the number of steps. Because the mean of the same
    N steps is subtracted, every autocorrelation is too small by tau / N. Sokal's window extends
    over `WINDOW` times the estimate to either side, so the sum over it is too small by tau / N for
    each of these steps: estimate = tau / (1 + 2 `WINDOW` tau / N).

    Returns tau in steps; infinite if the chain is too short."""
    share = 1 - 2 * WINDOW * time / length
    return time / share if share > 0 else math.inf


def split_r_hat(draws: Float[np.ndarray, "chains draws"]) -> float:
    """Return split R-hat: the standard deviation of all half chains together, divided by that
    within half chains. It is 1 if they agree.

    Source:
        Vehtari et al., Bayesian Analysis 16, 2021, eqs. 1-4 and 14.
    """
    halves, found = _halves(draws), []
    for x in (halves, np.abs(halves - np.median(halves))):
        within, together = _variances(_normal_scores(x))
        found.append(float(np.sqrt(together / within)) if within > 0 else np.inf)
    return max(found)


def effective_draws(draws: Float[np.ndarray, "chains draws"]) -> float:
    """Compute the effective sample size for the centre of the distribution (bulk ESS), from
    rank-normalised draws.

    Source:
        Vehtari et al., Bayesian Analysis 16, 2021, eqs. 7-13; Geyer, Statistical Science 7, 1992.
    """
    scores = _normal_scores(_halves(draws))
    chains, length = scores.shape
    within, together = _variances(scores)
    size = next_fast_len(2 * length, real=True)
    centred = scores - scores.mean(axis=1, keepdims=True)
    products = irfft(np.abs(rfft(centred, size, axis=1)) ** 2, size, axis=1)[:, :length] / length
    correlation = 1 - (within - products.mean(axis=0)) / together
    correlation[0] = 1.0
    pairs = correlation[: length // 2 * 2].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(pairs < 0)
    pairs = pairs[: negative[0]] if negative.size else pairs
    tau = 2 * np.sum(np.minimum.accumulate(pairs)) - 1
    total = chains * length
    return total / max(tau, 1 / np.log10(total))  # antithetic chains: never more than n log n


def _halves(draws: np.ndarray) -> np.ndarray:
    half = draws.shape[1] // 2
    return np.concatenate([draws[:, :half], draws[:, -half:]])


def _normal_scores(draws: np.ndarray) -> np.ndarray:
    """Return Blom's normal scores: the normal quantiles of the draws' ranks among all draws."""
    from scipy.stats import rankdata

    return ndtri((rankdata(draws).reshape(draws.shape) - 3 / 8) / (draws.size + 1 / 4))


def _variances(draws: np.ndarray) -> tuple[float, float]:
    """Return the mean variance within chains, and the variance of all chains together."""
    length = draws.shape[1]
    within = float(draws.var(axis=1, ddof=1).mean())
    return within, within * (length - 1) / length + float(draws.mean(axis=1).var(ddof=1))
