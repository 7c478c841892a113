"""Files as cameras for measurement write them: raw files (DNG, CR2, NEF, ARW, ...) by rawpy, and
FITS by astropy, each an extra of the package that is loaded on first use."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from .errors import InputError, install

RAW_FORMATS = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".orf", ".raf", ".rw2", ".pef", ".srw")
FITS_FORMATS = (".fits", ".fit", ".fts")


def read_raw(file: Path) -> np.ndarray:
    """The numbers of a raw file as the camera stored them, before black level and demosaicing.

    Args:
        file: of a sensor with one colour a pixel, or none.

    Returns:
        (h, w) uint16 DN, the margins that the camera masks left out.

    Raises:
        InputError: for a file that rawpy cannot read, for several colours a pixel, and without the
            `raw` extra.
    """
    with opened_raw(file) as raw:
        if raw.raw_type.name != "Flat":
            raise InputError(
                f"{file}: holds several colours a pixel, no mosaic; develop it and save a TIFF."
            )
        return np.array(raw.raw_image_visible)


@contextmanager
def opened_raw(file: Path) -> Iterator[Any]:
    """A raw file as rawpy gives it: a context.

    Args:
        file: the file.

    Yields:
        `rawpy.RawPy`.

    Raises:
        InputError: for a file that it cannot read, also within the context, where it reads the
            pixels, and without the `raw` extra.
    """
    rawpy = extra("rawpy", "raw", file)
    try:
        with rawpy.imread(str(file)) as raw:
            yield raw
    except (rawpy.LibRawError, OSError) as error:
        told = str(error.args[0].decode() if isinstance(error.args[0], bytes) else error)
        raise InputError(f"{file}: not readable as a raw file ({told}); copy it again.") from error


def read_fits(file: Path) -> np.ndarray:
    """The first image of a FITS file, its rows in the order of the file.

    Args:
        file: the file. BZERO and BSCALE are applied.

    Returns:
        (h, w), or (h, w, channels) of a file with a third axis, in the type of the file.

    Raises:
        InputError: for a file that astropy cannot read or without an image, and without the `fits`
            extra.
    """
    with opened_fits(file) as units:
        image = _image_unit(file, units)
        pixels = np.asarray(image.data)
    if pixels.ndim == 3:
        pixels = np.moveaxis(pixels, 0, -1)
    if pixels.ndim not in (2, 3):
        raise InputError(f"{file}: its image has {pixels.ndim} axes; give two, or three.")
    return pixels.astype(pixels.dtype.newbyteorder("="))


@contextmanager
def opened_fits(file: Path) -> Iterator[Any]:
    """A FITS file as astropy gives it: a context.

    Args:
        file: the file.

    Yields:
        `astropy.io.fits.HDUList`.

    Raises:
        InputError: for a file that it cannot read, also within the context, where it reads heads
            and pixels, and without the `fits` extra.
    """
    fits = extra("astropy.io.fits", "fits", file)
    try:
        with fits.open(file, memmap=False) as units:
            yield units
    except InputError:
        raise
    except (OSError, ValueError, KeyError, TypeError, fits.VerifyError) as error:
        told = " ".join(str(error).split())
        raise InputError(f"{file}: not readable as FITS ({told}); copy it again.") from error


def fits_header(file: Path) -> dict[str, Any]:
    """The keywords of the first image of a FITS file.

    Args:
        file: the file.

    Returns:
        Values by keyword.

    Raises:
        InputError: as `read_fits` does.
    """
    with opened_fits(file) as units:
        return dict(_image_unit(file, units).header)


def _image_unit(file: Path, units: Any) -> Any:
    for unit in units:
        axes = unit.header.get("NAXIS", 0)
        if isinstance(axes, int) and axes >= 2 and getattr(unit, "is_image", False):
            return unit
    raise InputError(f"{file}: holds no image; name a FITS file with one.")


def extra(module: str, name: str, file: Path) -> Any:
    """A library that an extra of the package brings.

    Args:
        module: to import.
        name: of the extra.
        file: that needs it, for the message.

    Returns:
        The module.

    Raises:
        InputError: if it is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        library = module.partition(".")[0]
        raise InputError(
            f"{file}: {library} reads such files; install it by `{install(name)}`."
        ) from error
