"""Normals with errors

Photometric stereo of a relief under ten lamps 30 cm away, at known positions. The normals come
with a standard deviation for each pixel, which is large where the albedo is small. The last map is
the angle between estimated and true normals.
"""

import matplotlib.pyplot as plt
import numpy as np

from fitting.reflectance import photometric_stereo

y, x = np.mgrid[0.1:-0.1:90j, -0.1:0.1:90j]  # m
waves = 60 * (x + 0.3 * y), 70 * (y - 0.2 * x)
z = 0.003 * np.sin(waves[0]) * np.cos(waves[1])
by_y, by_x = np.gradient(z, y[:, 0], x[0])
normals = np.stack([-by_x, -by_y, np.ones_like(z)], axis=-1)
normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
albedo = np.where(np.hypot(x, y) < 0.06, 2.0, 10.0)
turns = 0.6 * np.arange(10)
lamps = np.stack([0.25 * np.cos(turns), 0.25 * np.sin(turns), 0.25 + 0.02 * turns], axis=-1)
points = np.stack([x, y, z], axis=-1)
toward = lamps[:, None, None] - points
shading = np.sum(toward * normals, axis=-1) / np.linalg.norm(toward, axis=-1) ** 3
images = albedo * shading + np.random.default_rng(0).normal(0, 0.5, shading.shape)
found = photometric_stereo(images, lamps, points=points)
off = np.linalg.norm(found.normals - normals, axis=-1)
figure, axes = plt.subplots(1, 3, figsize=(6.6, 2.4))
axes[0].imshow((1 + found.normals) / 2)
for axis, angle in zip(axes[1:], (found.normal_sd, off), strict=True):
    shown = axis.imshow(np.degrees(angle), vmin=0, vmax=2.5, cmap="magma")
figure.colorbar(shown, ax=axes[1:], label="degrees")
for axis, title in zip(axes, ("normals", "standard deviation", "error"), strict=True):
    axis.set(title=title, xticks=[], yticks=[])
