"""Execute notebooks in place, and shrink the pictures that they store.

    python notebooks/refresh.py [--shrink-only] [NOTEBOOK ...]

Without names all notebooks are executed, one after the other. A stored picture of more than about
120 kB, or more than its share of 250 kB, becomes a JPEG. It needs the `notebooks` extra.
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
MOST = 120_000  # bytes of one stored picture, before base64
TOGETHER = 250_000  # bytes of all of a notebook, unless they become too narrow
NARROWEST = 800  # pixels


def as_jpeg(png: bytes, most: int) -> bytes:
    """The picture as a JPEG, narrower in steps of a tenth until it has at most so many bytes."""
    picture = Image.open(io.BytesIO(png)).convert("RGB")
    width, height = picture.size
    while True:
        found = io.BytesIO()
        part = picture.resize((width, round(height * width / picture.width)), Image.LANCZOS)
        part.save(found, "JPEG", quality=85, optimize=True)
        if len(found.getvalue()) <= most or width < NARROWEST / 0.9:
            return found.getvalue()
        width = round(0.9 * width)


def shrink(notebook: Path) -> None:
    """Shrink every stored picture of a notebook in place."""
    content = json.loads(notebook.read_text(encoding="utf-8"))
    outputs = [output for cell in content["cells"] for output in cell.get("outputs", [])]
    shown = [output["data"] for output in outputs if "data" in output]
    most = min(MOST, TOGETHER // max(sum("image/png" in data for data in shown), 1))
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
