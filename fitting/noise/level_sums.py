"""Statistics of the frames of one level, one frame in memory at a time."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..frame_checks.frame import FrameSample, frame_sample
from .live_pixels import LivePixels, hits
from .neighbours import Neighbours
from .periodic import quarters, residues
from .raw_frames import BLOCK, block_products, combs, local_variance


@dataclass(frozen=True)
class TemporalVariance:
    """The parts of a pixel's temporal variance. Without an effect its estimates scatter about 0."""

    pixels: float  # independent noise of each pixel, DN^2
    rows: float  # noise that the pixels of a row share, DN^2
    columns: float  # noise that the pixels of a column share, DN^2
    frames: float  # noise that all pixels share, as light or black level drifts, DN^2

    @property
    def of_a_pixel(self) -> float:
        """The variance of a pixel without drift, DN^2."""
        return max(self.pixels + self.rows + self.columns, 0.0)


class Moments:
    """Sums over the frames of a level, from which its shared variances follow.

    T is the temporal variance of a pixel. Q_rows and Q_columns are the mean variances of the lines'
    means about the frame's mean, and W is the variance of the frames' means. The parts solve

        (T, Q_rows, Q_columns) = A (pixels, rows, columns),
        frames = W - b (pixels, rows, columns),

    where A and b are `LivePixels.variance_shares`. If all h x w pixels are valid,

        pixels = (T - Q_rows - Q_columns) / ((1 - 1 / h) (1 - 1 / w)),
        rows = Q_rows / (1 - 1 / h) - pixels / w,        columns likewise,
        frames = W - rows / h - columns / w - pixels / (h w).

    Each part is unbiased, whatever the others are. Without row and column effects the expected sum
    of the three is T (h w) / (h w - 1).
    """

    def __init__(self, live: LivePixels) -> None:
        self._live = live
        self._squares = [np.zeros(size) for size in live.mask.shape]
        self._shares = live.variance_shares()

    def add(self, deviation: np.ndarray, *, weight: float = 1.0) -> None:
        """Add the squares of a further frame, after subtracting the first frame and the shift of
        the mean."""
        for axis, squares in enumerate(self._squares):
            squares += weight * self._live.line_means(deviation, axis) ** 2

    def temporal(
        self, total: np.ndarray, variance: float, wandering: float, count: int
    ) -> TemporalVariance:
        """The variances of pixels, rows, columns and whole frames between `count` frames, DN^2.

        `total` is the sum of the frames (DN), `variance` T averaged over the pixels, and
        `wandering` W. If a frame is a single row or column, its lines are single pixels."""
        of_rows, of_columns = (
            float(np.nanmean(count * squares - self._live.line_means(total, axis) ** 2))
            / (count * (count - 1))
            for axis, squares in enumerate(self._squares)
        )
        parts = self._parted(variance, of_rows, of_columns)
        pixels, rows, columns = parts.tolist()
        return TemporalVariance(pixels, rows, columns, wandering - float(self._shares[3] @ parts))

    def fixed(
        self, average: np.ndarray, temporal: TemporalVariance, count: int
    ) -> tuple[float, float]:
        """The fixed variances of rows and of columns, DN^2, from the average of `count` frames,
        which retains a share of the temporal parts; 0 where a frame is a single row or column."""
        if min(self._live.shape) == 1:
            return 0.0, 0.0
        away = average - self._live.mean(average)
        of_rows, of_columns = (
            float(np.nanmean(self._live.line_means(away, axis) ** 2)) for axis in (0, 1)
        )
        _, rows, columns = self._parted(self._live.mean(away**2), of_rows, of_columns)
        return float(rows - temporal.rows / count), float(columns - temporal.columns / count)

    def _parted(self, total: float, of_rows: float, of_columns: float) -> np.ndarray:
        """The parts for pixels, rows and columns."""
        if min(self._live.shape) == 1:
            return np.array([total / self._shares[0, 0], 0.0, 0.0])
        return np.linalg.solve(self._shares[:3], [total, of_rows, of_columns])


UNEVEN = 3.0  # standard errors from which light counts as uneven
LEAST_FLICKER = 1e-5  # share of a pixel's variance below which lamp flicker is not removed


class Unlit(NamedTuple):
    """A level without light."""

    mean: float  # DN
    variance: float  # temporal variance, DN^2


class LevelStatistics(NamedTuple):
    """The statistics of one level."""

    numbers: dict[str, float | np.ndarray]  # fields of `Levels`
    lines: tuple[float, ...]  # variances of rows, columns, fixed rows, fixed columns, frames, DN^2
    live: LivePixels
    shown: tuple[FrameSample, ...]
    hits: int  # pixels of single frames that were replaced


