"""Detection of dead, stuck and hot pixels, and statistics over all other pixels.

A dead or stuck pixel has the same number in the dark and under light. A hot pixel is far above (or
below) the others in the dark, usually because its dark current is larger. Such pixels are excluded
from means and variances, and from the number of pixels on which errors depend. If columns, rows or
mosaic sites have separate converters, pixels whose converter has a bit that never changes are
excluded, too.

Outliers in single frames, such as hits by cosmic rays, can increase a variance by more than the
noise of all pixels. Such outliers are recognised by a gap between their values and those of all
other pixels. A noise distribution with a long tail (few electrons, multiplied electrons, warm
pixels) has no such gap.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

# Noise of a pixel over a bit's value from which both states of the bit occur
LEAST_NOISE_RATIO = 0.5
FEWEST = 64  # pixels of a line in which both states must then occur
MOST_LINES = 0.75  # of the lines; a bit stuck in more of them makes the converter's own grid
SHOWN_LINES = 4  # lines that are listed
SITES = 2  # rows and columns of a cell
LARGEST_LAG = 3  # rows and columns up to which pixels count as neighbours


class StuckBit(NamedTuple):
    """A bit of the code that never changes in some pixels."""

    where: str  # in which pixels, in words
    bit: int  # index of the bit, 0 the lowest
    value: int  # the value that the bit always has
    mask: Bool[np.ndarray, "h w"]  # true in these pixels

    @property
    def clause(self) -> str:
        """A clause for the report that states the pixels and the bit."""
        return (
            f"in {self.where}, where bit {self.bit} of the codes is always {self.value} and half "
            "of the codes never occur"
        )


def stuck_bits(frames: Sequence[np.ndarray]) -> list[StuckBit]:
    """Find bits that never change in some columns, rows or sites of a 2 x 2 mosaic.

    Example:
        >>> from fitting.noise.live_pixels import stuck_bits
        >>> frames = np.random.default_rng(0).normal(900, 20, (4, 50, 60)).round()
        >>> frames[:, :, 7] = frames[:, :, 7].astype(int) | 8
        >>> print(stuck_bits(list(frames))[0].clause[:53])
        in column 7, where bit 3 of the codes is always 1 and
    """
    if len(frames) < 2 or not all(np.array_equal(one, np.floor(one)) for one in frames[:2]):
        return []
    noise = float(np.median(np.abs(frames[1] - frames[0]))) / 0.9539
    highest = int(np.floor(np.log2(noise / LEAST_NOISE_RATIO))) if noise > LEAST_NOISE_RATIO else -1
    whole = [one.astype(np.int64) for one in frames if one.min() >= 0]
    if highest < 0 or len(whole) < 2:
        return []
    places = np.indices(whole[0].shape)
    rows, columns = places[0], places[1]
    sites = SITES * (rows % SITES) + columns % SITES
    for name, line in (("column", columns), ("row", rows), ("site", sites)):
        if found := _stuck(whole, name, line, highest):
            return found
    return []


def _stuck(
    frames: Sequence[np.ndarray], name: str, line: np.ndarray, highest: int
) -> list[StuckBit]:
    order = np.argsort(line, axis=None, kind="stable")
    starts = np.searchsorted(line.ravel()[order], np.arange(int(line.max()) + 1))
    if np.diff(starts, append=line.size).min() * len(frames) < FEWEST:
        return []
    every = [one.ravel()[order] for one in frames]
    always = np.bitwise_and.reduce([np.bitwise_and.reduceat(one, starts) for one in every])
    ever = np.bitwise_or.reduce([np.bitwise_or.reduceat(one, starts) for one in every])
    changes = ever & ~always
    alive = (np.array([int(x).bit_count() for x in changes])) > 1
    found = []
    for bit in range(highest + 1):
        still = (changes >> bit & 1 == 0) & alive
        for value in (0, 1):
            own = np.flatnonzero(still & (always >> bit & 1 == value))
            if len(own) and still.sum() <= MOST_LINES * len(changes):
                found.append(StuckBit(_words(name, own), bit, value, np.isin(line, own)))
    return found


def _words(name: str, lines: np.ndarray) -> str:
    if name == "site":
        places = ", ".join(f"({i // SITES}, {i % SITES})" for i in lines)
        return f"the pixels of row and column {places} of every cell of 2 x 2"
    if len(lines) == 1:
        return f"{name} {lines[0]}"
    listed = ", ".join(str(i) for i in lines[:SHOWN_LINES])
    if len(lines) <= SHOWN_LINES:
        return f"{name}s {listed}"
    return f"{len(lines)} {name}s ({listed}, ...)"


DEAD_SIGNAL_SHARE = 0.1  # share of the signal of most pixels below which a pixel is dead
LIT = 20.0  # least signal for this test, relative to a pixel's noise
OUTLIER_SIGMAS = 6.0  # standard deviations from the other pixels in every dark frame of an exposure
DECILE = 1.2816  # standard deviations of a normal distribution from its middle to a decile
MOST = 0.1  # share of the pixels; of more, something else is the cause
MOST_COVERED = 0.5  # share of the pixels in rows and columns at a border that light never reaches
SHOWN = 6  # rows, columns or pixels that are listed


def line_products(x: Float[np.ndarray, "h w"]) -> tuple[np.ndarray, np.ndarray]:
    """Return sums of products of neighbours, one for each pair of rows, then of columns."""
    below = np.einsum("ij,ij->i", x[:-1], x[1:])
    beside = np.einsum("ij,ij->j", x[:, :-1], x[:, 1:])
    return below, beside


def neighbour_products(x: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "lags lags"]:
    """Return, for each offset of 0 to `LARGEST_LAG` rows and columns, the sum of x_p x_q over all
    pairs of pixels p and q at that distance. Offsets of both signs are added. Offsets larger than
    the frame give 0."""
    rows, columns = (min(LARGEST_LAG, size - 1) for size in x.shape)
    width, found = x.shape[1] + columns, np.zeros((LARGEST_LAG + 1, LARGEST_LAG + 1))
    flat = np.pad(x, ((0, 0), (0, columns))).ravel()  # zeros beside the frame
    for i, j in product(range(rows + 1), range(columns + 1)):
        for apart in {i * width + j, abs(i * width - j)}:
            found[i, j] += flat[: flat.size - apart] @ flat[apart:]
    return found


class LivePixels:
    """The (h, w) mask of the valid pixels of a frame, and statistics over these pixels."""

    def __init__(self, mask: Bool[np.ndarray, "h w"]) -> None:
        self.mask, self.count = mask, int(mask.sum())
        self._all = self.count == mask.size
        self._of_line = [mask.sum(axis=1), mask.sum(axis=0)]

    @cached_property
    def pairs_by_line(self) -> tuple[np.ndarray, np.ndarray]:
        """The numbers of valid pairs of neighbours, in the order of `line_products`."""
        return line_products(self.mask.astype(float))

    @cached_property
    def neighbours(self) -> Float[np.ndarray, "lags lags"]:
        """The numbers of pairs of valid pixels at each offset, as in `neighbour_products`."""
        return neighbour_products(self.mask.astype(float))

    @property
    def shape(self) -> tuple[int, int]:
        """The number of rows and of columns with at least one valid pixel."""
        rows, columns = (int((of > 0).sum()) for of in self._of_line)
        return rows, columns

    def zero_invalid(self, plane: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
        """Return the plane with 0 at invalid pixels."""
        return plane if self._all else np.where(self.mask, plane, 0.0)

    def mean(self, plane: Float[np.ndarray, "h w"]) -> float:
        """Return the mean of a plane over the valid pixels."""
        return float(self.zero_invalid(plane).sum()) / self.count

    def line_means(self, plane: Float[np.ndarray, "h w"], axis: int) -> np.ndarray:
        """Return means of rows (axis 0) or columns (1) over valid pixels; NaN without any."""
        sums = self.zero_invalid(plane).sum(axis=1 - axis)
        counts = self._of_line[axis]
        return np.divide(sums, counts, out=np.full(len(sums), np.nan), where=counts > 0)

    def filled(self, plane: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
        """Return the plane with the mean of its valid pixels at invalid pixels."""
        return plane if self._all else np.where(self.mask, plane, self.mean(plane))

    @cached_property
    def variance_shares(self) -> Float[np.ndarray, "4 3"]:
        """(4, 3) expected variances of four quantities under three kinds of noise of variance 1.
        The rows of the result are the quantities: a pixel, the means of rows and the means of
        columns, each about the frame's mean, and the frame's mean. The columns of the result are
        the kinds of noise: independent for each pixel, for each row, and for each column."""
        counts = [of[of > 0].astype(float) for of in self._of_line]
        n, lines = float(self.count), [of.size for of in counts]
        inverse = [float(np.mean(1 / of)) for of in counts]
        square = [float(np.sum(of**2)) / n**2 for of in counts]
        rows, columns = (np.maximum(of, 1) for of in self._of_line)
        # Covariance of a row's mean with the frame's mean, from the columns that both contain.
        crossed = self.mask / np.outer(rows, np.ones_like(columns)) * columns / n
        of_rows = float(crossed.sum()) / lines[0]
        crossed = self.mask / np.outer(np.ones_like(rows), columns) * rows[:, None] / n
        of_columns = float(crossed.sum()) / lines[1]
        return np.array(
            [
                [1 - 1 / n, 1 - square[0], 1 - square[1]],
                [
                    inverse[0] - 1 / n,
                    1 - 2 / lines[0] + square[0],
                    inverse[0] - 2 * of_rows + square[1],
                ],
                [
                    inverse[1] - 1 / n,
                    inverse[1] - 2 * of_columns + square[0],
                    1 - 2 / lines[1] + square[1],
                ],
                [1 / n, square[0], square[1]],
            ]
        )


@dataclass(frozen=True)
class DeadPixels:
    """The invalid pixels of a frame, by kind."""

    still: Bool[np.ndarray, "h w"]  # true where light changes nothing
    # true where a pixel is far from the others in the dark, but responds to light
    hot: Bool[np.ndarray, "h w"]
    stuck: tuple[StuckBit, ...] = ()  # bits of the ADC that never change

    @property
    def all(self) -> Bool[np.ndarray, "h w"]:
        """Invalid pixels of any kind."""
        return np.logical_or.reduce([self.still, self.hot, *(one.mask for one in self.stuck)])

    @property
    def sentence(self) -> str:
        """The finding on the invalid pixels, with numbers and positions."""
        parts = [
            f"{int(mask.sum())} {what}{_where(mask)}"
            for mask, what in (
                (self.still, "that are dead or stuck (the same with and without light)"),
                (self.hot, "that are hot (in the dark far above or below the others)"),
            )
            if mask.any()
        ]
        parts += [f"{int(one.mask.sum())} {one.clause}" for one in self.stuck]
        gone = self.all
        return (
            f"{int(gone.sum())} of {gone.size} pixels were left out: "
            f"{' and '.join(parts).removesuffix(',')}. All figures are for the "
            f"{gone.size - int(gone.sum())} others."
        )


def dead_pixels(flats: Sequence[np.ndarray], darks: Sequence[np.ndarray]) -> DeadPixels | None:
    """Find pixels that are dead, stuck or hot; None if there are none.

    Example:
        >>> from fitting.noise.live_pixels import dead_pixels
        >>> rng = np.random.default_rng(0)
        >>> flats, darks = rng.normal(900, 9, (2, 20, 20)), rng.normal(60, 2, (2, 20, 20))
        >>> flats[:, 3, 4] = darks[:, 3, 4] = 128
        >>> print(np.argwhere(dead_pixels(list(flats), list(darks)).all))
        [[3 4]]
    """
    shape = darks[0].shape
    flats, darks = ([one for one in own if one.shape == shape] for own in (flats, darks))
    low, high = np.min(darks, axis=0), np.max(darks, axis=0)
    hot = _far(low, 1) | _far(high, -1)
    still = np.zeros(shape, bool)
    if flats:
        gained = np.max(flats, axis=0) - low
        usual = float(np.median(gained))
        noise = float(np.median(high - low))
        if usual > LIT * max(noise, _step(low)):
            still = gained < DEAD_SIGNAL_SHARE * usual
            hot &= ~still
    stuck = tuple(stuck_bits([*flats, *darks]))
    covered = _covered_border(still)
    if covered.mean() > MOST_COVERED:
        covered = np.zeros(shape, bool)
    if not ((still | hot) & ~covered).mean() <= MOST:
        still, hot = covered, np.zeros(shape, bool)
    still |= covered
    return DeadPixels(still, hot, stuck) if still.any() or hot.any() or stuck else None


def _covered_border(still: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Return a mask of rows and columns at the border that hardly respond to light."""
    covered = np.zeros_like(still)
    for axis in (0, 1):
        line = still.mean(axis=1 - axis) >= 1 - MOST
        for dark in (line, line[::-1]):
            depth = int(np.logical_and.accumulate(dark).sum())
            place = np.s_[:depth] if dark is line else np.s_[len(line) - depth :]
            np.moveaxis(covered, axis, 0)[place] = True
    return covered


