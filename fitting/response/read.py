"""Exposure stacks: one still scene at several exposure times, as planes of integer codes.

A plane is one colour channel or one site of a Bayer mosaic of one group of images. Codes stay the
integers of the files (uint16), so sixteen 8-bit colour images of 768 x 512 take 38 MB.
"""

import os
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from jaxtyping import Bool, Float, UInt16

from jaxvision.errors import InputError
from jaxvision.io import read_image

from ..copies import Copies
from ..inference.formatting import format_percent
from ..observation import Load, in_region, read_frame, read_stack, split_channels
from ..rig import Exposure, Rig, SiteCamera, as_rig, require

LONGER = 8.0  # a pixel that stays alike while its exposure grows so much sees no light
BRIGHTER = 1.9
MOSTLY = 0.5  # share of pixels beyond which a longer exposure is called darker than a shorter
FEWEST_ALIKE = 0.005  # share of the pixels that such a level rests on
LOWEST_STUCK = 0.01  # quantile of the stuck codes

Codes = UInt16[np.ndarray, "exposures h w"]


@dataclass(frozen=True)
class Plane:
    """One channel of one group of images.

    Attributes:
        group: of the rig.
        channel: colour or mosaic site.
        files: names, in the order of `exposures`.
        exposures: (exposures,) s, ascending.
        codes: (exposures, h, w) DN.
        mask: (h, w), true where the scene may be used.
        black: DN without light.
        clip: DN from which a pixel is saturated.
        black_sd: DN, with which black is known; 0 for exactly.
        exposure_sd: rms of what is known of the exposures' relative errors; 0 where nothing is.
    """

    group: str
    channel: str
    files: tuple[str, ...]
    exposures: Float[np.ndarray, " exposures"]
    codes: Codes
    mask: Bool[np.ndarray, "h w"]
    black: float
    clip: float
    black_sd: float = 0.0
    exposure_sd: float = 0.0

    @property
    def label(self) -> str:
        return f"{self.group} {self.channel}".strip()


@dataclass(frozen=True)
class ExposureStack:
    """All planes of a rig.

    Attributes:
        planes: group by group.
        bits: of the camera.
    """

    planes: tuple[Plane, ...]
    bits: int

    @property
    def full_scale(self) -> int:
        return 2**self.bits - 1


def read_exposure_stack(
    rig: Rig | str | os.PathLike[str],
    *,
    mask: Bool[np.ndarray, "h w"] | None = None,
    load: Load = read_image,
) -> ExposureStack:
    """A rig's `[[exposure]]` images, group by group, split into planes.

    The black level of a channel or site is the camera's, else its mean in the `[[dark]]` frames,
    else the code of its dark pixels that stay alike however long the exposure; its clip level is
    the camera's saturation, else read off the bright pixels that do.

    Args:
        rig: with `[[exposure]]`, or its folder or file.
        mask: (h, w) of full images, true where the scene may be used (a mosaic site keeps its own
            pixels); None for everywhere.
        load: how an image is had by its path.

    Returns:
        The stack.

    Raises:
        InputError: for a group without two different exposure times, or whose images get darker as
            they last longer, for images of different size, for values that are not integers, and
            for a mask of another size or with nothing in it.
    """
    rig = as_rig(rig)
    require(rig, "a response calibration")
    ordered = sorted(rig.exposure, key=lambda entry: (entry.group, entry.exposure))
    measured_black = _black_levels(rig, load)
    planes: list[Plane] = []
    for group, entries in groupby(ordered, key=lambda entry: entry.group):
        planes += _planes(rig, group, tuple(entries), mask, measured_black, load)
    return ExposureStack(tuple(planes), rig.camera.bits)


