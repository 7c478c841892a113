"""Rounding errors of JPEG's colour conversion, which all pixels of one hue share.

A JPEG picture contains integers Y, Cb and Cr. From these the decoder computes the colours by (ITU-T
T.871)

    R = Y + 1.402 Cr,   G = Y - 0.344136 Cb - 0.714136 Cr,   B = Y + 1.772 Cb,

where each product is rounded. In a scene of several hues, pixels with equal codes have different
rounding errors, which average out. In a scene of one hue, the rounding errors are equal in every
exposure and every part of the picture. The codes of that scene deviate from a smooth response by
half a code rms, and the scatter of pixels does not reveal this deviation. The variance of Cb and Cr
among pixels of equal code determines how much the rounding errors average out
(`weights.undithered_share`).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, UInt16

from .curve import ResponseCurve
from .weights import undithered_share

TO_YCC = np.array([[0.299, 0.587, 0.114], [-0.168736, -0.331264, 0.5], [0.5, -0.418688, -0.081312]])
OF_CHROMA = np.array([[0.0, 1.402], [-0.344136, -0.714136], [1.772, 0.0]])  # in R, G and B
COLOURS = ("red", "green", "blue")
DECODED = 0.9  # share of pixels that integer Y, Cb and Cr explain; a quarter by chance
FEWEST = 1000  # coloured pixels needed for a decision
MOST_PIXELS = 1 << 19  # pixels examined


def shared_rounding(
    codes: Sequence[UInt16[np.ndarray, "exposures h w"]], colour: str, clip: float
) -> Float[np.ndarray, "256"] | None:
    """Return the error that all pixels of a code share, DN rms; None if they were never JPEG."""
    if max(int(one.max()) for one in codes) > 255:
        return None
    every = max(1, codes[0].size // MOST_PIXELS)
    pixels = np.stack([one.ravel()[::every] for one in codes], axis=1).astype(float)
    ycc = pixels @ TO_YCC.T
    whole = np.rint(ycc)
    used = (pixels.min(axis=1) > 0) & (pixels.max(axis=1) < min(clip, 255))
    used &= np.any(whole[:, 1:] != 0, axis=1)
    if np.count_nonzero(used) < FEWEST:
        return None
    pixels, whole = pixels[used], whole[used]
    again = np.rint(whole[:, 1:] @ OF_CHROMA.T) + whole[:, :1]
    if np.mean(np.all(again == pixels, axis=1)) < DECODED:
        return None
    place = COLOURS.index(colour)
    own = pixels[:, place].astype(int)
    count = np.maximum(np.bincount(own, minlength=256), 1)
    variance = np.ones(256)  # variance of the products' rounding, in 1 / 12 DN^2
    total, share = np.zeros(256), np.zeros(256)
    for weight, chroma in zip(OF_CHROMA[place], whole[:, 1:].T, strict=True):
        if weight:
            mean = np.bincount(own, chroma, 256) / count
            spread = np.bincount(own, chroma**2, 256) / count - mean**2
            left = undithered_share(np.maximum(spread - 1 / 12, 0))
            total += weight**2 * left
            share = np.maximum(share, left)
    return np.sqrt((total + variance * share) / 12)


def add_shared_rounding(curve: ResponseCurve, shared: Float[np.ndarray, "256"]) -> ResponseCurve:
    """Return the curve with shared rounding of each code and of mid-scale, where g = 0."""
    error = shared[np.rint(curve.codes).astype(int)] * np.gradient(curve.log_exposure, curve.codes)
    middle, variance = curve.bins.middle, error**2
    added = np.diag(variance) + variance[middle]
    added[middle], added[:, middle] = 0, 0
    return replace(curve, covariance=curve.covariance + added)
