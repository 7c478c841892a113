"""Reading of exposure stacks: images of one still scene at several exposure times, as planes of
integer codes.

A plane is one colour channel or one site of a Bayer mosaic of one group of images. Codes are kept
as the integers of the files (uint16), so that sixteen 8-bit colour images of 768 x 512 pixels take
38 MB.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from jaxtyping import Bool, Float, UInt16

from jaxvision import ArrayLike
from jaxvision.errors import InputError
from jaxvision.files.images import read_image

from ..codes import Converter, converter_of
from ..frame_checks.exposures import blank_images, odd_exposures, refuse_toned
from ..frame_checks.frame import frame_sample, refuse_half
from ..frame_checks.heads import Stated, odd_heads
from ..inference.diagnostics import listed
from ..inference.formatting import format_percent
from ..observation import (
    Load,
    cropped_to_region,
    number_list,
    read_frame,
    read_stack,
    require_as_many,
    require_several_images,
    rig_in_memory,
    split_channels,
    unequal_sites,
)
from ..rig import Camera, Exposure, Rig, SiteCamera, as_rig, require
from .moved import moved_back, moved_exposures

# Increase of the exposure during which a pixel without light stays constant
LEAST_EXPOSURE_RATIO = 8.0
LEAST_RATIO = 1.9
MAJORITY_SHARE = 0.5  # share of darker pixels from which a longer exposure counts as darker
FEWEST_ALIKE = 0.005  # least share of constant pixels that determines a level
DARKER_SHARE = 0.01  # share of pixels below a level from which it is not black
DIM_SHARE = 0.05  # share of the range above black from which a pixel changes with the exposure
FIXED_SHARE = 0.001  # share of pixels with one number in all images: reported
LOWEST_STUCK = 0.01  # quantile of the constant codes

Codes = UInt16[np.ndarray, "exposures h w"]


@dataclass(frozen=True)
class Plane:
    """The codes of one channel of one group of images.

    Attributes:
        group: name of the group of images in the rig.
        channel: colour or mosaic site.
        files: names of the image files, in the order of `exposures`.
        exposures: (exposures,) s, ascending.
        codes: (exposures, h, w) DN.
        mask: (h, w), true where the scene may be used.
        black: DN without light.
        clip: DN from which a pixel is saturated.
        black_sd: standard deviation of the black level, DN; 0 where exact.
        exposure_sd: rms of the stated relative errors of the exposures; 0 where none is stated.
        start: row and column of the plane's first pixel among all pixels of its colour. With one
            amplifier tap, (0, 0).
        step: distance of the plane's neighbouring pixels among all pixels of its colour, in rows
            and columns; more than 1 if several amplifier taps alternate.
        black_measured: true if the black level is stated or measured on darks, false if it is
            estimated from the images.
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
    start: tuple[int, int] = (0, 0)
    step: tuple[int, int] = (1, 1)
    black_measured: bool = False

    @property
    def label(self) -> str:
        return f"{self.group} {self.channel}".strip()

    @property
    def name(self) -> str:
        """The label of the plane, or `grey` if it has none."""
        return self.label or "grey"


@dataclass(frozen=True)
class ExposureStack:
    """An exposure stack: the planes of all channels and groups of images of a rig.

    Attributes:
        planes: all planes, in the order of the groups in the rig.
        bits: of the camera.
        step: DN between neighbouring codes; 16 for 12 bits that are stored in the upper bits of 16.
        origin: the DN of every code is `origin` plus a multiple of `step`; 0 <= `origin` < `step`.
        remarks: findings on the images, as sentences.
    """

    planes: tuple[Plane, ...]
    bits: int
    step: int = 1
    origin: int = 0
    remarks: tuple[str, ...] = ()

    @property
    def full_scale(self) -> int:
        return 2**self.bits - 1


