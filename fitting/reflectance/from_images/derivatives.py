"""Derivatives of the likelihood of a picture, over all samples and in blocks."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...inference.compiled import compiled_briefly
from ...inference.in_blocks import Counts, mapped, summed
from ...inference.newton import twice
from .model import Samples, log_likelihoods, residuals


def with_information(
    vector: Float[Array, " parameters"], samples: Samples
) -> tuple[Float[Array, ""], Float[Array, " parameters"], Float[Array, "parameters parameters"]]:
    """Return the negative log likelihood, its gradient and the observed information."""
    return summed(lambda part, counts: twice(_cost, vector, (part, counts)), samples)


@compiled_briefly
def scores_and_slopes(
    vector: Float[Array, " parameters"], samples: Samples
) -> tuple[Float[Array, "parameters samples"], Float[Array, "parameters samples"]]:
    """Return the gradient of each sample's log likelihood and of its prediction in standard
    deviations, (parameters, samples) each; slopes of saturated samples are 0."""

    def of_block(part: Samples) -> tuple[Array, Array]:
        def both(v: Array) -> tuple[Array, Array]:
            return log_likelihoods(v, part), residuals(v, part)

        _, along = jax.linearize(both, vector)
        return jax.vmap(along)(jnp.eye(vector.size, dtype=vector.dtype))

    return mapped(of_block, samples)


def _cost(vector: Array, data: tuple[Samples, Counts]) -> Array:
    """Negative log likelihood of the valid samples."""
    samples, counts = data
    each = log_likelihoods(vector, samples)
    return -jnp.sum(each if counts is None else jnp.where(counts, each, 0))
