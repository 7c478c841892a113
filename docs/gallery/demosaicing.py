"""A colour mosaic and three ways to demosaic it

Each pixel of a mosaic measures one colour. Bilinear interpolation causes coloured fringes at edges;
Malvar's and Menon's methods reduce them by using the other colours.
"""

import jax.numpy as jnp
import matplotlib.pyplot as plt
from skimage import data

import jaxvision as jv

photo = jnp.asarray(data.astronaut()[24:104, 180:260] / 255)
pattern = jv.bayer("RGGB")
raw = jv.mosaic(photo, pattern)
figure, axes = plt.subplots(2, 2, figsize=(4.4, 4.4))
axes[0, 0].imshow(photo)
axes[0, 0].set_title("all three colours")
for axis, method in zip(axes.flat[1:], ("bilinear", "malvar", "menon"), strict=True):
    picture = jv.demosaic(raw, pattern, method=method)
    error = jnp.sqrt(jnp.mean((picture - photo) ** 2))
    axis.imshow(picture.clip(0, 1))
    axis.set_title(f"{method}, rms {error:.3f}")
for axis in axes.flat:
    axis.axis("off")
