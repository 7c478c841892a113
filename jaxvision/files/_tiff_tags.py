"""Read the tags of a TIFF file that the decoder (OpenImageIO) does not report. Sources: TIFF 6.0
(Adobe, 1992); BigTIFF; TIFF/EP (ISO 12234-2) for mosaics."""

import struct
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO

# the layout of a value, by the type of its tag
_LETTERS = {1: "B", 2: "B", 3: "H", 4: "I", 5: "II", 7: "B", 10: "ii", 13: "I", 16: "Q", 18: "Q"}
_QUOTIENTS = (5, 10)
SUBFILE, ROWS, COLUMNS, BITS, PHOTOMETRIC, COLOUR_MAP, SUB_IFDS = 254, 257, 256, 258, 262, 320, 330
ALPHA, MULTIPLIED = 338, 1  # kind of an extra channel: alpha by which colours are multiplied
GDAL_WORDS, GDAL_MISSING = 42112, 42113  # XML with scale and offset, among others; a number as text
TRANSFER, PRIMARIES = 301, 319  # a tone curve with a value a code; x, y of R, G and B
SAMPLE_FORMAT = 339  # 1: whole numbers without a sign, 3: floating numbers
BLACKS_SIZE, BLACKS, BLACKS_ALONG = 50713, 50714, (50715, 50716)  # of DNG: rows and columns; levels
CFA_SIZE, CFA_COLOURS = 33421, 33422
WHITE_IS_ZERO, PALETTE, INKS, MOSAIC = 0, 3, 5, 32803  # photometric interpretations
LIGHT = (0, 1, 2, 3, 4, 6, MOSAIC, 34892)  # grey, RGB, palettes, YCbCr, mosaics, linear raw
REDUCED, MASK = 1, 4  # bits of SUBFILE: a smaller copy, a mask of another picture
_MOST_VALUES = 3 << 16  # largest number of values in a tag, that of a colour map
_MOST_PICTURES = 1 << 16
_MOST_INNER = 64  # largest number of subdirectories of one picture


@dataclass(frozen=True)
class TiffPicture:
    """The tags of one picture in a TIFF file."""

    values: Mapping[int, tuple[Any, ...]] = field(default_factory=dict)  # numbers by tag
    # position of the first value of each tag, bytes from the beginning of the file
    places: Mapping[int, int] = field(default_factory=dict)
    # the pictures in its subdirectories (SubIFDs), which the decoder does not return
    inner: tuple["TiffPicture", ...] = ()

    def first(self, tag: int, otherwise: int = 0) -> Any:
        """Return the first value of a tag."""
        return next(iter(self.values.get(tag, ())), otherwise)

    def text(self, tag: int) -> str:
        """Return the text of a tag, without its terminator."""
        return bytes(self.values.get(tag, ())).split(b"\0")[0].decode("latin-1")

    @property
    def is_copy(self) -> bool:
        """Whether the picture is a smaller copy, or a mask, of another picture in the file."""
        return bool(self.first(SUBFILE) & (REDUCED | MASK))

    @property
    def pattern(self) -> str | None:
        """The phase of a Bayer mosaic, such as "RGGB"; None if the picture is not a 2 x 2 Bayer
        mosaic."""
        if self.first(PHOTOMETRIC) != MOSAIC or self.values.get(CFA_SIZE) != (2, 2):
            return None
        letters = "".join("RGB"[i] if i < 3 else "?" for i in self.values.get(CFA_COLOURS, ()))
        return letters if sorted(letters) == ["B", "G", "G", "R"] else None


def tiff_pictures(file: Path) -> list[TiffPicture]:
    """Read the tags of a TIFF's pictures and SubIFDs up to any damage; [] for other files."""
    with file.open("rb") as stream:
        head = stream.read(16)
        order = {b"II": "<", b"MM": ">"}.get(head[:2], "")
        version = struct.unpack(f"{order}H", head[2:4])[0] if order and len(head) >= 8 else 0
        if version not in (42, 43):
            return []
        layout = _Layout(order, big=version == 43)
        (here,) = layout.words(head[8:16] if layout.big else head[4:8])
        found: list[TiffPicture] = []
        seen: set[int] = set()
        with suppress(struct.error, OSError, OverflowError):
            while here and here not in seen and len(found) < _MOST_PICTURES:
                seen.add(here)
                picture, here = layout.directory(stream, here)
                inner = []
                with suppress(struct.error, OSError, OverflowError):
                    for at in picture.values.get(SUB_IFDS, ())[:_MOST_INNER]:
                        inner.append(layout.directory(stream, at)[0])
                found.append(replace(picture, inner=tuple(inner)))
        return found


@dataclass(frozen=True)
class _Layout:
    """The layout of a TIFF file: its byte order, and whether it has BigTIFF's 8-byte words."""

    order: str
    big: bool

    def words(self, data: bytes) -> tuple[int, ...]:
        return struct.unpack(f"{self.order}{'Q' if self.big else 'I'}", data)

    def directory(self, stream: BinaryIO, here: int) -> tuple[TiffPicture, int]:
        """Read the tags of the directory at an offset, and the offset of the next one."""
        word, count_letter, entry = ("Q", "Q", 20) if self.big else ("I", "H", 12)
        order, at = self.order, struct.calcsize(word)
        stream.seek(here)
        (count,) = struct.unpack(
            f"{order}{count_letter}", stream.read(struct.calcsize(count_letter))
        )
        entries = stream.read(entry * min(count, 4096))
        (following,) = self.words(stream.read(at))
        values, places = {}, {}
        for start in range(0, len(entries), entry):
            tag, kind = struct.unpack_from(f"{order}HH", entries, start)
            (number,) = struct.unpack_from(f"{order}{word}", entries, start + 4)
            if kind not in _LETTERS or not 0 < number <= _MOST_VALUES:
                continue
            values_of = struct.Struct(order + number * _LETTERS[kind])
            place = here + struct.calcsize(count_letter) + start + 4 + at
            if values_of.size > at:
                (place,) = struct.unpack_from(f"{order}{word}", entries, start + 4 + at)
            stream.seek(place)
            found = values_of.unpack(stream.read(values_of.size))
            if kind in _QUOTIENTS:
                above, below = found[::2], found[1::2]
                found = tuple(n / d if d else n for n, d in zip(above, below, strict=True))
            values[tag] = found
            places[tag] = place
        return TiffPicture(values, places), following
