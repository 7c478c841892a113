"""Conversion of a calibration to two sensors for predictions: the best fit, and a sensor with
posterior draws."""

from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.optimize import root_scalar
from scipy.special import ndtr

from jaxvision import Compression, PoissonShotNoise, Sensor, ShutterOffset
from jaxvision.files.cameras import write_sensor

from ..codes import Converter
from ..inference.compiled import compiled_briefly
from ..inference.parameters import names, to_natural, to_unconstrained
from ..inference.precision import double_precision
from .brighter_fatter import fitted_effect, fitted_kernel, fitted_mixing
from .calibration import NoiseCalibration
from .levels import reached, shot_of
from .model import compressed, electrons_and_steps
from .neighbours import shares
from .pattern import SIGNIFICANCE_SIGMAS
from .shared import drift, temporal_lines
from .statement import fit_without_levels

AT_FULL_SCALE = 0.98  # share of full scale from which the brightest level is at the converter's end
CUT = 0.5  # share of the expected shot noise below which a level has full wells


def ends_at_full_scale(calibration: NoiseCalibration) -> bool:
    """Return whether the converter's range ends before the well is full."""
    measurement = calibration.measurement
    if measurement.full_scale is None:
        return False
    return float(reached(measurement.bright).max()) >= AT_FULL_SCALE * measurement.full_scale


def full_well(calibration: NoiseCalibration) -> tuple[float, float] | None:
    """Return the full well times the gain at zero signal, DN, and its standard error, from levels
    at which wells fill; None if there are no such levels.

    At mu expected electrons and a full well W, the mean is E[min(N, W)], with N Gaussian of mean
    and variance mu. This equation is solved for W.
    """
    if calibration.within.saturation is None or ends_at_full_scale(calibration):
        return None
    measurement, chosen = calibration.measurement, calibration.chosen
    bright, shot = measurement.bright, shot_of(measurement)
    values = {name: float(value) for name, value in chosen.values.items()}
    gain, top = values["system_gain"], float(chosen.data.top_signal)
    above = np.asarray(bright.mean) - values["black_level"]
    light = np.asarray(bright.light)
    electrons = np.asarray(electrons_and_steps(chosen.values, chosen.data)[0])
    electrons = electrons[: len(calibration.usable)]
    per_light = electrons[-1] / light[calibration.usable[-1]]
    found = []
    for level in range(int(calibration.usable[-1]) + 1, len(light)):
        if above[level] <= 0 or shot[level] > CUT * gain * above[level]:
            continue
        signal = root_scalar(
            lambda x, to: float(compressed(values, x, top)) - to,  # type: ignore[arg-type]
            bracket=(0.0, 3 * above[level]),
            args=(above[level],),
        ).root
        mean = light[level] * per_light
        if signal / gain < mean:
            found.append(gain * _well_of(signal / gain, mean))
    if not found:
        return None
    pixels = float(bright.pixels)
    noise = np.sqrt(np.max(np.asarray(bright.variance)) / pixels)
    return float(np.median(found)), float(np.hypot(np.std(found), noise))


def _well_of(held: float, mean: float) -> float:
    """Solve E[min(N, W)] = held for W, with N Gaussian of this mean and variance."""
    sigma = np.sqrt(mean)

    def mean_error(well: float) -> float:
        z = (well - mean) / sigma
        return well - held - sigma * (z * ndtr(z) + np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi))

    return root_scalar(mean_error, bracket=(held, mean + 10 * sigma)).root


DRAWS = 1000  # most draws that are kept
BIT_TOLERANCE = 0.01  # bits by which a range may exceed a power of two
LINES = ("row_noise", "column_noise")  # noise that the likelihood's read noise includes


