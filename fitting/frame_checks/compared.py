"""Light levels with several frames each, from which the checks remove deviating frames."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from .frame import ALONE, FrameSample, OddFrames

BLOCKS = 16  # of a frame, along each side
SURE = 6.0  # standard deviations from which a frame deviates
UNEVEN, HALF = 0.03, 0.5  # least deviation, relative to the signal and to a pixel's noise
OTHER_NOISE = 1.4  # ratio of variances
MOSTLY = 0.9  # share of the pixels at black or white from which a finding says so
MOST = 0.5  # largest relative flicker of a lamp
TRIMMED = 0.98  # share of the squared residuals that is kept, to drop hot pixels and cosmic rays
FEWEST_TRIMMED = 50
MEDIAN = 0.6745  # median of |z| for a standard normal z


def usual_size(deviates: Sequence[float] | np.ndarray) -> float:
    """Return the standard deviation of normal deviates with mean 0, from the median of their
    absolute values. This estimate is robust as long as fewer than half of the deviates are
    outliers.
    """
    return float(np.median(np.abs(deviates))) / MEDIAN if len(deviates) else 0.0


def beyond_chance(count: int) -> float:
    """Return the limit, in multiples of `usual_size`, that the largest of `count` independent
    normal deviates exceeds with a probability of 1 in 1,000.

    The limit is higher for few deviates, because the median of few deviates is imprecise. Simulated
    quantiles for n = 4 to 100 deviates (at least 400,000 draws) are between 90 and 100 % of 5 + 36
    / n.
    """
    return 5 + 36 / max(count, 1)


class ComparedLevels:
    """The light levels of a series with their frames, from which the checks remove deviating
    frames."""

    def __init__(
        self, frames: list[list[FrameSample]], light: np.ndarray, black: np.ndarray | None
    ) -> None:
        self.frames, self.light, self.black = frames, light, black
        self.odd: list[OddFrames] = []
        self._pixel_noise: dict[tuple, float] = {}  # of levels with these frames
        own = [self.pixel_noise(level) for level in range(len(frames))]
        apart = [a.mean - b.mean for level in frames for a, b in pairwise(level)]
        self.wander = usual_size(apart) / float(np.sqrt(2))  # drift of a frame's mean, DN rms
        self.noise = _noise_of_levels(frames, light, np.array(own))

    def pixel_noise(self, level: int, *, lines: bool = True) -> float:
        """Return the temporal noise of a pixel, DN rms, from the pair of frames that differs least
        without being copies.

        `lines`: whether to include noise that whole rows and columns share."""
        frames = self.frames[level]
        if len(frames) < 2:
            return 0.0
        known = level, lines, *(frame.name for frame in frames)
        if known not in self._pixel_noise:
            black = None if self.black is None else float(self.black[level])
            fields = [a - b for a, b in pairwise(scaled_to_one_mean(frames, black))]
            variances = [trimmed_variance(f if lines else subtract_line_means(f)) for f in fields]
            least = min((v for v in variances if v > 0), default=0.0)
            self._pixel_noise[known] = float(np.sqrt(least / 2))
        return self._pixel_noise[known]

    def means(self, levels: Sequence[int]) -> Float[np.ndarray, " levels"]:
        """Return the median over frames of their means, DN, at some levels that have frames."""
        return np.array([np.median([frame.mean for frame in self.frames[i]]) for i in levels])

    def sample_size(self, level: int) -> int:
        """Return the number of pixels in a frame's sample."""
        return max((frame.sample.size for frame in self.frames[level]), default=0)

    def chance(self, level: int) -> float:
        """Return an upper limit of the rms difference, in DN, that pixel noise causes between the
        means of two frames. The limit is computed for the number of pixels in a frame's sample,
        which is smaller than the number of pixels in its mean."""
        return float(self.noise[level]) * float(np.sqrt(2 / max(self.sample_size(level), 1)))

    def scale(self, level: int) -> float:
        """Return the unit of deviations at a level: signal for flats, noise for darks, DN."""
        if self.black is None:
            return float(max(self.noise[level], 0.1))
        middle = self.means([level])[0]
        return float(max(abs(middle - self.black[level]), 1e-9))

    def floor(self, level: int) -> float:
        """Return the smallest deviation of a frame's mean that matters at a level, DN."""
        if self.black is None:
            return 2 * HALF * self.scale(level)
        return max(UNEVEN * self.scale(level), HALF * self.noise[level])

    def blocks(self, level: int, frame: FrameSample) -> Float[np.ndarray, "rows columns"]:
        """Return the means of blocks minus the frame's mean, divided by signal (flats) or noise
        (darks)."""
        sample = frame.sample.astype(float)
        edges = [np.linspace(0, n, min(BLOCKS, n) + 1)[:-1].astype(int) for n in sample.shape]
        sums = np.add.reduceat(np.add.reduceat(sample, edges[0], 0), edges[1], 1)
        sizes = [np.diff([*starts, n]) for starts, n in zip(edges, sample.shape, strict=True)]
        means = sums / np.outer(*sizes)
        if self.black is None:
            return (means - means.mean()) / self.scale(level)
        signal = abs(float(means.mean() - self.black[level]))
        return (means - means.mean()) / max(signal, self.noise[level], 1e-9)

    def comparable_levels(self, level: int) -> list[int]:
        """Return the indices of the other levels that have at least two frames."""
        return [i for i, frames in enumerate(self.frames) if i != level and len(frames) > 1]

    def expected(self, level: int) -> float | None:
        """Return the mean interpolated from two or more other levels, DN; else None."""
        others = [
            i for i in self.comparable_levels(level) if self.black is None or self.light[i] > 0
        ]
        if len(others) < 2:
            return None
        light = self.light[others]
        means = self.means(others)
        order = np.argsort(light, kind="stable")
        if self.black is None:
            return float(np.interp(self.light[level], light[order], means[order]))
        rates = (means - self.black[others]) / light
        rate = np.interp(self.light[level], light[order], rates[order])
        return float(self.black[level] + rate * self.light[level])

    def remove(self, level: int, reason: str, places: Sequence[int] | None = None) -> None:
        """Remove the frames at `places` in a level (None: all), and record the reason."""
        frames = self.frames[level]
        gone = range(len(frames)) if places is None else places
        self.odd.append(OddFrames(tuple(frames[i].name for i in gone), reason))
        self.frames[level] = [one for i, one in enumerate(frames) if i not in gone]

    def drop_single_frames(self) -> None:
        """Remove levels of one frame, which gives no temporal variance."""
        for level, frames in enumerate(self.frames):
            if len(frames) == 1:
                self.remove(level, ALONE)


