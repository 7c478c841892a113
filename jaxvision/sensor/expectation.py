"""Expectations over the electrons that a pixel counts, with slopes in the mean.

A draw has no derivative; an expectation has. Three estimators of d E[f(N)] / dm from draws of
N ~ Poisson(m), each the mean over the draws of

    pathwise          f'(N) (1/2 + N / (2 m)), as `count` is differentiated: unbiased for
                      polynomials up to the second degree, not beyond (by 1/2 for N^3); blind to a
                      step of f
    measure_valued    f(N + 1) - f(N): unbiased for any f of each pixel alone
    score             (f(N) - b) (N / m - 1), b being the mean of f over the other draws: unbiased
                      for any f, also of a whole picture to one number; its variance grows like 1/m
                      in faint light, and with the number of pixels

Expected images need no draw: `expected_signal`, `signal_variance` and `clipped_moments` have the
slopes of their closed forms. Sources: Mohamed et al., "Monte Carlo Gradient Estimation in Machine
Learning", JMLR 21 (2020); for the difference, Last & Penrose, Lectures on the Poisson Process
(2017), section 19.1.
"""

from collections.abc import Callable

import jax
from jaxtyping import Array, Float

from .._arguments import takes_numbers
from .._numerics import divide, smallest_divisor, with_gradient_of
from .._types import Key, Scalars, check_choice, check_count
from ..scene import PoissonShotNoise
from .shot_noise import count

ESTIMATORS = ("pathwise", "measure_valued", "score")


@takes_numbers
def expected_of_count(
    key: Key,
    mean: Scalars,
    function: Callable[[Scalars], Scalars],
    *,
    estimator: str = "measure_valued",
    draws: int = 2,
) -> Float[Array, "..."]:
    """E[f(N)] of Poisson counts by a mean over draws; its gradient is the estimator's.

    Gradients also reach what `function` closes over. Second derivatives in the mean are not those
    of the expectation.

    Args:
        key: random key.
        mean: (...) expected electrons of each pixel, > 0; a mean of 0 has the slope 1 of `count`
            with "pathwise", 0 with "score".
        function: of counts (...), electrons, to values (...) in any unit, each of its own pixel
            alone; with "pathwise" and "score" also of all pixels to one value ().
        estimator: "pathwise", "measure_valued" or "score".
        draws: static; at least 2 for "score", whose baseline is made of the others.

    Returns:
        What `function` returns, averaged over the draws.

    Raises:
        ValueError: another estimator, too few draws, or values of another shape.

    Example:
        The chance of an empty pixel, exp(-m), is a step of the count, which has no slope along it.

        >>> def empty(n):
        ...     return jnp.where(n < 0.5, 1.0, 0.0)
        >>> def chance(m):
        ...     key = jax.random.key(0)
        ...     return jv.sensor.expected_of_count(key, m, empty, draws=10_000)
        >>> round(float(jax.grad(chance)(jnp.array(1.0))), 1)  # -exp(-1)
        -0.4
    """
    check_choice("estimator", estimator, ESTIMATORS)
    check_count("draws", draws, 2 if estimator == "score" else 1)
    keys = jax.random.split(key, draws)
    numbers = jax.vmap(lambda one: count(one, mean, PoissonShotNoise()))(keys)
    if estimator == "pathwise":
        return jax.vmap(function)(numbers).mean(0)
    numbers = jax.lax.stop_gradient(numbers)
    values = jax.vmap(function)(numbers)
    whole = mean.ndim > 0 and values.ndim == 1
    if values.shape[1:] != mean.shape and not (whole and estimator == "score"):
        raise ValueError(
            f"function must return values of shape {mean.shape} with estimator {estimator!r}, got "
            f"{values.shape[1:]}."
        )
    if estimator == "measure_valued":
        weights = jax.vmap(function)(numbers + 1) - values
    else:
        others = (values.sum(0, keepdims=True) - values) / (draws - 1)
        lit = ~(mean <= smallest_divisor(mean.dtype))
        weights = jax.vmap(lambda n, value: value * divide(n - mean, mean, lit))(
            numbers, values - others
        )
    along_mean = jax.lax.stop_gradient(weights.mean(0)) * mean
    average = values.mean(0)
    along_mean = along_mean.sum() if whole else along_mean
    return with_gradient_of(jax.lax.stop_gradient(average), average + along_mean)
