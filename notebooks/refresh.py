"""Execute notebooks in place, and shrink the pictures that they store.

    python notebooks/refresh.py [--shrink-only] [NOTEBOOK ...]

Without names the script executes all notebooks, one after the other. It stores plots as PNG with a
palette and other pictures as JPEG, so that the outputs of each notebook take at most 300 kB. It
needs the `notebooks` extra.
"""

import argparse
import base64
import io
import json
import subprocess
import sys
from pathlib import Path

from PIL import Image, ImageChops, ImageStat

HERE = Path(__file__).parent
TOGETHER = 296_500  # bytes of all outputs of a notebook
# quality and greatest width of a JPEG in pixels, tried in this order
STEPS = ((85, 1100), (75, 1000), (65, 900), (60, 800), (55, 750), (50, 700), (45, 650), (40, 600))
PALETTE_ERROR = 1.5  # greatest RMS error of a palette, codes of 255


def with_palette(picture: Image.Image) -> bytes | None:
    """Return the picture as a PNG with 64 or 256 colours. Return None if the palette changes the
    picture visibly, or if a JPEG is smaller."""
    for colours in (64, 256):
        indexed = picture.quantize(colours, dither=Image.Dither.NONE)
        difference = ImageStat.Stat(ImageChops.difference(picture, indexed.convert("RGB")))
        if max(difference.rms) <= PALETTE_ERROR:
            found = io.BytesIO()
            indexed.save(found, "PNG", optimize=True)
            small = found.getvalue()
            return small if len(small) <= len(as_jpeg(picture, *STEPS[3])) else None
    return None


def as_jpeg(picture: Image.Image, quality: int, widest: int) -> bytes:
    """Return the picture as a JPEG of the given quality and of at most `widest` pixels across."""
    narrow = picture.copy()
    narrow.thumbnail((widest, picture.height), Image.Resampling.LANCZOS)
    found = io.BytesIO()
    narrow.save(found, "JPEG", quality=quality, optimize=True)
    return found.getvalue()


def stored(data: bytes) -> dict[str, str]:
    """Return the bytes of a picture as an entry of a notebook's output, {MIME type: base64}."""
    kind = "image/png" if data.startswith(b"\x89PNG") else "image/jpeg"
    return {kind: base64.b64encode(data).decode()}


def shrink(notebook: Path) -> None:
    """Shrink the stored pictures of a notebook in place, until its outputs are small enough."""
    content = json.loads(notebook.read_text(encoding="utf-8"))
    outputs = [output for cell in content["cells"] for output in cell.get("outputs", [])]
    shown = [output["data"] for output in outputs if "data" in output]
    pictures = [data for data in shown if {"image/png", "image/jpeg"} & data.keys()]
    sources = [
        base64.b64decode("".join(data.pop("image/png", None) or data.pop("image/jpeg")))
        for data in pictures
    ]
    other = len(json.dumps(outputs))
    opened = [Image.open(io.BytesIO(source)).convert("RGB") for source in sources]
    plots = [with_palette(picture) for picture in opened]
    for step in STEPS:
        small = [
            min(source, plot or as_jpeg(picture, *step), key=len)
            for source, plot, picture in zip(sources, plots, opened, strict=True)
        ]
        if other + sum(4 * len(picture) // 3 for picture in small) <= TOGETHER:
            break
    for data, picture in zip(pictures, small, strict=True):
        data.update(stored(picture))
    text = json.dumps(content, indent=1, ensure_ascii=False)
    notebook.write_text(text + "\n", encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("notebooks", nargs="*", type=Path, default=sorted(HERE.glob("*.ipynb")))
    parser.add_argument("--shrink-only", action="store_true", help="execute nothing")
    given = parser.parse_args()
    for notebook in given.notebooks:
        print(notebook.name, flush=True)
        if not given.shrink_only:
            command = [sys.executable, "-m", "jupyter", "nbconvert", "--to", "notebook"]
            subprocess.run([*command, "--execute", "--inplace", str(notebook)], check=True)
        shrink(notebook)


if __name__ == "__main__":
    main()
