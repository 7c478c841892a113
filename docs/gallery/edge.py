"""The resolution of a camera

A slanted edge, photographed by a simulated camera, and the MTF that was computed from it without a
model of the blur. Bars are two standard errors. The line is the true MTF of blur and pixel.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import jaxvision as jv
from fitting import resolution

y, x = np.mgrid[-30:30:0.2, -30:30:0.2] + 0.1  # pixels, in fifths
light = 400 + 3600 * np.clip(5 * (np.cos(0.1) * x + np.sin(0.1) * y) + 0.5, 0, 1)  # electrons
blurred = jv.filters.gaussian(light, 5 * 0.6, border="clamp")
pixels = blurred.reshape(60, 5, 60, 5).mean((1, 3))[..., None]
camera = jv.Sensor(shot_noise=jv.PoissonShotNoise(), read_noise=3.0, gain=0.25, bits=12)
raw = jv.raw_image(jax.random.key(1), camera, pixels)
found = resolution.from_edge(raw)
f, error = found.frequency, np.sqrt(np.diag(found.otf_covariance))
truth = np.exp(-2 * (np.pi * 0.6 * f) ** 2) * np.sinc(f)  # Gaussian and pixel
figure, (left, right) = plt.subplots(1, 2, figsize=(7.2, 3), width_ratios=(2, 3))
left.imshow(raw[..., 0], cmap="gray")
left.set(xticks=[], yticks=[])
right.errorbar(f, found.otf, 2 * error, fmt=".", label="edge, no model")
right.plot(f, truth, label="true")
right.set(xlabel="cycles per pixel", ylabel="MTF", xlim=(0, 1))
right.legend()
