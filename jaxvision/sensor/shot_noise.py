"""Counting electrons: Poisson draws, exact or by inversion, or Gaussian draws.

The fast sampler turns one uniform number into a count by the inverse of the Poisson distribution.
Up to a mean of 10 the distribution is summed; above, its inverse is an expansion in z, the Gaussian
quantile of the same probability (Giles, "Algorithm 955: approximation of the inverse Poisson
cumulative distribution function", ACM TOMS 42 (2016), Q_N2):

    x = mu + sqrt(mu) z + (1/3 + z^2/6) - (z/36 + z^3/72) / sqrt(mu)
        + (-8/405 + 7 z^2/810 + z^4/270) / mu,         N = floor(x)

A count is differentiated along the draw, as if its deviation from the mean grew like the noise:

    N(m) = m + (N - m_0) sqrt(m / m_0),    dN/dm = 1/2 + N / (2 m)

On average the slope is 1, and that of N^2 is 2 m + 1: gradients of first and second moments are
unbiased at every light level. Those of N^3 are too large by 1/2 (of 3 m^2 + 6 m + 1), and the slope
of one draw has the variance 1 / (4 m), so that faint light needs many pixels. For expected images
use `expected_signal` and `signal_variance`, whose gradients have no noise.
"""

import jax
import jax.numpy as jnp

from .._arguments import takes_numbers
from .._numerics import divide, safe_sqrt, smallest_divisor, with_gradient_of
from .._types import Key, Scalars
from ..scene import FastPoissonShotNoise, GaussianShotNoise, PoissonShotNoise, ShotNoise
from ._draws import Frame, Words, gaussian, subkey, tail_probability, upper_quantile, words

MOST_ELECTRONS = 2.0**30  # larger Poisson means are drawn as this one: counts are 32-bit integers
SUMMED_MEAN = 10.0  # up to here the distribution is summed
SUMMED_COUNTS = 38  # P(N >= 38) is 4e-11 at a mean of 10, below the smallest uniform number


@takes_numbers
def count(key: Key, mean: Scalars, shot_noise: ShotNoise) -> Scalars:
    """Draws the electrons counted in each pixel.

    `FastPoissonShotNoise` differs from the Poisson distribution in total variation by less than
    2e-6 up to a mean of 10 and 1.4e-4 just above, falling to 2e-5 from 1000 on, for means up to
    1e5, in float32 too; its mean is right to 1e-6, its variance to 3e-4. All are differentiated
    along the draw, by 1/2 + N / (2 mean), which leaves the slopes of first and second moments
    unbiased; its variance is 1 / (4 mean).

    Args:
        key: random key of the frame.
        mean: (...) expected electrons; a mean below 0 counts as 0, and NaN stays NaN.
        shot_noise: which distribution is drawn.

    Returns:
        (...) electrons in the dtype of `mean`; whole numbers unless Gaussian.

    Example:
        >>> electrons = jnp.full(10000, 100.0)
        >>> drawn = jv.sensor.count(jax.random.key(0), electrons, jv.GaussianShotNoise())
        >>> print(round(float(drawn.var() / drawn.mean()), 1))  # as of Poisson's distribution
        1.0
    """
    match shot_noise:
        case PoissonShotNoise():
            expected = jnp.clip(jax.lax.stop_gradient(mean), 0, MOST_ELECTRONS)
            drawn = jax.random.poisson(subkey(key, Frame.SHOT), expected).astype(mean.dtype)
            return _along_draw(jnp.where(jnp.isnan(expected), expected, drawn), mean)
        case FastPoissonShotNoise():
            return _inverse_poisson(words(key, Frame.SHOT, mean.shape), mean)
        case GaussianShotNoise():
            expected = jnp.maximum(mean, 0)
            return expected + safe_sqrt(expected) * gaussian(
                key, Frame.SHOT, mean.shape, mean.dtype
            )


def _inverse_poisson(bits: Words, mean: Scalars) -> Scalars:
    """The count that a Poisson variable of that `mean` exceeds with a probability of at most (bits
    + 1/2) / 2^32; `bits`: 32 uniform ones for each entry.
    """
    bounded = jax.lax.stop_gradient(jnp.clip(mean, 0, MOST_ELECTRONS))
    few = bounded < SUMMED_MEAN
    many = jnp.where(few, SUMMED_MEAN, bounded)
    z, root = upper_quantile(bits, mean.dtype), jnp.sqrt(many)
    # the remainder is small beside a large mean and keeps its digits if rounded separately
    whole = jnp.floor(many)
    x = (many - whole) + root * z + (1 / 3 + z**2 / 6)
    x = x - (z / 36 + z**3 / 72) / root + (-8 / 405 + 7 * z**2 / 810 + z**4 / 270) / many
    counted = jnp.maximum(whole + jnp.floor(x), 0)
    summed = _summed_inverse(tail_probability(bits, mean.dtype), jnp.where(few, bounded, 0))
    return _along_draw(jnp.where(few, summed, counted), mean)


def _along_draw(drawn: Scalars, mean: Scalars) -> Scalars:
    """A count with the slope 1/2 + N / (2 mean); 1 without light."""
    slope = divide(drawn + mean, 2 * mean, ~(mean <= smallest_divisor(mean.dtype)), otherwise=1)
    return with_gradient_of(jax.lax.stop_gradient(drawn), jax.lax.stop_gradient(slope) * mean)


def _summed_inverse(probability: Scalars, mean: Scalars) -> Scalars:
    """How many of the survival functions P(N > 0), P(N > 1), ... exceed `probability`; each is
    summed from its small end, so that rare counts keep their digits.
    """
    terms = [mean * jnp.exp(-mean)]
    for n in range(2, SUMMED_COUNTS):
        terms.append(terms[-1] * (mean / n))
    survival, counted = jnp.zeros_like(mean), jnp.zeros_like(mean)
    for term in reversed(terms):
        survival = survival + term
        counted = counted + (probability < survival).astype(mean.dtype)
    return counted
