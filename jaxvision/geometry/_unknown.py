"""Hits of rays that are not finite."""

import jax
import jax.numpy as jnp

from .rays import Hit, Ray


def unknown_without_ray(hit: Hit, ray: Ray) -> Hit:
    """Return the hit. If a number of the ray is NaN or infinite, every number of the result is
    NaN."""
    lost = ~jnp.isfinite(sum(jax.tree.leaves(ray)))
    return jax.tree.map(lambda x: jnp.where(lost, jnp.nan, x), hit)
