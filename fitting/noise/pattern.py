"""Fixed pattern of a sensor from the spatial variances of its levels: DSNU and PRNU.

    s^2 = s^2_measured - var_y / L                 pattern left after L frames of temporal noise
    s^2 = s_dark^2 + PRNU^2 (mu_y - mu_y.dark)^2   what dark signal and gain of the pixels add up to

The standard (EMVA 1288, release 3.1) takes one dark level and one at half of saturation; the
weighted fit takes all. Uneven light counts as PRNU in both. Errors are those of the population
that the die's n pixels are a sample of: 2 s^4 / n for the pattern itself, beside temporal noise.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from .emva1288 import Ranges
from .levels import LINEAR_TOP, Levels, PhotonTransfer
from .shared import Found, one_pattern

HALF = 0.5  # of the saturation signal: where the standard measures PRNU
SEEN = 2.0  # standard errors above zero from which a pattern variance is a finding


@dataclass(frozen=True)
class PatternVariance:
    """What the spatial variances of levels add up to.

    Attributes:
        dark: s_dark^2, DN^2.
        dark_error: its standard error.
        response: PRNU^2, no unit.
        response_error: its standard error.
        chi_square_per_dof: of the fit to all levels; None for the standard's two.
        level: the bright level used; None where all were.
    """

    dark: float
    dark_error: float
    response: float
    response_error: float
    chi_square_per_dof: float | None = None
    level: int | None = None


def pattern_variance(levels: Levels) -> tuple[np.ndarray, np.ndarray]:
    """Spatial variance that temporal noise does not explain.

    Args:
        levels: with `spatial_variance`.

    Returns:
        s^2 (DN^2) of each level, and its variance by temporal noise (DN^4).
    """
    measured, temporal, frames = (
        np.asarray(x) for x in (levels.spatial_variance, levels.variance, levels.frames)
    )
    n, rest = float(levels.pixels), temporal / frames
    pattern = measured - rest

    def of(pattern: np.ndarray, rest: np.ndarray, count: float) -> np.ndarray:
        return (4 * np.maximum(pattern, 0) * rest + 2 * rest**2 * frames / (frames - 1)) / count

    by_noise = of(pattern, rest, n)
    for fixed, varying, count in _lines(levels):
        by_noise = by_noise + of(fixed, np.maximum(varying, 0) / frames, count)
    return pattern, by_noise


def population_variance(levels: Levels, pattern: Float[np.ndarray, " levels"]) -> np.ndarray:
    """Variance with which a die's n pixels, and its rows and columns, stand for their population.

    Args:
        levels: of pixels.
        pattern: (levels,) their spatial variance, DN^2.

    Returns:
        (levels,) DN^4.
    """
    lines = sum(2 * np.maximum(fixed, 0) ** 2 / count for fixed, _, count in _lines(levels))
    return 2 * pattern**2 / float(levels.pixels) + lines


def response_population_variance(
    measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"], response: float
) -> float:
    """Variance with which a die's pixels, rows and columns stand for the gains of their population.

    Args:
        measurement: bright and dark levels.
        usable: indices of the bright levels to use.
        response: PRNU^2.

    Returns:
        Of PRNU^2, no unit.
    """
    found = 2 * response**2 / float(measurement.bright.pixels)
    if measurement.bright.shared is None or measurement.dark.shared is None:
        return found
    for axis, count in enumerate(np.asarray(measurement.bright.shared.shape)):
        found += 2 * max(unequal_gains(measurement, usable, axis).variance, 0.0) ** 2 / float(count)
    return found


def unequal_gains(
    measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"], axis: int
) -> Found:
    """How unequal the gains of rows (axis 0) or columns (axis 1) are, of all levels together.

    Args:
        measurement: bright and dark levels with `shared`.
        usable: indices of the bright levels to use.
        axis: which.

    Returns:
        The part of PRNU^2, no unit.
    """
    bright, dark = measurement.bright, measurement.dark
    assert bright.shared is not None
    lines, across = np.asarray(bright.shared.shape)[[axis, 1 - axis]]
    matched, square = np.asarray(measurement.dark_of)[usable], _signal(measurement)[usable] ** 2
    pattern, dark_pattern = pattern_variance(bright)[0], pattern_variance(dark)[0]
    own = np.maximum(pattern[usable] - dark_pattern[matched], 0) / square / across

    def of_lines(levels: Levels) -> tuple[np.ndarray, np.ndarray]:
        """What stays, and what passes of the average frame's."""
        fixed, varying, _ = _lines(levels)[axis]
        passing = np.maximum(varying, 0) + np.asarray(levels.variance) / across
        return fixed, passing / np.asarray(levels.frames)

    fixed, passing = (x[usable] for x in of_lines(bright))
    dark_fixed, dark_passing = (x[matched] for x in of_lines(dark))
    return one_pattern(
        (fixed - dark_fixed) / square,
        float(np.median(own)),
        (passing + dark_passing) / square,
        np.asarray(bright.frames)[usable],
        float(lines),
    )