def read_exposure_stack(
    rig: Rig | str | os.PathLike[str],
    *,
    mask: Bool[np.ndarray, "h w"] | None = None,
    load: Load = read_image,
) -> ExposureStack:
    """Read a rig's `[[exposure]]` images and split each group into planes.

    The black level of a channel or site is the level that the rig states. If it states none, the
    black level is the mean of the `[[dark]]` frames or, without darks, the code of dark pixels that
    do not change with the exposure time. The clip level is the saturation that the rig states or,
    if it states none, the code of bright pixels that do not change with the exposure time.

    Args:
        rig: with `[[exposure]]`, or its folder or file.
        mask: (h, w) of full images, true where the scene may be used (a mosaic site keeps its own
            pixels); None for everywhere.
        load: function that reads an image from its path.

    Returns:
        The stack.

    Raises:
        InputError: for a group without two different exposure times, or whose images get darker
            with longer exposure; for images of different size; for values that are not integers; if
            metadata show that half of the images were taken with other settings; if the camera
            moved in half of the images; and for a mask of another size or an empty mask.
    """
    rig = as_rig(rig)
    require(rig, "a response calibration")
    rig, remarks = _drop_odd_heads(rig)
    frames = {entry.file: _codes(rig, entry.file, load) for entry in rig.exposure}
    converter = converter_of(frames.values())
    ordered = sorted(rig.exposure, key=lambda entry: (entry.group, entry.exposure))
    measured_black = _black_levels(rig, load)
    planes: list[Plane] = []
    for group, entries in groupby(ordered, key=lambda entry: entry.group):
        kept = _drop_odd_images(rig, tuple(entries), frames, remarks)
        planes += _planes(rig, group, kept, mask, measured_black, frames, converter)
    fixed = max(
        float(np.mean(_find_overlays(p.codes, p.exposures, p.black, p.clip))) for p in planes
    )
    if fixed > FIXED_SHARE:
        remarks.append(
            f"{format_percent(fixed)} of the pixels have the same number above black in all "
            "images, as bars, an overlay or dead pixels have, and were left out."
        )
    for plane in planes if rig.camera.sites == ("grey",) else ():
        lit = np.where(plane.mask & (plane.codes < plane.clip), plane.codes - plane.black, np.nan)
        clause, key = unequal_sites(lit.sum(axis=0))
        if clause and plane.channel == "grey":
            where = f"{plane.group}: " * bool(plane.group)
            remarks.append(f"{where}{clause}, but have one curve here; give {key}.")
    step, origin = _grid_of(converter)
    remarks += _converter_in_words(converter, step)
    return ExposureStack(tuple(planes), rig.camera.bits, step, origin, tuple(remarks))


def from_stack(
    images: Sequence[ArrayLike],
    exposures: Sequence[float],
    *,
    camera: Camera,
    mask: Bool[np.ndarray, "h w"] | None = None,
    exposure_sd: float | None = None,
) -> ExposureStack:
    """Make an exposure stack from images of one still scene in memory, as the input of
    `response.calibrate`.

    Args:
        images: (h, w) or (h, w, 3) integer DN each, in any order.
        exposures: of the images, s.
        camera: the camera's bits, and other known properties.
        mask: (h, w), true where the scene may be used; None for all pixels.
        exposure_sd: relative standard deviation of each exposure's error; None where it is unknown
            and estimated from the images.

    Returns:
        The stack, after the same checks as one from a folder.

    Raises:
        InputError: for lists of unequal length, and for images that cannot be used.

    Example:
        >>> from fitting.response import Camera, from_stack
        >>> light = np.random.default_rng(0).uniform(100, 500, (20, 20))  # DN a second
        >>> times = [0.5, 1.0, 2.0]
        >>> images = [(t * light).astype(int) for t in times]
        >>> stack = from_stack(images, times, camera=Camera(bits=12))
        >>> print([(plane.channel, plane.codes.shape) for plane in stack.planes])
        [('grey', (3, 20, 20))]
    """
    require_several_images("images", images)
    exposures = number_list("exposures", exposures)
    require_as_many("exposures", exposures, "images", images)
    entries = [
        {"file": f"images[{i}]", "exposure": exposure, "exposure_sd": exposure_sd}
        for i, exposure in enumerate(exposures)
    ]
    named = {f"images[{i}]": image for i, image in enumerate(images)}
    called = {"exposure.exposure": "exposures"}
    rig, load = rig_in_memory(named, called=called, camera=camera, exposure=entries)
    return read_exposure_stack(rig, mask=mask, load=load)


def _drop_odd_heads(rig: Rig) -> tuple[Rig, list[str]]:
    """Return the rig without exposures that contradict their metadata, and findings on these."""
    groups = list(dict.fromkeys(entry.group for entry in rig.exposure))
    stated = [
        Stated(entry.file, rig.path(entry.file), entry.exposure, groups.index(entry.group))
        for entry in rig.exposure
    ]
    odd, remarks = odd_heads(rig.folder, stated)
    refuse_half(rig.folder, odd, len(stated))
    gone = {name for one in odd for name in one.names}
    kept = tuple(entry for entry in rig.exposure if entry.file not in gone)
    return rig.model_copy(update={"exposure": kept}), [*remarks, *(one.sentence for one in odd)]


