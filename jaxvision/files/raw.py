"""Read raw files of cameras (DNG, CR2, NEF, ARW and others) by rawpy, and FITS files by astropy.
Both packages are extras that are loaded on first use."""

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from ..core._warnings import warn
from ..errors import InputError, install
from ._tiff_tags import MOSAIC, PHOTOMETRIC, SAMPLE_FORMAT, tiff_pictures

RAW_FORMATS = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".orf", ".raf", ".rw2", ".pef", ".srw")
FITS_FORMATS = (".fits", ".fit", ".fts")


def read_raw(file: Path) -> np.ndarray:
    """Read the numbers of a raw file as LibRaw decodes them, before black-level subtraction and
    demosaicing.

    Some files store numbers through a nonlinear curve: DNG files with a linearisation table, and
    compressed files of Nikon and Sony. LibRaw inverts the curve, so that the result is linear in
    the light.

    Args:
        file: a raw file of a colour mosaic, with one colour per pixel, or of a monochrome sensor.

    Returns:
        (h, w) uint16 DN, without the masked margins.

    Raises:
        InputError: for a file that rawpy cannot read, for several colours per pixel, and without
            the `raw` extra.
    """
    pictures = [
        picture
        for page in tiff_pictures(file)
        for picture in (page, *page.inner)
        if not picture.is_copy
    ]
    if any(picture.first(SAMPLE_FORMAT, 1) == 3 for picture in pictures):
        raise InputError(
            f"{file}: holds floating numbers, which LibRaw scales by the brightest of each file; "
            "save a TIFF of floating numbers, or give the raw files that it was merged from."
        )
    with opened_raw(file) as raw:
        if raw.raw_type.name != "Flat":
            raise InputError(
                f"{file}: holds several colours a pixel, no mosaic; develop it and save a TIFF."
            )
        mosaics = sum(picture.first(PHOTOMETRIC, 0) == MOSAIC for picture in pictures)
        if mosaics > 1:
            warn(
                f"{file}: not used: {mosaics - 1} of its {mosaics} raw pictures; LibRaw chose one."
            )
        if raw.sizes.flip:
            warn(f"{file}: not used: its orientation: rows and columns are as stored.")
        return np.array(raw.raw_image_visible)


@contextmanager
def opened_raw(file: Path) -> Iterator[Any]:
    """Open a raw file as a `rawpy.RawPy`; `InputError` if damaged, or without the extra."""
    rawpy = extra("rawpy", "raw", file)
    try:
        with rawpy.imread(str(file)) as raw:
            yield raw
    except (rawpy.LibRawError, OSError) as error:
        reason = str(error.args[0].decode() if isinstance(error.args[0], bytes) else error)
        raise InputError(
            f"{file}: not readable as a raw file ({reason}); copy it again, or convert it to an "
            "uncompressed DNG."
        ) from error


def read_fits(file: Path, *, part: int | str | None = None) -> np.ndarray:
    """Read an image of a FITS file, with its rows in the order of the file.

    A warning names the HDUs that are not read, and a third axis that is not colour.

    Args:
        file: the file. BZERO and BSCALE are applied; pixels of the value BLANK are NaN.
        part: number or name of the HDU; None for the first HDU with an image.

    Returns:
        (h, w), or (h, w, channels) for a file with a third axis, in the type of the file; floating
        where BLANK or BSCALE require it.

    Raises:
        InputError: for a file that astropy cannot read or without an image, for a part that it does
            not have, and without the `fits` extra.
    """
    extra("astropy.io.fits", "fits", file)  # loading it redirects warnings
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with opened_fits(file) as units:
            image = _image_unit(file, units, part)
            blank, zero = image.header.get("BLANK"), image.header.get("BZERO", 0)
            third = str(image.header.get("CTYPE3", "")).strip()
            pixels = np.asarray(image.data)
            others = [
                f"unit {i}{f' ({unit.name})' if unit.name else ''}"
                for i, unit in enumerate(units)
                if part is None and unit is not image and unit.header.get("NAXIS", 0)
            ]
    notes = dict.fromkeys(" ".join(str(one.message).split()) for one in caught)
    if any("truncated" in note for note in notes):
        raise InputError(f"{file}: the file is cut short; copy it again from its source.")
    for note in notes:
        warn(f"{file}: {note}")
    pixels = pixels.astype(pixels.dtype.newbyteorder("="))
    known = isinstance(blank, int) and isinstance(zero, int | float)
    if known and np.issubdtype(pixels.dtype, np.integer):  # floating numbers are already NaN
        missing = pixels == blank + zero
        if missing.any():
            kind = np.float32 if pixels.dtype.itemsize <= 2 else np.float64
            pixels = np.where(missing, np.nan, pixels).astype(kind)
    while pixels.ndim > 2 and pixels.shape[0] == 1:
        pixels = pixels[0]
    if pixels.ndim not in (2, 3):
        raise InputError(f"{file}: its image has {pixels.ndim} axes; give two, or three.")
    notes = []
    if others:
        verb = "is" if len(others) == 1 else "are"
        notes.append(f"{listed(others)} {verb} not used (the argument part chooses one)")
    if pixels.ndim == 3:
        planes = len(pixels)
        if planes != 3 or third.upper() != "RGB":
            called = f" ({third})" if third else ""
            notes.append(f"the {planes} planes of its third axis{called} are taken as channels")
        pixels = np.moveaxis(pixels, 0, -1)
    if notes:
        warn(f"{file}: {'; '.join(notes)}.")
    return pixels


@contextmanager
def opened_fits(file: Path) -> Iterator[Any]:
    """Open a FITS file as an `HDUList`; `InputError` if damaged, or without the extra."""
    fits = extra("astropy.io.fits", "fits", file)
    try:
        with fits.open(file, memmap=False) as units:
            yield units
    except InputError:
        raise
    except (OSError, ValueError, KeyError, TypeError, fits.VerifyError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{file}: not readable as FITS ({reason}); copy it again.") from error


def fits_header(file: Path) -> dict[str, Any]:
    """Read the headers of the first image and the first HDU of a FITS file, by keyword."""
    extra("astropy.io.fits", "fits", file)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # `read_fits` warns of them
        with opened_fits(file) as units:
            return dict(units[0].header) | dict(_image_unit(file, units, None).header)


def _image_unit(file: Path, units: Any, part: int | str | None) -> Any:
    images = [unit for unit in units if _holds_image(unit)]
    if not images:
        raise InputError(f"{file}: holds no image; name a FITS file with one.")
    if part is None:
        return images[0]
    for i, unit in enumerate(units):
        if part in (i, unit.name) and _holds_image(unit):
            return unit
    known = ", ".join(f"{i} {unit.name}".strip() for i, unit in enumerate(units))
    raise InputError(f"{file}: has no image {part!r}; its units are {known}.")


def _holds_image(unit: Any) -> bool:
    axes = unit.header.get("NAXIS", 0)
    return isinstance(axes, int) and axes >= 2 and bool(getattr(unit, "is_image", False))


def listed(words: Sequence[str], *, most: int = 6) -> str:
    """Join words by commas. If there are too many words, list only the first ones and the number of
    the others."""
    shown = ", ".join(words[:most])
    return shown if len(words) <= most else f"{shown} and {len(words) - most} more"


def extra(module: str, name: str, file: Path) -> Any:
    """Import a module of the extra `name`; `InputError` if it is not installed."""
    try:
        return import_module(module)
    except ImportError as error:
        library = module.partition(".")[0]
        raise InputError(
            f"{file}: {library} reads such files; install it by `{install(name)}`."
        ) from error
