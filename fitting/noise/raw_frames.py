"""What compression, denoising and tone curves leave in frames, from which no gain can be read.

JPEG       noise that neighbours share, except across the borders of blocks of 8 x 8 pixels
denoising  frames that share noise: a pattern that grows as the signal does, as shot noise, and
           not as offsets and gains of pixels, d + p x^2
gamma      a signal that grows as a power of the light, and noise that does not grow with it

Pixels that are dead, at 0 or at the top code in every frame, tell nothing at all.
"""

from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from .levels import PhotonTransfer

BLOCK = 8  # pixels of a side
SURE = 6.0  # standard errors
SHARED = 0.1  # of the noise, by which less the covariance across a border must be
KEPT = 0.1  # of K, by which less a pattern may grow with the signal
FEWEST_FOR_PATTERN = 7  # levels, for a polynomial of four terms
FEWEST_FOR_CURVE = 3
BELOW_SATURATION = 0.8  # of the largest signal; levels above it may be saturated
STRAIGHT = 0.85  # exponent of the light below which a signal is curved
MOST_DEAD = 0.1  # share of the pixels; of more, something else is the cause
APART = 240  # pixels at most from a dead one to that in its place; multiples of all periods sought
GROWS = 0.7  # share of what noise gains over black that must be in proportion to the signal


def block_products(deviation: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "2 8"]:
    """Mean product of a pixel and the one below it (to the right of it), by row (column) modulo 8.

    Args:
        deviation: (h, w) DN.

    Returns:
        DN^2; NaN of frames of fewer than 16 rows or columns.
    """
    found = np.full((2, BLOCK), np.nan)
    if min(deviation.shape) >= 2 * BLOCK:
        below = np.einsum("ij,ij->i", deviation[:-1], deviation[1:]) / deviation.shape[1]
        beside = np.einsum("ij,ij->j", deviation[:, :-1], deviation[:, 1:]) / deviation.shape[0]
        for own, along in zip(found, (below, beside), strict=True):
            own[:] = [along[i::BLOCK].mean() for i in range(BLOCK)]
    return found


def dead_pixels(frames: Iterable[np.ndarray], top: float) -> Bool[np.ndarray, "h w"] | None:
    """Pixels that are at 0 in every frame, or at the top code in every frame.

    Args:
        frames: (h, w) each, flats and darks, the brightest flat and a dark first: where these show
            no such pixel, no more are looked at.
        top: the top code.

    Returns:
        True where a pixel is dead; None where none is, or more than a tenth of all.
    """
    low = high = None
    for i, frame in enumerate(frames):
        if frame.ndim != 2 or (low is not None and frame.shape != low.shape):
            return None
        low = (frame <= 0) & (True if low is None else low)
        high = (frame >= top) & (True if high is None else high)
        if i and not (low.any() or high.any()):
            return None
    if low is None or high is None or not 0 < (low | high).mean() <= MOST_DEAD:
        return None
    return low | high


def without_dead(frame: np.ndarray, dead: Bool[np.ndarray, "h w"]) -> np.ndarray:
    """A frame whose dead pixels have the number of another one, always the same: too far for noise
    that neighbours share, and at the same place of a mosaic and of periods up to 8.

    Args:
        frame: (h, w).
        dead: where pixels are dead.

    Returns:
        A copy; a frame of another size as it is.
    """
    if frame.shape != dead.shape:
        return frame
    found, left = frame.copy(), dead.copy()
    for step in (APART, 48, 24, 16, 8):
        for along in ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1)):
            shift = (along[0] * step, along[1] * step)
            if all(abs(x) < size for x, size in zip(shift, frame.shape, strict=True)):
                here = left & ~np.roll(dead, shift, (0, 1))
                found[here] = np.roll(frame, shift, (0, 1))[here]
                left &= ~here
    return found


def dead_in_words(dead: Bool[np.ndarray, "h w"], top: float) -> str:
    """A sentence on dead pixels, whole rows and columns by number.

    Args:
        dead: where pixels are dead.
        top: the top code.

    Returns:
        The sentence.
    """
    lines = []
    for axis, name in ((0, "column"), (1, "row")):
        whole = np.flatnonzero(dead.all(axis=axis))
        if len(whole):
            shown = ", ".join(str(i) for i in whole[:6]) + ", ..." * (len(whole) > 6)
            lines.append(f"{name}{'s' * (len(whole) > 1)} {shown}")
    count = int(dead.sum())
    where = f" ({' and '.join(lines)})" if lines else ""
    return (
        f"{count} of {dead.size} pixels{where} read 0 in every frame, or {top:g} in every frame, "
        "as dead pixels do: they were left out, and others of the same frame took their place."
    )


def local_variance(average: Float[np.ndarray, "h w"]) -> float:
    """Variance of pixels by differences of neighbours, which uneven light does not raise.

    Args:
        average: (h, w) of frames, DN.

    Returns:
        DN^2.
    """
    apart = [np.diff(average, axis=axis) for axis in (0, 1) if average.shape[axis] > 1]
    return float(np.mean([np.mean(d**2) / 2 for d in apart]))


def processing_in_words(
    measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"]
) -> list[str]:
    """What shows that frames are not raw.

    Args:
        measurement: bright and dark levels.
        usable: indices of the bright levels to use.

    Returns:
        Sentences.
    """
    return [*_compressed(measurement, usable), *_denoised(measurement, usable)]


