"""Test Laplace's approximation, and sample by importance where the posterior is not Gaussian
enough.

Let c_i be the column of the covariance C for parameter i. Along the line x = mode + s c_i /
sqrt(C_ii), a Gaussian log density decreases by s^2 / 2. If the decrease differs from this by more
than `TOLERATED` at two standard deviations (s = 2), importance sampling is used. The proposals are
a quasi-random sequence from Student's t about the mode, and each has the ratio of posterior to
proposal density as its weight. The proposal distribution is then given the mean and covariance of
the weighted draws. This is repeated until the effective number of draws is large enough (adaptive
importance sampling: Oh & Berger, J. Stat. Comput. Simul. 41, 1992). If numbers have bounds, half of
the proposals are made on the scale of the numbers themselves. A ridge that is straight on that
scale is curved on the unconstrained one, where a Student's t distribution does not reach both of
its ends. If the volume of the other parameters changes along a parameter, `ridge` tabulates the
integrated density of this parameter, and the proposals follow that density. The returned draws are
resampled by their weights.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.linalg import solve_triangular
from scipy.special import chdtri, ndtri

from .emcee_run import Emcee, Unbounded
from .parameters import ParameterSpace, from_scaled, names, natural_numbers, scaled_ends, to_scaled
from .posterior import LogDensity, Posterior, evaluate_density, laplace, sample
from .ridge import Local, proposed, ridge, volume_change, widest_first

FAR = 2.0  # standard deviations at which the Gaussian is tested
NEAR = 0.3  # step of a parameter alone, in its standard deviations at fixed others
TOLERATED = 0.4  # difference from a Gaussian's decrease of 2: a 95 % interval is then right to 2 %
FREEDOM = 5.0  # degrees of freedom of the proposals, whose tails exceed those of most posteriors
FEWEST, USUAL, MOST = 1024, 4096, 16_384  # proposals of a round: powers of two
SETTLED = 0.2  # effective draws per proposal from which the proposals follow the density
KEPT = 8000  # draws that are returned
# Effective draws at which sampling stops, and the fewest that are accepted: the end of a 95 %
# interval then has an error of 6 % or 8 % of a standard deviation.
WANTED, ENOUGH = 2000.0, 1000.0
ROUNDS = 6
# Change of ln det / 2 of the other parameters' information at two standard deviations. It moves the
# most probable value by half this change, in standard deviations.
TOLERATED_VOLUME = 0.8
RIDGES = 3  # parameters along which draws are tried
# Effective draws along a parameter per draw, from which they describe all parameters: .83 to .95
# where their information changes with one scale, .64 to .75 where another parameter meets a bound.
FOLLOWED = 0.8
APART = 2.0  # standard deviations between marginal and joint mode that are reported
UNNOTICED = 0.5  # the same distance, up to which Laplace's approximation may stay
HOPELESS = 50.0  # draws for each effective one from which no more are made


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
    local: Local | None = None,
) -> Posterior:
    """Return Laplace's approximation if the density is Gaussian enough. Otherwise return draws by
    importance sampling, or by emcee if the proposals do not converge. The result remains Laplace's,
    and names a parameter, if emcee's chain is too short or if the data bound that parameter on one
    side only, so that the posterior is improper.

    Args:
        log_density: module-level function of (vector, args).
        space: the P parameters.
        mode: (P,) unconstrained values at the mode.
        covariance: (P, P) on the unconstrained scale.
        args: second argument of `log_density`, such as the data.
        seed: seed of every draw.
        freedom: (P,) degrees of freedom of the variances; None where they are known.
        wider: (P, P), the covariance that belongs to `log_density` where `freedom` is given; None
            for `covariance`.
        missed: (P,) the result of `gaussian_miss`, if the caller has a better estimate of it; None
            computes it.
        by_chain: whether to run emcee where importance sampling fails. Otherwise the posterior is
            Laplace's, and names the parameter that it describes badly.
        local: the derivatives of minus `log_density`. With them, the volume of the other parameters
            is tested too. If this volume changes along a parameter, the parameter's most probable
            value differs from its value at the mode. Draws then follow the parameter's integrated
            density.

    Returns:
        The posterior.

    Raises:
        InputError: as `laplace` does.
    """
    drawn = laplace(
        log_density, space, mode, args, covariance=covariance, freedom=freedom, seed=seed
    )
    spread = covariance if wider is None else wider
    integrated = None
    if local is not None and missed is None:
        centre = np.asarray(mode, np.float64)
        cost, _, curvature = local(np.stack([centre, *_shifted_modes(centre, spread)]))
        missed, volume = _misses(cost), volume_change(curvature)
        if not np.max(volume) <= TOLERATED_VOLUME:
            run = (log_density, space, mode, spread, args)
            integrated = _along_a_ridge(*run, curvature[0], seed=seed, local=local)
    if missed is None:
        missed = gaussian_miss(log_density, mode, spread, args)
    gaussian = np.max(missed) <= TOLERATED
    if integrated is not None and abs(integrated.shifted) > APART:
        return integrated
    if integrated is not None and not (gaussian and abs(integrated.shifted) <= UNNOTICED):
        at_mode = {"mode": drawn.mode, "unconstrained_mode": drawn.unconstrained_mode}
        return replace(integrated, shifted=0.0, **at_mode)
    if gaussian:
        return replace(drawn, miss=float(np.max(missed)))
    found = _importance(log_density, space, mode, spread, args, seed)
    worst = names(space)[int(np.argmax(missed))]
    if found is None and not by_chain:
        return replace(drawn, missed=worst)
    if found is None:
        try:
            options = Emcee(gives_up=True)
            chain = sample(log_density, space, mode, spread, args, options=options, seed=seed)
        except Unbounded as error:
            return replace(drawn, endless=error.parameter)
        return replace(drawn, missed=worst) if chain.missing_steps else chain
    vectors, effective = found
    return replace(
        drawn,
        method="importance sampling",
        draws=natural_numbers(space, vectors)[None],
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
    """Return the decrease of the log density at two standard deviations, minus a Gaussian's."""
    centre = np.asarray(mode, np.float64)
    points = jnp.asarray(np.stack([centre, *_shifted_modes(centre, covariance)]), mode.dtype)
    return _misses(-evaluate_density(log_density, points, args))


