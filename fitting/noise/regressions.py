"""Least-squares lines, and tests of the scatter of points about them against their variances."""

import jax
import jax.numpy as jnp
from jax.scipy.special import gammaincc
from jaxtyping import Array, Float


def through_origin(x: Array, y: Array, within: Array) -> Float[Array, ""]:
    """Least-squares slope of y = b x."""
    return jnp.sum(jnp.where(within, x * y, 0)) / jnp.sum(jnp.where(within, x * x, 0))


def line(x: Array, y: Array, *, weights: Array | None = None) -> tuple[Array, Array]:
    """The weighted least-squares line."""
    weights = jnp.ones_like(x) if weights is None else weights
    total = jnp.sum(weights)
    centre_x, centre_y = jnp.sum(weights * x) / total, jnp.sum(weights * y) / total
    away = x - centre_x
    slope = jnp.sum(weights * away * (y - centre_y)) / jnp.sum(weights * away**2)
    return centre_y - slope * centre_x, slope


def surprise(chi2: Array, degrees: Array) -> Array:
    """The p-value of a chi-square."""
    free = jnp.maximum(degrees, 1)
    return jnp.where(degrees > 0, gammaincc(free / 2, chi2 / 2), 1)


@jax.jit
def line_misfit(x: Array, y: Array, variances: Array) -> tuple[Array, Array]:
    """Chi-square of points about their own weighted line, or about their mean if they share one
    abscissa."""
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
    """Sum of squared residuals over their variances."""
    safe = jnp.where(used & (variances > 0), variances, 1)
    return jnp.sum(jnp.where(used, missed**2 / safe, 0))
