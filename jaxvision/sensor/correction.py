"""Convert raw data back to light: undo the effects of the camera, and estimate the error of the
result.

    light = (unmixed(g^-1((raw - black) / K)) - dark) / flat

In this formula g is the curve of the nonlinearity, and K the gain. The error of a corrected frame
is a sum of parts. Each part is an amplitude times a standard Gaussian variable, which is
independent for each pixel, row, column or frame, or the same in all pixels. If the correction
inverts mixing or crosstalk between neighbours, the part is convolved with a small kernel. Shot
noise, read noise and rounding errors are independent from frame to frame. The errors of master
frames, differences between pixels and the uncertainty of the camera's parameters are the same in
all frames, and partly cancel in the difference of two frames.
"""

import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.signal import convolve2d
from jaxtyping import Array, Bool, Float

from ..core._arguments import takes_numbers
from ..core._shown import Shown
from ..core._types import (
    POSITIVE,
    Scalar,
    Scalars,
    as_float,
    check_choice,
    check_fields,
    check_shape,
    is_known,
)
from ..filters.convolution import convolve
from ..scene import Camera, Sensor, ShutterOffset
from . import _processed
from ._taps import factored, tap_map, total_gain
from .adc import amplified, largest_number
from .brighter_fatter import gathered
from .ccd import transferred
from .exposure import (
    PLANCK,
    SPEED_OF_LIGHT,
    Counts,
    drifted,
    mean_dark,
    mean_photoelectrons,
    smeared,
)
from .moments import QUANTISATION_VARIANCE, Moments, pattern_variance, signal_variance
from .nonlinearity import charge_of_signal, signal_of_charge
from .read_out import read_out_variance
from .sampling import light_share

FAR = 4.0  # a pixel may be full, dead or dark if it is within so many standard deviations of noise
SAMPLE = 2**18  # pixels of a frame that are compared with black
MOST_BELOW, FEWEST_BELOW = 0.01, 10  # share and number of pixels far below black: defects are fewer
DEAD = 0.1  # a pixel whose flat is within the noise is dead below this relative sensitivity

Along = Literal["pixels", "rows", "columns", "frame", "all"]
Kernel = Float[Array, "rows columns"]

_PERIOD, _REACH = 32, 8  # pixels: grid on which a kernel is inverted, and reach of the result
UNITS = ("electrons", "photons", "irradiance")


class Master(Shown):
    """A master frame: the mean of several frames.

    Attributes:
        mean: (h, w, bands) DN.
        frames: () number of averaged frames, > 0.

    Example:
        >>> jv.Master(jnp.full((2, 2, 1), 64.0), 100).frames.item()
        100.0
    """

    mean: Float[Array, "h w bands"] = eqx.field(converter=as_float)
    frames: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, frames=POSITIVE)


class Masters(Shown):
    """Master frames for the correction of other frames with the same exposure time.

    Attributes:
        dark: frame without light, which shows black level, dark current and the offset of each
            pixel; or None.
        flat: frame in uniform light, which shows the sensitivity of each pixel; or None.
        defects: (h, w) true for pixels that must not be used; or None.

    Example:
        >>> jv.Masters(dark=jv.Master(jnp.full((2, 2, 1), 64.0), 100)).flat is None
        True
    """

    dark: Master | None = eqx.field(default=None, kw_only=True)
    flat: Master | None = eqx.field(default=None, kw_only=True)
    defects: Bool[Array, "h w"] | None = eqx.field(default=None, kw_only=True)


class Part(Shown):
    """One part of the error of a corrected frame, such as its shot noise.

    Attributes:
        name: source of the error. Parts with the same name whose draws are the same in all frames
            cancel in differences. Static.
        amplitude: (..., h, w, bands) standard deviation in the unit of the frame. The sign matters
            if the draws are the same in all frames.
        kernel: (rows, columns) no unit, with which the error is convolved, or None.
        along: which pixels have the same draw: none ("pixels"), those of a row or of a column, or
            all of one "frame"; with "all" the draw is also the same in all frames. Static.
        lasts: whether the draws are the same in all frames. Static.

    Example:
        >>> jv.sensor.Part("shot", jnp.ones((2, 2, 1))).lasts
        False
    """

    name: str = eqx.field(static=True)
    amplitude: Counts
    kernel: Kernel | None = None
    along: Along = eqx.field(static=True, default="pixels", kw_only=True)
    lasts: bool = eqx.field(static=True, default=False, kw_only=True)


