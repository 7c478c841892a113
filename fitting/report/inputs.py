"""The list of a rig's images in a report, with names, settings, sizes and thumbnails."""

import base64
import io
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from jaxvision.errors import InputError
from jaxvision.files.images import read_image

from ..inference.formatting import format_cell, format_unit
from ..rig import NEEDED, Dark, Exposure, Flat, Geometry, Light, Purpose, Rig
from .section import Input, Section
from .unused_keys import unused_keys

MOST_PICTURES = 16  # most thumbnails in one section, spread evenly over its images
SIDE = 96  # pixels of a thumbnail's longer side, at most
UNITS = {"exposure": "s", "irradiance": "W m^-2"}  # others name it, or have none
DISPLAY_GAMMA = 2.2


def add_inputs(section: Section, rig: Rig, purpose: Purpose, *, fit_gamma: bool = False) -> Section:
    """Return the section with the rig's images, and findings on keys without effect."""
    idle = unused_keys(rig, section.kind, fit_gamma=fit_gamma)
    inputs = inputs_of(rig, purpose)
    region = rig.camera.region
    first = rig.path(inputs[0].files[0])
    if region and region[:2] == (0, 0) and read_image(first).shape[:2] == region[2:]:
        idle = (*idle, "Not used of the rig: camera.region; it is the whole image.")
    return replace(section, findings=(*section.findings, *idle), inputs=inputs)


def inputs_of(rig: Rig, purpose: Purpose) -> tuple[Input, ...]:
    """Return the images of a rig that a calibration of this kind uses."""
    entries = [
        entry
        for section in NEEDED[purpose]
        for own in (getattr(rig, section),)
        for entry in (own if isinstance(own, tuple) else (own,))
        if not isinstance(entry, Geometry)
    ]
    count = min(MOST_PICTURES, len(entries))
    shown = {round(place) for place in np.linspace(0, len(entries) - 1, count)}
    return tuple(_input(rig, entry, i in shown) for i, entry in enumerate(entries))


def _input(rig: Rig, entry: Flat | Dark | Exposure | Light, shown: bool) -> Input:
    files = entry.files if isinstance(entry, Flat | Dark) else (entry.file,)
    given = entry.model_dump(exclude={"file", "files"}, exclude_defaults=True)
    settings = ", ".join(_setting(name, value) for name, value in given.items())
    size = None
    with suppress(OSError):
        size = sum(rig.path(name).stat().st_size for name in files)
    return Input(
        files=files,
        kind=type(entry).__name__.lower(),
        settings=settings,
        bytes=size,
        picture=(lambda: small_picture(rig, files[0])) if shown else None,
    )


def _setting(name: str, value: Any) -> str:
    if value is True:
        return name.replace("_", " ")
    numbers = value if isinstance(value, tuple) else (value,)
    text = ", ".join(map(format_cell, numbers))
    text = f"({text})" if len(numbers) > 1 else text
    return f"{name.replace('_', ' ')} {text} {format_unit(UNITS.get(name, '1'))}".rstrip()


def small_picture(rig: Rig, name: str) -> str | None:
    """Make a thumbnail as a base64-encoded PNG; None if the image cannot be read."""
    import matplotlib.image

    try:
        image = np.atleast_3d(np.asarray(read_image(rig.path(name)), float))
    except InputError:
        return None
    step = -(-max(image.shape[:2]) // SIDE)
    means = _block_means(_block_means(image, step, axis=0), step, axis=1)
    camera = rig.camera
    black = float(np.min(camera.black_level or 0.0))  # a thumbnail does not distinguish sites
    clip = float(np.max(camera.saturation or camera.full_scale))
    shown = np.nan_to_num(np.clip((means - black) / (clip - black), 0, 1))
    if camera.bits > 8 and camera.gamma in (None, 1.0):  # linear
        shown = shown ** (1 / DISPLAY_GAMMA)
    rgb = shown if shown.shape[2] == 3 else np.repeat(shown[..., :1], 3, axis=2)
    buffer = io.BytesIO()
    matplotlib.image.imsave(buffer, rgb, format="png")
    return base64.b64encode(buffer.getvalue()).decode()


def _block_means(image: np.ndarray, step: int, *, axis: int) -> np.ndarray:
    starts = np.arange(0, image.shape[axis], step)
    sizes = np.diff([*starts, image.shape[axis]])
    sums = np.add.reduceat(image, starts, axis=axis)
    return sums / np.expand_dims(sizes, [i for i in range(image.ndim) if i != axis])
