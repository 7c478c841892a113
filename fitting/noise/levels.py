"""The record of a photon transfer measurement, and the choice of its levels below saturation.

At each level, L frames are taken in the same light. For one pixel, let S1 be the sum of its digital
numbers over the frames and S2 the sum of their squares:

    mean      y   = S1 / L                               averaged over the pixels
    variance  s^2 = (L S2 - S1^2) / (L (L - 1))          averaged over the pixels
    spatial   s^2_measured = variance of S1 / L over the pixels

The temporal variance contains no fixed pattern. DN is the digital number; exposures are seconds;
light is counted in photons per pixel and exposure.

Some converters compress their codes by a piecewise linear curve (companding). Above its knee, the
slope of the signal is r times the slope below. With K DN per electron below the knee and a signal
of s_k DN at the knee, the shot-noise variance at the signal s is

    K s                        below the knee,
    r K (s - (1 - r) s_k)      above.

From below to above the knee, the variance falls by the factor r^2, similarly to the fall at a full
well, and then rises again. The knee is found from signal and variance alone, not from the light, so
a lamp that changes between levels neither hides nor imitates it.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..codes import Converter

FEWEST = 3  # fewest levels on either side
LARGEST_VARIANCE_RATIO = 0.85  # r above which a bend may be a smooth curve
LEAST_VARIANCE_RATIO = 0.02  # r below which the well is full
# Relative rms deviation of variances from both lines, beyond their noise
VARIANCE_MODEL_ERROR = 0.03
# Least ratio of the largest signal to that of the first level above a knee
LEAST_SIGNAL_RATIO = 1.05
# Largest distance of the knee from the gap between the levels, relative to the signal
LARGEST_KNEE_DISTANCE = 0.1


class Knee(NamedTuple):
    """The knee of a response with two slopes."""

    level: int  # index of the first level above the knee
    slope: float  # r, the slope above the knee over the slope below it
    signal: float  # s_k, DN above black


def knee_of(
    signal: Float[np.ndarray, " levels"],
    shot: Float[np.ndarray, " levels"],
    error: Float[np.ndarray, " levels"],
) -> Knee | None:
    """Find the knee of a response with two slopes; None if it has none."""
    known = (signal > 0) & (shot > 0) & (error < shot / 4)
    places = np.flatnonzero(known)
    s, v, e = signal[places], shot[places], error[places] / shot[places]
    best, found = np.inf, None
    for place in range(FEWEST, len(s) - FEWEST + 1):
        if s[-1] < LEAST_SIGNAL_RATIO * s[place]:
            continue
        gain = float(
            np.average(
                v[:place] / s[:place], weights=1 / (e[:place] ** 2 + VARIANCE_MODEL_ERROR**2)
            )
        )
        slope, cut = np.polyfit(s[place:], v[place:], 1, w=1 / v[place:])
        ratio = float(slope) / gain
        if not LEAST_VARIANCE_RATIO < ratio < LARGEST_VARIANCE_RATIO:
            continue
        knee = -float(cut) / (slope * (1 - ratio))
        if (
            not (1 - LARGEST_KNEE_DISTANCE) * s[place - 1]
            <= knee
            <= (1 + LARGEST_KNEE_DISTANCE) * s[place]
        ):
            continue
        line = np.concatenate([gain * s[:place], slope * s[place:] + cut])
        left = (v / line - 1) / np.hypot(e, VARIANCE_MODEL_ERROR)
        sides = [float(np.sqrt(np.mean(part**2))) for part in (left[:place], left[place:])]
        if max(sides) < min(best, 1.5):
            best, found = max(sides), Knee(int(places[place]), ratio, knee)
    return found


FEWEST_PIXELS = 100
SATURATED_DROP = 5.0  # standard errors by which the variance decreases above the saturation point
LINEAR_TOP = 0.95  # of the saturation signal: the upper end of the standard's linearity range
CLEAR_OF_CLIPPING = 4.0  # standard deviations
MOST_ENDED = 1e-3  # share of saturated values of a level that is used
FEWEST_OF_ONE = 4  # fewest levels read by one of two converters


class SharedVariance(eqx.Module):
    """The noise that the pixels of a row or of a column share, at each level. Estimates of absent
    noise scatter about 0.
    """

    lines: Float[Array, "2 levels"]  # temporal variance that the pixels of a line share, DN^2
    # variance of the lines' means that is the same in all frames, DN^2
    fixed: Float[Array, "2 levels"]
    # variance of the frames' means beyond what pixels, rows and columns explain, DN^2
    frames: Float[Array, " levels"]
    shape: Float[Array, "2"]  # rows and columns of a frame


class Levels(eqx.Module):
    """Statistics of the frames at each level of light (or at each exposure of darks).

    Attributes:
        light: (levels,) photons per pixel and exposure, 0 in the dark.
        exposure: (levels,) s.
        mean: (levels,) DN.
        variance: (levels,) temporal variance, DN^2.
        frames: (levels,) L, the number of frames.
        pixels: number of pixels.
        spatial_variance: (levels,) variance of the pixels' means, DN^2; None where only sums over
            the pixels are known.
        shared: noise that is shared by rows, columns and whole frames; None where only sums over
            the pixels are known.
        flicker: (2, levels) noise of rows and of columns that was subtracted from `variance`, DN^2;
            None if none was subtracted.
        converter: grid of the values.
        covariances: (levels, lags, lags) covariances of neighbouring pixels, at offsets of 0 to
            `REACH` rows and columns, with the variance at (0, 0), DN^2; None without frames or
            where the pixels are not adjacent.
        residues: (levels, 2, 5, residues) means of the average frame and of its variance, by row,
            by column and by position in a cell (`periodic`); None without frames.
        quarters: (levels, 2, 12) means of the average frame and of its variance for the quarters of
            a frame, its centre and border, and the steps at its middle (`periodic`).
        taken: (levels,) s since the first level, when the first frame was taken; None if unknown.
        local_pattern: (levels,) variance that is the same in all frames, from differences of
            neighbours, DN^2; None without frames.
        blocks: (levels, 2, 8) covariance of a pixel and the one below (beside) it, by row (column)
            modulo 8, DN^2; None without frames or where the pixels are not adjacent.
        combs: (levels, steps, 8, 8) test of JPEG compression by `raw_frames.combs`; None without
            frames or where the pixels are not adjacent.
        left_out: sentences on frames that were left out because they do not match the others.
        trend: (levels,) slope of the frames' means over their order, DN per frame; None where only
            sums over the frames are known.
        ended: (levels,) share of the values at the end of the scale; None without frames.
    """

    light: Float[Array, " levels"]
    exposure: Float[Array, " levels"]
    mean: Float[Array, " levels"]
    variance: Float[Array, " levels"]
    frames: Float[Array, " levels"]
    pixels: Float[Array, ""]
    spatial_variance: Float[Array, " levels"] | None = None
    shared: SharedVariance | None = None
    covariances: Float[Array, "levels lags lags"] | None = None
    residues: Float[Array, "levels 2 5 residues"] | None = None
    quarters: Float[Array, "levels 2 12"] | None = None
    taken: Float[Array, " levels"] | None = None
    local_pattern: Float[Array, " levels"] | None = None
    blocks: Float[Array, "levels 2 12"] | None = None
    combs: Float[Array, "levels steps 8 8"] | None = None
    left_out: tuple[str, ...] = eqx.field(static=True, default=())
    flicker: Float[Array, "2 levels"] | None = None
    converter: Converter = eqx.field(static=True, default=Converter())
    trend: Float[Array, " levels"] | None = None
    ended: Float[Array, " levels"] | None = None

    @property
    def variance_error(self) -> Float[np.ndarray, " levels"]:
        """Standard error of `variance` for independent Gaussian pixels, DN^2."""
        degrees = float(self.pixels) * (np.asarray(self.frames) - 1)
        return np.asarray(self.variance) * np.sqrt(2 / degrees)

    @property
    def unsteady(self) -> Float[Array, " levels"] | None:
        """The variance of a frame's mean that `flicker` causes, DN^2."""
        if self.flicker is None or self.shared is None:
            return None
        return jnp.sum(self.flicker / self.shared.shape[:, None], axis=0)


