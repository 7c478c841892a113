"""Common parts of the readers: the bytes of a file, and the units of files."""

import os
from collections.abc import Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from ...errors import InputError
from .._plain_content import file_at

NANOMETRE = 1e-9
LEAST_NANOMETRES = 10.0  # shorter wavelengths are X-rays
TURN = 6.2832  # rad, 2 pi rounded up to the digits in files


def representable(values: np.ndarray | Sequence[float]) -> np.ndarray:
    """Mask of the values, in any unit, that are finite in JAX's default dtype, as records need."""
    with np.errstate(over="ignore"):
        return np.isfinite(np.asarray(values).astype(jnp.result_type(float)))


def contents_of(path: str | os.PathLike[str]) -> tuple[Path, bytes]:
    """The path and the bytes of a file; `InputError` if there is none."""
    file = Path(path)
    if file.is_dir():
        raise InputError(f"{file}: is a folder; name the file in it.")
    return file, file_at(file).read_bytes()
