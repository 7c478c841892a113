"""A calibrated camera as a sensor for predictions: the best fit, and draws."""

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
from ..inference.parameters import names, to_natural
from ..inference.precision import double_precision
from .brighter_fatter import electrons_and_steps, fitted_effect, fitted_kernel, fitted_mixing
from .calibration import NoiseCalibration
from .levels import reached, shot_of
from .model import compressed
from .neighbours import shares
from .pattern import SEEN
from .shared import drift, temporal_lines
from .statement import fitted_without

AT_FULL_SCALE = 0.98  # share of full scale from which the brightest level is at the converter's end
CUT = 0.5  # share of the expected shot noise below which a level has full wells


def ends_at_full_scale(calibration: NoiseCalibration) -> bool:
    """Return whether the converter's range ends before the well is full."""
    measurement = calibration.measurement
    if measurement.full_scale is None:
        return False
    return float(reached(measurement.bright).max()) >= AT_FULL_SCALE * measurement.full_scale


def full_well(calibration: NoiseCalibration) -> tuple[float, float] | None:
    """The full well times the gain at zero signal, from the levels whose wells are full.

    A level of mu electrons has the mean E[min(N, W)] with N Gaussian of variance mu, which is
    solved for W.
    """
    if calibration.within.saturation is None or ends_at_full_scale(calibration):
        return None
    measurement, chosen = calibration.measurement, calibration.chosen
    bright, shot = measurement.bright, shot_of(measurement)
    values = {name: float(value) for name, value in chosen.values.items()}
    gain, top = values["system_gain"], float(chosen.data.top_signal)
    above = np.asarray(bright.mean) - values["black_level"]
    light = np.asarray(bright.light)
    electrons = np.asarray(electrons_and_steps(chosen)[0])[: len(calibration.usable)]
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
    """W of E[min(N, W)] = held, with N Gaussian of this mean and variance."""
    sigma = np.sqrt(mean)

    def missed(well: float) -> float:
        z = (well - mean) / sigma
        return well - held - sigma * (z * ndtr(z) + np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi))

    return root_scalar(missed, bracket=(held, mean + 10 * sigma)).root


DRAWS = 1000  # most draws that are kept
WHOLE = 0.01  # bits by which a range may exceed a power of two
LINES = ("row_noise", "column_noise")  # noise that the likelihood's read noise includes


def fitted_sensor(
    calibration: NoiseCalibration, *, left_out: Bool[np.ndarray, " levels"] | None = None
) -> tuple[Sensor, Sensor]:
    """The sensor of a calibration, with every effect that was found.

    Gain and efficiency are those at zero signal. Noise that rows, columns or frames share is
    separate from the read noise. Unequal rows and columns are separate from DSNU, and unequal
    columns from PRNU. The kernels of the brighter-fatter effect and of mixing have the best fit's
    shape in every draw. The exposure is the median of the flats' exposures, so light is a rate in
    photons per pixel and second. If the numbers of the frames are multiples of a step, as
    left-aligned ones are, the sensor gives the converter's own codes.
    """
    return best_and_draws(sensors_of(drawn_numbers(calibration, left_out=left_out)))


def best_and_draws(every: Sensor) -> tuple[Sensor, Sensor]:
    """The first of several sensors along the leading axis of every field, and the others."""
    best = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)[0]), every)
    return best, jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)[1:]), every)


class Numbers(eqx.Module):
    """The parameters of a calibrated camera: the best estimate, then draws."""

    about: "About"  # the part that all draws share
    natural: Float[np.ndarray, "draws parameters"]  # values of the likelihood's parameters
    # of each effect outside the likelihood, by its field
    beside: dict[str, Float[np.ndarray, " draws"]]

    @property
    def top(self) -> np.ndarray:
        """X, DN."""
        return self.about.top

    def of(self, name: str) -> Float[np.ndarray, " draws"]:
        """The values of one parameter."""
        return self.natural[:, self.about.labels.index(name)]

    def having(self, draws: dict[str, Float[np.ndarray, " draws"]]) -> "Numbers":
        """Return the numbers with these parameters replaced."""
        natural = self.natural.copy()
        for name, values in draws.items():
            natural[:, self.about.labels.index(name)] = values
        return replace(self, natural=natural)

    def at(self, rows: Int[np.ndarray, " draws"]) -> "Numbers":
        """The numbers of some draws."""
        beside = {name: one[rows] for name, one in self.beside.items()}
        return replace(self, natural=self.natural[rows], beside=beside)


