"""Oracles for spectra, photons, sensors and the moments of clipped signals."""

import jax.numpy as jnp
from oracle_numbers import MP, special

import jaxvision as jv
from jaxvision import scene, sensor, spectra
from jaxvision.sensor import adc

from .entry import Columns, Entry, Range, Whole

KELVIN = Range(1000.0, 20_000.0)
NANOMETRES = Range(3e-7, 2e-6)
H, C, K_B = "6.62607015e-34", "299792458", "1.380649e-23"
Q = "1.602176634e-19"


def planck(m, wavelength, kelvin):
    h, c, k = m.c(H), m.c(C), m.c(K_B)
    return 2 * h * c * c / wavelength**5 / m.expm1(h * c / (wavelength * k * kelvin))


def censored_moments(mean, variance, low, high):
    """Return the mean and variance of a Gaussian clipped to [low, high], in 60 digits."""
    with MP.workdps(80):
        s = MP.sqrt(variance)
        a, b = (low - mean) / s, (high - mean) / s
        density = [MP.npdf(x) for x in (a, b)]
        below, above = MP.ncdf(a), MP.ncdf(-b)
        inside = (
            1 - below - above
            if a < 0 < b
            else (MP.ncdf(-a) - MP.ncdf(-b) if a > 0 else MP.ncdf(b) - MP.ncdf(a))
        )
        first = low * below + high * above + mean * inside + s * (density[0] - density[1])
        moved = (
            (low - first) ** 2 * below
            + (high - first) ** 2 * above
            + inside * (mean - first) ** 2
            + 2 * (mean - first) * s * (density[0] - density[1])
            + variance * (inside + a * density[0] - b * density[1])
        )
        return +first, +moved


clipped_mean = special(lambda m, v, a, b: censored_moments(m, v, a, b)[0])
clipped_variance = special(lambda m, v, a, b: censored_moments(m, v, a, b)[1])


def both(mean, sd):
    """Return the moments of a Gaussian clipped to [0, 1]; mean and deviation in units of the
    window."""
    one = jnp.ones_like(mean)
    return tuple(sensor.censored(jv.Moments(mean, sd * sd), low=0 * one, high=one))


def below(mean):
    return tuple(sensor.censored(jv.Moments(mean, jnp.ones_like(mean)), low=jnp.zeros_like(mean)))


def at_zero(m, mean):
    zero, far = 0 * mean, 0 * mean + 10**6
    return clipped_mean(mean, zero + 1, zero, far), clipped_variance(mean, zero + 1, zero, far)


def in_window(m, mean, sd):
    zero = 0 * mean
    return (
        clipped_mean(mean, sd * sd, zero, zero + 1),
        clipped_variance(mean, sd * sd, zero, zero + 1),
    )


def a_sensor(read, gain, offset, **other):
    return jv.Sensor(
        shot_noise=scene.PoissonShotNoise(), read_noise=read, gain=gain, offset=offset, **other
    )


def mean_of(photons, gain, offset):
    zero = jnp.zeros_like(gain)
    return jv.expected_signal(a_sensor(zero, gain, offset), photons[None])[0]


def pattern_of(photons, prnu, dsnu, dead):
    plain = jv.Sensor(prnu=prnu, dsnu=dsnu, dead_pixels=dead)
    return sensor.pattern_variance(plain, photons[None])[0]


def variance_of(photons, read, gain):
    return jv.signal_variance(a_sensor(read, gain, 0 * gain), photons[None])[0]


def ratio_of(photons, read, gain):
    return sensor.signal_to_noise(a_sensor(read, gain, 0 * gain), photons[None])[0]


def widths(m, w):
    first, second = w[:, 1] - w[:, 0], w[:, 2] - w[:, 1]
    return first, (first + second) / 2, second


def of_daylight(m, basis, kelvin):
    """Return CIE daylight at one wavelength (CIE 15:2018, 4.1.2)."""
    t = 1000 / kelvin
    low = m.c("0.244063") + m.c("0.09911") * t + m.c("2.9678") * t**2 - m.c("4.6070") * t**3
    high = m.c("0.237040") + m.c("0.24748") * t + m.c("1.9018") * t**2 - m.c("2.0064") * t**3
    x = m.where(kelvin <= 7000, low, high)
    y = -3 * x**2 + m.c("2.870") * x - m.c("0.275")
    below = m.c("0.0241") + m.c("0.2562") * x - m.c("0.7341") * y
    first = (m.c("-1.3515") - m.c("1.7703") * x + m.c("5.9114") * y) / below
    second = (m.c("0.0300") - m.c("31.4424") * x + m.c("30.0717") * y) / below
    return basis[:, 0] + first * basis[:, 1] + second * basis[:, 2]


class Grid:
    """Three wavelengths in ascending order."""

    def __str__(self):
        return "3 ascending from 4e-07"

    def draw(self, rng, n):
        steps = rng.uniform(1e-9, 5e-8, size=(n, 3))
        return 4e-7 + steps.cumsum(axis=-1)


