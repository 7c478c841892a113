"""Noise of one scene in less and less light

Raw numbers of one sensor at decreasing light; each picture is scaled to its mean. At 3 photons per
pixel the shot noise is stronger than the scene.
"""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
from skimage import data

import jaxvision as jv

scene = jv.srgb_decode(jnp.asarray(data.camera()[::2, ::2, None] / 255))
sensor = jv.Sensor(
    quantum_efficiency=0.6, shot_noise=jv.PoissonShotNoise(), read_noise=1.5, gain=4.0
)
figure, axes = plt.subplots(1, 3, figsize=(5.6, 2.2))
for axis, photons in zip(axes, (1000, 30, 3), strict=True):
    raw = jv.raw_image(jax.random.key(1), sensor, photons * scene / scene.mean())
    axis.imshow(jv.srgb_encode((raw / raw.mean() * 0.2).clip(0, 1)), cmap="gray")
    axis.set_title(f"{photons} photons")
    axis.axis("off")
