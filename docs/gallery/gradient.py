"""How a picture depends on a lamp

The derivative of each pixel with respect to the lamp's position, by forward-mode differentiation of
the renderer. Red becomes brighter, and blue darker, as the lamp moves to the right (x), up (y) or
towards the viewer (z).
"""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxvision as jv

ball = jv.Surface(jv.Sphere((0, 0, 0), 1.0), jv.PhongBRDF([0.2], [0.2], 30.0))
view = jv.Orthographic((0, 0, 5.0), np.diag([1.0, -1, -1]), 2.2 / 200, resolution=(200, 200))


def picture(place):
    return jv.render(jv.Scene([ball], [jv.PointLight(place, (20.0,))]), view)[..., 0]


slopes = jax.jit(jax.jacfwd(picture))(jnp.array([-1.0, 1.0, 2.5]))
figure, axes = plt.subplots(1, 3, figsize=(5.6, 2.2))
for axis, slope, name in zip(axes, jnp.moveaxis(slopes, -1, 0), "xyz", strict=True):
    axis.imshow(slope, cmap="RdBu_r", vmin=-2, vmax=2)
    axis.set_title(f"d radiance / d {name}")
    axis.axis("off")