def _drop_odd_images(
    rig: Rig, entries: tuple[Exposure, ...], images: dict[str, np.ndarray], remarks: list[str]
) -> tuple[Exposure, ...]:
    """Return exposures of one still scene in order; add findings on the others."""
    top, seen = rig.camera.at(rig.camera.sites[0]).clip_level, []
    for entry in entries:
        frame = images[entry.file]
        seen.append(
            frame_sample(entry.file, frame.mean(axis=2) if frame.ndim == 3 else frame, top=top)
        )
    times = [entry.exposure for entry in entries]
    refuse_toned(rig.folder, seen, times, full_scale=rig.camera.full_scale)
    blank = blank_images(seen)
    gone = {name for one in blank for name in one.names}
    clear = [entry.file for entry in entries if entry.file not in gone]
    pictures, full_scale = [images[file] for file in clear], rig.camera.full_scale
    moved, near = moved_exposures(clear, pictures, full_scale=full_scale, cell=rig.camera.cell)
    for name, by in near.items():
        images[name] = moved_back(images[name], by, full_scale)
    gone = {name for one in moved for name in one.names}
    still = [i for i, one in enumerate(seen) if one.name not in gone]
    kept = [times[i] for i in still]
    odd = odd_exposures(rig.folder, [seen[i] for i in still], kept, full_scale=full_scale)
    odd = [*moved, *odd]
    refuse_half(rig.folder, odd, len(entries))
    # Blank images are not fitted, but show the black level and the clip level.
    remarks += [one.sentence for one in (*blank, *odd)]
    if near:
        remarks.append(
            f"The scene of {listed(list(near))} is shifted by a pixel from its position in most "
            "exposures. The images were moved back by whole pixels; a tripod gives a better curve."
        )
    gone = {name for one in odd for name in one.names}
    return tuple(entry for entry in entries if entry.file not in gone)


def _grid_of(converter: Converter) -> tuple[int, int]:
    """Return step and origin of the grid of all codes; 1 and 0 if there is no grid."""
    step = round(converter.step)
    even = converter.even and step > 1 and step == converter.step
    return (step, round(converter.origin)) if even else (1, 0)


def _converter_in_words(converter: Converter, step: int) -> list[str]:
    if step > 1:
        return [
            f"All values are {step} DN apart or a multiple of that, as from an ADC with fewer bits "
            "than the file; this is taken as the step between codes."
        ]
    if converter.step > 1:
        return [
            f"The values lie on a grid of {converter.step:.4g} DN, rounded again, as if a reader "
            "scaled them; save the original codes of the camera."
        ]
    if converter.missing:
        return [
            f"{format_percent(converter.missing)} of the codes do not occur, as if the contrast of "
            "the image was stretched; give the original codes of the camera."
        ]
    return []