def _planes(
    rig: Rig,
    group: str,
    entries: tuple[Exposure, ...],
    mask: np.ndarray | None,
    measured_black: dict[str, float],
    load: Load,
) -> list[Plane]:
    times = np.array([entry.exposure for entry in entries])
    where = f"{rig.folder}: the exposures" + (f" of group {group!r}" if group else "")
    if len(entries) < 2:
        raise InputError(f"{where} are a single image; a response needs at least two.")
    if times[-1] < times[0] * (1 + 1e-6):
        raise InputError(
            f"{where} all last {times[0]:g} s; give at least two different exposure times."
        )
    frames = [_codes(rig, entry.file, load) for entry in entries]
    copies = Copies()
    for entry, frame in zip(entries, frames, strict=True):
        copies.add(entry.file, frame)
        if frame.shape != frames[0].shape:
            raise InputError(
                f"{rig.path(entry.file)}: is {frame.shape}, but {entries[0].file} is "
                f"{frames[0].shape}; all images of one stack need the same size."
            )
    copies.refuse(rig.folder)
    darker = float(np.mean(frames[-1] < frames[0]))
    if darker > MOSTLY and np.mean(frames[-1] > frames[0]) < 1 - MOSTLY:
        raise InputError(
            f"{where}: {entries[-1].file}, the longest, is darker than {entries[0].file}, the "
            f"shortest, at {format_percent(darker)} of the pixels; check the order of the times, "
            "and that the images are no negatives."
        )
    scene = _scene_mask(rig, mask, frames[0].shape[:2], where)
    files = tuple(entry.file for entry in entries)
    channels = [split_channels(frame, rig.camera) for frame in frames]
    grid = np.broadcast_to(
        scene.reshape(*scene.shape, *[1] * (frames[0].ndim - 2)), frames[0].shape
    )
    masks = split_channels(grid, rig.camera)
    planes = []
    for name in channels[0]:
        codes = np.stack([frame[name] for frame in channels])
        camera = rig.camera.at(name)
        black = camera.black_level if camera.black_level is not None else measured_black.get(name)
        if black is None and measured_black:
            raise InputError(
                f"{rig.folder}: the darks have {', '.join(measured_black)}, the exposures "
                f"{', '.join(channels[0])}; give darks of the same kind, or camera.black_level."
            )
        black = floor_level(codes, times, camera) if black is None else black
        clip = camera.saturation or ceiling_level(codes, times, camera)
        planes.append(
            Plane(
                group,
                name,
                files,
                times,
                codes,
                masks[name],
                black,
                clip,
                black_sd=camera.black_sd or 0.0,
                exposure_sd=float(np.sqrt(np.mean([(e.exposure_sd or 0.0) ** 2 for e in entries]))),
            )
        )
    return planes


def floor_level(
    codes: Codes, exposures: Float[np.ndarray, " exposures"], camera: SiteCamera
) -> float:
    """Black level read off the pixels whose code stays within one step while the exposure grows at
    least eightfold.

    Args:
        codes: (exposures, h, w) DN.
        exposures: (exposures,) s, ascending.
        camera: for its clip level.

    Returns:
        DN; 0 where there are too few such pixels.
    """
    longer = np.flatnonzero(exposures >= LONGER * exposures[0])
    if not len(longer):
        return 0.0
    before, after = codes[0].astype(int), codes[longer[0]].astype(int)
    dark = (np.abs(after - before) <= 1) & (after < camera.clip_level / 4)
    return float(np.median(before[dark])) if dark.sum() > FEWEST_ALIKE * dark.size else 0.0


def ceiling_level(
    codes: Codes, exposures: Float[np.ndarray, " exposures"], camera: SiteCamera
) -> float:
    """Clip level read off the pixels beyond half scale whose code stays within one step while the
    exposure grows by 1.9 at least.

    Sensors saturate at codes that vary from pixel to pixel, so it is nearly the lowest of them.

    Args:
        codes: (exposures, h, w) DN.
        exposures: (exposures,) s, ascending.
        camera: for its full scale.

    Returns:
        DN; full scale where there are too few such pixels.
    """
    shorter = np.flatnonzero(exposures * BRIGHTER <= exposures[-1])
    if not len(shorter):
        return float(camera.full_scale)
    before, after = codes[shorter[-1]].astype(int), codes[-1].astype(int)
    stuck = (np.abs(after - before) <= 1) & (before > camera.full_scale / 2)
    if stuck.sum() <= FEWEST_ALIKE * stuck.size:
        return float(camera.full_scale)
    return float(np.quantile(np.minimum(before, after)[stuck], LOWEST_STUCK))


def _codes(rig: Rig, name: str, load: Load) -> UInt16[np.ndarray, "h w *channels"]:
    frame = read_frame(rig.path(name), rig.camera, load=load)
    codes = frame.astype(np.uint16)
    if not np.array_equal(codes, frame):
        raise InputError(
            f"{rig.path(name)}: holds fractions, not digital numbers; give the integer codes as "
            "the camera wrote them."
        )
    return codes


def _scene_mask(
    rig: Rig, mask: np.ndarray | None, shape: tuple[int, ...], where: str
) -> np.ndarray:
    if mask is None:
        return np.ones(shape, bool)
    if mask.shape != shape:  # as it is where it has the size of the region already
        mask = in_region(mask, rig.camera, rig.path("the mask"))
    if mask.shape != shape:
        raise InputError(f"{where} are {shape} pixels, the mask is {mask.shape}; resize it.")
    if not mask.any():
        raise InputError(f"{where}: the mask leaves no pixel; make it non-zero on the scene.")
    return mask


def _black_levels(rig: Rig, load: Load) -> dict[str, float]:
    """Mean of the dark frames in each channel, DN; none where the rig states the black level, or
    has no darks."""
    if rig.camera.black_level is not None or not rig.dark:
        return {}
    means = [read_stack(rig, entry.files, load=load).mean(axis=0) for entry in rig.dark]
    planes = [split_channels(mean, rig.camera) for mean in means]
    return {name: float(np.mean([each[name].mean() for each in planes])) for name in planes[0]}
