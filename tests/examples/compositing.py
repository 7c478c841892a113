"""Calls for layers of two bands and a coverage."""

import jax.numpy as jnp
import numpy as np

RNG = np.random.default_rng(10)
FRONT, BACK, THIRD = (jnp.asarray(RNG.uniform(0.1, 0.9, size=(2, 2, 3))) for _ in range(3))
ONE = jnp.asarray(0.7)

EXAMPLES = {
    "matting.compositing.over": ((FRONT, BACK), {}),
    "matting.compositing.composite": ((FRONT, BACK), {"operator": "xor"}),
    "matting.compositing.flatten": ((jnp.stack([FRONT, BACK, THIRD]),), {}),
    "matting.compositing.dissolve": ((FRONT, ONE), {}),
    "matting.compositing.darken": ((FRONT, ONE), {}),
    "matting.compositing.premultiply": ((FRONT[..., :2], BACK[..., -1:]), {}),
    "matting.compositing.unpremultiply": ((FRONT,), {}),
    "matting.compositing.layer_from_srgb": ((FRONT,), {}),
    "matting.compositing.layer_to_srgb": ((FRONT * 0.9,), {}),
    "matting.compositing.checked_alpha": ((ONE,), {}),
}
