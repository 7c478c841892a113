"""Smoothing with and without preserved edges

A picture with Gaussian noise and a few dead pixels. The Gaussian filter blurs noise, dead pixels
and edges alike, the median removes the dead pixels, and the bilateral filter keeps the edges but
also the dead pixels.
"""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
from skimage import data

from jaxvision.filters import bilateral_filter, gaussian, median_filter

clean = jnp.asarray(data.camera()[60:200, 160:300] / 255)
noise, dead = jax.random.split(jax.random.key(0))
noisy = clean + 0.08 * jax.random.normal(noise, clean.shape)
noisy = jnp.where(jax.random.uniform(dead, clean.shape) < 0.02, 0.0, noisy)
pictures = {
    "noisy": noisy,
    "Gaussian": gaussian(noisy, 1.5),
    "median": median_filter(noisy, size=5),
    "bilateral": bilateral_filter(noisy, 2.0, 0.25, radius=5),
}
figure, axes = plt.subplots(2, 2, figsize=(4.4, 4.4))
for axis, (name, picture) in zip(axes.flat, pictures.items(), strict=True):
    axis.imshow(picture, cmap="gray", vmin=0, vmax=1)
    axis.set_title(f"{name}, rms {jnp.sqrt(jnp.mean((picture - clean) ** 2)):.3f}")
    axis.axis("off")
