"""Summaries of frames for comparison with each other, and findings on frames that deviate."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxvision.errors import InputError

from ..inference.diagnostics import listed as all_listed

SIDE = 128  # pixels of a frame that are kept, along each side
ALONE = "it is the only remaining frame of its level"
COPIED_DARKS = "they are equal in every pixel to darks that are listed under another exposure"
COPIED = "{} are equal in every pixel, so at most one of them was taken as stated"


@dataclass(frozen=True)
class FrameSample:
    """The summary of a frame: means, shares of clipped pixels, and a sample of at most 128 x 128
    pixels."""

    name: str  # of the frame
    mean: float  # of the frame, DN
    at_top: float  # share of the pixels at or above the clip level
    at_bottom: float  # share of the pixels at 0
    sample: Float[np.ndarray, "rows columns"]  # DN of evenly spread pixels


@dataclass(frozen=True)
class OddFrames:
    """Frames that are left out, with the reason."""

    names: tuple[str, ...]  # names of the frames, at least one
    reason: str  # why they differ from the others, a clause
    spare: bool = False  # whether the frames are correct, but do not belong to this set of frames

    @property
    def sentence(self) -> str:
        """The finding that states the frames and the reason."""
        verb = "was" if len(self.names) == 1 else "were"
        return f"{listed(self.names)} {verb} left out: {self.reason}."


def frame_sample(name: str, frame: Float[np.ndarray, "h w"], *, top: float) -> FrameSample:
    """Summarise a frame whose pixels clip at `top` DN."""
    steps = [-(-size // SIDE) for size in frame.shape]
    sample = frame[steps[0] // 2 :: steps[0], steps[1] // 2 :: steps[1]].astype(np.float32)
    return FrameSample(
        name, float(frame.mean()), float((frame >= top).mean()), float((frame <= 0).mean()), sample
    )


def listed(names: Sequence[str]) -> str:
    """List names for a sentence: the first three of more than four, and a count."""
    return all_listed([*names] if len(names) <= 4 else [*names[:3], f"{len(names) - 3} more"])


def refuse_half(where: str | Path, odd: Sequence[OddFrames], count: int) -> None:
    """Refuse a series of which half the frames would be left out: the user must decide."""
    wrong = [one for one in odd if not one.spare]
    if 2 * sum(len(one.names) for one in wrong) >= count > 0:
        first = wrong[0]
        raise InputError(
            f"{where}: at least half of its {count} frames do not match the others "
            f"({listed(first.names)}: {first.reason}). Keep those that belong, remove the others."
        )
