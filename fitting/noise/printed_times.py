"""Exposure times that were rounded as cameras print them: 1/60 for 1/64, 1/125 for 1/128.

Shutters keep to whole, half or third stops, 2^(k / 3) s. Where light is counted in seconds, times
as printed are off by up to 7 %, and light seems to scatter from level to level.
"""

from fractions import Fraction

import numpy as np
from jaxtyping import Float, Int

from .levels import PhotonTransfer

STOPS = (1, 2, 3)  # parts of a stop that dials have
PRINTED = 0.08  # relative error of a printed time, at most
LESS = 1 / 3  # of the scatter, that exact times must leave at most
FEWEST_LEVELS = 6


def printed_times_in_words(
    measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"]
) -> list[str]:
    """A sentence where the times of the flats are printed ones.

    Args:
        measurement: whose light is counted in seconds.
        usable: indices of the bright levels to use.

    Returns:
        The sentence; none where exact times do not explain the light better.
    """
    times = np.asarray(measurement.bright.exposure)[usable]
    dark = np.asarray(measurement.dark.mean)[np.asarray(measurement.dark_of)[usable]]
    signal = np.asarray(measurement.bright.mean)[usable] - dark
    if measurement.photons_known or len(times) < FEWEST_LEVELS or np.any(times * signal <= 0):
        return []
    stated = _scatter(signal, times)
    for parts in STOPS:
        exact = 2.0 ** (np.round(parts * np.log2(times)) / parts)
        off = np.abs(exact / times - 1)
        left = _scatter(signal, exact)
        if off.max() < PRINTED and left < LESS * stated:
            worst = int(np.argmax(off))
            return [
                f"The exposure times are rounded as cameras print them: with whole fractions of a "
                f"stop ({_fraction(exact[worst])} s for {_fraction(times[worst])} s, and so on) "
                f"the light departs from a smooth response by {100 * left:.2g} % rms, with the "
                f"stated times by {100 * stated:.2g} %; state the exact times."
            ]
    return []


def _scatter(signal: Float[np.ndarray, " levels"], times: Float[np.ndarray, " levels"]) -> float:
    """Rms of the logarithm of signal over time about a smooth curve."""
    x = times / times.max()
    design = np.stack([np.ones_like(x), x, times.min() / times], axis=1)
    rates = np.log(signal / times)
    rest = rates - design @ np.linalg.lstsq(design, rates)[0]
    return float(np.sqrt(np.sum(rest**2) / (len(x) - design.shape[1])))


def _fraction(seconds: float) -> str:
    """As a dial has it."""
    if seconds >= 0.5:
        return f"{seconds:.4g}"
    return str(Fraction(1, round(1 / seconds)))