ENTRIES = [
    Entry(
        "spectra.blackbody",
        lambda w: spectra.blackbody(w[None], jnp.asarray(5000.0, w.dtype))[0],
        lambda m, w: planck(m, w, m.c("5000")),
        (Range(2e-7, 1e-4),),
        ((5.5e-7,), (1e-4,)),
        bound=2,
        form="5000 K",
    ),
    Entry(
        "spectra.blackbody",
        lambda w, t: spectra.blackbody(w[None], t)[0],
        planck,
        (NANOMETRES, KELVIN),
        ((3e-7, 1000.0), (1e-2, 6000.0), (5.5e-7, 1e6), (3e-7, 500.0)),
        bound=2,
        gradient=1e-4,
        note="the slope near the maximum, where it vanishes",
    ),
    Entry(
        "spectra.daylight",
        lambda basis, t: spectra.daylight(basis[None], t)[0],
        of_daylight,
        (Columns(Range(1.0, 100.0)), Range(4001.0, 24999.0)),
        (([100.0, 40.0, 5.0], 6504.0), ([100.0, 1.0, 1.0], 5503.0), ([1.0, 1.0, 1.0], 7000.0)),
        bound=4,
        precisions=("float32",),
        conditioned=True,
        gradient=1e-4,
        note="where a colour is cold or warm enough for a band to vanish",
    ),
    Entry(
        "spectra.daylight",
        lambda basis, t: spectra.daylight(basis[None], t)[0],
        of_daylight,
        (Columns(Range(1.0, 100.0)), Range(4001.0, 24999.0)),
        (([100.0, 40.0, 5.0], 6504.0), ([100.0, 1.0, 1.0], 5503.0), ([1.0, 1.0, 1.0], 7000.0)),
        bound=100,
        form="float64",
        precisions=("float64",),
        conditioned=True,
        gradient=1e-4,
        note="where a colour is cold or warm enough for a band to vanish, and the rounding of "
        "constants",
    ),
    Entry(
        "spectra.band_widths",
        spectra.band_widths,
        widths,
        (Grid(),),
        parts=("first", "middle", "last"),
        conditioned=True,
        gradient=1e-4,
        note="differences",
    ),
    Entry(
        "sensor.exposure.photon_rate",
        lambda e, w, a: jv.photon_rate(e[None], w, a)[0],
        lambda m, e, w, a: e * w * a / (m.c(H) * m.c(C)),
        (Range(1e-9, 1e6), NANOMETRES, Range(1e-13, 1e-9)),
        ((1e-12, 5.5e-7, 1.2e-11), (1e6, 5.5e-7, 1e-10)),
    ),
    Entry(
        "sensor.dark.dark_rate",
        lambda r, t: sensor.dark_rate(
            jv.DoublingDarkCurrent(r, t, reference_temperature=0 * t + 300, doubling=0 * t + 8)
        ),
        lambda m, r, t: r * m.power(m.c("2"), (t - 300) / 8),
        (Range(1e-3, 1e3), Range(220.0, 380.0, log=False)),
        ((1.0, 300.0), (1.0, 308.0)),
        form="doubling",
        conditioned=True,
        note="the exponential of a difference of temperatures",
    ),
    Entry(
        "sensor.dark.dark_rate",
        lambda r, t: sensor.dark_rate(
            jv.ArrheniusDarkCurrent(
                r, t, reference_temperature=0 * t + 300, activation_energy=0 * t + 0.5
            )
        ),
        lambda m, r, t: r * m.exp(m.c("0.5") * m.c(Q) / m.c(K_B) * (1 / m.c("300") - 1 / t)),
        (Range(1e-3, 1e3), Range(220.0, 380.0, log=False)),
        ((1.0, 300.0), (1.0, 301.0)),
        form="Arrhenius",
        conditioned=True,
        note="the exponential of a difference of temperatures",
    ),
    Entry(
        "sensor.adc.largest_number",
        adc.largest_number,
        lambda m, b: m.power(m.c("2"), b) - 1,
        (Whole(1, 24),),
        ((8.0,), (12.0,), (16.0,), (1.0,)),
        bound=0,
        gradient=None,
    ),
    Entry(
        "sensor.moments.expected_signal",
        mean_of,
        lambda m, p, k, o: k * p + o,
        (Range(1e-2, 1e6), Range(0.01, 10), Range(0.1, 100)),
    ),
    Entry(
        "sensor.moments.signal_variance",
        variance_of,
        lambda m, p, r, k: k * k * (p + r * r),
        (Range(1e-2, 1e6), Range(0.1, 100), Range(0.01, 10)),
    ),
    Entry(
        "sensor.moments.signal_to_noise",
        ratio_of,
        lambda m, p, r, k: p / m.sqrt(p + r * r),
        (Range(1e-2, 1e6), Range(0.1, 100), Range(0.01, 10)),
        bound=5.0,
    ),
    Entry(
        "sensor.moments.pattern_variance",
        pattern_of,
        lambda m, p, prnu, dsnu, dead: (1 - dead) * (prnu**2 + dead) * p**2 + dsnu**2,
        (Range(1e-2, 1e6), Range(1e-6, 0.3), Range(1e-3, 100), Range(1e-12, 0.1)),
        ((1e4, 1e-3, 1e-3, 1e-12), (1e4, 1e-4, 1e-3, 1e-10)),
    ),
    Entry(
        "sensor.moments.censored",
        below,
        at_zero,
        (Range(-12.0, 30.0, log=False),),
        tuple((x,) for x in (-12.0, -8.0, -5.416331, -1.0, 0.0, 1e-20, 5.0)),
        form="at one end, sd 1",
        parts=("mean", "variance"),
        bound=8,
        of_digits=True,
        note="relative, also in the tail",
    ),
    Entry(
        "sensor.moments.censored",
        both,
        in_window,
        (Range(-3.0, 4.0, log=False), Range(0.3, 1e4)),
        ((-1e3, 1e3), (-1e3, 1e6), (0.5, 1e-3), (0.5, 0.1), (0.0, 10.0)),
        form="to a window",
        parts=("mean", "variance"),
        bound=2e3,
        conditioned=True,
        of_digits=True,
        gradient=None,
        note="noise at least as wide as the window: a relative error of 2e-4 in float32",
    ),
]
