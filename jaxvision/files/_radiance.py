"""Read Radiance pictures (`.hdr`), which have three 8-bit mantissas and a shared exponent for each
pixel.

A mantissa m and an exponent e represent (m + 1/2) 2^(e - 136), as in Radiance itself. This value is
the middle of the quantisation step, because programs round down when they write. A pixel with the
exponent 0 is black. EXPOSURE and COLORCORR are factors that were applied to the stored pixels, so
the pixels are divided by these factors. Source: Ward, "Radiance File Formats", and `color.c` of
Radiance.
"""

import re
from pathlib import Path

import numpy as np

from ..core._warnings import warn
from ..errors import InputError
from ._plain_content import damaged

_SIZE = re.compile(rb"([+-])([XY]) (\d+) ([+-])([XY]) (\d+)$")
_BIAS = 128 + 8  # bias of the exponent, for a mantissa below 256
END_OF_RANGE = 2.0**127  # exponents of values from here on need more than 8 bits
_LONGEST_HEAD = 1 << 16
_MAX_PIXELS = 1 << 30  # pixels


def is_radiance(file: Path) -> bool:
    """Return whether a file begins with the bytes of a Radiance picture."""
    with file.open("rb") as stream:
        return stream.read(2) == b"#?"


def read_radiance(file: Path) -> np.ndarray:
    """Read a Radiance picture, (h, w, 3) float32 in W m^-2 sr^-1 or relative, with its first row at
    the top. Raise `InputError` for a file that is damaged, incomplete or not Radiance, and for XYZ
    colours."""
    data = file.read_bytes()
    lines, at = _head(file, data)
    if b"FORMAT=32-bit_rle_xyze" in lines:
        raise InputError(
            f"{file}: holds CIE XYZ, not RGB; convert it, with Radiance by `ra_xyze -r`."
        )
    end = data.find(b"\n", at, at + 200)
    size = _SIZE.match(data[at:end].strip()) if end >= 0 else None
    if size is None or size[2] == size[5]:
        raise damaged(file, "its head gives no size")
    first, second = int(size[3]), int(size[6])
    if not 0 < first * second <= _MAX_PIXELS:
        raise damaged(file, f"its head gives a size of {first} x {second}")
    stored = _scanlines(file, data[end + 1 :], first, second)
    exponent = stored[..., 3].astype(np.int32)
    step = np.where(exponent > 0, np.ldexp(np.float64(1), exponent - _BIAS), 0)
    pixels = (stored[..., :3] + 0.5) * step[..., None] / _exposure_factors(file, lines)
    if size[1] == (b"+" if size[2] == b"Y" else b"-"):
        pixels = pixels[::-1]
    if size[4] == (b"+" if size[5] == b"Y" else b"-"):
        pixels = pixels[:, ::-1]
    if size[2] == b"X":  # columns, one after the other
        pixels = pixels.swapaxes(0, 1)
    return np.ascontiguousarray(pixels, np.float32)


def _head(file: Path, data: bytes) -> tuple[list[bytes], int]:
    """Return the lines of the header and the position of its end."""
    if data[:2] != b"#?":
        raise InputError(
            f"{file}: not readable as an image (it does not begin as Radiance's); export it again "
            "as HDR or EXR."
        )
    blank = re.search(rb"\n\r?\n", data[:_LONGEST_HEAD])
    if blank is None:
        raise damaged(file, "its head does not end")
    return [line.strip() for line in data[: blank.start()].split(b"\n")], blank.end()


def _exposure_factors(file: Path, lines: list[bytes]) -> np.ndarray:
    """Return the factors, (3,), by which the radiance was multiplied before it was stored."""
    whole = np.ones(3)
    aspect = 1.0
    for line in lines:
        name, _, words = line.partition(b"=")
        if name not in (b"EXPOSURE", b"COLORCORR", b"PIXASPECT", b"PRIMARIES"):
            continue
        try:
            numbers = np.array([float(word) for word in words.split()])
        except ValueError:
            numbers = np.empty(0)
        wanted = {b"COLORCORR": 3, b"PRIMARIES": 8}.get(name, 1)
        positive = name == b"PRIMARIES" or (numbers > 0).all()
        if len(numbers) != wanted or not np.isfinite(numbers).all() or not positive:
            raise damaged(file, f"{name.decode()} in its head is not {wanted} numbers above 0")
        if name == b"PIXASPECT":
            aspect *= numbers[0]
        elif name == b"PRIMARIES":
            warn(
                f"{file}: its primaries ({words.decode().strip()}) are not used; colours are as "
                "stored."
            )
        else:
            whole = whole * numbers
    if aspect != 1:
        warn(f"{file}: its pixels are not square (PIXASPECT {aspect:g}), which is not used.")
    return whole


def _scanlines(file: Path, data: bytes, rows: int, width: int) -> np.ndarray:
    """Unpack the scanlines to bytes, (rows, width, 4)."""
    mark = bytes((2, 2, width >> 8, width & 255))
    if not 8 <= width < 1 << 15 or data[:4] != mark:
        return _pixel_sequence(file, data, rows * width).reshape(rows, width, 4)
    found = np.empty((rows, 4, width), np.uint8)
    at = 0
    for row in range(rows):
        if data[at : at + 4] != mark:
            raise damaged(file, f"its row {row} does not begin as the others")
        at += 4
        for channel in range(4):
            line = bytearray()
            while len(line) < width:
                if at + 1 >= len(data):
                    raise damaged(file, f"it ends in row {row} of {rows}")
                count = data[at]
                if count > 128:
                    line += data[at + 1 : at + 2] * (count - 128)
                    at += 2
                else:
                    line += data[at + 1 : at + 1 + count]
                    at += 1 + count
                if not count:
                    break
            if len(line) != width:
                raise damaged(file, f"its row {row} is not {width} pixels wide")
            found[row, channel] = np.frombuffer(line, np.uint8)
    return found.swapaxes(1, 2)


def _pixel_sequence(file: Path, data: bytes, count: int) -> np.ndarray:
    """Unpack single pixels, (count, 4), some of which repeat the previous one."""
    pixels = np.frombuffer(data[: len(data) // 4 * 4], np.uint8).reshape(-1, 4)
    repeats = np.flatnonzero((pixels[:count, :3] == 1).all(axis=1))
    if not len(repeats):
        found = pixels
    else:
        pieces, length, start, shift = [], 0, 0, 0
        repeats = np.flatnonzero((pixels[:, :3] == 1).all(axis=1))
        for i in repeats:
            if i > start:
                pieces.append(pixels[start:i])
                length += i - start
                shift = 0
            times = int(pixels[i, 3]) << shift
            if not pieces or length + times > count:
                raise damaged(file, "it repeats pixels that are not there")
            if times:
                pieces.append(np.repeat(pieces[-1][-1:], times, axis=0))
            length += times
            shift += 8
            start = i + 1
            if length >= count:
                break
        pieces.append(pixels[start:])
        found = np.concatenate(pieces)
    if len(found) < count:
        raise damaged(file, f"it holds {len(found)} of {count} pixels")
    return found[:count]
