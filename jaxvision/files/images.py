"""Read and write image files: PNG, TIFF, JPEG, EXR, Radiance HDR and NumPy arrays. Also read PGM,
PPM, TGA, raw files of cameras and FITS, which cannot be written.

This module cannot be traced by JAX. All functions take and return NumPy arrays. Most files are read
by OpenImageIO, which is loaded on first use. Arrays are (h, w) or (h, w, channels). Integer files
keep their codes of 1 to 16 bits, as uint8 or uint16; floating-point files become float32. If a
decoder changes the codes, the change is undone. If a file contains more than one picture, a warning
of one sentence names the pictures that are not read, or an error is raised. Every failure raises an
`InputError` with a message of one sentence.
"""

import errno
import logging
import os
import re
import shutil
import tempfile
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from tokenize import TokenError
from typing import Any
from zipfile import BadZipFile

import numpy as np

from ..core._warnings import warn
from ..core.interrupts import removed_if_interrupted
from ..core.plain_arrays import plain_array
from ..errors import InputError, check_utf8, nearest, unwritable
from . import _tiff_tags as tiff
from ._heads import (
    HALF,
    OFF,
    PngChunks,
    icc_differences,
    jpeg_extras,
    png_chunks,
    targa_bits,
)
from ._heads import PALETTE as PNG_PALETTE
from ._netpbm import NETPBM_FORMATS, read_netpbm
from ._plain_content import damaged, file_at
from ._radiance import END_OF_RANGE, is_radiance, read_radiance
from ._tiff_tags import TiffPicture, tiff_pictures
from .raw import FITS_FORMATS, RAW_FORMATS, listed, read_fits, read_raw

_LOG = logging.getLogger("jaxvision.io")
INTEGER_FORMATS = (".png", ".tif", ".tiff")
JPEG_FORMATS = (".jpg", ".jpeg")
LONGEST_JPEG = 65535  # rows or columns
FLOAT_FORMATS = (".exr", ".hdr")
READ_ONLY_FORMATS = (*NETPBM_FORMATS, ".tga")
# largest length of another library's message: OpenEXR lists every fault with the path
LONGEST_REASON = 300
NOT_TEXT = "it holds bytes that are not text where its format has text"
_DTYPES = {"uint8": np.uint8, "uint16": np.uint16, "half": np.float32, "float": np.float32}
# OpenImageIO's formats whose codes `_stored_codes` restores as they are stored.
_DECODED = ("png", "tiff", "jpeg", "openexr", "targa", "bmp", "gif")
# the names that plots use
_NAMES = {"r": "red", "g": "green", "b": "blue", "a": "alpha", "y": "grey"}
REC_709 = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)  # x, y of R, G, B and white
_LOSSY, _LOSSY_HALF = ("dwaa", "dwab", "jpeg"), ("b44", "b44a")  # of EXR and TIFF
# largest number of pixels by which a display window may exceed the stored data of an EXR
_MOST_ADDED = 1 << 26


