"""A blur that varies

The width of the Gaussian increases with the distance from the face. A convolution cannot do this.
Here each pixel is interpolated between 12 blurred pictures.
"""

import jax.numpy as jnp
import matplotlib.pyplot as plt
from skimage import data

import jaxvision as jv
from jaxvision.filters import blur_sigmas, gaussian_varying

photo = jv.srgb_decode(jnp.asarray(data.astronaut()[:300, 60:380] / 255))
rows, columns = jnp.mgrid[0:300, 0:320]
width = (jnp.hypot(rows - 110, columns - 165) / 30 - 2).clip(0, 8)
blurred = gaussian_varying(photo, width, sigmas=blur_sigmas(0.0, 8.0, members=12))
plt.imshow(jv.srgb_encode(blurred.clip(0, 1)))
plt.axis("off")
