"""Detection of frames that differ from the others of their light level.

A level is a set of frames taken in the same light at the same exposure. Such frames agree in mean,
in the distribution of light over the frame, and in noise. A frame is left out if it differs from
the other frames of its level by more than the usual scatter of frames, estimated at all levels, and
by enough to change results. If a level has two frames that disagree, the frame that is closer to an
interpolation of the neighbouring levels is kept.
"""

from collections.abc import Callable, Sequence
from itertools import combinations, pairwise

import numpy as np
from jaxtyping import Bool, Float

from jaxvision import ArrayLike

from ..copies import Copies
from ..inference.formatting import format_percent
from .between_levels import (
    dark_levels,
    distribution_of_levels,
    light_of_levels,
    noise_of_levels,
)
from .compared import (
    MOST,
    MOSTLY,
    OTHER_NOISE,
    SURE,
    ComparedLevels,
    beyond_chance,
    rms,
    scaled_to_one_mean,
    subtract_line_means,
    trimmed_variance,
    usual_size,
)
from .frame import COPIED, COPIED_DARKS, FrameSample, OddFrames, listed
from .moved import moved_frames

PAIRS = 2.22  # standard deviations per lower quartile of pairwise differences
LAMP = 0.005  # of the signal; a smaller flicker changes results by at most half of it
FEWEST_KNOWN = 4  # levels that give the usual distribution of light over a frame
CLOSER = 3.0  # ratio of distances to the prediction from which the nearer of two frames is right


def odd_frames(
    levels: Sequence[Sequence[FrameSample]],
    *,
    light: ArrayLike,
    black: Float[np.ndarray, " levels"] | None = None,
) -> list[OddFrames]:
    """Return frames that differ from their level, and frames of levels that stand out."""
    compared = ComparedLevels([list(level) for level in levels], np.asarray(light, float), black)
    for test in (_copies, _means, _unevenness, moved_frames, _noise):
        test(compared)
    compared.drop_single_frames()
    if black is not None:
        distribution_of_levels(compared)
        light_of_levels(compared)
        noise_of_levels(compared)
    _copies_across(compared)
    if black is None:
        dark_levels(compared)
    return compared.odd


def _scatter(distances: Sequence[float]) -> float:
    """Return the frames' deviation from a lower quartile of pairwise differences."""
    return PAIRS * float(np.quantile(distances, 0.25)) if len(distances) else 0.0


def _pairs(count: int) -> list[tuple[int, int]]:
    """Return all pairs of fewer than 24 frames, else those of successive frames."""
    return list(combinations(range(count), 2) if count < 24 else pairwise(range(count)))


def _mark_distant_frames(
    distances: Float[np.ndarray, " frames"],
    limit: float,
    expected: Float[np.ndarray, " frames"] | None,
) -> Bool[np.ndarray, " frames"] | None:
    """Return a mask of the frames that are farther than `limit` from the median of their level. If
    this marks at least half of the frames, frames that are far from the prediction of the other
    levels are marked instead; `expected` is the distance of each frame from this prediction. Return
    None if these distances do not determine which frames deviate."""
    far = distances > limit
    if 2 * far.sum() < len(far) or not far.any():
        return far
    if expected is None:
        return None
    far = expected * CLOSER > max(expected.max(), limit)
    return None if far.all() or not far.any() else far


def _copies(levels: ComparedLevels) -> None:
    dark = levels.black is None
    usual = float(np.median(levels.noise))
    for level, frames in enumerate(levels.frames):
        if not frames or (not dark and levels.light[level] <= 0):
            continue
        if dark and usual**2 * levels.sample_size(level) < SURE**2:
            continue  # frames without noise may be equal
        copies = Copies()
        for frame in frames:
            copies.add(frame.name, frame.sample)
        for first, *again in copies.equal_groups:
            places = [i for i, one in enumerate(levels.frames[level]) if one.name in again]
            levels.remove(level, f"equal to {first} in every pixel, as a copy is", places)


def _copies_across(levels: ComparedLevels) -> None:
    """Remove frames that occur at two levels from both levels, because it is unknown which frame is
    the copy. If darks consist of such copies alone, those of one level are kept."""
    dark, copies = levels.black is None, Copies()
    for level, frames in enumerate(levels.frames):
        noisy = levels.noise[level] ** 2 * levels.sample_size(level) > SURE**2
        for frame in frames if (noisy if dark else levels.light[level] > 0) else ():
            copies.add(frame.name, frame.sample)
    copied = {name for names in copies.equal_groups for name in names}
    of_levels = [{frame.name for frame in frames} for frames in levels.frames]
    keep = min((i for i, own in enumerate(of_levels) if own & copied), default=None)
    if not dark or any(len(own - copied) > 1 for own in of_levels):
        keep = None
    if dark and copied:
        gone = tuple(
            frame.name
            for level, frames in enumerate(levels.frames)
            for frame in frames
            if frame.name in copied and level != keep
        )
        levels.odd.append(OddFrames(gone, COPIED_DARKS, spare=True))
        levels.frames[:] = [[one for one in x if one.name not in gone] for x in levels.frames]
    for names in () if dark else copies.equal_groups:
        for level, frames in enumerate(levels.frames):
            places = [i for i, frame in enumerate(frames) if frame.name in names]
            if places:
                levels.remove(level, COPIED.format(listed(names)), places)
    levels.drop_single_frames()


