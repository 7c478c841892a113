"""Losses of JPEG compression

The library's JPEG gives the same pixel values as libjpeg, and can be differentiated. The pictures
show quality 10, and the difference from the original multiplied by four.
"""

import jax.numpy as jnp
import matplotlib.pyplot as plt
from skimage import data

import jaxvision as jv

photo = jnp.asarray(data.astronaut()[:200, 100:300] / 255)
lossy = jv.jpeg(photo, 10.0)
figure, axes = plt.subplots(1, 2)
axes[0].imshow(lossy)
axes[0].set_title("quality 10")
axes[1].imshow((0.5 + 4 * (lossy - photo)).clip(0, 1))
axes[1].set_title("what was lost, times 4")
for axis in axes:
    axis.axis("off")
