"""Raw files, written byte by byte."""

import struct


def dng(codes, *, exif_apart=True, orientation=1, black=(64,), more=()):
    """Return a minimal DNG, byte by byte (Adobe's specification 1.4): one strip, a BGGR mosaic."""
    height, width = codes.shape
    extra, base = bytearray(), 4096

    def entry(tag, kind, values):
        form = {1: "B", 2: "s", 3: "H", 4: "I", 5: "II", 10: "ii"}[kind]
        if kind == 2:
            data, count = values.encode() + b"\0", len(values) + 1
        elif kind in (5, 10):
            data, count = b"".join(struct.pack("<" + form, *v) for v in values), len(values)
        else:
            data, count = struct.pack(f"<{len(values)}{form}", *values), len(values)
        if len(data) > 4:
            place = base + len(extra)
            extra.extend(data + b"\0" * (len(data) % 2))
            data = struct.pack("<I", place)
        return struct.pack("<HHI", tag, kind, count) + data.ljust(4, b"\0")

    def directory(entries):
        return struct.pack("<H", len(entries)) + b"".join(entries) + b"\0" * 4

    exif = [
        entry(33434, 5, [(1, 60)]),
        entry(33437, 5, [(28, 10)]),
        entry(34855, 3, [400]),
        entry(36867, 2, "2026:05:04 12:30:00"),
    ]
    identity = [(1, 1), (0, 1), (0, 1), (0, 1), (1, 1), (0, 1), (0, 1), (0, 1), (1, 1)]
    main = directory(
        [
            entry(254, 4, [0]),
            entry(256, 4, [width]),
            entry(257, 4, [height]),
            entry(258, 3, [16]),
            entry(259, 3, [1]),
            entry(262, 3, [32803]),
            entry(271, 2, "Maker"),
            entry(272, 2, "Model 3"),
            entry(273, 4, [8192]),
            entry(274, 3, [orientation]),
            entry(277, 3, [1]),
            entry(278, 4, [height]),
            entry(279, 4, [2 * codes.size]),
            entry(33421, 3, [2, 2]),
            entry(33422, 1, [2, 1, 1, 0]),
            *([entry(34665, 4, [1024])] if exif_apart else exif),
            entry(50706, 1, [1, 4, 0, 0]),
            entry(50708, 2, "Maker Model 3"),
            *([entry(50713, 3, [2, 2])] if len(black) == 4 else []),
            *([entry(50714, 3, black)] if black else []),
            entry(50717, 3, [4095]),
            entry(50721, 10, identity),
            entry(50778, 3, [21]),
            *(entry(*tag) for tag in more),
        ]
    )
    head = b"II" + struct.pack("<HI", 42, 8) + main
    whole = head.ljust(1024, b"\0") + directory(exif)
    whole = (whole.ljust(base, b"\0") + bytes(extra)).ljust(8192, b"\0")
    return whole + codes.astype("<u2").tobytes()