class Calibrated(Shown):
    """A corrected frame, and the parts of its error.

    Attributes:
        image: (..., h, w, bands) photoelectrons for a pixel of mean sensitivity, or photons, or W
            m^-2; NaN in defects and where the raw value or the flat was saturated, or the flat
            has no light.
        parts: the parts of its error.
        saturated: (..., h, w, bands) whether the raw value was saturated; None if the sensor has
            neither `bits` nor a `full_well`.

    Example:
        >>> sensor = jv.Sensor(shot_noise=jv.PoissonShotNoise(), gain=0.5, offset=10.0)
        >>> found = jv.sensor.correct(jnp.full((2, 2, 1), 60.0), sensor)
        >>> found.image[0, 0].tolist(), found.variance[0, 0].tolist()
        ([100.0], [100.0])
    """

    image: Counts
    parts: tuple[Part, ...]
    saturated: Bool[Array, "..."] | None = None

    @property
    def variance(self) -> Counts:
        """The variance of the noise that is independent from frame to frame, (..., h, w, bands):
        shot noise, read-out noise and rounding."""
        return self._sum(lambda part: not part.lasts)

    @property
    def total_variance(self) -> Counts:
        """The variance of the total error of each pixel, (..., h, w, bands), summed over all
        parts."""
        return self._sum(lambda part: True)

    @property
    def shared(self) -> Float[Array, "factors ..."]:
        """The shift of all pixels by one standard deviation along each principal axis of the
        camera's parameters, (factors, ..., h, w, bands)."""
        found = [_blur(part.amplitude, part.kernel) for part in self.parts if part.along == "all"]
        return jnp.stack(found) if found else jnp.zeros((0, *self.image.shape))

    def mean(self, where: Bool[Array, "h w"] | None = None) -> Moments:
        """Return the mean of the pixels where `where` is true, (..., bands) in the unit of the
        image, and the variance of this mean. Pixels that are NaN are excluded, and errors common to
        several pixels are included in the variance. Warn of saturated pixels, unless JAX traces the
        frame."""
        kept = jnp.isfinite(self.image)
        if where is not None:
            kept = kept & _broadcast(jnp.asarray(where)[..., None], kept)
        if self.saturated is not None and is_known(self.saturated):
            with jax.ensure_compile_time_eval():  # known values may occur inside a trace
                patch = jnp.ones(1, bool) if where is None else jnp.asarray(where)[..., None]
                share = float(jnp.mean(self.saturated, where=_broadcast(patch, self.saturated)))
            if share > 0:
                warnings.warn(
                    f"{share:.2g} of the patch's pixels are saturated and left out. The others are "
                    "those whose light or noise is low, so that the mean is too low.",
                    stacklevel=2,
                )
        counted = kept.astype(self.image.dtype)
        weights = counted / jnp.sum(counted, axis=(-3, -2), keepdims=True)
        value = jnp.sum(jnp.where(kept, self.image, 0) * weights, axis=(-3, -2))
        variances = (_sum_variance(part, weights) for part in self.parts)
        return Moments(value, sum(variances, jnp.zeros_like(value)))

    def filtered(self, kernel: Kernel) -> "Calibrated":
        """Return the frame, and its error, after a convolution with mirrored borders.

        Args:
            kernel: (rows, columns) no unit.

        Returns:
            The filtered frame.
        """
        kernel = as_float(kernel)
        parts = (replace(part, kernel=_combine_kernels(part.kernel, kernel)) for part in self.parts)
        return Calibrated(convolve(self.image, kernel), tuple(parts), self.saturated)

    def __sub__(self, other: "Calibrated") -> "Calibrated":
        """Return the difference of two frames of one camera. Errors that are the same in both
        frames cancel."""
        lasting = {part.name: part for part in other.parts if part.lasts}
        parts = [part for part in other.parts if not part.lasts]
        for part in self.parts:
            same = lasting.pop(part.name, None) if part.lasts else None
            if same is not None:
                part = replace(part, amplitude=part.amplitude - same.amplitude)
            parts.append(part)
        ends = [x for x in (self.saturated, other.saturated) if x is not None]
        saturated = ends[0] | ends[-1] if ends else None
        return Calibrated(self.image - other.image, (*parts, *lasting.values()), saturated)

    def _sum(self, counts: Callable[[Part], bool]) -> Counts:
        found = [_variance(part) for part in self.parts if counts(part)]
        return jnp.zeros_like(self.image) + sum(found)


def _broadcast(picture: Array, frames: Counts) -> Array:
    """Add leading axes to a picture until it has as many axes as `frames`."""
    return picture.reshape(*(1,) * (frames.ndim - picture.ndim), *picture.shape)


def _blur(picture: Counts, kernel: Kernel | None) -> Counts:
    return picture if kernel is None else convolve(picture, kernel)


def _combine_kernels(first: Kernel | None, second: Kernel | None) -> Kernel | None:
    """Return the kernel of two convolutions, one after the other; None stands for no
    convolution."""
    if first is None or second is None:
        return second if first is None else first
    return convolve2d(first, second)


def _variance(part: Part) -> Counts:
    """Return the variance of each pixel due to one part of the error. The amplitude is assumed to
    be constant over the kernel."""
    kernel = part.kernel
    if part.along in ("frame", "all") or kernel is None:
        return _blur(part.amplitude, kernel) ** 2
    if part.along == "rows":
        kernel = kernel.sum(1, keepdims=True)
    elif part.along == "columns":
        kernel = kernel.sum(0, keepdims=True)
    return convolve(part.amplitude**2, kernel**2)


def _sum_variance(part: Part, weights: Counts) -> Scalars:
    """Return the variance, (..., bands), of a weighted sum over the pixels due to one part of the
    error."""
    back = weights if part.kernel is None else convolve(weights, part.kernel[::-1, ::-1])
    share = back * part.amplitude
    match part.along:
        case "pixels":
            return jnp.sum(share**2, axis=(-3, -2))
        case "rows":
            return jnp.sum(jnp.sum(share, axis=-2) ** 2, axis=-2)
        case "columns":
            return jnp.sum(jnp.sum(share, axis=-3) ** 2, axis=-2)
        case _:
            return jnp.sum(share, axis=(-3, -2)) ** 2


