"""Compute uncertainty bands for functions of the parameters and for predicted data, from the draws
of a fit.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxvision.core.parallel_loops import map_
from jaxvision.errors import InputError

from ..inference.formatting import format_spread, format_with_error
from ..inference.given import require_whole
from ..inference.likelihoods import scale_noise
from ..inference.posterior import Posterior
from ..inference.problem import Problem, give, likelihood_at, prediction, values_from

LEVELS = (0.16, 0.84, 0.025, 0.975)
BATCH = 8  # draws evaluated at a time


@dataclass(frozen=True)
class Bands:
    """A quantity derived from the parameters, with its uncertainty.

    Attributes:
        mean: mean of the draws, in the unit of the quantity.
        sd: standard deviation of the draws.
        interval_68: (2, ...) lower and upper end of the 68 % interval.
        interval_95: (2, ...) lower and upper end of the 95 % interval.
        draws: (draws, ...) values of the quantity at the draws of the parameters.

    Example:
        >>> import jaxvision as jv
        >>> from fitting import Gaussian, Parameter, Problem, fit
        >>> free = {"gain": Parameter(start=1.0), "bias": Parameter(start=0.0)}
        >>> line = {"x": np.array([-1.0, 0.0, 1.0]), **free}
        >>> found = fit(Problem(line, jv.gain_bias, Gaussian(sd=0.1), np.array([1.0, 3.0, 5.0])))
        >>> bands = found.derived(lambda gain, bias: bias - gain)  # of sd 0.1 sqrt(1 / 2 + 1 / 3)
        >>> round(float(bands.mean), 1), round(float(bands.sd), 2)
        (1.0, 0.09)
    """

    mean: Float[np.ndarray, "..."]
    sd: Float[np.ndarray, "..."]
    interval_68: Float[np.ndarray, "2 ..."]
    interval_95: Float[np.ndarray, "2 ..."]
    draws: Float[np.ndarray, "draws ..."]

    def __str__(self) -> str:
        """Return one number with its interval, or the shape and the ranges of many numbers."""
        if self.mean.ndim == 0:
            ends = ", ".join(f"{float(end):.6g}" for end in self.interval_95)
            return f"{format_with_error(float(self.mean), float(self.sd))}, 95 % in [{ends}]"
        shape = " x ".join(map(str, self.mean.shape))
        finite = np.isfinite(self.mean) & np.isfinite(self.sd)
        if not finite.any():
            return f"Bands of {shape} numbers, none of them finite"
        mean, sd = (format_spread(of[finite])[1] for of in (self.mean, self.sd))
        return f"Bands of {shape} numbers: 90 % of the means in {mean}, of the s.d. in {sd}"

    def _repr_html_(self) -> str:
        return f"<p>{self}</p>"


def thinned_draws(posterior: Posterior, draws: int) -> np.ndarray:
    """Return at most `draws` posterior draws (draws, P), evenly spaced over all chains, in the
    parameters' units.
    """
    require_whole("draws", draws)
    every = posterior.samples
    return every[np.linspace(0, len(every) - 1, min(draws, len(every))).astype(int)]


@eqx.filter_jit
def evaluate_draws(problem: Problem, function: Callable[..., Any], natural: Array) -> Array:
    """Evaluate a function of the parameters at every draw."""

    def evaluate(natural: Array) -> Array:
        found = give(problem, function, values_from(problem, natural), problem.inputs)
        try:
            return jnp.asarray(found)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"derived: the function returns a {type(found).__name__}, not an array; return "
                "one array, or call derived once for each."
            ) from error

    return map_(evaluate, natural, batch_size=BATCH)


@eqx.filter_jit
def simulate_data(
    problem: Problem, keys: Array, natural: Array, inputs: Any, noise: Array
) -> Array:
    """Simulate one data set from each draw of the parameters."""

    def simulate(key_and_natural: tuple[Array, Array]) -> Array:
        key, natural = key_and_natural
        values = values_from(problem, natural)
        likelihood = likelihood_at(problem, values)
        louder = scale_noise(likelihood, noise)
        predicted = prediction(problem, values, inputs=inputs)
        return (likelihood if louder is None else louder).draw(key, predicted)

    return map_(simulate, (keys, natural), batch_size=BATCH)


def bands(draws: np.ndarray) -> Bands:
    """Return the mean, the standard deviation and the intervals of a quantity over its draws."""
    low68, high68, low95, high95 = np.quantile(draws, LEVELS, axis=0)
    return Bands(
        np.asarray(draws.mean(0)),
        np.asarray(draws.std(0)),
        np.stack([low68, high68]),
        np.stack([low95, high95]),
        draws,
    )
