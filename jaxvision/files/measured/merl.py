"""Read and write MERL files (`.binary`), with isotropic reflectance in RGB.

The file begins with three little-endian int32, the numbers of bins n_h, n_d, n_p (90, 90, 180).
Then follow n_h n_d n_p float64 for each of red, green and blue, over the bins of
`brdf.half_difference`; phi_d is the fastest index and theta_h the slowest. The values times (1,
1.15, 1.66) / 1500, for red, green and blue, are f_r in sr^-1. Negative values mark bins that were
not measured or lie below the surface.

Source:
    The reader published with Matusik et al., "A Data-Driven Reflectance Model", 2003.
"""

import os
import struct
from pathlib import Path
from typing import Literal

import jax.numpy as jnp
import numpy as np

from ...brdf.half_difference import HalfDifferenceTable
from ...core._warnings import warn
from ...errors import InputError
from ..images import replaced_on_success
from ._contents import contents_of, representable

_PADDING_SHARE = 0.02  # share of zeros at the end of a colour, above which they are padding
DARKEST, BRIGHTEST = 5e-4, 1.5  # albedos of materials, with the errors of measured ones
OF_DATABASE = (90, 90, 180)  # bins of its files; tables of other sizes may hold anything
ANGLES = 90  # number of angles in the sum for the albedo
MERL_SCALE = np.array([1.0, 1.15, 1.66]) / 1500


def _nearest_valid(values: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Replace invalid bins, (bins..., bands), by the nearest valid; phi_d is periodic."""
    from scipy.ndimage import distance_transform_edt

    turn = valid.shape[2]
    tiled = np.concatenate([valid] * 3, axis=2)
    middle = np.s_[:, :, turn : 2 * turn]
    nearest = distance_transform_edt(~tiled, return_distances=False, return_indices=True)
    h, d, p = (index[middle] for index in np.asarray(nearest))
    return values[h, d, p % turn]


def read_merl(
    path: str | os.PathLike[str], *, invalid: Literal["nearest", "zero"] = "nearest"
) -> HalfDifferenceTable:
    """Read the BRDF table of a MERL file.

    Args:
        path: the file.
        invalid: value of bins marked as not measured. "nearest" uses the value of the nearest
            measured bin, so that interpolated values at the edge of the measured range are not too
            small; "zero" uses 0.

    Returns:
        The table of f_r in sr^-1.

    Raises:
        InputError: the file is missing or not of this format.
    """
    file, data = contents_of(path)
    if len(data) < 12:
        raise InputError(f"{file}: too short for a MERL file; copy it again from its source.")
    shape = struct.unpack("<3i", data[:12])
    swapped = struct.unpack(">3i", data[:12])
    if not all(0 < n <= 4096 for n in shape):
        if all(0 < n <= 4096 for n in swapped):
            raise InputError(
                f"{file}: the bytes are in big-endian order; swap them to the little-endian order "
                "of the MERL database."
            )
        raise InputError(
            f"{file}: the header gives {shape} bins, which is not a MERL file; take the .binary "
            "file of the MERL database."
        )
    if shape != OF_DATABASE and sorted(shape) == sorted(OF_DATABASE):
        warn(
            f"{file}: its head gives {shape} bins, where files of the MERL database have "
            f"{OF_DATABASE}; if its values are in the order of the database, all of them are at "
            "wrong angles: correct the head."
        )
    expected = 12 + 3 * 8 * int(np.prod(shape))
    if len(data) != expected:
        raise InputError(
            f"{file}: {len(data)} bytes where {shape} bins of three colours need {expected}; the "
            "file is cut short or damaged, copy it again from its source."
        )
    stored = np.frombuffer(data, "<f8", offset=12).reshape(3, *shape)
    if not (finite := representable(stored)).all():
        raise InputError(
            f"{file}: {np.count_nonzero(~finite)} values are not finite numbers; the file is "
            "damaged, copy it again from its source."
        )
    valid = np.asarray((stored >= 0).all(axis=0))
    if not valid.any():
        raise InputError(f"{file}: every bin is marked as not measured; take another file.")
    _name_padding(file, stored)
    values = np.moveaxis(stored, 0, -1) * MERL_SCALE
    if invalid == "nearest" and not valid.all():
        values = _nearest_valid(values, valid)
    else:
        values = np.where(valid[..., None], values, 0)
    if shape == OF_DATABASE:
        _name_implausible(file, values)
    return HalfDifferenceTable(jnp.asarray(values))


def _name_implausible(file: Path, values: np.ndarray) -> None:
    """Warn if a surface lit along its normal reflects more light than it receives, or no visible
    light. If wi is the normal, half and difference angle are both half the angle of wo."""
    angles = (np.arange(ANGLES) + 0.5) * (np.pi / 2 / ANGLES)
    share = angles / np.pi  # of 90 degrees
    half = (np.sqrt(share) * values.shape[0]).astype(int)
    seen = values[half, (share * values.shape[1]).astype(int)].mean(axis=1)
    weights = np.pi * np.sin(2 * angles) * (np.pi / 2 / ANGLES)
    albedo = float((weights @ seen).max())
    if not DARKEST <= albedo <= BRIGHTEST:
        warn(
            f"{file}: along the normal the surface reflects {100 * albedo:.2g} % of the light, "
            "which no material does. MERL files hold numbers that are multiplied by 1/1500 (red), "
            "1.15/1500 (green) and 1.66/1500 (blue); this one may be in another unit."
        )


def _name_padding(file: Path, stored: np.ndarray) -> None:
    """Warn if the bins of a colour end in zeros, as in a truncated file that was padded."""
    for colour, values in zip(("red", "green", "blue"), stored.reshape(3, -1), strict=True):
        ends = len(values) - 1 - int(np.max(np.flatnonzero(values), initial=-1))
        if _PADDING_SHARE * len(values) < ends < len(values):
            warn(
                f"{file}: {colour} ends in zeros, {ends / len(values):.0%} of its bins, as in a "
                "copy that was cut short; copy it again from its source."
            )


def write_merl(path: str | os.PathLike[str], table: HalfDifferenceTable) -> None:
    """Write a BRDF table as a MERL file, in which no bin is marked as unmeasured.

    Args:
        path: the file.
        table: f_r in sr^-1, three bands.

    Raises:
        InputError: the table has another number of bands.
    """
    *shape, bands = table.values.shape
    if bands != 3:
        raise InputError(f"{path}: a MERL file holds 3 bands, got {bands}; convert to RGB first.")
    stored = np.moveaxis(np.asarray(table.values, np.float64) / MERL_SCALE, -1, 0)
    with replaced_on_success(Path(path)) as partial:
        partial.write_bytes(struct.pack("<3i", *shape) + stored.astype("<f8").tobytes())
