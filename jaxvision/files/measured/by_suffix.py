"""Choose the reader for a file of measured reflectance by its suffix."""

import os
from pathlib import Path

from ...brdf.half_difference import HalfDifferenceTable
from ...brdf.measured import BRDFSamples
from ...brdf.rgl import RGL
from ...errors import InputError
from .cornell import read_cornell
from .merl import read_merl
from .rgl import read_rgl


def read_measured(path: str | os.PathLike[str]) -> HalfDifferenceTable | BRDFSamples | RGL:
    """Read a file of measured reflectance, in the format of its suffix.

    Args:
        path: a file ending in `.binary` (MERL), `.brdf` (Cornell) or `.bsdf` (RGL).

    Returns:
        A table, scattered samples or an RGL material, with values in sr^-1.

    Raises:
        InputError: for an unknown suffix, or a file that does not have the format of its suffix.

    Example:
        >>> from tempfile import mkdtemp
        >>> file = mkdtemp() + "/paint.brdf"
        >>> samples = jv.BRDFSamples([0.1], [0], [0.1], [np.pi], [[0.25]], [550e-9])
        >>> jv.files.write_cornell(file, samples)
        >>> print(jv.read_measured(file).values)
        [[0.25]]
    """
    readers = {".binary": read_merl, ".brdf": read_cornell, ".bsdf": read_rgl}
    suffix = Path(path).suffix.lower()
    if suffix not in readers:
        raise InputError(
            f"{path}: the suffix {suffix!r} is not one of {', '.join(readers)}; rename the file to "
            "that of its format (MERL, Cornell, RGL)."
        )
    return readers[suffix](path)
