"""Flats and darks of the camera in the same rig. Their temporal noise gives gain and read noise,
and darks give the black level."""

import os
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jaxvision.errors import InputError
from jaxvision.files.images import read_image

from ...frame_checks.frame import FrameSample, frame_sample, refuse_half
from ...frame_checks.levels import odd_frames
from ...noise.settings import require_one_setting
from ...observation import Load, one_site, read_stack, to_one_site
from ...rig import Dark, Flat, Rig, as_rig
from .read import Photographs, UniformLevels, read_reflectance_observation


def read_joint_measurement(
    rig: Rig | str | os.PathLike[str], *, load: Load = read_image
) -> Photographs:
    """Read and check the images of a rig, its flats and its darks.

    Args:
        rig: with `[[light]]` and `[geometry]`, and optional `[[flat]]` and `[[dark]]`; or its
            folder or file.
        load: function that reads an image from its path.

    Returns:
        The photographs, with the levels of flats and darks.

    Raises:
        InputError: as for the reflectance calibration, and for flats and darks that do not match.
    """
    rig = as_rig(rig)
    observation = read_reflectance_observation(rig, load=load)
    encoded = observation.gamma is not None
    rig, findings = _without_odd_frames(rig, load)
    if encoded and rig.dark:
        findings.append(
            "The files are gamma encoded: darks, at the foot of the curve, were left out."
        )
    return replace(
        observation,
        levels=_levels(rig, len(observation.channels), load, with_darks=not encoded),
        findings=(*findings, *observation.findings),
    )


def _without_odd_frames(rig: Rig, load: Load) -> tuple[Rig, list[str]]:
    """A rig without the flats and darks that deviate from the others, with the reason."""
    sentences: list[str] = []
    black = np.zeros(0)
    kept: dict[str, list[Flat | Dark]] = {"dark": [], "flat": []}
    for kind in kept:
        entries: Sequence[Flat | Dark] = getattr(rig, kind)
        if not entries:
            continue
        levels = [_samples_of(rig, entry, load) for entry in entries]
        light = [getattr(entry, "photons", None) or entry.exposure for entry in entries]
        is_flat = kind == "flat"
        floor = np.median(black) if black.size else one_site(rig.camera).black_level or 0.0
        odd = odd_frames(
            levels, light=light, black=np.full(len(levels), floor) if is_flat else None
        )
        refuse_half(rig.folder, odd, sum(len(level) for level in levels))
        sentences += [one.sentence for one in odd]
        gone = {name for one in odd for name in one.names}
        black = np.array([one.mean for level in levels for one in level if one.name not in gone])
        for entry in entries:
            if files := tuple(name for name in entry.files if name not in gone):
                kept[kind].append(entry.model_copy(update={"files": files}))
    return rig.model_copy(update={kind: tuple(own) for kind, own in kept.items()}), sentences


def _samples_of(rig: Rig, entry: Flat | Dark, load: Load) -> list[FrameSample]:
    """The summaries of a level's frames; for colours, of their mean."""
    stack = read_stack(rig, entry.files, load=load)
    grey = stack.mean(axis=3) if stack.ndim == 4 else stack
    top = one_site(rig.camera).clip_level
    return [
        frame_sample(name, frame, top=top) for name, frame in zip(entry.files, grey, strict=True)
    ]


def _levels(
    rig: Rig, channels: int, load: Load, *, with_darks: bool
) -> tuple[UniformLevels, ...] | None:
    entries = [*rig.flat, *(rig.dark if with_darks else ())]
    if not entries:
        return None
    require_one_setting(rig, "give those of the images' gain and temperature alone")
    rows = np.array([_level(rig, entry.files, channels, load) for entry in entries])
    dark = np.arange(len(entries)) >= len(rig.flat)
    levels = tuple(UniformLevels(*rows[:, channel].T, dark=dark) for channel in range(channels))
    for channel in levels:
        if (channel.variance <= 0).any():
            first = entries[int(np.argmax(channel.variance <= 0))].files[0]
            raise InputError(
                f"{rig.path(first)}: its frames are equal in every pixel, so they are copies, "
                "clipped or saturated; give independent frames at another level."
            )
    return levels


def _level(rig: Rig, files: tuple[str, ...], channels: int, load: Load) -> np.ndarray:
    """(channels, 4): mean, temporal variance, its degrees of freedom, error of the mean."""
    stack = np.stack([to_one_site(f, rig.camera) for f in read_stack(rig, files, load=load)])
    stack = stack[..., None] if stack.ndim == 3 else stack
    if stack.shape[3] != channels:
        raise InputError(
            f"{rig.path(files[0])}: has {stack.shape[3]} channels, the object's images have "
            f"{channels}; give flats and darks of the same kind."
        )
    if (stack >= one_site(rig.camera).clip_level).any():
        raise InputError(
            f"{rig.path(files[0])}: has saturated pixels; leave this level out of the rig."
        )
    frames, height, width = stack.shape[:3]
    pixels = height * width
    # frames may drift together, which is not the noise of pixels
    noise = stack - stack.mean(axis=(1, 2), keepdims=True)
    variance = noise.var(axis=0, ddof=1).mean(axis=(0, 1)) * pixels / (pixels - 1)
    of_pixels = stack.mean(axis=0).reshape(pixels, channels)
    error = np.sqrt(of_pixels.var(axis=0, ddof=1) / pixels)
    freedom = np.full(channels, (frames - 1.0) * (pixels - 1))
    return np.stack([of_pixels.mean(axis=0), variance, freedom, error], axis=1)
