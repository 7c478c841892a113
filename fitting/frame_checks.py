"""Frames that should be alike, compared with each other before anything is fitted to them.

Frames of one level see the same light, so that their means, their unevenness and the noise between
them agree. A frame does not belong where it departs by more than the frames of all levels scatter
(by a quantile of pairwise differences, Rousseeuw and Croux 1993) and by more than matters: lamps
flicker by a percent. Of two frames that disagree, the levels around them tell which one is wrong.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from jaxvision import ArrayLike
from jaxvision.errors import InputError
from jaxvision.image_settings import ImageSettings, read_settings

from .copies import Copies
from .inference.formatting import format_percent

SIDE, BLOCKS = 128, 16  # pixels of a frame that are kept, along each side; blocks of them
SURE = 6.0  # robust standard deviations beyond which a frame departs
PAIRS = 2.22  # standard deviations a quartile of pairwise differences
UNEVEN, HALF = 0.03, 0.5  # least departure: of the signal, and of a pixel's noise
MOST = 0.5  # of the signal, more than which no lamp flickers
OTHER_NOISE = 1.4  # ratio of variances
SPIKE = 0.15  # by which a level's light differs from that of both levels beside it
CLOSER = 3.0  # times that one of two frames must be nearer to what the other levels tell
TRIMMED = 0.98  # of squares: hot pixels and cosmic rays are no noise of a frame
FEWEST_TRIMMED = 50
FEWEST_LEVELS = 4  # to tell what a level should be from those beside it
BETWEEN = 0.01  # share of pixels that are neither black nor white in a frame that can be a copy
MOSTLY = 0.9  # share of the pixels at one end of the codes
BLANK = 0.999  # share of saturated pixels of an image that tells nothing
LONGER = 1.2  # ratio of exposures from which the longer must be the brighter
FEWEST_CLEAR, CONTRAST = 200, 0.02  # sampled pixels to compare scenes by; their spread, of scale
UNLIKE, LIKE = 0.6, 0.9  # rank correlation of another scene at most, of one scene at least
SAME = 0.02  # relative difference of exposures and apertures that heads round to
ROUNDED = 0.1  # relative difference of an exposure from the one that a camera prints
WARMER = 5.0  # K, by which sensors drift while frames are taken

ALONE = "it is the only frame that is left of its level"
COPIED = "{} are equal in every pixel, so that one of them at most was taken as stated"


@dataclass(frozen=True)
class Shown:
    """What is kept of a frame to compare it with others.

    Attributes:
        name: of the frame.
        mean: DN.
        at_top: share of the pixels at or above the clip level.
        at_bottom: share of the pixels at 0.
        sample: (rows, columns) DN of evenly spread pixels.
    """

    name: str
    mean: float
    at_top: float
    at_bottom: float
    sample: Float[np.ndarray, "rows columns"]


@dataclass(frozen=True)
class Odd:
    """Frames that do not belong, and why.

    Attributes:
        names: of the frames, at least one.
        reason: a clause.
    """

    names: tuple[str, ...]
    reason: str

    @property
    def sentence(self) -> str:
        """For a report."""
        verb = "was" if len(self.names) == 1 else "were"
        return f"{listed(self.names)} {verb} left out: {self.reason}."


def shown(name: str, frame: Float[np.ndarray, "h w"], *, top: float) -> Shown:
    """What is kept of a frame.

    Args:
        name: of the frame.
        frame: (h, w) DN.
        top: DN from which a pixel is saturated.

    Returns:
        The record.
    """
    steps = [-(-size // SIDE) for size in frame.shape]
    sample = frame[steps[0] // 2 :: steps[0], steps[1] // 2 :: steps[1]].astype(np.float32)
    return Shown(
        name, float(frame.mean()), float((frame >= top).mean()), float((frame <= 0).mean()), sample
    )


def listed(names: Sequence[str]) -> str:
    """Names in a sentence, of many the first ones.

    Args:
        names: at least one.

    Returns:
        As "a, b and c".
    """
    if len(names) > 4:
        return f"{', '.join(names[:3])} and {len(names) - 3} more"
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def odd_frames(
    levels: Sequence[Sequence[Shown]],
    *,
    light: ArrayLike,
    black: Float[np.ndarray, " levels"] | None = None,
) -> list[Odd]:
    """Frames that differ from the others of their level, and levels that differ from those beside
    them.

    Args:
        levels: frames of each level.
        light: (levels,) proportional to the light of each; of darks, their exposures.
        black: (levels,) DN without light; None for darks, which have no light to compare.

    Returns:
        What does not belong; a level of which one frame would be left is named whole.
    """
    compared = _Levels([list(level) for level in levels], np.asarray(light, float), black)
    for test in (_copies, _means, _unevenness, _noise):
        test(compared)
    compared.without_single_frames()
    if black is not None:
        _light_of_levels(compared)
        _noise_of_levels_beside(compared)
        _copies_across(compared)
    return compared.odd


def refuse_half(where: str | Path, odd: Sequence[Odd], count: int) -> None:
    """Asks the user to decide where half of the frames would be left out.

    Args:
        where: the frames lie, for the message.
        odd: what does not belong.
        count: of all frames.

    Raises:
        InputError: names the first frames and why they disagree.
    """
    if 2 * sum(len(one.names) for one in odd) >= count > 0:
        first = odd[0]
        raise InputError(
            f"{where}: half of its {count} frames or more do not belong with the others "
            f"({listed(first.names)}: {first.reason}); decide which belong and take the others out."
        )


class _Levels:
    """Levels from which what does not belong is taken."""

    def __init__(
        self, frames: list[list[Shown]], light: np.ndarray, black: np.ndarray | None
    ) -> None:
        self.frames, self.light, self.black = frames, light, black
        self.odd: list[Odd] = []
        self.noise = _noise_of_levels(frames, light)

    def scale(self, level: int) -> float:
        """DN in which departures are counted: the signal of flats, the noise of darks."""
        if self.black is None:
            return float(max(self.noise[level], 0.1))
        middle = np.median([frame.mean for frame in self.frames[level]])
        return float(max(abs(middle - self.black[level]), 1e-9))

    def floor(self, level: int) -> float:
        """DN, the least departure that matters."""
        if self.black is None:
            return 2 * HALF * self.scale(level)
        return max(UNEVEN * self.scale(level), HALF * self.noise[level])

    def others(self, level: int) -> list[int]:
        """Levels that tell of this one."""
        return [i for i, frames in enumerate(self.frames) if i != level and len(frames) > 1]

    def expected(self, level: int) -> float | None:
        """Mean of this level by the others, DN; None where they do not tell."""
        others = [i for i in self.others(level) if self.black is None or self.light[i] > 0]
        if len(others) < 2:
            return None
        light = self.light[others]
        means = np.array([np.median([frame.mean for frame in self.frames[i]]) for i in others])
        order = np.argsort(light, kind="stable")
        if self.black is None:
            return float(np.interp(self.light[level], light[order], means[order]))
        rates = (means - self.black[others]) / light
        rate = np.interp(self.light[level], light[order], rates[order])
        return float(self.black[level] + rate * self.light[level])

    def remove(self, level: int, places: Sequence[int], reason: str) -> None:
        """Takes frames out of a level."""
        names = tuple(self.frames[level][i].name for i in places)
        self.odd.append(Odd(names, reason))
        self.frames[level] = [
            one for i, one in enumerate(self.frames[level]) if i not in set(places)
        ]

    def without_single_frames(self) -> None:
        """Levels of which one frame is left tell no variance."""
        for level, frames in enumerate(self.frames):
            if len(frames) == 1:
                self.remove(level, [0], ALONE)


def _noise_of_levels(
    frames: Sequence[Sequence[Shown]], light: np.ndarray
) -> Float[np.ndarray, " levels"]:
    """DN rms of a pixel between frames; where two frames disagree, not far above other levels."""
    found = np.array([_noise_of(level) for level in frames])
    own, order = found.copy(), np.argsort(light, kind="stable")
    for i, place in enumerate(order):
        rest = np.delete(order, i)
        if len(frames[place]) == 2 and len(rest) > 1:
            beside = float(np.interp(light[place], light[rest], own[rest]))
            found[place] = min(own[place], 2 * max(beside, float(np.median(own[rest]))))
    return found


def _noise_of(level: Sequence[Shown]) -> float:
    """DN rms of a pixel between two frames, by the pair that differs least and is no copy."""
    variances = [_trimmed(a.sample - b.sample) for a, b in pairwise(level)]
    return float(np.sqrt(min((v for v in variances if v > 0), default=0.0) / 2))


def _trimmed(residuals: np.ndarray) -> float:
    """Variance about the mean without the largest squares."""
    squares = np.sort((residuals - np.median(residuals)).ravel().astype(float) ** 2)
    kept = squares if squares.size < FEWEST_TRIMMED else squares[: int(TRIMMED * squares.size)]
    return float(kept.mean())


def _scatter(distances: Sequence[float]) -> float:
    """Standard deviation by pairwise differences, of which most may be of frames that are odd."""
    return PAIRS * float(np.quantile(distances, 0.25)) if len(distances) else 0.0


def _pairs(count: int) -> list[tuple[int, int]]:
    """All pairs of a few frames, neighbours of many."""
    return (
        list(combinations(range(count), 2))
        if count < 24
        else [(i, i + 1) for i in range(count - 1)]
    )


def _parted(
    distances: Float[np.ndarray, " frames"],
    limit: float,
    from_expected: Callable[[], Float[np.ndarray, " frames"] | None],
) -> Bool[np.ndarray, " frames"] | None:
    """Which frames depart; None where that cannot be told.

    Args:
        distances: from the middle of the level; of two frames, from each other.
        limit: beyond which a frame departs.
        from_expected: distances from what other levels tell, None where they do not.

    Returns:
        True where a frame departs.
    """
    far = distances > limit
    if 2 * far.sum() < len(far) or not far.any():
        return far
    known = from_expected()
    if known is None:
        return None
    far = known * CLOSER > max(known.max(), limit)
    return None if far.all() or not far.any() else far


def _copies(levels: _Levels) -> None:
    dark = levels.black is None
    usual = float(np.median(levels.noise))
    for level, frames in enumerate(levels.frames):
        if not frames or (not dark and levels.light[level] <= 0):
            continue
        if dark and usual**2 * frames[0].sample.size < SURE**2:
            continue  # frames without noise may be equal
        first: dict[bytes, int] = {}
        again = []
        for i, frame in enumerate(frames):
            between = (frame.sample > frame.sample.min()) & (frame.sample < frame.sample.max())
            if between.mean() > BETWEEN and first.setdefault(frame.sample.tobytes(), i) != i:
                again.append(i)
        if again:
            copied = frames[first[frames[again[0]].sample.tobytes()]].name
            levels.remove(level, again, f"equal to {copied} in every pixel, as a copy is")


def _copies_across(levels: _Levels) -> None:
    """Frames of one level that are in another one too, where nothing told which is the copy."""
    copies = Copies()
    for level, frames in enumerate(levels.frames):
        for frame in frames if levels.light[level] > 0 else ():
            copies.add(frame.name, frame.sample)
    for names in copies.found:
        for level, frames in enumerate(levels.frames):
            places = [i for i, frame in enumerate(frames) if frame.name in names]
            if places:
                levels.remove(level, places, COPIED.format(listed(names)))
    levels.without_single_frames()


def _means(levels: _Levels) -> None:
    means = [np.array([frame.mean for frame in level]) for level in levels.frames]
    scatter = _scatter(
        [
            abs(values[i] - values[j]) / levels.scale(level)
            for level, values in enumerate(means)
            for i, j in _pairs(len(values))
        ]
    )
    for level, values in enumerate(means):
        if len(values) < 2:
            continue
        spread = min(SURE * scatter, MOST if levels.black is not None else np.inf)
        limit = max(spread * levels.scale(level), levels.floor(level))
        middle = np.median(values)
        distances = np.abs(values - middle) * (2 if len(values) == 2 else 1)

        def from_expected(values: np.ndarray = values, level: int = level) -> np.ndarray | None:
            told = levels.expected(level)
            return None if told is None else np.abs(values - told)

        _take(levels, level, _parted(distances, limit, from_expected), _mean_in_words)


def _take(
    levels: _Levels,
    level: int,
    far: Bool[np.ndarray, " frames"] | None,
    in_words: Callable[[list[Shown], list[Shown]], str],
) -> None:
    """Takes out frames that depart, or the whole level where it cannot be told which do."""
    frames = levels.frames[level]
    if far is None:
        parted = f"{in_words(frames[:1], frames[1:])}, and which of them belongs cannot be told"
        levels.remove(level, range(len(frames)), parted)
    elif far.any():
        for i in np.flatnonzero(far):
            rest = [one for j, one in enumerate(frames) if not far[j]]
            place = levels.frames[level].index(frames[i])
            levels.remove(level, [place], in_words([frames[i]], rest))


def _mean_in_words(odd: list[Shown], rest: list[Shown]) -> str:
    mean = float(np.median([frame.mean for frame in rest]))
    others = "the other frame" if len(rest) == 1 else "the other frames"
    told = f"its mean is {odd[0].mean:.5g} DN, that of {others} of its level {mean:.5g} DN"
    for share, end in ((odd[0].at_top, "saturated"), (odd[0].at_bottom, "0 DN")):
        if share > MOSTLY:
            return f"{format_percent(share)} of its pixels are {end}, and {told}"
    return told


def _unevenness(levels: _Levels) -> None:
    fields = [
        [_blocks(levels, level, frame) for frame in frames]
        for level, frames in enumerate(levels.frames)
    ]
    far = [[_rms(own[i] - own[j]) for i, j in _pairs(len(own))] for level, own in enumerate(fields)]
    scatter = _scatter([x for distances in far for x in distances])
    known = [np.median(own, axis=0) for own in fields if len(own) > 1]
    for level, own in enumerate(fields):
        if len(own) < 2:
            continue
        pixels = levels.frames[level][0].sample.size / own[0].size
        chance = 2 * levels.noise[level] / np.sqrt(pixels) / levels.scale(level)
        limit = max(SURE * scatter, levels.floor(level) / levels.scale(level), 3 * chance)
        middle = np.median(own, axis=0)
        away = 2.0 if len(own) == 2 else 1.0
        distances = np.array([away * _rms(field - middle) for field in own])

        def from_expected(own: list[np.ndarray] = own) -> np.ndarray | None:
            if len(known) < 4:
                return None
            told = np.median(known, axis=0)
            return np.array([_rms(field - told) for field in own])

        _take(levels, level, _parted(distances, limit, from_expected), _unevenness_in_words)


def _blocks(levels: _Levels, level: int, frame: Shown) -> np.ndarray:
    """Means of blocks, less the frame's, of flats over its signal, of darks over their noise."""
    edges = [
        np.linspace(0, size, min(BLOCKS, size) + 1)[:-1].astype(int) for size in frame.sample.shape
    ]
    sums = np.add.reduceat(np.add.reduceat(frame.sample.astype(float), edges[0], 0), edges[1], 1)
    sizes = [
        np.diff([*starts, size]) for starts, size in zip(edges, frame.sample.shape, strict=True)
    ]
    means = sums / np.outer(*sizes)
    if levels.black is None:
        return (means - means.mean()) / levels.scale(level)
    signal = abs(float(means.mean() - levels.black[level]))
    return (means - means.mean()) / max(signal, levels.noise[level], 1e-9)


