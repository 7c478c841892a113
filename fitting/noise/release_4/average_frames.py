"""Histograms of the deviations of pixels from the mean of an average frame (clause 8.8), and counts
of outliers.

The width of a class is a multiple of 1 / L DN, the step between the values of an average over L
frames:

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
from scipy.special import betaincinv, erfc

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
