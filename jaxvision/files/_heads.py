"""Read metadata and chunks of image files that image decoders ignore. Also check that a PNG file is
complete, because libpng prints messages of its own for an incomplete file.

A PNG file is a signature and chunks. Each chunk has a length, a type, content, and the CRC-32 of
type and content (ISO/IEC 15948, section 5). A chunk whose type begins with a lower-case letter is
not needed to decode the picture. Sources for JPEG: ITU-T T.81, annex B; CIPA DC-007 (Multi-Picture
Format); ISO 21496-1 and Adobe's gain maps. Source for TGA: Truevision, TGA File Format
Specification 2.0, page 6.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

SIGNATURE = b"\x89PNG\r\n\x1a\n"
PALETTE = 3  # colour type
_CHUNKS = b"IHDR sBIT acTL pCAL sCAL gAMA cHRM cICP sRGB".split()  # chunks of a few bytes each


@dataclass(frozen=True)
class PngChunks:
    """The metadata in the chunks of a PNG file."""

    fault: str | None  # description of the damage; None if all chunks of the picture are complete
    depth: int = 8  # bits of a sample as stored; of a palette's index for a palette
    colour_type: int = 0  # colour type in IHDR; 3 for a palette
    # significant bits of each channel (sBIT); empty if not stated
    significant: tuple[int, ...] = ()
    frames: int = 1  # pictures of an animation; 1 for a plain picture
    # descriptions of chunks that define the meaning of its numbers or pixels
    scales: tuple[str, ...] = ()

    @property
    def bits(self) -> int:
        """The significant bits per sample of the image from which the file was made."""
        if self.colour_type == PALETTE:
            return 8
        alike = len(set(self.significant)) == 1 and 0 < self.significant[0] <= self.depth
        return self.significant[0] if alike else self.depth


def png_chunks(file: Path, *, head: bool = False) -> PngChunks | None:
    """Read the chunks of a PNG file. With `head`, only the chunks before the picture are read, even
    if the rest of the file is missing. Return None for a file that does not begin with the
    signature of PNG."""
    kept: dict[bytes, bytes] = {}
    with file.open("rb") as stream:
        if stream.read(len(SIGNATURE)) != SIGNATURE:
            return None
        while len(start := stream.read(8)) == 8:
            size, kind = struct.unpack(">I4s", start)
            if head and kind == b"IDAT":
                return _read_chunks(kept)
            content, check = stream.read(size), stream.read(4)
            if len(check) < 4:
                break
            needed = kind[:1].isupper() or not kind.isalpha()
            if needed and zlib.crc32(content, zlib.crc32(kind)) != struct.unpack(">I", check)[0]:
                # a damaged name may not be text
                name = kind.decode() if kind.isalpha() else kind.hex()
                return PngChunks(f"the check sum of its chunk {name} is wrong")
            if kind in _CHUNKS:
                kept.setdefault(kind, content)
            if kind == b"IEND":
                return _read_chunks(kept)
    return PngChunks("its last chunk is missing")


def _read_chunks(kept: dict[bytes, bytes]) -> PngChunks:
    header, animation = kept.get(b"IHDR", b""), kept.get(b"acTL", b"")
    if len(header) != 13:
        return PngChunks("it does not begin with its size")
    frames = struct.unpack(">I", animation[:4])[0] if len(animation) == 8 else 1
    significant = tuple(kept.get(b"sBIT", b""))
    return PngChunks(None, header[8], header[9], significant, max(frames, 1), tuple(_scales(kept)))


def _scales(kept: dict[bytes, bytes]) -> Iterator[str]:
    """Describe each chunk that gives the codes or pixels of a PNG another meaning than sRGB."""
    name, _, rest = kept.get(b"pCAL", b"").partition(b"\0")
    if len(rest) > 10:
        low, high, law = struct.unpack(">iiB", rest[:9])
        unit, *numbers = (word.decode("latin-1") for word in rest[10:].split(b"\0"))
        in_unit = f" in {unit}" if unit else ""
        yield (
            f"its calibration {name.decode('latin-1')!r}{in_unit} (pCAL: codes {low} to {high}, "
            f"law {law} of {' '.join(numbers)}): codes are as stored"
        )
    size = kept.get(b"sCAL", b"")
    if size[:1] in (b"\1", b"\2"):
        unit = "m" if size[:1] == b"\1" else "rad"
        sides = " x ".join(size[1:].decode("latin-1").split("\0"))
        yield f"the size of its pixels, {sides} {unit} (sCAL)"
    gamma = int.from_bytes(kept.get(b"gAMA", b""), "big") / 1e5
    if gamma and b"sRGB" not in kept and not 0.44 < gamma < 0.47:
        yield f"its exponent of {gamma:g} (gAMA): codes are as stored"
    code = kept.get(b"cICP", b"")
    if len(code) == 4 and code[1] not in (1, 6, 13, 14, 15):
        curve = {8: "linear", 16: "PQ", 18: "HLG"}.get(code[1], f"number {code[1]}")
        yield f"its transfer curve (cICP: {curve}): codes are as stored"
    if not kept[b"IHDR"][9] & 2:  # grey
        return
    if len(code) == 4 and code[0] != 1:
        spaces = {9: "Rec. 2020", 11: "DCI-P3", 12: "Display P3"}
        yield f"its primaries (cICP: {spaces.get(code[0], f'number {code[0]}')})"
    places = kept.get(b"cHRM", b"")
    if len(places) == 32 and b"sRGB" not in kept and len(code) != 4:
        stated = np.frombuffer(places, ">u4") / 1e5
        if np.abs(stated - _SRGB).max() > 0.01:
            listed = ", ".join(f"{x:.4g}" for x in stated)
            yield f"its white and primaries ({listed}; cHRM)"


# x, y of white, red, green and blue; XYZ of the primaries under D50, as profiles store them
_SRGB = (0.3127, 0.3290, 0.64, 0.33, 0.30, 0.60, 0.15, 0.06)
_SRGB_D50 = {
    b"rXYZ": (0.4361, 0.2225, 0.0139),
    b"gXYZ": (0.3851, 0.7169, 0.0971),
    b"bXYZ": (0.1431, 0.0606, 0.7141),
}
HALF, OFF = 0.2140, 0.03  # light of half the largest sRGB code, and deviation that is named


def icc_differences(profile: bytes, name: str) -> list[str]:
    """Describe how primaries and tone curve of an ICC profile (ICC.1:2022) differ from sRGB.

    Profiles that consist of tables are ignored.
    """
    tags: dict[bytes, bytes] = {}
    count = int.from_bytes(profile[128:132], "big")
    for i in range(min(count, (len(profile) - 132) // 12)):
        tag, start, size = struct.unpack(">4sII", profile[132 + 12 * i : 144 + 12 * i])
        tags[tag] = profile[start : start + size]
    found, called = [], f"ICC profile{f' {name!r}' if name else ''}"
    places = {tag: tags[tag] for tag in _SRGB_D50 if len(tags.get(tag, b"")) >= 20}
    off = [
        np.abs(np.frombuffer(place, ">i4", 3, 8) / 65536 - _SRGB_D50[tag]).max()
        for tag, place in places.items()
    ]
    if max(off, default=0.0) > OFF:
        found.append(f"its primaries ({called}): colours are as stored")
    half = _light_of_half(tags.get(b"gTRC", tags.get(b"kTRC", b"")))
    if half is not None and abs(half - HALF) > OFF:
        found.append(
            f"its tone curve ({called}: half of the largest code is {half:.2g} of the light, "
            f"where sRGB has {HALF:.2g}): codes are as stored"
        )
    return found


def _light_of_half(curve: bytes) -> float | None:
    """Return the relative light that the tone curve of an ICC profile gives for half of the largest
    code; None if the profile has no curve."""
    kind, count = curve[:4], int.from_bytes(curve[8:12], "big")
    if kind == b"para" and len(curve) >= 16:
        numbers = np.frombuffer(curve, ">i4", (len(curve) - 12) // 4, 12) / 65536
        slope, offset = numbers[1:3] if curve[8:10] != b"\0\0" and numbers.size > 2 else (1.0, 0.0)
        return float(max(slope * 0.5 + offset, 0.0) ** numbers[0])
    if kind != b"curv" or len(curve) < 12:
        return None
    values = np.frombuffer(curve, ">u2", min(count, (len(curve) - 12) // 2), 12)
    if values.size < 2:  # an exponent, or a straight line
        return float(0.5 ** (values[0] / 256)) if values.size else 0.5
    return float(np.interp(0.5, np.linspace(0, 1, values.size), values / 65535))


_SMALLER_COPIES = (0x010001, 0x010002)  # kinds of entries of the Multi-Picture Format
_PICTURE_LIST, _ENTRY = 0xB002, 16
_END = 0xD9  # marker of the end of the picture


def jpeg_extras(file: Path) -> list[str]:
    """Describe further pictures, gain maps, and bytes after the end of the picture in a JPEG
    file.
    """
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
    """Yield the type and the content of each JPEG segment; the end marker's content is the rest."""
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
    """Count the pictures in a Multi-Picture index after the first, without smaller copies."""
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


_GREY = (3, 11)  # image types
_PALETTES = (1, 9)


def targa_bits(file: Path) -> int:
    """Return the bits of each colour of a TGA file: 5 for 15- or 16-bit pixels, else 8."""
    with file.open("rb") as stream:
        head = stream.read(18)
    if len(head) < 18 or head[2] in _GREY:
        return 8
    whole = head[7] if head[2] in _PALETTES else head[16]
    return 5 if whole in (15, 16) else 8