def _far(values: np.ndarray, sign: int) -> np.ndarray:
    """Return a mask of the values that are far above (sign 1) or far below (-1) all others."""
    middle = float(np.median(values))
    decile = float(np.quantile(sign * (values - middle), 0.9)) / DECILE
    return sign * (values - middle) > OUTLIER_SIGMAS * max(decile, _step(values))


def _step(values: np.ndarray) -> float:
    """Return the smallest step between different values, DN."""
    gaps = np.diff(np.unique(values))
    return float(gaps.min()) if gaps.size else 1.0


def _where(mask: Bool[np.ndarray, "h w"]) -> str:
    """Describe masked pixels in words: whole columns and rows, then single pixels."""
    parts, left = [], mask.copy()
    for axis, name in ((0, "column"), (1, "row")):
        whole = np.flatnonzero(mask.all(axis=axis))
        if len(whole):
            listed = ", ".join(str(i) for i in whole[:SHOWN]) + ", ..." * (len(whole) > SHOWN)
            parts.append(f"{name}{'s' * (len(whole) > 1)} {listed}")
            left[(slice(None), whole) if axis == 0 else whole] = False
    places = np.argwhere(left)
    if len(places):
        listed = ", ".join(f"({i}, {j})" for i, j in places[:SHOWN].tolist())
        listed += ", ..." * (len(places) > SHOWN)
        parts.append(f"row and column {listed}")
    return f", {'; '.join(parts)}," if parts else ""