class Doubt(NamedTuple):
    """A contradiction in the frames, and the figures that are not reported because of it."""

    of: tuple[str, ...]  # names of the doubtful figures
    reason: str  # a clause that replaces their values
    sentence: str  # for the findings


class CodeTables(eqx.Module):
    """Histograms of codes at levels of few electrons. Codes are relative to the black level of each
    pixel.

    The black level of a pixel is its mean over the dark frames. The pixels are divided into several
    histograms by the position of their black level between two codes.
    """

    level: Int[Array, " tables"]  # index of the bright level
    dark: Int[Array, " tables"]  # index of the dark that gives the pixels' black
    place: Float[Array, " tables"]  # mean of the pixels' black level minus a whole code, codes
    # variance of the error of a pixel's assumed black level, codes^2: noise of the dark frames,
    # positions within a table, and drift
    known: Float[Array, " tables"]
    # the first code of each table, relative to the whole code of the pixel's black level
    first: Float[Array, " tables"]
    # number of pixels and frames with each code; NaN beyond a table's end
    counts: Float[Array, "tables codes"]


class PhotonTransfer(eqx.Module):
    """A photon transfer measurement: the statistics of flats and darks at several levels.

    Attributes:
        bright: levels with light, in the order of their light.
        dark: levels without light.
        dark_of: (levels,) index of the dark that belongs to each bright level.
        light_step: rounding step of the photon counts, photons.
        photons_known: false where `bright.light` is the exposure in s.
        full_scale: largest DN, None where unknown.
        remarks: sentences on what was done in reading the files.
        lossy: names of frames whose files are JPEG.
        doubts: contradictions in the frames, with the figures that are not reported because of
            them.
        site: name of the amplifier tap or mosaic site of these pixels; None for all pixels.
        pattern: phase of the Bayer mosaic; None without a mosaic.
        tables: histograms of codes at levels of few electrons; None where means and variances
            contain as much information, and where only sums are known.
        stated: numbers that both the rig states and the frames determine: (key of the rig, name of
            the estimate, value, standard deviation).
    """

    bright: Levels
    dark: Levels
    dark_of: Int[Array, " levels"]
    light_step: Float[Array, ""]
    photons_known: bool = eqx.field(static=True, default=True)
    full_scale: float | None = eqx.field(static=True, default=None)
    remarks: tuple[str, ...] = eqx.field(static=True, default=())
    lossy: tuple[str, ...] = eqx.field(static=True, default=())
    doubts: tuple[Doubt, ...] = eqx.field(static=True, default=())
    site: str | None = eqx.field(static=True, default=None)
    pattern: str | None = eqx.field(static=True, default=None)
    tables: CodeTables | None = None
    stated: tuple[tuple[str, str, float, float], ...] = eqx.field(static=True, default=())

    @property
    def converter(self) -> Converter:
        """The finer of the grids on which the codes of flats and darks lie."""
        return finer(self.bright, self.dark)

    @property
    def clear(self) -> Bool[np.ndarray, " levels"]:
        """Mask of the bright levels whose mean is at least four standard deviations below full
        scale."""
        return reached(self.bright) <= (np.inf if self.full_scale is None else self.full_scale)

    @property
    def saturated(self) -> int | None:
        """Index of the bright level at the standard's saturation point. None if the variance does
        not fall above its largest value, or if the response has a knee."""
        return None if self.knee is not None else saturation_index(self.bright)

    @property
    def knee(self) -> Knee | None:
        """The knee at which the response changes to a second slope, below full scale; None if the
        response has no knee."""
        clear = self.clear
        end = len(clear) if clear.all() else int(np.argmin(clear))
        levels = signal_of(self), shot_of(self), self.bright.variance_error
        return knee_of(*(x[:end] for x in levels))


