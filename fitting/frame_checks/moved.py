"""Detection of flats between which the camera or an object in front of it moved.

Unequal pixel gains, dust and uneven light cause the same pattern in all frames of a level, so this
pattern cancels in the difference of two frames. If the camera or an object moved between two
frames, another pattern remains in their difference. This pattern has the same shape at all levels,
and grows with the signal."""

from itertools import combinations

import numpy as np

from .compared import (
    OTHER_NOISE,
    SURE,
    ComparedLevels,
    scaled_to_one_mean,
    subtract_line_means,
    trimmed_variance,
)
from .frame import OddFrames, listed

FEWEST_LEVELS = 3  # levels at which frames differ by the same pattern
ALIKE = 0.05  # correlation of differences at two levels below which gain errors are small
MOST_FRAMES = 24  # frames up to which all pairs are compared


def moved_frames(levels: ComparedLevels) -> None:
    """Remove frames that differ from their level by a pattern that other levels share."""
    if levels.black is None:
        return
    samples = {
        level: scaled_to_one_mean(frames, float(levels.black[level]))
        for level, frames in enumerate(levels.frames)
        if 2 <= len(frames) <= MOST_FRAMES and levels.light[level] > 0
    }
    parted = {
        level: found for level, own in samples.items() if (found := _group_frames(own)) is not None
    }
    apart = {level: _difference(samples[level], groups) for level, (groups, _) in parted.items()}
    if len(apart) < FEWEST_LEVELS or len({field.size for field in apart.values()}) > 1:
        return
    least = max(SURE / np.sqrt(next(iter(apart.values())).size), ALIKE)
    alike = [
        level
        for level, own in apart.items()
        if np.median([abs(own @ apart[i]) for i in apart if i != level]) > least
    ]
    if len(alike) < FEWEST_LEVELS:
        return
    groups = {level: parted[level][0] for level in alike}
    # In dim levels, noise hides the same pattern.
    usual = groups[max(alike, key=lambda level: levels.light[level])]
    for level, own in samples.items():
        if level not in parted and len(own) == sum(map(len, usual)):
            field = _difference(own, usual)
            if np.median([abs(field @ apart[i]) for i in alike]) > SURE / np.sqrt(field.size):
                groups[level] = usual
    _leave_out(levels, groups, [parted[level][1] for level in alike])


def _difference(samples: list[np.ndarray], groups: list[list[int]]) -> np.ndarray:
    """Return the difference between the means of two groups without flicker bands, of norm 1."""
    first, second = (np.mean([samples[i] for i in group], axis=0) for group in groups[:2])
    field = subtract_line_means((second - first).astype(float)).ravel()
    return field / max(float(np.linalg.norm(field)), 1e-300)


def _group_frames(samples: list[np.ndarray]) -> tuple[list[list[int]], float] | None:
    """Group frames that differ by noise alone; return groups, and variance across over within."""
    if len(samples) == 2:
        return [[0], [1]], np.nan
    variances = {
        (i, j): trimmed_variance(samples[j] - samples[i])
        for i, j in combinations(range(len(samples)), 2)
    }
    least = min(variances.values())
    if not least > 0:
        return None
    groups: list[list[int]] = []
    for i in range(len(samples)):
        own = [g for g in groups if any(variances[j, i] < OTHER_NOISE * least for j in g)]
        if len(own) > 1:
            return None
        if own:
            own[0].append(i)
        else:
            groups.append([i])
    groups.sort(key=len, reverse=True)
    within = [variances[pair] for group in groups for pair in combinations(group, 2)]
    across = [v for pair, v in variances.items() if not any({*pair} <= {*g} for g in groups)]
    if not across or not within or max(within) > OTHER_NOISE * least:
        return None
    return groups, float(np.median(across) / np.median(within))


def _leave_out(
    levels: ComparedLevels, groups: dict[int, list[list[int]]], ratios: list[float]
) -> None:
    """Remove, at each level, the frames outside the largest group, or both frames of a pair."""
    gone: dict[bool, list[str]] = {True: [], False: []}
    example = ""
    for level in sorted(groups):
        frames = levels.frames[level]
        kept, *others = groups[level]
        pair = len(frames) == 2
        places = range(2) if pair else sorted(i for group in others for i in group)
        example = example or listed([frames[i].name for i in kept])
        gone[pair] += [frames[i].name for i in places]
        levels.frames[level] = [frame for i, frame in enumerate(frames) if i not in set(places)]
    cause = "as if the camera or something in front of it moved"
    if gone[True]:
        reason = (
            "the two frames of a level differ by a pattern that is the same at other levels and "
            f"grows with the light, {cause} in between"
        )
        levels.odd.append(OddFrames(tuple(gone[True]), reason))
    if gone[False]:
        ends = " to ".join(f"{ratio:.2g}" for ratio in (np.nanmin(ratios), np.nanmax(ratios)))
        reason = (
            f"the other frames of a level agree with each other, as {example} do, but differ from "
            f"these by {ends} times that variance, in a pattern that is the same at other levels, "
            f"{cause}"
        )
        levels.odd.append(OddFrames(tuple(gone[False]), reason, spare=True))
