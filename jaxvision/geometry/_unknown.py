"""Hits of rays that are not finite."""

import jax
import jax.numpy as jnp

from .rays import Hit, Ray


def unknown_without_ray(hit: Hit, ray: Ray) -> Hit:
    """Return the hit, of which every number is NaN if the ray has one that is NaN or infinite."""
    lost = ~jnp.isfinite(sum(jax.tree.leaves(ray)))
    return jax.tree.map(lambda x: jnp.where(lost, jnp.nan, x), hit)
