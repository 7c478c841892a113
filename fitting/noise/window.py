"""The choice of light levels for which mean and variance after rounding and clipping at black are
computed exactly.

The usual moments count rounding as a variance of 1/12 and assume no clipping of black. For a normal
signal of standard deviation s rounded to whole numbers, the errors of mean and variance are at most

    sum_k exp(-2 pi^2 k^2 s^2) / (pi k),    4 sum_k (s^2 + 1 / (2 pi k)^2) exp(-2 pi^2 k^2 s^2)

(Widrow and Kollar, "Quantization Noise", 2008, chapter 4) for any position of the mean between two
codes. If black is clipped at a distance m below the mean, the mean is too large by a, and the
variance is too small by b + 2 m a + a^2. Here z = m / s, phi is the normal density and Q its tail
probability:

    a = s (phi(z) - z Q(z)),    b = s^2 ((1 + z^2) Q(z) - z phi(z)).

Errors from rounding and from clipping are systematic and the same in all frames. If both are too
small to matter (`negligible`), the usual moments are used.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy.special import ndtr

from ..inference.left_out import LeftOut, negligible
from .levels import PhotonTransfer
from .model import NoiseData, OffsetData
from .pattern import fitted_pattern, pattern_variance
from .quantised import WIDEST, WIDEST_CLIPPED, Window, window_for
from .regressions import sampling_variance
from .shared import drift
from .statement import noise_data

ROUNDING = 1 / 12  # variance of rounding to whole numbers
NAME = "exact rounding and clipping"
HARMONICS = np.arange(1, 9)
NEAR_BLACK = 4.5  # standard deviations above 0 DN within which clipping changes the moments
LARGEST_ROUNDING_VARIANCE = 0.25  # largest variance of a rounded signal, midway between two codes
AFFECTED_DEVIATION = 1.0  # codes; at larger noise, rounding always has a variance of 1/12


def usual_moments_error(
    mean: Float[np.ndarray, " levels"],
    variance: Float[np.ndarray, " levels"],
    frames: Float[np.ndarray, " levels"],
    pixels: float,
) -> LeftOut:
    """Return the largest errors of the usual moments of a rounded, clipped signal."""
    own = np.maximum(variance - ROUNDING, 0)
    decay = np.exp(-2 * np.pi**2 * HARMONICS**2 * own[:, None])
    of_mean = (decay / (np.pi * HARMONICS)).sum(1)
    of_variance = 4 * ((own[:, None] + 1 / (2 * np.pi * HARMONICS) ** 2) * decay).sum(1)
    total = np.maximum(variance, ROUNDING)
    deviation, above = np.sqrt(total), np.maximum(mean, 0)
    z = above / deviation
    tail, density = ndtr(-z), np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi)
    lost = deviation * np.maximum(density - z * tail, 0)
    squares = total * np.maximum((1 + z**2) * tail - z * density, 0)
    of_mean = of_mean + lost
    of_variance = of_variance + squares + 2 * above * lost + lost**2
    share = frames * of_mean**2 / total + (frames - 1) * of_variance**2 / (2 * total**2)
    return LeftOut(NAME, None, float(np.sqrt(pixels * share.sum())))


def _convert_to_codes(
    measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"]
) -> tuple[NoiseData, np.ndarray, np.ndarray]:
    """Return inputs of a fit, and means and variances of its levels in codes."""
    (data, rows), converter = noise_data(measurement, usable), measurement.converter
    mean, variance = np.asarray(rows)[:, :2].T
    return data, (mean - converter.lowest) / converter.step, variance / converter.step**2


def needed_window(
    measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"]
) -> tuple[Window | None, tuple[LeftOut, ...]]:
    """Return the weights for exact moments if they are needed, else None."""
    left_out = LeftOut(NAME, None, 0.0)
    if measurement.converter.step:
        data, mean, variance = _convert_to_codes(measurement, usable)
        frames, pixels = np.asarray(data.frames), float(data.pixels)
        left_out = usual_moments_error(mean, variance, frames, pixels)
    gone = negligible([left_out])
    return (None if gone else window_of(measurement, usable)), gone


def window_of(measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"]) -> Window:
    """Compute the weights for exact moments of darks and of levels that may need them."""
    data, mean, variance = _convert_to_codes(measurement, usable)
    lit, converter = np.asarray(data.lit), measurement.converter
    deviation, dark = np.sqrt(variance), lit == 0
    near_black = mean < NEAR_BLACK * deviation
    affected = near_black | (deviation < AFFECTED_DEVIATION) | dark
    # Clipping hides up to half of a standard deviation.
    widest = (2 if near_black[dark].any() else 1.2) * float(deviation[affected].max())
    # Midway between two codes, even vanishing noise gives a variance of 1 / 4.
    least = variance[dark].max() - ROUNDING
    read_noise = float(np.sqrt(least)) if least > LARGEST_ROUNDING_VARIANCE else 0.0
    levels = np.flatnonzero(affected)
    offsets = offset_data(measurement, usable)
    spread, known = 0.0, None
    if offsets is not None:
        spread = float(np.sqrt(np.max(np.asarray(offsets.spatial)))) / converter.step
        # Unequal gains and a drift of black shift pixels relative to the grid of codes, too.
        response, wander = fitted_pattern(measurement, usable).response, drift(measurement.dark)
        signal = converter.step * np.maximum(mean - mean[dark].min(), 0)
        known = lit * signal**2 * (response.variance if response.significant else 0.0)
        known = known + (wander.variance if wander.is_significant else 0.0)
        known = known[levels] / converter.step**2
    return window_for(
        levels,
        mean[levels],
        deviation=widest,
        read_noise=read_noise,
        spread=spread,
        known_spread=known,
        widest=WIDEST_CLIPPED if near_black[dark].any() else WIDEST,
    )


def offset_data(
    measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"]
) -> OffsetData | None:
    """Return the darks' spatial variances as data; None if unknown or insignificant."""
    dark = measurement.dark
    if dark.spatial_variance is None or measurement.bright.spatial_variance is None:
        return None
    offsets = fitted_pattern(measurement, usable).dark
    if not offsets.significant:
        return None
    spatial, noise = pattern_variance(dark)
    unlit = np.zeros(len(usable))
    return OffsetData(
        spatial=jnp.asarray(np.concatenate([unlit, spatial])),
        noise=jnp.asarray(np.concatenate([unlit, noise])),
        darks=jnp.asarray(float(len(spatial))),
        pixels=jnp.asarray(2 * offsets.variance**2 / sampling_variance(offsets.parts)),
    )
