"""Calls for nonlinear filters, pyramids and integral images."""

import jax.numpy as jnp
import numpy as np

from jaxvision.filters.integral import integral_image
from jaxvision.filters.pyramid import laplacian_pyramid

RNG = np.random.default_rng(7)
X = jnp.asarray(RNG.uniform(0.1, 0.9, size=(5, 6, 2)))
Y = jnp.asarray(RNG.uniform(0.1, 0.9, size=(5, 6, 2)))
MASK = jnp.asarray(RNG.uniform(0.1, 0.9, size=(5, 6, 1)))
WIDE, NARROW = jnp.asarray(1.3), jnp.asarray(0.2)
TOP, LEFT, BOTTOM, RIGHT = (jnp.asarray(i) for i in (1, 2, 4, 5))

EXAMPLES = {
    "filters.median.median_filter": ((X,), {"size": 3}),
    "filters.bilateral.bilateral_filter": ((X, WIDE, NARROW), {"radius": 2, "window": "disc"}),
    "filters.bilateral.joint_bilateral_filter": ((X, Y, WIDE, NARROW), {"radius": 1}),
    "filters.nonlocal_means.nonlocal_means_filter": (
        (X, NARROW),
        {"noise": 0.05, "patch": 3, "radius": 2},
    ),
    "filters.pyramid.reduce_by_two": ((X,), {}),
    "filters.pyramid.expand": ((X,), {"size": (9, 12)}),
    "filters.pyramid.gaussian_pyramid": ((X,), {"levels": 3}),
    "filters.pyramid.laplacian_pyramid": ((X,), {"levels": 3}),
    "filters.pyramid.collapse_laplacian": ((laplacian_pyramid(X, 3),), {}),
    "filters.pyramid.blend_by_pyramid": ((X, Y, MASK), {"levels": 3}),
    "filters.integral.integral_image": ((X,), {}),
    "filters.integral.box_sum": ((integral_image(X), TOP, LEFT, BOTTOM, RIGHT), {}),
    "filters.integral.window_sum": ((integral_image(X),), {"size": (2, 3)}),
}