@takes_numbers
def correct(
    raw: Counts,
    camera: Sensor | Camera,
    *,
    masters: Masters | None = None,
    draws: Sensor | Camera | None = None,
    expected: Counts | None = None,
    unit: str = "electrons",
) -> Calibrated:
    """Convert raw data to photoelectrons, photons or irradiance. Black level, gain, nonlinearity,
    mixing, charge transfer, brighter-fatter effect, dark current, flat field, crosstalk, smear and
    light offset are undone.

    Charge transfer and the brighter-fatter effect are undone to first order. Without master frames,
    the differences between pixels remain in the image. The RMS of these differences, as given in
    the sensor, is a part of the error. Banding is treated as row noise.

    Args:
        raw: (..., h, w, bands) DN; (..., h, w, 1) for a mosaic. Leading axes are frames.
        camera: the sensor, or a camera that contains it.
        masters: dark and flat frames, and defects.
        draws: the same record with a leading axis of draws at every number, from the posterior of
            its calibration: `read_sensor(file, draws=200)`. The covariance of the draws gives the
            error parts that pixels share.
        expected: (..., h, w, bands) expected photoelectrons for the variance of shot noise, such as
            a smoothed picture; in photoelectrons for every `unit`. None takes the image itself,
            whose noise then affects the variance.
        unit: "electrons", "photons" per pixel and exposure, or "irradiance" in W m^-2.

    Returns:
        The corrected frame, and the parts of its error.

    Raises:
        ValueError: for an unknown unit, a unit that several bands or a colour filter make
            ambiguous, user-defined effects or a curve without an inverse, masters whose shape
            differs from the frames', and a flat that is saturated throughout.

    Warns:
        UserWarning: if the dark master differs much from the dark signal of the camera; if raw
            numbers are not whole, are above the last code, or are below the numbers without light;
            and if a frame has much less noise than the camera, or lacks the pattern of the masters.
            Traced arrays give no warning.

    Example:
        >>> sensor = jv.Sensor(nonlinearity=jv.Compression(0.05, electrons=1e4), offset=64.0)
        >>> raw = jv.raw_image(None, sensor, jnp.full((4, 4, 1), 5000.0))
        >>> round(float(jv.sensor.correct(raw, sensor).image[0, 0, 0]))
        5000
    """
    check_choice("unit", unit, UNITS)
    sensor = camera.sensor if isinstance(camera, Camera) else camera
    masters = Masters() if masters is None else masters
    check_shape("correct: raw", raw, ("...", "h", "w", "bands"))
    advice = ", as the frames have; give masters of the same frames"
    for name in ("dark", "flat"):
        master = getattr(masters, name)
        shown = None if master is None else master.mean
        check_shape(f"correct: masters.{name}.mean", shown, raw.shape[-3:], advice=advice)
    check_shape("correct: masters.defects", masters.defects, raw.shape[-3:-1], advice=advice)
    if expected is not None and expected.ndim > 0:
        check_shape("correct: expected", expected, ("...", *raw.shape[-3:]))
    measured = raw = as_float(raw)  # codes are unsigned, and would wrap
    stated = masters
    masters = _add_defects_of_flat(sensor, masters)
    if masters.defects is not None:  # neighbours are unmixed from the mean of those around
        raw, masters = _fill(raw, masters.defects), _fill_masters(masters, masters.defects)
    if sensor.own is not None:
        names = ", ".join(type(effect).__name__ for effect in sensor.own)
        raise ValueError(f"correct knows no inverse of {names}.")

    def image_by(one: Sensor) -> Counts:
        image = _image(one, raw, masters, _flat(one, masters, raw))
        return _times(image, _scale(one, unit, raw, masters))

    image = image_by(sensor)
    of_light = _multiply(_scale(sensor, unit, raw, masters), _shutter(sensor))
    parts = [
        replace(part, amplitude=_times(part.amplitude, of_light))
        for part in _parts(sensor, raw, masters, expected)
    ]
    if draws is not None:
        own = draws.sensor if isinstance(draws, Camera) else draws
        parts += _camera_parts(sensor, own, image_by)
    saturated = _find_saturated(sensor, measured)
    bad = jnp.zeros(raw.shape, bool) if saturated is None else saturated
    if masters.defects is not None:
        bad = bad | _broadcast(masters.defects[..., None], raw)
    if masters.dark is not None:
        _warn_of_dark(sensor, masters.dark)
    found = Calibrated(jnp.where(bad, jnp.nan, image), tuple(parts), saturated)
    _warn_of_raw(sensor, found, measured, stated)
    return found


def _find_saturated(sensor: Sensor, raw: Counts) -> Bool[Array, "..."] | None:
    """Return the mask of pixels at the upper end of the ADC's range, or within the noise below the
    full well; None if the sensor has neither limit."""
    bad = None
    if sensor.bits is not None:
        bad = raw >= largest_number(sensor.bits)
    if sensor.full_well is not None:
        noise = jnp.sqrt(read_out_variance(sensor, shape=raw.shape, dtype=raw.dtype))
        full = _charge(sensor, raw, None) + FAR * noise >= sensor.full_well
        bad = full if bad is None else bad | full
    return bad