def _noise_of_levels(
    frames: Sequence[Sequence[FrameSample]], light: np.ndarray, own: Float[np.ndarray, " levels"]
) -> Float[np.ndarray, " levels"]:
    """Return a pixel's noise at each level, DN rms; for two frames at most twice that of others."""
    found, order = own.copy(), np.argsort(light, kind="stable")
    for i, place in enumerate(order):
        rest = np.delete(order, i)
        if len(frames[place]) == 2 and len(rest) > 1:
            beside = float(np.interp(light[place], light[rest], own[rest]))
            found[place] = min(own[place], 2 * max(beside, float(np.median(own[rest]))))
    return found


def trimmed_variance(residuals: np.ndarray) -> float:
    """Return the mean square about the median, without the largest 2 % of squares."""
    squares = (residuals - np.median(residuals)).ravel().astype(float) ** 2
    if squares.size >= FEWEST_TRIMMED:
        count = int(TRIMMED * squares.size)
        squares = np.partition(squares, count)[:count]
    return float(squares.mean())


def subtract_line_means(field: np.ndarray) -> np.ndarray:
    """Subtract the means of rows and of columns, such as flicker bands under a rolling shutter."""
    of_columns, of_rows = field.mean(axis=0), field.mean(axis=1, keepdims=True)
    return field - of_columns - of_rows + field.mean()


def scaled_to_one_mean(frames: Sequence[FrameSample], black: float | None) -> list[np.ndarray]:
    """Return the samples of frames, adjusted to one common mean. In flats, the signal above the
    black level is scaled, because the lamp may flicker. Darks and very unequal flats are shifted
    instead."""
    means = np.array([frame.mean for frame in frames])
    middle = float(np.median(means))
    if black is None or np.any(means - black <= MOST * (middle - black)):
        return [frame.sample - mean + middle for frame, mean in zip(frames, means, strict=True)]
    scales = (middle - black) / (means - black)
    return [(one.sample - black) * s + black for one, s in zip(frames, scales, strict=True)]


def rms(field: np.ndarray) -> float:
    """Return the root mean square of an array."""
    return float(np.sqrt(np.mean(field**2)))
