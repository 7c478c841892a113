"""Detection of compression, resizing, denoising and tone curves, after which a gain is meaningless.

- After JPEG compression, neighbouring pixels share noise, except across the borders of blocks of
  8 x 8 pixels. At high quality, the block cosine transforms are multiples of the quantiser steps.
- After resizing, neighbouring pixels share noise, and share less of it after every second or fourth
  row or column.
- After denoising, frames share noise. The variance of their common pattern grows with the signal x
  as shot noise does, and not as d + p x^2 like that of unequal offsets and gains of pixels.
- After a tone curve (gamma), the signal grows as a power of the light, and the noise does not grow
  with the signal.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy.fft import dctn

from ..frame_checks.frame import listed
from .levels import PhotonTransfer, shot_of, signal_of
from .live_pixels import LivePixels, line_products
from .pattern import local_variances
from .regressions import least_squares

BLOCK = 8  # pixels of a side
SIGNIFICANCE_SIGMAS = 6.0  # standard errors
# Share of the noise by which the covariance across a border must be smaller
LEAST_COVARIANCE_DEFICIT = 0.1
# Share of the lowest covariance's deficit that the others of a period must have
LEAST_DEFICIT_SHARE = 0.5
# Share of K below which the growth of a pattern with the signal is accepted
LARGEST_SLOPE_SHARE = 0.1
STEPS = np.arange(1, 17)  # quantiser steps of JPEG that are tested, DN
SMOOTH = 1 / 1.3  # deviation of a coefficient, in steps, above which raw frames have no comb
COMB, FEWEST_COMBS = 5.0, 10  # standard errors, and coefficients of 63, that show a comb
MOST_BLOCKS = 4096  # used to find combs, evenly spread over a frame
FEWEST_FOR_PATTERN = 7  # levels, for a polynomial of four terms
FEWEST_FOR_CURVE = 3
BELOW_SATURATION = 0.8  # of the largest signal; levels above it may be saturated
STRAIGHT = 0.85  # exponent of the light below which a signal is curved
NOT_THE_CAMERAS = "gain, read noise and quantum efficiency are not the camera's. Give raw frames."
GROWS = 0.7  # share of the noise above black that must be proportional to the signal


def block_products(
    deviation: Float[np.ndarray, "h w"], live: LivePixels
) -> Float[np.ndarray, "2 8"]:
    """Return mean products of pixels with those below (or beside), by row (or column) modulo 8."""
    found = np.full((2, BLOCK), np.nan)
    if min(deviation.shape) >= 2 * BLOCK:
        lines = zip(found, line_products(deviation), live.pairs_by_line, strict=True)
        for own, products, pairs in lines:
            own[:] = [
                products[i::BLOCK].sum() / max(pairs[i::BLOCK].sum(), 1.0) for i in range(BLOCK)
            ]
    return found


def combs(
    frame: Float[np.ndarray, "h w"], *, corner: tuple[int, int] = (0, 0)
) -> Float[np.ndarray, "steps 8 8"]:
    """Test, for each of 16 steps q and each of 8 x 8 coefficients c of the block cosine transform,
    whether the coefficients cluster at multiples of q. Return the mean of cos(2 pi c / q) in
    standard errors.

    JPEG rounds each coefficient of a block of 8 x 8 pixels to a multiple of a step q from its
    table. The mean of cos(2 pi c / q) is then 1, or exp(-pi^2 / (6 q^2)) after the pixels are
    rounded again. For raw frames whose noise exceeds a step, the mean is 0.
    """
    found = np.full((len(STEPS), BLOCK, BLOCK), np.nan)
    own = frame[-corner[0] % BLOCK :, -corner[1] % BLOCK :]
    rows, columns = (size // BLOCK for size in own.shape)
    if rows * columns < 4:
        return found
    own = own[: rows * BLOCK, : columns * BLOCK].reshape(rows, BLOCK, columns, BLOCK)
    blocks = own.swapaxes(1, 2).reshape(-1, BLOCK, BLOCK)
    blocks = blocks[:: -(-len(blocks) // MOST_BLOCKS)]
    coefficients = np.asarray(dctn(blocks, axes=(1, 2), norm="ortho"))
    coefficients[:, 0, 0] = 0.0
    of_block = np.sqrt(np.sum(coefficients**2, axis=(1, 2)) / (BLOCK**2 - 1))
    every = coefficients.std(axis=0)
    for own, step in zip(found, STEPS, strict=True):
        some = of_block > SMOOTH * step  # narrower coefficients, as in the dark, cluster about 0
        if np.count_nonzero(some) < 4:
            continue
        lively = coefficients if some.all() else coefficients[some]
        turns = lively / step
        turns -= np.rint(turns)  # less than half a turn, for which float32 suffices
        mean = np.cos((2 * np.pi * turns).astype(np.float32)).mean(axis=0, dtype=float)
        textured = (every if some.all() else lively.std(axis=0)) > SMOOTH * step
        own[:] = np.where(textured, mean * np.sqrt(2 * len(lively)), np.nan)
    found[:, 0, 0] = np.nan
    return found


def local_variance(average: Float[np.ndarray, "h w"], live: LivePixels) -> float:
    """Return an average frame's variance by neighbours' differences, free of uneven light."""
    found = []
    for axis in (0, 1):
        if average.shape[axis] > 1:
            first, second = (
                np.moveaxis(live.mask, axis, 0)[part] for part in (np.s_[:-1], np.s_[1:])
            )
            apart = np.diff(np.moveaxis(average, axis, 0), axis=0)
            if (first & second).any():
                found.append(np.mean(apart[first & second] ** 2) / 2)
    return float(np.mean(found)) if found else np.nan


def processing_in_words(
    measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"]
) -> list[str]:
    """Return sentences on the evidence that frames are not raw; an empty list if there is none."""
    lossy = measurement.lossy
    if not lossy:
        return [*compressed_in_words(measurement, usable), *_find_denoising(measurement, usable)]
    named = (
        f"{listed(lossy)} {'is' if len(lossy) == 1 else 'are'} JPEG, which removes noise and "
        f"usually has a tone curve: {NOT_THE_CAMERAS}"
    )
    return [named, *_find_denoising(measurement, usable)]


def compressed_in_words(
    measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"]
) -> list[str]:
    """Return a sentence on compression or resizing by blocks; else []."""
    return _rounded_blocks(measurement, usable) or _parted_blocks(measurement, usable)


def _rounded_blocks(measurement: PhotonTransfer, usable: np.ndarray) -> list[str]:
    if measurement.bright.combs is None or not len(usable):
        return []
    each = np.asarray(measurement.bright.combs)[usable]
    known = np.isfinite(each)
    both = np.where(known, each, 0.0).sum(axis=0) / np.sqrt(np.maximum(known.sum(axis=0), 1))
    # Single levels may be too dim or too bright to show the effect.
    at_most = np.maximum(both, np.where(known, each, 0.0).max(axis=0) - 1.0)
    count = int((at_most.max(axis=0) > COMB).sum())
    if count < FEWEST_COMBS:
        return []
    return [
        f"In blocks of 8 x 8 pixels {count} of 63 coefficients of the cosine transform are "
        "multiples of a step, because JPEG rounds them: the files were made from JPEG, perhaps of "
        f"high quality. {NOT_THE_CAMERAS[0].upper()}{NOT_THE_CAMERAS[1:]}"
    ]


def _parted_blocks(measurement: PhotonTransfer, usable: np.ndarray) -> list[str]:
    bright = measurement.bright
    if bright.blocks is None or not len(usable):
        return []
    variance, frames = (np.asarray(x)[usable] for x in (bright.variance, bright.frames))
    shares = np.asarray(bright.blocks)[usable] / variance[:, None, None]
    found = np.average(shares, axis=0, weights=frames - 1)  # (2, residues)
    widest = 1 + 2 * max(float(found.mean()), 0.0)  # shared noise has fewer degrees
    error = widest / np.sqrt(np.sum(frames - 1) * float(bright.pixels) / BLOCK)
    least = found.min(axis=1)
    others = (found.sum(axis=1) - least) / (BLOCK - 1)
    if not np.all(others - least > max(SIGNIFICANCE_SIGMAS * error, LEAST_COVARIANCE_DEFICIT)):
        return []
    period = next((p for p in (2, 4) if _repeats(found, p)), BLOCK)
    if period < BLOCK:
        every = {2: "second", 4: "fourth"}[period]
        return [
            f"Neighbouring pixels share {100 * float(others.mean()):.2g} % of their noise, and "
            f"less across every {every} row and column, as in frames that were resized: "
            f"{NOT_THE_CAMERAS}"
        ]
    return [
        f"Neighbouring pixels share {100 * float(others.mean()):.2g} % of their noise, but "
        f"{100 * float(least.mean()):.2g} % across every eighth row and column, as in JPEG, which "
        f"drops noise block by block: {NOT_THE_CAMERAS}"
    ]


def _repeats(shares: Float[np.ndarray, "2 residues"], period: int) -> bool:
    """Return whether the noise that neighbours share drops once every `period` rows and columns."""
    for own in shares:
        low = np.arange(BLOCK) % period == int(np.argmin(own)) % period
        if own[~low].mean() - own[low].max() < LEAST_DEFICIT_SHARE * (own[~low].mean() - own.min()):
            return False
    return True


def _find_denoising(measurement: PhotonTransfer, usable: np.ndarray) -> list[str]:
    bright, dark = measurement.bright, measurement.dark
    lit, unlit = local_variances(bright), local_variances(dark)
    if lit is None or unlit is None:
        return []
    # The more frames are averaged, the less of their shared noise remains.
    counts = np.asarray(bright.frames)[usable]
    usable = usable[counts == np.median(counts)]
    if len(usable) < FEWEST_FOR_PATTERN:
        return []
    signal = np.concatenate([signal_of(measurement)[usable], np.zeros(dark.mean.size)])
    pattern, square = (
        np.concatenate([one[usable], other]) for one, other in zip(lit, unlit, strict=True)
    )
    errors, top = np.sqrt(square), float(signal.max())
    known = errors > 0
    if known.sum() < FEWEST_FOR_PATTERN or top <= 0:
        return []
    x, y, scale = signal[known] / top, pattern[known], errors[known]
    shot = shot_of(measurement)[usable]
    gain = float(np.median(shot[-3:] / signal[: len(usable)][-3:]))
    if gain <= 0:
        return []
    slope = 0.0
    for powers in ((0, 1, 2), (0, 1, 2, 3)):  # a curved response adds a cube
        fit = least_squares([x**power for power in powers], y, errors=scale)
        found, error = fit.values, fit.errors[1]
        # Correlated offsets and gains of pixels add at most this.
        together = 2 * np.sqrt(max(found[0], 0) * max(found[2], 0))
        slope = float(found[1] - together) / top
        if slope < max(SIGNIFICANCE_SIGMAS * float(error) / top, LARGEST_SLOPE_SHARE * gain):
            return []
    return [
        "The pattern that is the same in all frames of a level grows with the signal as shot noise "
        f"does, by {slope / gain:.2g} times the gain: the frames of a level share noise, as after "
        "temporal denoising or running averages. Variances between frames are too small, and so is "
        "K; read noise and quantum efficiency are wrong too. Give independent raw frames.",
    ]


def tone_curve(measurement: PhotonTransfer) -> float | None:
    """Return the exponent of a tone curve, that is, of the power of the light to which the signal
    is proportional. Return None if the signal is linear in the light, or if the variance grows in
    proportion to the signal.

    Wrongly stated light bends the signal too, but then the variance stays proportional to the
    signal.
    """
    bright, dark = measurement.bright, measurement.dark
    light, variance = np.asarray(bright.light), np.asarray(bright.variance)
    signal, errors = signal_of(measurement), bright.variance_error
    seen = (light > 0) & (variance > 0) & (signal <= BELOW_SATURATION * signal.max())
    seen &= signal > SIGNIFICANCE_SIGMAS * np.sqrt(variance / float(bright.pixels))
    if seen.sum() < FEWEST_FOR_CURVE or np.ptp(np.log(light[seen])) < np.log(2):
        return None
    light, signal, variance, errors = (x[seen] for x in (light, signal, variance, errors))
    exponent = float(np.polyfit(np.log(light), np.log(signal), 1)[0])
    if exponent >= STRAIGHT:
        return None
    (slope, _), covariance = np.polyfit(signal, variance, 1, w=1 / errors, cov="unscaled")
    top = int(np.argmax(light))
    gained = float(variance[top] - np.median(np.asarray(dark.variance)))
    most = (slope + SIGNIFICANCE_SIGMAS * np.sqrt(covariance[0, 0])) * signal[top]
    return exponent if most < GROWS * max(gained, 0.0) or slope < 0 else None
