"""Calls for point operators besides those from light to digital numbers."""

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
    "point_ops.linear.contrast_brightness": ((X, TWO, ONE), {}),
    "point_ops.linear.exposure": ((X, ONE), {}),
    "point_ops.linear.blend": ((X, Y, ONE), {}),
    "point_ops.linear.cross_dissolve": ((X[..., None], Y[..., None]), {}),
    "point_ops.across_picture.graded_filter": ((X, ONE, TWO, ONE * 0.1, TWO), {}),
    "point_ops.across_picture.vignette": ((X, FALLOFF), {}),
    "point_ops.across_picture.correct_vignetting": ((X, FALLOFF), {}),
    "point_ops.curves.clip": ((X, ONE * 0.4, ONE), {}),
    "point_ops.tables.lookup": ((X, CURVE), {}),
    "point_ops.tables.lookup_codes": ((CODES, CURVE), {}),
    "point_ops.tables.lookup_3d": ((RGB, CUBE), {}),
    "point_ops.tone_mapping.reinhard": ((X,), {"white": TWO}),
    "point_ops.tone_mapping.scaled_to_key": ((X[..., 0],), {}),
    "point_ops.tone_mapping.filmic": ((X,), {}),
    "point_ops.tone_mapping.log_curve": ((X, TWO), {}),
    "point_ops.tone_mapping.set_luminance": ((X, X[..., 0], Y[..., 0]), {}),
}
