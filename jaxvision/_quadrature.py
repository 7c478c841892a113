"""Nodes and weights on the unit interval."""

import numpy as np
from jaxtyping import Float


def gauss_legendre(order: int) -> tuple[Float[np.ndarray, " order"], Float[np.ndarray, " order"]]:
    """Gauss-Legendre quadrature on [0, 1], exact for polynomials to degree 2 order - 1.

    Args:
        order: how many nodes, at least 1.

    Returns:
        Nodes in (0, 1) and weights of sum 1, each (order,); no unit.
    """
    x, w = np.polynomial.legendre.leggauss(order)
    return (x + 1) / 2, w / 2