def drawn_numbers(
    calibration: NoiseCalibration,
    *,
    left_out: Bool[np.ndarray, " levels"] | None = None,
    asked: frozenset[str] = frozenset(),
) -> Numbers:
    """The parameters of `fitted_sensor`; `asked` names effects to include even if they are not
    significant."""
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
    beside = _beside_the_likelihood(calibration, len(rows), asked)
    return Numbers(about, np.stack([mode, *natural]), beside)


def bits_of(full_scale: float, converter: Converter) -> float:
    """The bits of a converter whose largest number is known. A step that was scaled in the file is
    known to a few digits, and the range may end early."""
    return float(
        np.ceil(np.log2((full_scale - converter.origin) / (converter.step or 1.0) + 1) - WHOLE)
    )


@compiled_briefly
def sensors_of(numbers: Numbers) -> Sensor:
    """Sensors with a leading axis at every field: the best estimate, then draws."""
    return eqx.filter_vmap(lambda natural, beside: _sensor(numbers.about, natural, beside))(
        numbers.natural, numbers.beside
    )


@double_precision
def write_fitted_sensor(calibration: NoiseCalibration, path: Path) -> None:
    """Write the sensor of a calibration, with its draws in a second file."""
    best, draws = fitted_sensor(calibration)
    about = "Fitted by photon transfer; light is photons per pixel and second."
    write_sensor(
        best, path, draws=draws, about=about + codes_in_words(calibration.measurement.converter)
    )


def codes_in_words(converter: Converter) -> str:
    """Return a sentence on the step of the numbers in the files; empty if these are the codes."""
    if converter.step in (0.0, 1.0):
        return ""
    return f" Its codes are the file's numbers divided by {converter.step:.5g}."


def mode_without(
    calibration: NoiseCalibration, left_out: Bool[np.ndarray, " levels"]
) -> tuple[Float[np.ndarray, " parameters"], Float[np.ndarray, "parameters parameters"]]:
    """The fit of the same model without some levels."""
    chosen = calibration.chosen
    optimum = fitted_without(chosen, left_out)
    return optimum.vector, chosen.inflation * np.linalg.inv(optimum.information)


def _beside_the_likelihood(
    calibration: NoiseCalibration, count: int, asked: frozenset[str]
) -> dict[str, Float[np.ndarray, " draws"]]:
    """Parameters of a sensor outside the likelihood, by field name: the best estimate, then draws.
    They are in DN^2, so that each draw's own gain applies; PRNU^2 is relative, and the full well in
    DN."""
    rng, found = np.random.default_rng(calibration.posterior.seed), {}

    def add(name: str, variance: float, degrees: float, noise: float = 0.0) -> None:
        """Add a variance with its degrees of freedom and the noise of its estimate."""
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
        if one.believed:
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
        if own.variance > SEEN * offsets.noise or "dsnu" in asked:
            add("dsnu", own.variance, own.degrees, offsets.noise)
        for name, part in zip(("row_dsnu", "column_dsnu"), lines, strict=False):
            if part.variance > 0 or name in asked:
                add(name, part.variance, part.degrees)
        own, *lines = gains.parts
        pixels = own.variance + (lines[0].variance if lines else 0.0)
        if pixels > SEEN * gains.noise or "prnu" in asked:
            add("prnu", pixels, own.degrees, gains.noise)
        if lines[1:] and (lines[1].variance > 0 or "column_prnu" in asked):
            add("column_prnu", lines[1].variance, lines[1].degrees)
    well = full_well(calibration)
    if well is not None:
        drawn = well[0] + well[1] * rng.standard_normal(count)
        found["full_well"] = np.maximum(np.concatenate([[well[0]], drawn]), 0.0)
    return found


class About(eqx.Module):
    """Properties that all draws of a sensor share: parameter names, converter, known light, median
    exposure, X, and the shapes of the kernels."""

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
    """The sensor for one draw of the likelihood's parameters and of the other parameters."""
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
    """The compression of the chosen model, in electrons."""
    if "compression" not in values:
        return None
    electrons = top / values["system_gain"]
    return Compression(values["compression"], values.get("compression_2"), electrons=electrons)
