"""The chunks of a PNG file: whether they are whole, before libpng prints its own complaints, and
what they say that a decoder leaves out.

A PNG is a signature and chunks: length, type, content and the CRC-32 of type and content (ISO/IEC
15948, section 5). Chunks whose type begins with a small letter are no part of the picture.
"""

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

SIGNATURE = b"\x89PNG\r\n\x1a\n"
PALETTE = 3  # colour type
_KEPT = (b"IHDR", b"sBIT", b"acTL")  # of a few bytes each


@dataclass(frozen=True)
class PngChunks:
    """What the chunks of a file say.

    Attributes:
        fault: what is wrong with them, in words; None where all of the picture are whole.
        depth: bits of a sample as stored; of a palette's index for a palette.
        colour_type: of IHDR; 3 for a palette.
        significant: bits of each channel that the source had (sBIT); empty where it does not say.
        frames: pictures of an animation; 1 for a plain picture.
    """

    fault: str | None
    depth: int = 8
    colour_type: int = 0
    significant: tuple[int, ...] = ()
    frames: int = 1

    @property
    def bits(self) -> int:
        """Bits of the source's samples: those that are significant, where all channels agree."""
        if self.colour_type == PALETTE:
            return 8
        alike = len(set(self.significant)) == 1 and 0 < self.significant[0] <= self.depth
        return self.significant[0] if alike else self.depth


def png_chunks(file: Path, *, head: bool = False) -> PngChunks | None:
    """What the chunks of a file say, with `head` those before the picture alone, whether or not the
    picture is whole; None for a file without a PNG's signature."""
    kept: dict[bytes, bytes] = {}
    with file.open("rb") as stream:
        if stream.read(len(SIGNATURE)) != SIGNATURE:
            return None
        while len(start := stream.read(8)) == 8:
            size, kind = struct.unpack(">I4s", start)
            if head and kind == b"IDAT":
                return _said(kept)
            content, check = stream.read(size), stream.read(4)
            if len(check) < 4:
                break
            needed = kind[:1].isupper() or not kind.isalpha()
            if needed and zlib.crc32(content, zlib.crc32(kind)) != struct.unpack(">I", check)[0]:
                name = kind.decode() if kind.isalpha() else kind.hex()  # damaged, it is no text
                return PngChunks(f"the check sum of its chunk {name} is wrong")
            if kind in _KEPT:
                kept.setdefault(kind, content)
            if kind == b"IEND":
                return _said(kept)
    return PngChunks("its last chunk is missing")


def _said(kept: dict[bytes, bytes]) -> PngChunks:
    header, animation = kept.get(b"IHDR", b""), kept.get(b"acTL", b"")
    if len(header) != 13:
        return PngChunks("it does not begin with its size")
    frames = struct.unpack(">I", animation[:4])[0] if len(animation) == 8 else 1
    significant = tuple(kept.get(b"sBIT", b""))
    return PngChunks(None, header[8], header[9], significant, max(frames, 1))
