"""Fixed pattern of a sensor (DSNU and PRNU) from the spatial variances at its light levels.

    s^2 = s^2_measured - var_y / L spatial variance without the noise of L frames s^2 = s_dark^2 +
    PRNU^2 (mu_y - mu_y.dark)^2   sum of the variations of dark signal and gain

The standard (EMVA 1288, release 3.1) uses one dark level and one bright level at half of
saturation. The weighted fit uses all darks and all bright levels below saturation. Both methods
count uneven light as PRNU. Both methods estimate the variance of the population of pixels, of which
this sensor's pixels are a sample. The variance over the pixels of a frame contains only the share 1
- 1 / w of the variance of w unequal columns. Therefore significant contributions of rows and
columns are divided by this share, to give the variance of their population. The sampling error of
each contribution (`parts`) is that of a chi-square with n degrees of freedom for n pixels, or w - 1
for w columns.

In a sample of pixels, even independent offsets and gains have a random covariance c, which adds 2 c
(mu_y - mu_y.dark) to s^2. The mean of c is 0, so c is treated as an error.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Int

from .emva1288 import Ranges
from .levels import LINEAR_TOP, Levels, PhotonTransfer, signal_of
from .regressions import Part, p_value, sampling_variance
from .shared import NOTHING, Found, fixed_lines, one_pattern

PRNU_SIGNAL_SHARE = 0.5  # of the saturation signal: where the standard measures PRNU
# Ratio to the bound from temporal noise above which other errors dominate
LARGEST_BOUND_RATIO = 2.0
SIGNIFICANCE_SIGMAS = 2.0  # standard errors above zero from which a pattern variance is a finding


@dataclass(frozen=True)
class Spread:
    """The variance of the pixels' offsets or of their gains over the population of pixels."""

    variance: float  # DN^2 for offsets; relative for gains
    # standard error of the variance over this sensor's pixels, without the sampling error of these
    # pixels from a population
    noise: float
    # variances of pixels and, where the means of rows and columns are known, of rows and columns; 0
    # where rows or columns do not differ significantly
    parts: tuple[Part, ...]
    # the part of `noise` from temporal noise, which more frames reduce; None if all of `noise` is
    # temporal
    temporal: float | None = None

    @property
    def error(self) -> float:
        """Standard error of the population's variance, with the error from sampling these
        pixels."""
        return float(np.sqrt(self.noise**2 + sampling_variance(self.parts)))

    @property
    def significant(self) -> bool:
        """Whether the variance exceeds 0 significantly."""
        return self.variance > SIGNIFICANCE_SIGMAS * self.noise

    @property
    def bound(self) -> float:
        """The upper limit of the variance if it is not significant."""
        return self._upper_limit(self.noise)

    @property
    def hidden_by_noise(self) -> bool:
        """Whether temporal noise limits the bound, so that more frames would lower it."""
        return self.temporal is None or self.bound < LARGEST_BOUND_RATIO * self._upper_limit(
            self.temporal
        )

    def _upper_limit(self, noise: float) -> float:
        return max(self.variance, 0.0) + SIGNIFICANCE_SIGMAS * noise


@dataclass(frozen=True)
class PatternVariance:
    """The fixed pattern of a sensor: the variances of dark signal and of gain."""

    dark: Spread  # s_dark^2, the variance of the dark signal, DN^2
    response: Spread  # PRNU^2, the relative variance of the gains
    # of the fit to all levels; None for the standard's method, which uses two levels
    chi_square_per_dof: float | None = None
    # probability of a chi-square at least as large by chance; None for the standard's method
    p_value: float | None = None
    level: int | None = None  # index of the bright level used; None if all were used


def pattern_variance(levels: Levels) -> tuple[np.ndarray, np.ndarray]:
    """Return the spatial variance of each level beyond that by temporal noise.

    Args:
        levels: levels with a `spatial_variance`.

    Returns:
        s^2 (DN^2) of each level, and its sampling variance by temporal noise (DN^4).
    """
    measured, temporal, frames = (
        np.asarray(x) for x in (levels.spatial_variance, levels.variance, levels.frames)
    )
    if levels.flicker is not None:  # an average over few frames retains a part of it
        temporal = temporal + np.asarray(levels.flicker).sum(axis=0)
    # A variance over the pixels of a frame contains (h - 1) / h of the variance of h rows.
    common = sum(varying / count for _, varying, count in _lines(levels))
    n, rest = float(levels.pixels), (temporal - common) / frames
    pattern = measured - rest

    by_noise = _noise_variance(pattern, rest, frames) / n
    for fixed, varying, count in _lines(levels):
        by_noise += _noise_variance(fixed, np.maximum(varying, 0) / frames, frames) / count
    return pattern, by_noise


