"""Contents of a JPEG file besides its picture. Sources: ITU-T T.81, annex B; CIPA DC-007
(Multi-Picture Format); ISO 21496-1 and Adobe's gain maps."""

import struct
from collections.abc import Iterator
from pathlib import Path

_SMALLER_COPIES = (0x010001, 0x010002)  # kinds of a Multi-Picture Format entry
_PICTURE_LIST, _ENTRY = 0xB002, 16
_END = 0xD9  # of the picture


def jpeg_extras(file: Path) -> list[str]:
    """What of a JPEG is no part of the picture and no note about it: further pictures, gain maps
    and bytes after its end (a film, say), each in words."""
    data = file.read_bytes()
    found, pictures, listed, rest = [], 0, False, b""
    for kind, content in _segments(data):
        if kind == 0xE2 and content[:4] == b"MPF\0":
            pictures += _further_pictures(content[4:])
            listed = True
        if kind == _END:
            rest = content.strip(b"\0\xff")
        gain_map = kind == 0xE2 and content.startswith(b"urn:iso:std:iso:ts:21496:-1\0")
        if gain_map or (kind == 0xE1 and b"hdrgm:Version" in content):
            found.append("its gain map, by which a screen of high dynamic range brightens it")
    if pictures:
        found.append(f"{pictures} further picture{'s' if pictures > 1 else ''} after the first")
    if rest and not listed:
        found.append(f"{len(rest)} bytes after its picture")
    return list(dict.fromkeys(found))


def _segments(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Kind and content of the segments, those between scans too; of the end, what follows it."""
    at = 2
    while 0 <= (at := data.find(b"\xff", at)) < len(data) - 1:
        kind = data[at + 1]
        if kind == _END:
            yield kind, data[at + 2 :]
            return
        if kind == 0xFF:  # a fill byte
            at += 1
        elif kind == 0 or 0xD0 <= kind <= 0xD7:  # within a scan
            at += 2
        else:
            size = int.from_bytes(data[at + 2 : at + 4], "big")
            yield kind, data[at + 4 : at + 2 + size]
            at += 2 + max(size, 2)


def _further_pictures(index: bytes) -> int:
    """How many pictures a Multi-Picture index lists beside the first and smaller copies of it."""
    order = {b"II": "<", b"MM": ">"}.get(index[:2])
    if order is None:
        return 0
    try:
        (at,) = struct.unpack_from(f"{order}I", index, 4)
        (count,) = struct.unpack_from(f"{order}H", index, at)
        for i in range(count):
            tag, _, size, place = struct.unpack_from(f"{order}HHII", index, at + 2 + 12 * i)
            if tag == _PICTURE_LIST:
                kinds = [
                    struct.unpack_from(f"{order}I", index, place + start)[0] & 0xFFFFFF
                    for start in range(_ENTRY, size, _ENTRY)
                ]
                return sum(kind not in _SMALLER_COPIES for kind in kinds)
    except struct.error:
        pass
    return 0
