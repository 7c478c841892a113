"""Read the metadata of image files: exposure time, ISO speed, date, camera and bit depth.
OpenImageIO reads the EXIF data of JPEG, TIFF and PNG files. exifread reads the EXIF data of raw
files. astropy reads FITS headers."""

import datetime
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..core._warnings import warn
from ..errors import InputError, check_utf8
from . import _tiff_tags as tiff
from ._heads import png_chunks, targa_bits
from ._netpbm import NETPBM_FORMATS, netpbm_head
from ._tiff_tags import tiff_pictures
from .raw import FITS_FORMATS, RAW_FORMATS, extra, fits_header, opened_raw

ABSOLUTE_ZERO = -273.15  # degrees Celsius
_HIGHEST_RATING = 65535
_OUTPUT, _INDEX, _SPEED = "StandardOutputSensitivity", "RecommendedExposureIndex", "ISOSpeed"
_SENSITIVITIES = {
    1: (_OUTPUT,),
    2: (_INDEX,),
    3: (_SPEED,),
    4: (_INDEX, _OUTPUT),
    5: (_SPEED, _OUTPUT),
    6: (_INDEX, _SPEED),
    7: (_INDEX, _SPEED, _OUTPUT),
}
_CODES = "bits of codes"  # an own name in addition to those of OpenImageIO


@dataclass(frozen=True)
class ImageSettings:
    """The metadata of an image file; a value is None if the file does not state it.

    Attributes:
        exposure: exposure time, s.
        iso: ISO speed.
        f_number: f-number of the lens.
        taken: date and time of the camera's clock.
        temperature: temperature of the sensor, K.
        camera: make and model of the camera.
        black_level: black level, DN; for a mosaic whose sites differ, one for each site in the
            order of `pattern`.
        saturation: saturation level, DN.
        pattern: phase of a Bayer mosaic, such as "RGGB", counted from the first pixel of the file.
        bits: number of bits of the codes that `jaxvision.read_image` returns, from the file's
            depth: a 12-bit TIFF has 12. The camera's ADC may have fewer, not more.
        kind: value of IMAGETYP in a FITS file, such as "Flat Field".
        gain: value of GAIN in a FITS file, the setting of the amplifier in the camera's own unit.
    """

    exposure: float | None = None
    iso: float | None = None
    f_number: float | None = None
    taken: datetime.datetime | None = None
    temperature: float | None = None
    camera: str | None = None
    black_level: float | tuple[float, ...] | None = None
    saturation: float | None = None
    pattern: str | None = None
    kind: str | None = None
    gain: float | None = None
    bits: int | None = None


def read_settings(path: str | os.PathLike[str]) -> ImageSettings:
    """Read the metadata of an image file without its pixels.

    Args:
        path: a file that `jaxvision.read_image` reads.

    Returns:
        The settings; empty for a file without metadata.

    Raises:
        InputError: for a raw or FITS file that cannot be read, or if its optional dependency is
            missing.
    """
    file = Path(path)
    check_utf8(file)
    suffix = file.suffix.lower()
    if suffix in RAW_FORMATS:
        return _raw_settings(file)
    if suffix in FITS_FORMATS:
        return _fits_settings(file, fits_header(file))
    if suffix in NETPBM_FORMATS:
        head = netpbm_head(file)
        return ImageSettings(bits=head.bits, saturation=head.saturation)
    return _exif_settings(file, _attributes(file))


def largest_code(path: str | os.PathLike[str], codes: np.ndarray) -> float:
    """Return the largest code that an image file can hold, DN, for `codes` from `read_image`: 15
    for a PNG of 4 bits, and not 255, the largest number of the array's type.
    """
    settings = read_settings(path)
    largest = float(np.iinfo(codes.dtype).max)
    stated = settings.saturation or (2.0**settings.bits - 1 if settings.bits else largest)
    return stated if codes.max() <= stated else largest  # a stated depth that the codes contradict


