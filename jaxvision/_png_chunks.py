"""Whether a PNG file is whole, before libpng reads it: that library prints its complaints itself.

A PNG is a signature and chunks: length, type, content and the CRC-32 of type and content (ISO/IEC
15948, section 5). Chunks whose type begins with a small letter are no part of the picture.
"""

import struct
import zlib
from pathlib import Path

SIGNATURE = b"\x89PNG\r\n\x1a\n"


def png_fault(file: Path) -> str | None:
    """What is wrong with the chunks of a file.

    Args:
        file: any; one without a PNG's signature has no fault.

    Returns:
        In words; None where all chunks of the picture are whole.
    """
    with file.open("rb") as stream:
        if stream.read(len(SIGNATURE)) != SIGNATURE:
            return None
        while len(head := stream.read(8)) == 8:
            size, kind = struct.unpack(">I4s", head)
            content, check = stream.read(size), stream.read(4)
            if len(check) < 4:
                break
            needed = kind[:1].isupper()
            if needed and zlib.crc32(content, zlib.crc32(kind)) != struct.unpack(">I", check)[0]:
                name = kind.decode() if kind.isalpha() else kind.hex()  # damaged, it is no text
                return f"the check sum of its chunk {name} is wrong"
            if kind == b"IEND":
                return None
    return "its last chunk is missing"