def _rms(field: np.ndarray) -> float:
    return float(np.sqrt(np.mean(field**2)))


def _unevenness_in_words(odd: list[Shown], rest: list[Shown]) -> str:
    return "it shows another distribution of light over the frame than its level does"


def _noise(levels: _Levels) -> None:
    for level, frames in enumerate(levels.frames):
        if len(frames) < 3 or levels.noise[level] == 0:
            continue
        alike = _of_one_mean(frames, None if levels.black is None else levels.black[level])
        middle = np.median(alike, axis=0)
        variances = np.array([_trimmed(sample - middle) for sample in alike])
        if not (variances > 0).all():
            continue
        logs = np.log(variances)
        scatter = _scatter([abs(logs[i] - logs[j]) for i, j in _pairs(len(logs))])
        chance = np.sqrt(2 / frames[0].sample.size)
        limit = max(SURE * max(scatter, chance), np.log(OTHER_NOISE))
        far = _parted(np.abs(logs - np.median(logs)), limit, lambda: None)
        if far is not None:
            _take(levels, level, far, _noise_in_words(variances, np.median(variances), frames))


def _of_one_mean(frames: Sequence[Shown], black: float | None) -> list[np.ndarray]:
    """Samples of frames as if all had the middle one's mean: flats of a lamp that flickers are
    scaled above black, all others shifted."""
    means = np.array([frame.mean for frame in frames])
    middle = float(np.median(means))
    if black is None or np.any(means - black <= MOST * (middle - black)):
        return [frame.sample - mean + middle for frame, mean in zip(frames, means, strict=True)]
    scales = (middle - black) / (means - black)
    return [(one.sample - black) * s + black for one, s in zip(frames, scales, strict=True)]