def _attributes(file: Path) -> dict[str, Any]:
    """Read EXIF values that are single numbers or words, by OpenImageIO's names."""
    import OpenImageIO as oiio

    # libpng would print messages about the damage
    if (chunks := png_chunks(file)) and chunks.fault:
        return {}
    source = oiio.ImageInput.open(str(file))
    if source is None:
        with suppress(UnicodeDecodeError):  # it quotes the file
            oiio.geterror()  # otherwise the message is printed when the process ends
        return {}
    found = {}
    try:
        for attribute in source.spec().extra_attribs:
            with suppress(UnicodeDecodeError):  # a damaged name or value is not text
                value = attribute.value
                # TIFF gives a list with one number
                if isinstance(value, tuple) and len(value) == 1:
                    (value,) = value
                if isinstance(value, str | int | float):
                    found[attribute.name] = value
        found[_CODES] = {"uint8": 8, "uint16": 16}.get(str(source.spec().format))
    finally:
        source.close()
    return found


def _exif_settings(file: Path, exif: Mapping[str, Any]) -> ImageSettings:
    rating = exif.get("Exif:PhotographicSensitivity", exif.get("Exif:ISOSpeedRatings"))
    return ImageSettings(
        exposure=_seconds(exif.get("ExposureTime"), exif.get("Exif:ShutterSpeedValue")),
        iso=_sensitivity(file, rating, lambda name: exif.get(f"Exif:{name}")),
        f_number=_f_number(exif.get("FNumber"), exif.get("Exif:ApertureValue")),
        taken=_time(exif.get("Exif:DateTimeOriginal") or exif.get("DateTime")),
        camera=_name(exif.get("Make"), exif.get("Model")),
        pattern=next((page.pattern for page in tiff_pictures(file) if page.pattern), None),
        bits=_depth(file, exif),
    )


def _depth(file: Path, exif: Mapping[str, Any]) -> int | None:
    """Return the bits of the codes of a PNG, TIFF, JPEG or TGA; None for other samples."""
    whole = exif.get(_CODES)
    if chunks := png_chunks(file, head=True):
        return chunks.bits if whole else None
    page = next((page for page in tiff_pictures(file) if not page.is_copy), None)
    if page is None:
        return targa_bits(file) if "targa:version" in exif else whole
    if page.first(tiff.PHOTOMETRIC) == tiff.PALETTE:
        colours = np.array(page.values.get(tiff.COLOUR_MAP, (1,)))
        return 8 if not (colours % 257).any() or not (colours % 256).any() else 16
    bits = page.first(tiff.BITS, 1)
    return bits if page.first(tiff.SAMPLE_FORMAT, 1) == 1 and bits <= 16 else None


def _raw_settings(file: Path) -> ImageSettings:
    tags = _raw_tags(file)

    def exif(name: str) -> Any:
        """Return an EXIF value, which TIFF/EP and DNG may hold in the main directory."""
        return tags.get(f"EXIF {name}", tags.get(f"Image {name}"))

    with opened_raw(file) as raw:
        letters = raw.color_desc.decode()
        colours = raw.raw_colors_visible[:2, :2].ravel() if raw.num_colors > 1 else []
        pattern = "".join(letters[i] for i in colours)
        sites = raw.raw_pattern
        if raw.num_colors > 1 and not (_is_bayer(pattern) and np.shape(sites) == (2, 2)):
            _warn_of_mosaic(file, "x".join(map(str, np.shape(sites))) + f", {letters}")
            pattern = ""
        blacks = np.array(raw.black_level_per_channel, float)
        blacks = blacks[colours].reshape(2, 2) if pattern else blacks[:1].reshape(1, 1)
        stated = _dng_blacks(file)
        if stated is not None:
            rows, columns = (
                np.arange(n) % m for n, m in zip(stated.shape, blacks.shape, strict=True)
            )
            blacks = stated[
                np.ix_(*(np.arange(n) % m for n, m in zip(blacks.shape, stated.shape, strict=True)))
            ]
            if (stated != blacks[np.ix_(rows, columns)]).any():
                warn(
                    f"{file}: its black level is not used: it differs over rows or columns in more "
                    "than the sites of a mosaic; measure it from darks."
                )
                blacks = np.array([])
        levels = tuple(blacks.ravel().tolist())
        saturation = float(raw.white_level)
    return ImageSettings(
        exposure=_seconds(exif("ExposureTime"), exif("ShutterSpeedValue")),
        iso=_sensitivity(file, exif("ISOSpeedRatings"), exif),
        f_number=_f_number(exif("FNumber"), exif("ApertureValue")),
        taken=_time(exif("DateTimeOriginal") or tags.get("Image DateTime")),
        camera=_name(tags.get("Image Make"), tags.get("Image Model")),
        black_level=levels if len(set(levels)) > 1 else next(iter(levels), None),
        saturation=saturation,
        pattern=pattern or None,
    )


