"""A matte with its error

Strands of hair before a wall, and the coverage of each pixel by closed-form matting. The third
picture is the standard deviation of the coverage, and the fourth the actual error.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import jaxvision as jv

rng = np.random.default_rng(2)
y, x = np.mgrid[0:96, 0:96]
cover = np.clip((46 - x) / 4, 0, 1)
for _ in range(24):
    strand = rng.uniform(0, 96) + rng.normal(0, 0.4) * (x - 46) + rng.normal(0, 9) * np.sin(x / 18)
    thin = np.exp(-((y - strand) ** 2)) * np.clip((80 - x) / 8, 0, 1)
    cover = np.maximum(cover, thin * (x > 40))
hair, wall = np.array([0.16, 0.09, 0.05]), np.array([0.35, 0.45, 0.55])
picture = cover[..., None] * hair + (1 - cover[..., None]) * wall
picture = (picture + rng.normal(0, 0.004, picture.shape)).clip(0)
trimap = np.where(x < 38, 1.0, np.where(x > 84, 0.0, 0.5))
found = jv.matting.matte_errors(jax.random.key(0), picture, trimap)
error = np.abs(found.alpha[..., 0] - cover)
figure, axes = plt.subplots(1, 4, figsize=(6.6, 1.8))
axes[0].imshow(jv.srgb_encode(picture.clip(0, 1)))
axes[1].imshow(found.alpha[..., 0], cmap="gray", vmin=0, vmax=1)
for axis, shown in zip(axes[2:], (found.alpha_sd[..., 0], error), strict=True):
    drawn = axis.imshow(shown, vmin=0, vmax=0.04)
figure.colorbar(drawn, ax=axes[2:], shrink=0.8)
for axis, title in zip(axes, ("picture", "coverage", "its s.d.", "its error"), strict=True):
    axis.set(title=title, xticks=[], yticks=[])
