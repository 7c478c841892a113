"""Store the chains of a sampler in blocks. Each block is written when it is complete, so that a
killed run loses at most one block.

A block is a record of arrays: the draws, the state from which the next block continues, and a hash
of everything that determines the chain. Blocks end at whole multiples of their size, so a resumed
run gives bit-identical results to an uninterrupted one.
"""

import hashlib
import re
from collections.abc import Callable, Hashable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from jaxvision.errors import InputError
from jaxvision.files.images import read_arrays, replaced_on_success

from .on_host import to_host

Progress = Callable[[int, int], None]
Block = dict[str, np.ndarray]


def resume_blocks(
    folder: Path | str | None, before: Sequence[Block], fingerprint: str
) -> list[Block]:
    """Return the blocks from which a run continues: those in memory or those in the checkpoint
    folder (None for no folder), whichever are more. Blocks that the folder lacks are written to it.
    """
    stored = [] if folder is None else _read_blocks(Path(folder))
    other = "the chain of another run (other data, density, seed, settings or package versions)"
    if not _have_fingerprint(stored, fingerprint):
        raise InputError(
            f"{folder}: holds {other}; delete that folder or choose another output folder."
        )
    if not _have_fingerprint(before, fingerprint):
        raise InputError(f"The posterior to go on from is {other}; leave it out to start anew.")
    for i in range(len(stored), len(before)):
        store(folder, i, before[i])
    return list(max(stored, before, key=len))


def store(folder: Path | str | None, index: int, block: Block) -> None:
    """Write one block atomically; a folder of None writes nothing."""
    if folder is None:
        return
    file = _place(folder, index)
    with replaced_on_success(file) as partial, partial.open("wb") as stream:
        np.savez(stream, **block)  # type: ignore[arg-type]


def _read_blocks(folder: Path) -> list[Block]:
    """Read the blocks of a folder; raise if one is missing or incomplete."""
    found: list[Block] = []
    for file in sorted(folder.glob("block-*.npz")):
        due = _place(folder, len(found))
        rest = "delete {} behind it, and the chain goes on from there."
        if file != due:
            raise InputError(f"{due}: missing; {rest.format('the blocks')}")
        try:
            block = read_arrays(file)
        except InputError as error:
            raise InputError(f"{file}: a damaged block; {rest.format('it and those')}") from error
        if not {"chain", "fingerprint"} <= block.keys():
            raise InputError(f"{file}: a damaged block; {rest.format('it and those')}")
        found.append(block)
    return found


def _place(folder: Path | str, index: int) -> Path:
    return Path(folder) / f"block-{index:05d}.npz"


def length(blocks: Sequence[Block]) -> int:
    """Return the number of steps in all blocks."""
    return sum(len(block["chain"]) for block in blocks)


def next_length(done: int, size: int, ceiling: int) -> int:
    """Return the number of steps up to the next multiple of the block size, or to the last step."""
    return min(size - done % size, ceiling - done)


def stack_blocks(blocks: Sequence[Block], name: str) -> np.ndarray:
    """Concatenate one array of all blocks along their steps."""
    return np.concatenate([block[name] for block in blocks])


def _have_fingerprint(blocks: Sequence[Block], fingerprint: str) -> bool:
    return all(str(block["fingerprint"]) == fingerprint for block in blocks)


ADDRESS = re.compile(r"0x[0-9a-f]+")  # memory address of an object
PACKAGES = ("jax", "numpy", "scipy")


def fingerprint(
    log_density: Callable[[Float[Array, " parameters"], Any], Float[Array, ""]],
    mode: Float[Array, " parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
    args: Any,
    *settings: Hashable,
    package: str,
) -> str:
    """Return a hash of a density with its data, of the start of a sampler, and of its settings.

    The density enters with its name, the text of its jaxpr and the constants that it closes over.
    Two formulas of the same name therefore give different hashes."""
    closed = eqx.filter_make_jaxpr(log_density)(mode, args)[0]
    name = getattr(log_density, "__module__", ""), getattr(log_density, "__qualname__", "")
    packages = [f"{known} {version(known)}" for known in (package, *PACKAGES)]
    digest = hashlib.sha256()
    digest.update(ADDRESS.sub("", repr((settings, packages, name, str(closed)))).encode())
    for leaf in jax.tree.leaves((mode, covariance, args, closed.consts)):
        digest.update(to_host(leaf).tobytes() if eqx.is_array_like(leaf) else b"static")
    return digest.hexdigest()