def signal_of(measurement: PhotonTransfer) -> Float[np.ndarray, " levels"]:
    """Return the signal of each bright level: its mean minus that of its dark, DN."""
    dark = np.asarray(measurement.dark.mean)[np.asarray(measurement.dark_of)]
    return np.asarray(measurement.bright.mean) - dark


def shot_of(measurement: PhotonTransfer) -> Float[np.ndarray, " levels"]:
    """Return the shot variance of each bright level: its variance minus that of its dark, DN^2."""
    dark = np.asarray(measurement.dark.variance)[np.asarray(measurement.dark_of)]
    return np.asarray(measurement.bright.variance) - dark


def finer(bright: Levels, dark: Levels) -> Converter:
    """Return the finer of the grids of codes of the bright and the dark levels."""
    return min(bright.converter, dark.converter, key=lambda one: one.step)


def reached(levels: Levels) -> Float[np.ndarray, " levels"]:
    """Return the mean plus four temporal standard deviations of each level, DN."""
    return np.asarray(levels.mean) + CLEAR_OF_CLIPPING * np.sqrt(np.asarray(levels.variance))


def saturation_index(levels: Levels) -> int | None:
    """Return the level of largest variance; None unless it decreases above this level."""
    variance = np.asarray(levels.variance)
    peak = int(np.argmax(variance))
    least = variance[peak] - SATURATED_DROP * levels.variance_error[peak]
    return peak if (variance[peak + 1 :] < least).any() else None


