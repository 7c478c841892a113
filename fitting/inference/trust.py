"""Reliability of draws, as findings."""

import math

import numpy as np

from .convergence import without_bias
from .emcee_run import TIMES_TAU
from .parameters import names
from .posterior import Posterior

DIVERGENT = 0.001  # share of trajectories beyond which they matter


def is_trusted(posterior: Posterior) -> bool:
    """Whether the chains, if any, are long enough, and few of their trajectories diverge."""
    return not (posterior.missing_steps or _diverges(posterior))


def _diverges(posterior: Posterior) -> bool:
    chains, kept = posterior.draws.shape[:2]
    return (posterior.divergences or 0) > DIVERGENT * chains * kept


def convergence_in_words(posterior: Posterior) -> str:
    """The reliability of the draws in one sentence; for a short chain, with the missing length."""
    if posterior.endless:
        return (
            f"The data bound {posterior.endless} on one side only, and a chain diverged. "
            "Laplace's intervals describe only the neighbourhood of the best fit and mislead; take "
            "more data, or remove disturbed ones."
        )
    if posterior.missed and posterior.method == "Laplace":
        return (
            f"The posterior of {posterior.missed} is far from a Gaussian, so Laplace's intervals "
            "may mislead: a chain (--mcmc, or posterior=Emcee() or Nuts()) draws from the "
            "posterior itself."
        )
    if posterior.missed:
        return (
            f"The posterior of {posterior.missed} is far from a Gaussian, so intervals are "
            "quantiles of draws by importance sampling, with an effective number of "
            f"{posterior.effective:.0f}."
        )
    if posterior.method == "marginal":
        return "Intervals are exact integrals; draws are independent."
    if posterior.tau is None:
        shape = "Gaussian" if posterior.freedom is None else "Student's t"
        return f"Intervals are Laplace's: {shape} about the best fit on the scale of the transform."
    slowest = int(np.argmax(posterior.tau))
    name, tau = names(posterior.space)[slowest], posterior.tau[slowest]
    chains, kept = posterior.draws.shape[:2]
    if posterior.r_hat is not None:
        return _independent_chains_in_words(posterior, name, chains * kept / tau)
    if not np.isfinite(tau):
        return (
            f"Some walkers have not moved in {posterior.steps} steps, so the chain cannot be "
            f"judged and its intervals cannot be trusted; about {posterior.missing_steps} more "
            "steps are missing."
        )
    if posterior.missing_steps:
        behind = without_bias(tau, kept)
        likely = f" ({behind:.1f} is likely)" if math.isfinite(behind) else " by any factor"
        return (
            f"The chain of {posterior.steps} steps is, after its burn-in, {kept / tau:.0f} "
            f"autocorrelation times long (tau = {tau:.1f} steps, of {name}) and at least "
            f"{TIMES_TAU} are needed to trust its intervals; so short a chain underestimates tau"
            f"{likely} and about {posterior.missing_steps} more steps are missing."
        )
    return (
        f"{posterior.steps} steps of {chains} walkers; the slowest parameter, {name}, has an "
        f"autocorrelation time of {tau:.1f} steps, so the chain is worth {chains * kept / tau:.0f} "
        f"independent draws; acceptance {posterior.acceptance:.2f}."
    )


def _independent_chains_in_words(posterior: Posterior, name: str, effective: float) -> str:
    chains, kept = posterior.draws.shape[:2]
    assert posterior.r_hat is not None
    told = (
        f"{chains} chains of {kept} draws; the slowest parameter, {name}, is worth "
        f"{effective:.0f} independent draws; largest R-hat {posterior.r_hat.max():.3f}; "
        f"{posterior.divergences} divergent trajectories"
    )
    if posterior.missing_steps:
        told += (
            f": too few to trust the intervals; about {posterior.missing_steps} more draws of each "
            "chain are missing"
        )
    if _diverges(posterior):
        told += ". Trajectories that diverge miss a part of the posterior: a higher acceptance="
        return f"{told} of Nuts takes smaller steps, which more draws do not replace."
    return f"{told}."
