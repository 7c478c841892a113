"""Bits of a colour in a TGA file. Source: Truevision, TGA File Format Specification 2.0, page 6."""

from pathlib import Path

_GREY = (3, 11)  # image types
_PALETTES = (1, 9)


def targa_bits(file: Path) -> int:
    """Bits of each colour of a TGA: 5 for pixels, or colours of a palette, of 15 or 16 bits; else
    8."""
    with file.open("rb") as stream:
        head = stream.read(18)
    if len(head) < 18 or head[2] in _GREY:
        return 8
    whole = head[7] if head[2] in _PALETTES else head[16]
    return 5 if whole in (15, 16) else 8
