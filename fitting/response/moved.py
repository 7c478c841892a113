"""Test whether the exposures of a stack are registered, as with a camera on a tripod.

Each image is thresholded at a quantile of its codes (Ward, J. Graphics Tools 8, 2003). The
resulting mask of bright pixels is the same for any exposure and response. The shift between two
images is the shift at which most pixels of the two masks agree. A shift is accepted if
significantly more pixels agree than without a shift.
"""

from collections.abc import Sequence
from itertools import islice, pairwise
from typing import Any

import numpy as np
from jaxtyping import Float, Shaped
from scipy.ndimage import uniform_filter

from ..frame_checks.frame import OddFrames

QUANTILES = 0.5, 0.35, 0.65, 0.2, 0.8  # quantiles at which images are thresholded
CUTS = 3  # at most
WIDEST = 1024  # largest side, in pixels, of the compared part, from the middle
THRESHOLD_RANGE = 0.03, 0.95  # shares of the range of codes between which a threshold must lie
FARTHEST = 8  # largest shift: the picture's side divided by this number
MOST_FIXED = 0.9  # share of pixels with one number in all images that may be left out
LEAST_SHIFT = 2.0  # shift, in pixels, from which an image is left out and not moved back
SIGNIFICANCE_SIGMAS = 6.0  # standard deviations by which a shift must increase the agreement
LEAST_KAPPA = 0.5  # Cohen's kappa of the agreement needed at the found shift


def moved_exposures(
    names: Sequence[str],
    frames: Sequence[Shaped[np.ndarray, "h w *channels"]],
    *,
    full_scale: float,
    cell: tuple[int, int] = (1, 1),
) -> tuple[list[OddFrames], dict[str, tuple[int, int]]]:
    """Return exposures displaced by two pixels or more, and smaller shifts by name."""
    if len({np.shape(frame) for frame in frames}) != 1:
        return [], {}  # sizes differ; refused where frames are read
    size: Any = list(cell)  # SciPy's types know one number for all axes only
    middles = [_middle(frame) for frame in frames]
    smooth = [uniform_filter(frame, size) for frame in middles]
    fixed = np.all([frame == middles[0] for frame in middles], axis=0)
    if fixed.mean() < MOST_FIXED:  # bars and overlays do not show the scene
        smooth = [np.where(fixed, np.nan, frame) for frame in smooth]
    steps = [_shift(one, other, full_scale) for one, other in pairwise(smooth)]
    places = np.concatenate([np.zeros((1, 2)), np.cumsum(np.array(steps).reshape(-1, 2), axis=0)])
    far = np.linalg.norm(places[:, None] - places, axis=-1) >= LEAST_SHIFT
    middle = int(np.argmin(far.sum(axis=1)))
    home = places[middle]
    apart = np.hypot(*(places - home).T)
    near = {}
    for i in np.flatnonzero((apart > 0) & (apart < LEAST_SHIFT)).tolist():
        down, right = _shift(smooth[middle], smooth[i], full_scale)
        if 0 < np.hypot(down, right) < LEAST_SHIFT and not (down % cell[0] or right % cell[1]):
            near[names[i]] = int(down), int(right)
    return [
        OddFrames(
            (name,),
            f"its scene is shifted by {right:+.0f} pixels to the right and {down:+.0f} down from "
            "its position in most exposures; align the images or use a tripod",
        )
        for name, (down, right) in zip(names, places - home, strict=True)
        if np.hypot(down, right) >= LEAST_SHIFT
    ], near


def moved_back(
    frame: Shaped[np.ndarray, "h w *channels"], by: tuple[int, int], fill: float
) -> Shaped[np.ndarray, "h w *channels"]:
    """Move a picture up and left by rows and columns, and fill the border."""
    found = np.full_like(frame, fill)
    (into, of), (into_columns, of_columns) = (
        (slice(max(-n, 0), size - max(n, 0)), slice(max(n, 0), size + min(n, 0)))
        for n, size in zip(by, frame.shape, strict=False)
    )
    found[into, into_columns] = frame[of, of_columns]
    return found


def _shift(
    one: Float[np.ndarray, "h w"], other: Float[np.ndarray, "h w"], full_scale: float
) -> Float[np.ndarray, "2"]:
    """Return the shift, (rows, columns), of the second image; 0 if insignificant."""
    cuts = (_cut(one, other, q, full_scale) for q in QUANTILES)
    pairs = list(islice((pair for pair in cuts if pair is not None), CUTS))
    if not pairs:
        return np.zeros(2)
    reach = [max(2, size // FARTHEST) for size in one.shape]
    size = [-(-(n + m) // 64) * 64 for n, m in zip(one.shape, reach, strict=True)]

    def correlation(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        full = np.fft.irfft2(np.conj(np.fft.rfft2(a, size)) * np.fft.rfft2(b, size), size)
        rows, columns = (np.arange(-m, m + 1) for m in reach)
        return full[np.ix_(rows % size[0], columns % size[1])]

    agree = np.sum([correlation(a, b) for a, b in pairs], axis=0)
    common = np.sum([correlation(np.abs(a), np.abs(b)) for a, b in pairs], axis=0)
    share = agree / np.maximum(common, 1)
    best = np.unravel_index(np.argmax(np.where(common > common.max() / 2, share, -1)), share.shape)
    middle = (reach[0], reach[1])
    # Each pixel that agrees at only one of the two shifts changes the sum by 2.
    scatter = 2 * np.sqrt(len(pairs) * (1 - min(share[middle], 1)) * common[middle] / 2 + 1)
    rise = (share[best] - share[middle]) * common[middle]
    chance = np.mean([a.mean() * b.mean() for a, b in pairs])  # agreement of unrelated images
    if rise < SIGNIFICANCE_SIGMAS * scatter or share[best] - chance < LEAST_KAPPA * (1 - chance):
        return np.zeros(2)
    return np.array(best, float) - middle


def _cut(
    one: np.ndarray, other: np.ndarray, quantile: float, full_scale: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """Threshold two images at a quantile (1, -1, 0 for NaN); None if it is black or saturated."""
    found = []
    for image in (one, other):
        level, black = np.nanquantile(image, quantile), float(np.nanmin(image))
        if (
            not THRESHOLD_RANGE[0] * full_scale < level - black
            or not level < THRESHOLD_RANGE[1] * full_scale
        ):
            return None
        found.append(np.nan_to_num(np.sign(image - level)))
    return found[0], found[1]


def _middle(frame: Shaped[np.ndarray, "h w *channels"]) -> Float[np.ndarray, "h w"]:
    """Return the central part of a picture, at most 1024 x 1024 pixels, as grey values."""
    top, left = (max(0, size - WIDEST) // 2 for size in frame.shape[:2])
    middle = np.asarray(frame[top : top + WIDEST, left : left + WIDEST], float)
    return middle.mean(axis=2) if middle.ndim == 3 else middle
