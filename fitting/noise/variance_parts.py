"""What pixels, rows, columns and whole frames add to the variances of a level, parted by two-way
analysis of variance over its frames."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class TemporalVariance:
    """What adds up to the temporal variance of a pixel; estimates that scatter about 0 without any.

    Attributes:
        pixels: of each pixel by itself, DN^2.
        rows: that the pixels of a row share, DN^2.
        columns: likewise.
        frames: that all pixels share: light or black level that drifts, DN^2.
    """

    pixels: float
    rows: float
    columns: float
    frames: float

    @property
    def of_a_pixel(self) -> float:
        """Without drift, which is no noise of pixels, DN^2."""
        return max(self.pixels + self.rows + self.columns, 0.0)


class Moments:
    """Sums over the frames of a level, from which its shared variances follow."""

    def __init__(self, first: np.ndarray) -> None:
        self._lines = [np.zeros(first.shape[axis]) for axis in (0, 1)]
        self._squares = [np.zeros(first.shape[axis]) for axis in (0, 1)]
        self._shape, self._count = first.shape, 1

    def add(self, deviation: np.ndarray) -> None:
        """One more frame, less the first."""
        self._count += 1
        for axis in (0, 1):
            means = deviation.mean(axis=1 - axis)
            self._lines[axis] += means
            self._squares[axis] += means**2

    def temporal(self, total: float, wandering: float) -> TemporalVariance:
        """What pixels, rows, columns and whole frames add from frame to frame: with T the temporal
        variance of pixels, W that of the frames' means, and Q those of rows' and of columns' means,

            pixels = (T + W - Q_rows - Q_columns) / ((1 - 1 / h) (1 - 1 / w)),
            rows = (Q_rows - W) / (1 - 1 / h) - pixels / w,        columns likewise,
            frames = W - rows / h - columns / w - pixels / (h w).

        Args:
            total: T, averaged over the pixels, DN^2.
            wandering: W, DN^2.

        Returns:
            The parts, DN^2; lines are pixels where a frame is a single row or column.
        """
        count, (h, w) = self._count, self._shape
        if min(h, w) == 1:
            pixels = (total - wandering) / (1 - 1 / (h * w))
            return TemporalVariance(pixels, 0.0, 0.0, wandering - pixels / (h * w))
        rows, columns = (
            float(np.mean(count * self._squares[axis] - self._lines[axis] ** 2))
            / (count * (count - 1))
            - wandering
            for axis in (0, 1)
        )
        pixels = (total - wandering - rows - columns) / ((1 - 1 / h) * (1 - 1 / w))
        rows = rows / (1 - 1 / h) - pixels / w
        columns = columns / (1 - 1 / w) - pixels / h
        frames = wandering - rows / h - columns / w - pixels / (h * w)
        return TemporalVariance(pixels, rows, columns, frames)

    def fixed(self, average: np.ndarray, temporal: TemporalVariance) -> tuple[float, float]:
        """What rows and columns add that stays.

        Args:
            average: (h, w) of all frames, DN.
            temporal: of these frames, which an average keeps a share of.

        Returns:
            Variances of rows and of columns, DN^2; 0 where a frame is a single row or column.
        """
        h, w = self._shape
        if min(h, w) == 1:
            return 0.0, 0.0
        rows, columns = average.mean(axis=1), average.mean(axis=0)
        rest = average - rows[:, None] - columns + average.mean()
        pixels = float(np.sum(rest**2)) / ((h - 1) * (w - 1))
        return (
            float(rows.var(ddof=1)) - pixels / w - temporal.rows / self._count,
            float(columns.var(ddof=1)) - pixels / h - temporal.columns / self._count,
        )
