"""Least-squares lines over levels, sampling errors, chi-square tests, and intervals of variances.

A variance may be the sum of parts, some of which are estimated with few degrees of freedom. Part i
(of pixels, rows or columns) has the variance V_i, whose estimate has a chi-square distribution with
nu_i degrees of freedom. For w columns, nu_i is w - 1. For small nu_i, intervals that are symmetric
in the logarithm or the square root are wrong. Let V be the sum of the V_i, and sigma the standard
error of V from temporal noise. The quantile of the variance at probability p is

    V + sqrt(S) for p > 1/2,    V - sqrt(S) for p < 1/2,
    S = sum (nu_i / q_i - 1)^2 V_i^2 + z^2 sigma^2,

where q_i is the value that a chi-square with nu_i degrees of freedom exceeds with probability p,
and z the Gaussian quantile at p (Graybill and Wang, J. Am. Stat. Assoc. 75, 869, 1980).
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import gammaincc
from jaxtyping import Array, Float
from scipy.special import chdtrc, chdtri, ndtri

from ..inference.estimates import QUANTILES
from .levels import Levels
from .shared import SharedNoise


def slope_through_origin(x: Array, y: Array, within: Array) -> Float[Array, ""]:
    """Return the least-squares slope b of y = b x."""
    return jnp.sum(jnp.where(within, x * y, 0)) / jnp.sum(jnp.where(within, x * x, 0))


def line(x: Array, y: Array, *, weights: Array | None = None) -> tuple[Array, Array]:
    """Return intercept and slope of the weighted least-squares line."""
    weights = jnp.ones_like(x) if weights is None else weights
    total = jnp.sum(weights)
    centre_x, centre_y = jnp.sum(weights * x) / total, jnp.sum(weights * y) / total
    away = x - centre_x
    slope = jnp.sum(weights * away * (y - centre_y)) / jnp.sum(weights * away**2)
    return centre_y - slope * centre_x, slope


def surprise(chi2: Array, degrees: Array) -> Array:
    """Return the p-value of a chi-square."""
    free = jnp.maximum(degrees, 1)
    return jnp.where(degrees > 0, gammaincc(free / 2, chi2 / 2), 1)


@jax.jit
def line_misfit(x: Array, y: Array, variances: Array) -> tuple[Array, Array]:
    """Return chi-square about a weighted line (mean if all x are equal), and degrees of freedom."""
    weights = 1 / variances
    one_place = jnp.all(x == x[0])
    mean = jnp.sum(weights * y) / jnp.sum(weights)
    intercept, slope = line(
        jnp.where(one_place, jnp.arange(x.size, dtype=x.dtype), x), y, weights=weights
    )
    expected = jnp.where(one_place, mean, intercept + slope * x)
    degrees = jnp.where(one_place, x.size - 1, x.size - 2)
    return jnp.sum((y - expected) ** 2 / variances), degrees.astype(y.dtype)


def chi_square(missed: Array, variances: Array, used: Array) -> Array:
    """Return the sum of squared residuals over their variances."""
    safe = jnp.where(used & (variances > 0), variances, 1)
    return jnp.sum(jnp.where(used, missed**2 / safe, 0))


class SamplingErrors(eqx.Module):
    """The sampling variances and covariance of each level's mean and temporal variance."""

    mean: Float[Array, " levels"]  # variance of the mean, DN^2
    variance: Float[Array, " levels"]  # variance of the variance, DN^4
    both: Float[Array, " levels"]  # their covariance, DN^3


def sampling_errors(
    levels: Levels,
    *,
    shot_variance: Array | float = 0.0,
    gain: Array | float = 0.0,
    shared: SharedNoise | None = None,
) -> SamplingErrors:
    """Return the sampling errors of mean and temporal variance over pixels and frames."""
    shot = jnp.maximum(shot_variance, 0)
    n, frames = levels.pixels, levels.frames
    mean = levels.variance / (n * frames)
    variance = (2 * levels.variance**2 / (frames - 1) + gain**2 * shot / frames) / n
    if levels.unsteady is not None:
        mean = mean + levels.unsteady / frames
    if shared is not None:
        mean = mean + shared.of_mean / frames
        variance = variance + shared.of_variance / (frames - 1)
    return SamplingErrors(mean=mean, variance=variance, both=gain * shot / (n * frames))


MISFIT = 1e-3  # p-value below which a model is rejected


def p_value(chi_square: float, degrees: float) -> float:
    """Return the probability that chance gives a chi-square at least as large."""
    return float(chdtrc(max(degrees, 1), chi_square))


def inflation(chi_square: float, degrees: float) -> float:
    """Return chi-square per degree of freedom if it is significant, else 1."""
    beyond = degrees > 0 and p_value(chi_square, degrees) < MISFIT
    return chi_square / degrees if beyond else 1.0


class Fitted(NamedTuple):
    """A sum of terms, fitted by least squares."""

    values: Float[np.ndarray, " terms"]  # coefficients of the terms
    covariance: Float[np.ndarray, "terms terms"]  # by the errors of the data
    misfit: float  # chi-square per degree of freedom

    @property
    def errors(self) -> Float[np.ndarray, " terms"]:
        """Standard errors of the coefficients, enlarged if the data scatter more than their
        errors."""
        return np.sqrt(np.diagonal(self.covariance) * max(self.misfit, 1.0))


def least_squares(
    terms: Sequence[np.ndarray | float],
    y: Float[np.ndarray, " data"],
    *,
    errors: Float[np.ndarray, " data"] | float = 1.0,
) -> Fitted:
    """Fit a sum of terms, each with one coefficient, to data with these standard errors."""
    design = np.stack([term / errors * np.ones(len(y)) for term in terms], axis=1)
    scale = np.sqrt(np.sum(design**2, axis=0))
    inverse = np.linalg.pinv(design / scale) / scale[:, None]
    values = inverse @ (y / errors)
    degrees = max(len(y) - len(terms), 1)
    misfit = float(np.sum((y / errors - design @ values) ** 2)) / degrees
    return Fitted(values, inverse @ inverse.T, misfit)


class Part(NamedTuple):
    """A part of a variance, estimated from a sample."""

    variance: float  # of the population
    degrees: float  # of freedom of its estimate


def sampling_variance(parts: Sequence[Part]) -> float:
    """Return the sampling variance of the sum of parts, sum 2 V_i^2 / nu_i."""
    return sum(2 * part.variance**2 / part.degrees for part in parts)


def deviation_quantiles(
    variance: float, noise: float, parts: Sequence[Part], *, relative: float = 0.0
) -> Float[np.ndarray, "5"]:
    """Return five quantiles of a standard deviation in ascending order: the ends of its 95 % and 68
    % intervals, and its median.

    Example:
        >>> from fitting.noise.regressions import Part, deviation_quantiles
        >>> low, _, middle, _, high = deviation_quantiles(1.0, 0.0, [Part(1.0, 15)])
        >>> np.round([low**2, middle, high**2], 3).tolist()  # 15 / 27.488, 15 / 6.262
        [0.546, 1.0, 2.395]
    """
    z = ndtri(QUANTILES)
    square = (z * noise) ** 2
    for part in parts:
        factor = part.degrees / chdtri(part.degrees, QUANTILES)
        square = square + np.where(z == 0, 0.0, (factor - 1) * part.variance) ** 2
    ratio = np.maximum(1 + np.sign(z) * np.sqrt(square) / variance, 0.0)
    with np.errstate(divide="ignore"):  # the logarithm of 0 is an end at 0
        steps = np.sign(z) * np.hypot(np.log(ratio) / 2, z * relative)
    return np.sqrt(variance) * np.exp(steps)
