"""Properties of a camera's analogue-to-digital converter, inferred from the numbers in its frames.

A converter of b bits gives 2^b different numbers, but a file may store them in another form:

    multiples     all numbers are multiples of a step: 12 bits at the upper end of 16
                  (left-aligned), or frames divided or averaged by hand
    scaled        multiples of 65535 / 4095, rounded again
    uneven        a stretched histogram, or a table (gamma): codes are missing, more of them in
                  some places than in others
    alternating   even codes more often than odd ones, because their steps are wider
    coarser       above some code all are multiples of a larger step: a second amplifier or
                  converter took over

The step q between neighbouring codes determines the rounding variance, q^2 / 12. If q = 1 is
assumed for a file with another step, the read noise is wrong.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

MOST_VALUES = 2**18  # distinct numbers; frames with more lie on no grid
RARE = 1e-9  # probability that the codes above some number share a step by chance
MOST_LABELS = 7  # different numbers of masks or labels, too few to measure noise
FEWEST_WHOLE = 5  # distinct numbers needed to decide that all are whole
TOP_SHARE = 1e-3  # share of the pixels that must have these codes
CHANCE = 1e-3  # probability that numbers of step 1 are all multiples of a larger step
SMOOTH_NOISE = 1.0  # noise between neighbouring pixels, in codes, from which histograms are smooth
MOST_NOISE = 2**14  # pixels from which a frame's noise is known to a per cent
QUARTILE = 0.9539  # median distance of two normal deviates of standard deviation 1
EXPECTED = 12.0  # pixels per code next to which an empty code counts as missing
REACH = 4.0  # gap, in median distances, beyond which numbers do not belong to the signal
RARE_RATIO = 3.0  # a code is rare if both neighbouring codes occur this many times as often
STANDARD_ERRORS = 5.0  # standard errors, and codes
COMPARED_NUMBERS = 16  # numbers below the largest with which it is compared
PILE, STEEP = 100, 10.0  # least pixels at the largest number, and ratio to the numbers below
LEAST_PILE_SHARE = 0.002  # of all pixels, that codes next to a pile of clipped black have
PILE_RATIOS = 0.5, 10.0  # of its count to the next code's: tails have less, quiet black has more
LEAST_CURVATURE = -1.6  # of the logarithms of counts, for a noise of 0.8 codes
COARSE_STEP = 3.0  # DN; a finer step cannot be detected after a second rounding
FLOAT32 = 2.0**-22  # relative rounding error of numbers stored in single precision


@dataclass(frozen=True)
class Converter:
    """The grid of numbers that a camera's converter can give: its step, its origin and its
    irregularities."""

    step: float = 1.0  # q, DN between neighbouring codes; 0 where the values lie on no grid
    origin: float = 0.0  # DN of one code; every other code lies a whole number of steps from it
    even: bool = True  # whether all steps are equal
    # share of the codes that do not occur between the smallest and the largest code, given the step
    missing: float = 0.0
    # half the relative difference between the counts of even and odd codes; 0 where chance explains
    # it
    imbalance: float = 0.0
    # largest value, DN, where many pixels have exactly that value; None elsewhere
    clips_at: float | None = None
    # DN above which the step is `coarse_step`; None where all steps are equal
    coarse_from: float | None = None
    coarse_step: float = 1.0  # DN between neighbouring codes above `coarse_from`
    # smallest value of darks, DN, where clipping gives many pixels that value, although it is above
    # the first code; None elsewhere
    clips_below: float | None = None

    @property
    def lowest(self) -> float:
        """The number below which all are clipped, DN."""
        return self.origin if self.clips_below is None else self.clips_below

    @property
    def width(self) -> float:
        """Mean distance between neighbouring codes that occur, DN."""
        return self.step / (1 - self.missing) if self.missing < 1 else self.step

    @property
    def rounding(self) -> float:
        """Variance of the rounding error, DN^2."""
        if not self.step:
            return 0.0
        # A signal meets wide steps (1 + d) more often than narrow ones (1 - d): the mean of w^3.
        one = self.width**2 * (1 + 3 * self.imbalance**2) / 12
        again = 0.0 if self._rounded_once else 1 / 12
        return one + again

    @property
    def _rounded_once(self) -> bool:
        """Whether the numbers were rounded once, by the converter and not by software."""
        return (self.even and self.step < 1) or (self.even and self.step == round(self.step))


@dataclass
class Codes:
    """Counts of the numbers in frames, from which the grid of the converter follows.

    Example:
        >>> from fitting.codes import Codes
        >>> codes, rng = Codes(), np.random.default_rng(0)
        >>> codes.add(16 * rng.poisson(400, (50, 50)))  # 12 bits at the upper end of 16
        >>> print(codes.converter().step)
        16.0
    """

    _whole: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    _by_noise: dict[int, np.ndarray] = field(default_factory=dict)  # counts by octave of the noise
    _broken: np.ndarray = field(default_factory=lambda: np.zeros((2, 0)))  # values, their counts
    _continuous: bool = False

    def add(self, frame: np.ndarray) -> None:
        """Add the counts of one frame."""
        values = np.asarray(frame, float).ravel()
        values = values[np.isfinite(values)]
        if self._continuous:  # only the largest numbers are still needed
            values = values[values >= self._broken[0, 0]]
        if not values.size:
            return
        whole = not self._continuous and np.array_equal(values, np.floor(values))
        if whole and 0 <= values.min() <= values.max() < 2**17:
            counts = np.bincount(values.astype(np.int64))
            self._whole = _sum(self._whole, counts)
            octave = int(np.floor(np.log2(_noise(frame))))
            self._by_noise[octave] = _sum(self._by_noise.get(octave, counts[:0]), counts)
            return
        self._broken = _merge_counts([self._broken, np.unique(values, return_counts=True)])
        self._continuous |= self._broken.shape[1] > MOST_VALUES
        if self._continuous:
            self._broken = self._broken[:, -COMPARED_NUMBERS - 1 :]

    def converter(self) -> Converter:
        """Return the grid on which the numbers of all frames added so far lie."""
        used = np.flatnonzero(self._whole).astype(float)
        counts = self._whole[self._whole > 0]
        if self._broken.size:
            values = np.union1d(self._broken[0], used)
            grid = None if self._continuous else _grid(values, FLOAT32 * np.abs(values).max())
            step, origin = grid or (0.0, 0.0)
            return Converter(step, origin, clips_at=_clips_at(*self._broken))
        clips_at = _clips_at(used, counts)
        common = _common_step(used)
        if common is not None and common[0] > 1:
            step, origin = common
            inner = self._smooth(step)[int(origin) :: int(step)]
            return Converter(step, origin, True, 0.0, _imbalance(inner), clips_at)
        scaled = _grid(used, 0.5 + 1e-3)
        if scaled is not None and scaled[0] > COARSE_STEP:
            return Converter(*scaled, clips_at=clips_at)
        coarse = _coarser_above(used, counts)
        smooth = self._smooth(1.0)
        if coarse is not None and not _missing(smooth[: int(coarse[0])]):
            below = _imbalance(smooth[: int(coarse[0])])
            return Converter(1.0, 0.0, True, 0.0, below, clips_at, *coarse)
        missing = _missing(smooth)
        if missing:
            return Converter(even=False, missing=missing, clips_at=clips_at)
        return Converter(imbalance=_imbalance(smooth), clips_at=clips_at)

    def clips_below(self) -> float | None:
        """Return the smallest number of frames without light if clipping piles up pixels there,
        else None.

        The logarithms of the counts of a noisy black level are a parabola with curvature -1 / s^2
        for noise of s codes. If the codes above the smallest code follow this parabola, and the
        smallest code has more counts than the parabola predicts, then its counts include clipped
        pixels.
        """
        used = np.flatnonzero(self._whole)
        if self._broken.size or used.size < FEWEST_WHOLE or np.ptp(np.diff(used[:4])):
            return None
        counts = self._whole[used[:4]].astype(float)
        ratio, share = counts[0] / counts[1], counts.min() / self._whole.sum()
        least, most = PILE_RATIOS
        if counts[0] < PILE or not least < ratio < most or share < LEAST_PILE_SHARE:
            return None

        def combine(weights: Sequence[int]) -> tuple[float, float]:
            own = np.array(weights)
            return float(own @ np.log(counts)), float(np.sqrt(own**2 @ (1 / counts)))

        curvature, error = combine((0, 1, -2, 1))
        excess, of_excess = combine((1, -3, 3, -1))
        smooth = LEAST_CURVATURE < curvature < 2 * error
        return float(used[0]) if smooth and excess > 2 * of_excess else None

    @property
    def whole(self) -> bool | None:
        """Whether all numbers are whole; None if there are fewer than 5 different numbers."""
        if self._continuous or self._broken.size:
            return False
        return True if np.count_nonzero(self._whole) >= FEWEST_WHOLE else None

    @property
    def few(self) -> list[float]:
        """Return the different numbers if they are too few for the noise of a camera, else []."""
        known = np.union1d(np.flatnonzero(self._whole), self._broken[0])
        return [] if self._continuous or known.size > MOST_LABELS else known.tolist()

    def __add__(self, other: "Codes") -> "Codes":
        """Add the counts of two sets of frames."""
        octaves = self._by_noise.keys() | other._by_noise.keys()
        none = np.zeros(0, np.int64)
        return Codes(
            _sum(self._whole, other._whole),
            {n: _sum(self._by_noise.get(n, none), other._by_noise.get(n, none)) for n in octaves},
            _merge_counts([self._broken, other._broken]),
            self._continuous or other._continuous,
        )

    def _smooth(self, step: float) -> np.ndarray:
        """Return the counts by code of frames whose noise fills a grid of this step."""
        found = np.zeros(0, np.int64)
        for octave, counts in self._by_noise.items():
            if 2.0**octave >= SMOOTH_NOISE * step:
                found = _sum(found, counts)
        return found


def converter_of(frames: Iterable[np.ndarray]) -> Converter:
    """Return the grid on which the numbers of some frames lie."""
    codes = Codes()
    for frame in frames:
        codes.add(frame)
    return codes.converter()


def converter_in_words(converter: Converter, full_scale: float | None) -> list[str]:
    """Return a finding for the report if the converter's codes are not simply 0, 1, 2 and so on;
    else an empty list."""
    step, origin = converter.step, converter.origin
    if not step:
        return [
            "The numbers lie on no grid, as in frames that were corrected or averaged: "
            "no rounding noise is subtracted, and averages hide noise. Give raw frames."
        ]
    if not converter.even:
        return [
            f"{100 * converter.missing:.2g} % of the codes do not occur, as after a stretched "
            f"histogram or a table (gamma). The rounding noise is that of the mean step of "
            f"{converter.width:.3g} DN. Where steps differ, the read noise is wrong. Give raw "
            "frames."
        ]
    if step < 1:
        parts = f"{1 / step:.6g}"
        return [
            f"Every number is a multiple of 1/{parts}: the frames were divided by {parts}, or are "
            f"averages of {parts}. The gain of an average is {parts} times too small and its "
            f"quantum efficiency {parts} times too large, so give single frames."
        ]
    if step == 1 and converter.coarse_from is not None:
        return [
            f"From {converter.coarse_from:g} DN on numbers lie {converter.coarse_step:g} apart, "
            f"below it {step:g}: a second amplifier or converter takes over there, with another "
            "gain and read noise."
        ]
    if step == 1:
        return []
    bits = "" if full_scale is None else f"{np.log2((full_scale - origin) / step + 1):.3g}"
    has = f"the converter has {bits} bits, and its" if bits else "the"
    if step != round(step):
        return [
            f"The numbers lie {step:.5g} apart, scaled and rounded again: {has} rounding variance "
            f"is {step:.5g}²/12 DN². Results in DN refer to the numbers in the file."
        ]
    grid = f"{step:g}" if not origin else f"{step:g}, plus {origin:g}"
    return [
        f"Every number is a multiple of {grid}: {has} rounding variance is {step:g}²/12 DN². "
        "Results in DN refer to the numbers in the file."
    ]


def _sum(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    small, large = sorted((one, other), key=len)
    found = large.copy()
    found[: small.size] += small
    return found


def _merge_counts(parts: Sequence[Any]) -> Float[np.ndarray, "2 values"]:
    """Merge tables of values and counts to the sorted values and the count of each."""
    different, place = np.unique(np.concatenate([x[0] for x in parts]), return_inverse=True)
    counts = np.bincount(place, np.concatenate([x[1] for x in parts]), different.size)
    return np.stack([different, counts])


def _noise(frame: np.ndarray) -> float:
    """Return the standard deviation of the differences between nearby pixels, DN, at least 1/4. The
    width of the histogram would mislead: a scene of few tones has a wide histogram that is not
    smooth. The pixels are two rows or columns apart, because these have the same colour in a
    mosaic."""
    values = np.asarray(frame, float)
    values = values.reshape(values.shape[0], -1) if values.ndim == 1 else values
    some = max(values.size // MOST_NOISE, 1)  # every so many rows
    apart = values[2::some] - values[:-2:some], values[::some, 2:] - values[::some, :-2]
    both = np.concatenate([np.abs(d).ravel() for d in apart])
    both = both[np.isfinite(both)]
    return max(float(np.median(both)) / QUARTILE, 0.25) if both.size else 0.25


def _common_step(used: Float[np.ndarray, " values"]) -> tuple[float, float] | None:
    """Return the greatest common divisor of the gaps between the codes that occur, and the
    remainder of the codes after division by it; None if the codes are so few that chance explains
    such a
    divisor."""
    if used.size < 2:
        return None
    step = int(np.gcd.reduce(np.diff(used).astype(np.int64)))
    if step > 1 and float(step) ** (1.0 - used.size) > CHANCE:
        return None
    return float(step), float(used[0] % step)


def _coarser_above(used: Float[np.ndarray, " values"], counts: np.ndarray) -> tuple | None:
    """Return the code above which all gaps are multiples of a larger step, and that step; None if
    there is no such code, or if chance explains it. The search is repeated without the largest
    code, which may be a clipping limit off the grid."""
    for values in (used, used[:-1]):
        gaps = np.diff(values).astype(np.int64)
        if gaps.size < 2:
            continue
        above = np.gcd.accumulate(gaps[::-1])[::-1]  # divisor of each gap and all gaps above it
        many = np.arange(gaps.size, 0, -1)
        sure = (above > above[0]) & (many * np.log(np.maximum(above, 1)) > -np.log(RARE))
        # Rarely used codes leave gaps of any size.
        sure &= float(counts.sum()) * TOP_SHARE < np.cumsum(counts[: values.size][::-1])[::-1][:-1]
        if sure.any():
            place = int(np.argmax(sure))
            return float(values[place]), float(above[place])
    return None


def _grid(values: Float[np.ndarray, " values"], error: float) -> tuple[float, float] | None:
    """Return step and origin of an even grid for all numbers within `error`, or None."""
    gaps = np.diff(values)
    gaps = gaps[gaps > 2 * error] if error < 0.5 else gaps
    if gaps.size < 5:
        return None
    finest = float(gaps.min())
    if finest <= 1 and error >= 0.5:
        return None
    near = gaps[gaps < 4.4 * finest]
    step = float(near.sum() / np.round(near / finest).sum())
    origin, place = float(values[0]), np.zeros_like(values)
    for _ in range(3):
        place = np.cumsum(np.round(np.diff(values, prepend=values[0]) / step))
        if place[-1] < 5:
            return None
        step, origin = (float(x) for x in np.polyfit(place, values, 1))
    if np.abs(values - origin - step * place).max() > 2 * error:
        return None
    # Probability that numbers of step 1 have such distances by chance.
    if error >= 0.5 and np.exp(-(values.size**2) / np.ptp(values)) > CHANCE:
        return None
    origin %= step
    if step < 1 and abs(1 / step - round(1 / step)) < 1e-4 / step:
        step = 1 / round(1 / step)
    return step, 0.0 if min(origin, step - origin) <= max(2 * error, 1e-3 * step) else origin


def _missing(counts: np.ndarray) -> float:
    """Return the share of codes that never occur although many pixels have the neighbouring codes.

    It is 0 if many other codes are rare, because chance or narrow peaks of the histogram then
    explain the empty ones.
    """
    used = np.flatnonzero(counts)
    if used.size < 3:
        return 0.0
    gaps, many = np.diff(used), counts[used] > EXPECTED
    both = many[:-1] & many[1:]
    if not both.any():
        return 0.0
    reach = max(np.ceil(COARSE_STEP), REACH * float(np.median(gaps[both])))
    near = (gaps <= reach) & both
    span = int(gaps[near].sum())
    empty = span - int(near.sum())
    beside = np.minimum(counts[used[:-2]], counts[used[2:]])
    close = used[2:] - used[:-2] <= 2 * reach
    rare = close & (beside > EXPECTED) & (RARE_RATIO * counts[used[1:-1]] < beside)
    by_chance = span * np.exp(-EXPECTED)
    if empty < STANDARD_ERRORS + by_chance + RARE_RATIO * float(rare.sum()):
        return 0.0
    return empty / span


def _imbalance(counts: np.ndarray) -> float:
    """Return half the relative difference between the widths of even and odd codes, from a smooth
    histogram; 0 if it is not significant.

    Its error comes from the scatter of the differences between even and odd codes, pair by pair, so
    a few codes at which pixels accumulate do not count as an imbalance.
    """
    pairs = counts[: counts.size // 2 * 2].reshape(-1, 2).astype(float)
    more = pairs[:, 0] - pairs[:, 1]
    total, error = pairs.sum(), np.sqrt(np.sum(more**2))
    return float(abs(more.sum()) / total) if abs(more.sum()) > STANDARD_ERRORS * error else 0.0


def _clips_at(values: np.ndarray, counts: np.ndarray) -> float | None:
    """Return the largest number if clipping piles up far more pixels there, else None."""
    below = counts[:-1][-COMPARED_NUMBERS:]
    # In darks that are a few codes wide, the largest number may be the most frequent.
    if below.size < COMPARED_NUMBERS or counts[-1] < max(PILE, STEEP * float(below.max())):
        return None
    return float(values[-1])
