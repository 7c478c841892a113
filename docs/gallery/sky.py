"""A ball under a sky

An environment map is the only light. Each glossy reflection is computed from 64 rays per pixel, in
directions drawn both from the sky and from the lobe, weighted by the balance heuristic.
"""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxvision as jv

theta, phi = np.mgrid[0.5:64, 0.5:128] * np.pi / 64  # of the map's pixels, its pole along z
up = np.sin(theta) * np.sin(phi)  # y
sky = np.where(up[..., None] > 0, [0.25, 0.4, 0.7], [0.16, 0.12, 0.08])
window = (np.abs(theta - 0.9) < 0.35) & (np.abs(phi - 2.2) < 0.3)
light = jv.environment_map(np.where(window[..., None], 9.0, sky))
glass = jv.Dielectric([1.5] * 3)
material = jv.TorranceSparrow([0.05, 0.02, 0.02], [1.0] * 3, 0.12, interface=glass)
scene = jv.Scene([jv.Surface(jv.Sphere((0, 0, 0), 1.0), material)], [light])
view = jv.Orthographic((0, 0, 5.0), np.diag([1.0, -1, -1]), 2.1 / 256, resolution=(256, 256))
draw = jax.jit(jv.render)
radiance = draw(scene, view, rule=jv.Balanced(jax.random.key(0), 64))
plt.imshow(jv.srgb_encode((radiance / jnp.quantile(radiance, 0.99)).clip(0, 1)))
plt.axis("off")
