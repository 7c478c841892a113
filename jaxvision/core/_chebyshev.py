"""Sums of Chebyshev polynomials, for functions that only their expansions make fast."""

from collections.abc import Sequence

import jax.numpy as jnp

from ._types import Scalars


def chebyshev(coefficients: Sequence[float], t: Scalars) -> Scalars:
    """The sum of c_k T_k(t), t in [-1, 1], by Clenshaw's recurrence.

    Coefficients too small for the dtype are left out.
    """
    least = float(jnp.finfo(t.dtype).eps) / 16
    used = max(k for k, c in enumerate(coefficients) if abs(c) > least)
    b, after = jnp.zeros_like(t), jnp.zeros_like(t)
    for c in coefficients[used:0:-1]:
        b, after = 2 * t * b - after + c, b
    return t * b - after + coefficients[0]
