#!/usr/bin/env bash
# One TIFF of 12-bit samples, codes 0, 1, 100, 2048 and 4095, packed by hand (TIFF 6.0, page 17), is
# read in three ways, and white-is-zero is reversed or not by depth. Needs Python 3.11 and a package
# index. Versions: OpenImageIO 3.2.2.0, opencv-python-headless 5.0.0.93, pillow 13.0.0, numpy 2.4.
#
# Expected: every reader gives 0, 1, 100, 2048, 4095, or says that it has changed them; and a reader
# that reverses PhotometricInterpretation 0 (WhiteIsZero) at one depth reverses it at all.
# Happens: OpenImageIO stretches the codes to 16 bits by 65535 / 4095 (0, 16, 1600, 32775, 65535);
# OpenCV shifts them (0, 16, 1600, 32768, 65520); Pillow keeps them. OpenImageIO and OpenCV reverse
# WhiteIsZero at 8 bits and not at 12. None prints a word.
# Source of what is right: Adobe, TIFF Revision 6.0 (1992), BitsPerSample and
# PhotometricInterpretation.
# Exits with 0 while all of that holds.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install -q --disable-pip-version-check \
    OpenImageIO==3.2.2.0 opencv-python-headless==5.0.0.93 pillow==13.0.0 'numpy>=2.4,<2.5'
cd "$folder"
"$folder/env/bin/python" - <<'PYTHON'
import struct

import cv2
import numpy as np
import OpenImageIO as oiio
from PIL import Image


def write(path, codes, bits, photometric):
    digits = "".join(format(code, f"0{bits}b") for code in codes)
    digits += "0" * (-len(digits) % 8)
    data = int(digits, 2).to_bytes(len(digits) // 8, "big")
    tags = [(256, len(codes)), (257, 1), (258, bits), (259, 1), (262, photometric), (273, 8)]
    tags += [(277, 1), (278, 1), (279, len(data)), (284, 1), (339, 1)]
    data += b"\0" * (len(data) % 2)
    head = b"II" + struct.pack("<HI", 42, 8 + len(data))
    table = b"".join(struct.pack("<HHII", tag, 4 if tag in (273, 279) else 3, 1, v) for tag, v in tags)
    table = struct.pack("<H", len(tags)) + table + struct.pack("<I", 0)
    with open(path, "wb") as stream:
        stream.write(head + data + table)


codes = [0, 1, 100, 2048, 4095]
write("black.tif", codes, 12, 1)
write("white.tif", codes, 12, 0)
write("white8.tif", [0, 1, 100, 255], 8, 0)


def by_openimageio(path):
    source = oiio.ImageInput.open(path)
    return source.read_image(source.spec().format).ravel().tolist()


read = {
    "OpenImageIO": by_openimageio,
    "OpenCV": lambda path: cv2.imread(path, cv2.IMREAD_UNCHANGED).ravel().tolist(),
    "Pillow": lambda path: np.asarray(Image.open(path)).ravel().tolist(),
}
found = {name: reader("black.tif") for name, reader in read.items()}
found |= {f"{name}, white is zero, 12 bits": read[name]("white.tif") for name in list(read)[:2]}
found |= {f"{name}, white is zero, 8 bits": reader("white8.tif") for name, reader in read.items()}
stretched, shifted, reversed_ = [0, 16, 1600, 32775, 65535], [0, 16, 1600, 32768, 65520], [255, 254, 155, 0]
known = {
    "OpenImageIO": stretched,
    "OpenCV": shifted,
    "Pillow": codes,
    "OpenImageIO, white is zero, 12 bits": stretched,
    "OpenCV, white is zero, 12 bits": shifted,
    **{f"{name}, white is zero, 8 bits": reversed_ for name in read},
}
print("codes in the file:", codes)
for name, values in found.items():
    print(f"{name}: {values}" + ("" if values == known[name] else f", where {known[name]} was known"))
raise SystemExit(found != known)
PYTHON
