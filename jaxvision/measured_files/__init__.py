"""Files of measured reflectance: MERL, Cornell goniometer, RGL. The edge of the library: eager.

The layout of each format stands in its module. Every failure is an `InputError` of one sentence
that names the file.
"""

import os
from pathlib import Path

from ..brdf.half_difference import HalfDifferenceTable
from ..brdf.measured import BRDFSamples
from ..brdf.rgl import RGL
from ..errors import InputError
from .cornell import read_cornell, write_cornell
from .merl import read_merl, write_merl
from .rgl import read_rgl, write_rgl
from .scattered import table_of_samples

__all__ = [
    "read_cornell",
    "read_measured",
    "read_merl",
    "read_rgl",
    "table_of_samples",
    "write_cornell",
    "write_merl",
    "write_rgl",
]


def read_measured(path: str | os.PathLike[str]) -> HalfDifferenceTable | BRDFSamples | RGL:
    """What a file of measured reflectance holds, its format taken from the suffix: `.binary`
    (MERL), `.brdf` (Cornell) or `.bsdf` (RGL)."""
    readers = {".binary": read_merl, ".brdf": read_cornell, ".bsdf": read_rgl}
    suffix = Path(path).suffix.lower()
    if suffix not in readers:
        raise InputError(
            f"{path}: the suffix {suffix!r} is none of {', '.join(readers)}; rename the file to "
            "that of its format (MERL, Cornell, RGL)."
        )
    return readers[suffix](path)
