"""Noise that the pixels of a row, of a column or of a whole frame share.

An amplifier or voltage reference of a row adds the same noise to all pixels of the row. For frames
of h rows and w columns, the temporal variance of a row's mean about the frame's mean is

    V_row = sigma_row^2 + (sigma^2 - sigma_row^2) / w

times (h - 1) / h, with sigma^2 the temporal variance of a pixel and sigma_row^2 the part that all
pixels of its row share. The same holds for columns. Shared noise is part of sigma^2, and so of the
read noise, but is not independent between pixels. Therefore the sampling variance of sigma^2 cannot
fall below a multiple of sigma_row^4 / h, however many columns a frame has. The same
formula holds for fixed differences between rows or columns, with the spatial variances of the
average frame in place of the temporal variances.
"""

from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.special import chdtri, fdtrc, ndtri

from .levels import Levels

LINES = ("rows", "columns")  # of a frame; axis 0 and axis 1
SIGNIFICANCE_SIGMAS = 4.0  # normal deviate, exceeded once in 30,000 cameras without shared noise
LOWEST = 0.05  # probability of so small an estimate in the darks if they have the noise
RAREST, EPSILON = 1e-300, 1e-16  # least probability, and least distance from 1
MOST_DEGREES, TINY = 1e9, 1e-300  # degrees that count as infinite; ratio that counts as 0


class SharedNoise(eqx.Module):
    """The sampling errors that shared noise of rows, columns or whole frames adds at a level of L
    frames. `of_mean` / L is added to the sampling variance of the level's mean, and `of_variance` /
    (L - 1) to that of its temporal variance. Noise of whole frames does not affect the latter.
    """

    of_mean: Float[Array, ""]  # variance of a level's mean by shared noise, DN^2
    of_variance: Float[Array, ""]  # variance of a level's variance by shared noise, DN^4


@dataclass(frozen=True)
class Found:
    """An estimated variance with its standard error and significance."""

    variance: float  # DN^2
    error: float  # its standard error
    significance: float  # significance of a variance above 0, as a normal deviate

    @property
    def is_significant(self) -> bool:
        return self.significance > SIGNIFICANCE_SIGMAS

    @property
    def deviation(self) -> float:
        """Square root of the variance, DN; 0 if the estimate is negative."""
        return float(np.sqrt(max(self.variance, 0.0)))


NOTHING = Found(0.0, 0.0, 0.0)


def _deviate(ratio: float, degrees: float, beneath: float = MOST_DEGREES) -> float:
    """Return the normal deviate of the same tail probability as an F-ratio."""
    return -float(ndtri(np.clip(fdtrc(degrees, beneath, max(ratio, 0.0)), RAREST, 1 - EPSILON)))


def temporal_lines(levels: Levels, axis: int) -> Found:
    """Estimate the temporal noise that rows (axis 0) or columns (axis 1) share, DN^2."""
    if levels.shared is None:
        return NOTHING
    lines, across = np.asarray(levels.shared.shape)[[axis, 1 - axis]]
    degrees = (np.asarray(levels.frames) - 1) * max(lines - 1, 1.0)
    expected = np.asarray(levels.variance) / across
    values = np.asarray(levels.shared.lines)[axis]
    return _pool(values, expected, degrees, degrees * max(across - 1, 1.0))


def extra_lines(
    bright: Levels, dark: Levels, usable: Int[np.ndarray, " usable"], axis: int
) -> Found:
    """Estimate the noise that lines share in usable flats beyond that of the darks."""
    unlit = temporal_lines(dark, axis)
    if bright.shared is None or not unlit.error:
        return NOTHING
    lines, across = np.asarray(bright.shared.shape)[[axis, 1 - axis]]
    alike, by_pixels = max(unlit.variance, 0.0), np.asarray(bright.variance)[usable] / across
    of_darks = float(np.mean(np.asarray(dark.variance))) / across
    own = unlit.variance + of_darks
    known = 2 * (own / unlit.error) ** 2
    more = max(float(np.mean(by_pixels)) - of_darks, 0.0)  # of pixels
    beneath = known * (1 + more / (own * known / chdtri(known, 1 - LOWEST))) ** 2
    values = np.asarray(bright.shared.lines)[axis, usable] - alike
    degrees = (np.asarray(bright.frames)[usable] - 1) * max(lines - 1, 1.0)
    expected = by_pixels + alike
    pooled = _pool(values, expected, degrees, np.full(len(values), beneath / len(values)))
    ratio = np.divide(values, expected, out=np.full(len(values), -np.inf), where=expected > 0)
    plainest = int(np.argmax(ratio * np.sqrt(degrees)))
    error = (expected + values)[plainest] * np.sqrt(2 / degrees[plainest])
    error = float(np.hypot(error, unlit.error))
    return Found(float(values[plainest]), error, pooled.significance)