def _means(levels: ComparedLevels) -> None:
    means = [np.array([frame.mean for frame in level]) for level in levels.frames]
    apart = [
        abs(values[i] - values[j]) / levels.scale(level)
        for level, values in enumerate(means)
        for i, j in _pairs(len(values))
    ]
    degrees = sum(len(values) - 1 for values in means if len(values))
    if levels.black is None:
        spread = SURE * _scatter(apart)
    else:
        spread = min(beyond_chance(degrees) * usual_size(apart), MOST)
    for level, values in enumerate(means):
        if len(values) < 2:
            continue
        scale, least = levels.scale(level), levels.floor(level)
        if levels.black is not None:
            # A drift of the black level shifts all levels by the same DN, whatever their light.
            drift = min(beyond_chance(degrees) * np.sqrt(2) * levels.wander, MOST * scale)
            least = max(LAMP * scale, SURE * levels.chance(level), drift)
        limit = max(spread * scale, least)
        middle = np.median(values)
        distances = np.abs(values - middle) * (2 if len(values) == 2 else 1)
        mean = levels.expected(level)
        expected = None if mean is None else np.abs(values - mean)
        _take(levels, level, _mark_distant_frames(distances, limit, expected), _mean_in_words)


def _take(
    levels: ComparedLevels,
    level: int,
    far: Bool[np.ndarray, " frames"] | None,
    in_words: Callable[[list[FrameSample], list[FrameSample]], str],
) -> None:
    """Remove the frames that a mask `far` marks, or all frames if it is None."""
    frames = levels.frames[level]
    if far is None:
        parted = f"{in_words(frames[:1], frames[1:])}, and it is unknown which of them is right"
        levels.remove(level, parted)
    elif far.any():
        for i in np.flatnonzero(far):
            rest = [one for j, one in enumerate(frames) if not far[j]]
            place = levels.frames[level].index(frames[i])
            levels.remove(level, in_words([frames[i]], rest), [place])


def _mean_in_words(odd: list[FrameSample], rest: list[FrameSample]) -> str:
    mean = float(np.median([frame.mean for frame in rest]))
    others = "the other frame" if len(rest) == 1 else "the other frames"
    means = f"its mean is {odd[0].mean:.5g} DN, that of {others} of its level {mean:.5g} DN"
    for share, end in ((odd[0].at_top, "saturated"), (odd[0].at_bottom, "0 DN")):
        if share > MOSTLY:
            return f"{format_percent(share)} of its pixels are {end}, and {means}"
    return means


def _unevenness(levels: ComparedLevels) -> None:
    fields = [
        [levels.blocks(level, frame) for frame in frames]
        for level, frames in enumerate(levels.frames)
    ]
    far = [[rms(own[i] - own[j]) for i, j in _pairs(len(own))] for level, own in enumerate(fields)]
    scatter = _scatter([x for distances in far for x in distances])
    known = [np.median(own, axis=0) for own in fields if len(own) > 1]
    usual = None
    if len(known) >= FEWEST_KNOWN and len({own.shape for own in known}) == 1:
        usual = np.median(known, axis=0)
    uneven = "its distribution of light over the frame differs from that of its level"
    for level, own in enumerate(fields):
        if len(own) < 2:
            continue
        pixels = levels.frames[level][0].sample.size / own[0].size
        chance = 2 * levels.noise[level] / np.sqrt(pixels) / levels.scale(level)
        limit = max(SURE * scatter, levels.floor(level) / levels.scale(level), 3 * chance)
        middle = np.median(own, axis=0)
        away = 2.0 if len(own) == 2 else 1.0
        distances = np.array([away * rms(field - middle) for field in own])
        expected = None if usual is None else np.array([rms(field - usual) for field in own])
        _take(
            levels,
            level,
            _mark_distant_frames(distances, limit, expected),
            lambda odd, rest: uneven,
        )


def _noise(levels: ComparedLevels) -> None:
    for level, frames in enumerate(levels.frames):
        if len(frames) < 3 or levels.noise[level] == 0:
            continue
        alike = scaled_to_one_mean(frames, None if levels.black is None else levels.black[level])
        middle = np.median(alike, axis=0)
        variances = np.array(
            [trimmed_variance(subtract_line_means(sample - middle)) for sample in alike]
        )
        if not (variances > 0).all():
            continue
        logs = np.log(variances)
        scatter = _scatter([abs(logs[i] - logs[j]) for i, j in _pairs(len(logs))])
        chance = np.sqrt(2 / frames[0].sample.size)
        limit = max(SURE * max(scatter, chance), np.log(OTHER_NOISE))
        far = _mark_distant_frames(np.abs(logs - np.median(logs)), limit, None)
        ratios = variances / np.median(variances)
        reasons = {
            frame.name: "the variance of its difference from the median of its level is "
            f"{ratio:.2g} times that of the others, as with an averaged, smoothed or moved frame"
            for frame, ratio in zip(frames, ratios, strict=True)
        }
        if far is not None:
            _take(levels, level, far, lambda odd, rest, reasons=reasons: reasons[odd[0].name])
