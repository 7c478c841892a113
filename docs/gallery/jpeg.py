"""What JPEG loses

The library's JPEG equals libjpeg's, level for level, and can be differentiated. Quality 10 and
the difference to the original, four times as strong.
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
