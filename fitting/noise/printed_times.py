"""Detection of exposure times that a camera rounded for display. They make the light seem to
scatter between levels.
"""

import numpy as np
from jaxtyping import Float, Int

from ..frame_checks.dialled import LESS, exact_times, worst_in_words
from .levels import PhotonTransfer

FEWEST_LEVELS = 6


def printed_times(
    measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"]
) -> dict[str, str | float] | None:
    """The numbers of the finding on rounded exposure times; None if they are exact."""
    times = np.asarray(measurement.bright.exposure)[usable]
    dark = np.asarray(measurement.dark.mean)[np.asarray(measurement.dark_of)[usable]]
    signal = np.asarray(measurement.bright.mean)[usable] - dark
    if measurement.photons_known or len(times) < FEWEST_LEVELS or np.any(times * signal <= 0):
        return None
    stated = _scatter(signal, times)
    for exact in exact_times(times):
        left = _scatter(signal, exact)
        if left < LESS * stated:
            worst = worst_in_words(times, exact)
            return {"worst": worst, "left": 100 * left, "stated": 100 * stated}
    return None


def _scatter(signal: Float[np.ndarray, " levels"], times: Float[np.ndarray, " levels"]) -> float:
    """Rms of ln(signal / time) about a smooth curve."""
    x = times / times.max()
    design = np.stack([np.ones_like(x), x, times.min() / times], axis=1)
    rates = np.log(signal / times)
    rest = rates - design @ np.linalg.lstsq(design, rates)[0]
    return float(np.sqrt(np.sum(rest**2) / (len(x) - design.shape[1])))
