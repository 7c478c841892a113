"""Oracles for likelihoods and transforms of `fitting`, in float64, to 40 standard deviations in
either tail."""

import jax.numpy as jnp
from oracle_numbers import MP, special

from fitting import Censored, Gaussian, SensorCounts, StudentT
from fitting.inference.tails import log1mexp, log_ndtr, ndtri_exp
from fitting.poisson import log_poisson, log_poisson_tails
from jaxvision import PoissonShotNoise, Sensor
from jaxvision.sensor.shot_noise import poisson_deviance, stirling_remainder

from .entry import Entry, Range, Whole

SIGMAS = Range(-40.0, 40.0, log=False)
mp_log_ndtr = special(lambda z: MP.log(MP.ncdf(z)) if z < 0 else MP.log1p(-MP.ncdf(-z)))
gamma_part = special(lambda d: MP.loggamma((d + 1) / 2) - MP.loggamma(d / 2))


def gaussian(m, z, sd):
    return -((z / sd) ** 2) / 2 - m.log(sd) - m.log(2 * m.pi) / 2


def student(m, z, scale, dof):
    norm = gamma_part(dof) - m.log(dof * m.pi) / 2
    return norm - m.log(scale) - (dof + 1) / 2 * m.log1p((z / scale) ** 2 / dof)


log_gamma = special(lambda x: MP.loggamma(x))
quantile = special(lambda p: _quantile(p))
phi = special(lambda x: MP.ncdf(x))
fewer = special(lambda n, x: MP.gammainc(max(n, 1), x, MP.inf, regularized=True) * (n > 0))
more = special(lambda n, x: MP.gammainc(n, 0, x, regularized=True))
AWAY = Whole(-30, 30)  # distance of counts from the mean


def _quantile(log_p):
    start = -MP.sqrt(max(-2 * log_p - MP.log(1 - 2 * log_p) - 2, MP.mpf(0)))
    return MP.findroot(lambda z: MP.log(MP.ncdf(z)) - log_p, (start, start - MP.mpf("0.1")))


def _many(function):
    """Return a function of the mean and the counts' distance from it, for `function(counts,
    mean)`."""
    return lambda mean, away: function(jnp.maximum(_about(mean, away), 1), mean)


def _about(mean, away):
    return jnp.floor(mean) + jnp.floor(away + 0.5)


def _counts(m, mean, away):
    """Return counts of at least one. They are steps in both arguments, so that only the mean has a
    derivative."""
    return m.maximum(m.floor(mean) + m.floor(away + m.c("0.5")), 0 * mean + 1)


def poisson(m, n, mean):
    return n * m.log(mean) - mean - log_gamma(n + 1)


def tails(m, mean, away):
    n = _counts(m, mean, away)
    below, above = fewer(n, mean), more(n, mean)
    return tuple(
        m.where(one > other, m.log1p(-other), m.log(one))
        for one, other in ((below, above), (above, below))
    )


NOISE, REACH = 0.2, 5


def _counted(mean):
    """Return a sensor of two DN per electron, in the dtype of the mean."""
    one = jnp.ones_like(mean)
    sensor = Sensor(shot_noise=PoissonShotNoise(), read_noise=NOISE * one, gain=2 * one)
    return SensorCounts(sensor, reach=REACH)


def code_density(mean, away):
    code = 2 * jnp.maximum(_about(mean, away), 0)
    return _counted(mean).log_density(mean[None], code[None])[0]


def code_deviate(mean, away):
    code = 2 * jnp.maximum(_about(mean, away), 0)
    return _counted(mean).residuals(mean[None], code[None], 0.5)[0]


def _shares(m, mean, away):
    """Return the probabilities in the interval of a code, below and above it, by sums over
    electrons near it."""
    code = m.maximum(m.floor(mean) + m.floor(away + m.c("0.5")), 0 * mean)
    sums = [0 * mean, 0 * mean, 0 * mean]
    noise = m.c(str(NOISE))
    for k in range(-4, 5):
        n = m.maximum(code + k, 0 * mean)
        chance = m.where(code + k < 0, 0 * mean, m.exp(poisson(m, n, mean)))
        low, high = ((half / 2 - k) / noise for half in (m.c("-0.5"), m.c("0.5")))
        for i, share in enumerate((phi(high) - phi(low), phi(low), phi(-high))):
            sums[i] = sums[i] + chance * share
    least, most = code - 4, code + 5
    fewer = special(
        lambda n, x: MP.gammainc(n, x, MP.inf, regularized=True) if n > 0 else MP.mpf(0)
    )
    more = special(lambda n, x: MP.gammainc(n, 0, x, regularized=True))
    return sums[0], sums[1] + fewer(least, mean), sums[2] + more(most, mean)


def mp_code_deviate(m, mean, away):
    inside, below, above = _shares(m, mean, away)
    low, high = below + inside / 2, above + inside / 2
    z = quantile(m.log(m.minimum(low, high)))
    return m.where(low < high, z, -z)