def fitted_sensor(
    calibration: NoiseCalibration, *, left_out: Bool[np.ndarray, " levels"] | None = None
) -> tuple[Sensor, Sensor]:
    """Return the sensor of a calibration, with every significant effect, and its posterior draws.

    Gain and efficiency are those at zero signal. Noise that rows, columns or frames share is not
    part of the sensor's read noise. Likewise, unequal rows and columns are not part of DSNU, nor
    unequal columns of PRNU. In every draw, the kernels of the brighter-fatter effect and of mixing
    have the shape of the best fit. The sensor's exposure time is the median of the flats'
    exposures, and its light is in photons per pixel and second. If all numbers in the frames are
    multiples of a step, as left-aligned numbers are, the sensor's output is the number divided by
    that step.
    """
    return best_and_draws(sensors_of(drawn_numbers(calibration, left_out=left_out)))


def best_and_draws(every: Sensor) -> tuple[Sensor, Sensor]:
    """Split sensors along their leading axis into the best fit and the draws."""
    best = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)[0]), every)
    return best, jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)[1:]), every)


class Numbers(eqx.Module):
    """The parameters of a calibrated camera. The first row is the best estimate, each further row a
    posterior draw."""

    about: "About"  # the part that all draws share
    natural: Float[np.ndarray, "draws parameters"]  # values of the likelihood's parameters
    # of each effect outside the likelihood, by its field
    beside: dict[str, Float[np.ndarray, " draws"]]

    @property
    def top(self) -> np.ndarray:
        """The signal X of the brightest level, DN."""
        return self.about.top

    def parameter(self, name: str) -> Float[np.ndarray, " draws"]:
        """Return the values of one parameter."""
        return self.natural[:, self.about.labels.index(name)]

    def replace_parameters(self, draws: dict[str, Float[np.ndarray, " draws"]]) -> "Numbers":
        """Return the record with the values of these parameters replaced."""
        natural = self.natural.copy()
        for name, values in draws.items():
            natural[:, self.about.labels.index(name)] = values
        return replace(self, natural=natural)

    def select_draws(self, rows: Int[np.ndarray, " draws"]) -> "Numbers":
        """Return the parameters of some draws."""
        beside = {name: one[rows] for name, one in self.beside.items()}
        return replace(self, natural=self.natural[rows], beside=beside)


def drawn_numbers(
    calibration: NoiseCalibration,
    *,
    left_out: Bool[np.ndarray, " levels"] | None = None,
    asked: frozenset[str] = frozenset(),
) -> Numbers:
    """Return a sensor's parameters; effects `asked` for need not be significant."""
    posterior, usable = calibration.posterior, calibration.usable
    rows = np.linspace(0, len(posterior.samples) - 1, min(DRAWS, len(posterior.samples)))
    if left_out is None:
        mode, natural = posterior.mode, posterior.samples[rows.astype(int)]
    else:
        mode, covariance = mode_without(calibration, left_out)
        rng = np.random.default_rng(posterior.seed)
        every = [mode, *rng.multivariate_normal(mode, covariance, len(rows))]
        mode, *natural = np.asarray(to_natural(posterior.space, jnp.asarray(np.array(every))))
        usable = usable[~left_out[: len(usable)]]
    labels, measurement = names(posterior.space), calibration.measurement
    about = About(
        labels=labels,
        converter=measurement.converter,
        full_scale=measurement.full_scale if measurement.converter.step else None,
        photons_known=measurement.photons_known,
        fades=any("dark_current" in doubt.of for doubt in measurement.doubts),
        exposure=np.median(np.asarray(measurement.bright.exposure)),
        top=np.asarray(calibration.chosen.data.top_signal),
        kernel=fitted_kernel(measurement, usable) if "brighter_fatter" in labels else None,
        shares=shares(measurement, usable, power=1) if "pixel_mixing" in labels else None,
    )
    beside = _parameters_outside_likelihood(calibration, len(rows), asked)
    return Numbers(about, np.stack([mode, *natural]), beside)


def bits_of(full_scale: float, converter: Converter) -> float:
    """Return the number of bits of a converter whose largest number is known. The number of bits is
    rounded up, because a step that was scaled in the file is known to few digits, and because the
    range may end before the last code."""
    return float(
        np.ceil(
            np.log2((full_scale - converter.origin) / (converter.step or 1.0) + 1) - BIT_TOLERANCE
        )
    )


