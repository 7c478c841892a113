"""Image files: 8- and 16-bit PNG and TIFF, EXR and Radiance HDR, NumPy arrays. The edge of the
library: eager, NumPy in and out, through OpenImageIO, which is loaded on first use.

Arrays are (h, w) or (h, w, channels). Integer files keep their bit depth (uint8, uint16), floating
files come as float32. Every failure is an `InputError` of one sentence.
"""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from .errors import InputError

INTEGER_FORMATS = (".png", ".tif", ".tiff")
FLOAT_FORMATS = (".exr", ".hdr")
_DTYPES = {"uint8": np.uint8, "uint16": np.uint16, "half": np.float32, "float": np.float32}


@contextmanager
def replaced_on_success(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` that replaces it only when the block ends without error, so
    that nothing half-written is ever left under the final name."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=".partial-", suffix=path.suffix)
    os.close(handle)
    partial = Path(name)
    try:
        yield partial
        partial.chmod(0o644)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def read_image(path: str | os.PathLike[str]) -> np.ndarray:
    """Pixels of an image file as stored: (h, w) for one channel, else (h, w, channels).

    PNG and TIFF give uint8 or uint16, EXR and HDR float32, `.npy` its array. `InputError` for a
    missing, unreadable or truncated file and for a sample type outside these.
    """
    file = Path(path)
    if not file.is_file():
        raise InputError(f"{file}: no such image file; check the name and the folder.")
    if file.suffix.lower() == ".npy":
        return _read_npy(file)
    import OpenImageIO as oiio

    as_stored = oiio.ImageSpec()
    as_stored.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(str(file), as_stored)
    if source is None:
        raise InputError(
            f"{file}: not readable as an image ({_one_line(oiio.geterror())}); "
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
            raise InputError(
                f"{file}: the file is damaged or cut short ({_one_line(source.geterror())}); "
                "copy it again from its source."
            )
    finally:
        source.close()
    pixels = np.asarray(pixels, _DTYPES[sample]).reshape(spec.height, spec.width, spec.nchannels)
    return pixels[..., 0] if spec.nchannels == 1 else pixels


def read_environment(path: str | os.PathLike[str]) -> np.ndarray:
    """A latitude-longitude picture of radiance from an EXR or HDR file: (h, w, bands) float32, for
    `environment_map`; an alpha channel is left out.

    `InputError` for a file that `read_image` refuses, for integer samples (a display picture holds
    no radiance), for a picture that is not twice as wide as high, and for values that are negative
    or not finite.
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


def write_image(path: str | os.PathLike[str], pixels: np.ndarray) -> None:
    """Writes (h, w) or (h, w, channels) pixels; the suffix chooses the format.

    uint8 and uint16 go to PNG or TIFF at their own depth, floating arrays to EXR or HDR (HDR:
    three channels, shared exponent, about 1 % steps). The file appears only when complete, and an
    integer file is read back to prove that its depth survived. `InputError` otherwise.
    """
    file, array = Path(path), np.ascontiguousarray(pixels)
    suffix = file.suffix.lower()
    floating = np.issubdtype(array.dtype, np.floating)
    if array.ndim not in (2, 3) or 0 in array.shape:
        raise InputError(f"{file}: an image is (h, w) or (h, w, channels), got {array.shape}.")
    if suffix not in INTEGER_FORMATS + FLOAT_FORMATS:
        known = ", ".join(INTEGER_FORMATS + FLOAT_FORMATS)
        raise InputError(f"{file}: unknown image suffix {suffix!r}; use one of {known}.")
    if floating != (suffix in FLOAT_FORMATS) or not (
        floating or array.dtype in (np.uint8, np.uint16)
    ):
        raise InputError(
            f"{file}: {array.dtype} pixels do not fit {suffix}; uint8 and uint16 go to PNG or "
            "TIFF, floating point to EXR or HDR."
        )
    if suffix == ".hdr" and (array.ndim != 3 or array.shape[2] != 3):
        raise InputError(f"{file}: Radiance HDR holds three channels, got {array.shape}.")
    with replaced_on_success(file) as partial:
        _write(partial, array.astype(np.float32) if floating else array)
        if not floating and not _same_pixels(read_image(partial), array):
            raise InputError(f"{file}: what was written does not read back; is the disk full?")


def _write(file: Path, array: np.ndarray) -> None:
    import OpenImageIO as oiio

    height, width, channels = array.shape if array.ndim == 3 else (*array.shape, 1)
    sample = "float" if array.dtype == np.float32 else str(array.dtype)
    sink = oiio.ImageOutput.create(str(file))
    spec = oiio.ImageSpec(width, height, channels, sample)
    spec.attribute("oiio:UnassociatedAlpha", 1)
    if sink is None or not sink.open(str(file), spec):
        raise InputError(f"{file}: cannot be written ({_one_line(oiio.geterror())}).")
    written = sink.write_image(array.reshape(height, width, channels))
    message = sink.geterror()
    if not (sink.close() and written):
        raise InputError(f"{file}: cannot be written ({_one_line(message)}).")


def _same_pixels(read: np.ndarray, written: np.ndarray) -> bool:
    return read.dtype == written.dtype and np.array_equal(read.reshape(written.shape), written)


def _read_npy(file: Path) -> np.ndarray:
    try:
        return np.load(file, allow_pickle=False)
    except (ValueError, OSError, EOFError) as error:
        raise InputError(f"{file}: not a NumPy array file ({_one_line(str(error))}).") from error


def _one_line(message: str) -> str:
    return " ".join(message.split()) or "no further detail"