def _noise_in_words(
    variances: np.ndarray, usual: float, frames: list[Shown]
) -> Callable[[list[Shown], list[Shown]], str]:
    by_name = {frame.name: v / usual for frame, v in zip(frames, variances, strict=True)}

    def in_words(odd: list[Shown], rest: list[Shown]) -> str:
        ratio = by_name[odd[0].name]
        return (
            f"it differs from the middle of its level by {ratio:.2g} times the variance of the "
            "others, as an averaged, smoothed or moved frame does"
        )

    return in_words


def _lit(levels: _Levels) -> list[int]:
    """Levels that are left, in the order of their light."""
    there = [i for i, frames in enumerate(levels.frames) if frames and levels.light[i] > 0]
    return sorted(there, key=lambda i: levels.light[i])


def _signals(levels: _Levels, there: list[int]) -> np.ndarray:
    assert levels.black is not None
    means = [np.median([frame.mean for frame in levels.frames[i]]) for i in there]
    return np.maximum(np.array(means) - levels.black[there], 1e-9)


def _light_of_levels(levels: _Levels) -> None:
    """Levels without light, and those whose light departs from that of both neighbours in the same
    direction, as no smooth response makes it."""
    assert levels.black is not None
    there = _lit(levels)
    if len(there) < FEWEST_LEVELS:
        return
    signal, light = _signals(levels, there), levels.light[there]
    told = float(np.median(signal / light)) * light
    noise = np.maximum(levels.noise[there], 1 / np.sqrt(12))
    for place in np.flatnonzero((signal < HALF * noise) & (told > SURE * noise)):
        frames = levels.frames[there[place]]
        mean = float(np.median([frame.mean for frame in frames]))
        reason = (
            f"the mean is {mean:.5g} DN, {levels.black[there[place]]:.5g} DN without light, where "
            f"the other levels tell a signal of {told[place]:.3g} DN, as where the lamp was off or "
            "the shutter closed"
        )
        levels.remove(there[place], range(len(frames)), reason)
    there = _lit(levels)
    if len(there) < FEWEST_LEVELS:
        return
    signal, light = _signals(levels, there), levels.light[there]
    for place in _peaks(np.log(signal / light), np.log1p(SPIKE), levels.noise[there] / signal):
        frames = levels.frames[there[place]]
        if not frames:
            continue
        other = _exchanged(signal, light, place)
        if other is not None and levels.frames[there[other]]:
            with_it = levels.frames[there[other]]
            names = tuple(frame.name for frame in (*frames, *with_it))
            reason = (
                f"the signals of {frames[0].name} and {with_it[0].name} fit the other levels where "
                "their light is exchanged"
            )
            levels.odd.append(Odd(names, reason))
            levels.frames[there[place]] = levels.frames[there[other]] = []
            continue
        usual = signal[place] / light[place] / _beside(signal / light, place)
        reason = f"the signal is {usual:.3g} times what the levels beside it tell for its light"
        top = float(np.mean([frame.at_top for frame in frames]))
        if top > MOSTLY:
            reason = f"{format_percent(top)} of the pixels are saturated, and {reason}"
        levels.remove(there[place], range(len(frames)), reason)


