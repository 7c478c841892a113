"""Bits of a converter that never change, so that half of the codes never occur.

Where columns, rows or sites have converters of their own, a bit may be stuck in some of them alone.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int

WIDE = 0.5  # noise of a pixel over a bit's value, from which both of its states occur
FEWEST = 64  # pixels of a line, among which both then occur
MOST = 0.75  # of the lines; a bit that is stuck in more of them makes the converter's own grid
SHOWN = 4  # lines that are listed
SITES = 2  # rows and columns of a cell


class StuckBit(NamedTuple):
    """Where a bit never changes.

    Attributes:
        where: in which pixels, in words.
        bit: index of the bit, 0 the lowest.
        value: the value that the bit always has.
        mask: (h, w) true in these pixels.
    """

    where: str
    bit: int
    value: int
    mask: Bool[np.ndarray, "h w"]

    @property
    def clause(self) -> str:
        """The clause for a report."""
        return (
            f"in {self.where}, where bit {self.bit} of the codes is always {self.value} and half "
            "of the codes never occur"
        )


def stuck_bits(frames: Sequence[np.ndarray]) -> list[StuckBit]:
    """Bits that are stuck in some columns, rows or sites of a cell of 2 x 2.

    Example:
        >>> from fitting.noise.stuck_bits import stuck_bits
        >>> frames = np.random.default_rng(0).normal(900, 20, (4, 50, 60)).round()
        >>> frames[:, :, 7] = frames[:, :, 7].astype(int) | 8
        >>> print(stuck_bits(list(frames))[0].clause[:53])
        in column 7, where bit 3 of the codes is always 1 and
    """
    if len(frames) < 2 or not all(np.array_equal(one, np.floor(one)) for one in frames[:2]):
        return []
    noise = float(np.median(np.abs(frames[1] - frames[0]))) / 0.9539
    highest = int(np.floor(np.log2(noise / WIDE))) if noise > WIDE else -1
    whole = [one.astype(np.int64) for one in frames if one.min() >= 0]
    if highest < 0 or len(whole) < 2:
        return []
    found: list[StuckBit] = []
    for lines in _groups(whole[0].shape):
        found += _stuck(whole, *lines, highest)
        if found:
            break
    return found


def _groups(shape: tuple[int, ...]) -> Iterator[tuple[str, Int[np.ndarray, "h w"]]]:
    """For each pixel, the name and number of its line."""
    rows, columns = np.indices(shape)
    yield "column", columns
    yield "row", rows
    yield "site", SITES * (rows % SITES) + columns % SITES


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
            if len(own) and still.sum() <= MOST * len(changes):
                found.append(StuckBit(_words(name, own), bit, value, np.isin(line, own)))
    return found


def _words(name: str, lines: np.ndarray) -> str:
    if name == "site":
        places = ", ".join(f"({i // SITES}, {i % SITES})" for i in lines)
        return f"the pixels of row and column {places} of every cell of 2 x 2"
    if len(lines) == 1:
        return f"{name} {lines[0]}"
    listed = ", ".join(str(i) for i in lines[:SHOWN])
    if len(lines) <= SHOWN:
        return f"{name}s {listed}"
    return f"{len(lines)} {name}s ({listed}, ...)"
