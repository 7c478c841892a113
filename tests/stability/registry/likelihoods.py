"""Likelihoods and transforms of `fitting`: float64, to 40 standard deviations in either tail."""

import jax.numpy as jnp
from oracle_numbers import MP, special

from fitting import Censored, Gaussian, StudentT
from fitting.inference.tails import log_ndtr

from .entry import Entry, Range

SIGMAS = Range(-40.0, 40.0, log=False)
mp_log_ndtr = special(lambda z: MP.log(MP.ncdf(z)) if z < 0 else MP.log1p(-MP.ncdf(-z)))
gamma_part = special(lambda d: MP.loggamma((d + 1) / 2) - MP.loggamma(d / 2))


def gaussian(m, z, sd):
    return -((z / sd) ** 2) / 2 - m.log(sd) - m.log(2 * m.pi) / 2


def student(m, z, scale, dof):
    norm = gamma_part(dof) - m.log(dof * m.pi) / 2
    return norm - m.log(scale) - (dof + 1) / 2 * m.log1p((z / scale) ** 2 / dof)


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
        note="in either tail; 1e-10 of itself where JAX's asymptotic series begins",
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
]