def _noise_of_levels_beside(levels: _Levels) -> None:
    """Levels whose variance for their signal departs from both neighbours in one direction."""
    there = _lit(levels)
    if len(there) < FEWEST_LEVELS:
        return
    signal = _signals(levels, there)
    varied = np.array([_noise_of(levels.frames[i]) ** 2 for i in there])
    rates = np.maximum(varied, 1e-12 * signal) / signal
    saturated = rates < 0.5 * np.median(rates)
    count = len(there) if saturated.all() else int(np.flatnonzero(~saturated)[-1]) + 1
    sizes = np.array([levels.frames[i][0].sample.size for i in there])
    for place in _peaks(np.log(rates[:count]), np.log(OTHER_NOISE), np.sqrt(2 / sizes)):
        ratio = rates[place] / _beside(rates, place)
        less = "copies, averaged or smoothed frames do"
        more = "frames do that moved, or that were taken at another gain"
        levels.remove(
            there[place],
            range(len(levels.frames[there[place]])),
            f"they differ from each other by {ratio:.2g} times the variance that the levels "
            f"beside them tell for their signal, as {less if ratio < 1 else more}",
        )


def _beside(values: np.ndarray, place: int) -> float:
    return float(np.mean(values[[place - 1, place + 1]]))


def _peaks(values: np.ndarray, size: float, chance: np.ndarray) -> list[int]:
    """Places beyond both neighbours by more than a size and than chance, the farthest first; a
    place beside a farther one is judged without that."""
    left, found = list(range(len(values))), []
    while len(left) > 2:
        own, around = np.array(left[1:-1]), (np.array(left[:-2]), np.array(left[2:]))
        away = [values[own] - values[side] for side in around]
        same = np.sign(away[0]) == np.sign(away[1])
        beyond = np.where(same, np.minimum(*np.abs(away)), 0.0)
        beyond = np.where(beyond > SURE * chance[own], beyond, 0.0)
        if beyond.max() <= size:
            return found
        found.append(int(own[int(np.argmax(beyond))]))
        left.remove(found[-1])
    return found