@compiled_briefly
def sensors_of(numbers: Numbers) -> Sensor:
    """Make a sensor with a leading axis: the best estimate, then each draw."""
    return eqx.filter_vmap(lambda natural, beside: _sensor(numbers.about, natural, beside))(
        numbers.natural, numbers.beside
    )


@double_precision
def write_fitted_sensor(calibration: NoiseCalibration, path: Path) -> None:
    """Write the sensor of a calibration to a file, and its posterior draws to a second file."""
    best, draws = fitted_sensor(calibration)
    about = "Fitted by photon transfer; light is photons per pixel and second."
    write_sensor(
        best, path, draws=draws, about=about + codes_in_words(calibration.measurement.converter)
    )


def codes_in_words(converter: Converter) -> str:
    """Return a sentence on the factor from the files' numbers to codes; "" for 1."""
    if converter.step in (0.0, 1.0):
        return ""
    return f" Its codes are the file's numbers divided by {converter.step:.5g}."


def mode_without(
    calibration: NoiseCalibration, left_out: Bool[np.ndarray, " levels"]
) -> tuple[Float[np.ndarray, " parameters"], Float[np.ndarray, "parameters parameters"]]:
    """Fit the same model without some levels; return the optimum of the fit and its covariance. If
    the other levels do not determine all parameters, the covariance is that of the posterior,
    increased by the ratio of the numbers of levels."""
    chosen, posterior = calibration.chosen, calibration.posterior
    optimum = fit_without_levels(chosen, left_out)
    try:
        np.linalg.cholesky(optimum.information)
    except np.linalg.LinAlgError:
        vectors = np.asarray(to_unconstrained(posterior.space, jnp.asarray(posterior.samples)))
        return optimum.vector, np.cov(vectors.T) * left_out.size / np.sum(~left_out)
    return optimum.vector, chosen.inflation * np.linalg.inv(optimum.information)


def _parameters_outside_likelihood(
    calibration: NoiseCalibration, count: int, asked: frozenset[str]
) -> dict[str, Float[np.ndarray, " draws"]]:
    """Return sensor fields by name (mostly variances, DN^2), the best value before the draws."""
    rng, found = np.random.default_rng(calibration.posterior.seed), {}

    def add(name: str, variance: float, degrees: float, noise: float = 0.0) -> None:
        """Add a variance to the parameters, with draws from its distribution, which follows from
        the degrees of freedom and the noise of the estimate."""
        drawn = variance * degrees / rng.chisquare(degrees, count)
        drawn = np.maximum(drawn + noise * rng.standard_normal(count), 0.0)
        found[name] = np.concatenate([[max(variance, 0.0)], drawn])

    dark = calibration.measurement.dark
    passing = {
        "row_noise": temporal_lines(dark, 0),
        "column_noise": temporal_lines(dark, 1),
        "frame_noise": drift(dark),
    }
    for name, one in passing.items():
        if one.is_significant:
            add(name, one.variance, 2 * (one.variance / one.error) ** 2)
        elif name in asked:
            drawn = one.variance + one.error * rng.standard_normal(count)
            found[name] = np.maximum(np.concatenate([[one.variance], drawn]), 0.0)
    labels = names(calibration.posterior.space)
    if "frame_noise" not in found and "black_scatter" in labels:
        # Drift of the black level between levels of this many frames.
        place, frames = labels.index("black_scatter"), float(np.median(np.asarray(dark.frames)))
        value, error = calibration.posterior.mode[place], calibration.chosen.errors["black_scatter"]
        add("frame_noise", frames * float(value) ** 2, 1 / (2 * error**2))
    if calibration.patterns is not None:
        offsets, gains = calibration.patterns[1].dark, calibration.patterns[1].response
        own, *lines = offsets.parts
        if own.variance > SIGNIFICANCE_SIGMAS * offsets.noise or "dsnu" in asked:
            add("dsnu", own.variance, own.degrees, offsets.noise)
        for name, part in zip(("row_dsnu", "column_dsnu"), lines, strict=False):
            if part.variance > 0 or name in asked:
                add(name, part.variance, part.degrees)
        own, *lines = gains.parts
        pixels = own.variance + (lines[0].variance if lines else 0.0)
        if pixels > SIGNIFICANCE_SIGMAS * gains.noise or "prnu" in asked:
            add("prnu", pixels, own.degrees, gains.noise)
        if lines[1:] and (lines[1].variance > 0 or "column_prnu" in asked):
            add("column_prnu", lines[1].variance, lines[1].degrees)
    well = full_well(calibration)
    if well is not None:
        drawn = well[0] + well[1] * rng.standard_normal(count)
        found["full_well"] = np.maximum(np.concatenate([[well[0]], drawn]), 0.0)
    return found