class LevelSums:
    """Sums over the frames of a level. They use deviations from the first frame, so that S2 and
    S1^2 are small and their difference keeps its precision.

    `top` is the DN from which a pixel is saturated, `unlit` has mean and variance of a flat's
    darks, and `corner` is the position of a frame's first pixel in its file."""

    def __init__(
        self,
        first: np.ndarray,
        top: float,
        live: LivePixels,
        unlit: Unlit | None = None,
        *,
        corner: tuple[int, int] = (0, 0),
    ) -> None:
        self.first, self.live = first, live
        self.shown: list[FrameSample] = []
        self._top, self._unlit, self._corner = top, unlit, corner
        self._total, self._squares = np.zeros_like(first), np.zeros_like(first)
        self._shifted = np.zeros_like(first)
        self._shifts: list[float] = []
        self._lines, self._neighbours = Moments(live), Neighbours(live)
        self._blocks = np.zeros((2, BLOCK))
        self.hits = 0

    def add(self, name: str, frame: np.ndarray) -> None:
        """Add the first or a further frame."""
        deviation = frame - self.first
        if self.shown and (jumps := hits(deviation, self.live)) is not None:
            deviation = jumps.change
            self.hits += int(jumps.up.sum() + jumps.down.sum())
            if len(self.shown) == 1:  # so that the following frames are compared with the first
                self.first = np.where(jumps.down, frame - deviation, self.first)
                self.shown[0] = self._sample_of(self.shown[0].name, self.first)
            frame = self.first + deviation
        self.shown.append(self._sample_of(name, frame))
        self._shifts.append(self.live.mean(deviation))
        if len(self.shown) == 1:
            return
        # A drift of the light between frames shifts all pixels together. It is not pixel noise, and
        # products would mix the two.
        deviation = self.live.only(deviation - self._shifts[-1])
        self._total += deviation
        if self._unlit is not None:
            self._shifted += self._shifts[-1] * deviation
        self._add_squares(deviation)

    def _sample_of(self, name: str, frame: np.ndarray) -> FrameSample:
        return frame_sample(name, self.live.filled(frame), top=self._top)

    def _add_squares(self, deviation: np.ndarray, *, weight: float = 1.0) -> None:
        self._squares += weight * deviation**2
        self._lines.add(deviation, weight=weight)
        self._neighbours.add(deviation, weight=weight)
        self._blocks += weight * block_products(deviation, self.live)

    def _without_flicker(self, average: np.ndarray) -> float:
        """Remove the effect of a flickering lamp on the unevenness of its light.

        A frame with a relative excess e_f of light exceeds the mean by e_f P at a pixel that
        differs by P from the mean. With s^2 the sum of e_f^2, the component sum_f (e_f / s) d_f of
        the frames contains s P, and all components orthogonal to it contain none. P is taken from
        the average frame, including its noise.
        """
        if self._unlit is None:
            return 1.0
        shifts, count = np.array(self._shifts), len(self._shifts)
        size = float(np.sum((shifts - shifts.mean()) ** 2))
        mean = self.live.mean(average)
        signal = mean - self._unlit.mean
        if size == 0 or signal <= 0:
            return 1.0
        pattern = self.live.only(average - mean)
        temporal = (self._squares.sum() - (self._total**2).sum() / count) / (count - 1)
        noise = temporal / count
        uneven = float(np.sum(pattern**2)) - noise
        share = size / signal**2
        seen = uneven > UNEVEN * noise * np.sqrt(2 / self.live.count)
        if not seen or share * uneven < LEAST_FLICKER * temporal * (count - 1):
            return 1.0
        pattern *= np.sqrt(share)
        along = (self._shifted - shifts.mean() * self._total) / np.sqrt(size)
        self._add_squares(along - pattern)
        self._add_squares(along, weight=-1.0)
        # `along` has more shot noise than the mean frame, because shot noise grows with the light.
        shot = 1 - self._unlit.variance * self.live.count / max(temporal, 1e-300)
        return 1 + (1 - 2 * shot) * share / (count * (count - 1))

    def level(self) -> LevelStatistics:
        """The statistics of two frames or more."""
        count, total, live = len(self.shown), self._total, self.live
        average = self.first + total / count + np.mean(self._shifts)
        excess = self._without_flicker(average)
        temporal = (count * self._squares - total**2) / (count * (count - 1) * excess)
        wandering = float(np.var(self._shifts, ddof=1))
        parts = self._lines.temporal(total, live.mean(temporal), wandering, count)
        variance = parts.of_a_pixel
        # The mean of a frame includes the noise of its own pixels, which was subtracted with it.
        lost = wandering - parts.frames
        temporal += lost
        covariances = self._neighbours.covariances(total, variance, lost, count)
        passing = variance - (covariances[0, 1] + covariances[1, 0]) / 2
        products = count * self._blocks - block_products(total, live)
        return LevelStatistics(
            {
                "mean": live.mean(average),
                "variance": variance,
                "spatial_variance": float(average[live.mask].var(ddof=1)),
                "frames": float(count),
                "trend": float(np.polyfit(np.arange(count), self._shifts, 1)[0]),
                "covariances": covariances,
                "residues": residues(average, temporal, live),
                "quarters": quarters(average, temporal, live),
                "local_pattern": local_variance(average, live) - passing / count,
                "blocks": products / (count * (count - 1)) + lost,
                "combs": combs(self.first, corner=self._corner),
            },
            lines=(
                *(parts.rows, parts.columns),
                *self._lines.fixed(average, parts, count),
                parts.frames,
            ),
            live=live,
            shown=tuple(self.shown),
            hits=self.hits,
        )
