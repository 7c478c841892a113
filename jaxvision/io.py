"""Image files: 8- and 16-bit PNG and TIFF, JPEG, EXR and Radiance HDR, NumPy arrays; raw files of
cameras and FITS, which are read only.

This is the edge of the library: eager, with NumPy in and out, through OpenImageIO, which is loaded
on first use. Arrays are (h, w) or (h, w, channels). Integer files keep their bit depth (uint8,
uint16); floating files come as float32. Every failure is an `InputError` of one sentence.
"""

import errno
import logging
import os
import tempfile
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from tokenize import TokenError
from typing import Any
from zipfile import BadZipFile

import numpy as np

from ._png_chunks import png_fault
from .errors import InputError, check_utf8, unwritable
from .interrupts import removed_if_interrupted
from .plain_arrays import plain_array
from .raw_files import FITS_FORMATS, RAW_FORMATS, read_fits, read_raw

_LOG = logging.getLogger("jaxvision.io")
INTEGER_FORMATS = (".png", ".tif", ".tiff")
JPEG_FORMATS = (".jpg", ".jpeg")
FLOAT_FORMATS = (".exr", ".hdr")
LONGEST_REASON = 300  # characters of another library's complaint: OpenEXR lists each, path and all
_DTYPES = {"uint8": np.uint8, "uint16": np.uint16, "half": np.float32, "float": np.float32}


@contextmanager
def replaced_on_success(path: Path) -> Iterator[Path]:
    """A temporary path beside `path`, which replaces it only when the block ends without error.

    So no half-written file is ever left under the final name.

    Args:
        path: the final file; missing folders are made.

    Returns:
        A context manager that gives the temporary path.

    Raises:
        InputError: if the folder cannot be written.
    """
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
        except OSError as error:  # of this file: a full disk names none
            if error.filename in (None, str(partial)):
                raise _unwritable(path, error) from error
            raise
        except InputError as error:  # a library's reason names the file that it wrote
            raise InputError(str(error).replace(str(partial), str(path))) from error
        finally:
            partial.unlink(missing_ok=True)


def _unwritable(path: Path, error: OSError) -> InputError:
    if error.errno == errno.ENOENT:  # its folder is there, of a kind that takes none
        return InputError(f"{path}: cannot be written: no file can be made there.")
    return InputError(f"{path}: cannot be written: {unwritable(error)}.")


def check_writable(path: Path, *, kind: type = np.float32) -> None:
    """Checks, before the work that an image file is for, that it can be written.

    Args:
        path: the file. Missing folders are made later, with the file.
        kind: type of its samples.

    Raises:
        InputError: if the format of the suffix holds no such samples, if a folder has that name, or
            if its folder cannot be written.
    """
    _check_format(path, np.dtype(kind))
    if path.is_dir():
        raise InputError(f"{path}: is a folder; choose another name for the image.")
    nearest = next(folder for folder in path.absolute().parents if folder.exists())
    try:
        with tempfile.TemporaryFile(dir=nearest):
            pass
    except OSError as error:
        raise _unwritable(path, error) from error


def read_image(path: str | os.PathLike[str]) -> np.ndarray:
    """The pixels of an image file as they are stored.

    Args:
        path: a PNG, TIFF, JPEG, EXR, HDR or `.npy` file; DNG and other raw files with the `raw`
            extra, FITS with the `fits` extra.

    Returns:
        (h, w) for one channel, else (h, w, channels): uint8 or uint16 codes for PNG, TIFF and JPEG,
        the mosaic's uint16 for a raw file, float32 for EXR and HDR, the array itself for `.npy` and
        FITS.

    Raises:
        InputError: for a missing, unreadable or truncated file, and for samples of another type.

    Example:
        >>> from tempfile import mkdtemp
        >>> file = mkdtemp() + "/grey.png"
        >>> jv.write_image(file, np.full((2, 3), 1000, np.uint16))
        >>> codes = jv.read_image(file)
        >>> print(codes.shape, codes.dtype, codes.max())
        (2, 3) uint16 1000
    """
    file = Path(path)
    check_utf8(file)
    if not file.is_file():
        raise InputError(f"{file}: no such image file; check the name and the folder.")
    special = {
        ".npy": _read_npy,
        **dict.fromkeys(RAW_FORMATS, read_raw),
        **dict.fromkeys(FITS_FORMATS, read_fits),
    }
    pixels = special.get(file.suffix.lower(), _read_by_openimageio)(file)
    _LOG.info("read %s: %s %s", file, "x".join(map(str, pixels.shape)), pixels.dtype)
    return pixels


