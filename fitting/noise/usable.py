"""Checks that refuse a measurement from which no gain can be determined."""

from pathlib import Path

import jax
import numpy as np
from scipy.stats import rankdata

from jaxvision.errors import InputError

from .emva1288 import least_dark_variance
from .levels import PhotonTransfer, linear_levels, shot_of, signal_of
from .raw_frames import tone_curve
from .regressions import least_squares

FEWEST_LEVELS = 4  # levels of light below saturation for a line, its error and its misfit
MOST_PHOTONS = 1e15  # a full well of 1e7 electrons at a quantum efficiency of 1e-8
# Standard errors by which the variance of a level must exceed that of its darks
SIGNIFICANCE_SIGMAS = 3.0
FALLING = -0.8  # rank correlation of light and signal of levels in the reverse order
UNEVEN_EFFICIENCY = 0.1  # rms of the logarithm of signal over light that no camera has
EVEN_SHARE = 0.1  # of it, that remains if the light is stated per second
FEWEST_FOR_BLACK = 6  # levels needed to estimate the flats' black level by a parabola
SURE_OF_BLACK = 6.0  # standard errors by which this black level must differ from the darks
MOST_OFF_BLACK = 0.1  # of the least signal: the change of the gain by a smaller difference


def check(file: Path, measurement: PhotonTransfer) -> None:
    """Raise InputError if no gain can be determined from a measurement, for example because it has
    no visible shot noise. `file` names the source of the measurement in the message."""
    try:
        _check(file, jax.tree.map(np.asarray, measurement))
    except InputError as error:
        left_out = (*measurement.bright.left_out, *measurement.dark.left_out)
        raise InputError(" ".join([str(error), *left_out[:3]])) from None


def _check(file: Path, measurement: PhotonTransfer) -> None:
    bright, dark = measurement.bright, measurement.dark
    for name, levels in (("flat", bright), ("dark", dark)):
        if bool(np.any(levels.exposure < 0)):
            raise InputError(f"{file}: a {name} has a negative exposure; give it in seconds.")
        if bool(np.any(levels.frames < 2)):
            raise InputError(f"{file}: a {name} level has one frame; a variance needs two or more.")
        if bool(np.any(levels.variance < 0)):
            raise InputError(f"{file}: a {name} level has a negative variance; check its column.")
    if not bool(np.any(bright.exposure > 0)):
        raise InputError(f"{file}: no flat has a positive exposure; give it in seconds.")
    if bool(np.any(bright.light < 0)):
        raise InputError(f"{file}: a flat has negative light; correct its photons.")
    if measurement.photons_known and float(bright.light.max()) > MOST_PHOTONS:
        raise InputError(
            f"{file}: a flat has {float(bright.light.max()):.3g} photons per pixel, more than any "
            f"pixel can hold; correct the unit (at most {MOST_PHOTONS:g})."
        )
    lights, times = (np.unique(np.asarray(x)).size for x in (bright.light, bright.exposure))
    if lights < FEWEST_LEVELS:
        if measurement.photons_known and times >= FEWEST_LEVELS:
            raise InputError(
                f"{file}: the flats have {times} exposures, but {lights} different photons; these "
                "are photons per pixel and exposure, so multiply a rate per second by the exposure."
            )
        raise InputError(
            f"{file}: the flats have too few different levels of light; at least {FEWEST_LEVELS} "
            "are needed, so vary the exposure or the light."
        )
    if measurement.photons_known and float(bright.light.max()) <= 0:
        raise InputError(f"{file}: no flat has any photons; give the light of each level.")
    exponent = tone_curve(measurement)
    if exponent is not None:
        raise InputError(
            f"{file}: the signal grows as the light to the power of {exponent:.2g}, and its noise "
            "does not grow with it, as after a tone curve (gamma, sRGB). No gain follows from such "
            "frames; give raw, linear ones."
        )
    if bool(np.all(dark.variance == 0)):
        raise InputError(
            f"{file}: no dark varies from frame to frame (mean {float(dark.mean.max()):g} DN), so "
            "black is clipped, the frames are copies, or compression (JPEG) removed their noise; "
            "raise the camera's black level and give independent raw frames."
        )
    if bool(np.all(bright.variance == 0)):
        raise InputError(
            f"{file}: no flat varies from frame to frame, so all are saturated or copies of one; "
            "give independent frames at lower light."
        )
    signal = signal_of(measurement)
    if signal.max() < 0 and -signal.max() > 3 * float(np.sqrt(bright.variance.max())):
        raise InputError(
            f"{file}: every flat is darker than its darks (by {-signal.max():.4g} DN and more), as "
            "if flats and darks are exchanged or the numbers are inverted; correct that."
        )
    if signal.max() < 3 * float(np.sqrt(dark.variance.max() / bright.pixels)):
        raise InputError(f"{file}: the flats are as dark as the darks; give more light.")
    ranks = rankdata(np.asarray(bright.light)), rankdata(signal)
    if np.corrcoef(*ranks)[0, 1] < FALLING:
        kind = "photons" if measurement.photons_known else "exposures"
        raise InputError(
            f"{file}: the signal falls from {signal[0]:.4g} to {signal[-1]:.4g} DN above black as "
            f"the stated light rises: the {kind} of the levels are in the reverse order, or the "
            "numbers are inverted."
        )
    of_dark = dark.variance_error[measurement.dark_of]
    if (
        np.max(shot_of(measurement) / np.hypot(bright.variance_error, of_dark))
        < SIGNIFICANCE_SIGMAS
    ):
        raise InputError(
            f"{file}: the flats vary no more from frame to frame than the darks do. The gain needs "
            "visible shot noise; give raw frames, neither averaged, smoothed nor compressed, and "
            "more light."
        )
    brightest = float(bright.mean.max()) / min(measurement.converter.step or 1.0, 1.0)
    quiet = float(np.median(dark.variance)) < least_dark_variance(measurement)
    if (measurement.full_scale or 0) > 255 and brightest <= 255 and quiet:
        raise InputError(
            f"{file}: no flat exceeds 255 DN, and the darks hardly vary, as in 8-bit data; correct "
            "camera.bits, or give more light."
        )
    usable = linear_levels(measurement)
    if len(usable) < FEWEST_LEVELS:
        raise InputError(
            f"{file}: {len(usable)} levels of light lie below 95 % of saturation; at least "
            f"{FEWEST_LEVELS} are needed, so add flats at lower light."
        )
    _refuse_light_per_second(file, measurement, usable)
    _refuse_other_black(file, measurement, usable)