def _planes(
    rig: Rig,
    group: str,
    entries: tuple[Exposure, ...],
    mask: np.ndarray | None,
    measured_black: dict[str, float],
    images: dict[str, np.ndarray],
    converter: Converter,
) -> list[Plane]:
    times = np.array([entry.exposure for entry in entries])
    where = f"{rig.folder}: the exposures" + (f" of group {group!r}" if group else "")
    if len(entries) < 2:
        raise InputError(f"{where} are a single image; a response needs at least two.")
    if times[-1] < times[0] * (1 + 1e-6):
        raise InputError(
            f"{where} all last {times[0]:g} s; give at least two different exposure times."
        )
    frames = [images[entry.file] for entry in entries]
    for entry, frame in zip(entries, frames, strict=True):
        if frame.shape != frames[0].shape:
            raise InputError(
                f"{rig.path(entry.file)}: is {frame.shape}, but {entries[0].file} is "
                f"{frames[0].shape}; all images of one stack need the same size."
            )
    darker = float(np.mean(frames[-1] < frames[0]))
    if darker > MAJORITY_SHARE and np.mean(frames[-1] > frames[0]) < 1 - MAJORITY_SHARE:
        raise InputError(
            f"{where}: {entries[-1].file}, the longest, is darker than {entries[0].file}, the "
            f"shortest, at {format_percent(darker)} of the pixels; check the order of the times, "
            "and that the images are not negatives."
        )
    scene = _scene_mask(rig, mask, frames[0].shape[:2], where)
    files = tuple(entry.file for entry in entries)
    channels = [split_channels(frame, rig.camera) for frame in frames]
    grid = np.broadcast_to(
        scene.reshape(*scene.shape, *[1] * (frames[0].ndim - 2)), frames[0].shape
    )
    masks = split_channels(grid, rig.camera)
    planes = []
    step, _ = _grid_of(converter)
    coarser = 2 if rig.camera.pattern else 1  # of the rows and columns, per colour
    apart = (rig.camera.cell[0] // coarser, rig.camera.cell[1] // coarser)
    starts = [
        (rows.start // coarser, columns.start // coarser)
        for rows, columns in rig.camera.places(*frames[0].shape[:2])
    ]
    for i, name in enumerate(channels[0]):
        codes = np.stack([frame[name] for frame in channels])
        camera = rig.camera.at(name)
        black = camera.black_level if camera.black_level is not None else measured_black.get(name)
        if black is None and measured_black:
            raise InputError(
                f"{rig.folder}: the darks have {', '.join(measured_black)}, the exposures "
                f"{', '.join(channels[0])}; give darks of the same kind, or camera.black_level."
            )
        measured = black is not None
        black = floor_level(codes, times, camera, step=step) if black is None else black
        clip = camera.saturation or ceiling_level(codes, times, camera, step=step)
        if camera.saturation is None and converter.clips_at is not None:
            clip = min(clip, converter.clips_at)
        planes.append(
            Plane(
                group,
                name,
                files,
                times,
                codes,
                masks[name] & ~_find_overlays(codes, times, black, clip),
                black,
                clip,
                black_sd=camera.black_sd or 0.0,
                exposure_sd=float(np.sqrt(np.mean([(e.exposure_sd or 0.0) ** 2 for e in entries]))),
                start=starts[i * len(starts) // len(channels[0])],
                step=apart,
                black_measured=measured,
            )
        )
    return planes


def floor_level(
    codes: Codes, exposures: Float[np.ndarray, " exposures"], camera: SiteCamera, *, step: int = 1
) -> float:
    """Estimate black from dark pixels that stay constant while exposure grows eightfold; else 0."""
    longer = np.flatnonzero(exposures >= LEAST_EXPOSURE_RATIO * exposures[0])
    if not len(longer):
        return 0.0
    before, after = codes[0].astype(int), codes[longer[0]].astype(int)
    dark = (np.abs(after - before) <= step) & (after < camera.clip_level / 4)
    if dark.sum() <= FEWEST_ALIKE * dark.size:
        return 0.0
    level = float(np.median(before[dark]))
    # The bars of a film and overlays are unchanged, too. They are not black where the scene is
    # darker.
    fixed = unchanged(codes, exposures)
    scene = before[~fixed]
    if (
        fixed[dark].mean() > MAJORITY_SHARE
        and scene.size
        and np.mean(scene < level - step) > DARKER_SHARE
    ):
        return 0.0
    # By chance, noise keeps a few pixels of any code constant. Other pixels of that code rise with
    # the light, and these rise too as the exposure grows further.
    at_level = np.abs(before - level) <= step
    risen = [np.mean((after - before > step)[at_level])]
    if longer[0] < len(codes) - 1:
        risen.append(np.mean((codes[-1].astype(int) - before > step)[dark]))
    return level if min(risen) < MAJORITY_SHARE else 0.0


def unchanged(codes: Codes, exposures: Float[np.ndarray, " exposures"]) -> Bool[np.ndarray, "h w"]:
    """Return a mask of pixels of one code in images that span a factor of 8 or more."""
    if exposures[-1] < LEAST_EXPOSURE_RATIO * exposures[0]:
        return np.zeros(codes.shape[1:], bool)
    return (codes == codes[0]).all(axis=0)


def _find_overlays(
    codes: Codes, exposures: Float[np.ndarray, " exposures"], black: float, clip: float
) -> Bool[np.ndarray, "h w"]:
    """Return a mask of lit pixels that neither change nor clip, such as overlays."""
    lit = codes[0] > black + DIM_SHARE * (clip - black)
    return unchanged(codes, exposures) & lit & (codes[0] < clip)


def ceiling_level(
    codes: Codes, exposures: Float[np.ndarray, " exposures"], camera: SiteCamera, *, step: int = 1
) -> float:
    """Estimate the clip level from bright pixels that stay constant as the exposure grows."""
    shorter = np.flatnonzero(exposures * LEAST_RATIO <= exposures[-1])
    if not len(shorter):
        return float(camera.full_scale)
    before, after = codes[shorter[-1]].astype(int), codes[-1].astype(int)
    stuck = (np.abs(after - before) <= step) & (before > camera.full_scale / 2)
    if stuck.sum() <= FEWEST_ALIKE * stuck.size:
        return float(camera.full_scale)
    level = float(np.quantile(np.minimum(before, after)[stuck], LOWEST_STUCK))
    risen = (after - before > step)[before >= level]
    return level if np.mean(risen) < MAJORITY_SHARE else float(camera.full_scale)


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
    if mask.shape != shape:  # a mask of the region's size is used unchanged
        mask = cropped_to_region(mask, rig.camera, rig.path("the mask"))
    if mask.shape != shape:
        raise InputError(f"{where} are {shape} pixels, the mask is {mask.shape}; resize it.")
    if not mask.any():
        raise InputError(f"{where}: the mask leaves no pixel; make it non-zero on the scene.")
    return mask


def _black_levels(rig: Rig, load: Load) -> dict[str, float]:
    """Return the mean dark by channel, DN; {} if the level is stated or without darks."""
    if rig.camera.black_level is not None or not rig.dark:
        return {}
    means = [read_stack(rig, entry.files, load=load).mean(axis=0) for entry in rig.dark]
    planes = [split_channels(mean, rig.camera) for mean in means]
    return {name: float(np.mean([each[name].mean() for each in planes])) for name in planes[0]}
