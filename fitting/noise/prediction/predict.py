"""Tests of a camera by prediction: of new frames by a camera file, and of its own frames by a
calibration."""

import os
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Int

from jaxvision import Sensor, as_dtype
from jaxvision.errors import InputError
from jaxvision.files.cameras import read_camera, read_sensor, write_sensor
from jaxvision.files.records import count_draws
from jaxvision.files.toml import read_toml
from jaxvision.sensor import dark_rate

from ...inference.given import require_kind
from ...inference.parameters import names
from ...inference.precision import double_precision
from ...report.notebook import ShownInNotebooks
from ..calibration import NoiseCalibration
from ..levels import PhotonTransfer, linear_levels, partly_saturated_in_words
from ..pattern import fitted_pattern, local_pattern
from ..periodic import periodic_in_words, periodic_structure
from ..raw_frames import processing_in_words
from ..sensor import bits_of, fitted_sensor
from ..sites import camera_of_taps, stated_in_words, tap_of, tap_sensor
from .comparison import Comparison, compare
from .missing import Missing, missing_effects
from .moments import OFFSETS, number_of, rms_of

DRAWS = 200  # draws of a camera file that are used for its uncertainty
LEAST = 3  # levels, beyond the number of a curve's terms, that half of the levels must have
NOISES = ("read_noise", "shot_noise")  # fields needed to predict variances
GAINS = ("prnu", "conversion_prnu", "column_prnu")
CORRECTED = {"offsets": "after a dark frame was subtracted", "gains": "after a division by a flat"}
OF_ALL_PIXELS = "An effect that is named below is a mean over all of these pixels, not of any one."
OTHER_CAUSES = {"offsets": " or a warmer one", "gains": ", or the light is not smooth"}
LEAST_OFFSETS, LEAST_GAINS = 0.5, 0.005  # of the dark noise, and relative, that are named
LEAST_PATTERN = 0.7  # of the stated rms of a fixed pattern, below which frames were corrected
MOST_AVERAGED = 256  # frames or pixels
CLEAR = 3.0  # standard deviations of a dark from the first code
OTHER = 5.0  # ratio of dark signals to each other, and to the noise, that is a contradiction
PATTERN_SIGMAS = 5.0  # standard errors of a measured pattern
HOLD_OUT_STRIDE = 2  # one of this many levels is held out
FEWEST_DARKS = 8  # number of darks from which darks are held out, too

Camera = NoiseCalibration | Sensor | str | os.PathLike[str]


@dataclass(frozen=True, repr=False)
class Prediction(ShownInNotebooks):
    """The result of a comparison of frames with their prediction by a camera.

    Attributes:
        camera: name of the camera in sentences.
        comparisons: of the prediction with sets of levels; findings are about the first comparison.
        labels: names of the levels of each comparison.
        light_error: relative error of the light of a level.
        variance_error: relative scatter of the variances for unknown reasons.
        missing: known effects that the camera lacks.
        remarks: sentences on numbers that the camera does not state, and how this was handled, and
            on frames that were left out or processed.
        cause: a sentence on numbers that contradict the camera, which replaces the search for
            missing effects.
    """

    camera: str
    comparisons: tuple[Comparison, ...]
    labels: tuple[str, ...]
    light_error: float
    variance_error: float
    missing: tuple[Missing, ...]
    remarks: tuple[str, ...] = ()
    cause: str = ""

    @property
    def main_comparison(self) -> Comparison:
        """The first comparison, from which findings are drawn."""
        return self.comparisons[0]

    @property
    def judged(self) -> Comparison:
        """Former name of `main_comparison`."""
        warnings.warn("judged is now main_comparison.", DeprecationWarning, stacklevel=2)
        return self.main_comparison

    @property
    def unscaled(self) -> bool:
        """Whether the rate of the light was fitted to the means."""
        return self.main_comparison.unscaled


