"""Layers of two bands and a coverage."""

import jax.numpy as jnp
import numpy as np

RNG = np.random.default_rng(10)
FRONT, BACK, THIRD = (jnp.asarray(RNG.uniform(0.1, 0.9, size=(2, 2, 3))) for _ in range(3))
ONE = jnp.asarray(0.7)

EXAMPLES = {
    "compositing.over": ((FRONT, BACK), {}),
    "compositing.composite": ((FRONT, BACK), {"operator": "xor"}),
    "compositing.flatten": ((jnp.stack([FRONT, BACK, THIRD]),), {}),
    "compositing.dissolve": ((FRONT, ONE), {}),
    "compositing.darken": ((FRONT, ONE), {}),
    "compositing.premultiply": ((FRONT[..., :2], BACK[..., -1:]), {}),
    "compositing.unpremultiply": ((FRONT,), {}),
    "compositing.layer_from_srgb": ((FRONT,), {}),
    "compositing.layer_to_srgb": ((FRONT * 0.9,), {}),
    "compositing.checked_alpha": ((ONE,), {}),
}
