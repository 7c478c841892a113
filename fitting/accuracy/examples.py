"""Example problems, for the settings that the fits of a rig do not use."""

from collections.abc import Callable, Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxvision.accuracy import Problem
from jaxvision.accuracy.records import Compute
from jaxvision.errors import InputError, nearest

from .. import Gaussian, Parameter, fit
from .. import Problem as Fitted
from ..inference.problem import log_density
from .chains import Density, chain_knobs

CYCLES = 3.7  # cycles of the sine over the data, whose likelihood has many optima


def sine() -> Fitted:
    """Fit a sine of unknown frequency to noisy data: the likelihood has many local optima."""
    time = np.linspace(0, 1, 200)
    noise = 0.5 * np.random.default_rng(0).standard_normal(200)
    return Fitted(
        {"cycles": Parameter(lower=0.1, upper=20), "phase": Parameter(lower=-2, upper=2)},
        predict=lambda cycles, phase, inputs: jnp.sin(2 * jnp.pi * cycles * inputs + phase),
        likelihood=Gaussian(sd=0.5),
        data=np.sin(2 * np.pi * CYCLES * time + 0.4) + noise,
        inputs=time,
    )


def _starts() -> Problem:
    problem = sine()
    best = fit(problem)
    errors = np.sqrt(np.diagonal(best.posterior.covariance))

    def prepare(settings: Mapping[str, Any]) -> Compute:
        starts = settings["starts"]
        return lambda seed: fit(problem, starts=starts, seed=seed).optimum.vector / errors

    return Problem("a sine of unknown frequency", prepare)


def _draws() -> Problem:
    problem = sine()
    best = fit(problem)
    about = jnp.asarray(best.optimum.vector), best.posterior.covariance
    turned = chain_knobs(Density(log_density, problem.space, *about, problem))["Laplace draws"]
    return Problem(
        "ends of intervals of a sine", lambda settings: turned(settings["Laplace draws"])
    )


EXAMPLES: Mapping[str, Callable[[], Problem]] = {"starts": _starts, "Laplace draws": _draws}


def example(knob: str) -> Problem:
    """Return the problem on which a setting is measured when there is no rig."""
    if knob not in EXAMPLES:
        raise InputError(f"knob {knob!r} has no example of its own; {nearest(knob, EXAMPLES)}.")
    return EXAMPLES[knob]()