@double_precision
def predict(
    camera: Camera,
    measurement: PhotonTransfer,
    *,
    draws: Sensor | None = None,
    light_error: float = 0.0,
) -> Prediction:
    """Compare frames with their prediction by a camera, without a fit to these frames.

    Args:
        camera: a calibration, a sensor, a file of either a sensor (`sensor.toml` of a noise
            calibration, with its draws beside it) or a camera, or the name of a shipped camera.
        measurement: flats of at least 4 levels and darks, as `read_photon_transfer` or
            `from_frames` returns them.
        draws: for a sensor that is not a file, the same sensor with a leading axis of draws at
            every number; None if its numbers are exact.
        light_error: relative standard deviation of the true light of a level about the stated one.

    Returns:
        Mean, variance and covariance of neighbours at each level with their prediction,
        chi-squares, and the effects that the camera lacks.

    Raises:
        InputError: for an argument that is not a camera of one channel, and for frames with another
            number of bits.

    Example:
        >>> from fitting.noise import Camera, from_frames, predict
        >>> known = {"quantum_efficiency": 0.5, "read_noise": 4.0, "gain": 0.5, "offset": 50.0}
        >>> sensor = jv.Sensor(shot_noise=jv.PoissonShotNoise(), bits=12, **known)
        >>> photons = [500.0, 1000.0, 2000.0, 4000.0]
        >>> def frames(seed, light):
        ...     field, keys = jnp.full((40, 40, 1), light), jax.random.split(jax.random.key(seed))
        ...     return [np.asarray(jv.raw_image(key, sensor, field))[..., 0] for key in keys]
        >>> flats = [frames(i, light) for i, light in enumerate(photons)]
        >>> at = {"camera": Camera(bits=12), "dark_exposures": [1.0]}
        >>> measured = from_frames(flats, [frames(9, 0.0)], [1.0] * 4, photons, **at)
        >>> predict(sensor, measured).main_comparison.missed  # nothing
        []
    """
    require_kind("noise.predict: measurement", measurement, PhotonTransfer, source="from_frames")
    if not 0 <= light_error < 1:
        raise InputError(
            f"light_error is {light_error:g}, but is relative: give .01 for 1 %, at least 0 and "
            "below 1."
        )
    name = "The camera"
    if isinstance(camera, NoiseCalibration):
        camera, draws = written(camera)
    elif not isinstance(camera, Sensor):
        name = str(camera)
        camera, draws = read_with_draws(Path(camera))
    if camera.taps is not None:
        camera, draws = _tap_sensors(name, camera, draws, measurement)
        name = f"{name}, {measurement.site},"
    camera = _channel_sensor(name, camera)
    _require_bits(name, camera, measurement)
    if draws is not None:
        draws = eqx.tree_at(
            lambda sensor: sensor.photon_conversion, draws, None, is_leaf=lambda leaf: leaf is None
        )
    measurement = as_dtype(measurement, np.float64)
    usable = linear_levels(measurement)
    unstated = [field for field in NOISES if getattr(camera, field) is None]
    dithered = camera
    if camera.read_noise is None:  # the effect of rounding on means depends on it
        step = (measurement.converter.step or 1.0) * number_of(camera, "gain", absent=1.0)
        read = np.sqrt(np.asarray(measurement.dark.variance).mean()) / step
        dithered = replace(camera, read_noise=read)
        if draws is not None:
            every = np.full(len(jax.tree.leaves(draws)[0]), read)
            draws = eqx.tree_at(
                lambda sensor: sensor.read_noise, draws, every, is_leaf=lambda leaf: leaf is None
            )
    found = compare(
        *(dithered, draws, measurement, usable),
        noise_known=not unstated,
        dies=1 if draws is None else 2,
        light_error=light_error,
    )
    cause = _contradiction(camera, measurement)
    if not np.asarray(found.lit.lit).any():
        raise InputError(
            f"{name}: predicts every level of light at an end of its scale, but the frames have "
            f"{float(measurement.bright.mean[usable].min()):.4g} to "
            f"{float(measurement.bright.mean[usable].max()):.4g} DN; check its gain, its offset, "
            f"the photons (per pixel and exposure){' and exposures. ' + cause if cause else '.'}"
        )
    return Prediction(
        camera=name,
        comparisons=(found,),
        labels=("all levels below saturation",),
        light_error=light_error,
        variance_error=0.0,
        missing=() if cause else missing_effects(found),
        cause=cause,
        remarks=(
            *processing_in_words(measurement, usable),
            *(doubt.sentence for doubt in measurement.doubts),
            *measurement.bright.left_out,
            *measurement.dark.left_out,
            *measurement.remarks,
            *partly_saturated_in_words(measurement),
            *_remarks(name, camera, unstated, found),
            *_pattern_in_words(camera, measurement, usable),
            *_structure_in_words(camera, measurement, usable),
        ),
    )


