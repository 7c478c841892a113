"""Compute the posterior of a fit by Laplace's approximation or by emcee (for NUTS see `nuts`).

The log density is a module-level pure function of an unconstrained vector and its data. Laplace's
approximation uses its curvature at the mode. The ensemble sampler evaluates the density of half of
its walkers in one compiled call (`emcee_run`).
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.special import ndtr, stdtrit

from jaxvision.core.parallel_loops import map_
from jaxvision.errors import InputError
from jaxvision.programs import targets_cpu

from .blocks import Block, fingerprint
from .diagnostics import identifiability
from .emcee_run import Emcee, enough_walkers, run_ensemble
from .estimates import (
    QUANTILES,
    Estimate,
    quantile_estimate,
    reach_from_end,
    sampled_estimate,
)
from .on_host import to_host
from .parameters import (
    Parameter,
    ParameterSpace,
    ends,
    names,
    natural_numbers,
    natural_slopes,
    prior_values,
    scaled_ends,
)

LogDensity = Callable[[Float[Array, " parameters"], Any], Float[Array, ""]]

PRIOR_RATIO = 0.7  # posterior over prior standard deviation above which the prior dominates
BATCH = 8  # walkers evaluated at a time: blocks of 8 beat a full vmap on a CPU
_KERNEL_FACTOR = 128  # factor on BATCH for an accelerator, where each operation costs a launch


@dataclass(frozen=True)
class Posterior:
    """Draws from a posterior, and how they were made.

    Attributes:
        space: the P parameters.
        method: "Laplace", "marginal" (independent draws of integrals on a grid), "importance
            sampling", "emcee" or "NUTS".
        draws: (chains, draws, P) parameters in natural units.
        mode: (P,) mode in natural units. Where `shifted` is not 0, the most probable value of
            `missed` alone, with the others at their best values for it.
        unconstrained_mode: (P,) mode on the unconstrained scale.
        covariance: (P, P) covariance on the unconstrained scale.
        seed: seed of the draws.
        freedom: (P,) degrees of freedom of the variances, where Laplace's intervals are those of
            Student's t; None where the variances count as known.
        log_density: (chains, draws) log density of the draws, None for Laplace.
        tau: (P,) autocorrelation times in steps, None for Laplace; for NUTS, the value that gives
            its effective number of draws.
        acceptance: share of accepted proposals, None for Laplace.
        steps: number of steps of each chain, burn-in included; 0 for Laplace.
        missing_steps: estimated number of further steps that the chains need.
        r_hat: (P,) split R-hat of independent chains; NUTS only, else None.
        divergences: number of trajectories whose energy error is too large; NUTS only, else None.
        missed: parameter that the Gaussian describes worst, where this matters.
        endless: parameter that the data bound on one side only, as found by a chain.
        effective: effective number of draws of importance sampling.
        shifted: distance of the most probable value of `missed` alone from its value at the mode of
            all parameters together, in standard deviations; 0 where it is at most 2, infinite where
            all parameters together have no mode.
        miss: difference between the decrease of the log density at two standard deviations and a
            Gaussian's, the largest over parameters, where Laplace's approximation was tested; else
            NaN.
        blocks: the whole chain, from which a longer run continues; empty for Laplace.
    """

    space: ParameterSpace
    method: Literal["Laplace", "marginal", "importance sampling", "emcee", "NUTS"]
    draws: Float[np.ndarray, "chains draws parameters"]
    mode: Float[np.ndarray, " parameters"]
    unconstrained_mode: Float[np.ndarray, " parameters"]
    covariance: Float[np.ndarray, "parameters parameters"]
    seed: int
    freedom: Float[np.ndarray, " parameters"] | None = None
    log_density: Float[np.ndarray, "chains draws"] | None = None
    tau: Float[np.ndarray, " parameters"] | None = None
    acceptance: float | None = None
    steps: int = 0
    missing_steps: int = 0
    r_hat: Float[np.ndarray, " parameters"] | None = None
    divergences: int | None = None
    missed: str = ""
    endless: str = ""
    effective: float = float("nan")
    shifted: float = 0.0
    miss: float = float("nan")
    blocks: tuple[Block, ...] = field(default=(), repr=False)

    @property
    def samples(self) -> Float[np.ndarray, "samples parameters"]:
        """Return all draws as one array (samples, P)."""
        return self.draws.reshape(-1, len(self.space))

    @property
    def by_name(self) -> dict[str, Float[np.ndarray, "chains draws"]]:
        """Return the draws (chains, draws) of every parameter by name, in natural units."""
        return {name: self.draws[..., i] for i, name in enumerate(names(self.space))}

    @property
    def sampled(self) -> bool:
        """Return whether draws come from a sampler, whose quantiles are the intervals."""
        return self.method != "Laplace"


@dataclass(frozen=True)
class Laplace:
    """Laplace's approximation, a Gaussian about the mode of the unconstrained values. If the
    posterior is not Gaussian enough, draws by importance sampling replace it.

    Example:
        >>> from fitting import Gaussian, Laplace, Parameter, Problem, fit
        >>> likelihood, data = Gaussian(sd=0.2), np.array([1.9, 2.0, 2.0, 2.1])
        >>> mean = Problem({"m": Parameter(start=1.0)}, lambda m: m * jnp.ones(4), likelihood, data)
        >>> fit(mean, posterior=Laplace()).posterior.method
        'Laplace'
    """


def laplace_or_emcee(
    log_density: LogDensity,
    space: ParameterSpace,
    mode: Float[Array, " parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
    args: Any,
    *,
    sampling: Emcee | None,
    seed: int,
) -> Posterior:
    """Draw from a posterior by emcee, or from Laplace's approximation if `sampling` is None."""
    if sampling is None:
        return laplace(log_density, space, mode, args, covariance=covariance, seed=seed)
    return sample(log_density, space, mode, covariance, args, options=sampling, seed=seed)


