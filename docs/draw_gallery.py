"""Draw each picture of the gallery next to its script: `python docs/draw_gallery.py [NAME ...]`."""

import runpy
import sys
from pathlib import Path

import matplotlib

matplotlib.use("agg")
import jax
import matplotlib.pyplot as plt
from PIL import Image

GALLERY = Path(__file__).parent / "gallery"
FINE = 200  # dots per inch of figures without pixels of their own
INK = "#767b83"  # legible on white and on near black, on which a transparent figure may lie
LEVELS = [round(round(value * 127 / 255) * 255 / 127) for value in range(256)]  # 128 of 256
STYLE = {
    **dict.fromkeys(
        ("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color"), INK
    ),
    "savefig.transparent": True,
    "legend.frameon": False,
    "figure.figsize": (4.4, 3.3),
    "figure.dpi": 100,
    "figure.constrained_layout.use": True,
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
}


def draw(script: Path, folder: Path) -> Path:
    """Run one script and write its figure to a folder, as a PNG named after the script."""
    with jax.enable_x64(False), plt.rc_context(STYLE):  # as a user starts
        runpy.run_path(str(script))
        picture = folder / f"{script.stem}.png"
        has_pixels = any(axes.images for axes in plt.gcf().axes)
        dots = STYLE["figure.dpi"] if has_pixels else FINE
        plt.savefig(picture, metadata={"Software": None}, dpi=dots)
        plt.close("all")
    image = Image.open(picture)
    if has_pixels:
        image = image.point(LEVELS * len(image.getbands()))
    else:  # lines need few colours
        image = image.quantize(256, method=Image.Quantize.FASTOCTREE)
    image.save(picture, optimize=True)
    return picture


if __name__ == "__main__":
    for script in sorted(GALLERY.glob("*.py")):
        if not sys.argv[1:] or script.stem in sys.argv[1:]:
            print(draw(script, GALLERY))
