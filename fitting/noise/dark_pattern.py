"""Compare the fixed pattern of the darks with that of the flats.

The same sensor in the same state has the same offsets and dark currents of pixels in flats and
darks of one exposure. A flat then contains the pattern of its dark, times a factor c = 1, an
independent pattern of unequal sensitivities, and noise. With darks of another temperature, exposure
or gain, c differs from 1. In the regression for c, one half of the frames of a dark level is the
regressor and the other half the instrumental variable, so that the noise of the darks does not
reduce c. Patterns of rows, columns, quadrants and checkerboards are left out, because amplifiers
may differ in offset and gain.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ..frame_checks.frame import FrameSample
from ..inference.formatting import format_percent, format_with_error
from .emva1288 import least_dark_variance
from .levels import PhotonTransfer, linear_levels, signal_of

SURE = 5.0  # standard errors of c - 1
LEAST = 0.1  # least difference of c from 1
SEEN = 10.0  # standard errors of the variance of the darks' pattern
FEWEST = 4  # levels
OUTLYING = 15.0  # of the median deviation, beyond which a pixel may be stuck or saturated


def dark_pattern_in_words(
    measurement: PhotonTransfer,
    flats: Sequence[Sequence[FrameSample]],
    darks: Sequence[Sequence[FrameSample]],
) -> list[str]:
    """Return a sentence if the flats do not contain exactly the pattern of the darks (c is not
    1)."""
    found = share_of_pattern(measurement, flats, darks)
    if found is None or abs(found[0] - 1) < max(SURE * found[1], LEAST):
        return []
    share, error = found
    dark, times = measurement.dark, np.asarray(measurement.dark.exposure)
    change = "."
    if np.ptp(times) > 0:
        usable = linear_levels(measurement)
        rate = float(np.polyfit(times, np.asarray(dark.mean), 1)[0])
        lit = np.asarray(measurement.bright.exposure)[usable] / signal_of(measurement)[usable]
        moved = (share - 1) * rate * float(np.median(lit))
        change = (
            f": if dark current alone differs, by {format_percent(abs(moved))} too "
            f"{'large' if moved > 0 else 'small'}."
        )
    return [
        f"The fixed pattern of the darks is in the flats {format_with_error(share, error)} times, "
        "and not once: the darks were taken at another temperature, exposure time or gain. Dark "
        "current, dark noise and DSNU are those of the darks, and the signal of the flats, from "
        f"which the darks were subtracted, is wrong{change} Take darks at the conditions of the "
        "flats."
    ]


def share_of_pattern(
    measurement: PhotonTransfer,
    flats: Sequence[Sequence[FrameSample]],
    darks: Sequence[Sequence[FrameSample]],
) -> tuple[float, float] | None:
    """Return c and its standard error; None where the darks show no pattern."""
    usable, of_dark = linear_levels(measurement), np.asarray(measurement.dark_of)
    fine = float(np.min(np.asarray(measurement.dark.variance))) > 2 * least_dark_variance(
        measurement
    )
    shapes = {frame.sample.shape for level in (*flats, *darks) for frame in level}
    known = [darks[i] for i in {*of_dark[usable]}]
    clipped = any(frame.at_bottom > 0 for level in known for frame in level)
    fewest = min((len(level) for level in known), default=0)
    if not fine or clipped or fewest < 2 or len(shapes) != 1 or len(usable) < FEWEST:
        return None

    def pattern(frames: Sequence[FrameSample]) -> Float[np.ndarray, " pixels"]:
        return _of_pixels(np.mean([frame.sample for frame in frames], axis=0, dtype=float))

    halves = {i: (pattern(darks[i][::2]), pattern(darks[i][1::2])) for i in {*of_dark[usable]}}
    square, product, seen, scores = 0.0, 0.0, 0.0, [0.0, 0.0]
    for level in usable:
        first, second = halves[of_dark[level]]
        y = pattern(flats[level])
        away = np.abs(first + second)
        kept = away < OUTLYING * np.median(away)  # stuck and saturated pixels are the same in both
        first, second, y = (kept * one for one in (first, second, y))
        weight = 1 / np.var(y)
        for x, z in ((first, second), (second, first)):
            square = square + weight * (x @ z)
            seen = seen + weight * x * z
            product = product + weight * (z @ y)
            scores = [scores[0] + weight * z * y, scores[1] + weight * z * x]
    if square < SEEN * np.sqrt(np.sum(seen**2)):
        return None
    share = product / square
    error = float(np.sqrt(np.sum((scores[0] - share * scores[1]) ** 2)) / square)
    return float(share), error


def _of_pixels(mean: Float[np.ndarray, "rows columns"]) -> Float[np.ndarray, " pixels"]:
    """Return the pattern of single pixels, without structures that rows or columns share."""
    y, x = np.indices(mean.shape)
    sides = [np.where(2 * one < n, -1, 1) for one, n in zip((y, x), mean.shape, strict=True)]
    across, down = x - x.mean(), y - y.mean()
    terms = [across * down, sides[0] * sides[1], (-1.0) ** (x + y)]

    def single(one: np.ndarray) -> np.ndarray:
        rows, columns = one.mean(axis=1, keepdims=True), one.mean(axis=0, keepdims=True)
        return (one - rows - columns + one.mean()).ravel()

    basis = np.linalg.qr(np.stack([single(one.astype(float)) for one in terms], axis=-1))[0]
    left = single(mean)
    return left - basis @ (basis.T @ left)
