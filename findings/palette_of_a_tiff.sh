#!/usr/bin/env bash
# A palette picture that Pillow writes as TIFF, its colours 0 to 255, comes back one too dark from
# OpenImageIO. Needs Python 3.11 and a package index. Versions: OpenImageIO 3.2.2.0, pillow 13.0.0,
# numpy 2.4.
#
# Expected: white, stored as white, is read as 255, since both libraries are exact for RGB.
# Happens: a TIFF's palette holds numbers of 16 bits (TIFF 6.0, ColorMap). Pillow writes 256 times
# the colour, so that white is 65280, not 65535; OpenImageIO divides by 257 and drops the rest: 254.
# Every colour but black is one too dark (1 becomes 0). Pillow reads its own file right. A palette of
# true 16 bits loses its lower 8 bits in both, without a word.
# Source of what is right: Adobe, TIFF Revision 6.0 (1992), ColorMap: 0 is the least and 65535 the
# largest intensity, so that white should be 65535; a reader that finds only multiples of 256 can
# tell which way its writer took.
# Exits with 0 while that holds.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install -q --disable-pip-version-check \
    OpenImageIO==3.2.2.0 pillow==13.0.0 'numpy>=2.4,<2.5'
cd "$folder"
"$folder/env/bin/python" - <<'PYTHON'
import numpy as np
import OpenImageIO as oiio
from PIL import Image

colours = np.arange(256, dtype=np.uint8)
picture = Image.fromarray(colours[None]).convert("P")
picture.putpalette(np.repeat(colours, 3).tolist())
picture.save("palette.tif")
by_pillow = np.asarray(Image.open("palette.tif").convert("RGB"))[0, :, 0]
source = oiio.ImageInput.open("palette.tif")
by_openimageio = source.read_image("uint8")[0, :, 0]
print("colours written:", colours[[0, 1, 2, 128, 255]].tolist())
print("read by Pillow:", by_pillow[[0, 1, 2, 128, 255]].tolist())
print("read by OpenImageIO:", by_openimageio[[0, 1, 2, 128, 255]].tolist())
darker = np.maximum(colours.astype(int) - 1, 0)
raise SystemExit(not ((by_pillow == colours).all() and (by_openimageio == darker).all()))
PYTHON