def _exchanged(signal: np.ndarray, light: np.ndarray, place: int) -> int | None:
    """The level with whose light this one's is exchanged; None where it is not."""
    rates = signal / light
    usual = float(np.median(rates))
    for other in range(len(light)):
        swapped = signal[[place, other]] / light[[other, place]] / usual
        if other != place and light[other] != light[place]:
            stated = np.abs(np.log(rates[[place, other]] / usual))
            if np.all(np.abs(np.log(swapped)) < UNEVEN) and np.all(stated > np.log1p(SPIKE)):
                return other
    return None


def odd_exposures(
    where: str | Path, frames: Sequence[Shown], times: ArrayLike, *, full_scale: float
) -> list[Odd]:
    """Images of one still scene that show another one, or less light than a shorter image.

    Args:
        where: the images lie, for messages.
        frames: with their codes.
        times: (frames,) s.
        full_scale: of the codes, DN.

    Returns:
        What does not belong.

    Raises:
        InputError: where half of the images would be left out.
    """
    gone = {name for one in blank_images(frames) for name in one.names}
    left = [i for i, frame in enumerate(frames) if frame.name not in gone]
    odd, seconds = [], np.asarray(times, float)
    for test in (_copied_exposures, _of_another_scene, _out_of_order):
        for i, reason in test(frames, seconds, left, full_scale).items():
            odd.append(Odd((frames[i].name,), reason))
            left.remove(i)
    refuse_half(where, odd, len(frames))
    return odd


