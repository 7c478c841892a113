"""Detection of exposure times that a camera rounded for display: 1/60 for 1/64, 1/125 for 1/128.

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
    """Exact times in whole, half or third stops that match these displayed times."""
    for parts in STOPS:
        exact = 2.0 ** (np.round(parts * np.log2(times)) / parts)
        off = np.abs(exact / times - 1).max()
        if ROUNDED < off < PRINTED and len(np.unique(exact)) == len(np.unique(times)):
            yield exact


def worst_in_words(times: Float[np.ndarray, " n"], exact: Float[np.ndarray, " n"]) -> str:
    """Return the exact and the printed time with the largest difference."""
    worst = int(np.argmax(np.abs(exact / times - 1)))
    return f"{_fraction(exact[worst])} s for {_fraction(times[worst])} s"


def _fraction(seconds: float) -> str:
    """Return a time as on a camera dial."""
    if seconds >= 0.5:
        return f"{seconds:.4g}"
    return str(Fraction(1, round(1 / seconds)))
