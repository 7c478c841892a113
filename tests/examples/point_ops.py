"""Point operators beyond those of the narrow path."""

import jax.numpy as jnp
import numpy as np

RNG = np.random.default_rng(9)
X = jnp.asarray(RNG.uniform(0.1, 0.9, size=(2, 3, 2)))
Y = jnp.asarray(RNG.uniform(0.1, 0.9, size=(2, 3, 2)))
RGB = jnp.asarray(RNG.uniform(0.1, 0.9, size=(2, 2, 3)))
ONE, TWO = jnp.asarray(0.7), jnp.asarray(2.3)
CURVE, CUBE = jnp.asarray(RNG.uniform(size=5)), jnp.asarray(RNG.uniform(size=(2, 3, 4, 2)))
FALLOFF = jnp.asarray([-0.2, -0.1])
CODES = jnp.asarray([0, 3, 2, 1])

EXAMPLES = {
    "point_ops.contrast_brightness": ((X, TWO, ONE), {}),
    "point_ops.exposure": ((X, ONE), {}),
    "point_ops.blend": ((X, Y, ONE), {}),
    "point_ops.cross_dissolve": ((X, Y), {}),
    "point_ops.graded_filter": ((X, ONE, TWO, ONE * 0.1, TWO), {}),
    "point_ops.vignette": ((X, FALLOFF), {}),
    "point_ops.correct_vignetting": ((X, FALLOFF), {}),
    "point_ops.clip": ((X, ONE * 0.4, ONE), {}),
    "point_ops.lookup": ((X, CURVE), {}),
    "point_ops.lookup_codes": ((CODES, CURVE), {}),
    "point_ops.lookup_3d": ((RGB, CUBE), {}),
    "point_ops.reinhard": ((X,), {"white": TWO}),
    "point_ops.scaled_to_key": ((X[..., 0],), {}),
    "point_ops.filmic": ((X,), {}),
    "point_ops.log_curve": ((X, TWO), {}),
    "point_ops.with_luminance": ((X, X[..., 0], Y[..., 0]), {}),
}