@contextmanager
def replaced_on_success(path: Path) -> Iterator[Path]:
    """Yield a temporary path next to `path`, and move the file there to `path` if the block ends
    without an error. Missing folders are made. Raise `InputError` if the file cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=".partial-", suffix=path.suffix)
    except OSError as error:
        raise _unwritable(path, error) from error
    os.close(handle)
    partial = Path(name)
    with removed_if_interrupted(partial):
        try:
            yield partial
            partial.chmod(0o644)
            partial.replace(path)
        except OSError as error:  # name the file, which the error of a full disk does not
            if error.filename in (None, str(partial)):
                raise _unwritable(path, error) from error
            raise
        except InputError as error:  # a library's message names the temporary file
            raise InputError(str(error).replace(str(partial), str(path))) from error
        finally:
            partial.unlink(missing_ok=True)


def _unwritable(path: Path, error: OSError) -> InputError:
    if error.errno == errno.ENOENT:  # the folder exists, but cannot contain files
        return InputError(f"{path}: cannot be written: no file can be made there.")
    return InputError(f"{path}: cannot be written: {unwritable(error)}.")


def check_writable(path: Path, *, kind: type = np.float32) -> None:
    """Raise `InputError` if an image file with this suffix cannot contain samples of type `kind`,
    or cannot be written at this path. Functions that take long call this function first, so that
    they do not fail when they write their result."""
    _check_format(path, np.dtype(kind))
    if path.is_dir():
        raise InputError(f"{path}: is a folder; choose another name for the image.")
    nearest = next(folder for folder in path.absolute().parents if folder.exists())
    try:
        with tempfile.TemporaryFile(dir=nearest):
            pass
    except OSError as error:
        raise _unwritable(path, error) from error


def read_image(path: str | os.PathLike[str], *, part: int | str | None = None) -> np.ndarray:
    """Read the pixels of an image file as they are stored.

    Codes are returned as stored: 12-bit samples range from 0 to 4095, and bitmaps have the values 0
    and 1. `image_settings.read_settings` gives the number of bits. Rows and columns are also as
    stored. An orientation tag is not applied, but a warning names the tag. A palette is replaced by
    its colours. If the file stores white as zero, the codes are reversed, so that larger codes are
    brighter. For an EXR, the result is the picture of its display window, black outside the data
    window. The channels R, G, B and A, or Y, of an EXR are found by their names. For an HDR, the
    values are radiances; the factor EXPOSURE has been divided out.

    Colours of an EXR are premultiplied by alpha, as its standard requires. Colours of other files
    are returned as stored; they are usually not premultiplied.

    Warnings name contents of the file that are not read: further pictures, channels, or pixels
    outside the window.

    Args:
        path: a PNG, TIFF, JPEG, EXR, HDR, PGM, PPM, PFM, TGA or `.npy` file; DNG and other raw
            files with the `raw` extra, FITS with the `fits` extra.
        part: the picture to read from a file with several pictures: its number, from 0, or the name
            of an EXR part, an EXR layer or a FITS extension. None for the first picture.

    Returns:
        (h, w) for one channel, else (h, w, channels): uint8 or uint16 codes for PNG, TIFF, JPEG,
        PGM, PPM and TGA, the mosaic's uint16 for a raw file, float32 for EXR, HDR and PFM, the
        array itself for `.npy` and FITS.

    Raises:
        InputError: for a missing, unreadable or truncated file, for samples of another type, for
            colours that are not light (CMYK, Lab), and for a part that the file does not have.

    Example:
        >>> from tempfile import mkdtemp
        >>> file = mkdtemp() + "/grey.png"
        >>> jv.write_image(file, np.full((2, 3), 1000, np.uint16))
        >>> codes = jv.read_image(file)
        >>> print(codes.shape, codes.dtype, codes.max())
        (2, 3) uint16 1000
    """
    return read_channels(path, part=part)[0]


def read_channels(
    path: str | os.PathLike[str], *, part: int | str | None = None
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Read the pixels of an image file and the names of its channels.

    Args:
        path: as for `read_image`.
        part: as for `read_image`.

    Returns:
        The pixels, and the names of the channels: grey, red, green, blue, alpha, or the names in
            the file; empty for a file without names of channels.

    Raises:
        InputError: as `read_image` does.

    Example:
        >>> from tempfile import mkdtemp
        >>> file = mkdtemp() + "/grey.png"
        >>> jv.write_image(file, np.full((2, 3), 1000, np.uint16))
        >>> print(jv.files.read_channels(file)[1])
        ('grey',)
    """
    check_utf8(Path(path))
    file = file_at(path, "image")
    suffix = file.suffix.lower()
    names: tuple[str, ...] = ()
    if suffix in FITS_FORMATS:
        pixels = read_fits(file, part=part)
    elif suffix in (".npy", ".hdr", *RAW_FORMATS, *NETPBM_FORMATS) or is_radiance(file):
        special = {
            ".npy": _read_npy,
            **dict.fromkeys(RAW_FORMATS, read_raw),
            **dict.fromkeys(NETPBM_FORMATS, read_netpbm),
        }
        if part not in (None, 0):
            raise InputError(f"{file}: holds one picture, not a part {part!r}; leave part out.")
        pixels = special.get(suffix, read_radiance)(file)
    else:
        try:
            pixels, names = _read_by_openimageio(file, part)
        except UnicodeDecodeError:  # a name in the header is not text
            raise damaged(file, NOT_TEXT) from None
    _LOG.info("read %s: %s %s", file, "x".join(map(str, pixels.shape)), pixels.dtype)
    return pixels, names


def _read_by_openimageio(
    file: Path, part: int | str | None = None
) -> tuple[np.ndarray, tuple[str, ...]]:
    chunks = png_chunks(file)
    if chunks and chunks.fault:
        raise damaged(file, chunks.fault)
    pages = tiff_pictures(file)
    with _open(file) as source:
        number, layer = _place(file, source, pages, part)
        page = pages[number] if number < len(pages) else None
        spec = source.spec(number, 0)
        _refuse_unlike_pictures(file, spec, page)
        chosen, names = _channels(file, spec, layer)
        sample = _sample(file, spec, chosen)
        if page and page.first(tiff.PHOTOMETRIC) == tiff.PALETTE:
            pixels = _palette_colours(file, number, page)
        else:
            pixels = _pixels(file, source, number, chosen, sample)
            pixels = _stored_codes(file, pixels, spec, chunks, page)
            greys = (pixels[..., :3] == pixels[..., :1]).all() and (pixels[..., 3:] == 255).all()
            if source.format_name() == "gif" and greys:
                pixels, names = pixels[..., :1], ("grey",)
        _warn_of_unused(file, source.format_name(), spec, chunks, page)
    pixels = _display_window(file, pixels, spec)
    return pixels[..., 0] if pixels.shape[2] == 1 else pixels, names


