"""Judge whether posterior draws are reliable, and say so in sentences."""

import math
from collections.abc import Iterable

import numpy as np

from .convergence import correct_bias
from .emcee_run import TIMES_TAU
from .parameters import names
from .posterior import Posterior

# Standard error of the 97.5 % point of n draws of a Gaussian, sqrt(p (1 - p)) / (density sqrt(n))
_END_ERROR = 2.67
_MISS_SHARE = 0.8
DIVERGENT = 0.001  # share of divergent trajectories from which they are reported


def is_trusted(posterior: Posterior) -> bool:
    """Return whether the chains, if any, are long enough and few of their trajectories diverge."""
    return not (posterior.missing_steps or _diverges(posterior))


def _diverges(posterior: Posterior) -> bool:
    chains, kept = posterior.draws.shape[:2]
    return (posterior.divergences or 0) > DIVERGENT * chains * kept


def convergence_in_words(posterior: Posterior) -> str:
    """Say in a sentence how reliable the draws are, or how many steps are missing."""
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
    if posterior.shifted:
        side = "below" if posterior.shifted > 0 else "above"
        where = (
            f"The joint mode lies {abs(posterior.shifted):.1f} standard deviations {side} the most "
            f"probable value of {posterior.missed}"
        )
        if np.isinf(posterior.shifted):
            where = (
                f"There is no joint mode: {side} the most probable value of {posterior.missed} the "
                "joint density increases without limit"
            )
        return (
            f"{where}, as for the standard deviation of effects that are fitted too. Best values "
            "are at the most probable value; intervals are quantiles of draws by importance "
            f"sampling, with an effective number of {posterior.effective:.0f}."
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
        behind = correct_bias(tau, kept)
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
    sentence = (
        f"{chains} chains of {kept} draws; the slowest parameter, {name}, is worth "
        f"{effective:.0f} independent draws; largest R-hat {posterior.r_hat.max():.3f}; "
        f"{posterior.divergences} divergent trajectories"
    )
    if posterior.missing_steps:
        sentence += (
            f": too few to trust the intervals; about {posterior.missing_steps} more draws of each "
            "chain are missing"
        )
    if _diverges(posterior):
        sentence += ". Trajectories that diverge miss a part of the posterior: a higher acceptance="
        return f"{sentence} of Nuts takes smaller steps, which more draws do not replace."
    return f"{sentence}."


def cost_in_words(
    posteriors: Iterable[Posterior],
    seconds: float,
    *,
    typed: bool = False,
    argument: str = "posterior",
) -> str:
    """Return one sentence on the error of a fit's approximations in standard errors, on its time in
    s, and on settings that are cheaper or more accurate. With `typed` the settings are options of a
    command; otherwise they are values of the function's `argument`. The error of Laplace's
    intervals is derived from the test of the approximation: a cubic or quartic term of the log
    density that is m at two standard deviations moves the 97.5 % point by 0.73 m or 0.84 m standard
    errors (Cornish and Fisher's expansion).
    """
    every = list(posteriors)
    if not every:
        return ""
    worst = max(every, key=lambda one: np.nan_to_num(_error_of_end(one), nan=np.inf))
    error, draws = _error_of_end(worst), worst.draws.shape[1]
    exact = "--mcmc" if typed else f"{argument}=Emcee()"
    others = {
        "Laplace": f"{exact} draws from the posterior itself",
        "importance sampling": f"{exact} is the next better setting",
        "marginal": f"{'no' if np.isfinite(seconds) else 'No'} setting is better",
        "NUTS": f"Nuts(draws={max(draws // 4, 1)}) doubles the error in a quarter of the time, "
        f"Nuts(draws={4 * draws}) halves it in 4 times the time",
    }
    most = 4 * worst.draws.shape[0]
    wider = f"--walkers {most}" if typed else f"Emcee(walkers={most})"
    usual = "Laplace's approximation is cheaper, " + wider + " halves the error in 4 times the time"
    known = f"moves the ends of 95 % intervals by about {error:.1g} standard errors"
    verdict = "has not been tested here" if np.isnan(error) else "describes the posterior badly"
    verdict = known if np.isfinite(error) else verdict
    took = f"The fit took {seconds:.2g} s; " if np.isfinite(seconds) else ""
    name = {"Laplace": "Laplace's approximation", "marginal": "An integral on a grid"}
    of = name.get(worst.method, f"The finite number of draws by {worst.method}")
    return f"{of} {verdict}. {took}{others.get(worst.method, usual)}."


def _error_of_end(posterior: Posterior) -> float:
    """Return the error of 95 % ends by the approximation of a posterior, in standard errors."""
    if posterior.method == "Laplace":
        return np.inf if posterior.missed or posterior.endless else _MISS_SHARE * posterior.miss
    if posterior.method == "marginal":
        return 0.0
    effective = posterior.effective
    if posterior.tau is not None:
        chains, kept = posterior.draws.shape[:2]
        effective = chains * kept / float(np.max(posterior.tau))
    return _END_ERROR / math.sqrt(effective)