def _dng_blacks(file: Path) -> np.ndarray | None:
    """Return the black levels of a DNG's mosaic, in DN, over one period of rows and columns, or
    None if the file states no level. The levels are read here because LibRaw truncates and averages
    them."""
    for page in tiff_pictures(file):
        for picture in (page, *page.inner):
            along_columns, along_rows = (
                np.array(picture.values.get(t, (0,))) for t in tiff.BLACKS_ALONG
            )
            height, width = picture.values.get(tiff.BLACKS_SIZE, (1, 1))[:2]
            levels = np.array(picture.values.get(tiff.BLACKS, ()), float)
            if picture.is_copy or levels.size < max(height * width, 1):
                continue
            if len(set(along_columns)) == len(set(along_rows)) == 1:
                along_columns, along_rows = along_columns[:1], along_rows[:1]
            rows, columns = (
                max(n, m) for n, m in ((height, len(along_rows)), (width, len(along_columns)))
            )
            levels = levels[: height * width].reshape(height, width)
            levels = levels[np.ix_(np.arange(rows) % height, np.arange(columns) % width)]
            return levels + np.resize(along_rows, (rows, 1)) + np.resize(along_columns, columns)
    return None


def _raw_tags(file: Path) -> dict[str, Any]:
    """Read EXIF values by exifread's names. Of a list of values, only the first is returned."""
    exifread = extra("exifread", "raw", file)
    try:
        with file.open("rb") as stream:
            tags = exifread.process_file(stream, details=False)
    except Exception as error:  # a damaged header may raise any error
        raise InputError(f"{file}: its EXIF is damaged ({error}); copy it again.") from error
    return {
        name: tag.values if isinstance(tag.values, str) else tag.values[0]
        for name, tag in tags.items()
        if getattr(tag, "values", None)
    }


def _fits_settings(file: Path, header: Mapping[str, Any]) -> ImageSettings:
    celsius = _number(header.get("CCD-TEMP", header.get("SET-TEMP")))
    pedestal = _number(header.get("PEDESTAL"))
    return ImageSettings(
        exposure=_positive(header.get("EXPTIME")) or _positive(header.get("EXPOSURE")),
        iso=_positive(header.get("ISOSPEED")),
        taken=_time(header.get("DATE-OBS")),
        temperature=None if celsius is None else celsius - ABSOLUTE_ZERO,
        camera=_name(header.get("INSTRUME")),
        # or the negative of it, to be added
        black_level=None if pedestal is None else abs(pedestal),
        saturation=_positive(header.get("SATURATE")),
        pattern=_fits_pattern(file, header),
        kind=_name(header.get("IMAGETYP")),
        gain=_number(header.get("GAIN")),
    )