@contextmanager
def _open(file: Path) -> Iterator[Any]:
    """Open a file by OpenImageIO so that colours are not multiplied by alpha."""
    import OpenImageIO as oiio

    as_stored = oiio.ImageSpec()
    as_stored.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(str(file), as_stored)
    if source is None:
        raise InputError(
            f"{file}: not readable as an image ({_reason(oiio)}); export it again as PNG, TIFF, "
            "EXR or HDR."
        )
    try:
        kind = source.format_name()
        if kind not in _DECODED:
            raise InputError(
                f"{file}: is a file of {kind}, whose codes do not come back as they are stored; "
                "export it again as PNG, TIFF, EXR or HDR."
            )
        yield source
    finally:
        source.close()


def _pixels(file: Path, source: Any, number: int, chosen: Sequence[int], sample: str) -> np.ndarray:
    """Read the channels `chosen` of a picture, (h, w, channels), in that order."""
    first, last = min(chosen), max(chosen) + 1
    spec = source.spec(number, 0)
    wanted = "float" if sample == "half" else sample
    pixels = source.read_image(number, 0, first, last, wanted)
    if pixels is None:
        raise damaged(file, _reason(source))
    pixels = np.asarray(pixels, _DTYPES[sample]).reshape(spec.height, spec.width, last - first)
    order = [i - first for i in chosen]
    return pixels if order == [*range(last - first)] else np.ascontiguousarray(pixels[..., order])


def _place(
    file: Path, source: Any, pages: Sequence[TiffPicture], part: int | str | None
) -> tuple[int, str | None]:
    """Return the index of the picture to read and its layer; warn of all others."""
    titles = [f"number {i}" for i in range(len(pages))]  # for a TIFF, without reading every page
    while not pages and source.seek_subimage(len(titles), 0):
        named = source.spec(len(titles), 0).get_string_attribute("oiio:subimagename")
        titles.append(named or f"number {len(titles)}")
    source.geterror()  # clears the message that there is no further one
    plain = [i for i in range(len(titles)) if i >= len(pages) or not pages[i].is_copy]
    if not plain and pages:
        raise InputError(
            f"{file}: its main pictures are small copies or masks, the picture itself lies deeper; "
            "a raw file of a camera needs its own suffix, such as .dng."
        )
    if isinstance(part, int) or part in titles:
        number = part if isinstance(part, int) else titles.index(part)
        if not 0 <= number < len(titles):
            raise InputError(f"{file}: has no picture {number}; it has {len(titles)}, from 0.")
        return number, None
    others = [titles[i] for i in plain[1:]]
    if part is None and others:
        warn(
            f"{file}: holds {len(plain)} pictures; {titles[plain[0]]} is read, and "
            f"{listed(others)} {'is' if len(others) == 1 else 'are'} not used (the argument part "
            "chooses one)."
        )
    promised = re.match(
        r"ImageJ=.*\nimages=(\d+)", source.spec(0, 0).get_string_attribute("ImageDescription")
    )
    # ImageJ's stack of pictures described by one tag, beyond 4 GiB
    if promised and int(promised[1]) > len(titles):
        warn(f"{file}: holds {promised[1]} pictures of ImageJ; only the first is read.")
    return plain[0], part


def _refuse_unlike_pictures(file: Path, spec: Any, page: TiffPicture | None) -> None:
    """Raise `InputError` for content that is not a picture of light in rows and columns."""
    inks = spec.get_string_attribute("jpeg:ColorSpace") in ("CMYK", "YCCK")
    photometric = page.first(tiff.PHOTOMETRIC, 1) if page else 1
    if inks or photometric == tiff.INKS:
        raise InputError(f"{file}: holds amounts of ink (CMYK), not light; convert it to RGB.")
    if photometric not in tiff.LIGHT:
        raise InputError(
            f"{file}: holds CIE Lab or other colours ({photometric}), not light; convert it to RGB."
        )
    if spec.get_int_attribute("bmp:bitsperpixel") == 16:
        raise InputError(f"{file}: holds colours of 5 and 6 bits; export it as PNG or TIFF.")
    if spec.deep:
        raise InputError(f"{file}: holds several depths a pixel; flatten it.")
    if spec.depth > 1:
        raise InputError(f"{file}: holds a volume of {spec.depth} layers; save one of them.")


