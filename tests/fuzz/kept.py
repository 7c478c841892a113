"""Files that the library stores for itself: draws next to a record, tiles and sums of a render, and
blocks of a chain. `sound(folder)` returns their contents, and the other functions read a damaged
one."""

import io
from pathlib import Path

import jax
import numpy as np

import jaxvision
from fitting.inference.blocks import resume_blocks
from jaxvision.files.materials import read_material, write_material
from jaxvision.render_command.tiles import PartialImage, PartialSum

KEY = {"scene": "ball", "samples": 4}
VALUES, SHAPE = 12, (2, 3)
MATERIAL = jaxvision.Phong([0.2, 0.1], [0.3, 0.3], 9.0)


def archive(**arrays):
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def draws(file: Path) -> object:
    write_material(MATERIAL, file.with_suffix(".toml"))
    return read_material(file.with_suffix(".toml"), draws=3)


def tiles(file: Path) -> object:
    with PartialImage(file, key=KEY, values=VALUES, fresh=False) as kept:
        return [kept.tile(number) for number in range(kept.done)]


def passes(file: Path) -> object:
    kept = PartialSum(file, key=KEY, shape=SHAPE, fresh=False)
    return kept.total / max(kept.done, 1)


def chain(file: Path) -> object:
    folder = file.parent / "chain"
    folder.mkdir(exist_ok=True)
    (folder / "block-00000.npz").write_bytes(file.read_bytes())
    return [block["chain"] for block in resume_blocks(folder, (), "this run")]


def sound(folder: Path) -> dict[str, bytes]:
    """Return the contents by the name of the function that reads them."""
    rng = np.random.default_rng(4)
    with PartialImage(folder / "a.partial", key=KEY, values=VALUES, fresh=True) as kept:
        for _ in range(3):
            kept.append(rng.uniform(size=VALUES).astype(np.float32))
    total = PartialSum(folder / "b.partial", key=KEY, shape=SHAPE, fresh=True)
    total.add(rng.uniform(size=SHAPE))
    several = jax.tree.map(lambda x: np.asarray(x) * rng.uniform(0.5, 1, (5, *x.shape)), MATERIAL)
    write_material(MATERIAL, folder / "c.toml", draws=several)
    return {
        "draws": (folder / "c.npz").read_bytes(),
        "tiles": (folder / "a.partial").read_bytes(),
        "passes": (folder / "b.partial").read_bytes(),
        "chain": archive(chain=rng.normal(size=(4, 6, 2)), fingerprint=np.array("this run")),
    }
