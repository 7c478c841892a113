"""Detection of electron multiplication before the read-out (EMCCD), from the skewness of dim flats.

Without multiplication, a signal x has variance K x and third cumulant K^2 x. A register of many
stages turns each electron into an exponentially distributed number of mean g. The variance over the
signal is then K' = 2 g K (an excess noise factor of 2), and the third cumulant is 3 / 2 K'^2 x.
"""

from collections.abc import Sequence

import numpy as np

from ..frame_checks.frame import FrameSample
from ..inference.formatting import format_with_error
from .levels import Doubt, PhotonTransfer, linear_levels
from .pattern import pattern_variance
from .quantities import ON_GAIN

SKEWED, NEAR = 1.5, 0.15  # times the third cumulant of light alone, and how near to it
SURE = 6.0  # standard errors
SMALL = 0.1  # of the third cumulant, which unequal pixels may add
FEWEST_LEVELS = 3


def multiplied(
    measurement: PhotonTransfer,
    flats: Sequence[Sequence[FrameSample]],
    darks: Sequence[Sequence[FrameSample]],
) -> Doubt | None:
    """Whether dim flats are as skew as multiplied electrons."""
    bright, dark = measurement.bright, measurement.dark
    if bright.spatial_variance is None or dark.spatial_variance is None:
        return None
    matched = np.asarray(measurement.dark_of)
    uneven = pattern_variance(bright)[0] - pattern_variance(dark)[0][matched]
    of_darks = {i: _third_cumulant(darks[i], float(dark.variance[i])) for i in {*matched.tolist()}}
    ratios, errors, gains = [], [], []
    for level in linear_levels(measurement):
        own = int(matched[level])
        signal = float(bright.mean[level] - dark.mean[own])
        gain = float(bright.variance[level] - dark.variance[own]) / max(signal, 1e-9)
        of_light = gain**2 * signal
        clipped = any(frame.at_bottom > 0 for frame in (*flats[level], *darks[own]))
        if clipped or gain <= 0 or max(uneven[level], 0.0) ** 1.5 > SMALL * of_light:
            continue
        found, error = _third_cumulant(flats[level], float(bright.variance[level]))
        unlit, unlit_error = of_darks[own]
        ratios.append((found - unlit) / of_light)
        errors.append(float(np.hypot(error, unlit_error)) / of_light)
        gains.append(gain)
    if len(ratios) < FEWEST_LEVELS:
        return None
    weights = np.array(errors) ** -2
    ratio = float(np.average(ratios, weights=weights))
    scatter = float(np.average((np.array(ratios) - ratio) ** 2 / np.square(errors)))
    error = float(np.sqrt(max(scatter, 1.0) / weights.sum()))
    if ratio - 1 < SURE * error or abs(ratio - SKEWED) > NEAR:
        return None
    gain = float(np.average(gains, weights=weights))
    return Doubt(
        ON_GAIN,
        "the electrons were multiplied, as the findings say",
        f"Dim flats are {format_with_error(ratio, error)} times as skewed as light alone makes "
        "them, as where a register multiplies electrons (EMCCD): the excess noise factor is 2 and "
        f"variance over signal, {gain:.4g} DN, is twice the gain from an electron of a pixel to "
        f"the codes, which is {gain / 2:.4g} DN. What rests on the gain is not given.",
    )


def _third_cumulant(frames: Sequence[FrameSample], variance: float) -> tuple[float, float]:
    """The third cumulant over the pixels of each frame, averaged, DN^3, and its standard error."""
    samples = [frame.sample.astype(float) for frame in frames]
    found = float(np.mean([np.mean((one - one.mean()) ** 3) for one in samples]))
    return found, float(np.sqrt(6 * variance**3 / sum(one.size for one in samples)))