def _find_ended(sensor: Sensor, flat: Master) -> Bool[Array, "..."]:
    """Return the mask of pixels of a flat that may have been saturated in some of the averaged
    frames, because they are within the noise below the end of the range."""
    if sensor.bits is None:
        return jnp.zeros(flat.mean.shape, bool)
    top = largest_number(sensor.bits)
    gain = 1.0 if sensor.gain is None else jnp.max(sensor.gain)
    near = FAR * jnp.sqrt(gain * top + QUANTISATION_VARIANCE)  # noise at the end of the range, DN
    ended = flat.mean >= (top if sensor.shot_noise is None else top - near)
    if is_known(ended) and bool(ended.all()):
        raise ValueError(
            "correct: masters.flat is saturated in all its pixels; take flats of half of full "
            "scale."
        )
    return ended


def _add_defects_of_flat(sensor: Sensor, masters: Masters) -> Masters:
    """Add to the defects the pixels whose flat is saturated or does not exceed the noise."""
    if masters.flat is None:
        return masters
    flat = _flat(sensor, masters, masters.flat.mean)
    assert flat is not None
    of = {"shape": flat.shape, "dtype": flat.dtype}
    noise = jnp.sqrt(read_out_variance(sensor, **of) / masters.flat.frames)
    dim = jnp.minimum(FAR * noise, DEAD * jnp.mean(flat, (-3, -2), keepdims=True))
    bad = jnp.any(_find_ended(sensor, masters.flat) | (flat <= jnp.maximum(dim, 0)), axis=-1)
    if is_known(bad):
        if not bool(bad.any()):
            return masters
        if bool(bad.all()):
            dark = "the black level" if masters.dark is None else "masters.dark"
            level = float(jnp.mean(masters.flat.mean))
            raise ValueError(
                f"correct: masters.flat, of {level:.4g} DN on average, shows no light above {dark} "
                "in any pixel; give flats as the camera wrote them, neither divided by their mean "
                "nor without the black level, and not in the place of the dark."
            )
    return replace(masters, defects=bad if masters.defects is None else masters.defects | bad)


def _warn(words: str) -> None:
    """Warn at the line that calls `correct`."""
    warnings.warn(words, stacklevel=5)


