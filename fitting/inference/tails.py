"""Compute the logarithms of the normal and Student's t distribution functions, accurate in the far
tails, and the inverse of the first.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy import special
from jaxtyping import Array, Float

_FRACTION_FROM = 5.0  # deviations from which the continued fraction is accurate to rounding
_TERMS = 24
_SERIES_RATIO = 0.25  # dof / (dof + z^2) below which `_SERIES_TERMS` terms of the series suffice
_SERIES_TERMS = 26
_FREEDOM = 20.0  # degrees of freedom from which quadrature is accurate and betainc is not
_QUADRATURE_SCALES = 2.0  # scales from which the tail's quadrature is accurate
_LEGENDRE = np.polynomial.legendre.leggauss(16)  # nodes in (-1, 1), and weights
_LAGUERRE = np.polynomial.laguerre.laggauss(32)
_HALF_STEP = (-1 / 8, 1 / 192, -1 / 640, 17 / 14336, -31 / 18432, 691 / 180224)
_STEPS = 8
_ASYMPTOTE = -20.0  # ln of a probability below which `ndtri_exp` begins with the tail's asymptote
_NEWTON_STEPS = 4  # Newton steps from that start
HALF_LOG_PI = float(np.log(np.pi)) / 2


def log1mexp(log_p: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return ln(1 - exp(`log_p`)), (...) no unit. XLA's log1p is accurate only above -0.29 in
    float64, so this function avoids it below.
    """
    likely = log_p > -1.4
    rare = jnp.log1p(-jnp.exp(jnp.where(likely, -2, log_p)))
    return jnp.where(likely, jnp.log(-jnp.expm1(jnp.where(likely, log_p, -1))), rare)


