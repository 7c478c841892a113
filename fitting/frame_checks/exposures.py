"""Checks whether images of one still scene agree with their stated exposures."""

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from jaxvision import ArrayLike
from jaxvision.errors import InputError

from ..copies import Copies
from .frame import COPIED, FrameSample, OddFrames, listed, refuse_half

BLANK = 0.999  # share of saturated pixels of an image without information
LONGER = 1.2  # ratio of exposures from which the longer image must be brighter
FEWEST_CLEAR, CONTRAST = 200, 0.02  # pixels needed to compare scenes; least spread, of full scale
LEAST_RISE = 0.01  # of full scale, by which a stop of exposure brightens any camera's codes
UNLIKE, LIKE = 0.6, 0.9  # rank correlation: at most for another scene, at least for the same scene


def odd_exposures(
    where: str | Path, frames: Sequence[FrameSample], times: ArrayLike, *, full_scale: float
) -> list[OddFrames]:
    """Return the images to leave out: copies, images of another scene, or in the wrong order."""
    gone = {name for one in blank_images(frames) for name in one.names}
    left = [i for i, frame in enumerate(frames) if frame.name not in gone]
    odd, seconds = [], np.asarray(times, float)
    for test in (_copied_exposures, _other_scene_images, _find_disordered):
        for i, reason in test(frames, seconds, left, full_scale).items():
            odd.append(OddFrames((frames[i].name,), reason))
            left.remove(i)
    refuse_half(where, odd, len(frames))
    return odd


def blank_images(frames: Sequence[FrameSample]) -> list[OddFrames]:
    """Return the images that are saturated everywhere, or have the same code everywhere."""
    return [
        OddFrames((frame.name,), f"every pixel is {state}, so it does not show the scene")
        for frame in frames
        for state in ["saturated" if frame.at_top > BLANK else f"{frame.mean:.4g} DN"]
        if frame.at_top > BLANK or np.ptp(frame.sample) == 0
    ]


def refuse_toned(
    where: str | Path, frames: Sequence[FrameSample], times: ArrayLike, *, full_scale: float
) -> None:
    """Refuse images made equally bright although their exposures differ."""
    seconds, rises = np.asarray(times, float), []
    fixed = np.zeros(frames[0].sample.shape, bool) if frames else np.zeros(0, bool)
    if len({frame.sample.shape for frame in frames}) == 1:  # bars and overlays
        fixed = np.all([frame.sample == frames[0].sample for frame in frames], axis=0)
    for i, j in combinations(np.argsort(seconds), 2):
        stops, one, other = np.log2(seconds[j] / seconds[i]), frames[i].sample, frames[j].sample
        middle = (one > 0.05 * full_scale) & (one < 0.95 * full_scale)
        if one.shape == fixed.shape and not fixed.all():
            middle &= ~fixed
        if stops >= 1 and one.shape == other.shape and middle.sum() >= FEWEST_CLEAR:
            rises.append(float(np.median((other - one)[middle])) / full_scale / stops)
    if rises and np.median(np.abs(rises)) < LEAST_RISE:
        means, ratio = sorted(frame.mean for frame in frames), seconds.max() / seconds.min()
        raise InputError(
            f"{where}: the images are equally bright (means of {means[0]:.4g} to {means[-1]:.4g} "
            f"DN) although their exposures differ by a factor of {ratio:.3g}, as with automatic "
            "exposure, brightness or tone; give images of one still scene in one light, developed "
            "without automatic corrections."
        )


def _clear(
    frames: Sequence[FrameSample], i: int, j: int, full_scale: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the codes of two images at sampled pixels that neither clips."""
    one, other = frames[i].sample, frames[j].sample
    if one.shape != other.shape:
        return np.zeros(0), np.zeros(0)
    least = [float(x.min()) + 0.02 * full_scale for x in (one, other)]
    kept = (one > least[0]) & (other > least[1])
    kept &= (one < 0.95 * full_scale) & (other < 0.95 * full_scale)
    return one[kept], other[kept]


def _copied_exposures(
    frames: Sequence[FrameSample], times: np.ndarray, left: list[int], full_scale: float
) -> dict[int, str]:
    """Return the images that equal another in every sampled pixel, with the reason."""
    copies = Copies()
    for i in left:
        copies.add(frames[i].name, frames[i].sample)
    found = {name: COPIED.format(listed(names)) for names in copies.equal_groups for name in names}
    return {i: found[frames[i].name] for i in left if frames[i].name in found}


def _other_scene_images(
    frames: Sequence[FrameSample], times: np.ndarray, left: list[int], full_scale: float
) -> dict[int, str]:
    """Return the images that correlate with no other image although most do, with the reason."""
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
        i: "the brightness order of its pixels matches no other image (rank correlation "
        f"{best[i]:.2f} at best, {usual:.2f} among the others), as with another scene or view"
        for i in known
        if best[i] < UNLIKE < LIKE < usual
    }


def _find_disordered(
    frames: Sequence[FrameSample], times: np.ndarray, left: list[int], full_scale: float
) -> dict[int, str]:
    """Return images in the wrong order of brightness, or the two that were exchanged."""
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
    pairs = [f"{frames[j].name} is darker than {frames[i].name}" for i, j in wrong[:2]]
    why = f"{' and '.join(pairs)}, although the stated exposure is longer"
    return dict.fromkeys(
        out, f"{why}; check the order of the times, and that no image is a negative"
    )


def _darker(
    frames: Sequence[FrameSample], left: list[int], full_scale: float
) -> Bool[np.ndarray, "frames frames"]:
    """Return a matrix: whether image i is darker than j at most unclipped pixels."""
    found = np.zeros((len(frames), len(frames)), bool)
    for i, j in combinations(left, 2):
        one, other = frames[i].sample, frames[j].sample
        if one.shape == other.shape:
            lit = np.maximum(one, other) > min(one.min(), other.min()) + 0.02 * full_scale
            clear = lit & (np.minimum(one, other) < 0.95 * full_scale)
            if clear.sum() >= FEWEST_CLEAR:
                # By more than two images differ if they show hardly any light.
                less = 0.01 * full_scale
                found[i, j] = np.mean(one[clear] < other[clear] - less) > 0.5
                found[j, i] = np.mean(other[clear] < one[clear] - less) > 0.5
    return found


def _contradictions(
    darker: Bool[np.ndarray, "frames frames"], times: np.ndarray
) -> list[tuple[int, int]]:
    """Return (shorter, longer) pairs in which the longer exposure gives the darker image."""
    longer = times[None, :] > LONGER * times[:, None]
    return [(int(i), int(j)) for i, j in np.argwhere(longer & darker.T)]