def is_compressed(measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"]) -> bool:
    """Whether noise ends at the borders of blocks.

    Args:
        measurement: bright and dark levels.
        usable: indices of the bright levels to use.

    Returns:
        True where it does.
    """
    return bool(_compressed(measurement, usable))


def _compressed(measurement: PhotonTransfer, usable: np.ndarray) -> Sequence[str]:
    bright = measurement.bright
    if bright.blocks is None or not len(usable):
        return ()
    variance, frames = (np.asarray(x)[usable] for x in (bright.variance, bright.frames))
    shares = np.asarray(bright.blocks)[usable] / variance[:, None, None]
    found = np.average(shares, axis=0, weights=frames - 1)  # (2, residues)
    widest = 1 + 2 * max(float(found.mean()), 0.0)  # noise that neighbours share has fewer degrees
    error = widest / np.sqrt(np.sum(frames - 1) * float(bright.pixels) / BLOCK)
    least = found.min(axis=1)
    others = (found.sum(axis=1) - least) / (BLOCK - 1)
    if not np.all(others - least > max(SURE * error, SHARED)):
        return ()
    return (
        f"Neighbouring pixels share {100 * float(others.mean()):.2g} % of their noise, but "
        f"{100 * float(least.mean()):.2g} % across every eighth row and column, as in JPEG, which "
        "drops noise block by block: gain, read noise and quantum efficiency are not the camera's. "
        "Give raw frames.",
    )


def _denoised(measurement: PhotonTransfer, usable: np.ndarray) -> Sequence[str]:
    bright, dark = measurement.bright, measurement.dark
    if bright.local_pattern is None or dark.local_pattern is None:
        return ()
    # Frames that share noise keep less of it the more of them are averaged.
    counts = np.asarray(bright.frames)[usable]
    usable = usable[counts == np.median(counts)]
    if len(usable) < FEWEST_FOR_PATTERN:
        return ()
    matched = np.asarray(measurement.dark_of)[usable]
    black = np.asarray(dark.mean)[matched]
    signal = np.concatenate([np.asarray(bright.mean)[usable] - black, np.zeros(dark.mean.size)])
    pattern, variance, frames = (
        np.concatenate([np.asarray(one)[usable], np.asarray(other)])
        for one, other in (
            (bright.local_pattern, dark.local_pattern),
            (bright.variance, dark.variance),
            (bright.frames, dark.frames),
        )
    )
    rest, top = variance / frames, float(signal.max())
    # Of differences of neighbours half as many again count as of pixels.
    errors = 4 * np.maximum(pattern, 0) * rest + 2 * rest**2 * frames / (frames - 1)
    errors = np.sqrt(1.5 * errors / float(bright.pixels))
    told = errors > 0
    if told.sum() < FEWEST_FOR_PATTERN or top <= 0:
        return ()
    x, y, scale = signal[told] / top, pattern[told], errors[told]
    shot = np.asarray(bright.variance)[usable] - np.asarray(dark.variance)[matched]
    gain = float(np.median(shot[-3:] / signal[: len(usable)][-3:]))
    if gain <= 0:
        return ()
    slope = 0.0
    for powers in ((0, 1, 2), (0, 1, 2, 3)):  # a curved response adds a cube
        design = np.stack([x**power for power in powers], axis=1) / scale[:, None]
        covariance = np.linalg.pinv(design.T @ design)
        found = covariance @ (design.T @ (y / scale))
        misfit = np.sum((y / scale - design @ found) ** 2) / max(len(y) - len(powers), 1)
        error = np.sqrt(covariance[1, 1] * max(misfit, 1))
        # Offsets and gains of pixels that go together add no more than this.
        together = 2 * np.sqrt(max(found[0], 0) * max(found[2], 0))
        slope = float(found[1] - together) / top
        if slope < max(SURE * float(error) / top, KEPT * gain):
            return ()
    return (
        "What stays from frame to frame grows with the signal as shot noise does, by "
        f"{slope / gain:.2g} times the gain: the frames of a level share noise, as after temporal "
        "denoising or running averages. Variances between frames are too small, and with "
        "them K; read noise and quantum efficiency are wrong too. Give independent raw frames.",
    )


def tone_curve(measurement: PhotonTransfer) -> float | None:
    """The exponent of a tone curve that frames went through.

    Light that is stated wrongly bends the signal too, but leaves variance in proportion to it.

    Args:
        measurement: bright and dark levels.

    Returns:
        With which the signal grows; None where it is straight, or noise grows with it.
    """
    bright, dark = measurement.bright, measurement.dark
    light, variance = np.asarray(bright.light), np.asarray(bright.variance)
    degrees = float(bright.pixels) * (np.asarray(bright.frames) - 1)
    signal = np.asarray(bright.mean) - np.asarray(dark.mean)[np.asarray(measurement.dark_of)]
    seen = (light > 0) & (variance > 0) & (signal <= BELOW_SATURATION * signal.max())
    seen &= signal > SURE * np.sqrt(variance / float(bright.pixels))
    if seen.sum() < FEWEST_FOR_CURVE or np.ptp(np.log(light[seen])) < np.log(2):
        return None
    light, signal, variance, degrees = (x[seen] for x in (light, signal, variance, degrees))
    exponent = float(np.polyfit(np.log(light), np.log(signal), 1)[0])
    if exponent >= STRAIGHT:
        return None
    errors = variance * np.sqrt(2 / degrees)
    (slope, _), covariance = np.polyfit(signal, variance, 1, w=1 / errors, cov="unscaled")
    top = int(np.argmax(light))
    gained = float(variance[top] - np.median(np.asarray(dark.variance)))
    most = (slope + SURE * np.sqrt(covariance[0, 0])) * signal[top]
    return exponent if most < GROWS * max(gained, 0.0) or slope < 0 else None
