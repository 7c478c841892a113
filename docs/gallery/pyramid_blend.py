"""Two pictures joined without a seam

Burt and Adelson's method blends each level of the Laplacian pyramids over a width proportional to
its scale.
"""

import jax.numpy as jnp
import matplotlib.pyplot as plt
from skimage import data

from jaxvision.filters import blend_by_pyramid

left = jnp.asarray(data.astronaut()[:256, 100:356] / 255)
right = jnp.asarray(data.coffee()[60:316, 200:456] / 255)
mask = jnp.tile(jnp.arange(256)[:, None] < 150, (256, 1, 1)).astype(float)
figure, axes = plt.subplots(1, 2)
axes[0].imshow(jnp.where(mask > 0, left, right))
axes[0].set_title("cut")
axes[1].imshow(blend_by_pyramid(left, right, mask, levels=6).clip(0, 1))
axes[1].set_title("blended, 6 levels")
for axis in axes:
    axis.axis("off")