def _read_by_openimageio(file: Path) -> np.ndarray:
    import OpenImageIO as oiio

    if fault := png_fault(file):
        raise _damaged(file, fault)
    as_stored = oiio.ImageSpec()
    as_stored.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(str(file), as_stored)
    if source is None:
        raise InputError(
            f"{file}: not readable as an image ({_reason(oiio)}); "
            "export it again as PNG, TIFF, EXR or HDR."
        )
    try:
        spec = source.spec()
        sample = str(spec.format)
        if sample not in _DTYPES:
            raise InputError(
                f"{file}: samples are of type {sample}; save it as uint8, uint16 or float."
            )
        pixels = source.read_image(0, 0, 0, spec.nchannels, "float" if sample == "half" else sample)
        if pixels is None:
            raise _damaged(file, _reason(source))
    finally:
        source.close()
    pixels = np.asarray(pixels, _DTYPES[sample]).reshape(spec.height, spec.width, spec.nchannels)
    return pixels[..., 0] if spec.nchannels == 1 else pixels


def _damaged(file: Path, reason: str) -> InputError:
    return InputError(
        f"{file}: the file is damaged or cut short ({reason}); copy it again from its source."
    )


def read_environment(path: str | os.PathLike[str]) -> np.ndarray:
    """A latitude-longitude picture of radiance from an EXR or HDR file, for `environment_map`.

    Args:
        path: the file; an alpha channel is left out.

    Returns:
        (h, 2 h, bands) float32, W m^-2 sr^-1 or relative.

    Raises:
        InputError: for a file that `read_image` refuses, for integer samples (a display picture
            holds no radiance), for a picture that is not twice as wide as high, and for values that
            are negative or not finite.
    """
    picture = read_image(path)
    if not np.issubdtype(picture.dtype, np.floating):
        raise InputError(
            f"{path}: {picture.dtype} samples hold no radiance; an environment is an EXR or HDR."
        )
    picture = np.atleast_3d(picture).astype(np.float32)
    picture = picture[..., :3] if picture.shape[2] == 4 else picture
    height, width, _ = picture.shape
    if width != 2 * height:
        raise InputError(
            f"{path}: {height} rows of {width} are no latitude-longitude picture, which is twice "
            "as wide as high; convert it from its other projection first."
        )
    wrong = int((~(np.isfinite(picture) & (picture >= 0))).sum())
    if wrong:
        raise InputError(
            f"{path}: {wrong} of its values are negative or not finite; repair them first."
        )
    return picture


def write_image(path: str | os.PathLike[str], pixels: np.ndarray, *, quality: int = 95) -> None:
    """Writes an image file; the suffix chooses the format.

    The file appears only when it is complete. A lossless integer file is read back to prove that
    its depth survived.

    Args:
        path: the file. uint8 and uint16 go to PNG or TIFF at their own depth, uint8 of one or three
            channels to JPEG, floating arrays to EXR or HDR (HDR: three channels, shared exponent,
            steps of about 1 %).
        pixels: (h, w) or (h, w, channels), codes or any unit.
        quality: of a JPEG, 1 to 100 on libjpeg's scale. Colour is stored at half the resolution
            below 90, at full resolution from 90 on.

    Raises:
        InputError: for pixels that do not fit the format, and for a file that cannot be written.

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
    if suffix in JPEG_FORMATS and not (array.ndim == 2 or array.shape[2] in (1, 3)):
        raise InputError(f"{file}: JPEG holds one or three channels, got {array.shape}.")
    if not 1 <= quality <= 100:
        raise InputError(f"{file}: quality is 1 to 100, got {quality}.")
    attributes: dict[str, str | int] = {"oiio:UnassociatedAlpha": 1}
    if suffix in JPEG_FORMATS:
        attributes["compression"] = f"jpeg:{quality}"
        attributes["jpeg:subsampling"] = "4:2:0" if quality < 90 else "4:4:4"
    if np.issubdtype(array.dtype, np.floating):
        if (np.isfinite(array) & (np.abs(array) > np.finfo(np.float32).max)).any():
            raise InputError(f"{file}: float32, which it holds, ends at 3.4e38; scale the image.")
        array = array.astype(np.float32)
    shape = array.shape if array.ndim == 3 else (*array.shape, 1)
    with replaced_on_success(file) as partial:
        _write(partial, [array.reshape(shape)], shape, array.dtype, attributes)
        if suffix in INTEGER_FORMATS and not _reads_back(partial, array):
            raise InputError(f"{file}: what was written does not read back; is the disk full?")


def _check_format(file: Path, dtype: np.dtype) -> None:
    """`InputError` unless the file's format holds samples of this type."""
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
            f"{file}: {dtype} pixels do not fit {suffix}; uint8 and uint16 go to PNG or "
            f"TIFF, uint8 to JPEG, floating point to EXR or HDR{hint}."
        )