def _warn_of_raw(sensor: Sensor, found: Calibrated, raw: Counts, masters: Masters) -> None:
    """Warn if the raw numbers are not a single frame of the camera: if they are not codes of its
    converter, are below black, or lack its noise or the pattern of the masters."""
    if not all(map(is_known, jax.tree.leaves((sensor, found, raw, masters)))):
        return
    black, of_dark, pattern = _dark_signal(sensor, raw)
    spread = jnp.sqrt(of_dark if masters.dark is not None else of_dark + pattern)
    black = black if masters.dark is None else masters.dark.mean
    numbers = np.asarray(raw)
    every = max(raw.size // SAMPLE, 1) | 1  # rows of both kinds of a mosaic
    some, least = (one[..., ::every, :, :] for one in (numbers, np.asarray(black - FAR * spread)))
    if not np.isfinite(some).any():
        return
    smallest, largest = (float(one.reduce(numbers, axis=None)) for one in (np.fmin, np.fmax))
    mean, expected = float(np.nanmean(some, dtype=float)), float(np.mean(black))
    below = int(np.sum(some < least))
    if (
        mean < expected - FAR * float(np.mean(spread))
        or below > max(MOST_BELOW * some.size, FEWEST_BELOW)
        or (sensor.bits is not None and smallest < 0)
    ):
        _warn(
            f"raw has a mean of {mean:.4g} DN and {below} of {some.size} numbers below the "
            f"{expected:.4g} DN without light, by more than noise; give the numbers as the camera "
            "wrote them, neither divided by their largest number, nor of fewer bits, nor without "
            "the black level or a dark frame; and the exposure time in seconds."
        )
        return
    codes, top = _processed.middle(raw), np.inf
    if sensor.bits is not None:
        top = float(largest_number(sensor.bits))
        if largest > top:
            _warn(
                f"raw has numbers up to {largest:.6g}, where {float(sensor.bits):g} bits end at "
                f"{top:g}; divide numbers that are aligned at the left, and give single frames "
                "before any correction, not their sums."
            )
        elif not np.array_equal(codes, np.round(codes), equal_nan=True):
            _warn(
                "raw has numbers that are not whole, as means of frames or corrected frames have; "
                "the stated errors are those of a single raw frame."
            )
    dark = _processed.middle(jnp.broadcast_to(of_dark, raw.shape[-3:]))
    for words in _doubts_of_masters(sensor, found, masters, codes):
        _warn(words)
    own = [part for part in found.parts if not part.lasts and part.along == "pixels"]
    if own and top > 1:
        light = _processed.middle(found.image)
        noise = np.zeros_like(light)
        for part in own:
            near = replace(part, amplitude=_processed.middle(part.amplitude)[..., None])
            noise += np.asarray(_variance(near))[..., 0]
        ratios = _processed.noise_ratios(light, noise, codes)
        share = _processed.noise_ratio(ratios)
        if share < _processed.LESS_NOISE:
            _warn(
                f"the noise of raw, at its smoothest, has {share:.2g} of the variance that the "
                "camera states, as in means of frames or pixels, in denoised or scaled copies, in "
                "those of fewer bits, or at a lower gain; the errors are not those of such frames, "
                "and the electrons are wrong if the numbers were scaled."
            )
        if ratios.size and sensor.shot_noise is not None:
            squares = {
                one.name: float(np.nanmean(np.square(_processed.middle(one.amplitude))))
                for one in found.parts
            }
            lost = expected / (1.0 if sensor.gain is None else float(sensor.gain))
            if _processed.looks_without_black(
                ratios,
                light=float(np.nanmean(light)),
                noise=float(np.nanmean(noise)),
                offsets=squares.get("dsnu", 0.0),
                gains=squares.get("prnu", 0.0) + squares.get("conversion_prnu", 0.0),
                black=lost,
            ):
                _warn(
                    f"the noise of raw has {float(ratios.mean()):.3g} of the variance that the "
                    f"camera states, as if the black level of {expected:.4g} DN had been "
                    f"subtracted before: all results are then {lost:.4g} electrons too small; give "
                    "the numbers as the camera wrote them."
                )
    for name, *planes in _patterns(found, masters, codes, dark):
        lacking = _processed.lacks(*planes)
        if lacking is not None:
            why = f": it was corrected by a {name} frame before, or the master is of another "
            why += "camera, region or binning"
            if lacking:
                why = ": turn it, or the masters"
            _warn(
                f"raw lacks the pattern of masters.{name}{lacking}{why}; give raw frames, and "
                "masters of the same pixels."
            )


def _doubts_of_masters(
    sensor: Sensor, found: Calibrated, masters: Masters, codes: np.ndarray
) -> Iterator[str]:
    """Yield a sentence if a flat is a picture of a scene or of another mosaic, or if a master has
    more noise than that of its stated number of frames."""
    black, temporal, pattern = _dark_signal(sensor, found.image)
    black = black if masters.dark is None else masters.dark.mean
    shape = found.image.shape[-3:]
    black, temporal, pattern = (
        np.broadcast_to(np.asarray(one, float), shape) for one in (black, temporal, pattern)
    )
    variances = {"dark": (pattern, temporal)}
    if masters.flat is not None:
        flat = np.asarray(masters.flat.mean, float) - black
        light = _processed.DARKEST * float(np.median(flat[..., 0]))
        share = _processed.structured_share(flat[..., 0], light)
        if share > _processed.OF_A_SCENE:
            yield (
                f"masters.flat varies between neighbouring blocks of pixels in {share:.0%} of the "
                "frame, as a picture of a scene does: its structure is divided out of the result; "
                "give a mean of frames of an evenly lit white field."
            )
        shown = _processed.middle(flat)
        if shape[-1] == 1 and _processed.other_sites(codes - _processed.middle(black), shown):
            yield (
                "masters.flat has a pattern of 2 x 2 pixels, as of a colour mosaic, that raw lacks "
                "or has in another phase; give masters of the same pixels of the same camera."
            )
        gains = (sensor.prnu, sensor.conversion_prnu, sensor.column_prnu)
        relative = sum(float(np.max(one)) ** 2 for one in gains if one is not None)
        gain = 1.0 if sensor.gain is None else float(jnp.max(sensor.gain))
        shot = 0.0 if sensor.shot_noise is None else gain * np.maximum(flat, 0)
        if relative and share <= _processed.OF_A_SCENE:
            variances["flat"] = pattern + relative * flat**2, temporal + shot
    for name, (lasting, own) in variances.items():
        master = getattr(masters, name)
        if master is None or not np.any(lasting > 0):
            continue
        stated = _processed.middle(lasting + own / float(master.frames))
        rough = _processed.roughness(_processed.middle(master.mean), stated)
        if rough > _processed.ROUGH:
            yield (
                f"neighbouring pixels of masters.{name} differ {rough:.2g} times as much as the "
                f"camera states for a mean of {float(master.frames):g} frames: fewer frames were "
                "averaged, the master has fewer bits, or it is of another camera."
            )


def _patterns(
    found: Calibrated, masters: Masters, codes: np.ndarray, of_dark: np.ndarray
) -> Iterator[tuple[Any, ...]]:
    """Yield for each master: its name, the frame that must contain its pattern, the pattern, the
    variance of the pattern's error, and the weight of each pixel."""
    if masters.dark is not None:
        dark = _processed.middle(masters.dark.mean)
        yield "dark", codes, dark, of_dark / float(masters.dark.frames), np.ones_like(codes)
    errors = [part.amplitude for part in found.parts if part.name == "flat"]
    if masters.flat is not None and errors:
        flat, image = masters.flat.mean, found.image
        if masters.dark is not None:
            flat = flat - masters.dark.mean
        flat, image, error = map(_processed.middle, (flat, image, errors[0]))
        lit = (flat > 0) & (image > FAR * np.abs(error))
        flat, image = (np.where(lit, x, np.nan) for x in (flat, image))
        pattern = np.log(flat)
        yield "flat", np.log(image) + pattern, pattern, np.square(error / image), np.sqrt(image)


def _dark_signal(sensor: Sensor, raw: Counts) -> tuple[Counts, Counts, Counts]:
    """Return mean, temporal variance and pattern variance of a dark frame, DN and DN^2. If all
    pixels have the same values, the result is a single pixel, (1, 1, bands)."""
    height, width, bands = raw.shape[-3:]
    colours = sensor.colour_filter
    if colours is not None:
        bands = colours.transmission.shape[1]
    of_place = (sensor.taps, colours, sensor.smear, sensor.charge_transfer)
    if all(one is None for one in of_place):
        height = width = 1
    light = jnp.zeros((height, width, bands), raw.dtype)
    black = amplified(sensor, mean_dark(sensor, raw) + light[..., : raw.shape[-1]])
    return black, signal_variance(sensor, light), pattern_variance(sensor, light)


def _warn_of_dark(sensor: Sensor, dark: Master) -> None:
    """Warn if a dark master differs from the camera's dark signal by more than twice the noise."""
    if not all(map(is_known, jax.tree.leaves((sensor, dark.mean)))):
        return
    black, variance, _ = _dark_signal(sensor, dark.mean)
    beside = _light_offset(sensor, dark.mean)  # may be absent in a dark frame with a covered lens
    more = jnp.zeros((), black.dtype) if beside is None else jnp.max(beside)
    gain = total_gain(sensor, shape=black.shape, dtype=black.dtype)
    found = float(np.median(_processed.middle(dark.mean)))
    expected, noise = (float(jnp.median(one)) for one in (black, jnp.sqrt(variance)))
    most = expected + float(jnp.max(_times(more, gain)))
    if found < expected - 2 * noise or found > most + 2 * noise:
        warnings.warn(
            f"masters.dark has a median of {found:.4g} DN, where the camera states "
            f"{expected:.4g} DN for its exposure time and temperature; the result is wrong "
            "by the difference if the master's exposure time or temperature are not the frames'.",
            stacklevel=4,
        )


def _times(x: Scalars, factor: Scalars | None) -> Scalars:
    """Return x times the factor, or x itself if the factor is None."""
    return x if factor is None else x * factor


def _multiply(one: Scalars | None, other: Scalars | None) -> Scalars | None:
    return other if one is None else one if other is None else one * other


def _image(sensor: Sensor, raw: Counts, masters: Masters, flat: Counts | None) -> Counts:
    """Return the photoelectrons that a pixel of mean sensitivity would have collected in each
    place."""
    light = _subtract_dark(sensor, _charge(sensor, raw, masters.dark))
    light = light if flat is None else light / _response(flat)
    if sensor.crosstalk is not None:
        light = convolve(light, _inverse(_cross(sensor.crosstalk)))
    if sensor.smear is not None:
        column = light.sum(axis=-3, keepdims=True)
        whole = column / (1 + sensor.smear * (light.shape[-3] - 1))
        light = (light - sensor.smear * whole) / (1 - sensor.smear)
    beside = _light_offset(sensor, light)
    return _times(light if beside is None else light - beside, _shutter(sensor))


def _subtract_dark(sensor: Sensor, charge: Counts) -> Counts:
    return charge if sensor.dark_current is None else charge - mean_dark(sensor, charge)


def _light_offset(sensor: Sensor, like: Counts) -> Scalars | None:
    """Return the light offset of a sensor in photoelectrons, or None if the sensor has no light
    offset."""
    if sensor.light_offset is None or isinstance(sensor.light_offset, ShutterOffset):
        return None
    colours = sensor.colour_filter
    bands = like.shape[-1:] if colours is None else colours.transmission.shape[1:]
    return mean_photoelectrons(sensor, jnp.zeros((*like.shape[:-1], *bands), like.dtype))


def _shutter(sensor: Sensor) -> Scalar | None:
    """Return the nominal exposure time divided by the time during which light is collected; None if
    both are equal."""
    if not isinstance(sensor.light_offset, ShutterOffset):
        return None
    assert sensor.exposure_time is not None
    return sensor.exposure_time / (sensor.exposure_time + sensor.light_offset.time)


def _charge(sensor: Sensor, raw: Counts, dark: Master | None) -> Counts:
    """Return the electrons that each pixel collected from light and dark current: nonlinearity,
    mixing, charge transfer and the brighter-fatter effect are undone."""
    signal = _signal(sensor, raw, dark)
    charge = signal
    if sensor.nonlinearity is not None:
        charge = charge_of_signal(sensor.nonlinearity, signal)
    if sensor.mixing is not None:
        charge = convolve(charge, _inverse(sensor.mixing.kernel.astype(charge.dtype)))
    if sensor.charge_transfer is not None:
        charge = 2 * charge - transferred(charge, sensor.charge_transfer)
    if sensor.brighter_fatter is not None:
        there = jnp.maximum(charge, 0)
        moved = gathered(None, there, sensor.brighter_fatter, full_well=sensor.full_well)
        charge = charge - (moved - there)
    return charge


def _signal(sensor: Sensor, raw: Counts, dark: Master | None) -> Counts:
    """Return the signal of each pixel, in electrons, from raw numbers, black level and gain. The
    nonlinearity is not yet undone."""
    gain = total_gain(sensor, shape=raw.shape, dtype=raw.dtype)
    if dark is not None:
        above = raw - _broadcast(dark.mean.astype(raw.dtype), raw)
        above = above if gain is None else above / gain
        if sensor.dark_current is None:
            return above
        held = mean_dark(sensor, raw)
        curve = sensor.nonlinearity
        return above + (held if curve is None else signal_of_charge(curve, held))
    above = raw if sensor.offset is None else raw - sensor.offset
    if sensor.taps is not None and sensor.taps.offset is not None:
        above = above - tap_map(sensor.taps.offset, sensor.taps, shape=raw.shape, dtype=raw.dtype)
    return above if gain is None else above / gain


def _response(flat: Counts) -> Counts:
    """Return the sensitivity of each pixel relative to the mean pixel, from the flat."""
    return flat / jnp.mean(flat, (-3, -2), keepdims=True)


def _flat(sensor: Sensor, masters: Masters, raw: Counts) -> Counts | None:
    """Return the photoelectrons in the flat master, or None without a flat."""
    if masters.flat is None:
        return None
    flat = _broadcast(masters.flat.mean.astype(raw.dtype), raw)
    return _subtract_dark(sensor, _charge(sensor, flat, masters.dark))


def _fill_masters(masters: Masters, defects: Bool[Array, "h w"]) -> Masters:
    """Replace the defects of the dark and flat masters by means of their neighbours."""

    def fill_master(master: Master | None) -> Master | None:
        return master and replace(master, mean=_fill(master.mean, defects))

    return replace(masters, dark=fill_master(masters.dark), flat=fill_master(masters.flat))


def _fill(raw: Counts, defects: Bool[Array, "h w"]) -> Counts:
    """Replace each defect by the mean of the usable pixels in the 5 x 5 pixels around it, or by the
    mean of the frame if there are none."""
    good = jnp.broadcast_to(~_broadcast(defects[..., None], raw), raw.shape)
    around = jnp.ones((5, 5), raw.dtype)
    count = convolve(good.astype(raw.dtype), around)
    mean = convolve(jnp.where(good, raw, 0), around) / jnp.maximum(count, 1)
    whole = jnp.mean(raw, (-3, -2), keepdims=True, where=good)
    return jnp.where(good, raw, jnp.where(count > 0.5, mean, whole))


def _parts(sensor: Sensor, raw: Counts, masters: Masters, expected: Counts | None) -> list[Part]:
    """Return all parts of the error, in electrons, except those due to the uncertainty of the
    camera's parameters."""
    of = {"shape": raw.shape, "dtype": raw.dtype}
    flat = _flat(sensor, masters, raw)
    response = None if flat is None else _response(flat)
    if expected is None:
        charge = jnp.maximum(_charge(sensor, raw, masters.dark), 0)
    else:
        light = jnp.broadcast_to(expected, raw.shape).astype(raw.dtype)
        stated, beside = _shutter(sensor), _light_offset(sensor, raw)
        light = light if stated is None else light / stated
        light = light if beside is None else light + beside
        light = light if sensor.smear is None else smeared(light, sensor.smear)
        light = light if sensor.crosstalk is None else drifted(light, sensor.crosstalk)
        charge = _times(light, response)
        charge = charge if sensor.dark_current is None else charge + mean_dark(sensor, raw)
    light = _subtract_dark(sensor, charge)  # photoelectrons of this pixel, not of the mean pixel
    apart = None if sensor.crosstalk is None else _inverse(_cross(sensor.crosstalk))
    unmixed = None if sensor.mixing is None else _inverse(sensor.mixing.kernel.astype(raw.dtype))
    behind = _combine_kernels(unmixed, apart)  # for noise that is added after the mixing
    slope = None if sensor.nonlinearity is None else 1 / _slope(sensor, charge)
    gain = total_gain(sensor, **of)
    parts: list[Part] = []

    def add(name: str, size: Scalars, kernel: Kernel | None, **how: Any) -> None:
        size = size if response is None else size / response
        size = jnp.broadcast_to(size, raw.shape).astype(raw.dtype)
        parts.append(Part(name, size, kernel, **how))

    if sensor.shot_noise is not None:
        add("shot noise", jnp.sqrt(charge), apart)
    lines = {
        "row noise": (_square(sensor.row_noise) + _banding(sensor), "rows"),
        "column noise": (_square(sensor.column_noise), "columns"),
        "frame noise": (_square(sensor.frame_noise), "frame"),
    }
    alone = replace(sensor, row_noise=None, column_noise=None, frame_noise=None, banding=None)
    read = read_out_variance(alone, **of)
    if sensor.bits is not None:
        read = read + QUANTISATION_VARIANCE / (1.0 if gain is None else gain**2)
    add("read noise", _times(jnp.sqrt(read), slope), behind)
    for name, (variance, along) in lines.items():
        if not isinstance(variance, float):
            add(name, _times(jnp.sqrt(variance), slope), behind, along=along)
    if masters.dark is not None:
        if sensor.colour_filter is None:
            own = signal_variance(replace(sensor, light_offset=None), jnp.zeros_like(raw))
            own = own if gain is None else own / gain**2
        else:
            own = read if sensor.dark_current is None else read + mean_dark(sensor, raw)
        add("dark", _times(jnp.sqrt(own / masters.dark.frames), slope), behind, lasts=True)
    else:
        for name, along in (("dsnu", "pixels"), ("column_dsnu", "columns"), ("row_dsnu", "rows")):
            if getattr(sensor, name) is not None:
                size = _times(getattr(sensor, name), slope)
                add(name, size, behind, along=along, lasts=True)
    if masters.flat is not None and flat is not None:
        held = flat if sensor.dark_current is None else flat + mean_dark(sensor, flat)
        noise = read if sensor.nonlinearity is None else read / _slope(sensor, held) ** 2
        if sensor.shot_noise is not None:
            noise = noise + held - jnp.minimum(flat, 0)
        add("flat", light * jnp.sqrt(noise / masters.flat.frames) / flat, apart, lasts=True)
        return parts
    if sensor.prnu is not None:
        add("prnu", factored(sensor.prnu, sensor.taps, "prnu", **of) * light, apart, lasts=True)
    if sensor.conversion_prnu is not None:
        add("conversion_prnu", sensor.conversion_prnu * charge, behind, lasts=True)
    if sensor.column_prnu is not None:
        add("column_prnu", sensor.column_prnu * charge, behind, along="columns", lasts=True)
    return parts


def _square(rms: Scalar | None) -> Scalar | float:
    return 0.0 if rms is None else rms**2


def _banding(sensor: Sensor) -> Scalar | float:
    return 0.0 if sensor.banding is None else sensor.banding.amplitude**2 / 2


def _slope(sensor: Sensor, charge: Counts) -> Counts:
    """Return the derivative of the signal with respect to the charge."""
    curve = sensor.nonlinearity
    assert curve is not None
    one = jnp.ones_like(charge)
    return jax.jvp(lambda x: signal_of_charge(curve, x), (charge,), (one,))[1]


def _camera_parts(sensor: Sensor, draws: Sensor, image: Callable[[Sensor], Counts]) -> list[Part]:
    """Return the parts of an image's error due to the uncertainty of the camera: its change by one
    standard deviation along each principal axis of the posterior draws."""
    leaves, tree = jax.tree.flatten(sensor)
    drawn = [np.asarray(x, float) for x in jax.tree.leaves(draws)]
    if jax.tree.structure(draws) != tree or any(
        d.shape[1:] != np.shape(x) for d, x in zip(drawn, leaves, strict=True)
    ):
        raise ValueError("draws must be of the same kind of sensor, with one leading axis.")
    table = np.concatenate([x.reshape(len(x), -1) for x in drawn], axis=1)
    centred = table - table.mean(0)
    scale = centred.std(0)
    varies = scale > 1e-12 * np.abs(table).max(0)
    _, sizes, axes = np.linalg.svd(centred[:, varies] / scale[varies], full_matrices=False)
    splits = np.cumsum([np.size(x) for x in leaves])[:-1]
    parts = []
    for i, (size, axis) in enumerate(zip(sizes, axes, strict=True)):
        if size <= 1e-6 * sizes[0]:
            continue
        step = np.zeros(table.shape[1])
        step[varies] = size / np.sqrt(len(table) - 1) * axis * scale[varies]
        steps = (
            jnp.asarray(part.reshape(np.shape(x)), jnp.asarray(x).dtype)
            for part, x in zip(np.split(step, splits), leaves, strict=True)
        )
        moved = jax.jvp(image, (sensor,), (jax.tree.unflatten(tree, list(steps)),))[1]
        parts.append(Part(f"camera {i}", moved, along="all", lasts=True))
    return parts


def _scale(sensor: Sensor, unit: str, raw: Counts, masters: Masters) -> Scalars | None:
    """Return the factor that converts photoelectrons to `unit`; None for a factor of 1."""
    if unit == "electrons":
        return None
    several = sensor.quantum_efficiency is not None and sensor.quantum_efficiency.ndim > 0
    conversion = sensor.photon_conversion
    if sensor.colour_filter is not None or sensor.infrared_cut is not None or several:
        raise ValueError(f"correct: {unit} of several bands are not known; ask for electrons.")
    per_photon = jnp.ones((), raw.dtype)
    if sensor.quantum_efficiency is not None:
        per_photon = per_photon * sensor.quantum_efficiency
    of = {"shape": raw.shape, "dtype": raw.dtype}
    per_photon = factored(per_photon, sensor.taps, "quantum_efficiency", **of)
    if masters.flat is not None:  # the flat has equalised the taps
        per_photon = jnp.mean(per_photon)
    if sensor.pixel_aperture is not None:
        per_photon = per_photon * light_share(sensor.pixel_aperture)
    if unit == "photons":
        return 1 / per_photon
    if conversion is None or sensor.exposure_time is None or conversion.wavelength.ndim > 0:
        raise ValueError(
            "correct: irradiance needs Sensor.photon_conversion of one wavelength and "
            "Sensor.exposure_time; give them, or ask for electrons."
        )
    per_joule = conversion.wavelength / (PLANCK * SPEED_OF_LIGHT)
    return 1 / (per_photon * per_joule * conversion.pixel_area * sensor.exposure_time)


def _cross(share: Scalar) -> Kernel:
    """Return the 3 x 3 kernel of crosstalk, given the share that drifts to each neighbour."""
    around = jnp.asarray([[0, 1, 0], [1, 0, 1], [0, 1, 0]], share.dtype)
    middle = jnp.asarray([[0, 0, 0], [0, 1, 0], [0, 0, 0]], share.dtype)
    return share * around + (1 - 4 * share) * middle


def _inverse(kernel: Kernel) -> Float[Array, "height width"]:
    """Return the kernel whose convolution inverts that of another kernel, truncated at 8 pixels."""
    rows, columns = kernel.shape
    wide = jnp.zeros((_PERIOD, _PERIOD), kernel.dtype).at[:rows, :columns].set(kernel)
    wide = jnp.roll(wide, (-(rows // 2), -(columns // 2)), (0, 1))
    undone = jnp.fft.irfft2(1 / jnp.fft.rfft2(wide), wide.shape)
    size = 2 * _REACH + 1
    return jnp.roll(undone, (_REACH, _REACH), (0, 1))[:size, :size].astype(kernel.dtype)