def _remarks(name: str, camera: Sensor, noises: list[str], found: Comparison) -> list[str]:
    """Return sentences on numbers that the camera does not state, and levels left out."""
    sentences = [
        f"{name} states no {field}: {taken} was taken."
        for field, taken in (("gain", "1 DN/e⁻"), ("offset", "a black level of 0 DN"))
        if getattr(camera, field) is None
    ]
    if noises:
        seen, lit = np.asarray(found.measured[1]), np.asarray(found.lit.lit) > 0
        sentences.append(
            f"{name} states no {' and no '.join(noises)}, so it predicts no variance: "
            "only means were compared, with the noise of the frames, "
            f"{float(np.sqrt(seen[~lit].mean())):.3g} DN rms in the dark."
        )
    if found.ended:
        sentences.append(
            f"{found.ended} level{'s' * (found.ended > 1)} that the camera predicts at an end of "
            "its scale were left out."
        )
    return sentences


def _contradiction(camera: Sensor, measurement: PhotonTransfer) -> str:
    """Return a sentence if dark signal or black level contradict the camera's; else ""."""
    dark, converter = measurement.dark, measurement.converter
    step, gain = converter.step or 1.0, number_of(camera, "gain", absent=1.0)
    black = converter.origin + step * number_of(camera, "offset")
    longest = int(np.argmax(np.asarray(dark.exposure)))
    time, mean = float(dark.exposure[longest]), float(dark.mean[longest])
    noise = float(np.sqrt(dark.variance[longest]))
    current = 0.0 if camera.dark_current is None else float(dark_rate(camera.dark_current))
    seen, stated = mean - black, step * gain * current * time
    near = CLEAR * max(noise, step)
    if converter.clips_below is None and mean - converter.origin < near < black - converter.origin:
        return (
            f"The darks have a mean of {mean:.3g} DN, where the camera has a black level of "
            f"{black:.4g} DN: black was subtracted, and numbers below 0 became 0."
        )
    if current > 0 < time and max(seen, stated) > OTHER * max(noise, min(seen, stated)):
        return (
            f"The darks of {time:.4g} s have a dark signal of {seen:.3g} DN, where the camera's "
            f"dark current, {current:.3g} e⁻/s, gives {stated:.3g} DN: exposures may be in another "
            "unit than seconds, the temperature another one, or a dark frame was subtracted."
        )
    return ""


def _pattern_in_words(
    camera: Sensor, measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"]
) -> list[str]:
    """Return sentences on a fixed pattern much smaller or larger than the camera's."""
    bright, dark = measurement.bright, measurement.dark
    if bright.spatial_variance is None or bright.local_pattern is None:
        return []
    found, local = fitted_pattern(measurement, usable), local_pattern(measurement, usable)
    noise, sentences = np.sqrt(np.asarray(dark.variance)), []
    gain = number_of(camera, "gain", absent=1.0) * (measurement.converter.step or 1)
    kinds = (
        ("offsets", OFFSETS, found.dark, 1 / gain, " e⁻", LEAST_OFFSETS * float(noise.min())),
        ("gains", GAINS, found.response, 100.0, " %", LEAST_GAINS),
    )
    for kind, own in zip(kinds, local, strict=True):
        what, fields, seen, scale, unit, least = kind
        if fields is OFFSETS and np.any(dark.mean - measurement.converter.lowest < CLEAR * noise):
            continue  # clipped black hides a part of the offsets
        stated = rms_of(camera, fields) * (1.0 if unit == " e⁻" else scale)
        says = f"where the camera states {f'{stated:.2g}{unit}' if stated else 'none'}"
        most = scale * (max(seen.variance, 0.0) + PATTERN_SIGMAS * seen.noise) ** 0.5
        at_least = scale * max(own.variance - PATTERN_SIGMAS * own.noise, 0.0) ** 0.5
        if most < LEAST_PATTERN * stated:
            sentences.append(
                f"The {what} of the pixels differ by less than {most:.2g}{unit} rms, {says}, as "
                f"{CORRECTED[what]} or in means of several pixels."
            )
        elif LEAST_PATTERN * at_least > max(stated, scale * least):
            rms = scale * own.variance**0.5
            sentences.append(
                f"The {what} of neighbouring pixels differ by {rms:.2g}{unit} rms, {says}: it is "
                f"another sensor{OTHER_CAUSES[what]}."
            )
    return sentences


