"""Spectrograms of an average frame (clause 8.6).

Each of the M rows, of N pixels, is transformed by a discrete Fourier transform divided by sqrt(N).
The horizontal spectrogram is the squared magnitude, averaged over the rows. For independent pixels
of spatial variance s^2 and temporal variance sigma^2 in L frames, the expectation of the
spectrogram is s^2 + sigma^2 / L at every frequency. In units of its expectation, the spectrogram at
a frequency is distributed as the mean of M chi-square variables with two degrees of freedom,
divided by 2.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri

BAND = (0.975, 0.025)


class Spectrogram(NamedTuple):
    """The power spectrum of an image along one direction."""

    cycles: Float[np.ndarray, " frequencies"]  # frequency, cycles per pixel, 0 to 1/2
    power: Float[np.ndarray, " frequencies"]  # power at each frequency, DN^2
    # median power, DN^2, as an estimate of the power of noise that is independent between pixels
    white: float
    # (low, high) limits of the power of independent noise, 95 % at each frequency
    band: tuple[float, float]


def spectrogram(image: Float[np.ndarray, "h w"], axis: int) -> Spectrogram:
    """Compute the power spectrum along `axis` of an image, averaged over the other axis."""
    length = image.shape[axis]
    transform = np.fft.rfft(image - image.mean(), axis=axis) / np.sqrt(length)
    power = np.mean(np.abs(transform) ** 2, axis=1 - axis)
    degrees = 2 * image.shape[1 - axis]
    white = float(np.median(power[1:]))
    low, high = (white * float(chdtri(degrees, q)) / degrees for q in BAND)
    return Spectrogram(np.arange(len(power)) / length, power, white, (low, high))
