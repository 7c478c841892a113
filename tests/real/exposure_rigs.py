"""The published exposure stacks as folders for the commands, without copies of the images."""

import json
import re
from pathlib import Path

CAMERA = "[camera]\nbits = 8\n"


def write_memorial_rig(data_folder: Path, folder: Path) -> Path:
    """Write a rig for Debevec & Malik's memorial church (1997), 16 exposures."""
    root = data_folder / "hdr_memorial"
    lines = (root / "memorial.hdr_image_list.txt").read_text().splitlines()
    entries = [line.split() for line in lines if line.startswith("memorial")]
    stack = [
        _exposure(name.replace(".ppm", ".png"), 1 / float(shutter)) for name, shutter, *_ in entries
    ]
    return _write(folder, root, CAMERA, stack)


def write_bandpass_rig(data_folder: Path, folder: Path, *, bands: tuple[str, ...] = ()) -> Path:
    """Write a rig for Llanos' linear GBRG stacks, with band and shutter time from the file
    names."""
    root = data_folder / "llanos_bandpass"
    stack = []
    for file in sorted((root / "color_checker").glob("*.tif")):
        found = re.search(r"_(\d+nm)_(\d+)ms_", file.name)
        assert found is not None
        band, milliseconds = found.groups()
        if not bands or band in bands:
            stack.append(_exposure(f"color_checker/{file.name}", float(milliseconds) / 1e3, band))
    darks: dict[float, list[str]] = {}
    for file in sorted((root / "dark_frames").glob("d2_*.tif")):
        found = re.search(r"_(\d+)ms_", file.name)
        assert found is not None
        darks.setdefault(float(found[1]) / 1e3, []).append(f"dark_frames/{file.name}")
    dark = [
        f"[[dark]]\nfiles = {json.dumps(files)}\nexposure = {t}\n" for t, files in darks.items()
    ]
    return _write(folder, root, CAMERA + 'pattern = "GBRG"\n', stack + dark)


def _exposure(file: str, seconds: float, group: str = "") -> str:
    return f'[[exposure]]\nfile = "{file}"\nexposure = {seconds}\ngroup = "{group}"\n'


def _write(folder: Path, root: Path, camera: str, entries: list[str]) -> Path:
    (folder / "rig.toml").write_text(f'root = "{root}"\n\n{camera}\n' + "\n".join(entries))
    return folder
