"""The saturation point of release 4 (clause 6.6): the light at which .1 to .2 % of the numbers are
at the end of the scale.

The light at which the share is .15 % lies between two levels. If both levels have some numbers at
the end of the scale and some below, the normal deviate of the share, which is about linear in the
light, is interpolated. If the levels are too far apart for an interpolation, the distribution of
the numbers is assumed Gaussian. The mean and standard deviation of the two lower levels are
extrapolated to the light at which .15 % of the numbers exceed the end of the scale. The standard
error allows for any share between .1 and .2 %. For an interpolation, the standard error also
includes the error of the counts. For an extrapolation, it includes a tenth of the distance from the
mean to the end of the scale, because the tails may not be Gaussian.

If no level reaches this share (because the full well comes first, or a table has no pixels), the
saturation point is at the largest variance, as in release 3.1.
"""

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.special import ndtri

from .. import emva1288
from ..emva1288 import Ranges
from ..levels import PhotonTransfer, signal_of

SHARES = np.array([0.001, 0.0015, 0.002])
FEWEST = 10  # numbers at the end, and below, for an interpolation
TAILS = 0.1  # share of the distance from the mean to the end
WIDTH_OF_ERROR = float(np.sqrt(24))  # `Ranges.saturation_width` is the base of a triangle


@dataclass(frozen=True)
class Numbers:
    """The share of clipped numbers at each bright level, and their standard deviation."""

    # share of the values at the end of the scale; 0 where that end is unknown
    at_top: Float[np.ndarray, " levels"]
    spread: Float[np.ndarray, " levels"]  # standard deviation over pixels and frames, DN


def ranges(measurement: PhotonTransfer, numbers: Numbers | None) -> tuple[Ranges, bool]:
    """Return the levels of each figure, and whether clipped numbers show the saturation."""
    within = emva1288.ranges(measurement)
    if numbers is None or measurement.full_scale is None:
        return within, False
    beyond = np.flatnonzero(numbers.at_top > SHARES[1])
    if not beyond.size or beyond[0] < 2:
        return within, False
    above = int(beyond[0])
    bright = measurement.bright
    lights, mean = np.asarray(bright.light), np.asarray(bright.mean)
    pair = slice(above - 1, above + 1)
    count = float(bright.pixels) * np.asarray(bright.frames)[pair]
    share = numbers.at_top[pair]
    if np.all((share * count >= FEWEST) & ((1 - share) * count >= FEWEST)):
        light, error = _interpolate(lights[pair], share, count)
    else:
        end = measurement.full_scale - measurement.converter.step / 2
        light, error = _gaussian_saturation(lights, mean, numbers.spread, end, above)
    place = (light - lights[above - 1]) / max(lights[above] - lights[above - 1], 1e-300)
    signal = signal_of(measurement)
    top = signal[above - 1] + place * (signal[above] - signal[above - 1])
    sensitivity, linearity = emva1288.used_levels(signal, above, top)
    found = replace(
        within,
        sensitivity=sensitivity,
        linearity=linearity,
        saturation=jnp.asarray(float(light)),
        saturation_width=jnp.asarray(WIDTH_OF_ERROR * float(error)),
    )
    return found, True


def _interpolate(lights: np.ndarray, share: np.ndarray, count: np.ndarray) -> tuple[float, float]:
    """Interpolate the saturation light, and its error, between two partly clipped levels."""
    deviates = ndtri(share)
    slope = (lights[1] - lights[0]) / (deviates[1] - deviates[0])
    low, light, high = lights[0] + slope * (ndtri(SHARES) - deviates[0])
    density = np.exp(-(deviates**2) / 2) / np.sqrt(2 * np.pi)
    place = (light - lights[0]) / (lights[1] - lights[0])
    by_counts = np.sqrt(share * (1 - share) / count) / density * (1 - place, place)
    return float(light), float(np.hypot((high - low) / np.sqrt(12), slope * np.hypot(*by_counts)))


def _gaussian_saturation(
    lights: np.ndarray, mean: np.ndarray, spread: np.ndarray, end: float, above: int
) -> tuple[float, float]:
    """Extrapolate the saturation light, and its error, from two levels below."""
    one, two = above - 2, above - 1
    apart = lights[two] - lights[one]
    rate, growth = (mean[two] - mean[one]) / apart, (spread[two] - spread[one]) / apart
    deviates = -ndtri(SHARES)
    steps = (end - mean[two] - deviates * spread[two]) / (rate + deviates * growth)
    low, light, high = np.clip(lights[two] + steps, lights[two], lights[above])
    tails = TAILS * deviates[1] * (spread[two] + growth * (light - lights[two])) / rate
    return float(light), float(np.hypot((high - low) / np.sqrt(12), tails))