class About(eqx.Module):
    """Properties that all draws of a sensor share: parameter names, converter, whether photons are
    known, median exposure, the brightest signal X, and the shapes of the kernels."""

    labels: tuple[str, ...] = eqx.field(static=True)
    converter: Converter = eqx.field(static=True)
    full_scale: float | None = eqx.field(static=True)
    photons_known: bool = eqx.field(static=True)
    fades: bool = eqx.field(static=True)
    exposure: np.ndarray
    top: np.ndarray
    kernel: np.ndarray | None
    shares: np.ndarray | None


def _sensor(about: About, natural: Float[Array, " parameters"], known: dict[str, Array]) -> Sensor:
    """Make the sensor of one draw from the parameters of the likelihood and from `known` ones."""
    values = dict(zip(about.labels, natural, strict=True))
    converter, scale = about.converter, about.full_scale
    gain, read = values["system_gain"], (values["read_noise"] * values["system_gain"]) ** 2
    if about.photons_known:  # at most one electron for each photon
        gain = jnp.maximum(gain, values["responsivity"])
    step, origin = converter.step or 1.0, converter.origin
    current = None if about.fades else values.get("dark_current")
    offset = values.get("light_offset")
    if offset is not None and not about.photons_known:
        offset = ShutterOffset(offset)
    # The sensor rounds once, by its step; the variance of further rounding in the file counts as
    # read noise.
    rounding = converter.rounding - (0.0 if scale is None else step**2 / 12)
    read = read + rounding - sum(known[name] for name in LINES if name in known)
    rms = {name: jnp.sqrt(variance) for name, variance in known.items()}
    electrons = {name: deviation / gain for name, deviation in rms.items()}
    bits = None if scale is None else bits_of(scale, converter)
    return Sensor(
        shot_noise=PoissonShotNoise(),
        light_offset=offset,
        brighter_fatter=fitted_effect(about.kernel, values, about.top),
        mixing=fitted_mixing(about.shares, values),
        nonlinearity=_compression(values, about.top),
        exposure_time=jnp.asarray(about.exposure),
        quantum_efficiency=values["responsivity"] / gain if about.photons_known else None,
        read_noise=jnp.sqrt(jnp.maximum(read, 0)) / gain,
        dark_current=None if current is None else jnp.maximum(current, 0),
        full_well=known["full_well"] / gain if "full_well" in known else None,
        gain=gain / step,
        offset=(values["black_level"] - origin) / step,
        bits=None if bits is None else jnp.asarray(bits),
        row_noise=electrons.get("row_noise"),
        column_noise=electrons.get("column_noise"),
        frame_noise=electrons.get("frame_noise"),
        dsnu=electrons.get("dsnu"),
        row_dsnu=electrons.get("row_dsnu"),
        column_dsnu=electrons.get("column_dsnu"),
        prnu=rms.get("prnu"),
        column_prnu=rms.get("column_prnu"),
    )


def _compression(values: dict[str, Array], top: Array | np.ndarray) -> Compression | None:
    """Return the chosen response curve of a `Sensor`; None if it is linear."""
    if "compression" not in values:
        return None
    electrons = top / values["system_gain"]
    return Compression(values["compression"], values.get("compression_2"), electrons=electrons)