def blank_images(frames: Sequence[Shown]) -> list[Odd]:
    """Images that are saturated, or of one code, throughout.

    Args:
        frames: with their codes.

    Returns:
        Those that show nothing.
    """
    return [
        Odd((frame.name,), f"every pixel is {state}, which tells nothing of a scene")
        for frame in frames
        for state in ["saturated" if frame.at_top > BLANK else f"{frame.mean:.4g} DN"]
        if frame.at_top > BLANK or np.ptp(frame.sample) == 0
    ]


def _clear(
    frames: Sequence[Shown], i: int, j: int, full_scale: float
) -> tuple[np.ndarray, np.ndarray]:
    """Sampled codes of two images where both are neither black nor saturated."""
    one, other = frames[i].sample, frames[j].sample
    if one.shape != other.shape:
        return np.zeros(0), np.zeros(0)
    least = [float(x.min()) + 0.02 * full_scale for x in (one, other)]
    kept = (one > least[0]) & (other > least[1])
    kept &= (one < 0.95 * full_scale) & (other < 0.95 * full_scale)
    return one[kept], other[kept]


def _copied_exposures(
    frames: Sequence[Shown], times: np.ndarray, left: list[int], full_scale: float
) -> dict[int, str]:
    """Images that are equal in every pixel, though their exposures are not."""
    copies = Copies()
    for i in left:
        copies.add(frames[i].name, frames[i].sample)
    found = {name: COPIED.format(listed(names)) for names in copies.found for name in names}
    return {i: found[frames[i].name] for i in left if frames[i].name in found}


