"""Draws of a sampler in the parameters' own units, however many there are by one program."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .parameters import ParameterSpace, to_natural

ROWS = 4096  # vectors that go across at a time


def natural_draws(
    space: ParameterSpace, vectors: Float[np.ndarray, "... parameters"]
) -> Float[np.ndarray, "... parameters"]:
    """As `to_natural`, which is compiled for every shape: an ensemble ends after any number of
    steps, and a second fit compiles nothing.

    Args:
        space: the P parameters.
        vectors: (..., P) unconstrained.

    Returns:
        (..., P).
    """
    rows = vectors.reshape(-1, len(space))
    filled = np.pad(rows, ((0, -len(rows) % ROWS), (0, 0)), mode="edge")
    parts = [
        np.asarray(to_natural(space, jnp.asarray(filled[i : i + ROWS])))
        for i in range(0, len(filled), ROWS)
    ]
    return np.concatenate(parts)[: len(rows)].reshape(vectors.shape)
