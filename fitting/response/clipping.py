"""Detection of pixels that are too dark because their neighbours clipped.

Demosaicking, resampling, denoising and JPEG blocks mix neighbours after the sensor has clipped, so
a pixel near a clipped one is too dark. This error is the same in every tile and exposure, so no
comparison of tiles or exposures reveals the error. Therefore pixels near clipped pixels count as
clipped.

A camera that blurs its picture may also hide a clipped peak: after the blur, the codes of the peak
are below the clip level. The next shorter exposure reveals such hidden peaks. Pixels around a
hidden peak are darker in the longer exposure than other pixels with the same code in the shorter
exposure. If no peak is hidden, all pixels with the same code in the shorter exposure have the same
mean code in the longer exposure. If the mean difference is significant given its scatter over tiles
of the picture, pixels around the hidden peaks also count as clipped.
"""

import numpy as np
from jaxtyping import Bool, Float, Integer
from scipy.ndimage import maximum_filter, uniform_filter
from scipy.special import stdtr

MIXED_PIXELS = 4  # pixels over which neighbours are mixed: half a block of a JPEG
CONTRASTS = 4.0, 6.0, 9.0, 13.0  # factors by which a blur may have reduced a peak, mildest first
FEWEST_CLIPPED = 50  # pixels to estimate the code of the shorter exposure that clips in the longer
BRIGHT_SHARE = 0.6  # share of the clip level above which codes of the longer exposure are compared
INTERVALS = 256  # groups of codes of the shorter exposure that are compared
SIDE, FEWEST_TILES = 4, 4  # tiles along a side of the picture; fewest tiles with such pixels
FALSE_ALARM_PROBABILITY = 0.05  # probability of finding hidden peaks where there are none


def clear_of_clipping(
    codes: Integer[np.ndarray, "exposures h w"],
    clip: float,
    *,
    mask: Bool[np.ndarray, "h w"] | None = None,
    hidden: bool = True,
) -> Integer[np.ndarray, "exposures h w"]:
    """Return the codes with all codes near a clipped one set to the clip level.

    Args:
        codes: (exposures, h, w) DN, by exposure time.
        clip: DN from which a code is saturated.
        mask: (h, w), true where the scene may be used; None for all pixels.
        hidden: whether to search for clipped peaks that a blur reduced to codes below `clip`.

    Returns:
        Codes of the same shape. Codes within `MIXED_PIXELS` of a clipped code or of a hidden peak
        are set to `clip`, rounded up.

    Example:
        >>> from fitting.response import clear_of_clipping
        >>> codes = np.full((1, 1, 7), 100)
        >>> codes[0, 0, 0] = 255  # one clipped pixel
        >>> print(clear_of_clipping(codes, 255.0).ravel())
        [255 255 255 255 255 100 100]
    """
    near = _neighbourhood(codes >= clip)
    scene = np.ones(codes.shape[1:], bool) if mask is None else mask
    for contrast in CONTRASTS if hidden else ():
        lost = _lost_peaks(codes, clip, contrast, scene)
        if not _darker_p_value(codes, clip, lost, near | ~scene) < FALSE_ALARM_PROBABILITY:
            break
        near |= _neighbourhood(lost)
    return np.where(near, np.maximum(codes, int(np.ceil(clip))), codes).astype(codes.dtype)


def _neighbourhood(mask: np.ndarray) -> np.ndarray:
    size = 1, 2 * MIXED_PIXELS + 1, 2 * MIXED_PIXELS + 1
    return maximum_filter(mask.astype(np.uint8), size) > 0


def _lost_peaks(codes: np.ndarray, clip: float, contrast: float, scene: np.ndarray) -> np.ndarray:
    """Return probable hidden peaks, where a sharpened shorter exposure reaches codes that clip."""
    lost = np.zeros(codes.shape, bool)
    for shorter, longer, where in zip(codes, codes[1:], lost[1:], strict=False):
        clipped = (longer >= clip) & scene
        if np.count_nonzero(clipped) >= FEWEST_CLIPPED:
            code = shorter.astype(np.float32)
            peak = code + np.float32(contrast) * (code - uniform_filter(code, 3))
            where[:] = peak >= np.quantile(shorter[clipped], 0.1)
    return lost


def _darker_p_value(
    codes: np.ndarray, clip: float, lost: np.ndarray, left_out: np.ndarray
) -> float:
    """Test if pixels around hidden peaks are darker in the longer exposure; return p."""
    rows, columns = np.indices(codes.shape[1:])
    tile = rows * SIDE // codes.shape[1] * SIDE + columns * SIDE // codes.shape[2]
    width = max(1, round(clip / INTERVALS))
    product, square = np.zeros((2, SIDE**2))
    for shorter, longer, peaks, out in zip(codes, codes[1:], lost[1:], left_out[1:], strict=False):
        used = ~out & (longer > BRIGHT_SHARE * clip)
        if not (peaks.any() and used.any()):
            continue
        code = shorter[used].astype(int)
        group, place = code // width, code % width - (width - 1) / 2
        around, value = _ring(peaks)[used].astype(float), longer[used].astype(float)
        level = np.ones(len(code))
        slope = _regress_out(place, level, group)  # in intervals of several codes
        for turn in (level, slope):
            around, value = _regress_out(around, turn, group), _regress_out(value, turn, group)
        product += np.bincount(tile[used], around * value, SIDE**2)
        square += np.bincount(tile[used], around**2, SIDE**2)
    if not square.any():
        return 1.0
    tiles = square.sum() ** 2 / np.sum(square**2)  # effective number of tiles
    if tiles < FEWEST_TILES:
        return 1.0
    difference = product.sum() / square.sum()
    spread = np.sum((product - difference * square) ** 2) * tiles / (tiles - 1)
    return float(stdtr(tiles - 1, product.sum() / np.sqrt(spread))) if spread > 0 else 1.0


def _ring(mask: np.ndarray) -> np.ndarray:
    """Return the pixels within `MIXED_PIXELS` of a mask, without its direct neighbours."""
    one, reach = mask.astype(np.float32), 2 * MIXED_PIXELS + 1
    wide, narrow = (uniform_filter(one, size, mode="constant") for size in (reach, 3))
    return reach**2 * wide - 9 * narrow > 0.5


def _regress_out(
    value: Float[np.ndarray, " pixels"],
    regressor: Float[np.ndarray, " pixels"],
    group: Integer[np.ndarray, " pixels"],
) -> Float[np.ndarray, " pixels"]:
    """Regress values on `regressor` separately in each group, and return the residuals."""
    square = np.bincount(group, regressor**2)
    slope = np.bincount(group, value * regressor) / np.where(square > 0, square, 1)
    return value - slope[group] * regressor