ENTRIES = [
    Entry(
        "fitting.inference.tails.log_ndtr",
        log_ndtr,
        lambda m, z: mp_log_ndtr(z),
        (SIGMAS,),
        tuple((z,) for z in (-40.0, -20.0, -5.0, -4.999, 0.0, 5.0, 8.0, -1e4)),
        bound=1e5,
        conditioned=True,
        of_digits=True,
        note="in either tail; a relative error of 1e-10 where JAX's asymptotic series begins",
    ),
    Entry(
        "fitting.inference.likelihoods.Gaussian.log_density",
        lambda z, sd: Gaussian(sd=sd).log_density(jnp.zeros_like(z), z),
        gaussian,
        (SIGMAS, Range(1e-2, 1e2)),
        ((0.0, 1.0), (40.0, 1.0)),
        precisions=("float64",),
        conditioned=True,
        note="where the logarithm of the width cancels the rest",
    ),
    Entry(
        "fitting.inference.likelihoods.StudentT.log_density",
        lambda z, s, d: StudentT(scale=s, dof=d).log_density(jnp.zeros_like(z), z),
        student,
        (SIGMAS, Range(1e-2, 1e2), Range(1.0, 100.0)),
        ((0.0, 1.0, 4.0), (1e6, 1.0, 1.0)),
        bound=200,
        precisions=("float64",),
        conditioned=True,
        of_digits=True,
        gradient=1e-3,
        note="the difference of two logarithms of the gamma function",
    ),
    Entry(
        "fitting.inference.likelihoods.Censored.log_density",
        lambda z: Censored(sd=jnp.ones_like(z), low=jnp.zeros_like(z)).log_density(
            z, jnp.zeros_like(z)
        ),
        lambda m, z: mp_log_ndtr(-z),
        (SIGMAS,),
        ((40.0,), (-40.0,), (0.0,)),
        form="at its low end",
        bound=1e5,
        precisions=("float64",),
        conditioned=True,
        of_digits=True,
    ),
    Entry(
        "fitting.inference.tails.log1mexp",
        lambda p: log1mexp(-p),
        lambda m, p: m.log(-m.expm1(-p)),
        (Range(1e-10, 80.0),),
        ((0.5347,), (0.7,), (1.4,), (1.3999,)),
        conditioned=True,
        note="where the probability itself is nearly 1",
    ),
    Entry(
        "fitting.inference.tails.ndtri_exp",
        lambda p: ndtri_exp(-p),
        lambda m, p: quantile(-p),
        (Range(0.7, 1e30),),
        ((0.7,), (19.999,), (20.001,), (1e30,)),
        bound=1e5,
        conditioned=True,
        of_digits=True,
    ),
    Entry(
        "sensor.shot_noise.poisson_deviance",
        lambda n, mean: poisson_deviance(n, n - mean, mean),
        lambda m, n, mean: n * m.log(n / mean) - (n - mean),
        (Range(1.0, 1e9), Range(1e-2, 1e9)),
        ((1e9, 1.001e9), (1e6, 1e6 + 1), (10.0, 12.2), (10.0, 12.3)),
        conditioned=True,
        of_digits=True,
    ),
    Entry(
        "sensor.shot_noise.stirling_remainder",
        stirling_remainder,
        lambda m, n: log_gamma(n + 1) - (n + 1 / m.c("2")) * m.log(n) + n - m.log(2 * m.pi) / 2,
        (Range(30.0, 1e9),),
        ((30.0,), (1e9,)),
        of_digits=True,
    ),
    Entry(
        "fitting.poisson.log_poisson",
        _many(log_poisson),
        lambda m, mean, away: poisson(m, _counts(m, mean, away), mean),
        (Range(1e-2, 1e7), AWAY),
        ((1e7, 0.0), (31.5, 0.0), (32.5, 0.0), (1e-2, 30.0), (5e4, 3.0)),
        bound=50,
        of_digits=True,
        note="for counts near the mean",
    ),
    Entry(
        "fitting.poisson.log_poisson_tails",
        _many(log_poisson_tails),
        tails,
        (Range(1e-2, 1e4), AWAY),
        ((99.5, 0.0), (100.5, 0.0), (1e4, -30.0), (1e4, 30.0), (1e-2, 30.0)),
        parts=("below", "above"),
        bound=1e5,
        conditioned=True,
        of_digits=True,
        gradient=3e-3,
        note="the incomplete gamma function; 1e-10 in float64 beyond 1e5 counts",
    ),
    Entry(
        "fitting.sensor_likelihoods.SensorCounts.log_density",
        code_density,
        lambda m, mean, away: m.log(_shares(m, mean, away)[0]),
        (Range(1.0, 1e4), AWAY),
        ((1e4, 0.0), (0.5, 20.0), (0.5, 30.0), (5e3, -30.0)),
        bound=300,
        of_digits=True,
        gradient=1e-3,
    ),
    Entry(
        "fitting.sensor_likelihoods.SensorCounts.residuals",
        code_deviate,
        mp_code_deviate,
        (Range(1.0, 1e3), AWAY),
        ((0.5, 20.0), (0.5, 30.0), (900.0, -30.0), (3.0, 30.0)),
        bound=1e5,
        of_digits=True,
        gradient=None,
        conditioned=True,
        note="finite in both tails",
    ),
]