def laplace(
    log_density: LogDensity,
    space: ParameterSpace,
    mode: Float[Array, " parameters"],
    args: Any,
    *,
    covariance: Float[np.ndarray, "parameters parameters"] | None = None,
    freedom: Float[np.ndarray, " parameters"] | None = None,
    seed: int = 0,
    draws: int = 4000,
) -> Posterior:
    """Return the Gaussian approximation of the posterior about its mode, on the unconstrained
    scale. Its covariance is given, or is the inverse of the negative Hessian at the mode. If
    degrees of freedom of the variances are given, every parameter's draws follow Student's t, with
    the correlations of the Gaussian.
    """
    if covariance is None:
        information = to_host(_information(log_density, mode, args), dtype=np.float64)
        judged = identifiability(space, information)
        if not judged.determined:
            raise InputError(" ".join(judged.sentences))
        covariance = np.linalg.inv(information)
    covariance = np.asarray(covariance, np.float64)
    centre = np.asarray(mode, np.float64)
    rng = np.random.default_rng(seed)
    try:
        vectors = rng.multivariate_normal(centre, covariance, size=draws, method="cholesky")
    except np.linalg.LinAlgError as error:
        raise InputError(
            "The best fit is no proper maximum, so it has no standard errors: the model does not "
            "describe these data; check the data and their stated properties."
        ) from error
    if freedom is not None:
        deviation = np.sqrt(np.diagonal(covariance))
        chance = ndtr((vectors - centre) / deviation)
        vectors = centre + deviation * stdtrit(freedom, chance)
    return Posterior(
        space=space,
        method="Laplace",
        draws=natural_numbers(space, vectors)[None],
        mode=natural_numbers(space, centre),
        unconstrained_mode=centre,
        covariance=covariance,
        seed=seed,
        freedom=freedom,
    )


