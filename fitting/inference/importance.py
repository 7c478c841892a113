"""Where Laplace's Gaussian misses a posterior: noticed, and mended by importance sampling.

Along the line on which the Gaussian expects the mode to move with parameter i, x = mode + s c_i /
sqrt(C_ii) with c_i the column of the covariance C, a Gaussian falls by s^2 / 2. Where the density
falls otherwise, by more than `TOLERATED` at two standard deviations, draws are taken from
Student's t about the mode, in a quasi-random sequence, and weighted by density over proposal; the
proposal takes mean and covariance of the weighted draws until they are worth enough independent
ones (adaptive importance sampling: Oh & Berger, J. Stat. Comput. Simul. 41, 1992). The draws that
are handed on are resampled by their weights.
"""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.special import chdtri, ndtri

from .parameters import ParameterSpace, names, to_natural
from .posterior import LogDensity, Posterior, evaluate_density, laplace, sample

FAR = 2.0  # standard deviations at which the Gaussian is tested
TOLERATED = 0.4  # of its fall there, 2: a 95 % interval is then right to some 2 %
FREEDOM = 5.0  # of the proposals: their tails are heavier than a posterior's
FEWEST, USUAL, MOST = 1024, 4096, 16_384  # proposals of a round: powers of two
SETTLED = 0.2  # share of the proposals that the draws are worth once they follow the density
KEPT = 8000  # draws
WANTED, ENOUGH = 2000.0, 1000.0  # independent draws at which it ends, and that will do: the error
# of a 95 % interval's end is then 6 % of a standard deviation, or 8 %
ROUNDS = 6


def laplace_where_it_holds(
    log_density: LogDensity,
    space: ParameterSpace,
    mode: Float[Array, " parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
    args: Any,
    *,
    seed: int,
    freedom: Float[np.ndarray, " parameters"] | None = None,
    wider: Float[np.ndarray, "parameters parameters"] | None = None,
    missed: Float[np.ndarray, " parameters"] | None = None,
    by_chain: bool = True,
) -> Posterior:
    """Laplace's posterior if the density is as Gaussian as that says, else draws by importance
    sampling, else, where proposals do not settle, by emcee.

    Args:
        log_density: module-level function of (vector, args).
        space: the P parameters.
        mode: (P,) unconstrained.
        covariance: (P, P) on the unconstrained scale.
        args: data of `log_density`.
        seed: of every draw.
        freedom: (P,) degrees of freedom of the variances; None where they are known.
        wider: (P, P), the covariance that `log_density` has where `freedom` is given; None for
            `covariance`.
        missed: (P,), as `gaussian_miss` gives it, where the caller knows more; None for that.
        by_chain: whether to run emcee where proposals do not settle; else the posterior is
            Laplace's, with the parameter that it misses named.

    Returns:
        The posterior.

    Raises:
        InputError: as `laplace` does.
    """
    drawn = laplace(
        log_density, space, mode, args, covariance=covariance, freedom=freedom, seed=seed
    )
    spread = covariance if wider is None else wider
    if missed is None:
        missed = gaussian_miss(log_density, mode, spread, args)
    if np.max(missed) <= TOLERATED:
        return drawn
    found = _importance(log_density, mode, spread, args, seed)
    worst = names(space)[int(np.argmax(missed))]
    if found is None and not by_chain:
        return replace(drawn, missed=worst)
    if found is None:
        return sample(log_density, space, mode, spread, args, seed=seed)
    vectors, effective = found
    return replace(
        drawn,
        method="importance sampling",
        draws=np.asarray(to_natural(space, jnp.asarray(vectors)))[None],
        covariance=np.cov(vectors.T).reshape(len(space), len(space)),
        freedom=None,
        missed=worst,
        effective=effective,
    )


def gaussian_miss(
    log_density: LogDensity,
    mode: Float[Array, " parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
    args: Any,
) -> Float[np.ndarray, " parameters"]:
    """How far the fall of a log density at two standard deviations differs from a Gaussian's.

    Args:
        log_density: module-level function of (vector, args).
        mode: (P,) unconstrained.
        covariance: (P, P) of the Gaussian.
        args: data of `log_density`.

    Returns:
        (P,) of each parameter, the worse of both sides; infinite where the density is nowhere.
    """
    steps = FAR * covariance / np.sqrt(np.diagonal(covariance))
    centre = np.asarray(mode, np.float64)
    points = np.concatenate([centre[None], centre + steps.T, centre - steps.T])
    values = evaluate_density(log_density, jnp.asarray(points, mode.dtype), args)
    fall = values[0] - values[1:].reshape(2, -1)
    return np.nan_to_num(np.max(np.abs(fall - FAR**2 / 2), axis=0), nan=np.inf)


def _importance(
    log_density: LogDensity, mode: Array, covariance: np.ndarray, args: Any, seed: int
) -> tuple[np.ndarray, float] | None:
    """(draws, P) and what they are worth; None where too little."""
    from scipy.stats import qmc

    size = len(covariance)
    points = qmc.Sobol(size + 1, rng=np.random.default_rng(seed)).random(MOST)
    stretch = np.sqrt(FREEDOM / chdtri(FREEDOM, points[:, -1:]))
    units = ndtri(np.clip(points[:, :-1], 1e-12, 1 - 1e-12)) * stretch
    log_proposal = -(FREEDOM + size) / 2 * np.log1p(np.sum(units**2, axis=1) / FREEDOM)
    centre, spread, best = np.asarray(mode, np.float64), covariance, None
    proposed = FEWEST
    for _ in range(ROUNDS):
        root = np.linalg.cholesky(spread)
        vectors = centre + units[:proposed] @ root.T
        values = np.concatenate(
            [  # blocks of one size, so that one program serves all rounds
                evaluate_density(log_density, jnp.asarray(block, mode.dtype), args)
                for block in np.split(vectors, proposed // FEWEST)
            ]
        )
        log_weight = np.where(np.isfinite(values), values - log_proposal[:proposed], -np.inf)
        weight = np.exp(log_weight - log_weight.max())
        weight /= weight.sum()
        effective = float(1 / np.sum(weight**2))
        if best is None or effective > best[2]:
            best = vectors, weight, effective
        if effective > WANTED:
            break
        centre = weight @ vectors
        away = vectors - centre
        tempered = (away * weight[:, None]).T @ away
        share = min(1.0, effective / (10 * size))  # a few heavy draws say little of a covariance
        spread = share * tempered + (1 - share) * spread
        settled = effective > SETTLED * proposed
        proposed = min(MOST, max(2 * proposed, USUAL if settled else 0))
    assert best is not None
    vectors, weight, effective = best
    if effective < ENOUGH:
        return None
    places = (np.random.default_rng(seed).uniform() + np.arange(KEPT)) / KEPT
    chosen = np.minimum(np.searchsorted(np.cumsum(weight), places), len(vectors) - 1)
    return vectors[chosen], effective
