"""Tables of codes at levels of few electrons: the choice of the levels, and the counts from their
frames.

With a read noise below about one electron, the histogram of the codes has a peak for each count
of electrons, or is skew. Mean and variance lose most of this information. The black levels of
pixels differ (DSNU), which would blur the peaks. The pixel's own black level, its mean over the
dark frames of the same exposure, is therefore subtracted from each code. The noise of that mean
is known, and no distribution of the offsets is assumed. The gains of pixels are assumed to agree
within a fifth of the read noise over the counted electrons, which limits the light of the
levels."""

from collections.abc import Callable, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Int

from .levels import CodeTables, PhotonTransfer, linear_levels
from .pattern import fitted_pattern
from .shared import drift

SUB_ELECTRON = 1.5  # e- of read noise above which moments hold as much information
FINEST = 0.4  # codes of read noise, below which a pixel's black hides between two codes
FEWEST, MOST = 0.1, 30.0  # electrons of a level
UNEVEN = 0.2  # of the read noise, by which unequal gains may move a level's codes
LEVELS = 8  # of a fit at most: more cost time and add little information
REACH = 8.0  # standard deviations on either side that a table holds
SIZES = 64  # codes in whose multiples tables come, as each size is compiled by itself
PLACES = 8  # of the pixels' black between two codes, at most


def dim_levels(measurement: PhotonTransfer) -> Int[np.ndarray, " levels"] | str:
    """The bright levels whose codes are counted."""
    none, usable = np.zeros(0, int), linear_levels(measurement)
    bright, dark, converter = measurement.bright, measurement.dark, measurement.converter
    matched = np.asarray(measurement.dark_of)[usable]
    signal = np.asarray(bright.mean)[usable] - np.asarray(dark.mean)[matched]
    excess = np.asarray(bright.variance)[usable] - np.asarray(dark.variance)[matched]
    if bright.converter != dark.converter:  # some frames were averaged
        return none
    if not converter.step or any("system_gain" in doubt.of for doubt in measurement.doubts):
        return none
    if not signal.sum() > 0 or not excess.sum() > 0:
        return none
    gain = float(excess.sum() / signal.sum())
    noise = float(np.sqrt(max(np.median(np.asarray(dark.variance)) - converter.rounding, 0.0)))
    read = noise / gain
    if read >= SUB_ELECTRON:
        return none
    told = f"Read noise is about {read:.2g} e⁻, below {SUB_ELECTRON:g} e⁻, but"
    if not converter.even or converter.imbalance or noise < FINEST * converter.step:
        return (
            f"{told} {noise / converter.step:.2g} of a code, and steps between codes are too wide "
            "or uneven for the histogram of codes: the fit uses means and variances."
        )
    response = fitted_pattern(measurement, usable).response
    uneven = float(np.sqrt(response.variance)) if response.significant else 0.0
    most = min(MOST, UNEVEN * read / uneven) if uneven else MOST
    electrons = signal / gain
    dim = usable[(electrons >= FEWEST) & (electrons <= most)]
    if not len(dim):
        return (
            f"{told} no level has {FEWEST:g} to {most:.2g} electrons, at which the histogram of "
            "codes tells more than mean and variance; add such flats for a better gain."
        )
    return dim[np.unique(np.linspace(0, len(dim) - 1, min(len(dim), LEVELS)).astype(int))]


def code_tables(
    measurement: PhotonTransfer,
    levels: Int[np.ndarray, " levels"],
    flats: Sequence[Sequence[str]],
    darks: Sequence[Sequence[str]],
    *,
    plane: Callable[[str], np.ndarray],
    live: Bool[np.ndarray, "h w"] | None,
) -> CodeTables:
    """Count the codes of some levels, which reads their frames and darks again."""
    bright, dark, converter = measurement.bright, measurement.dark, measurement.converter
    matched = np.asarray(measurement.dark_of)[levels]
    wander = 0.0
    if dark.shared is not None:
        found = drift(dark.shared, np.asarray(dark.variance), np.asarray(dark.frames))
        wander = found.variance / converter.step**2 if found.believed else 0.0

    def codes_of(name: str) -> np.ndarray:
        frame = (plane(name) - converter.origin) / converter.step
        return frame.ravel() if live is None or live.shape != frame.shape else frame[live]

    rows = []
    for d in np.unique(matched):
        black = sum(codes_of(name) for name in darks[int(d)]) / len(darks[int(d)])
        variance = float(dark.variance[d]) / converter.step**2
        error = variance / len(darks[int(d)]) + wander
        noise = np.sqrt(variance + error)
        count = int(np.clip(np.ceil(2 / noise), 1, PLACES))
        whole = np.floor(black).astype(int)
        above = black - whole
        place = np.minimum((count * above).astype(int), count - 1)
        for level in levels[matched == d]:
            signal = float(bright.mean[level] - dark.mean[d]) / converter.step
            deviation = np.sqrt(float(bright.variance[level]) / converter.step**2 + error)
            first = int(np.floor(-REACH * noise))
            size = int(np.ceil(signal + REACH * deviation)) + 2 - first
            counts = np.zeros(count * size)
            for name in flats[int(level)]:
                at = np.round(codes_of(name)).astype(int) - whole - first
                inside = (at >= 0) & (at < size)
                counts += np.bincount((place * size + at)[inside], minlength=counts.size)
            for k, own in enumerate(counts.reshape(count, size)):
                of_place = above[place == k]
                if own.any():
                    known = error + float(of_place.var())
                    rows.append((level, d, float(of_place.mean()), known, first, own))
    level, of, places, known, first, counts = zip(*rows, strict=True)
    size = -(-max(len(own) for own in counts) // SIZES) * SIZES
    padded = [np.pad(own, (0, size - len(own)), constant_values=np.nan) for own in counts]
    return CodeTables(
        level=jnp.asarray(level),
        dark=jnp.asarray(of),
        place=jnp.asarray(places),
        known=jnp.asarray(known),
        first=jnp.asarray(first, float),
        counts=jnp.asarray(np.stack(padded)),
    )
