"""Statistics of the frames of one light level, computed with one frame in memory at a time."""

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
    """The temporal variance of a pixel, divided into independent noise and noise shared by rows,
    columns and whole frames. Estimates of an absent part scatter about 0."""

    pixels: float  # independent noise of each pixel, DN^2
    rows: float  # noise that the pixels of a row share, DN^2
    columns: float  # noise that the pixels of a column share, DN^2
    frames: float  # noise that all pixels share, as light or black level drifts, DN^2

    @property
    def pixel_variance(self) -> float:
        """The temporal variance of a pixel about the frame's mean, DN^2, at least 0."""
        return max(self.pixels + self.rows + self.columns, 0.0)


def temporal_variance(
    live: LivePixels, pixels: float, rows: float, columns: float, frames: float
) -> TemporalVariance:
    """Divide the temporal variance into parts of pixels, rows, columns and whole frames, DN^2. The
    arguments are variances between frames. `pixels` is the variance T of a pixel about the frame's
    mean. `rows` and `columns` are the variances Q_rows and Q_columns of the means of rows and of
    columns about the frame's mean. `frames` is the variance W of the frames' means. In the
    formulas, pixels, rows, columns and frames are the returned parts, which solve

        (T, Q_rows, Q_columns) = A (pixels, rows, columns),
        frames = W - b (pixels, rows, columns),

    where A is the first three rows of `LivePixels.variance_shares` and b the last. If all h x w
    pixels are valid,

        pixels = (T - Q_rows - Q_columns) / ((1 - 1 / h) (1 - 1 / w)),
        rows = Q_rows / (1 - 1 / h) - pixels / w,        columns likewise,
        frames = W - rows / h - columns / w - pixels / (h w).

    Each estimate is unbiased, whatever the sizes of the other parts. Without noise of rows and
    columns, the expected sum of the parts of pixels, rows and columns is T (h w) / (h w - 1). If a
    frame is a single row or column, all noise counts as noise of pixels.
    """
    parts = _separate_variances(live, pixels, rows, columns)
    pixels, rows, columns = parts.tolist()
    frames -= float(live.variance_shares[3] @ parts)
    return TemporalVariance(pixels, rows, columns, frames)


def fixed_variance(
    live: LivePixels, average: np.ndarray, temporal: TemporalVariance, count: int
) -> tuple[float, float]:
    """Return fixed variances of rows and columns, DN^2, from an average of `count` frames."""
    if min(live.shape) == 1:
        return 0.0, 0.0
    away = average - live.mean(average)
    lines = (float(np.nanmean(live.line_means(away, axis) ** 2)) for axis in (0, 1))
    _, rows, columns = _separate_variances(live, live.mean(away**2), *lines)
    return float(rows - temporal.rows / count), float(columns - temporal.columns / count)


def _separate_variances(
    live: LivePixels, total: float, of_rows: float, of_columns: float
) -> np.ndarray:
    """Solve for the variances of pixels, rows and columns."""
    if min(live.shape) == 1:
        return np.array([total / live.variance_shares[0, 0], 0.0, 0.0])
    return np.linalg.solve(live.variance_shares[:3], [total, of_rows, of_columns])


class SquareSums:
    """Sums of squares and products over a level's frames, for variances between frames."""

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
        """Add a frame's deviation from the first frame, without the shift of its mean."""
        for name, square in self._of.items():
            self._sums[name] = self._sums.get(name, 0.0) + weight * square(deviation)

    def variance(self, name: str, total: np.ndarray, count: int) -> np.ndarray:
        """Return the variance (or covariance) `name` between frames; `total` sums deviations."""
        return (count * self._sums[name] - self._of[name](total)) / (count * (count - 1))


UNEVENNESS_SIGMAS = 3.0  # standard errors from which light counts as uneven
LEAST_FLICKER = 1e-5  # share of a pixel's variance below which lamp flicker is not removed


class Unlit(NamedTuple):
    """Mean and temporal variances of the darks of a light level."""

    mean: float  # DN
    variance: float  # temporal variance, DN^2
    rows: float = 0.0  # temporal variance that the pixels of a row share, DN^2
    columns: float = 0.0  # the same of a column, DN^2


class ReducedLevel(NamedTuple):
    """The statistics of the frames of one level."""

    numbers: dict[str, float | np.ndarray]  # fields of `Levels`
    lines: tuple[float, ...]  # variances of rows, columns, fixed rows, fixed columns, frames, DN^2
    live: LivePixels
    shown: tuple[FrameSample, ...]
    hits: int  # pixels of single frames that were replaced


