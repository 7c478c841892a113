"""Moments of a standard Gaussian variable Z that is clipped at one end or to a narrow window. The
moments have full precision even where the textbook formulas subtract nearly equal numbers.

With a = |t| and the Gaussian density phi, the integrals of the tail are

    E[max(Z - a, 0)]   = phi(a) A(a) / (1 + a)^2
    E[max(Z - a, 0)^2] = phi(a) 2 B(a) / (1 + a)^3

The functions A and B vary between about 1 at a = 0 and 1 at infinity. Both are Chebyshev expansions
in (a - 4) / (a + 4), whose coefficients were computed with 60 digits and dropped below 1e-17. The
derivatives of these moments have closed forms.
"""

from math import factorial

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr
from jaxtyping import Array, Bool

from ..core._numerics import chebyshev, difference_of_products
from ..core._types import Scalars

_ONCE = (
    1.1838578106672012,
    -0.083491834240912617,
    -0.16929107857734637,
    0.085773752301233605,
    -0.016486567403064586,
    -0.0018565842308912393,
    0.0019122228197821925,
    -0.00044059354120629503,
    9.5020231010739097e-6,
    1.5740775327095933e-5,
    -1.9934667974794593e-6,
    -4.991414949663991e-7,
    1.0881199082272735e-7,
    1.8961082301393669e-8,
    -5.089148344736358e-9,
    -9.3513394329321721e-10,
    2.22549489755215e-10,
    5.5251290253164013e-11,
    -8.4662464878522375e-12,
    -3.4517565057701384e-12,
    1.9033898454068722e-13,
    2.0699851535825262e-13,
    9.6119400505960876e-15,
    -1.0891215377791668e-14,
    -1.8459774409384436e-15,
    4.2036780476662306e-16,
    1.6975040863439396e-16,
    -1.8854000813170549e-18,
    -1.1055233817394777e-17,
)
_TWICE = (
    1.1223606042636021,
    0.097335853999823161,
    -0.3184416265154147,
    0.102925531730092,
    0.0062046212184209076,
    -0.013894637828926484,
    0.0035165216995834281,
    0.00026215851437266232,
    -0.00032219337593165599,
    4.5804427067490934e-5,
    1.0934498499321507e-5,
    -3.4278904964291596e-6,
    -3.4111364757888587e-7,
    1.9253745933644531e-7,
    1.4569091003879692e-8,
    -1.0335487026042783e-8,
    -9.9199283937679046e-10,
    5.4250578109163226e-10,
    8.305351975727694e-11,
    -2.6261147074744005e-11,
    -6.8736857563203009e-12,
    9.8459098140036082e-13,
    5.17031221614119e-13,
    -5.5748317246352405e-15,
    -3.3428017586749715e-14,
    -3.8858098260760246e-15,
    1.6606821995307314e-15,
    4.9803093355317413e-16,
    -3.6188537089620574e-17,
    -3.9905714570795002e-17,
)

_BEYOND = 100.0  # standard deviations, where the density is 0


@jax.custom_jvp
def tail_mean(t: Scalars) -> Scalars:
    """Return the mean E[max(Z + t, 0)] of a shifted Gaussian clipped at 0, in standard
    deviations."""
    rare, _ = _rare(t)
    return jnp.where(t > 0, t + rare, rare)


@tail_mean.defjvp
def _tail_mean_jvp(primals, tangents):
    return tail_mean(*primals), ndtr(primals[0]) * tangents[0]


@jax.custom_jvp
def tail_square(t: Scalars) -> Scalars:
    """Return the mean square E[max(Z + t, 0)^2] of a shifted Gaussian clipped at 0."""
    _, rare = _rare(t)
    return jnp.where(t > 0, 1 + t * t - rare, rare)


@tail_square.defjvp
def _tail_square_jvp(primals, tangents):
    return tail_square(*primals), 2 * tail_mean(primals[0]) * tangents[0]


@jax.custom_jvp
def tail_variance(t: Scalars) -> Scalars:
    """Return the variance Var[max(Z + t, 0)] of a shifted Gaussian clipped at 0."""
    mean, square = _rare(t)
    rare = square - mean * mean
    return jnp.where(t > 0, 1 - 2 * ndtr(-jnp.abs(t)) + rare, rare)


@tail_variance.defjvp
def _tail_variance_jvp(primals, tangents):
    (t,) = primals
    return tail_variance(t), 2 * tail_mean(t) * ndtr(-t) * tangents[0]


def _rare(t: Scalars) -> tuple[Scalars, Scalars]:
    """Return the tail integrals E[max(Z - a, 0)] and E[max(Z - a, 0)^2] for a = |t|."""
    a = jnp.minimum(jnp.abs(t), _BEYOND)
    at = (a - 4) / (a + 4)
    inverse = 1 / (1 + a)
    once = density(a) * inverse * inverse
    return once * chebyshev(_ONCE, at), 2 * once * inverse * chebyshev(_TWICE, at)


def density(a: Scalars) -> Scalars:
    """Return the Gaussian density exp(-a^2 / 2) / sqrt(2 pi), corrected for the rounding error of
    a^2."""
    square, one = a * a, jnp.ones_like(a)
    lost = jax.lax.stop_gradient(difference_of_products(a, a, square, one))
    return jnp.exp(-square / 2) * (1 - lost / 2) / float(np.sqrt(2 * np.pi))


def is_narrow(width: Scalars, offset: Scalars) -> Bool[Array, "..."]:
    """Return whether `narrow_window_moments` is accurate for a window of this width and offset."""
    return width * jnp.maximum(offset, 1) < (0.5 if width.dtype == jnp.float64 else 1.0)


def narrow_window_moments(width: Scalars, offset: Scalars) -> tuple[Scalars, Scalars]:
    """Return the mean and variance of u, the position of the clipped variable Z in a window of this
    `width` about `offset`; u is 0 at the lower end and 1 at the upper end. The window must be
    narrow (`is_narrow`), and its middle m = offset >= 0. The moments are E[u] = int S du and E[u^2]
    = 2 int u S du. The survival function S(m + x) is the series S(m) - phi(m) (x - He_1(m) x^2 / 2!
    + He_2(m) x^3 / 3! - ...) with Hermite polynomials He."""
    m, half = jnp.minimum(offset, _BEYOND), width / 2
    even, odd = jnp.ones_like(m), m  # He_{2k-2} and He_{2k-1}
    power, more, less = half, jnp.zeros_like(m), jnp.zeros_like(m)
    for k in range(1, 6):
        less = less + power * even / (2 * (2 * k + 1) * factorial(2 * k - 1))
        more = more + power * half * odd / factorial(2 * k + 1)
        even = m * odd - (2 * k - 1) * even
        odd, power = m * even - 2 * k * odd, power * half * half
    mean = ndtr(-m) + density(m) * more
    return mean, mean * (1 - mean) - 2 * density(m) * less
