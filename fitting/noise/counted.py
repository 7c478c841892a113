"""The fit to tables of codes at levels of few electrons, with the exact distribution of a code.

    c = black + K (n + sigma_d z) rounded,   n ~ Poisson(mu_l)

for each level l, with one gain and read noise. Each dark has a black level, whose error from its
dark frames is common to all pixels. The fit is a `Problem` under `SensorCounts`. Its result is a
Gaussian in the logarithms of K, sigma_d and mu_l, which replaces the moments of these levels in the
likelihood of photon transfer.
"""

from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxvision import PoissonShotNoise, Sensor
from jaxvision.errors import InputError

from ..fits.solve import fit
from ..inference.misfit import Misfit
from ..inference.parameters import Parameter, names
from ..inference.priors import Normal
from ..inference.problem import Problem, Tied, Values
from ..sensor_likelihoods import SensorCounts
from .levels import CodeTables, PhotonTransfer
from .model import CountedLevels

BEYOND = 1.3  # times the read noise of the moments, that the sum over electrons has room for
TOLERATED = 2.0  # chi-square per degree of freedom up to which the tables count
TREND = 3  # exposures of darks that separate their electrons from the black level


@dataclass(frozen=True)
class CodeFit:
    """The fit to tables of codes.

    Attributes:
        levels: (m,) indices of the bright levels.
        logs: (2 + m,) logarithms of gain (DN/e-), read noise (e-) and electrons of each level.
        covariance: (2 + m, 2 + m).
        numbers: how many values the tables count, over pixels and frames.
        failures: why the fit is not used, in sentences; empty where it is used.
        misfit: of the counts in the tables; None where no search began.
    """

    levels: Int[np.ndarray, " m"]
    logs: Float[np.ndarray, " logs"]
    covariance: Float[np.ndarray, "logs logs"]
    numbers: int
    failures: tuple[str, ...]
    misfit: Misfit | None = None

    def among(self, usable: Int[np.ndarray, " usable"]) -> CountedLevels | None:
        """The result in the form for the likelihood of photon transfer with the bright levels
        `usable`; None where it is not used."""
        if self.failures:
            return None
        place = np.searchsorted(usable, self.levels)
        return CountedLevels(
            jnp.asarray(place),
            jnp.asarray(self.logs),
            jnp.asarray(self.covariance),
            jnp.zeros(len(place)),
        )


def counts_problem(
    measurement: PhotonTransfer, tables: CodeTables
) -> tuple[Problem, dict[str, np.ndarray]]:
    """The problem of the tables, and its starting point from the moments."""
    bright, dark, converter = measurement.bright, measurement.dark, measurement.converter
    levels, level = np.unique(np.asarray(tables.level), return_inverse=True)
    darks, of = np.unique(np.asarray(tables.dark), return_inverse=True)
    matched, step = np.asarray(measurement.dark_of)[levels], converter.step
    dark_variance = np.asarray(dark.variance)
    signal = (np.asarray(bright.mean)[levels] - np.asarray(dark.mean)[matched]) / step
    excess = (np.asarray(bright.variance)[levels] - dark_variance[matched]) / step**2
    gain = float(excess.sum() / signal.sum())
    own = np.maximum(dark_variance[darks] - converter.rounding, 0.0) / step**2
    read_noise = float(np.sqrt(own.mean()) / gain)
    unlit = _dark_signal(measurement)[darks] / step
    unsure = np.sqrt(dark_variance[darks] / np.asarray(dark.frames)[darks] / float(dark.pixels))
    known = np.asarray(tables.known)[:, None]
    widest = np.sqrt((BEYOND * read_noise) ** 2 + float(known.max()) / gain**2)
    codes = np.asarray(tables.first)[:, None] + np.arange(tables.counts.shape[1])
    one = jnp.ones((len(codes), 1))
    sensor = Sensor(shot_noise=PoissonShotNoise(), gain=gain, read_noise=read_noise, offset=0.0)
    # A number for each table, which a sensor of one camera has no shape for.
    sensor = eqx.tree_at(lambda s: (s.read_noise, s.offset), sensor, (read_noise * one, 0 * one))
    problem = Problem(
        {
            "sensor.gain": Parameter(unit="DN/e⁻", transform="log"),
            "read_noise": Parameter(unit="e⁻", transform="log"),
            "black": Parameter(shape=(len(darks),), prior=Normal(0.0, 1.0)),  # of its own errors
            "electrons": Parameter(unit="e⁻", shape=(len(levels),), transform="log"),
            "known": known,
            "expected": (np.asarray(tables.place) - unlit[of])[:, None],
            "unsure": np.eye(len(darks))[of] * unsure / step,
            "sensor.read_noise": Tied(_noise_of_tables),
            "sensor.offset": Tied(_black_of_tables),
        },
        _light_of_tables,
        SensorCounts("sensor", 4 * int(np.ceil((8 * widest + 0.5 / gain) / 4)), codes=codes),
        np.asarray(tables.counts),
        records={"sensor": sensor},
        inputs={"level": np.eye(len(levels))[level], "one": np.ones_like(codes)},
    )
    start = {
        "sensor.gain": np.asarray(gain),
        "read_noise": np.asarray(read_noise),
        "black": np.zeros(len(darks)),
        "electrons": (signal + unlit[np.searchsorted(darks, matched)]) / gain,
    }
    return problem, start


