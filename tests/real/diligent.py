"""The published DiLiGenT ball (Shi et al., CVPR 2016) as a folder for the commands."""

from pathlib import Path

import numpy as np

from jaxvision.files.images import write_image


def write_ball_rig(data_folder: Path, folder: Path, *, lights: slice = slice(None)) -> Path:
    """Write 16-bit PNGs, normals, mask and rig.toml, with every fourth light held out."""
    ball = np.load(data_folder / "diligent_ball" / "ball.npz")
    np.save(folder / "normals.npy", ball["normals"])
    write_image(folder / "mask.png", 255 * ball["mask"].astype(np.uint8))
    entries = []
    for i in range(len(ball["images"]))[lights]:
        write_image(folder / f"light_{i:02d}.png", ball["images"][i])
        direction, intensity = (
            ball[name][i].tolist() for name in ("light_directions", "light_intensities")
        )
        entries.append(
            f'[[light]]\nfile = "light_{i:02d}.png"\ndirection = {direction}\n'
            f"intensity = {intensity}\nheld_out = {str(i % 4 == 3).lower()}\n"
        )
    (folder / "rig.toml").write_text(
        "[camera]\nbits = 16\nblack_level = 0.0\n\n"
        '[geometry]\nnormals = "normals.npy"\nmask = "mask.png"\n\n' + "\n".join(entries)
    )
    return folder
