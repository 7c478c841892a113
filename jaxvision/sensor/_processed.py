"""Recognise numbers that are not a single raw frame of the camera.

In every scene, noise increases the differences of neighbouring pixels. If the differences are
smaller than the camera's noise implies, frames were averaged, binned, denoised or scaled. Likewise,
the pattern of the dark and flat master frames must appear in the differences of raw pixels. Pixels
two apart are compared, because they have the same colour in a mosaic. Other functions recognise
master frames of a scene, of fewer frames than stated, or of a mosaic that raw lacks.
"""

import numpy as np
from jaxtyping import ArrayLike, Float

SIDE = 256  # pixels of a frame's middle that are looked at, along each side
BLOCK = 8  # pixels of a side
FEWEST_BLOCKS = 20
FEWEST_PAIRS = 64  # of a block, along both axes
SMOOTHEST = 0.25  # share of the blocks, taken to be the smoothest
QUIET = 0.5  # DN^2 of noise, below which rounding makes it uncertain
BRIGHT = 3.0  # standard deviations of noise of a pixel, above which its stated noise is right
LESS_NOISE = 0.7  # share of the variance, below which frames are not raw
GONE = 0.5  # share of a master's differences, below which they were removed
RELIABLE = 0.3  # least share of a master's differences that is not its noise
EVEN = 0.4  # largest interquartile range of the blocks' noise in even light; .25 for pure noise
SURE = 4.0  # standard errors of the noise in even light
UNSURE_PATTERN = 0.1  # relative error of the variance of a stated pattern
SIGMAS = 5.0
CELL, BLOCKS, FEWEST_ALONG = 6, 32, 10  # of a flat: pixels and blocks along its shorter side
DARKEST = 0.1  # of a flat's median, below which its pixels are not compared
UNEVEN = 0.02  # relative size of a block's structure, above which it is not that of even light
OF_A_SCENE = 0.1  # share of such blocks
FOURTH = (1.0, -4.0, 6.0, -4.0, 1.0)  # differences, without smooth light
ROUGH = 1.5  # standard deviation of a master's pixels, relative to the stated one
UNEQUAL_SITES = 0.1  # log ratio of the sites of a mosaic

Plane = Float[np.ndarray, "h w"]