def _structure_in_words(
    camera: Sensor, measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"]
) -> list[str]:
    """Return sentences on taps, halves or a mosaic of frames that are predicted as one channel."""
    if measurement.site is not None:
        return []
    gain = number_of(camera, "gain", absent=1.0) * (measurement.converter.step or 1)
    sentences = periodic_in_words(periodic_structure(measurement, usable), gain, fitted=False)
    return [*sentences, *(OF_ALL_PIXELS,) * bool(sentences)]


def _require_bits(name: str, camera: Sensor, measurement: PhotonTransfer) -> None:
    converter = measurement.converter
    if camera.bits is None or measurement.full_scale is None or not converter.step:
        return
    bits, seen = float(camera.bits), bits_of(measurement.full_scale, converter)
    if bits == seen:
        return
    step = converter.step
    own = f"{seen:g}"
    if step < 1:
        count = round(1 / step)
        how = (
            f"in means of {count} frames or pixels" if count <= MOST_AVERAGED else "after division"
        )
        own += f" (their values are multiples of 1/{count}, as {how})"
    elif step > 1:
        own += f" (their values are multiples of {step:.6g})"
    elif seen > bits:
        own += ", as the sum of frames or pixels has, or a file whose upper bits are unused"
    else:
        own += ", as a copy of fewer bits has"
    raise InputError(
        f"{name} has {bits:g} bits, and the frames {own}; give single frames of the same "
        "converter, or state their bits."
    )


@double_precision
def predict_own_frames(calibration: NoiseCalibration) -> Prediction:
    """Compare a calibration's own frames with their prediction by its sensor, which is written to a
    file and read back. If there are enough levels, a second fit of the same model also predicts
    levels that it did not use.
    """
    whole = compared(calibration, written(calibration), None)
    kept_out = levels_kept_out(calibration)
    comparisons, labels = (whole,), ("the levels of its fit",)
    if kept_out is not None:
        camera = written(calibration, kept_out=kept_out)
        comparisons = (compared(calibration, camera, kept_out), whole)
        labels = ("levels kept out of its fit", "all levels, fitted to them")
    missing = missing_effects(comparisons[0])
    errors = scatters(calibration)
    return Prediction("The written camera", comparisons, labels, missing=missing, **errors)


def scatters(calibration: NoiseCalibration) -> dict[str, Any]:
    """Return the fitted relative scatter of light and variances, which no camera file contains."""
    values = calibration.chosen.values
    drift = float(values.get("light_drift", 0.0))
    return {
        "light_error": float(np.hypot(values.get("light_scatter", 0.0), drift / 12**0.5)),
        "variance_error": float(values.get("variance_scatter", 0.0)),
    }


