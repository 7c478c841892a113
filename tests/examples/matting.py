"""Calls for mattes of a few pixels."""

import jax
import jax.numpy as jnp
import numpy as np

RNG = np.random.default_rng(11)
IMAGE, BEHIND, FRONT = (jnp.asarray(RNG.uniform(0.1, 0.9, size=(4, 5, 2))) for _ in range(3))
SCREEN = jnp.asarray([0.1, 0.2, 0.95])
ALPHA = jnp.asarray(RNG.uniform(0.2, 0.8, size=(4, 5, 1)))
LOW, HIGH = jnp.asarray(0.05), jnp.asarray(0.9)
TRUE = RNG.uniform(0.2, 0.8, size=(4, 5, 1))
OVER, OVER_2 = (TRUE * FRONT + (1 - TRUE) * behind for behind in (BEHIND, IMAGE))
TRIMAP = jnp.full((4, 5), 0.5).at[0].set(1.0).at[3, 1:].set(0.0)
RGB = jnp.asarray(RNG.uniform(0.1, 0.4, size=(2, 3, 3)))

EXAMPLES = {
    "matting.keying.difference_matte": ((IMAGE, BEHIND, LOW, HIGH), {}),
    "matting.keying.blue_screen_matte": ((RGB, SCREEN), {}),
    "matting.keying.projected_matte": ((OVER, FRONT, BEHIND), {}),
    "matting.keying.least_squares_matte": (
        (jnp.stack([OVER, OVER_2]), jnp.stack([BEHIND, IMAGE])),
        {},
    ),
    "matting.keying.triangulation_matte": ((OVER, BEHIND, OVER_2, IMAGE), {}),
    "matting.keying.lift": ((IMAGE, ALPHA, BEHIND), {}),
    "matting.closed_form.closed_form_matte": (
        (IMAGE, TRIMAP),
        {"epsilon": 1e-2, "tolerance": 1e-13},
    ),
    "matting.errors.matte_errors": (
        (jax.random.key(0), IMAGE, TRIMAP),
        {"epsilon": 1e-2, "draws": 2},
    ),
    "matting.foreground.estimate_foreground": ((IMAGE, ALPHA), {}),
}
