"""Read and write Cornell goniometer files (`.brdf`), with spectral samples at scattered directions.

The files are text, and `#` starts a comment. First comes the number of wavelengths n, then the n
wavelengths in nm. Each sample is a row with theta_i phi_i theta_s phi_s in rad and n values of f_r
in sr^-1. The mirror direction lies at phi_s = phi_i + pi.

Source:
    Cornell Program of Computer Graphics.
"""

import os
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from ...brdf.measured import BRDFSamples
from ...core._warnings import warn
from ...errors import InputError
from ..images import replaced_on_success
from ._contents import LEAST_NANOMETRES, NANOMETRE, TURN, contents_of, representable

MANY = 100  # number of samples from which their median is checked
BRIGHTEST = 1.3  # largest reflectance, with the errors of measured ones
Row = tuple[int, list[float]]  # the number of its line, and its numbers


def read_cornell(path: str | os.PathLike[str]) -> BRDFSamples:
    """Read the samples of a Cornell goniometer file, in the order of the file.

    Args:
        path: the file.

    Returns:
        Samples of f_r in sr^-1, angles in rad, wavelengths in m.

    Raises:
        InputError: the file is missing or not of this format.
    """
    file, data = contents_of(path)
    rows = _rows_of_numbers(file, data)
    wavelengths = _take_wavelengths(file, rows)
    _check_samples(file, rows, bands=len(wavelengths))
    table = np.array([row for _, row in rows])
    theta_i, phi_i, theta_s, phi_s = jnp.asarray(table[:, :4].T)
    usual = float(np.median(table[:, 4:], axis=0).max())
    if len(table) >= MANY and usual * np.pi > BRIGHTEST:
        warn(
            f"{file}: half of its values are above {usual:.3g} sr^-1, with which a matte surface "
            f"reflects {usual * np.pi:.0%} of the light; radiance factors (pi f_r) or per cent are "
            "to be converted to f_r."
        )
    values, metres = jnp.asarray(table[:, 4:]), jnp.asarray(wavelengths) * NANOMETRE
    return BRDFSamples(theta_i, phi_i, theta_s, phi_s, values, metres)


def _rows_of_numbers(file: Path, data: bytes) -> list[Row]:
    """Return rows of numbers with their line numbers, without comments."""
    try:
        lines = data.decode("ascii").splitlines()
    except UnicodeDecodeError as error:
        raise InputError(
            f"{file}: not a text file (byte {error.start}); Cornell files are plain numbers."
        ) from None
    rows: list[Row] = []
    for number, line in enumerate(lines, 1):
        words = line.split("#")[0].split()
        try:
            numbers = [float(word) for word in words]
        except ValueError:
            raise InputError(
                f"{file}, line {number}: {' '.join(words)[:40]!r} is not a row of numbers; correct "
                "it or start it with #."
            ) from None
        if not representable(numbers).all():
            raise InputError(
                f"{file}, line {number}: a value is not a finite number; remove the row."
            )
        if numbers:
            rows.append((number, numbers))
    return rows


def _take_wavelengths(file: Path, rows: list[Row]) -> list[float]:
    """Remove the header from the rows, and return its wavelengths in nm."""
    if not rows or len(rows[0][1]) != 1 or rows[0][1][0] % 1 or rows[0][1][0] < 1:
        raise InputError(
            f"{file}: the first number must be the count of wavelengths, alone on its line; this "
            "is not a Cornell file."
        )
    bands, wavelengths = int(rows.pop(0)[1][0]), []
    while rows and len(wavelengths) < bands:
        wavelengths += rows.pop(0)[1]
    if len(wavelengths) != bands or (np.diff(wavelengths) <= 0).any() or wavelengths[0] <= 0:
        raise InputError(
            f"{file}: {bands} increasing wavelengths in nm are announced, got {len(wavelengths)} "
            f"numbers starting {wavelengths[:4]}; correct the header."
        )
    if wavelengths[-1] < LEAST_NANOMETRES:
        raise InputError(
            f"{file}: wavelengths up to {wavelengths[-1]:g} nm are X-rays; give them in nm, not in "
            "micrometres."
        )
    return wavelengths


def _check_samples(file: Path, rows: list[Row], *, bands: int) -> None:
    """Raise `InputError` for rows without four angles in rad and a value for each band."""
    if not rows:
        raise InputError(f"{file}: the header is followed by no samples; copy the file again.")
    for number, row in rows:
        if len(row) != 4 + bands:
            raise InputError(
                f"{file}, line {number}: {len(row)} columns where four angles and {bands} values "
                f"make {4 + bands}; the row is cut short or the header wrong."
            )
        if not (0 <= row[0] <= 1.5708 and 0 <= row[2] <= 1.5708):
            raise InputError(
                f"{file}, line {number}: elevations {row[0]:g} and {row[2]:g} must lie in "
                "[0, pi / 2] rad; convert degrees to radians."
            )
        if max(abs(row[1]), abs(row[3])) > TURN:
            raise InputError(
                f"{file}, line {number}: azimuths {row[1]:g} and {row[3]:g} must lie in "
                "[-2 pi, 2 pi] rad; convert degrees to radians."
            )


def write_cornell(
    path: str | os.PathLike[str], samples: BRDFSamples, *, description: str = ""
) -> None:
    """Write samples as a Cornell goniometer file, with 17 significant digits.

    Args:
        path: the file.
        samples: samples of f_r in sr^-1, with wavelengths.
        description: text for the comment at the beginning.

    Raises:
        InputError: the samples have no wavelengths.
    """
    if samples.wavelengths is None:
        raise InputError(
            f"{path}: the Cornell layout needs wavelengths, and these samples have none."
        )
    angles = (samples.theta_i, samples.phi_i, samples.theta_o, samples.phi_o)
    table = np.column_stack([*map(np.asarray, angles), np.asarray(samples.values)])
    wavelengths = np.asarray(samples.wavelengths, np.float64) / NANOMETRE
    head = [f"# {line}" for line in description.splitlines()]
    head += ["# num wls", f"{len(wavelengths)}", "", "# wls"]
    head += [" ".join(f"{x:.12g}" for x in wavelengths), ""]
    head += ["# theta i, phi i, theta s, phi_s, spectral sample values", ""]
    rows = [" ".join(f"{x:.17g}" for x in row) for row in table]
    with replaced_on_success(Path(path)) as partial:
        partial.write_text("\n".join(head + rows) + "\n")
