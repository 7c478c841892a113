"""A soft shadow

A rectangular lamp lights a ball, with 16 x 16 shadow rays from each point to the lamp.
"""

import jax.numpy as jnp
import matplotlib.pyplot as plt

import jaxvision as jv

white, red = jv.Lambert([0.25] * 3), jv.Lambert([0.2, 0.04, 0.03])
ball = jv.Surface(jv.Sphere((0.0, 0.0, 0.6), 0.6), red)
floor = jv.Surface(jv.Plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)), white)
lamp = jv.RectangleLight((-1.6, 0.2, 2.2), (0.0, 0.9, 0.0), (0.9, 0.0, 0.5), [9.0] * 3)
eye, middle = jnp.array([0.6, -4.5, 2.4]), jnp.array([0.2, 0.2, 0.4])
rotation = jv.look_at(eye, middle, jnp.array([0.0, 0.0, 1.0]))
view = jv.Pinhole(eye, rotation, 1.0, 0.75 / 320, resolution=(240, 320))
radiance = jv.render(jv.Scene([ball, floor], [lamp]), view, rule=jv.Quadrature(16))
plt.imshow(jv.srgb_encode((radiance / jnp.quantile(radiance, 0.995)).clip(0, 1)))
plt.axis("off")