def _of_another_scene(
    frames: Sequence[Shown], times: np.ndarray, left: list[int], full_scale: float
) -> dict[int, str]:
    """Images whose brighter pixels are not the brighter ones of any other, where those agree."""
    alike = np.full((len(frames), len(frames)), np.nan)
    for i, j in combinations(left, 2):
        one, other = _clear(frames, i, j, full_scale)
        if len(one) >= FEWEST_CLEAR and min(one.std(), other.std()) > CONTRAST * full_scale:
            ranks = [np.argsort(np.argsort(x)) for x in (one, other)]
            alike[i, j] = alike[j, i] = np.corrcoef(ranks[0], ranks[1])[0, 1]
    known = [i for i in left if not np.isnan(alike[i]).all()]
    if len(known) < 3:
        return {}
    best = {i: float(np.nanmax(alike[i])) for i in known}
    usual = float(np.median(list(best.values())))
    return {
        i: f"its pixels are ordered as in no other image (rank correlation {best[i]:.2f} at best, "
        f"{usual:.2f} among the others), as those of another scene or view are"
        for i in known
        if best[i] < UNLIKE < LIKE < usual
    }


def _out_of_order(
    frames: Sequence[Shown], times: np.ndarray, left: list[int], full_scale: float
) -> dict[int, str]:
    """Images that are darker than shorter ones, or brighter than longer ones."""
    darker = _darker(frames, left, full_scale)
    wrong = _contradictions(darker, times)
    if not wrong:
        return {}
    exchanged = []
    for pair in combinations(left, 2):
        swapped = times.copy()
        swapped[list(pair)] = times[list(pair[::-1])]
        if not _contradictions(darker, swapped):
            exchanged.append(pair)
    alone = [i for i in left if all(i in pair for pair in wrong)]
    out = list(exchanged[0]) if len(exchanged) == 1 else alone[:1]
    out = out or sorted({i for pair in wrong for i in pair})
    told = " and ".join(f"{frames[j].name} is darker than {frames[i].name}" for i, j in wrong[:2])
    why = f"{told}, though the exposure that is stated is longer"
    return dict.fromkeys(
        out, f"{why}; check the order of the times, and that no image is a negative"
    )


def _darker(
    frames: Sequence[Shown], left: list[int], full_scale: float
) -> Bool[np.ndarray, "frames frames"]:
    """Whether an image is darker than another at most pixels where both are clear."""
    found = np.zeros((len(frames), len(frames)), bool)
    for i, j in combinations(left, 2):
        one, other = frames[i].sample, frames[j].sample
        if one.shape == other.shape:
            lit = np.maximum(one, other) > min(one.min(), other.min()) + 0.02 * full_scale
            clear = lit & (np.minimum(one, other) < 0.95 * full_scale)
            if clear.sum() >= FEWEST_CLEAR:
                # By more than images differ that show hardly any light.
                less = 0.01 * full_scale
                found[i, j] = np.mean(one[clear] < other[clear] - less) > 0.5
                found[j, i] = np.mean(other[clear] < one[clear] - less) > 0.5
    return found


def _contradictions(
    darker: Bool[np.ndarray, "frames frames"], times: np.ndarray
) -> list[tuple[int, int]]:
    """Pairs of a shorter and a longer image of which the longer is the darker one."""
    longer = times[None, :] > LONGER * times[:, None]
    return [(int(i), int(j)) for i, j in np.argwhere(longer & darker.T)]


@dataclass(frozen=True)
class Stated:
    """A frame as a rig states it.

    Attributes:
        name: of the frame.
        path: where it lies.
        exposure: s; 0 where the rig states none.
        group: of frames that see the same light through the same lens.
    """

    name: str
    path: Path
    exposure: float
    group: int = 0


