"""Make small valid folders for the commands, and damage them."""

import shutil
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import tomli_w
from oracles import sphere_photographs, stacks
from photographs import photograph
from studies import write_camera

from jaxvision.files.images import read_image, write_image

from .damage import damaged

TIMES = (0.002, 0.01, 0.05, 0.25)  # s
SIZE, RADIUS = 40, 17.0


def flats(folder: Path) -> None:
    write_camera(folder, seed=1, levels=6, side=24)


def stack(folder: Path) -> None:
    folder.mkdir()
    rng = np.random.default_rng(2)
    _, codes = stacks.exposure_stack(
        stacks.gamma(2.2), np.array(TIMES) / 0.05, rng, pixels=3 * 1024
    )
    for number, frame in enumerate(codes):
        write_image(folder / f"{number}.png", frame.reshape(32, 32, 3).astype(np.uint8))
    shots = [{"file": f"{number}.png", "exposure": time} for number, time in enumerate(TIMES)]
    rig = {"camera": {"bits": 8}, "exposure": shots}
    (folder / "rig.toml").write_text(tomli_w.dumps(rig))


def ball(folder: Path) -> None:
    folder.mkdir()
    rng = np.random.default_rng(3)
    lights = sphere_photographs.light_directions(10)
    normals = sphere_photographs.sphere_normals(SIZE, RADIUS)
    shade = sphere_photographs.shade(normals, lights, "phong", 0.5, 0.3, 20.0)
    frames = [
        sphere_photographs.expose(
            rng, 3000 * picture, gain=0.25, read_noise=3.0, black=60.0, clip=4095
        )
        for picture in shade
    ]
    camera = {"bits": 12, "black_level": 60.0, "gain": 0.25, "read_noise": 3.0}
    sphere_photographs.write_rig(
        folder, np.stack(frames), lights, [3000.0], radius=RADIUS, camera=camera
    )


def photographs(folder: Path) -> None:
    """Write photographs without a rig, whose headers contain what `init` needs."""
    folder.mkdir()
    for number, time in enumerate(TIMES):
        photograph(folder / f"{number}.jpg", seconds=time, code=60 * number)


FOLDERS: dict[str, Callable[[Path], None]] = {
    "flats": flats,
    "stack": stack,
    "ball": ball,
    "photographs": photographs,
}


def copied(sound: Path, to: Path, number: int) -> Path:
    """Return a copy of the folder after a change, mostly to its rig, or to one of its images. It is
    unchanged for -1."""
    shutil.rmtree(to, ignore_errors=True)
    shutil.copytree(sound, to)
    if number < 0:
        return to
    rng = np.random.default_rng([zlib.crc32(sound.name.encode()), number])
    rig = to / "rig.toml"
    images = sorted(file for file in to.iterdir() if file != rig)
    if rig.exists() and rng.uniform() < 0.6:
        rig.write_bytes(damaged(rig.read_bytes(), rng, text=True, most=2))
        return to
    file, other = rng.choice(images, 2, replace=False)
    if rng.uniform() < 0.3:
        file.write_bytes(damaged(file.read_bytes(), rng, text=False))
    elif file.suffix != ".jpg" and rng.uniform() < 0.7:
        write_image(file, odd(read_image(file), rng))
    else:
        shutil.copy(other, file)
    return to


def odd(pixels: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return pixels of the same type that no camera takes."""
    most = np.iinfo(pixels.dtype).max
    brighter = np.clip(pixels * 10 ** rng.uniform(-2, 2), 0, most).astype(pixels.dtype)
    changes = (
        np.full_like(pixels, rng.choice((0, 1, 255, most))),
        rng.integers(0, int(pixels.max()) + 1, pixels.shape, pixels.dtype),
        brighter,
        pixels[::-1].copy(),
        np.where(rng.uniform(size=pixels.shape) < 0.3, pixels.max(), pixels),
        np.where(rng.uniform(size=pixels.shape) < 0.3, pixels.min(), pixels),
        pixels[: rng.integers(1, len(pixels))],
    )
    return changes[rng.integers(len(changes))]
