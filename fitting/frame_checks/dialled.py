"""Detection of exposure times that a camera rounded for display, such as 1/60 s for 1/64 s.

Shutters use whole, half or third stops, 2^(k / 3) s, so displayed times have errors of up to 7 %.
"""

from collections.abc import Iterator
from fractions import Fraction

import numpy as np
from jaxtyping import Float

STOPS = (1, 2, 3)  # steps per stop on camera dials
PRINTED = 0.08  # largest relative error of a printed time
ROUNDED = 0.01  # least relative error of the worst time of a series that counts as rounded
LESS = 1 / 3  # largest share of the scatter that may remain with exact times


def exact_times(times: Float[np.ndarray, " n"]) -> Iterator[Float[np.ndarray, " n"]]:
    """Yield exact times in whole, half and third stops whose rounded values these times may be."""
    for parts in STOPS:
        exact = 2.0 ** (np.round(parts * np.log2(times)) / parts)
        off = np.abs(exact / times - 1).max()
        if ROUNDED < off < PRINTED and len(np.unique(exact)) == len(np.unique(times)):
            yield exact


def worst_in_words(times: Float[np.ndarray, " n"], exact: Float[np.ndarray, " n"]) -> str:
    """Name the exact and the displayed time that differ most, for a sentence."""
    worst = int(np.argmax(np.abs(exact / times - 1)))
    return f"{_fraction(exact[worst])} s for {_fraction(times[worst])} s"


def _fraction(seconds: float) -> str:
    """Write a time as on a camera dial: 1/60, or 2."""
    if seconds >= 0.5:
        return f"{seconds:.4g}"
    return str(Fraction(1, round(1 / seconds)))
