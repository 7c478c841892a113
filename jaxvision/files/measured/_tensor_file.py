"""Read and write tensor files, which store named arrays in one file.

The file begins with "tensor_file", a zero byte, the version 1.0 in two bytes, and the number of
fields as a little-endian uint32. Each field has the length of its name as uint16, the name, the
number of dimensions as uint16, the type as uint8, the offset of its data from the start of the file
as uint64, and its shape as a uint64 for each dimension. Source: the loader published with the RGL
database, rgl.epfl.ch/materials.
"""

import math
import struct
from pathlib import Path

import numpy as np

from ...errors import InputError

_MAGIC = b"tensor_file\0"
_VERSION = b"\1\0"
_TYPES = dict(
    enumerate(("u1", "i1", "<u2", "<i2", "<u4", "<i4", "<u8", "<i8", "<f2", "<f4", "<f8"), 1)
)
_MOST_DIMENSIONS = 8  # the database's fields have 5 at most


def fields_in(file: Path, data: bytes) -> dict[str, np.ndarray]:
    """Read the named arrays of a tensor file."""
    cut = InputError(f"{file}: the file is cut short; copy it again from its source.")
    if len(data) < 14 and (_MAGIC.startswith(data) or data.startswith(_MAGIC)):
        raise cut
    if data[:12] != _MAGIC:
        raise InputError(f"{file}: not an RGL tensor file; take the .bsdf file of the database.")
    if data[12:14] != _VERSION:
        raise InputError(
            f"{file}: tensor file version {tuple(data[12:14])} where 1.0 is known; take the "
            "published version of the file."
        )
    position = 14

    def take(layout: str) -> tuple[int, ...]:
        nonlocal position
        size = struct.calcsize("<" + layout)
        if position + size > len(data):
            raise cut
        numbers = struct.unpack_from("<" + layout, data, position)
        position += size
        return numbers

    (count,) = take("I")
    if count > 1000:
        raise InputError(
            f"{file}: {count} fields are announced; the bytes are in big-endian order or the file "
            "is damaged, copy it again from its source."
        )
    found = {}
    for _ in range(count):
        (length,) = take("H")
        name = bytes(take(f"{length}B")).decode("utf-8", "replace")
        shown = name[:40]
        dimensions, kind, offset = take("HBQ")
        if dimensions > _MOST_DIMENSIONS:
            raise InputError(
                f"{file}: field {shown!r} announces {dimensions} dimensions; the header is "
                "damaged, copy the file again from its source."
            )
        shape = take(f"{dimensions}Q")
        if kind not in _TYPES:
            raise InputError(f"{file}: field {shown!r} has the unknown type {kind}; copy it again.")
        dtype = np.dtype(_TYPES[kind])
        size = dtype.itemsize * math.prod(shape)
        # an axis of length 0 must not hide an absurd length of another axis
        if offset + size > len(data) or math.prod(max(n, 1) for n in shape) > len(data):
            raise cut
        found[name] = np.frombuffer(data[offset : offset + size], dtype).reshape(shape)
    return found


def tensor_file(arrays: dict[str, np.ndarray]) -> bytes:
    """Return the bytes of a tensor file, with the headers of all fields before their data."""
    kinds = {np.dtype(name): number for number, name in _TYPES.items()}
    offset = len(_MAGIC + _VERSION) + 4
    offset += sum(2 + len(name.encode()) + 11 + 8 * x.ndim for name, x in arrays.items())
    head, body = _MAGIC + _VERSION + struct.pack("<I", len(arrays)), b""
    for name, x in arrays.items():
        head += struct.pack("<H", len(name.encode())) + name.encode()
        head += struct.pack("<HBQ", x.ndim, kinds[x.dtype], offset + len(body))
        head += struct.pack(f"<{x.ndim}Q", *x.shape)
        body += x.tobytes()
    return head + body