def middle(frames: ArrayLike) -> Plane:
    """Return the middle of the first band of the first frame."""
    plane = np.asarray(frames)
    plane = plane.reshape(-1, *plane.shape[-3:])[0, ..., 0]
    starts = [max(size - SIDE, 0) // 2 // 2 * 2 for size in plane.shape]
    return plane[starts[0] : starts[0] + SIDE, starts[1] : starts[1] + SIDE].astype(float)


def _sum_along_axes(plane: Plane, weights: tuple[float, ...]) -> list[Plane]:
    """Return weighted sums of pixels that are two apart, along columns and along rows, cropped to
    whole blocks."""
    reach = 2 * (len(weights) - 1)
    rows, columns = ((size - reach) // BLOCK * BLOCK for size in plane.shape)
    down, across = np.zeros((2, rows, columns))
    for i, weight in enumerate(weights):
        down += weight * plane[2 * i : 2 * i + rows, :columns]
        across += weight * plane[:rows, 2 * i : 2 * i + columns]
    return [down, across]


def _sums(values: Plane) -> np.ndarray:
    """Return the sums over blocks."""
    rows, columns = (size // BLOCK for size in values.shape)
    return values.reshape(rows, BLOCK, columns, BLOCK).sum(axis=(1, 3))


def noise_ratios(image: Plane, variance: Plane, codes: Plane) -> Float[np.ndarray, " blocks"]:
    """Return the measured noise variance of each block of a frame, from second differences of its
    pixels, divided by the stated noise variance. Only blocks with enough light, and with more noise
    than the rounding of codes, are used. If there are too few such blocks, the result is empty."""
    if min(image.shape) < BLOCK + 4:
        return np.zeros(0)
    weights = (1.0, -2.0, 1.0)
    known = [np.isfinite(one) for one in _sum_along_axes(image, weights)]

    def sum_known(planes: list[Plane]) -> np.ndarray:
        first, second = (np.where(k, x, 0.0) for k, x in zip(known, planes, strict=True))
        return _sums(first) + _sums(second)

    found, of_codes = (
        sum_known([one**2 for one in _sum_along_axes(plane, weights)]) for plane in (image, codes)
    )
    expected = sum_known(_sum_along_axes(variance, (1.0, 4.0, 1.0))) / 6
    level, pairs = (
        sum_known(_sum_along_axes(image, (1.0, 0.0, 0.0))),
        sum_known([1.0 * k for k in known]),
    )
    full = (pairs >= FEWEST_PAIRS) & (level > BRIGHT * np.sqrt(expected * pairs))
    full &= expected * of_codes.sum() > QUIET * pairs * found.sum()
    if np.count_nonzero(full) < FEWEST_BLOCKS:
        return np.zeros(0)
    return found[full] / (6 * expected[full])


def noise_ratio(ratios: Float[np.ndarray, " blocks"]) -> float:
    """Return the ratio of measured to stated noise variance in the smoothest blocks; 1 if there are
    none."""
    return float(np.quantile(ratios, SMOOTHEST)) if ratios.size else 1.0


def looks_without_black(
    ratios: Float[np.ndarray, " blocks"],
    *,
    light: float,
    noise: float,
    offsets: float,
    gains: float,
    black: float,
) -> bool:
    """Return whether the noise in even light fits a signal that is larger by `black`, as if a black
    level had been subtracted.

    All arguments are means over the frame: light and black in electrons, and the variances of noise
    and of the fixed pattern of offsets and of gains.
    """
    if not ratios.size or not light > 0:
        return False
    low, median, high = np.quantile(ratios, (0.25, 0.5, 0.75))
    if high - low > EVEN * median:  # a scene, or light that is not smooth
        return False
    measured = float(ratios.mean()) * noise
    by_chance = float(ratios.std()) / ratios.size**0.5 * noise
    error = float(np.hypot(by_chance, UNSURE_PATTERN * (offsets + gains)))
    without = noise + black + offsets + gains * (1 + black / light) ** 2
    excess = measured - noise - offsets - gains
    return excess > SURE * error and abs(measured - without) < min(3 * error, excess / 2)


def structured_share(flat: Plane, light: float) -> float:
    """Return the share of a flat's blocks with structure, from their fourth differences: a lens and
    uneven light vary smoothly, a scene does not. Blocks with a pixel below `light` are left out."""
    side = CELL * max(round(min(flat.shape) / (CELL * BLOCKS)), 1)
    rows, columns = (size // side for size in flat.shape)
    if min(rows, columns) < FEWEST_ALONG:
        return 0.0
    cut = flat[: rows * side, : columns * side]
    with np.errstate(invalid="ignore", divide="ignore"):
        cut = np.where(cut > light, cut, np.nan)
        blocks = cut.reshape(rows, side, columns, side).transpose(0, 2, 1, 3)
        blocks = np.log(blocks.reshape(rows, columns, -1).mean(axis=-1))
    found = []
    for plane in (blocks, blocks.T):
        parts = [w * plane[i : len(plane) - 4 + i] for i, w in enumerate(FOURTH)]
        along = np.sum(parts, axis=0)
        known = np.abs(along[np.isfinite(along)]) / np.sum(np.square(FOURTH)) ** 0.5
        found.append(float(np.mean(known > UNEVEN)) if known.size else 0.0)
    return max(found)


def roughness(master: Plane, variance: Plane) -> float:
    """Return the standard deviation of a master's fourth differences relative to that of a stated
    variance of its pixels, by medians: hot pixels and edges are few."""
    if min(master.shape) < BLOCK + 8:
        return 1.0
    apart = np.abs(np.ravel(_sum_along_axes(master, FOURTH)))
    stated = np.ravel(_sum_along_axes(variance, tuple(np.square(FOURTH))))
    known = np.isfinite(apart) & np.isfinite(stated) & (stated > 0)
    if np.count_nonzero(known) < FEWEST_PAIRS:
        return 1.0
    return float(np.median(apart[known] / np.sqrt(stated[known]))) / 0.6745


def sites(plane: Plane) -> Float[np.ndarray, "4"]:
    """Return the logarithms of the medians of the four sites of 2 x 2 cells, about their mean."""
    cells = [np.nanmedian(plane[i::2, j::2]) for i in (0, 1) for j in (0, 1)]
    with np.errstate(invalid="ignore", divide="ignore"):
        logs = np.log(cells)
    return logs - logs.mean()


def other_sites(frame: Plane, flat: Plane) -> bool:
    """Return whether a flat shows a mosaic that the frame lacks, or has in another phase: its equal
    sites, the greens, differ in the frame, and the two others do not."""
    own, wanted = sites(frame), sites(flat)
    if not np.isfinite([own, wanted]).all() or np.abs(wanted).max() < UNEQUAL_SITES:
        return False
    pairs = ((0, 3), (1, 2))

    def apart(of: Float[np.ndarray, "4"]) -> list[float]:
        return [abs(float(of[i] - of[j])) for i, j in pairs]

    in_flat, in_frame = apart(wanted), apart(own)
    if np.abs(own).max() < np.abs(wanted).max() / 10:
        return True
    greens = int(np.argmin(in_flat))
    clear = in_flat[greens] < max(in_flat) / 4 and in_frame[1 - greens] < in_frame[greens] / 4
    return clear and in_frame[greens] > UNEQUAL_SITES


def lacks(frame: Plane, pattern: Plane, noise: Plane, weight: Plane) -> str | None:
    """Return None if a frame contains at least half of a pattern in its own place. Otherwise return
    a clause that names another place where the frame shows the pattern, or "" for none."""
    if not _holds(frame, pattern, noise, weight)[0]:
        return None
    for axis, words in (
        (1, "left to right"),
        (0, "top to bottom"),
        ((0, 1), "in both directions, or turned by 180 degrees"),
    ):
        if _holds(frame, np.flip(pattern, axis), np.flip(noise, axis), weight)[1]:
            return f" where it is, but has it mirrored {words}"
    return ""


def _holds(frame: Plane, pattern: Plane, noise: Plane, weight: Plane) -> tuple[bool, bool]:
    """Return whether a frame contains significantly less than half of a pattern, and whether
    significantly more, by a regression of the frame's pixel differences on the pattern's. `noise`
    is the variance of the pattern's error. Differences are multiplied by `weight`."""
    if min(frame.shape) < BLOCK + 2:
        return False, False
    weights = np.ravel(_sum_along_axes(weight, (1.0, 0.0)))
    own, wanted = (weights * np.ravel(_sum_along_axes(x, (1.0, -1.0))) for x in (frame, pattern))
    error = weights**2 * np.ravel(_sum_along_axes(noise, (1.0, 1.0)))
    known = np.isfinite(own) & np.isfinite(wanted) & np.isfinite(error)
    own, wanted, error = own[known], wanted[known], error[known]
    square = float(np.sum(wanted**2))
    share = 1 - float(np.sum(error)) / square if square > 0 else 0.0
    if own.size < FEWEST_PAIRS or share < RELIABLE:
        return False, False
    slope = float(np.sum(own * wanted)) / square
    of_slope = 2 * float(np.sum(((own - slope * wanted) * wanted) ** 2)) ** 0.5 / square
    apart, half = SIGMAS * of_slope, GONE * share
    return slope + apart < half, slope - apart > half
