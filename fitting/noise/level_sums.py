"""Statistics of the frames of one level, one frame in memory at a time."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from ..frame_checks.frame import FrameSample, frame_sample
from .live_pixels import LivePixels, hits, neighbour_products
from .periodic import quarters, residues
from .raw_frames import block_products, combs, local_variance


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


def temporal_variance(
    live: LivePixels, pixels: float, rows: float, columns: float, frames: float
) -> TemporalVariance:
    """The variances of pixels, rows, columns and whole frames between frames, DN^2, from those of a
    pixel, T, of the lines' means about the frame's mean, Q_rows and Q_columns, and of the frames'
    means, W. The parts solve

        (T, Q_rows, Q_columns) = A (pixels, rows, columns),
        frames = W - b (pixels, rows, columns),

    where A and b are `LivePixels.variance_shares`. If all h x w pixels are valid,

        pixels = (T - Q_rows - Q_columns) / ((1 - 1 / h) (1 - 1 / w)),
        rows = Q_rows / (1 - 1 / h) - pixels / w,        columns likewise,
        frames = W - rows / h - columns / w - pixels / (h w).

    Each part is unbiased, whatever the others are. Without row and column effects the expected sum
    of the three is T (h w) / (h w - 1). If a frame is a single row or column, its lines are single
    pixels.
    """
    parts = _parted(live, pixels, rows, columns)
    pixels, rows, columns = parts.tolist()
    frames -= float(live.variance_shares[3] @ parts)
    return TemporalVariance(pixels, rows, columns, frames)


def fixed_variance(
    live: LivePixels, average: np.ndarray, temporal: TemporalVariance, count: int
) -> tuple[float, float]:
    """The fixed variances of rows and of columns, DN^2, from the average of `count` frames, which
    retains a share of the temporal parts; 0 where a frame is a single row or column."""
    if min(live.shape) == 1:
        return 0.0, 0.0
    away = average - live.mean(average)
    lines = (float(np.nanmean(live.line_means(away, axis) ** 2)) for axis in (0, 1))
    _, rows, columns = _parted(live, live.mean(away**2), *lines)
    return float(rows - temporal.rows / count), float(columns - temporal.columns / count)


def _parted(live: LivePixels, total: float, of_rows: float, of_columns: float) -> np.ndarray:
    """The parts for pixels, rows and columns."""
    if min(live.shape) == 1:
        return np.array([total / live.variance_shares[0, 0], 0.0, 0.0])
    return np.linalg.solve(live.variance_shares[:3], [total, of_rows, of_columns])


class SquareSums:
    """Sums over frames of functions that are quadratic in a frame, and the variances and
    covariances between the frames that follow from them."""

    def __init__(self, live: LivePixels) -> None:
        self._of: dict[str, Callable[[np.ndarray], np.ndarray]] = {
            "pixels": np.square,
            "rows": lambda frame: live.line_means(frame, 0) ** 2,
            "columns": lambda frame: live.line_means(frame, 1) ** 2,
            "neighbours": neighbour_products,
            "blocks": lambda frame: block_products(frame, live),
        }
        self._sums: dict[str, np.ndarray] = {}

    def add(self, deviation: np.ndarray, *, weight: float = 1.0) -> None:
        """Add a further frame, after subtracting the first frame and the shift of the mean."""
        for name, square in self._of.items():
            self._sums[name] = self._sums.get(name, 0.0) + weight * square(deviation)

    def variance(self, name: str, total: np.ndarray, count: int) -> np.ndarray:
        """The sum of a function over the deviations of `count` frames from their mean, over L - 1;
        `total` is the sum of the frames that were added."""
        return (count * self._sums[name] - self._of[name](total)) / (count * (count - 1))


UNEVEN = 3.0  # standard errors from which light counts as uneven
LEAST_FLICKER = 1e-5  # share of a pixel's variance below which lamp flicker is not removed


class Unlit(NamedTuple):
    """A level without light."""

    mean: float  # DN
    variance: float  # temporal variance, DN^2


class ReducedLevel(NamedTuple):
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
        self._total, self._shifted = np.zeros_like(first), np.zeros_like(first)
        self._shifts: list[float] = []
        self._squares = SquareSums(live)
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
        self._squares.add(deviation)

    def _sample_of(self, name: str, frame: np.ndarray) -> FrameSample:
        return frame_sample(name, self.live.filled(frame), top=self._top)

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
        temporal = float(self._squares.variance("pixels", self._total, count).sum())
        noise = temporal / count
        uneven = float(np.sum(pattern**2)) - noise
        share = size / signal**2
        seen = uneven > UNEVEN * noise * np.sqrt(2 / self.live.count)
        if not seen or share * uneven < LEAST_FLICKER * temporal * (count - 1):
            return 1.0
        pattern *= np.sqrt(share)
        along = (self._shifted - shifts.mean() * self._total) / np.sqrt(size)
        self._squares.add(along - pattern)
        self._squares.add(along, weight=-1.0)
        # `along` has more shot noise than the mean frame, because shot noise grows with the light.
        shot = 1 - self._unlit.variance * self.live.count / max(temporal, 1e-300)
        return 1 + (1 - 2 * shot) * share / (count * (count - 1))

    def level(self) -> ReducedLevel:
        """The statistics of two frames or more."""
        count, total, live = len(self.shown), self._total, self.live
        average = self.first + total / count + np.mean(self._shifts)
        excess = self._without_flicker(average)
        variance_of = partial(self._squares.variance, total=total, count=count)
        temporal = variance_of("pixels") / excess
        wandering = float(np.var(self._shifts, ddof=1))
        rows, columns = (float(np.nanmean(variance_of(name))) for name in ("rows", "columns"))
        parts = temporal_variance(live, live.mean(temporal), rows, columns, wandering)
        variance = parts.of_a_pixel
        # The mean of a frame includes the noise of its own pixels, which was subtracted with it.
        lost = wandering - parts.frames
        temporal += lost
        covariances = variance_of("neighbours") / np.maximum(live.neighbours, 1.0) + lost
        covariances[0, 0] = variance
        passing = variance - (covariances[0, 1] + covariances[1, 0]) / 2
        return ReducedLevel(
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
                "blocks": variance_of("blocks") + lost,
                "combs": combs(self.first, corner=self._corner),
            },
            lines=(
                *(parts.rows, parts.columns),
                *fixed_variance(live, average, parts, count),
                parts.frames,
            ),
            live=live,
            shown=tuple(self.shown),
            hits=self.hits,
        )
