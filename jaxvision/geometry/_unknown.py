"""Hits of rays that are not finite, and of shapes whose place is unknown."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .rays import Hit, Ray


def unknown_hit(hit: Hit, ray: Ray, *of_shapes: Float[Array, "..."]) -> Hit:
    """Return the hit, of which every number is NaN if the ray has one that is NaN or infinite, or
    if one of the shapes' numbers is NaN."""
    lost = ~jnp.isfinite(sum(jax.tree.leaves(ray)))
    for number in of_shapes:
        lost |= jnp.isnan(number).any()
    return jax.tree.map(lambda x: jnp.where(lost, jnp.nan, x), hit)
