"""Comparison of the metadata of image files (exposure, ISO, gain, aperture, temperature) with the
rig and with each other."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxvision.errors import InputError
from jaxvision.files.image_settings import ImageSettings, read_settings

from .frame import OddFrames

SAME = 0.02  # relative difference of exposures and apertures from rounded metadata
ROUNDED = 0.1  # relative difference of an exposure from its rounded value
WARMER = 5.0  # K, largest drift of a sensor during a series


@dataclass(frozen=True)
class Stated:
    """A frame as the rig file states it: its name, file, exposure and group."""

    name: str  # of the frame
    path: Path  # of its file
    exposure: float  # s; 0 where the rig states none
    group: int = 0  # number of the group of frames in the same light through the same lens


def odd_heads(where: str | Path, frames: Sequence[Stated]) -> tuple[list[OddFrames], list[str]]:
    """Return frames whose metadata contradict the rig or the majority, and remarks."""
    said = {one.name: _settings(one.path) for one in frames}
    odd: dict[str, str] = {}
    groups: dict[int, list[Stated]] = {}
    for one in frames:
        groups.setdefault(one.group, []).append(one)
    for group in (frames, *groups.values()):
        for key, in_words in _UNIFORM if group is frames else _OF_A_GROUP:
            values = {one.name: getattr(said[one.name], key) for one in group}
            odd |= _minority(where, {k: v for k, v in values.items() if v is not None}, in_words)
    warmth = {name: one.temperature for name, one in said.items() if one.temperature is not None}
    usual = float(np.median(list(warmth.values()))) if warmth else 0.0
    for name, kelvin in warmth.items():
        if abs(kelvin - usual) > WARMER:
            odd.setdefault(
                name, f"its metadata say {kelvin:.4g} K, those of the others {usual:.4g} K"
            )
    mistimed, remarks = _compare_exposures(frames, said)
    found = [OddFrames((name,), reason) for name, reason in (mistimed | odd).items()]
    return found, remarks


def different_settings(paths: Sequence[Path]) -> str:
    """Name exposures and gains that differ between files according to metadata; "" for none."""
    said, words = [_settings(path) for path in paths], []
    exposure: tuple[str, Callable[[Any], str]] = ("exposure", lambda t: f"exposure {t:.4g} s")
    for key, in_words in (exposure, *_UNIFORM, _OF_A_GROUP[1]):
        values = [value for one in said if (value := getattr(one, key)) is not None]
        if values and max(values) > (1 + ROUNDED) * min(values):
            words.append(f"{in_words(min(values))} to {in_words(max(values)).split(' ', 1)[-1]}")
    return ", ".join(words)


def _settings(path: Path) -> ImageSettings:
    """Read a file's metadata; empty if there are none, or if it is unreadable."""
    try:
        return read_settings(path) if path.is_file() else ImageSettings()
    except InputError:
        return ImageSettings()


def series_times(paths: Sequence[Path]) -> np.ndarray | None:
    """Return the times when files were taken, s since the first; None if unknown."""
    taken = [_settings(path).taken for path in paths]
    if not taken or any(one is None for one in taken):
        return None
    stamps = np.array([one.timestamp() for one in taken if one is not None])
    return stamps - stamps.min() if np.ptp(stamps) > 0 else None


_UNIFORM: list[tuple[str, Callable[[Any], str]]] = [
    ("iso", lambda iso: f"ISO {iso:g}"),
    ("gain", lambda gain: f"GAIN = {gain:g}"),
]
_OF_A_GROUP: list[tuple[str, Callable[[Any], str]]] = [
    ("camera", str),
    ("f_number", lambda number: f"f/{number:.3g}"),
]


def _are_equal(one: Any, other: Any) -> bool:
    if isinstance(one, str):
        return one == other
    return abs(one - other) <= SAME * max(abs(one), abs(other))


def _minority(
    where: str | Path, values: Mapping[str, Any], in_words: Callable[[Any], str]
) -> dict[str, str]:
    """Return frames whose metadata differ from the majority's, with the reason."""
    if len(values) < 2:
        return {}
    votes = {name: sum(_are_equal(own, x) for x in values.values()) for name, own in values.items()}
    first = max(votes, key=lambda name: votes[name])
    others = [name for name, own in values.items() if not _are_equal(own, values[first])]
    if not others:
        return {}
    if 2 * votes[first] <= len(values):
        raise InputError(
            f"{where}: the metadata of {first} say {in_words(values[first])}, those of {others[0]} "
            f"{in_words(values[others[0]])}. Keep frames of equal settings, or state the settings "
            "in the rig."
        )
    usual = in_words(values[first])
    return {
        name: f"its metadata say {in_words(values[name])}, those of the others {usual}"
        for name in others
    }


def _compare_exposures(
    frames: Sequence[Stated], said: Mapping[str, ImageSettings]
) -> tuple[dict[str, str], list[str]]:
    """Return frames whose exposures differ from the rig's, up to a common factor, and remarks."""
    timed = [(one, said[one.name].exposure) for one in frames if one.exposure > 0]
    ratios = {one.name: time / one.exposure for one, time in timed if time}
    if not ratios:
        return {}, []
    usual = float(np.median(list(ratios.values())))
    off = [name for name, ratio in ratios.items() if abs(ratio / usual - 1) > ROUNDED]
    by_name = {one.name: one for one in frames}

    def reason(name: str) -> str:
        stated, head = by_name[name].exposure, said[name].exposure
        return f"its metadata say an exposure of {head:.4g} s, the rig {stated:.4g} s"

    if 2 * len(off) >= len(ratios):
        return {}, [f"{off[0]}: {reason(off[0])}, and others differ too; the rig's times are used."]
    remarks = []
    if abs(usual - 1) > ROUNDED:
        remarks.append(
            f"The exposures in the metadata are {usual:.4g} times those of the rig, which are used."
        )
    return {name: reason(name) for name in off}, remarks
