"""Read Netpbm files: PBM, PGM and PPM, as text (P1 to P3) or binary (P4 to P6), and PFM.

Codes are returned as stored, from 0 to the largest code that the file states (`maxval`), which need
not be 255 or 65535. Sources: the manual pages pbm(5), pgm(5) and ppm(5) of Netpbm; pfm(5).
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core._warnings import warn
from ..errors import InputError
from ._plain_content import damaged

NETPBM_FORMATS = (".pgm", ".ppm", ".pbm", ".pnm", ".pfm")
_TOKEN = re.compile(rb"(?:\s|#[^\n\r]*[\n\r])*([^\s#]+)")
# end of a header that is longer than one white space
_ENDING = re.compile(rb"\r\n|[ \t]*#[^\n\r]*(?:\r\n|\r|\n)")
_CHANNELS = {b"P1": 1, b"P2": 1, b"P3": 3, b"P4": 1, b"P5": 1, b"P6": 3, b"PF": 3, b"Pf": 1}
_BITMAPS, _TEXTS, _FLOATS = (b"P1", b"P4"), (b"P1", b"P2", b"P3"), (b"PF", b"Pf")
_LONGEST_WORD = 32


@dataclass(frozen=True)
class NetpbmHead:
    """The header of a Netpbm file."""

    magic: bytes  # its first two letters
    columns: int  # of the picture
    rows: int  # of the picture
    largest: float  # largest code, 1 for a bitmap; for a PFM its scale
    start: int  # bytes before the samples

    @property
    def bits(self) -> int | None:
        """The number of bits of the largest code; None for floating-point samples."""
        return None if self.magic in _FLOATS else int(self.largest).bit_length()

    @property
    def saturation(self) -> float | None:
        """The largest code, if it is below 2^bits - 1; otherwise None."""
        return None if self.bits is None or self.largest == 2**self.bits - 1 else self.largest


def netpbm_head(file: Path, data: bytes | None = None) -> NetpbmHead:
    """Read the header of a Netpbm file or of its bytes; `InputError` for other files."""
    if data is None:
        with file.open("rb") as stream:
            data = stream.read(1 << 16)  # comments may be long
    magic = data[:2]
    if magic not in _CHANNELS or not re.match(rb"[\s#]", data[2:3]):
        first = data[:2] if magic not in _CHANNELS else data[:3]
        raise InputError(
            f"{file}: not a PGM, PPM, PBM or PFM file (it begins with {first!r}); export it again."
        )
    words, at = [], 2
    while len(words) < (2 if magic in _BITMAPS else 3):
        token = _TOKEN.match(data, at)
        if token is None or len(token[1]) > _LONGEST_WORD:
            raise damaged(file, "its head is no list of numbers")
        words.append(token[1])
        at = token.end()
    try:
        columns, rows = int(words[0]), int(words[1])
        largest = 1 if magic in _BITMAPS else float(words[2])
    except ValueError:
        raise damaged(file, "its head is no list of numbers") from None
    whole = largest == int(largest) and 1 <= largest <= 65535 if np.isfinite(largest) else False
    if magic in _FLOATS and not 0 < abs(largest) < np.inf:
        raise damaged(file, f"its scale is {largest:g}, whose sign should give the order of bytes")
    if columns < 1 or rows < 1 or not (whole or magic in _FLOATS):
        raise damaged(file, f"its head says {columns} x {rows} and a largest code {largest:g}")
    return NetpbmHead(magic, columns, rows, largest, at + 1)  # one white space ends the head


def read_netpbm(file: Path) -> np.ndarray:
    """Read the codes of a Netpbm file, (h, w) or (h, w, 3): uint8 or uint16, 1 for the white of a
    bitmap, float32 for a PFM. Raise `InputError` for a damaged file, or one of another format."""
    data = file.read_bytes()
    head = netpbm_head(file, data)
    channels = _CHANNELS[head.magic]
    count = head.columns * head.rows * channels
    if head.magic in _TEXTS:
        codes, rest = _text_samples(file, head, data[head.start - 1 :], count)
    else:
        codes, rest = _byte_samples(file, head, data, count)
    if rest.strip():
        warn(f"{file}: {len(rest)} bytes after its first picture are not used.")
    shape = (head.rows, head.columns, channels) if channels > 1 else (head.rows, head.columns)
    pixels = codes.reshape(shape)
    if head.magic in _FLOATS:
        if abs(head.largest) != 1:
            warn(
                f"{file}: its scale, {abs(head.largest):g}, is not used; the numbers are as stored."
            )
        return pixels[::-1].copy()
    if head.magic in _BITMAPS:
        return 1 - pixels
    if (top := int(pixels.max())) > head.largest:
        raise damaged(file, f"it holds {top}, above its largest code {head.largest:g}")
    return pixels


def _text_samples(
    file: Path, head: NetpbmHead, text: bytes, count: int
) -> tuple[np.ndarray, bytes]:
    plain = re.sub(rb"#[^\n\r]*", b"", text)
    if head.magic == b"P1":  # its digits need not be separated by spaces
        plain = b" ".join(re.findall(rb"\S", plain))
    words = plain.split(maxsplit=count)
    try:
        numbers = np.array([int(word) for word in words[:count]])
    except ValueError:
        raise damaged(file, "it holds words that are no numbers") from None
    if len(numbers) < count:
        raise damaged(file, f"it holds {len(numbers)} of {count} numbers")
    if numbers.min() < 0 or numbers.max() > head.largest:
        raise damaged(file, f"a number lies outside 0 to {head.largest:g}")
    return numbers.astype(_code_type(head)), b"".join(words[count:])


def _byte_samples(
    file: Path, head: NetpbmHead, data: bytes, count: int
) -> tuple[np.ndarray, bytes]:
    ending = _ENDING.match(data, head.start - 1)
    data = data[head.start :]
    if head.magic == b"P4":
        row = -(-head.columns // 8)
        size, kind = row * head.rows, np.dtype("u1")
    elif head.magic in _FLOATS:
        kind = np.dtype("<f4" if head.largest < 0 else ">f4")
        size = count * 4
    else:
        kind = np.dtype(_code_type(head)).newbyteorder(">")
        size = count * kind.itemsize
    data = data[_rest_of_head(file, ending, data, size) :]
    if len(data) < size:
        raise damaged(file, f"it holds {len(data)} of {size} bytes")
    if head.magic == b"P4":
        packed = np.frombuffer(data[:size], np.uint8).reshape(head.rows, -1)
        return np.unpackbits(packed, axis=1)[:, : head.columns].ravel(), data[size:]
    codes = np.frombuffer(data[:size], kind)
    return codes.astype(kind.newbyteorder("=")), data[size:]


def _rest_of_head(file: Path, ending: re.Match[bytes] | None, data: bytes, size: int) -> int:
    """Return the number of bytes of the header after the single white space that the format allows.
    A program may have written a line break of two characters, or a comment, after the last number.
    Whether these bytes belong to the header follows from the length of the file."""
    more = len(data) - size
    if ending is None or more <= 0:
        return 0
    length = len(ending[0]) - 1
    if more == length or data[length + size : length + size + 2] in _CHANNELS:
        return length
    raise damaged(file, f"its head ends in {ending[0]!r}, and its length fits no such head")


def _code_type(head: NetpbmHead) -> type:
    return np.uint8 if head.largest < 256 else np.uint16
