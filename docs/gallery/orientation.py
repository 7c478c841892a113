"""Edges and their directions

Freeman and Adelson's steerable filters give the response of a quadrature pair at every angle from a
few convolutions. Colour shows the dominant direction at each pixel, and brightness the energy in
that direction.
"""

import jax.numpy as jnp
import matplotlib.pyplot as plt
from skimage import data

from jaxvision.colour_spaces import hsv_to_rgb
from jaxvision.filters import dominant_orientation, quadrature_basis

photo = jnp.asarray(data.camera()[:256, 120:376] / 255)
angle, energy = dominant_orientation(quadrature_basis(photo, 2.0, size=13))
strength = (energy / jnp.quantile(energy, 0.98)).clip(0, 1)
plt.imshow(hsv_to_rgb(jnp.stack([angle / jnp.pi % 1, 0.8 + 0 * angle, strength], axis=-1)))
plt.axis("off")