def _noise_variance(pattern: np.ndarray, rest: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """Return the sampling variance, DN^4, of a deviation's square in an average of frames."""
    return 4 * np.maximum(pattern, 0) * rest + 2 * rest**2 * frames / (frames - 1)


def local_variances(levels: Levels) -> tuple[np.ndarray, np.ndarray] | None:
    """Return fixed variances between neighbours, DN^2, and their errors squared, DN^4."""
    if levels.local_pattern is None:
        return None
    own, frames = np.asarray(levels.local_pattern), np.asarray(levels.frames)
    # Differences of neighbours have 1.5 times the sampling variance of single pixels.
    by_noise = 1.5 * _noise_variance(own, np.asarray(levels.variance) / frames, frames)
    return own, by_noise / float(levels.pixels)


def local_pattern(
    measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"]
) -> tuple[Spread, Spread]:
    """Return variances of offsets and of gains between neighbours, free of uneven light."""
    signal = signal_of(measurement)
    usable = usable[signal[usable] > 0]
    matched = np.asarray(measurement.dark_of)[usable]

    def spread(values: np.ndarray, variances: np.ndarray) -> Spread:
        weights = 1 / np.maximum(variances, 1e-300)
        mean = float(np.average(values, weights=weights)) if values.size else 0.0
        return Spread(mean, float(weights.sum() ** -0.5) if values.size else np.inf, ())

    lit, unlit = local_variances(measurement.bright), local_variances(measurement.dark)
    assert lit is not None
    assert unlit is not None
    square = signal[usable] ** 2
    gains = (lit[0][usable] - unlit[0][matched]) / square
    return spread(*unlit), spread(gains, (lit[1][usable] + unlit[1][matched]) / square**2)


def unequal_offsets(dark: Levels) -> tuple[Found, Found]:
    """Return the fixed variance of rows and of columns of the darks, DN^2."""
    return fixed_lines(dark, 0), fixed_lines(dark, 1)


def _population_spread(
    levels: Levels, of_die: float, noise: float, lines: Sequence[Found]
) -> Spread:
    """Scale the variance over a sensor's pixels to the variance of their population."""
    n = float(levels.pixels)
    counts = () if levels.shared is None else levels.shared.shape
    parts = [
        Part(line.variance if line.is_significant else 0.0, max(float(count) - 1, 1.0))
        for line, count in zip(lines, counts, strict=False)
    ]
    # The variance over a die contains (w - 1) (n / w) / (n - 1) of that of w columns.
    lost = sum(part.variance * (n / (part.degrees + 1) - 1) / (n - 1) for part in parts)
    variance = of_die + lost
    own = max(variance - sum(part.variance for part in parts), 0.0)
    return Spread(float(variance), noise, (Part(float(own), n), *parts))


def _chance_covariance(dark: Spread, response: Spread, pixels: float) -> float:
    """Return the variance of the sample covariance of independent offsets and gains."""
    lines = zip(dark.parts[1:], response.parts[1:], strict=False)
    return max(dark.variance, 0.0) * max(response.variance, 0.0) / pixels + sum(
        one.variance * other.variance / one.degrees for one, other in lines
    )


def unequal_gains(
    measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"]
) -> tuple[Found, Found]:
    """Return the relative fixed variance of the gains of rows and of columns."""
    bright, dark = measurement.bright, measurement.dark
    signal = signal_of(measurement)
    usable = usable[signal[usable] > 0]  # flats without light hold no information on gains
    if bright.shared is None or dark.shared is None or not len(usable):
        return NOTHING, NOTHING
    matched, square = np.asarray(measurement.dark_of)[usable], signal[usable] ** 2
    pattern, dark_pattern = pattern_variance(bright)[0], pattern_variance(dark)[0]
    own = np.maximum(pattern[usable] - dark_pattern[matched], 0) / square
    lit, unlit = _lines(bright), _lines(dark)

    def compare_lines(axis: int) -> Found:
        across = lit[1 - axis][2]

        def line_variances(levels: Levels, lines: list) -> tuple[np.ndarray, np.ndarray]:
            """Return the fixed variance of the means of rows or columns, and the temporal variance
            of these means in the average frame."""
            fixed, varying, _ = lines[axis]
            passing = np.maximum(varying, 0) + np.asarray(levels.variance) / across
            return fixed, passing / np.asarray(levels.frames)

        fixed, passing = (x[usable] for x in line_variances(bright, lit))
        dark_fixed, dark_passing = (x[matched] for x in line_variances(dark, unlit))
        return one_pattern(
            (fixed - dark_fixed) / square,
            float(np.median(own)) / across,
            (passing + dark_passing) / square,
            np.asarray(bright.frames)[usable],
            lit[axis][2],
        )

    return compare_lines(0), compare_lines(1)


def _lines(levels: Levels) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Return (fixed, temporal variances, number) of rows and of columns; [] if unknown."""
    if levels.shared is None:
        return []
    fixed, varying, counts = (
        np.asarray(x) for x in (levels.shared.fixed, levels.shared.lines, levels.shared.shape)
    )
    return list(zip(fixed, varying, counts.tolist(), strict=True))


def standard_pattern(measurement: PhotonTransfer, within: Ranges) -> PatternVariance:
    """Return the pattern by the standard's method, from one bright level and its dark. The bright
    level is the one with the most frames and, of these, the closest to half of saturation."""
    bright, dark = measurement.bright, measurement.dark
    pattern, by_noise = pattern_variance(bright)
    dark_pattern, dark_by_noise = pattern_variance(dark)
    matched = np.asarray(measurement.dark_of)
    signal = signal_of(measurement)
    linear = np.flatnonzero(np.asarray(within.linearity))
    half = PRNU_SIGNAL_SHARE * signal[linear].max() / LINEAR_TOP
    frames = np.minimum(np.asarray(bright.frames), np.asarray(dark.frames)[matched])[linear]
    level = int(linear[np.lexsort((np.abs(signal[linear] - half), -frames))[0]])
    own = matched[level]
    noise = float(np.sqrt(dark_by_noise[own]))
    offsets = _population_spread(dark, float(dark_pattern[own]), noise, unequal_offsets(dark))
    of_die = float(pattern[level] - dark_pattern[own]) / signal[level] ** 2
    gains = unequal_gains(measurement, linear)
    response = _population_spread(bright, of_die, 0.0, gains)
    chance = 4 * signal[level] ** 2 * _chance_covariance(offsets, response, float(bright.pixels))
    temporal = by_noise[level] + dark_by_noise[own]
    noise, temporal = (
        float(np.sqrt(x) / signal[level] ** 2) for x in (temporal + chance, temporal)
    )
    return PatternVariance(offsets, replace(response, noise=noise, temporal=temporal), level=level)


def fitted_pattern(
    measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"]
) -> PatternVariance:
    """Estimate the pattern by least squares over all darks and `usable` bright levels."""
    bright, dark = measurement.bright, measurement.dark
    pattern, by_noise = pattern_variance(bright)
    dark_pattern, dark_by_noise = pattern_variance(dark)
    signal = np.concatenate([signal_of(measurement)[usable], np.zeros(len(dark_pattern))])
    observed = np.concatenate([pattern[usable], dark_pattern])
    by_noise = np.concatenate([by_noise[usable], dark_by_noise])
    informative = by_noise > 0  # levels whose frames are not identical
    signal, observed, by_noise = signal[informative], observed[informative], by_noise[informative]
    unequal = unequal_offsets(dark), unequal_gains(measurement, usable)
    design = np.stack([np.ones_like(signal), signal**2], axis=1)
    degrees = max(len(observed) - 2, 1)

    by_temporal = np.linalg.inv(design.T @ (design / by_noise[:, None]))
    by_temporal = np.sqrt(np.diagonal(by_temporal))

    def fit(chance: float) -> tuple[Spread, Spread, float]:
        """Fit the variances of offsets and gains, given `chance`, the variance of their random
        covariance. Return the fit and its chi-square."""
        weights = np.linalg.inv(np.diag(by_noise) + 4 * chance * np.outer(signal, signal))
        covariance = np.linalg.inv(design.T @ weights @ design)
        found = covariance @ (design.T @ (weights @ observed))
        left = observed - design @ found
        chi_square = float(left @ weights @ left)
        noise = np.sqrt(np.diagonal(covariance) * max(chi_square / degrees, 1))
        offsets, gains = (
            replace(
                _population_spread(levels, float(one), float(error), lines), temporal=float(own)
            )
            for levels, one, error, own, lines in zip(
                (dark, bright), found, noise, by_temporal, unequal, strict=True
            )
        )
        return offsets, gains, chi_square

    offsets, gains, _ = fit(0.0)
    offsets, gains, chi_square = fit(_chance_covariance(offsets, gains, float(bright.pixels)))
    return PatternVariance(
        offsets,
        gains,
        chi_square_per_dof=chi_square / degrees,
        p_value=p_value(chi_square, degrees),
    )
