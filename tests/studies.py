"""Folders of simulated camera pictures, written with NumPy alone."""

import numpy as np
import tomli_w

from jaxvision.files.images import write_image


def write_camera(folder, *, seed, gain=0.25, read_noise=3.0, levels=8, side=48, **camera):
    """Write pairs of flats and darks of a 12-bit camera, with a rig file that lists them."""
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True)
    rig = {"camera": {"bits": 12, **camera}, "flat": [], "dark": []}
    for number, photons in enumerate(np.linspace(500, 13_000, levels)):
        exposure = 0.01 * (number + 1)
        for kind, light in (("flat", 0.6 * photons), ("dark", 0.0)):
            files = [f"{kind}_{number}_{k}.png" for k in range(2)]
            for name in files:
                electrons = rng.poisson(light, (side, side)) + 2.0 * exposure
                electrons = electrons + read_noise * rng.standard_normal((side, side))
                codes = np.clip(np.round(gain * electrons + 20), 0, 4095)
                write_image(folder / name, codes.astype(np.uint16))
            more = {"photons": float(photons)} if kind == "flat" else {}
            rig[kind].append({"files": files, "exposure": exposure, **more})
    (folder / "rig.toml").write_text(tomli_w.dumps(rig))
    return folder
