"""The contributions of pixels, rows, columns and whole frames to the variances of a level, by
two-way analysis of variance over its frames."""

from dataclasses import dataclass

import numpy as np

from .live_pixels import LivePixels


@dataclass(frozen=True)
class TemporalVariance:
    """The parts of a pixel's temporal variance. Without an effect its estimates scatter about 0.

    Attributes:
        pixels: independent noise of each pixel, DN^2.
        rows: noise that the pixels of a row share, DN^2.
        columns: noise that the pixels of a column share, DN^2.
        frames: noise that all pixels share, as light or black level drifts, DN^2.
    """

    pixels: float
    rows: float
    columns: float
    frames: float

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
        """Add the squares of one more frame, minus the first and without its shift of the mean."""
        for axis, squares in enumerate(self._squares):
            squares += weight * self._live.line_means(deviation, axis) ** 2

    def temporal(
        self, total: np.ndarray, variance: float, wandering: float, count: int
    ) -> TemporalVariance:
        """The variances of pixels, rows, columns and whole frames between frames.

        Args:
            total: (h, w) sum of the frames, DN.
            variance: T, averaged over the pixels, DN^2.
            wandering: W, variance of the frames' means, DN^2.
            count: number of frames, the first included.

        Returns:
            The parts, DN^2; where a frame is a single row or column, its lines are pixels.
        """
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
        """The fixed variances of rows and columns.

        Args:
            average: (h, w) average of all frames, DN.
            temporal: variance parts of these frames; the average retains a share of them.
            count: number of frames.

        Returns:
            Variances of rows and of columns, DN^2; 0 where a frame is a single row or column.
        """
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