def _noise_of_tables(values: Values) -> Array:
    return jnp.sqrt(values["read_noise"] ** 2 + values["known"] / values["sensor.gain"] ** 2)


def _black_of_tables(values: Values) -> Array:
    return values["expected"] + (values["unsure"] @ values["black"])[:, None]


def _light_of_tables(electrons: Array, inputs: dict[str, Array]) -> Array:
    return (inputs["level"] @ electrons)[:, None] * inputs["one"]


def fitted_tables(measurement: PhotonTransfer) -> CodeFit | None:
    """The fit to the tables of a measurement."""
    tables = measurement.tables
    if tables is None:
        return None
    problem, start = counts_problem(measurement, tables)
    levels = np.unique(np.asarray(tables.level))
    numbers = int(np.nansum(np.asarray(tables.counts)))
    try:
        found = fit(problem, start=start, misfit="inflate")
    except InputError as error:
        begin = np.log([start["sensor.gain"], start["read_noise"], *start["electrons"]])
        return CodeFit(levels, begin, np.diag(begin + np.nan), numbers, (str(error),))
    labels = names(found.posterior.space)
    at = [i for i, name in enumerate(labels) if not name.startswith("black")]
    logs = found.posterior.unconstrained_mode[at]
    logs[0] += np.log(measurement.converter.step)
    factor = _frames_in_common(measurement, tables, float(found.values["read_noise"]), logs[0])
    covariance = found.posterior.covariance[np.ix_(at, at)] * factor
    failures = [] if found.optimum.stationary else ["the search did not converge."]
    ratio = found.misfit.chi_square / found.misfit.dof
    if ratio > TOLERATED:
        failures.append(
            "Poisson's electrons with Gaussian read noise do not describe it (chi-square per "
            f"degree of freedom is {ratio:.3g})."
        )
    return CodeFit(levels, logs, covariance, numbers, tuple(failures), found.misfit)


def _dark_signal(measurement: PhotonTransfer) -> np.ndarray:
    """The dark signal of each dark in DN, from the line of their means over exposure. With too
    few exposures it is 0, and its electrons count as read noise, as in the likelihood of the
    moments."""
    dark = measurement.dark
    exposure, mean = np.asarray(dark.exposure), np.asarray(dark.mean)
    if len(np.unique(exposure)) < TREND:
        return np.zeros_like(mean)
    slope = np.polyfit(exposure, mean, 1)[0]
    return max(float(slope), 0.0) * exposure


def _frames_in_common(
    measurement: PhotonTransfer, tables: CodeTables, read_noise: float, log_gain: float
) -> float:
    """The factor on variances because all flats of a pixel share the error of its black level. If
    the codes of F flats have correlation rho, their squares have rho^2."""
    step, most = measurement.converter.step, 1.0
    own = (read_noise * np.exp(log_gain)) ** 2 + measurement.converter.rounding
    for d in np.unique(np.asarray(tables.dark)):
        of = np.asarray(tables.dark) == d
        flats = np.unique(np.asarray(tables.level)[of])
        frames = float(np.asarray(measurement.bright.frames)[flats].sum())
        error = float(np.asarray(tables.known)[of].max()) * step**2
        most = max(most, 1 + (frames - 1) * (error / (own + error)) ** 2)
    return most