def _lines(levels: Levels) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """(fixed variance, temporal variance, how many) of rows and of columns."""
    shared = levels.shared
    if shared is None:
        return []
    rows, columns = (float(count) for count in shared.shape)
    return [
        (np.asarray(shared.fixed_rows), np.asarray(shared.rows), rows),
        (np.asarray(shared.fixed_columns), np.asarray(shared.columns), columns),
    ]


def standard_pattern(measurement: PhotonTransfer, within: Ranges) -> PatternVariance:
    """The standard's two levels: most frames first, then closest to half of saturation.

    Args:
        measurement: bright and dark levels.
        within: the standard's ranges.

    Returns:
        The pattern.
    """
    bright, dark = measurement.bright, measurement.dark
    pattern, by_noise = pattern_variance(bright)
    dark_pattern, dark_by_noise = pattern_variance(dark)
    matched = np.asarray(measurement.dark_of)
    signal = _signal(measurement)
    linear = np.flatnonzero(np.asarray(within.linearity))
    half = HALF * signal[linear].max() / LINEAR_TOP
    frames = np.minimum(np.asarray(bright.frames), np.asarray(dark.frames)[matched])[linear]
    level = int(linear[np.lexsort((np.abs(signal[linear] - half), -frames))[0]])
    own = matched[level]
    square = signal[level] ** 2
    variances = by_noise + population_variance(bright, pattern)
    dark_variances = dark_by_noise + population_variance(dark, dark_pattern)
    return PatternVariance(
        dark=float(dark_pattern[own]),
        dark_error=float(np.sqrt(dark_variances[own])),
        response=float((pattern[level] - dark_pattern[own]) / square),
        response_error=float(np.sqrt(variances[level] + dark_variances[own]) / square),
        level=level,
    )


def fitted_pattern(
    measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"]
) -> PatternVariance:
    """The pattern by weighted least squares over all darks and many bright levels.

    Args:
        measurement: bright and dark levels.
        usable: indices of the bright levels to use.

    Returns:
        The pattern.
    """
    pattern, by_noise = pattern_variance(measurement.bright)
    dark_pattern, dark_by_noise = pattern_variance(measurement.dark)
    square = np.concatenate([_signal(measurement)[usable] ** 2, np.zeros(len(dark_pattern))])
    observed = np.concatenate([pattern[usable], dark_pattern])
    spread = np.sqrt(np.concatenate([by_noise[usable], dark_by_noise]))
    design = np.stack([np.ones_like(square), square], axis=1) / spread[:, None]
    covariance = np.linalg.inv(design.T @ design)
    found = covariance @ (design.T @ (observed / spread))
    chi_square = float(np.sum((observed / spread - design @ found) ** 2))
    degrees = max(len(observed) - 2, 1)
    covariance = covariance * max(chi_square / degrees, 1)
    of_dark = population_variance(measurement.dark, np.full(len(dark_pattern), found[0]))
    of_response = response_population_variance(measurement, usable, float(found[1]))
    of_sample = np.array([np.median(of_dark), of_response])
    errors = np.sqrt(np.diagonal(covariance) + of_sample)
    return PatternVariance(
        dark=float(found[0]),
        dark_error=float(errors[0]),
        response=float(found[1]),
        response_error=float(errors[1]),
        chi_square_per_dof=chi_square / degrees,
    )


def _signal(measurement: PhotonTransfer) -> Float[np.ndarray, " levels"]:
    dark = np.asarray(measurement.dark.mean)[np.asarray(measurement.dark_of)]
    return np.asarray(measurement.bright.mean) - dark