def _shifted_modes(centre: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Vectors at two standard deviations of each parameter, first up and then down."""
    steps = FAR * covariance / np.sqrt(np.diagonal(covariance))
    return np.concatenate([centre + steps.T, centre - steps.T])


def _misses(costs: np.ndarray) -> np.ndarray:
    """Return `gaussian_miss` from the costs at the mode and two standard deviations away."""
    rise = costs[1:].reshape(2, -1) - costs[0]
    return np.nan_to_num(np.max(np.abs(rise - FAR**2 / 2), axis=0), nan=np.inf)


def draw_without_mode(
    log_density: LogDensity,
    space: ParameterSpace,
    end: Float[Array, " parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
    args: Any,
    curvature: Float[np.ndarray, "parameters parameters"],
    *,
    seed: int,
    local: Local,
) -> Posterior | None:
    """Return draws along one parameter if the posterior has no joint mode, as for the standard
    deviation of effects without an upper bound. None if no parameter's integrated density decreases
    on both sides. `end` is the vector at which the search ended, and `curvature` the curvature at
    `end`; the other arguments are as in `laplace_where_it_holds`.
    """
    run = (log_density, space, end, covariance, args, curvature)
    found = _along_a_ridge(*run, seed=seed, local=local)
    if found is None or abs(found.shifted) <= APART:
        return None
    return replace(found, shifted=float(np.copysign(np.inf, found.shifted)))


def _along_a_ridge(
    log_density: LogDensity,
    space: ParameterSpace,
    mode: Array,
    covariance: np.ndarray,
    args: Any,
    curvature: np.ndarray,
    *,
    seed: int,
    local: Local,
) -> Posterior | None:
    """Draw along one parameter. Parameters are tried in the order of decreasing change of the other
    parameters' information; the first that gives enough effective draws is used. None if none
    does."""
    if len(space) == 1:
        return None
    centre = np.asarray(mode, np.float64)
    with np.errstate(all="ignore"):
        widths = NEAR / np.sqrt(np.abs(np.diagonal(curvature)))
    if not np.isfinite(widths).all():
        return None
    steps = np.diag(widths)
    near = local(np.stack([centre, *(centre + steps), *(centre - steps)]))[2]
    order = widest_first(near, FAR * np.sqrt(np.diagonal(covariance)) / widths)
    from scipy.stats import qmc

    points = qmc.Sobol(len(space) + 2, rng=np.random.default_rng(seed)).random(MOST)
    digit = float(jnp.finfo(mode.dtype).eps)
    for index in order[:RIDGES]:
        along = ridge(local, centre, covariance, int(index), digit=digit)
        if along is None:
            continue
        vectors, log_weight, effective = np.zeros((0, len(space))), np.zeros(0), 0.0
        weight = log_weight
        for block in np.split(points, MOST // FEWEST):
            drawn, log_proposal = proposed(along, block)
            values = evaluate_density(log_density, jnp.asarray(drawn, mode.dtype), args)
            own = np.where(np.isfinite(values), values, -np.inf) - log_proposal
            vectors, log_weight = np.concatenate([vectors, drawn]), np.append(log_weight, own)
            weight, effective = _normalise(log_weight)
            if effective > WANTED or effective < len(vectors) / HOPELESS:
                break
        if effective < ENOUGH:
            continue
        kept = _resample(vectors, weight, seed)
        found = np.cov(kept.T)
        shifted = float((along.mode - centre)[index] / np.sqrt(found[index, index]))
        if abs(shifted) <= APART and effective < FOLLOWED * len(vectors):
            continue
        return Posterior(
            space=space,
            method="importance sampling",
            draws=natural_numbers(space, kept)[None],
            mode=natural_numbers(space, along.mode),
            unconstrained_mode=along.mode,
            covariance=found,
            seed=seed,
            missed=names(space)[index],
            effective=effective,
            shifted=shifted,
        )
    return None


def _normalise(log_weight: np.ndarray) -> tuple[np.ndarray, float]:
    """Return weights of sum 1, and the effective number of draws; 0 if no draw has a density."""
    highest = log_weight.max()
    if not np.isfinite(highest):
        return np.zeros_like(log_weight), 0.0
    weight = np.exp(log_weight - highest)
    weight /= weight.sum()
    return weight, float(1 / np.sum(weight**2))


def _resample(vectors: np.ndarray, weight: np.ndarray, seed: int) -> np.ndarray:
    """Return draws of equal weight."""
    places = (np.random.default_rng(seed).uniform() + np.arange(KEPT)) / KEPT
    return vectors[np.minimum(np.searchsorted(np.cumsum(weight), places), len(vectors) - 1)]


def _importance(
    log_density: LogDensity,
    space: ParameterSpace,
    mode: Array,
    covariance: np.ndarray,
    args: Any,
    seed: int,
) -> tuple[np.ndarray, float] | None:
    """Return draws (draws, P) by importance sampling and their effective number, or None."""
    from scipy.stats import qmc

    size = len(covariance)
    points = qmc.Sobol(size + 1, rng=np.random.default_rng(seed)).random(MOST)
    stretch = np.sqrt(FREEDOM / chdtri(FREEDOM, points[:, -1:]))
    units = ndtri(np.clip(points[:, :-1], 1e-12, 1 - 1e-12)) * stretch
    proposals, best = _proposals(space, mode, covariance), None
    proposed = FEWEST
    for _ in range(ROUNDS):
        blocks, logs = [], []
        for block in np.split(units[:proposed], proposed // FEWEST):
            found = _propose(space, proposals, block)  # one size: one program
            values = evaluate_density(log_density, jnp.asarray(found.vectors, mode.dtype), args)
            logs.append(np.where(np.isfinite(values), values, -np.inf) - found.log_proposal)
            blocks.append(found)
        weight, effective = _normalise(np.concatenate(logs))
        drawn = np.concatenate([found.vectors for found in blocks])
        if best is None or effective > best[2]:
            best = drawn, weight, effective
        if effective > WANTED or not effective:
            break
        share = min(1.0, effective / (10 * size))  # a few heavy draws determine a covariance poorly
        scaled = np.concatenate([found.scaled for found in blocks])
        proposals = [
            _adapt_proposal(proposal, places, weight, share)
            for proposal, places in zip(proposals, (drawn, scaled), strict=False)
        ]
        settled = effective > SETTLED * proposed
        proposed = min(MOST, max(2 * proposed, USUAL if settled else 0))
    assert best is not None
    drawn, weight, effective = best
    if effective < ENOUGH:
        return None
    return _resample(drawn, weight, seed), effective


Proposal = tuple[np.ndarray, np.ndarray]  # centre and covariance


@dataclass(frozen=True)
class _Proposed:
    """Vectors drawn from the proposals, with their proposal densities."""

    vectors: np.ndarray  # (n, P) unconstrained
    scaled: np.ndarray  # (n, P) each on its own scale (identity or logarithm)
    # (n,) ln of their proposal density, infinite for those outside the bounds
    log_proposal: np.ndarray


def _proposals(space: ParameterSpace, mode: Array, covariance: np.ndarray) -> list[Proposal]:
    """Return proposals on the unconstrained scale and, with bounds, on that of the numbers."""
    centre = np.asarray(mode, np.float64)
    if not any(np.isfinite(scaled_ends(parameter)).any() for parameter in space):
        return [(centre, covariance)]
    scaled, slope = jax.jvp(lambda u: to_scaled(space, u)[0], (mode,), (jnp.ones_like(mode),))
    slope = np.asarray(slope, np.float64)
    return [
        (centre, covariance),
        (np.asarray(scaled, np.float64), covariance * np.outer(slope, slope)),
    ]


def _propose(space: ParameterSpace, proposals: Sequence[Proposal], units: np.ndarray) -> _Proposed:
    """Draw from the mixture of proposals (Owen & Zhou, J. Am. Stat. Assoc. 95, 2000), each with a
    contiguous part of the Sobol sequence; every other point would fill only half of the space."""
    dtype = jnp.result_type(float)
    roots = [np.linalg.cholesky(spread) for _, spread in proposals]
    parts = [
        centre + own @ root.T
        for own, (centre, _), root in zip(
            np.split(units, len(proposals)), proposals, roots, strict=True
        )
    ]
    inside = [parts[0], *(np.asarray(from_scaled(space, jnp.asarray(v, dtype))) for v in parts[1:])]
    vectors = np.concatenate(inside)
    there = np.all(np.isfinite(vectors), axis=1)
    vectors = np.where(there[:, None], vectors, proposals[0][0])
    scaled, slope = (
        np.asarray(x, np.float64) for x in to_scaled(space, jnp.asarray(vectors, dtype))
    )
    terms = [
        _log_student(places, centre, root) + turned
        for places, (centre, _), root, turned in zip(
            (vectors, scaled), proposals, roots, (0.0, slope), strict=False
        )
    ]
    density = np.logaddexp.reduce(terms, axis=0)
    return _Proposed(vectors, scaled, np.where(there, density, np.inf))


def _log_student(places: np.ndarray, centre: np.ndarray, root: np.ndarray) -> np.ndarray:
    """Return ln of a multivariate Student's t density, up to a constant."""
    z = solve_triangular(root, (places - centre).T, lower=True)
    fall = (FREEDOM + len(centre)) / 2 * np.log1p(np.sum(z**2, axis=0) / FREEDOM)
    return -fall - np.sum(np.log(np.diagonal(root)))


def _adapt_proposal(
    proposal: Proposal, places: np.ndarray, weight: np.ndarray, share: float
) -> Proposal:
    """Return a proposal with the mean of the weighted draws. Its covariance is the mean of the
    draws' covariance, with weight `share`, and the old covariance, because few draws determine a
    covariance poorly.
    """
    centre = weight @ places
    away = places - centre
    return centre, share * (away * weight[:, None]).T @ away + (1 - share) * proposal[1]
