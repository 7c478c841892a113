"""An Airy pattern on pixels

The image of a point through a lens at f/16 on pixels of 2 µm: the mean of the Airy pattern over
each pixel, for each band. Red light spreads further than blue.
"""

import jax.numpy as jnp
import matplotlib.pyplot as plt

from jaxvision.optics import airy_kernel

bands = jnp.array([610e-9, 550e-9, 465e-9])  # m
star = airy_kernel(bands, jnp.asarray(16.0), jnp.asarray(2e-6), size=41)
plt.imshow((star / star.max((0, 1))) ** (1 / 3))
plt.title("cube root of the irradiance")
plt.axis("off")
