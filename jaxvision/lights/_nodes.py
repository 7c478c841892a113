"""Nodes of quadrature rules in the unit square, with their weights. Fixed nodes are NumPy float64
arrays, computed while JAX traces a function."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._quadrature import KRONECKER_STEPS, gauss_legendre
from ..core._types import Key


def product(
    u: tuple[np.ndarray, np.ndarray], v: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the product rule of two one-dimensional quadrature rules: nodes (n, 2) and weights
    (n,), no unit."""
    nodes = np.stack(np.meshgrid(u[0], v[0], indexing="ij"), axis=-1).reshape(-1, 2)
    return nodes, np.outer(u[1], v[1]).reshape(-1)


def square_nodes(order: int) -> tuple[np.ndarray, np.ndarray]:
    """Return Gauss-Legendre nodes and weights on the unit square.

    Args:
        order: nodes along a side, at least 1.

    Returns:
        Nodes, (order^2, 2), and weights of sum 1, (order^2,); no unit.

    Example:
        >>> nodes, weights = jv.lights.square_nodes(2)
        >>> print(nodes.shape, weights)
        (4, 2) [0.25 0.25 0.25 0.25]
    """
    return product(gauss_legendre(order), gauss_legendre(order))


@takes_numbers
def shifted_lattice(
    key: Key, samples: int, dtype: DTypeLike
) -> tuple[Float[Array, "samples 2"], Float[Array, " samples"]]:
    """Return the points of a randomly shifted lattice in [0, 1)^2. The points cover the square
    evenly, and each of them is uniformly distributed.

    Args:
        key: random key of the shift.
        samples: number of points, at least 1.
        dtype: floating, of the result.

    Returns:
        Points, (samples, 2), and equal weights of sum 1, (samples,); no unit.
    """
    lattice = jnp.asarray(np.arange(samples)[:, None] * np.array(KRONECKER_STEPS) % 1, dtype)
    points = (lattice + jax.random.uniform(key, (1, 2), dtype)) % 1
    return points, jnp.full(samples, 1 / samples, dtype)
