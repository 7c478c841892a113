"""Read the bytes of files of measured reflectance, and define their units."""

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
    """Return a mask of the values that are finite in JAX's default dtype."""
    with np.errstate(over="ignore"):
        return np.isfinite(np.asarray(values).astype(jnp.result_type(float)))


def contents_of(path: str | os.PathLike[str]) -> tuple[Path, bytes]:
    """Return the path and the bytes of a file; `InputError` if there is no such file."""
    file = Path(path)
    if file.is_dir():
        raise InputError(f"{file}: is a folder; name the file in it.")
    return file, file_at(file).read_bytes()
