"""Shot noise: electron counts as exact Poisson draws, fast Poisson draws by inversion, or Gaussian
draws.

Up to a mean of 10, both Poisson samplers sum the distribution. Above 10, the exact sampler uses
rejection (Hörmann, "The transformed rejection method for generating Poisson random variables",
Insurance: Mathematics and Economics 12 (1993), PTRS). The log-probability of a count n is computed
from n - mu in Loader's form ("Fast and Accurate Computation of Binomial Probabilities", 2000), in
which no term is larger than the result. The usual form n ln mu - mu - ln n! loses 30 bits at a mean
of mu = 1e9. `jax.random.poisson` uses the usual form in float32, so that its variance is wrong
above a mean of 2e5.

The fast sampler maps one uniform number to a count by the inverse of the Poisson distribution. Up
to a mean of 10 the distribution is summed. Above 10, the inverse is expanded in z, the Gaussian
quantile of the same probability (Giles, "Algorithm 955: approximation of the inverse Poisson
cumulative distribution function", ACM TOMS 42 (2016), Q_N2):

    x = mu + sqrt(mu) z + (1/3 + z^2/6) - (z/36 + z^3/72) / sqrt(mu)
        + (-8/405 + 7 z^2/810 + z^4/270) / mu,         N = floor(x)

For the derivative, the draw N at the mean m_0 is reparameterised: its deviation from the mean is
assumed to scale with the standard deviation:

    N(m) = m + (N - m_0) sqrt(m / m_0),    dN/dm = 1/2 + N / (2 m)

The expected derivative of N is 1, and that of N^2 is 2 m + 1, so gradients of first and second
moments are unbiased at every light level. The derivative of N^3, which is 3 m^2 + 6 m + 1, is
overestimated by 1/2. The derivative of a single draw has the variance 1 / (4 m), so faint light
needs an average over many pixels. For expected images use `expected_signal` and `signal_variance`,
whose gradients have no noise.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, UInt32

from ..core._arguments import takes_numbers
from ..core._loops.fusion import one_program
from ..core._numerics import divide, polynomial, replace_gradient, safe_sqrt, smallest_divisor
from ..core._random import seed_of
from ..core._types import Key, Scalars, as_float, is_known
from ..core.parallel_loops import while_loop
from ..scene import FastPoissonShotNoise, GaussianShotNoise, ShotNoise
from ._draws import (
    Frame,
    Words,
    centred_probability,
    counting_dtype,
    gaussian,
    subkey,
    tail_probability,
    threefry,
    upper_quantile,
    words,
)

MOST_ELECTRONS = 2.0**31  # largest Poisson mean for which the samplers' errors were measured
SUMMED_MEAN = 10.0  # up to this mean the distribution is summed; Hörmann's constants hold above
MOST_PROPOSALS = 256  # then the count is NaN; each proposal is accepted with a chance above 1/2
SUMMED_COUNTS = 38  # P(N >= 38) is 4e-11 at a mean of 10, below the smallest uniform number


@takes_numbers
def count(key: Key, mean: Scalars, shot_noise: ShotNoise) -> Scalars:
    """Draw the number of electrons counted in each pixel.

    With `PoissonShotNoise` the cumulative probabilities are accurate to 3e-6 at every mean up to
    2^31, also in float32. `FastPoissonShotNoise` differs from it in total variation by less than
    2e-6 up to a mean of 10. Just above 10 the difference is 1.4e-4, and it falls to 2e-5 for means
    above 1000. The relative error of the mean is at most 1e-6, that of the variance 3e-4. In
    float32, counts above 2^24 are rounded to the nearest representable number. The derivative of a
    count N is 1/2 + N / (2 mean). Gradients of first and second moments are unbiased, and the
    variance of the derivative is 1 / (4 mean).

    Args:
        key: random key of the frame.
        mean: (...) expected electrons; negative values are set to 0, and NaN stays NaN. At most
            2^31 for Poisson draws; larger traced values give NaN.
        shot_noise: distribution of the draws.

    Returns:
        (...) electrons in the dtype of `mean`, or in floating point if that is an integer; whole
        numbers unless Gaussian. Draws of a narrower dtype than float32 are rounded from float32.

    Raises:
        ValueError: if the mean of Poisson draws is above 2^31, unless traced.

    Example:
        >>> electrons = jnp.full(10000, 100.0)
        >>> drawn = jv.sensor.count(jax.random.key(0), electrons, jv.GaussianShotNoise())
        >>> print(round(float(drawn.var() / drawn.mean()), 1))  # as of Poisson's distribution
        1.0
    """
    if not jnp.issubdtype(mean.dtype, jnp.floating):
        mean = as_float(mean)
    given, mean = mean.dtype, mean.astype(counting_dtype(mean.dtype))
    if isinstance(shot_noise, GaussianShotNoise):
        expected = jnp.maximum(mean, 0)
        noise = gaussian(key, Frame.SHOT, mean.shape, mean.dtype)
        return (expected + safe_sqrt(expected) * noise).astype(given)
    _check_countable(mean)
    expected = jnp.maximum(jax.lax.stop_gradient(mean), 0)
    bits = words(key, Frame.SHOT, mean.shape)
    if isinstance(shot_noise, FastPoissonShotNoise):
        drawn = _inverse_poisson(bits, expected)
    else:
        drawn = _exact_poisson(subkey(key, Frame.SHOT), bits, expected)
    # also where the mean is NaN, for which no comparison holds
    counted = _differentiable_count(jnp.where(expected <= MOST_ELECTRONS, drawn, jnp.nan), mean)
    return counted.astype(given)


def _check_countable(mean: Scalars) -> None:
    """Raise `ValueError` for means beyond the range of the Poisson draws; means that JAX traces are
    not checked."""
    if is_known(mean) and (beyond := np.asarray(mean) > MOST_ELECTRONS).any():
        raise ValueError(
            f"mean must be at most {MOST_ELECTRONS:.0f} electrons for Poisson draws, got "
            f"{np.asarray(mean)[beyond].flat[0]:g}; give the sensor a full_well, or use "
            "GaussianShotNoise."
        )


def _exact_poisson(key: Key, bits: Words, mean: Scalars) -> Scalars:
    """Draw a Poisson count for each mean, from 32 uniform bits for each entry."""
    few = mean < SUMMED_MEAN
    summed = _summed_inverse(tail_probability(bits, mean.dtype), jnp.where(few, mean, 0))
    many = (mean >= SUMMED_MEAN) & (mean <= MOST_ELECTRONS)
    return jnp.where(few, summed, _rejection_draws(key, jnp.where(many, mean, SUMMED_MEAN), ~many))


@one_program
def _rejection_draws(key: Key, mean: Scalars, done: Bool[Array, "..."]) -> Scalars:
    """Draw Poisson counts for means of at least 10, by rejection. Proposals are differences from
    the integer part of the mean, and are tested in float32. Where `done` is true, no count is
    needed, and the result is the integer part of the mean."""
    seed = seed_of(key)
    place = jax.lax.iota(jnp.uint32, mean.size).reshape(mean.shape)
    whole = jnp.floor(mean)
    part = mean - whole
    b = 0.931 + 2.53 * jnp.sqrt(mean)
    a = -0.059 + 0.02483 * b
    inverse_alpha = 1.006 * (1.1239 + 1.1328 / (b - 3.4))  # Hörmann's hat is up to 0.5 % too low
    shape = [x.astype(jnp.float32) for x in (part, mean, a, b, inverse_alpha)]

    def propose(state: tuple[UInt32[Array, ""], Scalars]) -> tuple[UInt32[Array, ""], Scalars]:
        attempt, drawn = state
        first, second = threefry(seed, place, attempt)
        u, edge = centred_probability(first, mean.dtype)
        steps = jnp.floor((2 * a / edge + b) * u + (part + 0.43))
        accepted = _accept(second, steps.astype(jnp.float32), edge.astype(jnp.float32), *shape)
        accepted &= (steps >= -whole) & jnp.isnan(drawn)
        return attempt + 1, jnp.where(accepted, steps, drawn)

    # one array of state, NaN where nothing is drawn yet, because XLA would need two loops for two
    start = jnp.zeros((), jnp.uint32), jnp.where(done, 0, jnp.nan).astype(mean.dtype)

    def is_left(state: tuple[UInt32[Array, ""], Scalars]) -> Bool[Array, ""]:
        return jnp.isnan(state[1]).any() & (state[0] < MOST_PROPOSALS)

    _, steps = while_loop(is_left, propose, start)
    return whole + steps


def _accept(
    bits: Words,
    steps: Scalars,
    edge: Scalars,
    part: Scalars,
    mean: Scalars,
    a: Scalars,
    b: Scalars,
    inverse_alpha: Scalars,
) -> Bool[Array, "..."]:
    """Return whether a proposal of the rejection sampler is accepted, given its random bits."""
    height = tail_probability(bits, mean.dtype) * inverse_alpha / (a / (edge * edge) + b)
    return height <= _poisson_probability(steps - part, mean)


def _poisson_probability(excess: Scalars, mean: Scalars) -> Scalars:
    """Return P(N = mean + excess) for a Poisson variable N, from Loader's form for the next count:
    P(n) = P(n + 1) (n + 1) / mean."""
    n = jnp.maximum(mean + (excess + 1), 1)
    size = jnp.exp(-poisson_deviance(n, excess + 1, mean) - stirling_remainder(n))
    return size * jnp.sqrt(n / (2 * np.pi)) / mean


# Coefficients 1/3, 1/5, ... of arctanh(v) - v, truncated below an ULP at v = 0.1, for numbers of 4
# and 8 bytes.
_ARCTANH = {4: [1 / k for k in (9, 7, 5, 3)], 8: [1 / k for k in range(17, 1, -2)]}


@takes_numbers
def poisson_deviance(n: Scalars, excess: Scalars, mean: Scalars) -> Scalars:
    """Return Loader's deviance D_0 = n ln(n / mean) - excess, no unit, without cancellation, for
    counts n >= 1. The argument `excess` = n - mean, in electrons, must be more accurate than the
    difference of the rounded n and mean."""
    v = excess / (n + mean)
    square = v * v
    near = v * square * polynomial(_ARCTANH[8 if v.dtype == jnp.float64 else 4], square)
    return excess * v + 2 * n * jnp.where(square < 0.01, near, jnp.log(n / mean) / 2 - v)


@takes_numbers
def stirling_remainder(n: Scalars) -> Scalars:
    """Return the remainder of Stirling's formula, ln n! - (n + 1/2) ln n + n - ln(2 pi) / 2, no
    unit, by a continued fraction. The error is 1e-5 at n = 1 and 1e-13 for n >= 30."""
    fraction = n
    for term in (22999 / 22737, 195 / 371, 53 / 210, 1 / 30):
        fraction = n + term / fraction
    return 1 / 12 / fraction


def _inverse_poisson(bits: Words, mean: Scalars) -> Scalars:
    """Return the smallest count that a Poisson variable of this `mean` exceeds with a probability
    of at most (bits + 1/2) / 2^32, from 32 uniform bits for each entry.
    """
    few = mean < SUMMED_MEAN
    many = jnp.where(few, SUMMED_MEAN, mean)
    z, root = upper_quantile(bits, mean.dtype), jnp.sqrt(many)
    # the terms below are small compared with a large mean, and are precise if rounded separately
    whole = jnp.floor(many)
    x = (many - whole) + root * z + (1 / 3 + z**2 / 6)
    x = x - (z / 36 + z**3 / 72) / root + (-8 / 405 + 7 * z**2 / 810 + z**4 / 270) / many
    counted = jnp.maximum(whole + jnp.floor(x), 0)
    summed = _summed_inverse(tail_probability(bits, mean.dtype), jnp.where(few, mean, 0))
    return jnp.where(few, summed, counted)


def _differentiable_count(drawn: Scalars, mean: Scalars) -> Scalars:
    """Return a count N with the derivative 1/2 + N / (2 mean) with respect to the mean, or 1 if the
    mean is 0."""
    slope = divide(drawn + mean, 2 * mean, ~(mean <= smallest_divisor(mean.dtype)), otherwise=1)
    return replace_gradient(jax.lax.stop_gradient(drawn), jax.lax.stop_gradient(slope) * mean)


def _summed_inverse(probability: Scalars, mean: Scalars) -> Scalars:
    """Return how many of the tail probabilities P(N > 0), P(N > 1), ... of a Poisson variable N
    exceed `probability`. Each tail is summed from its smallest term, so that the probabilities of
    rare counts are accurate.
    """
    terms = [mean * jnp.exp(-mean)]
    for n in range(2, SUMMED_COUNTS):
        terms.append(terms[-1] * (mean / n))
    survival, counted = jnp.zeros_like(mean), jnp.zeros_like(mean)
    for term in reversed(terms):
        survival = survival + term
        counted = counted + (probability < survival).astype(mean.dtype)
    return counted