def linear_levels(measurement: PhotonTransfer) -> Int[np.ndarray, " usable"]:
    """Return the bright levels that neither full well nor the end of the range affects."""
    bright = measurement.bright
    usable = (np.asarray(bright.variance) > 0) & measurement.clear
    knee, saturated = measurement.knee, measurement.saturated
    if knee is not None:
        usable &= np.arange(len(usable)) < knee.level
    if saturated is not None:
        signal = signal_of(measurement)
        usable &= signal <= LINEAR_TOP * signal[saturated]
    usable &= ~partly_saturated(measurement)
    # Levels below the number at which another converter takes over, if there are enough.
    top = measurement.converter.coarse_from
    below = np.flatnonzero(usable & (reached(bright) < (np.inf if top is None else top)))
    return below if len(below) >= FEWEST_OF_ONE else np.flatnonzero(usable)


def partly_saturated(measurement: PhotonTransfer) -> Bool[np.ndarray, " levels"]:
    """Return a mask of levels of which some pixels are saturated far below the end."""
    ended = measurement.bright.ended
    if ended is None:
        return np.zeros(measurement.bright.mean.shape, bool)
    return measurement.clear & (np.asarray(ended) > MOST_ENDED)


def partly_saturated_in_words(measurement: PhotonTransfer) -> list[str]:
    """Return a sentence on levels that are not used because a part of their pixels is saturated."""
    some = np.flatnonzero(partly_saturated(measurement))
    if not some.size:
        return []
    bright = measurement.bright
    ended, mean = (float(np.asarray(x)[some[0]]) for x in (bright.ended, bright.mean))
    levels = "1 level is" if some.size == 1 else f"{some.size} levels are"
    return [
        f"{levels} not used because a part of the pixels is saturated there although the mean is "
        f"not ({100 * ended:.2g} % of the values at a mean of {mean:.4g} DN): light or gains are "
        "uneven, so that a saturation capacity is too small. Give a region of even light."
    ]


def rounding_step(amounts: np.ndarray) -> float:
    """Return the rounding step of photon counts: 1 if all counts are whole numbers, else 0."""
    return 1.0 if np.array_equal(amounts, np.round(amounts)) else 0.0
