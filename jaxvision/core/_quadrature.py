"""Quadrature nodes and weights on the unit interval, and steps of a low-discrepancy sequence in the
unit square."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.polynomial import legendre

# Steps of the two-dimensional Kronecker sequence: powers of the inverse of the plastic number,
# x^3 = x + 1 (Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences", 2018).
KRONECKER_STEPS = (0.7548776662466927, 0.5698402909980532)


def gauss_legendre(order: int) -> tuple[Float[np.ndarray, " order"], Float[np.ndarray, " order"]]:
    """Return Gauss-Legendre nodes and weights on [0, 1], exact up to degree 2 order - 1.

    Args:
        order: number of nodes, at least 1.

    Returns:
        Nodes in (0, 1) and weights of sum 1, each (order,); no unit.

    Example:
        >>> nodes, weights = jv.lights.gauss_legendre(3)
        >>> print(weights @ nodes**5)  # the integral of x^5, 1/6
        0.1666666666666667
    """
    x, w = legendre.leggauss(order)
    return (x + 1) / 2, w / 2


def interpolate_legendre(
    values: Float[Array, "order bands"], t: Float[Array, ""]
) -> Float[Array, " bands"]:
    """Return the polynomial through `values` at the nodes of `gauss_legendre`, at `t` in [0, 1],
    (bands,) in the unit of the values: its series of Legendre polynomials."""
    order = len(values)
    x, w = legendre.leggauss(order)
    degrees = np.arange(order)
    transform = (degrees + 0.5)[:, None] * legendre.legvander(x, order - 1).T * w
    series = (jnp.asarray(transform, values.dtype)[:, :, None] * values[None]).sum(axis=1)
    x = 2 * t - 1
    before, now = jnp.ones_like(x), x
    total = series[0]
    for k in range(1, order):
        total = total + now * series[k]
        before, now = now, ((2 * k + 1) * x * now - k * before) / (k + 1)
    return total