def write_exr(
    path: str | os.PathLike[str],
    blocks: Iterable[np.ndarray],
    *,
    shape: tuple[int, int, int],
    channels: Sequence[str] = (),
    attributes: Mapping[str, str | int] | None = None,
) -> None:
    """Writes an EXR of float32 samples from blocks of rows.

    The picture need never be in memory as a whole. The file appears only when it is complete.

    Args:
        path: the file.
        blocks: (rows, w, channels) each, from the top, any unit.
        shape: (h, w, channels) of the picture.
        channels: their names; a reader gives them back in alphabetical order (except R, G, B, A).
        attributes: of the file's header.

    Raises:
        InputError: if the file cannot be written.
        ValueError: unless the blocks make up the shape.
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
    """Blocks of rows, (rows, w, channels), one below the other."""
    import OpenImageIO as oiio

    height, width, channels = shape
    sample = "float" if dtype == np.float32 else str(dtype)
    sink = oiio.ImageOutput.create(str(file))
    spec = oiio.ImageSpec(width, height, channels, sample)
    spec.attribute("DateTime", "")  # equal pictures are equal files
    if names:
        spec.channelnames = tuple(names)
    for name, value in attributes.items():
        text = value.encode(errors="replace").decode() if isinstance(value, str) else value
        spec.attribute(name, text)
    if sink is None or not sink.open(str(file), spec):
        raise InputError(f"{file}: cannot be written ({_reason(oiio)}).")
    written, row = True, 0
    for block in blocks:
        pixels = np.ascontiguousarray(block, dtype)
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
        read = _read_by_openimageio(file)
    except InputError:
        return False
    return read.dtype == written.dtype and np.array_equal(read.reshape(written.shape), written)


_NOT_NUMPY = (ValueError, TypeError, OSError, EOFError, MemoryError, SyntaxError, TokenError)
# Sums do not agree; compression or encryption is of another kind.
_NOT_ARCHIVE = (BadZipFile, zlib.error, NotImplementedError, RuntimeError)


def _read_npy(file: Path) -> np.ndarray:
    try:
        return np.load(file, allow_pickle=False)
    except _NOT_NUMPY as error:
        raise InputError(f"{file}: not a NumPy array file ({_one_line(str(error))}).") from error


def read_arrays(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    """The arrays of a `.npz` file, which the library writes beside records and for chains.

    Args:
        path: the file.

    Returns:
        Arrays by name, in the order of the file; each is as it was written, or the file is refused.

    Raises:
        InputError: for a file that is damaged, or no archive of NumPy arrays.
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
    """The last error of OpenImageIO, or of one of its files, on one line."""
    try:
        words = _one_line(teller.geterror())
    except UnicodeDecodeError:  # it quotes the file
        return "it holds bytes that are not text where its format has text"
    return "of no format of images that is known" if "find a format reader" in words else words


def _one_line(message: str) -> str:
    words = " ".join(message.split()) or "no further detail"
    return words if len(words) <= LONGEST_REASON else f"{words[:LONGEST_REASON]} ..."
