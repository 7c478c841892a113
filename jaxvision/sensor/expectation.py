"""Expectations over random draws of a pixel, with unbiased derivatives with respect to the
parameters of the distribution.

A random draw has no derivative, but an expectation has. Three estimators of the derivative of
E[f(X)] are available, each a mean over draws. For Poisson counts N, the derivative with respect to
the mean m is estimated by:

    pathwise          f'(N) (1/2 + N / (2 m)), which is the derivative of `count`. It is unbiased
                      for polynomials f of degree <= 2, has a bias of 1/2 for N^3, and omits the
                      contribution of a step of f.
    measure_valued    f(N + 1) - f(N). It is unbiased for any f that acts on each pixel alone.
    score             (f(N) - b) (N / m - 1), where b is the mean of f over the other draws. It is
                      unbiased for any f, also from a whole picture to one number. Its variance
                      grows like 1 / m in faint light, and with the number of pixels.

For a reading X = m + s Z with Gaussian noise, which an ADC rounds and clips, the derivatives with
respect to m and s are estimated by:

    pathwise          f'(X) and f'(X) Z. They are unbiased for a continuous f, including clipping,
                      and omit the contribution of steps.
    measure_valued    (f(m + s W) - f(m - s W)) / (s sqrt(2 pi)), where W has the Rayleigh
                      distribution, and (f(m + s D) - f(X)) / s, where D has the Maxwell
                      distribution with a random sign. They are unbiased for any f that acts on
                      each pixel alone.
    score             (f(X) - b) Z / s and (f(X) - b) (Z^2 - 1) / s. They are unbiased for any f.

For a defect that a pixel has (B = 1; dead, hot or a trap) with probability p, else B = 0, the
derivative with respect to p is estimated by:

    pathwise          0, because a pixel either has the defect or not.
    measure_valued    f(1) - f(0). It is unbiased for any f that acts on each pixel alone.
    score             (f(B) - b) (B - p) / (p (1 - p)). It is unbiased for any f.

Means and variances of images need no draws: `expected_signal`, `signal_variance` and
`clipped_moments` are closed forms with exact derivatives. Sources: Mohamed et al., "Monte Carlo
Gradient Estimation in Machine Learning", JMLR 21 (2020); for the difference of counts, Last &
Penrose, Lectures on the Poisson Process (2017), section 19.1.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._numerics import divide, replace_gradient, smallest_divisor
from ..core._types import Key, Scalars, check_choice, check_count
from ..scene import PoissonShotNoise
from ._draws import Shape
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
    """Return E[f(N)] for Poisson counts N, as a mean over draws. The gradient is computed by the
    chosen estimator.

    Variables that `function` captures have gradients, too. Second derivatives with respect to the
    mean are wrong.

    Args:
        key: random key.
        mean: (...) expected electrons of each pixel, > 0; at a mean of 0 the slope is that of
            `count`, 1, with "pathwise", and 0 with "score".
        function: from counts (...), electrons, to values (...) in any unit, where each value
            depends only on its own pixel. With "pathwise" and "score", it may also map all pixels
            to one value ().
        estimator: "pathwise", "measure_valued" or "score".
        draws: number of draws, static; at least 2 for "score", whose baseline is the mean of the
            others.

    Returns:
        What `function` returns, averaged over the draws.

    Raises:
        ValueError: another estimator, too few draws, or values of another shape.

    Example:
        The chance of an empty pixel is exp(-m), but the function of the count is a step, whose
        derivative along the draw is 0.

        >>> def empty(n):
        ...     return jnp.where(n < 0.5, 1.0, 0.0)
        >>> def chance(m):
        ...     key = jax.random.key(0)
        ...     return jv.sensor.expected_of_count(key, m, empty, draws=10_000)
        >>> round(float(jax.grad(chance)(jnp.array(1.0))), 1)  # -exp(-1)
        -0.4
    """
    keys = _keys(key, estimator, draws)
    numbers = jax.vmap(lambda one: count(one, mean, PoissonShotNoise()))(keys)
    if estimator == "pathwise":
        return jax.vmap(function)(numbers).mean(0)
    numbers = jax.lax.stop_gradient(numbers)
    values = _values(function, numbers, mean.shape, estimator)
    if estimator == "measure_valued":
        slope = (jax.vmap(function)(numbers + 1) - values).mean(0)
    else:
        lit = ~(mean <= smallest_divisor(mean.dtype))
        slope = _score(values, jax.vmap(lambda n: divide(n - mean, mean, lit))(numbers))
    return _attach_slopes(values.mean(0), (slope, mean))


@takes_numbers
def expected_of_reading(
    key: Key,
    mean: Scalars,
    rms: Scalars,
    function: Callable[[Scalars], Scalars],
    *,
    estimator: str = "measure_valued",
    draws: int = 2,
) -> Float[Array, "..."]:
    """Return E[f(X)] for readings X with Gaussian noise, as a mean over draws. The gradient is
    computed by the chosen estimator. `function` may round and clip, as an ADC does.

    Variables that `function` captures have gradients, too. Second derivatives are wrong.

    Args:
        key: random key.
        mean: (...) expected reading of each pixel, in any unit.
        rms: () standard deviation of the noise, in that unit, > 0; at 0 only "pathwise" has a
            slope.
        function: from readings (...) to values (...) in any unit, where each value depends only on
            its own pixel. With "pathwise" and "score", it may also map all pixels to one value ().
        estimator: "pathwise", "measure_valued" or "score".
        draws: number of draws, static; at least 2 for "score", whose baseline is the mean of the
            others.

    Returns:
        What `function` returns, averaged over the draws.

    Raises:
        ValueError: another estimator, too few draws, or values of another shape.

    Example:
        A reading with noise of 0.1, half-way between two whole numbers and rounded to these, grows
        on average four times as fast as the light.

        >>> def number(m):
        ...     key = jax.random.key(0)
        ...     return jv.sensor.expected_of_reading(key, m, 0.1, jnp.round, draws=10_000)
        >>> round(float(jax.grad(number)(jnp.array(0.5))), 1)
        4.0
    """
    keys = _keys(key, estimator, draws)
    z = jax.vmap(lambda one: jax.random.normal(one, mean.shape, mean.dtype))(keys)
    noisy = jax.vmap(lambda one: mean + rms * one)
    if estimator == "pathwise":
        return jax.vmap(function)(noisy(z)).mean(0)
    held_mean, held_rms = jax.lax.stop_gradient((mean, rms))
    held = jax.vmap(lambda one: held_mean + held_rms * one)
    values = _values(function, held(z), mean.shape, estimator)
    spread = ~(held_rms <= smallest_divisor(rms.dtype))
    if estimator == "measure_valued":
        away, aside = jax.vmap(lambda one: _draw_rayleigh_and_maxwell(one, mean))(keys)
        apart = jax.vmap(function)(held(away)) - jax.vmap(function)(held(-away))
        by_mean = divide(apart.mean(0), held_rms * np.sqrt(2 * np.pi), spread)
        by_rms = divide((jax.vmap(function)(held(aside)) - values).mean(0), held_rms, spread)
    else:
        by_mean = divide(_score(values, z), held_rms, spread)
        by_rms = divide(_score(values, z * z - 1), held_rms, spread)
    return _attach_slopes(values.mean(0), (by_mean, mean), (by_rms, rms))


def _draw_rayleigh_and_maxwell(key: Key, mean: Scalars) -> tuple[Scalars, Scalars]:
    """Draw from the Rayleigh distribution, and from the Maxwell distribution with a random sign."""
    flat, deep, sign = jax.random.split(jax.random.fold_in(key, 1), 3)
    rayleigh = jnp.sqrt(jax.random.chisquare(flat, 2, shape=mean.shape, dtype=mean.dtype))
    maxwell = jnp.sqrt(jax.random.chisquare(deep, 3, shape=mean.shape, dtype=mean.dtype))
    return rayleigh, maxwell * jax.random.rademacher(sign, mean.shape, mean.dtype)


@takes_numbers
def expected_of_defect(
    key: Key,
    chance: Scalars,
    function: Callable[[Scalars], Scalars],
    *,
    estimator: str = "measure_valued",
    draws: int = 2,
) -> Float[Array, "..."]:
    """Return E[f(B)] for pixels that have a defect (B = 1) with a given probability, else B = 0, as
    a mean over draws. The gradient is computed by the chosen estimator.

    Variables that `function` captures have gradients, too. Second derivatives are wrong.

    Args:
        key: random key.
        chance: (...) probability of a defect in each pixel, no unit, in [0, 1]; at 0 and 1 the
            slope is 0 with "score".
        function: from 0 and 1 (...) to values (...) in any unit, where each value depends only on
            its own pixel. With "pathwise" and "score", it may also map all pixels to one value ().
        estimator: "pathwise", "measure_valued" or "score".
        draws: number of draws, static; at least 2 for "score", whose baseline is the mean of the
            others.

    Returns:
        What `function` returns, averaged over the draws.

    Raises:
        ValueError: another estimator, too few draws, or values of another shape.

    Example:
        A pixel of 100 electrons that is dead with a chance of 1 in 1000:

        >>> def signal(p):
        ...     key = jax.random.key(0)
        ...     return jv.sensor.expected_of_defect(key, p, lambda dead: 100 * (1 - dead))
        >>> float(jax.grad(signal)(jnp.array(0.001)))
        -100.0
    """
    keys = _keys(key, estimator, draws)
    held = jax.lax.stop_gradient(chance)

    def draw_defects(one: Key) -> Scalars:
        defect = jax.random.uniform(one, held.shape, held.dtype) < held
        return jnp.where(jnp.isnan(held), held, defect.astype(held.dtype))

    defects = jax.vmap(draw_defects)(keys)
    if estimator == "pathwise":
        return jax.vmap(function)(defects).mean(0)
    values = _values(function, defects, chance.shape, estimator)
    if estimator == "measure_valued":
        slope = function(jnp.ones_like(held)) - function(jnp.zeros_like(held))
    else:
        variance = held * (1 - held)
        varies = ~(variance <= smallest_divisor(held.dtype))
        weights = jax.vmap(lambda one: divide(one - held, variance, varies))(defects)
        slope = _score(values, weights)
    return _attach_slopes(values.mean(0), (slope, chance))


def _keys(key: Key, estimator: str, draws: int) -> Key:
    check_choice("estimator", estimator, ESTIMATORS)
    check_count("draws", draws, 2 if estimator == "score" else 1)
    return jax.random.split(key, draws)


def _values(
    function: Callable[[Scalars], Scalars], drawn: Scalars, shape: Shape, estimator: str
) -> Float[Array, "draws ..."]:
    values = jax.vmap(function)(drawn)
    whole = len(shape) > 0 and values.ndim == 1
    if values.shape[1:] != shape and not (whole and estimator == "score"):
        raise ValueError(
            f"function must return values of shape {shape} with estimator {estimator!r}, got "
            f"{values.shape[1:]}."
        )
    return values


def _score(
    values: Float[Array, "draws ..."], scores: Float[Array, "draws ..."]
) -> Float[Array, "..."]:
    """Return the score-function estimator of the derivative of the expectation with respect to each
    pixel's parameter."""
    others = (values.sum(0, keepdims=True) - values) / (len(values) - 1)
    return jax.vmap(jnp.multiply)(values - others, scores).mean(0)


def _attach_slopes(average: Scalars, *slopes: tuple[Scalars, Scalars]) -> Scalars:
    """Return the average, with a given derivative with respect to each parameter. If the average is
    a single number for all pixels, the contributions of the pixels to its derivative are summed."""
    along = average
    for slope, parameter in slopes:
        change = jax.lax.stop_gradient(slope) * parameter
        along = along + (change.sum() if average.ndim == 0 else change)
    return replace_gradient(jax.lax.stop_gradient(average), along)
