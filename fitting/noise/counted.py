"""Histograms of codes at light levels of few electrons: the choice of levels, the counts, and the
fit to the histograms.

If read noise is below about one electron, the histogram of the codes has a peak for each number of
electrons, or is skewed. Mean and variance do not contain most of this information. The black levels
of pixels differ (DSNU), which would blur the peaks. Therefore the black level of each pixel,
estimated by the pixel's mean over the dark frames of the same exposure, is subtracted from its
codes. The noise of that mean is known and enters the fit, and no distribution of the black levels
is assumed. A histogram is used only at levels where unequal gains of the pixels shift the codes by
less than a fifth of the read noise.

The fit uses the exact distribution of a code at level l,

    c = black + K (n + sigma_d z) rounded,   n ~ Poisson(mu_l)

with one gain K (DN/e-) and read noise sigma_d (e-) for all levels. Here z is a standard normal
number, and mu_l is the mean number of electrons. The black level is a parameter for each exposure
of the darks, with the mean of these darks and its standard error as the prior. The fit is a
`Problem` with the likelihood `SensorCounts`. The result of the fit, a Gaussian in the logarithms of
K, sigma_d and mu_l, replaces the means and variances of these levels in the likelihood of photon
transfer.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxvision import PoissonShotNoise, Sensor
from jaxvision.errors import InputError

from ..fits.solve import fit
from ..inference.parameters import Parameter, names
from ..inference.priors import Normal
from ..inference.problem import Problem, Tied, Values
from ..sensor_likelihoods import SensorCounts
from .levels import CodeTables, PhotonTransfer, linear_levels, shot_of, signal_of
from .model import CountedLevels
from .pattern import fitted_pattern
from .shared import drift

SUB_ELECTRON = 1.5  # read noise, e-, above which moments contain as much information
FINEST = 0.4  # read noise, in codes, below which a pixel's black level between two codes is unknown
FEWEST, MOST = 0.1, 30.0  # electrons of a level
# Largest shift of a level's codes by unequal gains, relative to the read noise
LARGEST_CODE_SHIFT = 0.2
LEVELS = 8  # most levels in a fit: more levels cost time and add little information
TABLE_HALF_WIDTH = 8.0  # standard deviations on either side that a table covers
SIZES = 64  # tables are padded to multiples of this, because each size is compiled separately
PLACES = 8  # most classes of the pixels' black level between two codes


def dim_levels(measurement: PhotonTransfer) -> Int[np.ndarray, " levels"] | str:
    """Return the bright levels for which histograms are made, or why there are none."""
    none, usable = np.zeros(0, int), linear_levels(measurement)
    bright, dark, converter = measurement.bright, measurement.dark, measurement.converter
    signal, excess = signal_of(measurement)[usable], shot_of(measurement)[usable]
    if bright.converter != dark.converter:  # some frames were averaged
        return none
    if not converter.step or any("system_gain" in doubt.of for doubt in measurement.doubts):
        return none
    if not signal.sum() > 0 or not excess.sum() > 0:
        return none
    gain = float(excess.sum() / signal.sum())
    noise = float(np.sqrt(max(np.median(np.asarray(dark.variance)) - converter.rounding, 0.0)))
    read = noise / gain
    # Rounding hides the size of a noise below FINEST codes.
    hidden = noise < FINEST * converter.step
    if (FINEST * converter.step / gain if hidden else read) >= SUB_ELECTRON:
        return none
    opening = f"Read noise is about {read:.2g} e⁻, below {SUB_ELECTRON:g} e⁻, but"
    if not converter.even or converter.imbalance or hidden:
        return (
            f"{opening} {noise / converter.step:.2g} of a code, and steps between codes are too "
            "wide or uneven for the histogram of codes: the fit uses means and variances."
        )
    response = fitted_pattern(measurement, usable).response
    uneven = float(np.sqrt(response.variance)) if response.significant else 0.0
    most = min(MOST, LARGEST_CODE_SHIFT * read / uneven) if uneven else MOST
    if most < FEWEST:  # uneven light, or gain and read noise are of frames that flicker
        return none
    electrons = signal / gain
    dim = usable[(electrons >= FEWEST) & (electrons <= most)]
    if not len(dim):
        return (
            f"{opening} no level has {FEWEST:g} to {most:.2g} electrons, at which the histogram of "
            "codes contains more information than mean and variance; add such flats for a "
            "better gain."
        )
    return dim[np.unique(np.linspace(0, len(dim) - 1, min(len(dim), LEVELS)).astype(int))]


def code_tables(
    measurement: PhotonTransfer,
    levels: Int[np.ndarray, " levels"],
    flats: Sequence[Sequence[str]],
    darks: Sequence[Sequence[str]],
    *,
    plane: Callable[[str], np.ndarray],
    live: Bool[np.ndarray, "h w"] | None,
) -> CodeTables:
    """Count the codes at some light levels, from their flats and darks, which are read again."""
    bright, dark, converter = measurement.bright, measurement.dark, measurement.converter
    matched = np.asarray(measurement.dark_of)[levels]
    wander = drift(dark).variance / converter.step**2 if drift(dark).is_significant else 0.0

    def codes_of(name: str) -> np.ndarray:
        frame = (plane(name) - converter.origin) / converter.step
        return frame.ravel() if live is None or live.shape != frame.shape else frame[live]

    rows = []
    for d in np.unique(matched):
        black = sum(codes_of(name) for name in darks[int(d)]) / len(darks[int(d)])
        variance = float(dark.variance[d]) / converter.step**2
        error = variance / len(darks[int(d)]) + wander
        noise = np.sqrt(variance + error)
        count = int(np.clip(np.ceil(2 / noise), 1, PLACES))
        whole = np.floor(black).astype(int)
        above = black - whole
        place = np.minimum((count * above).astype(int), count - 1)
        for level in levels[matched == d]:
            signal = float(bright.mean[level] - dark.mean[d]) / converter.step
            deviation = np.sqrt(float(bright.variance[level]) / converter.step**2 + error)
            first = int(np.floor(-TABLE_HALF_WIDTH * noise))
            size = int(np.ceil(signal + TABLE_HALF_WIDTH * deviation)) + 2 - first
            counts = np.zeros(count * size)
            for name in flats[int(level)]:
                at = np.round(codes_of(name)).astype(int) - whole - first
                inside = (at >= 0) & (at < size)
                counts += np.bincount((place * size + at)[inside], minlength=counts.size)
            for k, own in enumerate(counts.reshape(count, size)):
                of_place = above[place == k]
                if own.any():
                    known = error + float(of_place.var())
                    rows.append((level, d, float(of_place.mean()), known, first, own))
    level, of, places, known, first, counts = zip(*rows, strict=True)
    size = -(-max(len(own) for own in counts) // SIZES) * SIZES
    padded = [np.pad(own, (0, size - len(own)), constant_values=np.nan) for own in counts]
    return CodeTables(
        level=jnp.asarray(level),
        dark=jnp.asarray(of),
        place=jnp.asarray(places),
        known=jnp.asarray(known),
        first=jnp.asarray(first, float),
        counts=jnp.asarray(np.stack(padded)),
    )


# Largest read noise in the sum over electrons, relative to that from moments
LARGEST_READ_NOISE_RATIO = 1.3
LARGEST_REDUCED_CHI_SQUARE = 2.0  # chi-square per degree of freedom up to which the tables are used
TREND = 3  # exposures of darks needed to separate dark electrons from the black level


@dataclass(frozen=True)
class CodeFit:
    """The result of the fit to histograms of codes."""

    levels: Int[np.ndarray, " m"]  # indices of the bright levels
    # (2 + m,) logarithms of gain (DN/e-), read noise (e-) and electrons of each level
    logs: Float[np.ndarray, " logs"]
    covariance: Float[np.ndarray, "logs logs"]
    numbers: int  # number of counted values, over pixels and frames
    failures: tuple[str, ...]  # why the fit is not used, in sentences; empty where it is used

    def counted_levels(self, usable: Int[np.ndarray, " usable"]) -> CountedLevels | None:
        """Return the result as data at the `usable` levels; None if the fit failed."""
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
    """Return the problem for histograms of codes, and its start from means and variances."""
    dark, converter = measurement.dark, measurement.converter
    levels, level = np.unique(np.asarray(tables.level), return_inverse=True)
    darks, of = np.unique(np.asarray(tables.dark), return_inverse=True)
    matched, step = np.asarray(measurement.dark_of)[levels], converter.step
    dark_variance = np.asarray(dark.variance)
    signal = signal_of(measurement)[levels] / step
    excess = shot_of(measurement)[levels] / step**2
    gain = float(excess.sum() / signal.sum())
    own = np.maximum(dark_variance[darks] - converter.rounding, 0.0) / step**2
    read_noise = float(np.sqrt(own.mean()) / gain)
    unlit = _dark_signal(measurement)[darks] / step
    unsure = np.sqrt(dark_variance[darks] / np.asarray(dark.frames)[darks] / float(dark.pixels))
    known = np.asarray(tables.known)[:, None]
    widest = np.sqrt((LARGEST_READ_NOISE_RATIO * read_noise) ** 2 + float(known.max()) / gain**2)
    codes = np.asarray(tables.first)[:, None] + np.arange(tables.counts.shape[1])
    one = jnp.ones((len(codes), 1))
    sensor = Sensor(shot_noise=PoissonShotNoise(), gain=gain, read_noise=read_noise, offset=0.0)
    # One number per table, for which a sensor record has no shape.
    sensor = eqx.tree_at(lambda s: (s.read_noise, s.offset), sensor, (read_noise * one, 0 * one))
    problem = Problem(
        {
            "sensor.gain": Parameter(unit="DN/e⁻", transform="log"),
            "read_noise": Parameter(unit="e⁻", transform="log"),
            "black": Parameter(shape=(len(darks),), prior=Normal(0.0, 1.0)),  # standard errors
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
    """Fit the histograms of codes of a measurement; None if it has none."""
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
    if ratio > LARGEST_REDUCED_CHI_SQUARE:
        failures.append(
            "Poisson's electrons with Gaussian read noise do not describe it (chi-square per "
            f"degree of freedom is {ratio:.3g})."
        )
    return CodeFit(levels, logs, covariance, numbers, tuple(failures))


def _dark_signal(measurement: PhotonTransfer) -> np.ndarray:
    """Return the dark signal of each dark, DN, by a line; 0 with fewer than 3 exposures."""
    dark = measurement.dark
    exposure, mean = np.asarray(dark.exposure), np.asarray(dark.mean)
    if len(np.unique(exposure)) < TREND:
        return np.zeros_like(mean)
    slope = np.polyfit(exposure, mean, 1)[0]
    return max(float(slope), 0.0) * exposure


def _frames_in_common(
    measurement: PhotonTransfer, tables: CodeTables, read_noise: float, log_gain: float
) -> float:
    """Return the factor by which the covariance of the fit grows because all flats of a pixel share
    the error of its black level. If the codes of a pixel in F flats have correlation rho, the
    squares of the codes have correlation rho^2. Therefore the factor is 1 + (F - 1) rho^2."""
    step, most = measurement.converter.step, 1.0
    own = (read_noise * np.exp(log_gain)) ** 2 + measurement.converter.rounding
    for d in np.unique(np.asarray(tables.dark)):
        of = np.asarray(tables.dark) == d
        flats = np.unique(np.asarray(tables.level)[of])
        frames = float(np.asarray(measurement.bright.frames)[flats].sum())
        error = float(np.asarray(tables.known)[of].max()) * step**2
        most = max(most, 1 + (frames - 1) * (error / (own + error)) ** 2)
    return most