def _fits_pattern(file: Path, header: Mapping[str, Any]) -> str | None:
    """Return the phase of a FITS mosaic at the first pixel of the file. The keyword BAYERPAT gives
    the phase at the pixel (XBAYROFF, YBAYROFF) of the upright image. A file with the row order
    BOTTOM-UP starts with the lowest row of the upright image."""
    names = ("BAYERPAT", "COLORTYP")
    words = [str(header.get(name, "")).strip().strip("'").strip().upper() for name in names]
    known = [word for word in words if _is_bayer(word)]
    if not known:
        if words[0] and words[0] not in ("NONE", "MONO"):
            _warn_of_mosaic(file, words[0])
        return None
    right = int(_number(header.get("XBAYROFF", header.get("BAYOFFX"))) or 0)
    down = int(_number(header.get("YBAYROFF", header.get("BAYOFFY"))) or 0)
    from_below = str(header.get("ROWORDER", "")).strip().upper() == "BOTTOM-UP"
    down += from_below and header.get("NAXIS2", 1) % 2 == 0
    return "".join(
        known[0][2 * ((row + down) % 2) + (column + right) % 2]
        for row in (0, 1)
        for column in (0, 1)
    )


def _is_bayer(letters: str) -> bool:
    """Return whether letters are a phase of the Bayer mosaic, with diagonal greens."""
    return letters in ("RGGB", "BGGR", "GRBG", "GBRG")


def _warn_of_mosaic(file: Path, name: str) -> None:
    warn(f"{file}: its mosaic ({name}) is not used: it is none of RGGB, BGGR, GRBG and GBRG.")


def _number(value: Any) -> float | None:
    """Convert a value, possibly a fraction, to a finite number; None if that is not possible."""
    try:
        found = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return found if np.isfinite(found) else None


def _positive(value: Any) -> float | None:
    found = _number(value)
    return found if found is not None and found > 0 else None


def _sensitivity(file: Path, rating: Any, exif: Callable[[str], Any]) -> float | None:
    """Return the ISO speed, normally from the 16-bit tag. If this tag is absent or 65535, which
    means at least 65535, return the 32-bit value of the tag that the type of sensitivity names
    (EXIF 2.3, tag 0x8830)."""
    found = _positive(rating)
    if found is not None and found < _HIGHEST_RATING:
        return found
    kind = _number(exif("SensitivityType"))
    names = _SENSITIVITIES.get(int(kind or 0), ()) + _SENSITIVITIES[7]
    further = next((speed for name in names if (speed := _positive(exif(name)))), None)
    if found is not None and further is None:
        warn(
            f"{file}: its head says ISO 65535, which stands for that and more; the sensitivity is "
            "not used."
        )
    return further


def _seconds(time: Any, speed: Any) -> float | None:
    """Return the exposure time in s, or 2^-speed if EXIF contains only the APEX shutter speed."""
    value = _number(speed)
    if time is not None or value is None or abs(value) > 64:
        return _positive(time)
    return 2.0**-value


def _f_number(stop: Any, aperture: Any) -> float | None:
    """Return the f-number, or 2^(aperture / 2) from an APEX aperture, which is 0 if unknown."""
    value = _positive(aperture)
    if stop is not None or value is None or value > 64:
        return _positive(stop)
    return 2 ** (value / 2)


def _time(value: Any) -> datetime.datetime | None:
    """Parse a date and time in the form of EXIF, 2026:11:23 13:00:00, or of ISO 8601."""
    text = str(value or "").strip().strip("\0")
    try:
        return datetime.datetime.strptime(text[:19], "%Y:%m:%d %H:%M:%S")
    except ValueError:
        pass
    try:
        return datetime.datetime.fromisoformat(text).replace(tzinfo=None)
    except ValueError:
        return None


def _name(*parts: Any) -> str | None:
    """Join the maker and the model of a camera. If the model begins with the maker, return only the
    model. Characters that cannot be printed, as in damaged metadata, become `?`."""
    texts = ("".join(c if c.isprintable() else "?" for c in str(part)) for part in parts if part)
    words = [text.strip("? ") for text in texts]
    if len(words) > 1 and words[-1].startswith(words[0]):
        words = words[1:]
    return " ".join(words) or None