def _channels(file: Path, spec: Any, layer: str | None) -> tuple[list[int], tuple[str, ...]]:
    """Choose the channels to read by their names. Return their indices and names."""
    layers: dict[str, dict[str, int]] = {}
    for i, name in enumerate(spec.channelnames):
        above, _, own = name.rpartition(".")
        layers.setdefault(above, {})[own] = i
    # renders of this library have a layer of standard errors in addition to the radiance
    rendered = bool(spec.get_string_attribute("jaxvision:relativeError"))
    beside = [name for name in layers if rendered and name.split(".")[0] == "error"]
    if layer is None:
        layer = "" if "" in layers else next(name for name in layers if name not in beside)
        if layer and len(layers) - len(beside) > 1:
            raise InputError(
                f"{file}: holds the layers {listed(sorted(layers))}, none of which is the picture; "
                "choose one by part."
            )
    if layer not in layers:
        raise InputError(f"{file}: has no part {layer!r}; {nearest(layer, filter(None, layers))}.")
    own = layers[layer]
    known: dict[str, int] = {}
    for name, i in own.items():
        known.setdefault({"red": "r", "green": "g", "blue": "b"}.get(name.lower(), name.lower()), i)
    if {"y", "ry", "by"} <= set(known):
        raise InputError(f"{file}: holds luminance and chroma (Y, RY, BY); convert it to R, G, B.")
    picture = next((c for c in ("rgb", "xyz", "y") if set(c) <= set(known)), "")
    chosen = [known[letter] for letter in picture]
    rest = [name for name in own if own[name] not in chosen]
    unnamed = all(re.fullmatch(r"channel\d+|A", name) for name in rest)
    if not chosen or (picture == "rgb" and unnamed):  # by position, as arrays are written
        chosen = sorted(own.values(), key=lambda i: _order(spec.channelnames[i], i))
    elif "a" in known:
        chosen.append(known["a"])
    unused = [spec.channelnames[i] for i in range(spec.nchannels) if i not in chosen]
    if unused and not rendered:
        warn(
            f"{file}: its channel{'s' if len(unused) > 1 else ''} {listed(unused)} "
            f"{'are' if len(unused) > 1 else 'is'} not used."
        )
    own_names = [spec.channelnames[i].rpartition(".")[2] for i in chosen]
    if picture == "xyz":
        layer = spec.channelnames[chosen[0]].rpartition(".")[0]
        what = f"{layer}.X, {layer}.Y and {layer}.Z" if layer else "CIE X, Y and Z"
        warn(f"{file}: holds {what}, not R, G and B; they are given as they are.")
    if picture not in ("rgb", "y"):
        return chosen, tuple(own_names)
    return chosen, tuple(_NAMES.get(name.lower()) or name for name in own_names)


def _order(name: str, index: int) -> tuple[float, int]:
    """Return the sort key of a channel. An EXR holds its channels in alphabetical order, in which
    channel10 precedes channel4."""
    number = re.search(r"\d+(?:[.,]\d+)?", name.rpartition(".")[2])
    return (float(number[0].replace(",", ".")) if number else -1, index)


def _sample(file: Path, spec: Any, chosen: Sequence[int]) -> str:
    """Return the sample type of the channels as one of the supported array types."""
    formats = spec.channelformats or [spec.format] * spec.nchannels
    for kind in {str(formats[i]) for i in chosen}:
        if kind not in _DTYPES:
            raise InputError(
                f"{file}: samples are of type {kind}; save it as uint8, uint16 or float."
            )
    return str(spec.format) if str(spec.format) in _DTYPES else "float"


def _stored_codes(
    file: Path, pixels: np.ndarray, spec: Any, chunks: PngChunks | None, page: TiffPicture | None
) -> np.ndarray:
    """Return the codes as stored, which the decoder has stretched to 8 or 16 bits."""
    if not np.issubdtype(pixels.dtype, np.integer):
        if page and page.first(tiff.PHOTOMETRIC, 1) == tiff.WHITE_IS_ZERO:
            raise InputError(f"{file}: floating numbers with white as zero; save it the other way.")
        return pixels
    full = 8 * pixels.dtype.itemsize
    bits = full
    if chunks:
        bits = 8 if chunks.colour_type == PNG_PALETTE else chunks.depth
    elif page:
        bits = page.first(tiff.BITS, 1)
    elif spec.get_int_attribute("targa:version"):
        bits = targa_bits(file)
    if bits < full:
        pixels = pixels >> (full - bits)  # the last bits repeat the first ones, exactly or nearly
    if page and page.first(tiff.PHOTOMETRIC, 1) == tiff.WHITE_IS_ZERO and full == 16:
        pixels = (2**bits - 1) - pixels  # the decoder itself does this up to 8 bits
    return _significant(file, pixels, bits, chunks) if chunks else pixels


def _significant(file: Path, pixels: np.ndarray, bits: int, chunks: PngChunks) -> np.ndarray:
    """Return the codes before a stretch to the depth of a PNG file that sBIT states."""
    if chunks.colour_type == PNG_PALETTE or all(bits == n for n in chunks.significant):
        return pixels
    source = chunks.bits
    codes, added = pixels >> (bits - source), bits - source
    stretched = [codes << added, _repeat_bits(codes, source, bits)]
    stretched.append(np.round(codes * ((2**bits - 1) / (2**source - 1))).astype(pixels.dtype))
    if source < bits and any(np.array_equal(pixels, way) for way in stretched):
        return codes
    stated = ", ".join(map(str, chunks.significant))
    warn(
        f"{file}: its sBIT ({stated} significant bits) is not used: the numbers are as stored, of "
        f"{bits} bits."
    )
    return pixels


def _repeat_bits(codes: np.ndarray, source: int, bits: int) -> np.ndarray:
    """Stretch codes to a larger bit depth by repeating their bits."""
    whole, left = np.zeros_like(codes), bits
    while left > 0:
        left -= source
        whole |= codes << left if left >= 0 else codes >> -left
    return whole