class LevelSums:
    """Running sums over the frames of a level. The sums are of deviations from the first frame,
    which are small, so that differences of sums are accurate.

    `top` is the DN from which a pixel is saturated, `unlit` has mean and variance of a flat's
    darks, and `corner` is the row and column of the frame's first pixel in its file."""

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
        """Add a frame; the first one added is the reference."""
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
        deviation = self.live.zero_invalid(deviation - self._shifts[-1])
        self._total += deviation
        if self._unlit is not None:
            self._shifted += self._shifts[-1] * deviation
        self._squares.add(deviation)

    def _sample_of(self, name: str, frame: np.ndarray) -> FrameSample:
        return frame_sample(name, self.live.filled(frame), top=self._top)

    def _remove_flicker(self, average: np.ndarray) -> float:
        """Remove from the sums the temporal variance that a flickering lamp causes where its light
        is uneven. Return the factor by which the remaining variance is too large, because the
        average frame that estimates the pattern of the light contains noise.

        Let P be the deviation of a pixel's light from the mean of the frame, e_f the relative
        excess of light in frame f, and d_f the deviation of the pixel in frame f from its mean over
        frames. The flicker adds e_f P to d_f. With s^2 the sum of e_f^2, the component sum_f (e_f /
        s) d_f contains s P, which is subtracted. Components orthogonal to this one do not contain
        P. The deviation P is estimated by the average frame, including its noise.
        """
        if self._unlit is None:
            return 1.0
        shifts, count = np.array(self._shifts), len(self._shifts)
        size = float(np.sum((shifts - shifts.mean()) ** 2))
        mean = self.live.mean(average)
        signal = mean - self._unlit.mean
        if size == 0 or signal <= 0:
            return 1.0
        pattern = self.live.zero_invalid(average - mean)
        temporal = float(self._squares.variance("pixels", self._total, count).sum())
        noise = temporal / count
        uneven = float(np.sum(pattern**2)) - noise
        share = size / signal**2
        seen = uneven > UNEVENNESS_SIGMAS * noise * np.sqrt(2 / self.live.count)
        if not seen or share * uneven < LEAST_FLICKER * temporal * (count - 1):
            return 1.0
        pattern *= np.sqrt(share)
        along = (self._shifted - shifts.mean() * self._total) / np.sqrt(size)
        self._squares.add(along - pattern)
        self._squares.add(along, weight=-1.0)
        # `along` has more shot noise than the mean frame, because shot noise grows with the light.
        shot = 1 - self._unlit.variance * self.live.count / max(temporal, 1e-300)
        return 1 + (1 - 2 * shot) * share / (count * (count - 1))

    def _band_variance(
        self, average: np.ndarray, parts: TemporalVariance, of_lines: tuple[np.ndarray, np.ndarray]
    ) -> np.ndarray | float:
        """Return the temporal variance of each pixel, DN^2, that bands add where the light of a row
        (or column) is uneven.

        Under a flickering lamp, a rolling shutter multiplies the light of a row in a frame by 1 +
        e. The mean of the row then changes by e times its mean signal, and a pixel in addition by e
        times the deviation P of its signal from this mean. This adds the variance e^2 P^2, which
        noise shared by a row does not contain.
        """
        if self._unlit is None or min(self.live.shape) == 1:
            return 0.0
        added, frames = np.zeros(average.shape), len(self.shown)
        unlit = self._unlit.rows, self._unlit.columns
        for axis, (own, dark) in enumerate(zip(of_lines, unlit, strict=True)):
            lines, across = self.live.shape[axis], self.live.shape[1 - axis]
            noise = max(parts.pixels, 0.0) / across + max(dark, 0.0)
            chance = np.sqrt(2 / (frames - 1) / lines)
            if not np.nanmean(own) > (1 + UNEVENNESS_SIGMAS * chance) * noise:
                continue
            middle = np.nan_to_num(self.live.line_means(average, axis), nan=self._unlit.mean)
            signal = middle - self._unlit.mean
            shown = np.isfinite(own) & (signal > 0)
            share = np.where(shown, own - noise, 0.0) / np.where(shown, signal, 1.0) ** 2
            share, middle = (np.expand_dims(x, 1 - axis) for x in (share, middle))
            added += share * self.live.zero_invalid(average - middle) ** 2
        return added if self.live.mean(added) > LEAST_FLICKER * parts.pixel_variance else 0.0

    def level(self) -> ReducedLevel:
        """Return the statistics of the added frames, at least two."""
        count, total, live = len(self.shown), self._total, self.live
        average = self.first + total / count + np.mean(self._shifts)
        excess = self._remove_flicker(average)
        variance_of = partial(self._squares.variance, total=total, count=count)
        temporal = variance_of("pixels") / excess
        wandering = float(np.var(self._shifts, ddof=1))
        of_lines = variance_of("rows"), variance_of("columns")
        rows, columns = (float(np.nanmean(own)) for own in of_lines)
        parts = temporal_variance(live, live.mean(temporal), rows, columns, wandering)
        bands = self._band_variance(average, parts, of_lines)
        if not np.isscalar(bands):
            temporal = temporal - bands
            parts = temporal_variance(live, live.mean(temporal), rows, columns, wandering)
        variance = parts.pixel_variance
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
                "ended": float(np.mean([frame.at_top for frame in self.shown])),
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