def _refuse_light_per_second(file: Path, measurement: PhotonTransfer, usable: np.ndarray) -> None:
    """Refuse photons per second: the signal follows photons times exposure."""
    bright = measurement.bright
    light, exposure = (np.asarray(x)[usable] for x in (bright.light, bright.exposure))
    signal = signal_of(measurement)[usable]
    if not measurement.photons_known or min(light.min(), exposure.min(), signal.min()) <= 0:
        return
    of_each, of_second = (float(np.std(np.log(signal / x))) for x in (light, light * exposure))
    if of_each > UNEVEN_EFFICIENCY and of_second < EVEN_SHARE * of_each:
        raise InputError(
            f"{file}: the signal follows the stated photons times the exposure, to "
            f"{100 * of_second:.2g} % rms, and not the photons ({100 * of_each:.2g} %), so they "
            "are stated per second; give photons per pixel and exposure: multiply them by the "
            "exposure."
        )


def _refuse_other_black(file: Path, measurement: PhotonTransfer, usable: np.ndarray) -> None:
    """Refuse darks of another black level than that to which the flats extrapolate."""
    bright, dark = measurement.bright, measurement.dark
    levels = usable[np.asarray(bright.light)[usable] > 0]
    if len(levels) < FEWEST_FOR_BLACK:
        return
    mean, variance, light, errors = (
        np.asarray(x)[levels]
        for x in (bright.mean, bright.variance, bright.light, bright.variance_error)
    )
    there = np.asarray(measurement.dark_of)[levels]
    black, noise = float(np.mean(dark.mean[there])), float(np.mean(dark.variance[there]))
    of_variance = least_squares((1.0, mean, mean**2), variance - noise, errors=errors)
    of_light = least_squares((1.0, light, light**2), mean, errors=np.sqrt(variance))
    slope, by_light = of_variance.values[1], of_light.values[0]
    by_variance = -of_variance.values[0] / slope
    error = np.hypot(of_variance.errors[0], noise) / abs(slope)
    off = np.array([by_variance, by_light]) - black
    signal = float(mean.min() - by_variance)
    sure = np.all(np.abs(off) > SURE_OF_BLACK * np.array([error, of_light.errors[0]]))
    alike = abs(off[0] - off[1]) < 0.5 * np.abs(off).min()
    if sure and alike and np.abs(off).min() > MOST_OFF_BLACK * abs(signal):
        raise InputError(
            f"{file}: extrapolated to no light, the flats have {by_variance:.4g} DN by their "
            f"variance and {by_light:.4g} DN by their light, but the darks have {black:.4g} DN; "
            "give flats and darks with the same offset, without any subtraction."
        )