def odd_heads(where: str | Path, frames: Sequence[Stated]) -> tuple[list[Odd], list[str]]:
    """Frames of one gain and temperature whose heads contradict the rig, or most of the others.

    Args:
        where: the frames lie, for messages.
        frames: as the rig states them; what lies in no file, and what has no head, says nothing.

    Returns:
        What does not belong, and remarks on what heads say otherwise.

    Raises:
        InputError: where no ISO speed, camera or aperture is that of most frames.
    """
    said = {one.name: _settings(one.path) for one in frames}
    odd: dict[str, str] = {}
    for group in (frames, *(list(own) for own in _grouped(frames))):
        for key, in_words in _UNIFORM if group is frames else _OF_A_GROUP:
            values = {one.name: getattr(said[one.name], key) for one in group}
            odd |= _minority(where, {k: v for k, v in values.items() if v is not None}, in_words)
    warmth = {name: one.temperature for name, one in said.items() if one.temperature is not None}
    usual = float(np.median(list(warmth.values()))) if warmth else 0.0
    for name, kelvin in warmth.items():
        if abs(kelvin - usual) > WARMER:
            odd.setdefault(name, f"its head says {kelvin:.4g} K, those of the others {usual:.4g} K")
    mistimed, remarks = _mistimed(frames, said)
    found = [Odd((name,), reason) for name, reason in (mistimed | odd).items()]
    return found, remarks


def _settings(path: Path) -> ImageSettings:
    """Of a file; empty where there is none or where it cannot be read, as its pixels will show."""
    try:
        return read_settings(path) if path.is_file() else ImageSettings()
    except InputError:
        return ImageSettings()


def _grouped(frames: Sequence[Stated]) -> list[list[Stated]]:
    groups: dict[int, list[Stated]] = {}
    for one in frames:
        groups.setdefault(one.group, []).append(one)
    return list(groups.values())


_UNIFORM: list[tuple[str, Callable[[Any], str]]] = [("iso", lambda iso: f"ISO {iso:g}")]
_OF_A_GROUP: list[tuple[str, Callable[[Any], str]]] = [
    ("camera", str),
    ("f_number", lambda number: f"f/{number:.3g}"),
]


def _alike(one: Any, other: Any) -> bool:
    if isinstance(one, str):
        return one == other
    return abs(one - other) <= SAME * max(abs(one), abs(other))


def _minority(
    where: str | Path, values: Mapping[str, Any], in_words: Callable[[Any], str]
) -> dict[str, str]:
    """Why, by name, of the frames whose head says something else than those of most."""
    if len(values) < 2:
        return {}
    votes = {name: sum(_alike(own, x) for x in values.values()) for name, own in values.items()}
    first = max(votes, key=lambda name: votes[name])
    others = [name for name, own in values.items() if not _alike(own, values[first])]
    if not others:
        return {}
    if 2 * votes[first] <= len(values):
        raise InputError(
            f"{where}: the head of {first} says {in_words(values[first])}, that of {others[0]} "
            f"{in_words(values[others[0]])}; keep frames that were taken alike, or state in the "
            "rig what differs."
        )
    usual = in_words(values[first])
    return {
        name: f"its head says {in_words(values[name])}, those of the others {usual}"
        for name in others
    }


def _mistimed(
    frames: Sequence[Stated], said: Mapping[str, ImageSettings]
) -> tuple[dict[str, str], list[str]]:
    """Frames whose head says another exposure than the rig, if those of most agree with it."""
    timed = [(one, said[one.name].exposure) for one in frames if one.exposure > 0]
    ratios = {one.name: time / one.exposure for one, time in timed if time}
    if not ratios:
        return {}, []
    usual = float(np.median(list(ratios.values())))
    off = [name for name, ratio in ratios.items() if abs(ratio / usual - 1) > ROUNDED]
    by_name = {one.name: one for one in frames}

    def told(name: str) -> str:
        stated, head = by_name[name].exposure, said[name].exposure
        return f"its head says an exposure of {head:.4g} s, the rig {stated:.4g} s"

    if 2 * len(off) >= len(ratios):
        return {}, [f"{off[0]}: {told(off[0])}, and others differ too; the rig's times are used."]
    remarks = []
    if abs(usual - 1) > ROUNDED:
        remarks.append(
            f"The heads of the files say exposures {usual:.4g} times those of the rig, which are "
            "used."
        )
    return {name: told(name) for name in off}, remarks