def _palette_colours(file: Path, number: int, page: TiffPicture) -> np.ndarray:
    """Return the colours of a TIFF with a palette, (h, w, 3), at full depth, because the decoder
    keeps only 8 bits. The palette indices are read from a copy of the file whose header declares a
    grey picture."""
    bits = page.first(tiff.BITS, 1)
    colours = np.array(page.values.get(tiff.COLOUR_MAP, ()))
    if len(colours) != 3 << bits:
        raise damaged(file, f"its palette holds {len(colours)} numbers where {3 << bits} belong")
    with tempfile.TemporaryDirectory() as folder:
        grey = Path(folder) / "grey.tif"
        shutil.copyfile(file, grey)
        with grey.open("r+b") as stream:
            order = "little" if stream.read(2) == b"II" else "big"
            stream.seek(page.places[tiff.PHOTOMETRIC])
            stream.write((1).to_bytes(2, order))
        with _open(grey) as source:
            indices = _pixels(file, source, number, [0], str(source.spec(number, 0).format))
            indices = _stored_codes(file, indices, source.spec(number, 0), None, page)[..., 0]
    colours = colours.reshape(3, -1).T.astype(np.uint16)[indices]
    for step in (257, 256):  # 8 bits, stored in one of two ways
        if not (colours % step).any():
            return (colours // step).astype(np.uint8)
    return colours


def _warn_of_unused(
    file: Path, kind: str, spec: Any, chunks: PngChunks | None, page: TiffPicture | None
) -> None:
    """Warn about metadata that change the meaning of the codes and are not applied."""
    unused = [
        f"its picture of {x.first(tiff.ROWS)} x {x.first(tiff.COLUMNS)} and "
        f"{x.first(tiff.BITS, 1)} bits in a SubIFD: export it as a file of its own"
        for x in (page.inner if page else ())
        if not x.is_copy
    ]
    orientation = spec.get_int_attribute("Orientation", 1)
    if orientation not in (0, 1):
        unused.append(f"its orientation (tag {orientation}): rows and columns are as stored")
    aspect = spec.get_float_attribute("PixelAspectRatio", 1.0)
    if not 0.99 < aspect < 1.01:
        unused.append(f"its pixels' aspect of {aspect:g}: they are taken as square")
    primaries = np.ravel(spec.getattribute("chromaticities") or REC_709)
    if primaries.shape != (8,) or np.abs(primaries - REC_709).max() > 0.01:
        unused.append(f"its primaries ({', '.join(f'{x:.4g}' for x in primaries)})")
    if chunks and chunks.frames > 1:
        unused.append(f"its animation of {chunks.frames} frames: the still picture is read")
    if chunks:
        unused += chunks.scales
    if (profile := spec.getattribute("ICCProfile")) is not None:
        name = spec.get_string_attribute("ICCProfile:profile_description")
        unused += icc_differences(np.asarray(profile, np.uint8).tobytes(), name)
    if kind == "jpeg":
        unused += jpeg_extras(file)
    if page and page.first(tiff.ALPHA) == tiff.MULTIPLIED:
        unused.append("that its colours are multiplied by alpha (those of most files are not)")
    white = spec.get_float_attribute("whiteLuminance", 0.0)
    if white > 0:
        unused.append(f"its luminance of white, {white:g} cd m^-2: values are relative, as stored")
    if page:
        unused += _gdal_scaling(page)
        unused += _tiff_colours(page, profiled=profile is not None)
    words = spec.get_string_attribute("ImageDescription")
    calibration = dict(re.findall(r"^(cf|c[0-4])=(.*)$", words, re.M))
    plain = [("cf", "0"), ("c0", "0.0"), ("c1", "1.0")]
    if words.startswith("ImageJ=") and calibration and [*calibration.items()] != plain:
        settings = ", ".join(f"{name} = {value.strip()}" for name, value in calibration.items())
        unused.append(f"its calibration by ImageJ ({settings}): the codes are as stored")
    if unused:
        warn(f"{file}: not used: {'; '.join(unused)}.")
    compression = spec.get_string_attribute("compression").partition(":")[0]
    half = "half" in map(str, spec.channelformats or [spec.format])
    if kind != "jpeg" and (compression in _LOSSY or (compression in _LOSSY_HALF and half)):
        warn(
            f"{file}: its compression ({compression}) is lossy: the numbers are not those that "
            "were written; for measurements write it with zip."
        )


def _tiff_colours(page: TiffPicture, *, profiled: bool) -> Iterator[str]:
    """Describe how tone curve and primaries in a TIFF's own tags differ from sRGB."""
    curve = np.array(page.values.get(tiff.TRANSFER, ()))
    bits = page.first(tiff.BITS, 1)
    if not profiled and bits <= 16 and curve.size in (1 << bits, 3 << bits):
        half = float(curve[round(0.5 * (2**bits - 1))] / 65535)
        if abs(half - HALF) > OFF:
            yield (
                f"its tone curve (TransferFunction: half of the largest code is {half:.2g} of the "
                f"light, where sRGB has {HALF:.2g}): codes are as stored"
            )
    primaries = np.array(page.values.get(tiff.PRIMARIES, ()))
    if not profiled and primaries.shape == (6,) and np.abs(primaries - REC_709[:6]).max() > 0.01:
        yield f"its primaries ({', '.join(f'{x:.4g}' for x in primaries)})"


def _gdal_scaling(page: TiffPicture) -> list[str]:
    """Describe GDAL's metadata of a GeoTIFF: scale, offset, and the value of missing pixels."""
    items = re.findall(
        r"<Item[^>]*\brole=[\"'](scale|offset)[\"'][^>]*>\s*([^<\s]+)", page.text(tiff.GDAL_WORDS)
    )
    plain = {"scale": 1.0, "offset": 0.0}
    roles = [f"{role} = {number}" for role, number in items if _differs(number, plain[role])]
    unused = []
    if roles:
        unused.append(f"its {', '.join(dict.fromkeys(roles))} by GDAL: the numbers are as stored")
    if missing := page.text(tiff.GDAL_MISSING).strip():
        unused.append(f"that pixels of {missing} are missing, by GDAL")
    return unused


def _differs(number: str, plain: float) -> bool:
    try:
        return float(number) != plain
    except ValueError:
        return True


def _display_window(file: Path, pixels: np.ndarray, spec: Any) -> np.ndarray:
    """Return the display window of an EXR, black outside the data of the file."""
    rows, columns = spec.full_height, spec.full_width
    top, left = spec.y - spec.full_y, spec.x - spec.full_x
    height, width = pixels.shape[:2]
    whole = (top, left, rows, columns) == (0, 0, height, width)
    if whole or not spec.get_string_attribute("openexr:lineOrder"):
        return pixels
    inside_rows = range(max(top, 0), min(top + height, rows))
    inside_columns = range(max(left, 0), min(left + width, columns))
    if not inside_rows or not inside_columns:
        raise InputError(
            f"{file}: none of its pixels lies within its display window; correct its windows."
        )
    if rows * columns - height * width > _MOST_ADDED:
        raise InputError(
            f"{file}: holds {height} x {width} pixels of a display window of {rows} x {columns}; "
            "correct its windows."
        )
    outside = height * width - len(inside_rows) * len(inside_columns)
    if outside:
        warn(
            f"{file}: {outside} pixels outside its display window of {rows} x {columns} are not "
            "used."
        )
    made = np.zeros((rows, columns, pixels.shape[2]), pixels.dtype)
    to_rows, to_columns = (slice(r.start, r.stop) for r in (inside_rows, inside_columns))
    made[to_rows, to_columns] = pixels[
        inside_rows.start - top : inside_rows.stop - top,
        inside_columns.start - left : inside_columns.stop - left,
    ]
    return made


def read_environment(path: str | os.PathLike[str]) -> np.ndarray:
    """Read a latitude-longitude picture of radiance from an EXR or HDR file, for `environment_map`.

    Args:
        path: path of the file. An alpha channel is ignored. The part of an EXR picture outside the
            data window is black.

    Returns:
        (h, 2 h, bands) float32, W m^-2 sr^-1 or relative.

    Raises:
        InputError: for a file that `read_image` refuses, for integer samples (a display picture
            holds no radiance), for a picture that is not twice as wide as high, and for values that
            are negative or not finite.
    """
    picture = read_sky(path)
    height, width, _ = picture.shape
    if width != 2 * height:
        raise InputError(
            f"{path}: {height} rows of {width} are no latitude-longitude picture, which is twice "
            "as wide as high; convert it from its other projection first."
        )
    return picture


def read_sky(path: str | os.PathLike[str]) -> np.ndarray:
    """Read a picture of radiance in any projection, (h, w, bands) float32, without its alpha. Raise
    `InputError` for integers and for values that are negative or not finite."""
    picture, names = read_channels(path)
    if not np.issubdtype(picture.dtype, np.floating):
        raise InputError(
            f"{path}: {picture.dtype} samples hold no radiance; an environment is an EXR or HDR."
        )
    picture = np.atleast_3d(picture).astype(np.float32)
    picture = picture[..., [i for i in range(picture.shape[2]) if names[i : i + 1] != ("alpha",)]]
    wrong = int((~(np.isfinite(picture) & (picture >= 0))).sum())
    if wrong:
        raise InputError(
            f"{path}: {wrong} of its values are negative or not finite; repair them first."
        )
    return picture


def write_image(path: str | os.PathLike[str], pixels: np.ndarray, *, quality: int = 95) -> None:
    """Write an image file in the format that its suffix names.

    The file appears at its path only when it is complete. A lossless integer file is read back and
    compared with the array.

    Args:
        path: the file. uint8 and uint16 are written as PNG or TIFF of the same depth, uint8 with
            one or three channels also as JPEG, floating arrays as EXR or HDR. An HDR file has three
            channels from 0 to 1.7e38 with a shared exponent, in steps of up to 1 % of a pixel's
            largest channel, so that much smaller channels of the pixel are lost.
        pixels: (h, w) or (h, w, channels), codes or any unit.
        quality: quality of a JPEG, 1 to 100 on libjpeg's scale. Colour has half the resolution
            below 90, and full resolution from 90 on.

    Raises:
        InputError: for pixels that the format cannot hold, and for a file that cannot be written.

    Example:
        >>> from tempfile import mkdtemp
        >>> file = mkdtemp() + "/radiance.exr"
        >>> jv.write_image(file, np.full((2, 3), 0.5, np.float32))
        >>> print(jv.read_image(file).mean())
        0.5
    """
    file, array = Path(path), np.ascontiguousarray(plain_array("pixels", pixels))
    suffix = file.suffix.lower()
    if array.ndim not in (2, 3) or 0 in array.shape:
        raise InputError(f"{file}: an image is (h, w) or (h, w, channels), got {array.shape}.")
    _check_format(file, array.dtype)
    if suffix == ".hdr" and (array.ndim != 3 or array.shape[2] != 3):
        raise InputError(f"{file}: Radiance HDR holds three channels, got {array.shape}.")
    if suffix == ".hdr" and (wrong := int((~((array >= 0) & (array < END_OF_RANGE))).sum())):
        raise InputError(
            f"{file}: {wrong} values are negative, not finite, or {END_OF_RANGE:.2g} and more, "
            "which Radiance HDR cannot hold; write EXR."
        )
    if suffix in JPEG_FORMATS and not (array.ndim == 2 or array.shape[2] in (1, 3)):
        raise InputError(f"{file}: JPEG holds one or three channels, got {array.shape}.")
    if suffix == ".png" and array.ndim == 3 and array.shape[2] > 4:
        raise InputError(
            f"{file}: PNG holds one to four channels, got {array.shape[2]}; write TIFF."
        )
    if suffix in JPEG_FORMATS and max(array.shape[:2]) > LONGEST_JPEG:
        raise InputError(
            f"{file}: JPEG holds at most {LONGEST_JPEG} rows and columns, got {array.shape[:2]}."
        )
    if not 1 <= quality <= 100:
        raise InputError(f"{file}: quality is 1 to 100, got {quality}.")
    attributes: dict[str, str | int] = {"oiio:UnassociatedAlpha": 1}
    if suffix in JPEG_FORMATS:
        attributes["compression"] = f"jpeg:{quality}"
        attributes["jpeg:subsampling"] = "4:2:0" if quality < 90 else "4:4:4"
    if np.issubdtype(array.dtype, np.floating):
        array = as_float32(file, array)
    shape = array.shape if array.ndim == 3 else (*array.shape, 1)
    with replaced_on_success(file) as partial:
        _write(partial, [array.reshape(shape)], shape, array.dtype, attributes)
        if suffix in INTEGER_FORMATS and not _reads_back(partial, array):
            raise InputError(f"{file}: what was written does not read back; is the disk full?")


def as_float32(path: str | os.PathLike[str], numbers: np.ndarray) -> np.ndarray:
    """Convert numbers, in any unit, to float32. Raise `InputError` for finite numbers beyond the
    range of float32, for whole numbers that float32 rounds, and if all numbers are below 1e-31."""
    if numbers.dtype == np.float32:
        return numbers
    with np.errstate(over="ignore", under="ignore"):
        single = numbers.astype(np.float32)
    if numbers.dtype.kind in "iu":
        lost, why = single.astype(numbers.dtype) != numbers, "ends for whole numbers at 2^24"
    else:
        lost, why = np.isfinite(numbers) & ~np.isfinite(single), "ends at 3.4e38"
    if not lost.any() and numbers.dtype.kind == "f":
        size = np.abs(np.where(np.isfinite(numbers), numbers, 0))
        limit = np.finfo(np.float32)
        lost = (size > 0) & (size.max() < limit.tiny / limit.eps)
        why = "has its 7 digits from 1e-31 on"
    if count := int(lost.sum()):
        raise InputError(
            f"{path}: float32, which the file holds, {why}: {count} of {numbers.size} numbers do "
            "not fit; scale them."
        )
    return single


def _check_format(file: Path, dtype: np.dtype) -> None:
    """Raise `InputError` unless the file's format supports samples of this type."""
    check_utf8(file)
    suffix, kept = file.suffix.lower(), (np.uint8, np.uint16)
    fits = {
        **dict.fromkeys(FLOAT_FORMATS, np.issubdtype(dtype, np.floating)),
        **dict.fromkeys(INTEGER_FORMATS, dtype in kept),
        **dict.fromkeys(JPEG_FORMATS, dtype == np.uint8),
    }
    if suffix not in fits:
        known = ", ".join(INTEGER_FORMATS + JPEG_FORMATS + FLOAT_FORMATS)
        raise InputError(f"{file}: unknown image suffix {suffix!r}; use one of {known}.")
    if not fits[suffix]:
        hint = (
            "; jaxvision.to_integers makes codes of a picture from 0 to 1"
            if np.issubdtype(dtype, np.floating)
            else ""
        )
        raise InputError(
            f"{file}: {dtype} pixels do not fit {suffix}; uint8 and uint16 go to PNG or TIFF, "
            f"uint8 to JPEG, floating point to EXR or HDR{hint}."
        )


def write_exr(
    path: str | os.PathLike[str],
    blocks: Iterable[np.ndarray],
    *,
    shape: tuple[int, int, int],
    channels: Sequence[str] = (),
    attributes: Mapping[str, str | int] | None = None,
) -> None:
    """Write an EXR file of float32 samples, given as blocks of rows.

    The whole picture never needs to be in memory. The file appears at its path only when it is
    complete.

    Args:
        path: the file.
        blocks: (rows, w, channels) each, from the top down, in any unit.
        shape: (h, w, channels) of the picture.
        channels: names of the channels; a reader returns them in alphabetical order (except R, G,
            B, A).
        attributes: attributes of the file's header; a number of more than 32 bits becomes text.

    Raises:
        InputError: if the file cannot be written, and for numbers that `as_float32` refuses.
        ValueError: unless the blocks have the shape in total.
    """
    file = Path(path)
    check_utf8(file)
    with replaced_on_success(file) as partial:
        _write(partial, blocks, shape, np.dtype(np.float32), attributes or {}, channels)


def _write(
    file: Path,
    blocks: Iterable[np.ndarray],
    shape: tuple[int, ...],
    dtype: np.dtype,
    attributes: Mapping[str, str | int],
    names: Sequence[str] = (),
) -> None:
    """Write an image file from blocks of rows, (rows, w, channels), from the top."""
    import OpenImageIO as oiio

    height, width, channels = shape
    sample = "float" if dtype == np.float32 else str(dtype)
    sink = oiio.ImageOutput.create(str(file))
    spec = oiio.ImageSpec(width, height, channels, sample)
    spec.attribute("DateTime", "")  # no date, so that equal pictures give equal files
    if names:
        spec.channelnames = tuple(names)
    for name, value in attributes.items():
        # the format has no such integers
        wide = isinstance(value, int) and not -(2**31) <= value < 2**31
        value = str(value) if wide else value
        text = value.encode(errors="replace").decode() if isinstance(value, str) else value
        spec.attribute(name, text)
    if sink is None or not sink.open(str(file), spec):
        raise InputError(f"{file}: cannot be written ({_reason(oiio)}).")
    written, row = True, 0
    for block in blocks:
        pixels = as_float32(file, np.asarray(block)) if sample == "float" else block
        pixels = np.ascontiguousarray(pixels, dtype)
        if pixels.shape[1:] != (width, channels) or row + len(pixels) > height:
            raise ValueError(f"a block of {pixels.shape} does not fit at row {row} of {shape}.")
        written = written and sink.write_scanlines(row, row + len(pixels), 0, pixels)
        row += len(pixels)
    if row != height:
        raise ValueError(f"the blocks hold {row} rows where the picture has {height}.")
    message = _reason(sink)
    if not (sink.close() and written):
        raise InputError(f"{file}: cannot be written ({message}).")


def _reads_back(file: Path, written: np.ndarray) -> bool:
    try:
        read, _ = _read_by_openimageio(file)
    except InputError:
        return False
    return read.dtype == written.dtype and np.array_equal(read.reshape(written.shape), written)


_NOT_NUMPY = (ValueError, TypeError, OSError, EOFError, MemoryError, SyntaxError, TokenError)
# Checksums differ, or the compression or encryption is not supported.
_NOT_ARCHIVE = (BadZipFile, zlib.error, NotImplementedError, RuntimeError)


def _read_npy(file: Path) -> np.ndarray:
    try:
        return np.load(file, allow_pickle=False)
    except _NOT_NUMPY as error:
        raise InputError(f"{file}: not a NumPy array file ({_one_line(str(error))}).") from error


def read_arrays(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    """Read the arrays of a `.npz` file, which the library writes for posterior draws next to a
    record, and for chains.

    Args:
        path: the file.

    Returns:
        Arrays by name, in the order of the file, exactly as they were written.

    Raises:
        InputError: for a file that is damaged, or is no archive of NumPy arrays.
    """
    file = Path(path)
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as content:
            return dict(content)
    except (*_NOT_NUMPY, *_NOT_ARCHIVE) as error:
        raise InputError(
            f"{file}: no whole archive of arrays ({_one_line(str(error))})."
        ) from error


def _reason(teller: Any) -> str:
    """Return the last error message of OpenImageIO, or of one of its open files, on one line."""
    try:
        words = _one_line(teller.geterror())
    except UnicodeDecodeError:  # it quotes the file
        return NOT_TEXT
    return "of no format of images that is known" if "find a format reader" in words else words


def _one_line(message: str) -> str:
    words = " ".join(message.split()) or "no further detail"
    return words if len(words) <= LONGEST_REASON else f"{words[:LONGEST_REASON]} ..."
