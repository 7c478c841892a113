"""Bound the change if a sensor effect between light and electrons is dropped; each effect has one
function.

The argument of each function is the sensor without the effects that were dropped before. Each
function returns a bound, in DN, on the distance of distributions defined in `pixel`.
"""

import math
from dataclasses import replace

import numpy as np

from ..scene import Sensor
from .electrons import share_of_light
from .overflow import sensitivity_bias
from .pixel import INF, Bound, Pixel, growth, unbounded
from .stages import Ends, field_functions

photon_conversion = unbounded("converts W m^-2 to photons: nothing can be left out")
colour_filter = unbounded("defines which bands a pixel measures")
exposure_time = unbounded("scales all charge: nothing can be left out")


def light_offset(pixel: Pixel) -> Bound:
    """Bound the effect of an offset of the light by the light that it adds or subtracts."""
    beside = pixel.offset_charge * pixel.smear_factor * pixel.push_factor
    return Bound(
        pixel.distribution_change(beside, patterned=True),
        f"{pixel.offset_charge:.3g} e- besides the light",
    )


def infrared_cut(pixel: Pixel) -> Bound:
    """Bound the infrared filter by the light that it removes, (1 - transmission)."""
    least = np.asarray(pixel.sensor.low["infrared_cut"], float)
    return _attenuator(pixel, "infrared_cut", least, "what the filter absorbs")


def quantum_efficiency(pixel: Pixel) -> Bound:
    """Bound the effect of the quantum efficiency by the photons that free no electron, the share |1
    - efficiency| in each band and tap (an efficiency may exceed 1)."""
    ends = (np.asarray(end["quantum_efficiency"], float) for end in pixel.sensor)
    least = 1 - np.maximum(*(np.abs(1 - efficiency) for efficiency in ends))
    return _attenuator(pixel, "quantum_efficiency", least, "photons that free no electron")


def pixel_aperture(pixel: Pixel) -> Bound:
    """Bound the effect of the pixel aperture by the light outside the active area. The bound is inf
    if the aperture is sampled more than once, because a displaced edge in the picture may change a
    pixel by any amount."""
    low = pixel.sensor.low["pixel_aperture"]
    if low.oversampling > 1:
        return Bound(INF, f"light is sampled {low.oversampling} times along each side")
    return _attenuator(pixel, "pixel_aperture", share_of_light(low), "light beside the active area")


def crosstalk(pixel: Pixel) -> Bound:
    """Bound the effect of crosstalk, a share c of the charge to each neighbour, by 4 c m with the
    largest mean m: a dark pixel among bright pixels gains this charge, and a bright pixel among
    dark pixels loses it."""
    share = 4 * pixel.high("crosstalk")
    why = f"{share:.3g} of the brightest charge drifts"
    return Bound(pixel.distribution_change(share * pixel.light, patterned=True), why)


def smear(pixel: Pixel) -> Bound:
    """Bound the effect of smear s by s (rows - 1) m: the charge that a dark pixel collects in a
    column of otherwise bright pixels of mean charge m."""
    share = pixel.high("smear") * (pixel.shape[0] - 1)
    gathered = share * pixel.light / pixel.smear_factor
    why = f"{share:.3g} of the brightest charge, gathered along its column"
    return Bound(pixel.distribution_change(gathered, patterned=True), why)


def prnu(pixel: Pixel) -> Bound:
    """Bound the effect of a PRNU p by sqrt(V + m + p^2 m^2) - sqrt(V + m), which is largest at the
    largest mean m.

    The shot noise of the light, of variance m, hides a part of the pattern. V is the variance of
    the noise that is added later; V is 0 in the bound if a full well may be reached. Sensitivities
    are clipped at 0, which also changes the mean.
    """
    rms, light = pixel.high("prnu"), pixel.light
    if not math.isfinite(light):
        return Bound(INF, "the light is not bounded")
    most_quiet, cut = pixel.clip_at_well(rms * light)
    before = pixel.quiet if math.isinf(most_quiet) else 0.0
    before += light if pixel.counted and pixel.repulsion == 0 else 0.0
    noise = growth(before, (rms * light) ** 2)
    moved = math.hypot(noise, light * sensitivity_bias(rms)) + cut
    return Bound(pixel.read(moved), f"{rms:.3g} of {light:.4g} e-")


def dead_pixels(pixel: Pixel) -> Bound:
    """Bound dead pixels by all their light, which affects the pixels within their `reach`."""
    rare = pixel.high("dead_pixels") * math.prod(pixel.shape) * pixel.reach
    why = f"{rare:.3g} pixels are dead; the bound is for these"
    return Bound(pixel.distribution_change(pixel.light, patterned=True), why, rare=rare)


def dark_current(pixel: Pixel) -> Bound:
    """Bound the effect of the dark current, of d electrons, and its noise. In the dark, where the
    noise has the variance V, the rms changes by sqrt(V) - sqrt(V - d)."""
    dark = pixel.dark
    rest = pixel.quiet - pixel.counted_dark
    most_quiet, cut = pixel.clip_at_well(dark)
    noise = growth(min(rest, most_quiet), dark) if pixel.counted else 0.0
    return Bound(pixel.read(math.hypot(dark, noise) + cut), f"{dark:.3g} e-")


def hot_pixels(pixel: Pixel) -> Bound:
    """Bound the effect of hot pixels with an exponential excess of mean H. The excess changes the
    mean by H and the variance by H^2. Shot noise of the excess changes the variance by another H.
    """
    fraction = float(pixel.sensor.high["hot_pixels"].fraction)
    rare = fraction * math.prod(pixel.shape) * pixel.reach
    hot = pixel.hot
    most_quiet, cut = pixel.clip_at_well(hot)
    noise = growth(min(pixel.quiet, most_quiet), hot**2 + (hot if pixel.counted else 0.0))
    why = f"{rare:.3g} pixels of {hot:.3g} e- more on average; the bound is for these"
    return Bound(pixel.read(math.hypot(hot, noise) + cut), why, rare=rare)


def _attenuator(pixel: Pixel, name: str, factor: float | np.ndarray, why: str) -> Bound:
    """Bound a filter, of a factor of at most 1 for each band, by the light that it removes."""
    ends = (dict(end, **{name: None}) for end in pixel.sensor)
    without = replace(pixel, sensor=Ends(*ends))
    # no bound is known if the light is inf, even if the factor is 1
    with np.errstate(invalid="ignore"):
        taken = replace(without, irradiance=pixel.irradiance * (1 - factor)).light
    return Bound(without.distribution_change(taken, patterned=True), why)


BOUNDS = field_functions(Sensor, globals())
