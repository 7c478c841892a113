"""Compute logarithms of Poisson probabilities and of their sums, accurately for any number of
counts.
"""

import math

import jax
import jax.numpy as jnp
from jax.scipy.special import gammainc, gammaincc
from jaxtyping import Array, Float

from jaxvision.sensor.shot_noise import poisson_deviance, stirling_remainder

from .inference.likelihoods import HALF_LOG_2PI
from .inference.tails import log1mexp, log_ndtr

# counts above which the saddle point is more accurate than XLA's gammainc, by bytes per number
_COUNTS = {4: 100.0, 8: 1e5}
_SERIES_BELOW = 0.03  # root of the deviance below which its series is accurate to rounding
# remainders of Stirling's formula, for 1, 2, ... counts
_REMAINDERS = [
    math.lgamma(n + 1) - (n + 0.5) * math.log(n) + n - HALF_LOG_2PI for n in range(1, 32)
]


def log_poisson(n: Float[Array, "..."], mean: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return Poisson's ln P(N = n) without cancellation of large terms (Loader 2000)."""
    some = jnp.maximum(n, 1)
    few = jnp.asarray(_REMAINDERS, some.dtype)[jnp.minimum(some, 31).astype(jnp.int32) - 1]
    remainder = jnp.where(some < 32, few, stirling_remainder(some))
    likely = -poisson_deviance(some, some - mean, mean) - remainder
    likely = likely - jnp.log(some) / 2 - HALF_LOG_2PI
    return jnp.where(n > 0, likely, jnp.where(n == 0, -mean, -jnp.inf))


@jax.custom_jvp
def log_poisson_tails(
    n: Float[Array, "..."], mean: Float[Array, "..."]
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Return ln P(N < n) and ln P(N >= n) of the Poisson distribution, differentiable with respect
    to the mean.

    The probabilities are computed from the incomplete gamma function, which in XLA is inaccurate
    for many counts. There, and in far tails of few counts, the saddle-point approximation is used
    (Barndorff-Nielsen's r*), with errors of 1e-6 in float32 and 1e-10 in float64.
    """
    excess = mean - n
    eta = jnp.sign(excess) * jnp.sqrt(2 * poisson_deviance(n, -excess, mean) / n)
    alike = jnp.abs(eta) < _SERIES_BELOW
    off = jnp.where(alike, 1, eta)
    shift = jnp.where(
        alike,
        1 / 3 - eta / 36 - eta**2 / 1620 + 7 * eta**3 / 6480,
        jnp.log(jnp.where(alike, 1, excess / n / off)) / off,
    )
    star = eta * jnp.sqrt(n) + shift / jnp.sqrt(n)
    limit = _COUNTS[8 if star.dtype == jnp.float64 else 4]
    few = jnp.minimum(n, limit)

    below, above = gammaincc(few, mean), gammainc(few, mean)

    def log_tail(
        tail: Float[Array, "..."], other: Float[Array, "..."], deviate: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        summed = (n < limit) & (tail > jnp.finfo(tail.dtype).tiny)
        large = tail > 0.5
        other = jnp.log(jnp.where(large, other, 0.5))
        small = jnp.log(jnp.where(summed & ~large, tail, 1))
        directly = jnp.where(large, log1mexp(other), small)
        return jnp.where(summed, directly, log_ndtr(deviate))

    return log_tail(below, above, -star), log_tail(above, below, star)


@log_poisson_tails.defjvp
def _log_poisson_tails_jvp(primals, tangents):
    n, mean = primals
    below, above = log_poisson_tails(n, mean)
    last = log_poisson(n - 1, mean)
    slopes = -jnp.exp(last - below), jnp.exp(last - above)
    return (below, above), tuple(slope * tangents[1] for slope in slopes)