def levels_kept_out(calibration: NoiseCalibration) -> Bool[np.ndarray, " levels"] | None:
    """Return a mask of the levels to hold out: every second bright level, and the darks that only
    these bright levels use. Return None if there are too few levels."""
    measurement, chosen = calibration.measurement, calibration.chosen
    bright, darks = len(calibration.usable), measurement.dark.mean.size
    curve = {"compression", "compression_2", "light_offset"} & {*names(chosen.space)}
    apart = np.arange(bright) % HOLD_OUT_STRIDE == 1
    if (~apart).sum() < LEAST + len(curve) + 1:
        return None
    unlit = np.zeros(darks, bool)
    if darks >= FEWEST_DARKS:
        matched = np.asarray(measurement.dark_of)
        used = np.isin(np.arange(darks), matched[calibration.usable[~apart]])
        unlit = np.isin(np.arange(darks), matched[calibration.usable[apart]]) & ~used
        if (~unlit).sum() < FEWEST_DARKS // 2:
            unlit[:] = False
    return np.concatenate([apart, unlit])


def compared(
    calibration: NoiseCalibration,
    camera: tuple[Sensor, Sensor | None],
    kept_out: Bool[np.ndarray, " levels"] | None,
) -> Comparison:
    """Compare own frames with a sensor; only levels `kept_out` if it was fitted without them."""
    own = {"shown": kept_out, "fitted": kept_out is None, **scatters(calibration)}
    return compare(*camera, calibration.measurement, calibration.usable, **own)


def written(
    calibration: NoiseCalibration, *, kept_out: Bool[np.ndarray, " levels"] | None = None
) -> tuple[Sensor, Sensor | None]:
    """Make the sensor of a calibration and its draws, write them to a file, and read them back."""
    return reread(*fitted_sensor(calibration, left_out=kept_out))


def reread(best: Sensor, draws: Sensor) -> tuple[Sensor, Sensor | None]:
    """Write a sensor and its draws to a file and read them back."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "sensor.toml"
        write_sensor(best, file, draws=draws)
        return read_with_draws(file)


def read_with_draws(file: Path) -> tuple[Sensor, Sensor | None]:
    """Read a sensor, and its draws from the file next to it if there is one."""
    if not file.suffix and not file.exists():
        return read_camera(str(file)).sensor, None
    whole = "view" in read_toml(file, "camera")
    count = min(DRAWS, count_draws(file))
    if whole:
        draws = read_camera(file, draws=count).sensor if count else None
        return read_camera(file).sensor, draws
    return read_sensor(file), read_sensor(file, draws=count) if count else None


def _tap_sensors(
    name: str, sensor: Sensor, draws: Sensor | None, measurement: PhotonTransfer
) -> tuple[Sensor, Sensor | None]:
    """Return the sensor, and its draws, of the amplifier tap that read the frames."""
    assert sensor.taps is not None
    site, pattern, stated = measurement.site, measurement.pattern, camera_of_taps(sensor.taps)
    count = max(max(row) for row in sensor.taps.pattern) + 1
    state = "camera.taps or camera.pattern of the frames as the calibration had it"
    if stated is not None:
        state = f"{stated_in_words(stated)} of the frames, or what it is of these"
    if site is None:
        raise InputError(
            f"{name}: has {count} taps, but the frames are not split into them; state {state}."
        )
    tap = tap_of(sensor.taps, site, pattern)
    if tap is None:
        own = f" of a {pattern} mosaic" if pattern else ""
        raise InputError(
            f"{name}: does not name its taps as the frames do ({site}{own} was requested); "
            f"state {state}, or calibrate a camera of that pattern."
        )
    every = None if draws is None else eqx.filter_vmap(lambda one: tap_sensor(one, tap))(draws)
    return tap_sensor(sensor, tap), every


def _channel_sensor(name: str, sensor: Sensor) -> Sensor:
    """Return a one-channel sensor whose light is in photons per pixel."""
    several = sensor.colour_filter is not None and sensor.colour_filter.transmission.size > 1
    several |= sensor.quantum_efficiency is not None and sensor.quantum_efficiency.size > 1
    if several or sensor.infrared_cut is not None:
        raise InputError(
            f"{name}: has several bands, but flats have one light; give the sensor of one channel, "
            "as jaxvision-fit noise writes it for each site of a mosaic."
        )
    return replace(sensor, photon_conversion=None)
