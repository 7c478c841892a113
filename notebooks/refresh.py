"""Execute notebooks in place, and shrink the pictures that they store.

    python notebooks/refresh.py [--shrink-only] [NOTEBOOK ...]

Without names all notebooks are executed, one after the other. A stored picture of more than its
share of 210 kB, which are 280 kB as text, becomes a JPEG. It needs the `notebooks` extra.
"""

import argparse
import base64
import io
import json
import subprocess
import sys
from pathlib import Path

from PIL import Image

HERE = Path(__file__).parent
TOGETHER = 210_000  # bytes of all pictures of a notebook, before base64
QUALITIES = (85, 75, 65)  # of a JPEG, tried before it becomes narrower
NARROWEST = 750  # pixels


def as_jpeg(png: bytes, most: int) -> bytes:
    """The picture as a JPEG of at most so many bytes: coarser first, then narrower by tenths."""
    picture = Image.open(io.BytesIO(png)).convert("RGB")
    width, height = picture.size
    while True:
        part = picture.resize((width, round(height * width / picture.width)), Image.LANCZOS)
        for quality in QUALITIES:
            found = io.BytesIO()
            part.save(found, "JPEG", quality=quality, optimize=True)
            if len(found.getvalue()) <= most:
                return found.getvalue()
        if 0.9 * width < NARROWEST:
            return found.getvalue()
        width = round(0.9 * width)


def shrink(notebook: Path) -> None:
    """Shrink every stored picture of a notebook in place."""
    content = json.loads(notebook.read_text(encoding="utf-8"))
    outputs = [output for cell in content["cells"] for output in cell.get("outputs", [])]
    shown = [output["data"] for output in outputs if "data" in output]
    most = TOGETHER // max(sum("image/png" in data for data in shown), 1)
    for data in shown:
        png = base64.b64decode("".join(data.get("image/png", "")))
        if len(png) > most:
            data["image/jpeg"] = base64.b64encode(as_jpeg(png, most)).decode()
            del data["image/png"]
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
