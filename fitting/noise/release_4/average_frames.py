"""Spectrograms of average frames (clause 8.6), histograms of the deviations of their pixels from
the mean (clause 8.8), and counts of outliers.

In a spectrogram, each of the M rows, of N pixels, is transformed by a discrete Fourier transform
divided by sqrt(N). The horizontal spectrogram is the squared magnitude, averaged over the rows. For
independent pixels of spatial variance s^2 and temporal variance sigma^2 in L frames, the
expectation of the spectrogram is s^2 + sigma^2 / L at every frequency. In units of its expectation,
the spectrogram at a frequency is distributed as the mean of M chi-square variables with two degrees
of freedom, divided by 2.

In a histogram, the width of a class is a multiple of 1 / L DN, the step between the values of an
average over L frames:

    I = floor(L (y_max - y_min) / 256) + 1,    Q = floor(L (y_max - y_min) / I) + 1      (73)
    q = floor(L (y - y_min) / I)                                                        (74)
    y[q] = y_min + (I - 1) / (2 L) + q I / L                                            (75)

Here y are the pixels of the average, and y_max and y_min their extremes. I is the width of a class
in units of 1 / L, Q is the number of classes, and q is the class of a pixel, with the centre y[q].
The accumulated histogram gives, for each deviation, the share of pixels that deviate at least that
much (77).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.special import betaincinv, chdtri, erfc

BAND = (0.975, 0.025)  # of a spectrogram
CLASSES = 256
ROUNDING = 1e-9  # tolerance, in classes, for an average that is a multiple of 1 / L


class Histogram(NamedTuple):
    """The histogram and the accumulated histogram of the pixels' deviations from their mean.

    Attributes:
        centres: (classes,) centre of each class minus the mean, in the unit of the image.
        counts: (classes,) number of pixels.
        gaussian: (classes,) expected number of pixels for a Gaussian of the same standard
            deviation.
        deviations: (257,) absolute deviations from the mean.
        share: (257,) per cent of pixels that deviate at least that far.
    """

    centres: Float[np.ndarray, " classes"]
    counts: Int[np.ndarray, " classes"]
    gaussian: Float[np.ndarray, " classes"]
    deviations: Float[np.ndarray, " deviations"]
    share: Float[np.ndarray, " deviations"]


class Outliers(NamedTuple):
    """The number of pixels beyond a number of standard deviations."""

    beyond: float  # threshold, in standard deviations
    pixels: int  # number of pixels beyond the threshold
    # (low, high) ends of the 95 % interval of the share of such pixels in the population (Clopper
    # and Pearson 1934)
    interval: tuple[float, float]
    expected: float  # share of a Gaussian distribution beyond the threshold


def histogram(image: Float[np.ndarray, "h w"], steps: float) -> Histogram:
    """Compute the standard's two histograms of an average frame.

    Args:
        image: average frame, with or without the high-pass filter.
        steps: number of grid steps of the average per unit of the image: the number L of frames for
            an image in DN.

    Returns:
        Both histograms.
    """
    low, spread, mean = image.min(), np.ptp(image), image.mean()
    width = int(steps * spread / CLASSES + ROUNDING) + 1
    classes = int(steps * spread / width + ROUNDING) + 1
    place = (steps * (image - low) / width + ROUNDING).astype(int).ravel()
    counts = np.bincount(np.minimum(place, classes - 1), minlength=classes)
    centres = low - mean + (width - 1) / (2 * steps) + np.arange(classes) * width / steps
    sd = max(float(image.std()), np.finfo(float).tiny)
    gaussian = np.exp(-((centres / sd) ** 2) / 2) / np.sqrt(2 * np.pi) / sd
    away = np.sort(np.abs(image - mean).ravel())
    deviations = np.linspace(0, away[-1], CLASSES + 1)
    beyond = away.size - np.searchsorted(away, deviations, side="left")
    return Histogram(
        centres,
        counts,
        gaussian * image.size * width / steps,
        deviations,
        100 * beyond / away.size,
    )


def outliers(image: Float[np.ndarray, "h w"]) -> tuple[Outliers, ...]:
    """Count the pixels beyond 3, 4 and 5 robust standard deviations from the median."""
    away = np.abs(image - np.median(image)).ravel()
    sd = float(np.quantile(away, 0.6827))
    found = []
    for beyond in (3.0, 4.0, 5.0):
        count = int(np.sum(away > beyond * sd))
        low = float(betaincinv(count, away.size - count + 1, 0.025)) if count else 0.0
        high = float(betaincinv(count + 1, away.size - count, 0.975)) if count < away.size else 1.0
        found.append(Outliers(beyond, count, (low, high), float(erfc(beyond / np.sqrt(2)))))
    return tuple(found)


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