def significant_lines(levels: Levels) -> list[tuple[float, float]]:
    """Return (variance in DN^2, number) of rows and columns with significant noise."""
    if levels.shared is None:
        return []
    found = [temporal_lines(levels, axis) for axis in (0, 1)]
    counts = (float(count) for count in levels.shared.shape)
    return [(one.variance, n) for one, n in zip(found, counts, strict=True) if one.is_significant]


def shared_noise(levels: Levels) -> SharedNoise | None:
    """Return the sampling errors that significant shared noise adds; None without any."""
    lines, wander = significant_lines(levels), drift(levels)
    if not lines and not wander.is_significant:
        return None
    of_mean = sum(one / count for one, count in lines)
    if wander.is_significant:
        degrees = float(np.sum(np.asarray(levels.frames) - 1))
        of_mean += wander.variance * degrees / max(degrees - 2, 1)  # variance of Student's t
    of_variance = sum(2 * one**2 / count for one, count in lines)
    return SharedNoise(jnp.asarray(of_mean, float), jnp.asarray(of_variance, float))


def fixed_lines(levels: Levels, axis: int) -> Found:
    """Estimate the fixed variance between rows (axis 0) or columns (axis 1), DN^2."""
    if levels.shared is None or levels.spatial_variance is None:
        return NOTHING
    spatial, variance, frames = (
        np.asarray(x) for x in (levels.spatial_variance, levels.variance, levels.frames)
    )
    lines, across = np.asarray(levels.shared.shape)[[axis, 1 - axis]]
    of_lines = max(temporal_lines(levels, axis).variance, 0.0)
    passing = (of_lines + variance / across) / frames
    own = float(np.median(np.maximum(spatial - variance / frames, 0))) / across
    return one_pattern(np.asarray(levels.shared.fixed)[axis], own, passing, frames, lines)


def one_pattern(
    values: Float[np.ndarray, " levels"],
    own: float,
    passing: Float[np.ndarray, " levels"],
    frames: np.ndarray,
    lines: float,
) -> Found:
    """Estimate the variance between rows (or columns) that is fixed, that is, the same in all
    frames and at all levels.

    The `values` are estimates of this variance at each level, from which the expected contributions
    of single pixels were subtracted. The fixed pattern of single pixels contributes the variance a,
    `own`, to the mean of a row. This contribution is the same at all levels, so more levels do not
    reduce its scatter. Temporal noise of an average over L frames contributes the variance b,
    `passing`, which is independent at each level. With the weight w of each level and sums over the
    levels, the standard error of the weighted mean is

        sqrt(2 / (lines - 1) (a^2 + 2 a sum w^2 b + sum w^2 b^2 L / (L - 1)))
    """
    informative = own + passing > 0
    if lines < 2 or not informative.any():
        return NOTHING
    values, passing, frames = values[informative], passing[informative], frames[informative]
    weight = (own + passing) ** -2
    weight = weight / weight.sum()
    found, base = float(weight @ values), own + float(weight @ passing)

    def error(pattern: float) -> float:
        mixed = 2 * pattern * np.sum(weight**2 * passing)
        noise = np.sum(weight**2 * passing**2 * frames / (frames - 1))
        return float(np.sqrt(2 / (lines - 1) * (pattern**2 + mixed + noise)))

    significance = _deviate(1 + found / base, 2 * (base / error(own)) ** 2)
    return Found(found, error(own + max(found, 0.0)), significance)


def drift(levels: Levels) -> Found:
    """Estimate the variance of frames' means beyond pixel, row and column noise, DN^2."""
    if levels.shared is None:
        return NOTHING
    degrees, shape = np.asarray(levels.frames) - 1, np.asarray(levels.shared.shape)[:, None]
    lines = np.maximum(np.asarray(levels.shared.lines), 0) / shape
    expected = np.asarray(levels.variance) / shape.prod() + lines.sum(axis=0)
    unsure = np.sum(lines**2 / (degrees * np.maximum(shape - 1, 1.0)), axis=0)
    beneath = np.minimum(expected**2 / np.maximum(unsure, TINY), MOST_DEGREES)
    return _pool(np.asarray(levels.shared.frames), expected, degrees, beneath)


def _pool(
    values: np.ndarray, expected: np.ndarray, degrees: np.ndarray, beneath: np.ndarray
) -> Found:
    """Return the weighted mean over levels of `values`, the variances in excess of those expected
    from independent pixels. The weight of a level is its degrees of freedom over its expected
    variance, as in the F-test, so that a significant excess is positive. Levels whose frames are
    identical have no weight.
    """
    known = expected > 0
    if not known.any():
        return NOTHING
    values, expected, degrees = values[known], expected[known], degrees[known]
    ratio = float(np.average(1 + values / expected, weights=degrees))
    significance = _deviate(ratio, float(degrees.sum()), float(beneath[known].sum()))
    share = degrees / expected / np.sum(degrees / expected)
    variance = float(share @ values)
    error = float(np.sqrt(np.sum(2 * (share * (expected + variance)) ** 2 / degrees)))
    return Found(variance, error, significance)
