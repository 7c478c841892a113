"""What an image file says of its making: exposure, sensitivity, date, camera. EXIF of JPEG, TIFF
and PNG by OpenImageIO, of raw files by exifread, headers of FITS by astropy."""

import datetime
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .errors import InputError, check_utf8
from .raw_files import FITS_FORMATS, RAW_FORMATS, extra, fits_header, opened_raw

ABSOLUTE_ZERO = -273.15  # degrees Celsius


@dataclass(frozen=True)
class ImageSettings:
    """What a file says; None where it does not.

    Attributes:
        exposure: s.
        iso: sensitivity.
        f_number: of the lens.
        taken: when, in the camera's own time.
        temperature: K, of the sensor.
        camera: maker's name of it.
        black_level: DN.
        saturation: DN.
        pattern: phase of a Bayer mosaic, such as "RGGB".
        kind: IMAGETYP of FITS, such as "Flat Field".
    """

    exposure: float | None = None
    iso: float | None = None
    f_number: float | None = None
    taken: datetime.datetime | None = None
    temperature: float | None = None
    camera: str | None = None
    black_level: float | None = None
    saturation: float | None = None
    pattern: str | None = None
    kind: str | None = None


def read_settings(path: str | os.PathLike[str]) -> ImageSettings:
    """Reads the head of an image file; its pixels stay unread.

    Args:
        path: a file that `jaxvision.io.read_image` reads.

    Returns:
        The settings; empty for a file that says nothing.

    Raises:
        InputError: for a raw or FITS file that cannot be read, or without its extra.
    """
    file = Path(path)
    check_utf8(file)
    suffix = file.suffix.lower()
    if suffix in RAW_FORMATS:
        return _of_raw(file)
    if suffix in FITS_FORMATS:
        return _of_fits(fits_header(file))
    return _of_exif(_attributes(file))


def _attributes(file: Path) -> dict[str, Any]:
    """EXIF by OpenImageIO's names."""
    import OpenImageIO as oiio

    source = oiio.ImageInput.open(str(file))
    if source is None:
        with suppress(UnicodeDecodeError):  # it quotes the file
            oiio.geterror()  # else it is printed when the process ends
        return {}
    found = {}
    try:
        for attribute in source.spec().extra_attribs:
            with suppress(UnicodeDecodeError):  # its name or value, damaged, is no text
                found[attribute.name] = attribute.value
    finally:
        source.close()
    return found


def _of_exif(said: Mapping[str, Any]) -> ImageSettings:
    sensitivity = said.get("Exif:PhotographicSensitivity", said.get("Exif:ISOSpeedRatings"))
    return ImageSettings(
        exposure=_seconds(said.get("ExposureTime"), said.get("Exif:ShutterSpeedValue")),
        iso=_positive(sensitivity),
        f_number=_f_number(said.get("FNumber"), said.get("Exif:ApertureValue")),
        taken=_time(said.get("Exif:DateTimeOriginal") or said.get("DateTime")),
        camera=_name(said.get("Make"), said.get("Model")),
    )


def _of_raw(file: Path) -> ImageSettings:
    tags = _raw_tags(file)

    def said(name: str) -> Any:
        """Of the photograph, which TIFF/EP and DNG may say in the main directory."""
        return tags.get(f"EXIF {name}", tags.get(f"Image {name}"))

    with opened_raw(file) as raw:
        letters = raw.color_desc.decode()
        colours = raw.raw_colors_visible[:2, :2].ravel() if raw.num_colors > 1 else []
        pattern = "".join(letters[i] for i in colours)
        blacks = [float(level) for level in raw.black_level_per_channel]
        saturation = float(raw.white_level)
    return ImageSettings(
        exposure=_seconds(said("ExposureTime"), said("ShutterSpeedValue")),
        iso=_positive(said("ISOSpeedRatings")),
        f_number=_f_number(said("FNumber"), said("ApertureValue")),
        taken=_time(said("DateTimeOriginal") or tags.get("Image DateTime")),
        camera=_name(tags.get("Image Make"), tags.get("Image Model")),
        black_level=float(np.mean(blacks)),
        saturation=saturation,
        pattern=pattern if sorted(pattern) == ["B", "G", "G", "R"] else None,
    )


def _raw_tags(file: Path) -> dict[str, Any]:
    """EXIF by exifread's names, each its first value."""
    exifread = extra("exifread", "raw", file)
    try:
        with file.open("rb") as stream:
            tags = exifread.process_file(stream, details=False)
    except Exception as error:  # of any kind, where the head is damaged
        raise InputError(f"{file}: its EXIF is damaged ({error}); copy it again.") from error
    return {
        name: tag.values if isinstance(tag.values, str) else tag.values[0]
        for name, tag in tags.items()
        if getattr(tag, "values", None)
    }


def _of_fits(header: Mapping[str, Any]) -> ImageSettings:
    celsius = _number(header.get("CCD-TEMP", header.get("SET-TEMP")))
    pattern = str(header.get("BAYERPAT", "")).strip().upper()
    return ImageSettings(
        exposure=_positive(header.get("EXPTIME", header.get("EXPOSURE"))),
        iso=_positive(header.get("ISOSPEED")),
        taken=_time(header.get("DATE-OBS")),
        temperature=None if celsius is None else celsius - ABSOLUTE_ZERO,
        camera=_name(header.get("INSTRUME")),
        black_level=_number(header.get("PEDESTAL")),
        saturation=_positive(header.get("SATURATE")),
        pattern=pattern if sorted(pattern) == ["B", "G", "G", "R"] else None,
        kind=_name(header.get("IMAGETYP")),
    )


def _number(said: Any) -> float | None:
    """A number, of a quotient too; None where there is none."""
    try:
        found = float(said)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return found if np.isfinite(found) else None


def _positive(said: Any) -> float | None:
    found = _number(said)
    return found if found is not None and found > 0 else None


def _seconds(time: Any, speed: Any) -> float | None:
    """The exposure, or else 2^-speed: EXIF may hold APEX's value alone."""
    value = _number(speed)
    if time is not None or value is None or abs(value) > 64:
        return _positive(time)
    return 2.0**-value


def _f_number(stop: Any, aperture: Any) -> float | None:
    """The f-number, or else 2^(aperture / 2); a lens without contacts has an aperture of 0."""
    value = _positive(aperture)
    if stop is not None or value is None or value > 64:
        return _positive(stop)
    return 2 ** (value / 2)


def _time(said: Any) -> datetime.datetime | None:
    """A time as EXIF writes it, 2026:11:23 13:00:00, or as ISO 8601 does."""
    text = str(said or "").strip().strip("\0")
    try:
        return datetime.datetime.strptime(text[:19], "%Y:%m:%d %H:%M:%S")
    except ValueError:
        pass
    try:
        return datetime.datetime.fromisoformat(text).replace(tzinfo=None)
    except ValueError:
        return None


def _name(*parts: Any) -> str | None:
    """Maker and model, the maker once; `?` for what is no letter, as where the head is damaged."""
    texts = ("".join(c if c.isprintable() else "?" for c in str(part)) for part in parts if part)
    words = [text.strip("? ") for text in texts]
    if len(words) > 1 and words[-1].startswith(words[0]):
        words = words[1:]
    return " ".join(words) or None