HIT, BULK = 8.0, 5.0  # standard deviations of a pixel's change: typical of hits; beyond noise
MOST_HIT = 0.01  # share of the pixels; of more, something else is the cause
REPLACEMENT_ROWS = 5  # rows to the pixel that replaces a hit, farther than compared neighbours
SAMPLED = 100_000  # pixels used to estimate the usual change


class Hits(NamedTuple):
    """Pixels whose change between two frames is an outlier, with replacement values for the
    change."""

    up: Bool[np.ndarray, "h w"]  # true where a pixel is much brighter in the second frame
    down: Bool[np.ndarray, "h w"]  # true where it is much brighter in the first frame
    change: Float[np.ndarray, "h w"]  # second frame minus the first, with these pixels replaced, DN


def hits(change: Float[np.ndarray, "h w"], live: LivePixels) -> Hits | None:
    """Find pixels whose change between two frames is an outlier; None if there are none."""
    stride = max(int(np.sqrt(change.size / SAMPLED)), 1)
    sample = change[::stride, ::stride][live.mask[::stride, ::stride]]
    if not sample.size:
        return None
    middle = float(np.median(sample))
    usual = float(np.quantile(np.abs(sample - middle), 0.8)) / DECILE
    size = np.abs(change - middle)
    far = live.mask & (size > BULK * usual)
    if usual == 0 or not far.any():
        return None
    count, plain = int(far.sum()), int((far & (size > HIT * usual)).sum())
    if not count < 2 * plain or count > MOST_HIT * live.count:
        return None
    other = np.roll(change, REPLACEMENT_ROWS, axis=0)
    spare = np.where(np.roll(far | ~live.mask, REPLACEMENT_ROWS, axis=0), middle, other)
    return Hits(far & (change > middle), far & (change < middle), np.where(far, spare, change))