@jax.custom_jvp
def log_ndtr(z: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return log Phi(z) for `z` standard deviations. Its derivative phi(z) / Phi(z) tends to -z.
    The relative error of the derivative by JAX is 30 % at z = -1e4 in float32, and 100 % at -1e10
    in float64.
    """
    return _log_ndtr(z)


@jax.jit  # one program, and one trace for each shape
def _log_ndtr(z: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return log Phi(z). Above the mean it is computed from the small probability above z, which
    JAX's own function rounds to eps.
    """
    above = z > 1
    below = special.log_ndtr(jnp.where(above, -z, z))
    return jnp.where(above, log1mexp(jnp.where(above, below, -1)), below)


@log_ndtr.defjvp
def _log_ndtr_jvp(primals, tangents):
    (z,) = primals
    return log_ndtr(z), _hazard(z) * tangents[0]


@jax.jit
def _hazard(z: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return phi(z) / Phi(z). In the lower tail the ratio is computed by Laplace's continued
    fraction a + 1 / (a + 2 / (a + 3 / (...))) with a = -z.
    """
    far = z < -_FRACTION_FROM
    a = jnp.where(far, -z, _FRACTION_FROM)
    fraction = a
    for k in range(_TERMS, 0, -1):
        fraction = a + k / fraction
    near = jnp.where(far, 0, z)
    ratio = jnp.exp(-near * near / 2 - _log_ndtr(near)) / float(np.sqrt(2 * np.pi))
    return jnp.where(far, fraction, ratio)


@jax.custom_jvp
def ndtri_exp(log_p: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return the z with log Phi(z) = `log_p`."""
    rare = log_p < _ASYMPTOTE
    square = -2 * jnp.where(rare & jnp.isfinite(log_p), log_p, _ASYMPTOTE)
    z = -jnp.sqrt(square - jnp.log(2 * np.pi * square))
    for _ in range(_NEWTON_STEPS):
        z = z - (_log_ndtr(z) + square / 2) / _hazard(z)
    z = jnp.where(log_p == -jnp.inf, -jnp.inf, z)
    return jnp.where(rare, z, special.ndtri(jnp.exp(jnp.where(rare, _ASYMPTOTE, log_p))))


@ndtri_exp.defjvp
def _ndtri_exp_jvp(primals, tangents):
    z = ndtri_exp(*primals)
    return z, tangents[0] / _hazard(z)


@jax.custom_jvp
def log_student(z: Float[Array, "..."], dof: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return log F(z) of Student's t, with z in units of the scale, measured from the median. The
    function is differentiable with respect to z only.

    F is computed by the incomplete beta function. Beyond z^2 = 3 dof its series (DLMF 8.17.22) is
    used, with the logarithm of its leading power, so that nothing underflows. For many degrees of
    freedom the series loses digits. There the density is integrated, by Gauss-Laguerre quadrature
    in the tail and by Gauss-Legendre quadrature from the tail to the median."""
    return _log_student(z, dof)


@jax.jit
def _log_student(z: Float[Array, "..."], dof: Float[Array, "..."]) -> Float[Array, "..."]:
    z, dof = jnp.broadcast_arrays(z, dof)
    a, x = dof / 2, dof / (dof + z**2)
    tail = jnp.minimum(x, _SERIES_RATIO)
    term = total = jnp.ones_like(tail)
    for n in range(_SERIES_TERMS):
        term = term * tail * (a + 0.5 + n) / (a + 1 + n)
        total = total + term
    series = (
        -a * _log1p_square(z / jnp.sqrt(dof)) + jnp.log1p(-tail) / 2 - jnp.log(a) + jnp.log(total)
    )
    far = series + _half_step(a) - HALF_LOG_PI
    many = dof >= _FREEDOM
    near = jnp.log(special.betainc(jnp.where(many, 1, a), 0.5, jnp.maximum(x, _SERIES_RATIO)))
    far, near = (value - float(np.log(2)) for value in (far, near))  # logarithms of F(-|z|)
    below = jnp.where(x < _SERIES_RATIO, far, jnp.where(many, _large_dof(jnp.abs(z), dof), near))
    return jnp.where(z > 0, log1mexp(below), below)


def _large_dof(z: Float[Array, "..."], dof: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return log F(-z) for z >= 0 and many degrees of freedom. In the tail F is the density times
    the integral of the relative density beyond. Nearer to the median, F is its value where the tail
    begins plus the integral up to z. No term is negative.
    """
    long = jnp.maximum(z, _QUADRATURE_SCALES)
    square = dof + long * long
    rate = (dof + 1) * long / square
    places = _prepend_axis(z, _LAGUERRE[0]) / rate[None]
    fall = jnp.log1p(places * (2 * long[None] + places) / square[None])
    left = _prepend_axis(z, _LAGUERRE[1] * np.exp(_LAGUERRE[0])) * jnp.exp(
        -(dof[None] + 1) / 2 * fall
    )
    tail = student_log_density(long, dof) + jnp.log(left.sum(0) / rate)
    width = long - z
    places = z[None] + width[None] * _prepend_axis(z, (_LEGENDRE[0] + 1) / 2)
    density = jnp.exp(student_log_density(places, dof[None]))
    between = width * (_prepend_axis(z, _LEGENDRE[1] / 2) * density).sum(0)
    return jnp.where(z > _QUADRATURE_SCALES, tail, jnp.log(jnp.exp(tail) + between))


def _prepend_axis(z: Float[Array, "..."], values: np.ndarray) -> np.ndarray:
    """Return values along a new axis in front of the axes of z."""
    return values.astype(z.dtype).reshape(-1, *(1,) * z.ndim)


def student_log_density(z: Float[Array, "..."], dof: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return ln of Student's t density of unit scale at z."""
    norm = _half_step(dof / 2) - jnp.log(dof) / 2 - HALF_LOG_PI
    return norm - (dof + 1) / 2 * _log1p_square(z / jnp.sqrt(dof))


def _log1p_square(q: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return ln(1 + q^2), where q^2 may overflow."""
    far = jnp.abs(q) > 1
    near = jnp.log1p(jnp.where(far, 0, q) ** 2)
    return jnp.where(far, 2 * jnp.log(jnp.hypot(1, q)), near)


@log_student.defjvp
def _log_student_jvp(primals, tangents):
    z, dof = primals
    below = log_student(z, dof)
    return below, jnp.exp(student_log_density(z, dof) - below) * tangents[0]


def _half_step(a: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return ln Gamma(a + 1/2) - ln Gamma(a) without cancellation of two large logarithms. A
    recurrence raises a by some steps, to a value at which a few terms of the asymptotic series
    (DLMF 5.11.13) are exact enough.
    """
    product = jnp.ones_like(a)
    for k in range(_STEPS):
        product = product * (a + k) / (a + k + 0.5)
    b = a + _STEPS
    series = sum(c / b ** (2 * n + 1) for n, c in enumerate(_HALF_STEP))
    return jnp.log(product) + jnp.log(b) / 2 + series