def sample(
    log_density: LogDensity,
    space: ParameterSpace,
    mode: Float[Array, " parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
    args: Any,
    *,
    options: Emcee | None = None,
    seed: int = 0,
    after: Posterior | None = None,
) -> Posterior:
    """Draw from a posterior by emcee, with walkers that start from the Gaussian (mode, covariance).

    A chain that reaches the largest number of steps before it spans 50 autocorrelation times is
    returned too, and reports how many steps it lacks. To continue it, allow more steps and give
    `after` or its checkpoint. The result is bit-identical to that of an uninterrupted run.
    """
    options = options or Emcee()

    def evaluate(vectors: np.ndarray) -> np.ndarray:
        return evaluate_density(log_density, jnp.asarray(vectors, mode.dtype), args)

    centre = np.asarray(mode, np.float64)
    chain = run_ensemble(
        evaluate,
        centre,
        covariance,
        names=names(space),
        options=options,
        seed=seed,
        fingerprint=fingerprint(
            *(log_density, mode, covariance, args),
            *(space, seed, enough_walkers(options, len(space))),
            package="emcee",
        ),
        before=() if after is None else after.blocks,
    )
    drawn = chain.vectors.reshape(-1, len(space))
    return Posterior(
        space=space,
        method="emcee",
        draws=natural_numbers(space, np.swapaxes(chain.vectors, 0, 1)),
        mode=natural_numbers(space, centre),
        unconstrained_mode=centre,
        covariance=np.cov(drawn.T).reshape(len(space), len(space)),
        seed=seed,
        log_density=chain.log_density.T,
        tau=chain.tau,
        acceptance=chain.acceptance,
        steps=chain.steps,
        missing_steps=chain.missing_steps,
        blocks=chain.blocks,
    )


def estimates(posterior: Posterior, *, group: str = "") -> tuple[Estimate, ...]:
    """Return the value, standard error, and 68 and 95 % intervals of each parameter in its own
    unit.

    For Laplace's approximation the value is the mode, and the intervals are Gaussian or Student
    quantiles converted to natural units. For samplers they are the median and the quantiles of the
    draws. If draws accumulate at a bound, the intervals begin there."""
    if posterior.sampled:
        return tuple(
            sampled_estimate(
                *(parameter, draws),
                method=posterior.method,
                group=group,
                ends=_sampled_ends(parameter, draws),
            )
            for parameter, draws in zip(posterior.space, posterior.samples.T, strict=True)
        )
    deviation = np.sqrt(np.diagonal(posterior.covariance))
    centre = posterior.unconstrained_mode
    freedom = np.inf if posterior.freedom is None else posterior.freedom
    steps = stdtrit(freedom, np.asarray(QUANTILES)[:, None]) * deviation
    found = natural_numbers(posterior.space, centre + steps)
    slope = natural_slopes(posterior.space, centre)[0]
    spread = np.abs(slope) * deviation
    return tuple(
        quantile_estimate(
            p, posterior.mode[i], spread[i], found[:, i], method="Laplace", group=group
        )
        for i, p in enumerate(posterior.space)
    )


def piled_at(parameter: Parameter, draws: Float[np.ndarray, " draws"]) -> str:
    """Return the bound at which a number's draws accumulate: "lower", "upper" or "".

    The result is "" for a posterior about as wide as the prior, because it may be dense at both
    bounds."""
    known = prior_values(parameter)
    if known is not None and np.std(draws) > PRIOR_RATIO * np.std(known):
        return ""
    for side, distance in _distance_from_bounds(parameter, draws).items():
        if reach_from_end(distance, 0.95)[0]:
            return side
    return ""


def _distance_from_bounds(
    parameter: Parameter, draws: Float[np.ndarray, " draws"]
) -> dict[str, Float[np.ndarray, " draws"]]:
    """Return the distances of the draws from the finite bounds, on the scale of the number."""
    low, high = scaled_ends(parameter)
    scaled = np.log(draws) if parameter.transform == "log" else draws
    found = {}
    if np.isfinite(low):
        found["lower"] = np.maximum(scaled - low, 0)
    if np.isfinite(high):
        found["upper"] = np.maximum(high - scaled, 0)
    return found


def _sampled_ends(
    parameter: Parameter, draws: Float[np.ndarray, " draws"]
) -> Float[np.ndarray, "5"]:
    """Return the values at `QUANTILES`; an interval begins at a bound where draws accumulate."""
    found = np.quantile(draws, QUANTILES)
    if not (side := piled_at(parameter, draws)):
        return found
    bound = ends(parameter)[side == "upper"]
    sign = 1 if side == "lower" else -1
    for level, first, last in ((0.95, 0, 4), (0.68, 1, 3)):
        begins, reach = reach_from_end(_distance_from_bounds(parameter, draws)[side], level)
        if begins:
            other = np.log(bound) if parameter.transform == "log" else bound
            other = other + sign * float(reach)
            other = np.exp(other) if parameter.transform == "log" else other
            found[first], found[last] = sorted((bound, other))
    return found


@eqx.filter_jit
def _information(log_density: LogDensity, vector: Array, args: Any) -> Array:
    return -jax.hessian(log_density)(vector, args)


def evaluate_density(
    log_density: LogDensity, vectors: Float[Array, "draws parameters"], args: Any
) -> Float[np.ndarray, " draws"]:
    """Evaluate a log density at many vectors, in batches; the result is -inf where it is NaN."""
    return to_host(_evaluate(log_density, vectors, args), dtype=float)


def walkers_at_a_time() -> int:
    """Return how many walkers are evaluated at a time on this device."""
    return BATCH if targets_cpu() else BATCH * _KERNEL_FACTOR


@eqx.filter_jit
def _evaluate(log_density: LogDensity, vectors: Array, args: Any) -> Array:
    values = map_(lambda vector: log_density(vector, args), vectors, batch_size=walkers_at_a_time())
    return jnp.where(jnp.isnan(values), -jnp.inf, values)
